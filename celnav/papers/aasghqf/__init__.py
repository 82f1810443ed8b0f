"""[Liang2014]: an adaptive anisotropic sparse Gauss-Hermite quadrature filter for star sensors, SAR and an inertial system.

`scenario`: parameters with their source, truth and measurements, filters. `study`: what is flown, what the paper states and what
we find. `show`: figures, tables, recordings.
"""

from celnav.lazy import modules
from celnav.papers.aasghqf.scenario import CITATION, JUDGED, PRESETS, TITLE, Config, filters, simulate, trial
from celnav.papers.aasghqf.show import FIGURES, RECORDINGS, TABLES, record
from celnav.papers.aasghqf.study import STUDY

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CITATION", "FIGURES", "JUDGED", "PRESETS", "RECORDINGS", "STUDY", "TABLES", "TITLE", "Config", "filters", "record",
    "simulate", "trial",
]  # fmt: skip
