"""Filters: parts (`predict`, `update`), the driver (`sequential`, `steps`, `run`), and what is built of them.

`step` the one conditioning step · `info` what hooks see and steps record · `driver` epochs, filters, run · `track` records ·
`iterated` updates linearized again · `single_draw` predict and update on one set of points · `colored` colored measurement
noise · `smoother` fixed interval · `adaptive` gates, windows, prescribed gains, fallback · `dropin` filterpy's interface.
"""

from celnav.filters.driver import Epoch, Epochs, Filter, FilterError, State, epochs, run, sequential, steps
from celnav.filters.info import Info, Joint
from celnav.filters.step import predict, update
from celnav.filters.track import Track

__all__ = [
    "Epoch",
    "Epochs",
    "Filter",
    "FilterError",
    "Info",
    "Joint",
    "State",
    "Track",
    "epochs",
    "predict",
    "run",
    "sequential",
    "steps",
    "update",
]
