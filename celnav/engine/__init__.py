"""Machine code for filters: recording, compiling and running a filter's steps.

`recording`: a filter's step on a tape. `runs`: all runs through all epochs. `stepper`: one step at
a time. `compiled`: the choice of the engine, and stored machine code. `sentinels`: steps compared
with numpy's. `memory`: reused memory. `gradient`: the gradient of the likelihood. `export`: a
filter as C.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
