"""Studies: simulated or recorded runs, filters for them, and evaluated results.

``import celnav`` is enough to write a study. This package also exports the names of its modules
`study`, `ledger`, `parameters` and `trial`, such as ``celnav.study.Study``. `celnav.study.numbers`
has the numbers that decide statements.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "study", "ledger", "parameters", "trial")
