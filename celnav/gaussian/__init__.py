"""Gaussians: beliefs about a state, and what a function makes of their mean and covariance.

`linalg` small matrices and the two forms of a covariance · `spaces`, `attitude` the differences
of states · `belief` checked Gaussians · `rules`, `sparse_grid` the mean and covariance of a
function of a Gaussian · `checks` the checks of arguments.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
