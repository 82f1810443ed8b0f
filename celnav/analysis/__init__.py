"""Analysis of filters and of their results.

`bounds`: covariances without simulation · `observability` · `metrics`: accuracy and consistency ·
`diagnose`: tests of innovations · `tuning`: noise parameters by maximum likelihood.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
