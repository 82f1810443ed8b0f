"""Filters: models (`Motion`, `Sensor`), the filters made of them, and the driver.

`records` the data that a filter receives and returns · `joint` the joint and its conditioning ·
`regression` linear over a belief · `sequential` predict and update, one sensor after the other ·
`colored` colored measurement noise · `two_stage` a bias beside the state · `imm` models that
alternate · `switching` filters of which one makes each step · `adaptive` hooks · `run`, `track` the
driver and its record · `smoother` fixed interval · `fixed_lag` late samples · `dropin` filterpy's
interface.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
