"""celnav: navigation filters, batched and in square-root form, and the papers they come from.

Conventions, stated once
------------------------
Arrays    The last axis is the component, ``(..., n)``; a matrix is ``(..., n, n)``; everything before is batch: runs of a Monte
          Carlo, or nothing. Sigma points lead, ``(p, ..., n)``, so inputs of each run broadcast by themselves in a model. Time
          leads in a record: a `Track` is ``(T, ..., n)``. Floats are float64. So a component is ``x[..., 0]`` and a matrix acts by
          ``x @ F.T``; ``F @ x`` would mix runs, and is told.
Roots     Lower triangular, diagonal >= 0, ``P = L @ L.T``. Noise may be given as a covariance (``Q``) or as columns (``sqrt_Q``).
Errors    Estimate minus truth. The innovation is measurement minus prediction.
Missing   nan. A missing component costs nothing but itself, in each run by itself.
Failure   `run` raises `FilterError` for the first run that loses definiteness. With ``on_failure="flag"`` it becomes nan instead,
          while its neighbors go on; ``Track.failed_at`` says when. Bad arguments raise ValueError naming the argument, what was
          expected and what came.
Units     SI and radians, except orbits: km and km/s. A name says its unit where it is another: ``sigma_km``.
Frames    Earth-centered inertial, equatorial (J2000), for orbits; east, north, up and right, front, up for aircraft.
Angles    One that wraps must be told: ``space=angles([2])`` of `predict` and `update` if it is a component of the state,
          ``measurement_space=angles([0])`` of `update` if it is one of the measurement. Nothing can notice one forgotten in both.
Attitude  Unit quaternions, scalar last; they take inertial components to body components, and the product composes such
          matrices. Errors are in body axes. The sign of a quaternion never matters (`celnav.gaussian.attitude`).
Time      s since the start of a study.
Chance    One generator for each run: ``(seed, study, run)`` determines its numbers, whatever the block or the process.
Sources   ``[Sun2015, Eq. 27]`` in a docstring; citations are in ``celnav.papers.<id>.CITATION``.
"""

from celnav.filters import Epoch, Filter, FilterError, Track, epochs, predict, run, sequential, smooth, steps, update
from celnav.gaussian.belief import Gaussian, covariance, square_root
from celnav.gaussian.points import cubature, from_filterpy, gauss_hermite, simplex, unscented
from celnav.gaussian.rule import Rule
from celnav.gaussian.spaces import angles
from celnav.gaussian.sparse_grid import smolyak
from celnav.gaussian.taylor import Taylor
from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)

__version__ = "0.1.0"

__all__ = [
    "Epoch",
    "Filter",
    "FilterError",
    "Gaussian",
    "Rule",
    "Taylor",
    "Track",
    "angles",
    "covariance",
    "cubature",
    "epochs",
    "from_filterpy",
    "gauss_hermite",
    "predict",
    "run",
    "sequential",
    "simplex",
    "smolyak",
    "smooth",
    "square_root",
    "steps",
    "unscented",
    "update",
]
