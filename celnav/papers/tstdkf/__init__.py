"""[Xu2023]: a two-stage strong-tracking differential Kalman filter for X-ray pulsars, colored noise
and an ephemeris error.

`scenario`: parameters with their source, truth and timings, filters. `method`: differencing and
strong tracking. `study`: what is flown, what the paper states and what we find. `show`: figures,
tables, recordings. Their names are found here as well: ``celnav.papers.tstdkf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show", "method")
