"""[Xu2023]: a two-stage strong-tracking differential Kalman filter for X-ray pulsars, colored noise
and an ephemeris error.

`scenario`: parameters with their source, truth and timings, filters. `method`: differencing and
strong tracking. `ledger.toml`: the paper's statements and our findings. `study`: the runs, and the
numbers that decide each row of the ledger. `show`: figures, tables, recordings. Their names are
also available here: ``celnav.papers.tstdkf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show", "method")
