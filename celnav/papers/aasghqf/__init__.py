"""[Liang2014]: an adaptive anisotropic sparse Gauss-Hermite quadrature filter for star sensors, SAR
and an inertial system.

`scenario`: parameters with their source, truth and measurements, filters. `ledger.toml`: what the
paper states and what we find. `study`: what is flown, and the numbers that decide each row of the
ledger. `show`: figures, tables, recordings. Their names are found here as well:
``celnav.papers.aasghqf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show")
