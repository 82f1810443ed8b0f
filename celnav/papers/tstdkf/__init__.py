"""[Xu2024]: a two-stage strong-tracking differential Kalman filter for X-ray pulsars, colored noise and an ephemeris error.

`scenario`: parameters with their source, truth and timings, filters. `method`: differencing and strong tracking. `study`: what is
flown, what the paper states and what we find. `show`: figures, tables, recordings.
"""

from celnav.lazy import modules
from celnav.papers.tstdkf.scenario import CITATION, JUDGED, PRESETS, SETTINGS, TITLE, Config, Setting, filters, simulate, trial
from celnav.papers.tstdkf.show import FIGURES, RECORDINGS, TABLES, record
from celnav.papers.tstdkf.study import STUDY

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CITATION", "FIGURES", "JUDGED", "PRESETS", "RECORDINGS", "SETTINGS", "STUDY", "TABLES", "TITLE", "Config", "Setting",
    "filters", "record", "simulate", "trial",
]  # fmt: skip
