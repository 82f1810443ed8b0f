"""The short way of one vector is the step of `predict` and `update`."""

import numpy as np
import pytest

import celnav
from celnav.filters.single_run import measurement_update, time_update

RULES = {
    "unscented": celnav.unscented(3),
    "a negative weight": celnav.unscented(3, alpha=0.1, beta=2.0),
    "cubature": celnav.cubature(3),
    "cubature 5": celnav.cubature(3, degree=5),
    "simplex": celnav.simplex(3),
    "Gauss-Hermite": celnav.gauss_hermite(3, 4),
    "sparse grid": celnav.smolyak(3, 3),
}


def f(x, epoch):
    return np.stack([x[..., 0] + 0.1 * x[..., 1] ** 2, 0.9 * x[..., 1], np.sin(x[..., 2])], -1)


def h(x, epoch):
    return np.stack([np.hypot(x[..., 0] + 3.0, x[..., 1]), x[..., 2] ** 2], -1)


@pytest.mark.parametrize("form", [celnav.square_root, celnav.covariance])
@pytest.mark.parametrize("name", RULES)
def test_both_updates_are_those_of_the_parts(form, name):
    rule, rng = RULES[name], np.random.default_rng(4)
    A = 0.3 * rng.normal(size=(3, 3))
    belief = form(rng.normal(size=3), A @ A.T)
    sqrt_Q, sqrt_R, z = 0.1 * rng.normal(size=(3, 2)), 0.2 * np.eye(2) + 0.1 * np.eye(2, k=-1), np.array([3.0, 0.2])
    predicted, _ = celnav.predict(f, rule, sqrt_Q=sqrt_Q)(belief)
    own = time_update(belief, f, rule, sqrt_Q)
    posterior, info, _ = celnav.update(h, rule, sqrt_R=sqrt_R)(predicted, z)
    found = measurement_update(own, z, h, rule, sqrt_R)
    for mine, theirs in (
        (own.mean, predicted.mean), (own.spread, predicted.spread),
        (found.belief.mean, posterior.mean), (found.belief.spread, posterior.spread),
        (found.innovation, info.innovation), (found.white, info.white), (found.S, info.innovation_root),
        (np.linalg.solve(found.S.T, found.U.T).T, info.gain()),
        (found.images, h(rule.points(own.mean, own.root, celnav.gaussian.spaces.EUCLIDEAN)[0], None)),
    ):  # fmt: skip
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-11)


def test_what_has_no_covariance_is_nan():
    """As everywhere: who calls it looks."""
    rule, belief = celnav.unscented(2, kappa=-1.0), celnav.square_root([0.0, 0.0], np.eye(2))  # |x| has variances 0, covariance -1
    after = time_update(belief, lambda x, _: np.abs(x), rule, 1e-9 * np.eye(2))
    assert np.isnan(after.spread).all()
    _, info = celnav.predict(lambda x, _: np.abs(x), rule, sqrt_Q=1e-9 * np.eye(2))(belief)
    assert "positive definite" in info.failure
