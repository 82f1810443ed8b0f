"""[Wu2012]: a state-switching unscented Kalman filter for attitude from gyros and star sensors.

The contract of a paper: `Config` and `PRESETS`, `simulate`, `filters`, `reproduce`, ``figure_N``, ``table_N``, `claims`,
`record`, and `ERRATA`; besides, `compare` runs any preset, the paper's 100 Hz in full too. Modules: `config` (parameters),
`scenario` (truth, measurements, filters), `variants` (total attitude, dense roots), `vector` (one measured vector), `checks`
(identities and sensitivity), `draws` (what drawing anew loses), `theory` (exact covariances), `errata`, `study` (all runs),
`tables`, `figures`, ``claims*``, `record`.

The equations of the text at hand are lost; the parts of the filters are

===================================  ==========================================================================
content                              here
===================================  ==========================================================================
augmented, switching, additive UKF   `celnav.filters.sequential.sigma_point`, models with ``augment``
AUKF drawn once                      `celnav.filters.sequential.SingleDraw`
attitude as a state                  `celnav.gaussian.attitude.attitude`
gyro and its drift                   `celnav.models.gyro`
satellite                            `celnav.models.gyro.Body`
===================================  ==========================================================================
"""

from celnav.lazy import modules
from celnav.papers.ssukf.claims import claims
from celnav.papers.ssukf.config import CITATION, PRESETS, TITLE, Config
from celnav.papers.ssukf.errata import ERRATA
from celnav.papers.ssukf.figures import (
    figure_1,
    figure_2,
    figure_3,
    figure_4,
    figure_5,
    figure_6,
    figure_7,
    figure_8,
    figure_9,
    figure_10,
    figure_11,
)
from celnav.papers.ssukf.record import RECORDINGS, record
from celnav.papers.ssukf.scenario import Scenario, filters, simulate
from celnav.papers.ssukf.study import Result, compare, plan, reproduce
from celnav.papers.ssukf.tables import table_1, table_2, table_3
from celnav.papers.ssukf.trial import JUDGED, trial

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CITATION",
    "ERRATA",
    "JUDGED",
    "PRESETS",
    "RECORDINGS",
    "TITLE",
    "Config",
    "Result",
    "Scenario",
    "claims",
    "compare",
    "figure_1",
    "figure_2",
    "figure_3",
    "figure_4",
    "figure_5",
    "figure_6",
    "figure_7",
    "figure_8",
    "figure_9",
    "figure_10",
    "figure_11",
    "filters",
    "plan",
    "record",
    "reproduce",
    "simulate",
    "table_1",
    "table_2",
    "table_3",
    "trial",
]
