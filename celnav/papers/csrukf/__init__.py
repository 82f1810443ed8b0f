"""[Sun2015]: a square-root unscented Kalman filter for colored measurement noise, satellite navigation by star sensor and camera.

The contract of a paper: `Config` and `PRESETS`, `simulate`, `filters`, `reproduce`, ``figure_N``, ``table_N``, `claims`,
`record`, and `ERRATA`.
Modules: `config` (parameters), `scenario` (truth, measurements, filters), `errata` (what is printed wrongly, as code),
`theory` (linear analysis), `study` (all runs), `published` (the paper's numbers),
`tune` (noise tuning), `tables`, `figures`, `claims`, `recording`.

=============  ======================================================  ===========================================
equation       content                                                 here
=============  ======================================================  ===========================================
38             acceleration with J2                                    `celnav.models.orbit.acceleration`
39-42          angles and position                                     `celnav.models.sightings`
1-2            colored measurement noise                               `celnav.models.noise.ar1`
4-8            differenced measurement                                 `celnav.filters.colored.difference`
10-20          decorrelation, J, Q*, R*                                `celnav.filters.colored.decorrelation`
21-37          the filter                                              `celnav.filters.colored.decorrelated`
=============  ======================================================  ===========================================
"""

from celnav.lazy import modules
from celnav.papers.csrukf import tune
from celnav.papers.csrukf.claims import claims
from celnav.papers.csrukf.config import CHOICES, CITATION, MISSION, PRESETS, TITLE, Config
from celnav.papers.csrukf.errata import ERRATA
from celnav.papers.csrukf.figures import (
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
    figure_12,
    figure_13,
    figure_14,
    figure_15,
    figure_16,
    figure_17,
    figure_18,
)
from celnav.papers.csrukf.record import RECORDINGS, record
from celnav.papers.csrukf.scenario import Scenario, filters, simulate
from celnav.papers.csrukf.study import Result, plan, reproduce
from celnav.papers.csrukf.tables import table_1, table_2, table_3
from celnav.papers.csrukf.trial import JUDGED, trial

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CHOICES",
    "CITATION",
    "ERRATA",
    "JUDGED",
    "MISSION",
    "PRESETS",
    "RECORDINGS",
    "TITLE",
    "Config",
    "Result",
    "Scenario",
    "claims",
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
    "figure_12",
    "figure_13",
    "figure_14",
    "figure_15",
    "figure_16",
    "figure_17",
    "figure_18",
    "filters",
    "plan",
    "record",
    "reproduce",
    "simulate",
    "table_1",
    "table_2",
    "table_3",
    "trial",
    "tune",
]
