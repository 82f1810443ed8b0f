"""[Sun2015]: a square-root unscented Kalman filter for colored measurement noise, satellite navigation by star sensor and camera.

`scenario`: parameters with their source, truth and measurements, filters. `study`: what is flown, what the paper states and what
we find. `show`: figures, tables, recordings.
"""

from celnav.lazy import modules
from celnav.papers.csrukf.scenario import CITATION, JUDGED, MISSION, PRESETS, TITLE, Config, filters, simulate, trial
from celnav.papers.csrukf.show import FIGURES, RECORDINGS, TABLES, record
from celnav.papers.csrukf.study import STUDY

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CITATION", "FIGURES", "JUDGED", "MISSION", "PRESETS", "RECORDINGS", "STUDY", "TABLES", "TITLE", "Config", "filters", "record",
    "simulate", "trial",
]  # fmt: skip
