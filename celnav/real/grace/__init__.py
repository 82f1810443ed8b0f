"""GRACE-A, 1 to 3 August 2008: GPS fixes of a satellite with correlated errors.

`positions`: the files. `settings`: models of the filters, and the search for their settings.
`study`: runs and findings. `show`: figures, a table, a recording. Their names can be imported from
here, such as ``celnav.real.grace.STUDY``.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "study", "show", "settings")
