"""Gaussian beliefs about a state, and their propagation through a function.

`linalg`: small matrices, and beliefs in square-root and covariance form · `spaces`, `attitude`,
`extended_pose`: differences of states · `belief`: checked Gaussians · `rules`, `sparse_grid`: mean
and covariance of a function of a Gaussian · `checks`: checks of arguments.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
