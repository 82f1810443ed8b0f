"""[Deng2013]: a spacecraft on its way from Earth to Mars times four millisecond pulsars every week.

We have the paper's abstract only. What it does not say is a reading of ours, and `scenario` names
its source. `scenario`: parameters, spin noise of the pulsars, truth and measurements, filters.
`ledger.toml`: the abstract's statements and our findings. `study`: the runs, and the numbers that
decide each row. `show`: figures, a table, a recording. The names of all modules are also available
here: ``celnav.papers.mars.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "scenario", "study", "show")
