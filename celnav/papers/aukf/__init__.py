"""[Fan]: an unscented Kalman filter for BeiDou positioning that adapts its measurement noise.

`scenario`: parameters with their source, truth, satellites and measurements, filters.
`ledger.toml`: the paper's statements and our findings. `study`: the runs, and the numbers that
decide each row of the ledger. `show`: figures, tables, recordings. Their names are also available
here: ``celnav.papers.aukf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show")
