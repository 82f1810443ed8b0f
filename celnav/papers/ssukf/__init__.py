"""[Wu2012]: a state-switching unscented Kalman filter for attitude from gyros and star sensors.

`scenario`: parameters with their source, truth and measurements, filters. `study`: what is flown, what the paper states and what
we find. `show`: figures, tables, recordings.
"""

from celnav.lazy import modules
from celnav.papers.ssukf.scenario import CITATION, JUDGED, PRESETS, TITLE, Config, filters, simulate, trial
from celnav.papers.ssukf.show import FIGURES, RECORDINGS, TABLES, record
from celnav.papers.ssukf.study import STUDY

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CITATION", "FIGURES", "JUDGED", "PRESETS", "RECORDINGS", "STUDY", "TABLES", "TITLE", "Config", "filters", "record", "simulate",
    "trial",
]  # fmt: skip
