"""[Xu2023]: a two-stage strong-tracking differential Kalman filter for X-ray pulsars, colored noise
and an ephemeris error.

`scenario`: parameters with their source, truth and timings, filters. `method`: differencing and
strong tracking. `ledger.toml`: what the paper states and what we find. `study`: what is flown, and
the numbers that decide each row of the ledger. `show`: figures, tables, recordings. Their names are
found here as well: ``celnav.papers.tstdkf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show", "method")
