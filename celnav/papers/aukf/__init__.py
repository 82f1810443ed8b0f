"""[Fan]: an unscented Kalman filter for BeiDou positioning that adapts its measurement noise.

`scenario`: parameters with their source, truth, satellites and measurements, filters. `study`: what is flown, what the paper
states and what we find. `show`: figures, tables, recordings.
"""

from celnav.lazy import modules
from celnav.papers.aukf.scenario import CITATION, JUDGED, PRESETS, TITLE, Config, filters, simulate, trial
from celnav.papers.aukf.show import FIGURES, RECORDINGS, TABLES, record
from celnav.papers.aukf.study import INPUTS, STUDY

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CITATION", "FIGURES", "INPUTS", "JUDGED", "PRESETS", "RECORDINGS", "STUDY", "TABLES", "TITLE", "Config", "filters",
    "record", "simulate", "trial",
]  # fmt: skip
