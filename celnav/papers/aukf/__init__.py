"""[Fan]: an unscented Kalman filter for BeiDou positioning that adapts its measurement noise.

The contract of a paper: `Config` and `PRESETS`, `simulate`, `filters`, `reproduce`, ``figure_N``, ``table_N``, `claims`,
`record`, and `ERRATA`; ``INPUTS``: what `reproduce` takes besides, a folder with a real receiver's log. Modules: `config`
(parameters, presets), `scenario` (truth, satellites, measurements, filters), `follow` (filters on runs), `sweeps` (the studies),
`real` (a receiver's day), `analysis` (what needs no simulation), `errata`, `study` (all runs), `evidence`, ``claims*``, `tables`,
`figures`, `record`.

The display equations and Table 1 of the text at hand are lost; what was inferred is

=====================  ===============================================  =================================================
what                   content                                          here
=====================  ===============================================  =================================================
measurement            pseudoranges and their rates                     `celnav.models.pseudorange`
orbits                 broadcast elements, geostationary ones too       `celnav.models.beidou`
state, its motion      position, velocity, clock; constant velocity     `celnav.models.pseudorange`
least squares          of each epoch by itself                          `celnav.receiver.least_squares`
AUKF                   noise inflated by a window of innovations        `celnav.filters.adaptive.innovation_window`
=====================  ===============================================  =================================================
"""

from celnav.lazy import modules
from celnav.papers.aukf.claims import claims
from celnav.papers.aukf.config import CHOICES, CITATION, PRESETS, TITLE, Config
from celnav.papers.aukf.errata import ERRATA
from celnav.papers.aukf.figures import (
    figure_1,
    figure_2,
    figure_3,
    figure_4,
    figure_5,
    figure_6,
    figure_7,
    figure_7b,
    figure_8,
    figure_8b,
    figure_9,
    figure_9b,
    figure_10,
    figure_11,
    figure_12,
    figure_13,
    figure_14,
)
from celnav.papers.aukf.record import RECORDINGS, record
from celnav.papers.aukf.scenario import Scenario, filters, simulate
from celnav.papers.aukf.study import INPUTS, Result, plan, reproduce
from celnav.papers.aukf.tables import table_1, table_2, table_3, table_4, table_5, table_6, table_7, table_8
from celnav.papers.aukf.trial import JUDGED, trial

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CHOICES", "CITATION", "ERRATA", "INPUTS", "JUDGED", "PRESETS", "RECORDINGS", "TITLE", "Config", "Result", "Scenario", "claims",
    "figure_1", "figure_2", "figure_3", "figure_4", "figure_5", "figure_6", "figure_7", "figure_7b", "figure_8", "figure_8b",
    "figure_9", "figure_9b", "figure_10", "figure_11", "figure_12", "figure_13", "figure_14", "filters", "plan", "record",
    "reproduce", "simulate", "table_1", "table_2", "table_3", "table_4", "table_5", "table_6", "table_7", "table_8", "trial",
]  # fmt: skip
