"""GRACE-A, 1 to 3 August 2008: a satellite's GPS fixes, whose errors are correlated from one to the
next.

`positions`: the files. `settings`: what filters believe, and how that was found. `study`: what is
flown and what we find. `show`: figures, a table, a recording. Their names are found here as well:
``celnav.real.grace.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "study", "show", "settings")
