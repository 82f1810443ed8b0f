"""[Fan]: an unscented Kalman filter for BeiDou positioning that adapts its measurement noise.

`scenario`: parameters with their source, truth, satellites and measurements, filters. `study`: what
is flown, what the paper states and what we find. `show`: figures, tables, recordings. Their names
are found here as well: ``celnav.papers.aukf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show")
