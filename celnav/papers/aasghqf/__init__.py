"""[Liang2014]: an adaptive anisotropic sparse Gauss-Hermite quadrature filter for star sensors, SAR
and an inertial system.

`scenario`: parameters with their source, truth and measurements, filters. `study`: what is flown,
what the paper states and what we find. `show`: figures, tables, recordings. Their names are found
here as well: ``celnav.papers.aasghqf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show")
