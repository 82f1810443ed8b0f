"""[Liang2014]: an adaptive anisotropic sparse Gauss-Hermite quadrature filter for star sensors, SAR and an inertial system.

The contract of a paper: `Config` and `PRESETS`, `simulate`, `filters`, `reproduce`, ``figure_N``, ``table_N``, `claims`,
`record`, and `ERRATA`. Modules: `config` (parameters), `scenario` (truth, measurements, filters), `analysis` (what needs no
simulation), `errata` (what is printed wrongly, as code), `study` (all runs), `published` (the paper's numbers), `tables`,
`figures`, ``claims*``, `record`.

=============  ======================================================  ===========================================
equation       content                                                 here
=============  ======================================================  ===========================================
11-14, 18      sparse rules, isotropic and anisotropic                 `celnav.gaussian.sparse_grid.smolyak`
15-16          degree of observability, choice of the weights          `celnav.analysis.observability`
20-25          errors of the inertial system                           `celnav.models.inertial.derivative`
26-28          star sensors                                            `celnav.models.inertial.star_residuals`
=============  ======================================================  ===========================================
"""

from celnav.lazy import modules
from celnav.papers.aasghqf.claims import claims
from celnav.papers.aasghqf.config import CITATION, PRESETS, TITLE, Config
from celnav.papers.aasghqf.errata import ERRATA
from celnav.papers.aasghqf.figures import (
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
from celnav.papers.aasghqf.record import RECORDINGS, record
from celnav.papers.aasghqf.scenario import Scenario, filters, simulate
from celnav.papers.aasghqf.study import Result, plan, reproduce
from celnav.papers.aasghqf.tables import table_1, table_2, table_3, table_4
from celnav.papers.aasghqf.trial import JUDGED, trial

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
    "table_4",
    "trial",
]
