"""Arguments that filterpy's class accepts are accepted by celnav's classes,
with the same results.
"""

from __future__ import annotations

import warnings
from datetime import timedelta

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from celnav.filters.dropin import SigmaPointUKF, SquareRootUKF

OURS = [SquareRootUKF, SigmaPointUKF]


def assigned(**values):
    def change(kf):
        for name, value in values.items():
            setattr(kf, name, value)

    return change


def heavier(kf):
    other = MerweScaledSigmaPoints(2, 0.8, 1.0, 0.5)
    kf.points_fn, kf.Wm, kf.Wc = other, other.Wm, other.Wc


ACCEPTED = {
    "Q one number": assigned(Q=0.01),
    "Q a number of numpy": assigned(Q=np.float32(0.25)),
    "Q 0": assigned(Q=0),
    "Q None": assigned(Q=None),
    "Q a list": assigned(Q=[[0.1, 0.0], [0.0, 0.2]]),
    "Q integers": assigned(Q=np.eye(2, dtype=int)),
    "Q read-only, not contiguous": assigned(Q=np.broadcast_to(np.ones(1), (2, 2))),
    "Q a matrix of one": assigned(Q=[[0.3]]),
    "R one number": assigned(R=0.3),
    "R a list": assigned(R=[0.3]),
    "R None": assigned(R=None),
    "P one number": assigned(P=3.0),
    "P a list": assigned(P=[[2.0, 0.1], [0.1, 1]]),
    "P Fortran's": assigned(P=np.asfortranarray([[2.0, 0.1], [0.1, 1]])),
    "x a list": assigned(x=[1, 2]),
    "x a tuple": assigned(x=(1.0, 2.0)),
    "x integers": assigned(x=np.array([1, 2])),
    "an interval without number": assigned(
        _dt=timedelta(seconds=2), fx=lambda x, dt: x + dt.total_seconds() * np.array([x[1], 0.0])
    ),
    "no interval": assigned(_dt=None, fx=lambda x, dt: x),
    "another motion": assigned(fx=lambda x, dt: [x[0] + dt * x[1], 0.9 * x[1]]),
    "a motion that changes its argument": assigned(fx=lambda x, dt: np.add(x, [0.1, 0.2], out=x)),
    "another measurement": assigned(hx=lambda x: [x[0] ** 2]),
    "another sensor": assigned(hx=lambda x: x, R=np.eye(2), test_z=[0.5, 0.2]),
    "a list measured": assigned(test_z=[0.5]),
    "a tuple measured": assigned(test_z=(0.5,)),
    "an integer measured": assigned(test_z=1),
    "a number of numpy measured": assigned(test_z=np.float32(0.5)),
    "other points": heavier,
    "other weights": lambda kf: setattr(kf, "Wc", kf.Wm),
    "own sums and means": assigned(
        state_add=lambda x, y: x + y,
        x_mean=lambda s, w: w @ s,
        z_mean=lambda s, w: w @ s,
        residual_x=lambda a, b: a - b,
    ),
    "a sum in place": assigned(state_add=lambda x, y: np.add(x, y, out=x)),
    "another inverse": assigned(inv=np.linalg.inv),
}


def pair(cls, points=None):
    kf = cls(
        2,
        1,
        0.5,
        lambda x: x[:1],
        lambda x, dt: np.array([x[0] + dt * x[1], x[1]]),
        points or MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0),
    )
    kf.Q = 0.1 * np.eye(2)
    return kf


@pytest.mark.parametrize("cls", OURS)
@pytest.mark.parametrize("name", ACCEPTED)
def test_what_filterpy_accepts_gives_what_it_gives(cls, name):
    points, both = MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0), []
    for kind in (UnscentedKalmanFilter, cls):
        kf = pair(kind, points)
        ACCEPTED[name](kf)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            kf.predict()
            kf.update(getattr(kf, "test_z", 0.7))
            if kf.R is not None:  # filterpy's points need a regular covariance
                kf.predict()
        both.append(kf)
    names = "x P Q R x_prior P_prior x_post P_post S SI K y log_likelihood likelihood mahalanobis sigmas_f sigmas_h Wm Wc"
    for attribute in names.split():
        if both[0].__dict__.get(attribute, 0) is not None:
            theirs, own = getattr(both[0], attribute), getattr(both[1], attribute)
            np.testing.assert_allclose(own, theirs, rtol=1e-9, atol=1e-11, err_msg=attribute)


@pytest.mark.parametrize("cls", OURS)
def test_arguments_of_a_step_that_filterpy_accepts(cls):
    points, both = MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0), []
    for kind in (UnscentedKalmanFilter, cls):
        kf = pair(kind, points)
        kf.predict(dt=-0.5)  # back in time
        kf.update([0.3], R=2)
        kf.predict(dt=np.float32(0.25), fx=lambda x, dt, turn: x * turn + dt, turn=0.9)
        kf.update(0.4, R=np.array([[0.2]]), hx=lambda x, bias: [x[0] + bias], bias=0.1)
        kf.predict()
        kf.update(np.array([0.1, 0.2]), R=np.diag([1.0, 2.0]), hx=lambda x: x)
        kf.predict()
        kf.update(np.array([0.1]), R=[[0.3]])
        both.append(kf)
    for attribute in ("x", "P", "S", "SI", "K", "y", "sigmas_f", "sigmas_h", "log_likelihood"):
        np.testing.assert_allclose(
            getattr(both[1], attribute),
            getattr(both[0], attribute),
            rtol=1e-9,
            atol=1e-11,
            err_msg=attribute,
        )


@pytest.mark.parametrize("cls", OURS)
def test_a_number_for_a_matrix_is_told_once(cls):
    """filterpy adds the number to every element; the warning says how to write a variance for each
    component.
    """
    kf = cls(2, 2, 0.5, lambda x: x, lambda x, dt: x, MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0))
    kf.Q = 0.01
    with pytest.warns(
        UserWarning,
        match=r"^Q: the number 0.01 counts in every element, as in filterpy; 0.01 \* np.eye\(2\) is",
    ):
        kf.predict()
    kf.predict()
    kf.R = 0.25
    with pytest.warns(UserWarning, match="^R: the number 0.25 counts in every element"):
        kf.update([0.1, 0.2])
    one = pair(cls)
    one.R = 0.25  # no warning for one component
    one.predict()
    one.update(0.1)
