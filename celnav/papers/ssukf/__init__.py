"""[Wu2012]: a state-switching unscented Kalman filter for attitude from gyros and star sensors.

`scenario`: parameters with their source, truth and measurements, filters. `ledger.toml`: the
paper's statements and our findings. `study`: the runs, and the numbers that decide each row of the
ledger. `show`: figures, tables, recordings. Their names are also available here:
``celnav.papers.ssukf.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show")
