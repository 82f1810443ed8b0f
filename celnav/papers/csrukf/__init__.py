"""[Sun2015]: a square-root unscented Kalman filter for colored measurement noise, satellite
navigation by star sensor and camera.

`scenario`: parameters with their source, truth and measurements, filters. `method`: its covariance
in five forms. `ledger.toml`: what the paper states and what we find. `study`: the runs, and the
numbers that decide each row of the ledger. `show`: figures, tables, recordings. The names of all
but `method` are available here as well: ``celnav.papers.csrukf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show")
