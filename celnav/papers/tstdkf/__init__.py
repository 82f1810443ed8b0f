"""[Xu2024]: a two-stage strong-tracking differential Kalman filter for X-ray pulsars, colored noise and an ephemeris error.

The contract of a paper: `Config` and `PRESETS`, `simulate`, `filters`, `reproduce`, ``figure_N``, ``table_N``, `claims`,
`record`, and `ERRATA`. Modules: `config` (parameters, settings, presets), `method` (differencing, strong tracking), `scenario`
(truth, timings), `estimators` (filters), `follow` (filters on runs), `ephemerides` and `forces` (Figs 2, 7, 8), `linear` and
`year` (the linear driver), `sweeps` (the smaller studies), `analysis` (what needs no simulation), `errata`, `study` (all runs),
`published` (the paper's numbers), `tables`, `figures`, ``claims*``, `record`.

The display equations of the text at hand are lost; what was inferred is

=============  ======================================================  ==============================================
equation       content                                                 here
=============  ======================================================  ==============================================
2              delay of a pulse                                        `celnav.models.pulsar.Timing`
3-4            orbit and its derivatives                               `celnav.models.orbit`
17, 69, 70     ephemeris error                                         `Config.bias`
19             deviation of a timing                                   `celnav.models.pulsar.Pulsar.timing_std`
21-56          colored, correlated noise; differencing                 `celnav.papers.tstdkf.method.Differenced`
57-61          strong tracking                                         `celnav.papers.tstdkf.method.strong_tracking`
(Friedland)    two stages                                              `celnav.filters.two_stage`
=============  ======================================================  ==============================================
"""

from celnav.lazy import modules
from celnav.papers.tstdkf.claims import claims
from celnav.papers.tstdkf.config import CHOICES, CITATION, PRESETS, SETTINGS, TITLE, Config, Setting
from celnav.papers.tstdkf.errata import ERRATA
from celnav.papers.tstdkf.estimators import filters
from celnav.papers.tstdkf.figures import (
    figure_1,
    figure_2,
    figure_2b,
    figure_3,
    figure_4,
    figure_5,
    figure_6,
    figure_7,
    figure_8,
    figure_9,
    figure_9b,
    figure_10,
    figure_11,
    figure_12,
    figure_13,
    figure_14,
)
from celnav.papers.tstdkf.record import RECORDINGS, record
from celnav.papers.tstdkf.scenario import Scenario, simulate
from celnav.papers.tstdkf.study import Result, plan, reproduce
from celnav.papers.tstdkf.tables import table_1, table_2, table_3, table_4, table_5, table_6, table_7, table_8
from celnav.papers.tstdkf.trial import JUDGED, trial

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CHOICES", "CITATION", "ERRATA", "JUDGED", "PRESETS", "RECORDINGS", "SETTINGS", "TITLE", "Config", "Result", "Scenario",
    "Setting", "claims", "figure_1", "figure_2", "figure_2b", "figure_3", "figure_4", "figure_5", "figure_6", "figure_7",
    "figure_8", "figure_9", "figure_9b", "figure_10", "figure_11", "figure_12", "figure_13", "figure_14", "filters", "plan",
    "record", "reproduce", "simulate", "table_1", "table_2", "table_3", "table_4", "table_5", "table_6", "table_7", "table_8",
    "trial",
]  # fmt: skip
