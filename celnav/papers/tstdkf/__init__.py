"""[Xu2024]: a two-stage strong-tracking differential Kalman filter for X-ray pulsars, colored noise and an ephemeris error.

Modules: `config` (parameters, settings, presets), `scenario` (truth, timings, filters).
"""

from celnav.papers.tstdkf.config import CITATION, PRESETS, SETTINGS, TITLE, Config, Setting
from celnav.papers.tstdkf.estimators import filters
from celnav.papers.tstdkf.scenario import Scenario, simulate

__all__ = ["CITATION", "PRESETS", "SETTINGS", "TITLE", "Config", "Scenario", "Setting", "filters", "simulate"]
