"""The likelihood is the density of the measurements, and its maximum recovers the true noise."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal

from celnav import Gaussian, Motion, Sensor, epochs, run, ukf
from celnav.analysis.tuning import maximize_likelihood

F = np.array([[1.0, 0.5], [0.0, 0.9]])
H = np.array([[1.0, 0.0]])
G = np.array([[0.125], [0.5]])
P0 = np.diag([1.0, 0.5])
STILL = Motion(np.eye(1), sqrt_Q=np.zeros((1, 0)))


def f(x, epoch):
    return x @ F.T


def simulate(rng, steps, runs, q, r):
    x = rng.normal(size=(runs, 2)) @ np.sqrt(P0)
    z = []
    for k in range(steps):
        if k:
            x = x @ F.T + q * rng.normal(size=(runs, 1)) @ G.T
        z.append(x @ H.T + r * rng.normal(size=(runs, 1)))
    return np.array(z)


def builder(runs, form="square root"):
    def build(parameters):
        q, r = parameters
        filter = ukf(Motion(f, sqrt_Q=q * G), Sensor(H, sqrt_R=[[r]]), form=form)
        return filter, Gaussian(np.zeros((runs, 2)), P0)

    return build


@pytest.mark.parametrize("form", ["square root", "covariance"])
def test_log_likelihood_is_the_joint_density(form):
    """scipy's multivariate normal density of all measurements of a run at once, some missing."""
    steps, q, r = 15, 0.4, 0.7
    z = simulate(np.random.default_rng(1), steps, 3, q, r)
    z[4, 1] = np.nan
    z[9] = np.nan
    P = np.zeros((2 * steps, 2 * steps))
    rows = [np.linalg.matrix_power(F, k) @ np.sqrt(P0) for k in range(steps)]
    effects = [
        [
            np.linalg.matrix_power(F, k - j) @ G * q if 0 < j <= k else np.zeros((2, 1))
            for j in range(steps)
        ]
        for k in range(steps)
    ]
    X = np.hstack([np.vstack(rows), np.block(effects)])
    P = np.kron(np.eye(steps), H) @ X @ X.T @ np.kron(np.eye(steps), H).T + r**2 * np.eye(steps)
    track = run(*builder(3, form)([q, r]), epochs(np.arange(steps), z))
    for i in range(3):
        there = ~np.isnan(z[:, i, 0])
        expected = multivariate_normal(np.zeros(there.sum()), P[np.ix_(there, there)]).logpdf(
            z[there, i, 0]
        )
        assert track.log_likelihood[i] == pytest.approx(expected, abs=1e-9)


def test_recovers_the_noise_that_made_the_data():
    """Within three standard errors of the truth, from a start that is wrong by factors of 5 and 10,
    and not less probable than the truth.
    """
    truth = np.array([0.4, 0.7])
    when = epochs(np.arange(80), simulate(np.random.default_rng(2), 80, 20, *truth))
    tuned = maximize_likelihood(builder(20), [4.0, 0.14], when)
    assert tuned.converged, tuned.message
    assert (np.abs(tuned.parameters - truth) < 3.0 * tuned.standard_errors).all()
    assert (tuned.standard_errors < 0.1 * truth).all()
    assert tuned.log_likelihood >= run(*builder(20)(truth), when).log_likelihood.sum()
    assert tuned.log_likelihood == pytest.approx(
        run(*builder(20)(tuned.parameters), when).log_likelihood.sum(), abs=1e-9
    )


def test_one_parameter_in_closed_form():
    """White noise around 0: the estimate is the root mean square, its standard error sigma / sqrt(2
    N), to second order.
    """
    z = 3.0 * np.random.default_rng(3).normal(size=(150, 1))

    def build(parameters):
        return ukf(STILL, Sensor([[1.0]], sqrt_R=parameters[:, None])), Gaussian([0.0], [[0.0]])

    tuned = maximize_likelihood(build, [0.5], epochs(np.arange(150), z))
    assert tuned.converged
    sigma = np.sqrt(np.mean(z**2))
    assert tuned.parameters[0] == pytest.approx(sigma, rel=1e-5)
    assert tuned.standard_errors[0] == pytest.approx(sigma / np.sqrt(300.0), rel=1e-3)
    assert tuned.covariance[0, 0] == pytest.approx(1.0 / 300.0, rel=1e-3)
    assert tuned.log_likelihood == pytest.approx(
        -75.0 * (1.0 + np.log(2.0 * np.pi * sigma**2)), abs=1e-6
    )


def test_standard_errors_are_the_curvature_of_the_joint():
    """Both parameters' errors and their correlation, from scipy's joint density differentiated by
    the profile.
    """
    runs, steps = 20, 40
    z = simulate(np.random.default_rng(4), steps, runs, 0.4, 0.7)
    when = epochs(np.arange(steps), z)
    tuned = maximize_likelihood(builder(runs), [0.4, 0.7], when)

    def at(logs):
        return run(*builder(runs)(np.exp(logs)), when).log_likelihood.sum()

    best = np.log(tuned.parameters)
    # the profile likelihood falls by 1/2 one standard error away, with the other parameter at its
    # best
    away = best[0] + 0.3 * np.sqrt(tuned.covariance[0, 0])
    profile = minimize_scalar(
        lambda b: -at([away, b]), bracket=(best[1] - 0.05, best[1] + 0.05), tol=1e-6
    )
    assert tuned.log_likelihood + profile.fun == pytest.approx(0.5 * 0.3**2, rel=0.05)


def test_what_the_data_do_not_determine_is_told():
    """A parameter without effect, and a parameter whose optimum is 0, give no finite standard
    error.
    """
    z = simulate(np.random.default_rng(5), 40, 4, 0.4, 0.7)

    def idle(parameters):
        return builder(4)(parameters[:2])

    tuned = maximize_likelihood(idle, [0.4, 0.7, 1.0], epochs(np.arange(40), z))
    assert not tuned.converged
    assert "parameter 2" in tuned.message
    assert np.isinf(tuned.standard_errors).all()

    constant = np.random.default_rng(6).normal(size=(40, 1))

    def walk(parameters):
        q, r = parameters
        return ukf(Motion(np.eye(1), [[q * q]]), Sensor([[1.0]], [[r * r]])), Gaussian(
            [0.0], [[1e-12]]
        )

    alternating = (
        np.abs(constant) * (-1.0) ** np.arange(40)[:, None]
    )  # less scatter than white noise: any random walk is less probable
    tuned = maximize_likelihood(walk, [0.3, 1.0], epochs(np.arange(40), alternating), factor=20.0)
    assert not tuned.converged
    assert "parameter 0" in tuned.message


def test_failing_parameters_are_improbable():
    """A filter that fails below some noise: the search turns back and finds the inner maximum."""
    z = 3.0 * np.random.default_rng(7).normal(size=(80, 1))
    failed = []

    def build(parameters):
        def h(x, epoch):
            if parameters[0] > 20.0:
                failed.append(parameters[0])
                return np.full_like(x, np.inf)
            return x

        return ukf(STILL, Sensor(h, sqrt_R=parameters[:, None])), Gaussian([0.0], [[1e-6]])

    with np.errstate(invalid="ignore"):
        tuned = maximize_likelihood(build, [0.3], epochs(np.arange(80), z))
        with pytest.raises(
            ValueError, match=r"start: expected parameters at which the filter works; step 0"
        ):
            maximize_likelihood(build, [30.0], epochs(np.arange(80), z))
    assert failed
    assert tuned.parameters[0] == pytest.approx(np.sqrt(np.mean(z**2)), rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "options", "match"),
    [
        (([0.0, 1.0],), {}, "start: expected positive"),
        (([[1.0]],), {}, "start: expected positive"),
        (([np.nan, 1.0],), {}, "start: expected finite"),
        (([1.0, 1.0],), {"factor": 1.0}, "factor"),
        (([1.0, 1.0],), {"tolerance": 0.0}, "tolerance"),
        (([1.0, 1.0],), {"max_iterations": 0}, "max_iterations"),
    ],
)
def test_bad_input_is_refused_by_name(arguments, options, match):
    z = np.zeros((3, 2, 1))
    with pytest.raises(ValueError, match=match):
        maximize_likelihood(builder(2), *arguments, epochs(np.arange(3), z), **options)


def test_data_and_builders_that_are_none():
    with pytest.raises(ValueError, match="epochs: expected measurements, got none"):
        maximize_likelihood(builder(2), [1.0, 1.0], epochs(np.arange(3)))
    with pytest.raises(ValueError, match="build: expected a filter and a prior, got Gaussian"):
        maximize_likelihood(
            lambda p: Gaussian([0.0], [[1.0]]), [1.0], epochs(np.arange(3), np.zeros((3, 1)))
        )
    with pytest.raises(ValueError, match="build: expected a filter and a prior, got tuple"):
        maximize_likelihood(
            lambda p: (*builder(2)(p), p), [1.0, 1.0], epochs(np.arange(3), np.zeros((3, 1)))
        )


def test_build_that_raises_is_improbable():
    """A correlation near 1, searched for among all positive numbers: the search turns back where
    the process does not exist.
    """
    when, truth = correlated()
    tried = []

    def build(parameters):
        tried.append(parameters[0])
        return strict(parameters)

    tuned = maximize_likelihood(build, [0.3, 1.0], when)
    assert max(tried) >= 1.0
    assert tuned.failures == sum(phi >= 1.0 for phi in tried)
    assert tuned.converged, tuned.message
    assert (np.abs(tuned.parameters - truth) < 3.0 * tuned.standard_errors).all()
    with pytest.raises(ValueError, match="phi: expected a number below 1") as refused:
        maximize_likelihood(build, [1.5, 1.0], when)
    assert "at the start" in refused.value.__notes__[0]


def correlation(parameters):
    """An AR(1) process of variance q^2 seen through white noise of deviation 0.5; parameters
    ``(..., 2)``: phi, q.
    """
    phi, q = parameters[..., :1], parameters[..., 1:, None]
    assert (phi < 1.0).all()
    motion = Motion(lambda x, _: phi * x, sqrt_Q=q * np.sqrt(1.0 - phi**2)[..., None])
    return ukf(motion, Sensor([[1.0]], sqrt_R=[[0.5]])), Gaussian([0.0], [[1.0]])


def strict(parameters):
    if (parameters[..., 0] >= 1.0).any():
        raise ValueError(f"phi: expected a number below 1, got {parameters[..., 0].max()}")
    return correlation(parameters)


def correlated(steps=100):
    rng = np.random.default_rng(8)
    phi, q = truth = np.array([0.95, 0.8])
    x, z = rng.normal(), []
    for _ in range(steps):
        z.append([x + 0.5 * rng.normal()])
        x = phi * x + q * np.sqrt(1.0 - phi**2) * rng.normal()
    return epochs(np.arange(steps), np.array(z)), truth


@pytest.fixture(scope="module")
def free():
    return maximize_likelihood(strict, [0.9, 0.9], correlated()[0])


@pytest.mark.parametrize(
    "domain", [["unit interval", "positive"], [(-1.0, 1.0), (0.0, 10.0)], (0.0, 1.0)]
)
def test_parameters_stay_in_their_domain(domain, free):
    when, truth = correlated()
    tuned = maximize_likelihood(
        correlation, [0.3, 0.9], when, domain=domain
    )  # this raises an error unless phi is below 1
    assert tuned.converged, tuned.message
    assert tuned.failures == 0
    assert (np.abs(tuned.parameters - truth) < 3.0 * tuned.standard_errors).all()
    np.testing.assert_allclose(tuned.parameters, free.parameters, rtol=2e-3)
    np.testing.assert_allclose(tuned.standard_errors, free.standard_errors, rtol=2e-2)
    assert tuned.log_likelihood == pytest.approx(free.log_likelihood, abs=1e-4)


def test_a_maximum_at_the_edge_of_what_can_be_built_is_told():
    """White noise with standard deviation 3, and a filter that rejects values above 2."""

    def build(parameters):
        if parameters[0] > 2.0:
            raise ZeroDivisionError("no such filter")
        return ukf(STILL, Sensor([[1.0]], sqrt_R=parameters[:, None])), Gaussian([0.0], [[0.0]])

    z = 3.0 * np.random.default_rng(9).normal(size=(50, 1))
    tuned = maximize_likelihood(build, [0.5], epochs(np.arange(50), z))
    assert not tuned.converged
    assert tuned.parameters[0] == pytest.approx(2.0, rel=0.02)
    assert "edge" in tuned.message
    assert np.isinf(tuned.standard_errors).all()


@pytest.mark.parametrize(
    ("start", "domain", "match"),
    [
        ([0.5, 2.0], "unit interval", "start: expected parameter 1 between 0 and 1, got 2"),
        (
            [0.5, 1.0],
            ["unit interval", (2.0, 3.0)],
            "start: expected parameter 1 between 2 and 3, got 1",
        ),
        ([0.5, 1.0], "large", "domain: expected 'positive', 'unit interval' or .*'large'"),
        ([0.5, 1.0], ["positive"], "domain: expected one domain, or 2, one for each"),
        ([0.5, 1.0], (1.0, 0.0), "domain: expected"),
        ([0.5, 1.0], [(0.0, np.nan), "positive"], "domain: expected"),
    ],
)
def test_bad_domains_are_refused_by_name(start, domain, match):
    with pytest.raises(ValueError, match=match):
        maximize_likelihood(
            builder(2), start, epochs(np.arange(3), np.zeros((3, 2, 1))), domain=domain
        )
