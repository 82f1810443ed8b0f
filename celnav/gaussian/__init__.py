"""Gaussians: what is known, and what a function makes of it.

`linalg` small matrices and the two forms of a covariance · `spaces`, `attitude` what a difference
is · `belief` what is known · `rules`, `sparse_grid` what a function of a Gaussian has for mean and
covariance · `checks` what comes from outside.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
