"""celnav: navigation filters, batched and in square-root form, and the papers they come from.

Contents
--------
Models    `Motion`, `Sensor`, `Linear`, `Gaussian`; for states or measurements that are not vectors
          `angles`, `attitude`, `product`.
Filters   `ukf`, `ekf`, `ckf`, `ghkf`, `sparse_grid_filter`, `sigma_point`; `colored`, `augmented`,
          `decorrelated` for colored noise; `two_stage` for a bias; `imm` for several models
          between which the system switches. ``celnav.filters.adaptive`` has hooks.
Rules     `unscented`, `cubature`, `gauss_hermite`, `simplex`, `smolyak`, `from_filterpy`; a `Rule`
          has points and weights, `Taylor` linearizes.
Run       `run` returns a `Track`; `steps` and `epochs` give single steps; `merge` puts an inertial
          unit and other sensors on common epochs; `FilterError` reports a failed run; `compiled`
          and `export_c` make machine code and C from a filter.
Smooth    `smooth`, `iterated_smoother`.
Evaluate  `simulate` draws truth and measurements, `Track.report` compares with the truth, `compare`
          runs filters on a `Problem`; ``celnav.analysis`` has metrics, tuning, bounds,
          observability and ``diagnose.diagnose``, which tests a log for consistency.

Conventions
-----------
Belief    `Motion` models the dynamics, `Sensor` a measurement, `Gaussian` the state at the start.
          A filter (`ukf`, `ekf`, ...) is data that refers to these models.
Arrays    The last axis is the component, ``(..., n)``; a matrix is ``(..., n, n)``; all axes
          before are batch axes, such as the runs of a Monte Carlo simulation. Sigma points come
          first, ``(p, ..., n)``, so inputs of each run broadcast in a model. Time comes first in a
          result: a `Track` is ``(T, ..., n)``. Floats are float64.
Roots     Lower triangular, diagonal >= 0, ``P = L @ L.T``. Noise may be given as a covariance
          (``Q``) or as columns (``sqrt_Q``).
Errors    Estimate minus truth. The innovation is measurement minus prediction.
Missing   nan. A missing component is left out exactly, in each run separately.
Failure   `run` raises `FilterError` for the first run that loses positive definiteness. With
          ``on_failure="flag"`` this run becomes nan instead, and the other runs continue;
          ``Track.failed_at`` is the epoch. Bad arguments raise ValueError, which names the
          argument, what was expected and what came.
Units     SI and radians, except orbits: km and km/s. Other units are in the name: ``sigma_km``.
Frames    Earth-centered inertial, equatorial (J2000), for orbits; east, north, up and right, front,
          up for aircraft; north, east, down and forward, right, down for inertial units.
Angles    Declare an angle that wraps once: ``Motion(..., space=angles([2]))`` for a component of
          the state, ``Sensor(..., space=angles([0]))`` for a component of the measurement.
Attitude  Unit quaternions, scalar last, which transform inertial components to body components;
          the product of quaternions corresponds to the product of these matrices. Errors are in
          body axes. The sign of a quaternion has no meaning: ``Motion(..., space=attitude())``.
Time      s since the start of a study.
Chance    One generator for each run: ``(seed, study, run)`` determines its numbers, independent of
          blocks and processes.
Sources   ``[Sun2015, Eq. 27]`` in a docstring; citations are in ``celnav.papers.<id>.CITATION``.
"""

from typing import TYPE_CHECKING

from celnav.filters.colored import augmented, colored, decorrelated
from celnav.filters.imm import imm
from celnav.filters.iterated_smoother import iterated_smoother
from celnav.filters.merge import merge
from celnav.filters.model import Linear, Motion, Sensor
from celnav.filters.records import Epoch as Epoch
from celnav.filters.records import Filter, FilterError, epochs
from celnav.filters.run import run, steps
from celnav.filters.sequential import ckf, ekf, ghkf, sigma_point, sparse_grid_filter, ukf
from celnav.filters.smoother import smooth
from celnav.filters.track import Track
from celnav.filters.two_stage import two_stage
from celnav.gaussian.attitude import attitude
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.rules import (
    Rule,
    Taylor,
    cubature,
    from_filterpy,
    gauss_hermite,
    simplex,
    unscented,
)
from celnav.gaussian.spaces import EUCLIDEAN, angles, product
from celnav.gaussian.sparse_grid import smolyak
from celnav.lazy import modules
from celnav.study.problem import Problem, compare
from celnav.study.simulate import simulate
from celnav.study.trial import Group as Group

if TYPE_CHECKING:
    from celnav.engine.compiled import compiled
    from celnav.engine.export import export_c

__version__ = "0.2.0"

_LATE = {"compiled": "celnav.engine.compiled", "export_c": "celnav.engine.export"}
__getattr__, __dir__ = modules(__name__, **_LATE)

# `Epoch` and `Group` are public names too, but as tuples they would fill the help with methods of
# tuples.
__all__ = [
    "EUCLIDEAN",
    "Filter",
    "FilterError",
    "Gaussian",
    "Linear",
    "Motion",
    "Problem",
    "Rule",
    "Sensor",
    "Taylor",
    "Track",
    "angles",
    "attitude",
    "augmented",
    "ckf",
    "colored",
    "compare",
    "compiled",
    "cubature",
    "decorrelated",
    "ekf",
    "epochs",
    "export_c",
    "from_filterpy",
    "gauss_hermite",
    "ghkf",
    "imm",
    "iterated_smoother",
    "merge",
    "product",
    "run",
    "sigma_point",
    "simplex",
    "simulate",
    "smolyak",
    "smooth",
    "sparse_grid_filter",
    "steps",
    "two_stage",
    "ukf",
    "unscented",
]
