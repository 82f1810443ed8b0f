"""Filters: parts (`predict`, `update`), the driver (`sequential`, `steps`, `run`), and what is built of them.

`step` predict and update · `conditioning` the one step below them · `arguments` what they check · `info` what hooks see and steps
record · `driver` epochs, filters, run · `track` records · `iterated` updates linearized again · `single_draw` predict and update
on one set of points · `colored`, `decorrelated`, `coloring` colored measurement noise · `smoother` fixed interval · `adaptive`
gates, windows, prescribed gains, fallback · `robust` reweighting · `parity` what no state explains · `least_squares` no prior ·
`two_stage` a bias beside the state, and `strong_tracking`, `differenced` for it · `dropin` filterpy's interface,
`filterpy_models` its functions of one vector, `single_run` the step of one vector · `mixing` models that mix runs.
"""

from celnav.filters.driver import Epoch, Epochs, Filter, FilterError, State, epochs, run, sequential, steps
from celnav.filters.info import Info, Joint
from celnav.filters.smoother import smooth
from celnav.filters.step import Motion, predict, update
from celnav.filters.track import Track
from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "Epoch",
    "Epochs",
    "Filter",
    "FilterError",
    "Info",
    "Joint",
    "Motion",
    "State",
    "Track",
    "epochs",
    "predict",
    "run",
    "sequential",
    "smooth",
    "steps",
    "update",
]
