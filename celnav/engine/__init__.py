"""Machine code for filters: what a step is recorded as, and who runs it.

`recording` a filter's step on a tape · `runs` all runs through all epochs · `stepper` one step at a
time · `compiled` which engine runs a filter, and machine code that is kept · `sentinels` steps
compared with numpy's · `memory` rows that are used again · `gradient` slopes of the likelihood ·
`export` a filter as C.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
