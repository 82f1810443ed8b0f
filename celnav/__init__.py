"""celnav: navigation filters, batched and in square-root form, and the papers they come from.

What there is
-------------
Believe   `Motion`, `Sensor`, `Linear`, `Gaussian`; where a difference is no subtraction `angles`,
          `attitude`, `product`.
Filters   `ukf`, `ekf`, `ckf`, `ghkf`, `sparse_grid_filter`, `sigma_point`; `colored`, `augmented`,
          `decorrelated` for noise that is not white; `two_stage` for a bias; `imm` for models that
          take turns. ``celnav.filters.adaptive`` has hooks.
Rules     `unscented`, `cubature`, `gauss_hermite`, `simplex`, `smolyak`, `from_filterpy`; `Rule` is
          data, `Taylor` expands.
Run       `run` gives a `Track`, `steps` and `epochs` go one by one, `merge` makes one clock of an
          inertial unit's and of others; a lost run is a `FilterError`; `compiled` and `export_c`
          make code of a filter.
Smooth    `smooth`, `iterated_smoother`.
Judge     `simulate` draws truth and measurements, `Track.report` compares with the truth, `compare`
          flies filters on a `Problem`; ``celnav.analysis`` has metrics, tuning, bounds,
          observability and ``diagnose.diagnose``, which asks a log.

Conventions, stated once
------------------------
Belief    `Motion` models the dynamics, `Sensor` a measurement, `Gaussian` the state at the start.
          A filter (`ukf`, `ekf`, ...) is data made of them.
Arrays    The last axis is the component, ``(..., n)``; a matrix is ``(..., n, n)``; everything
          before is batch: runs of a Monte Carlo, or nothing. Sigma points lead, ``(p, ..., n)``, so
          inputs of each run broadcast by themselves in a model. Time leads in a record: a `Track`
          is ``(T, ..., n)``. Floats are float64.
Roots     Lower triangular, diagonal >= 0, ``P = L @ L.T``. Noise may be given as a covariance
          (``Q``) or as columns (``sqrt_Q``).
Errors    Estimate minus truth. The innovation is measurement minus prediction.
Missing   nan. A missing component costs nothing but itself, in each run by itself.
Failure   `run` raises `FilterError` for the first run that loses definiteness. With
          ``on_failure="flag"`` it becomes nan instead, while its neighbors go on;
          ``Track.failed_at`` says when. Bad arguments raise ValueError naming the argument, what
          was expected and what came.
Units     SI and radians, except orbits: km and km/s. A name says its unit where it is another:
          ``sigma_km``.
Frames    Earth-centered inertial, equatorial (J2000), for orbits; east, north, up and right, front,
          up for aircraft; north, east, down and forward, right, down for inertial units.
Angles    One that wraps must be told, once: ``Motion(..., space=angles([2]))`` if it is a component
          of the state, ``Sensor(..., space=angles([0]))`` if it is one of the measurement.
Attitude  Unit quaternions, scalar last; they take inertial components to body components, and the
          product composes such matrices. Errors are in body axes. The sign of a quaternion never
          matters: ``Motion(..., space=attitude())``.
Time      s since the start of a study.
Chance    One generator for each run: ``(seed, study, run)`` determines its numbers, whatever the
          block or the process.
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

# `Epoch` and `Group` are names of celnav as well; as tuples they would fill its help with methods
# of tuples.
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
