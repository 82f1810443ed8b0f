"""Filters: what is believed (`Motion`, `Sensor`), what is made of it, and the driver.

`records` what filters are made of and pass on · `joint` the one joint and the one conditioning ·
`regression` linear over a belief · `sequential` predict and update, one sensor after the other ·
`colored` colored measurement noise · `two_stage` a bias beside the state · `imm` models that take
turns · `adaptive` hooks · `run`, `track` the driver and its record · `smoother` fixed interval ·
`fixed_lag` late samples · `dropin` filterpy's interface.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
