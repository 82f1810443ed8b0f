"""[Wu2012]: a state-switching unscented Kalman filter for attitude from gyros and star sensors.

Modules: `config` (parameters), `scenario` (truth, measurements, filters).
"""

from celnav.papers.ssukf.config import CITATION, PRESETS, TITLE, Config
from celnav.papers.ssukf.scenario import Scenario, filters, simulate

__all__ = ["CITATION", "PRESETS", "TITLE", "Config", "Scenario", "filters", "simulate"]
