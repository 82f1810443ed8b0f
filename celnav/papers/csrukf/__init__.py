"""[Sun2015]: a square-root unscented Kalman filter for colored measurement noise; satellite
navigation with star sensor and camera.

`scenario`: parameters with their source, truth and measurements, filters. `method`: the covariance
in five forms. `ledger.toml`: the paper's statements and our findings. `study`: the runs, and the
numbers that decide each row of the ledger. `show`: figures, tables, recordings. The names of all
modules but `method` are also available here: ``celnav.papers.csrukf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show")
