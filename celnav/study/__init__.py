"""Studies: runs that are simulated, filtered and judged.

``import celnav`` is enough to write one: the names of `study`, `ledger`, `parameters` and `trial`
are those of this package too, such as ``celnav.study.Study``. What decides a statement is in
`celnav.study.numbers`.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "study", "ledger", "parameters", "trial")
