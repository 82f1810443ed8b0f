"""[Fan2015]: an unscented Kalman filter for BeiDou positioning that adapts its measurement noise.

Modules: `config` (parameters, presets), `scenario` (truth, satellites, measurements, filters).
"""

from celnav.papers.aukf.config import CITATION, PRESETS, TITLE, Config
from celnav.papers.aukf.scenario import Scenario, filters, simulate

__all__ = ["CITATION", "PRESETS", "TITLE", "Config", "Scenario", "filters", "simulate"]
