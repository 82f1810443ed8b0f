"""Filters: models (`Motion`, `Sensor`), the filters made of them, and the driver.

`records`: the data that a filter receives and returns. `model`: motion and sensor models. `joint`:
the joint of measurement and state, and its conditioning. `regression`: statistical linear
regression. `sequential`: predict and update, one sensor after the other. `colored`: colored
measurement noise. `two_stage`: a bias estimated in a second stage. `imm`: interacting multiple
models. `switching`: several filters, one of which makes each step. `adaptive`: hooks. `run`,
`track`: the driver and its result. `smoother`, `iterated_smoother`: fixed-interval smoothing.
`fixed_lag`: late samples. `merge`: sensors with different clocks. `dropin`: filterpy's interface.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
