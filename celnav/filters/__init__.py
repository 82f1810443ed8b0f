"""Filters: parts (`predict`, `update`), the driver (`sequential`, `steps`, `run`), and what is built of them.

`step` the one conditioning step · `driver` epochs, filters, run · `track` records · `colored` colored measurement noise ·
`smoother` fixed interval · `adaptive` gates, windows, prescribed gains, fallback · `dropin` filterpy's interface.
"""

from celnav.filters.driver import Epoch, Epochs, Filter, FilterError, State, epochs, run, sequential, steps
from celnav.filters.step import Info, Joint, predict, update
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
