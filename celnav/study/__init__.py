"""Studies: runs that are simulated, filtered and judged.

``import celnav`` is enough to write a study. This package also has the names of its modules
`study`, `ledger`, `parameters` and `trial`, such as ``celnav.study.Study``. `celnav.study.numbers`
has the numbers that decide statements.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "study", "ledger", "parameters", "trial")
