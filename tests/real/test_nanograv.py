"""Arrival times of pulsars: timing models, fixes and filters, on simulated arrivals with known
truth and on real arrivals.
"""

from __future__ import annotations

import contextlib
import hashlib
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from celnav.files import InputError, data, read_npz
from celnav.models.ephemeris import GM, Tdb, de421
from celnav.models.pulsar import LIGHT_KM_S
from celnav.real import arrivals, nanograv
from celnav.show.drawing import render

REAL = Path(__file__).parents[3] / "shared" / "data" / "nanograv15"
AU_KM = 1.495978707e8


def directions(count, rng):
    n = rng.standard_normal((count, 3))
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def made(
    folder, count=12, noise_km=0.3, seed=0, every=9.0, end=nanograv.END, moved=None, model_km=5.0
):
    """Simulated arrivals from some pulsars from 2011 on, half of them solitary, each with a timing
    model wrong by some km, white noise, and an Earth displaced by ``moved(day)`` km.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for i, n in enumerate(directions(count, rng)):
        day = np.arange(55700.0 + rng.uniform(0.0, 9.0), end - 2.0, every).round()
        earth = (
            de421().state("earth", Tdb(np.full_like(day, 2400000.5), day + 0.5)).position / AU_KM
        )
        a = arrivals.Arrivals("", n, day, day, day, earth)
        late = arrivals.model(a) @ (
            model_km * rng.standard_normal(8)
        ) + noise_km * rng.standard_normal(len(day))
        late -= 0.0 if moved is None else moved(day) @ n
        sigma = np.full_like(day, noise_km)
        rows.append(
            np.column_stack(
                [
                    day,
                    np.full_like(day, i),
                    late / LIGHT_KM_S,
                    sigma / LIGHT_KM_S,
                    np.tile(n, (len(day), 1)),
                    earth * arrivals.AU_S,
                    np.full_like(day, 30.0),
                ]
            )
        )
    folder.mkdir(exist_ok=True)
    np.savez(
        folder / "daily_averages.npz",
        names=np.array([nanograv.SOLITARY[i] if i % 2 else f"P{i}" for i in range(count)]),
        epochs=np.concatenate(rows),
    )
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return made(tmp_path_factory.mktemp("arrivals") / "made")


# -- timing models ---------------------------------------------------------------------------------
def test_a_timing_model_is_what_a_pulsar_elsewhere_shows(folder):
    """The columns for position and parallax are derivatives of the delay of a pulsar at a finite
    distance; the columns for proper motion are the position columns times the years.
    """
    a = arrivals.read(folder)[3]
    M, earth, far = arrivals.model(a), a.earth, 3e4

    def delay(place):
        return np.linalg.norm(place, axis=-1) - np.linalg.norm(place - earth, axis=-1)

    east = np.cross([0.0, 0.0, 1.0], a.n)
    east /= np.linalg.norm(east)
    for column, side in ((3, east), (4, np.cross(a.n, east))):
        step = 1e-3
        slope = (delay(far * (a.n + step * side)) - delay(far * (a.n - step * side))) / (2.0 * step)
        np.testing.assert_allclose(M[:, column], slope, atol=1e-4)
    np.testing.assert_allclose(M[:, 7], 2.0 * far * (delay(far * a.n) - earth @ a.n), atol=1e-3)
    np.testing.assert_allclose(M[:, 5] * 10.0, M[:, 3] * (a.day - a.day[0]) / 365.25)


def test_a_spin_that_walks_has_the_covariance_of_one_that_was_walked(folder):
    a = arrivals.read(folder)[0]
    few = a._replace(day=a.day[::60])
    rng, fine = np.random.default_rng(1), np.arange(0.0, few.day[-1] - few.day[0] + 1.0)
    spin = np.cumsum(rng.standard_normal((4000, len(fine))), 1) / np.sqrt(365.25)
    phase = np.cumsum(spin, 1)[:, (few.day - few.day[0]).astype(int)] / 365.25
    K = arrivals.walk(few)
    np.testing.assert_allclose(np.cov(phase.T)[1:, 1:], K[1:, 1:], atol=0.06 * K.max())


def test_predictions_are_those_of_the_joint_law_of_past_future_and_parameters(folder):
    """An independent formula: a very wide prior of the parameters, and a single conditioning on all
    arrivals.
    """
    c = arrivals.clocks(folder, 57023.0, 57754.0)[2]
    a, (white, red) = c.arrivals, c.noise
    M = arrivals.model(a)
    cov = np.diag(a.sigma**2 + white**2) + red**2 * arrivals.walk(a) + 1e8 * M @ M.T
    past, ahead = cov[np.ix_(c.before, c.before)], cov[np.ix_(c.after, c.before)]
    predicted = ahead @ np.linalg.solve(past, a.late[c.before])
    np.testing.assert_allclose(c.early, predicted - a.late[c.after], atol=1e-4)
    left = cov[np.ix_(c.after, c.after)] - ahead @ np.linalg.solve(past, ahead.T)
    np.testing.assert_allclose(c.cov, left, atol=2e-4)


def test_noise_is_found_as_large_as_it_was_made(folder):
    rng = np.random.default_rng(2)
    a = arrivals.read(folder)[1]
    M, K = arrivals.model(a), arrivals.walk(a)
    found, runs = [], 8
    for _ in range(runs):
        red = np.linalg.cholesky(K[1:, 1:]) @ rng.standard_normal(len(K) - 1)
        late = (
            M @ rng.standard_normal(8)
            + 0.5 * rng.standard_normal(len(K))
            + 2.0 * np.append(0.0, red)
        )
        found.append(arrivals.sized(late, np.full(len(K), 0.3), M, K))
    # Fisher's information of the restricted likelihood, 0.5 tr(P V_i P V_j): P projects out the
    # columns of the model.
    V_inv = np.linalg.inv(0.25 * np.eye(len(K)) + 4.0 * K)
    P = V_inv - V_inv @ M @ np.linalg.solve(M.T @ V_inv @ M, M.T @ V_inv)
    slopes = P @ (2.0 * 0.4 * np.eye(len(K))), P @ (2.0 * 2.0 * K)
    information = 0.5 * np.array([[np.trace(a @ b) for b in slopes] for a in slopes])
    scatter = np.sqrt(np.linalg.inv(information).diagonal() / runs)
    white, walked = np.mean(found, axis=0)
    # The search ends within 2 % of the optimum.
    assert white == pytest.approx(0.4, abs=4.0 * scatter[0] + 0.02 * 0.4)  # with 0.3 claimed
    assert walked == pytest.approx(2.0, abs=4.0 * scatter[1] + 0.02 * 2.0)


# -- fixes -----------------------------------------------------------------------------------------
def test_fixes_of_made_arrivals_err_by_what_they_claim(folder):
    """Within four standard deviations, with the joint distribution of all weeks, which share the
    timing models.
    """
    out = nanograv.fixes(folder, [])
    nees = out["all/nees"][:, 0]
    assert len(nees) > 150
    heard = arrivals.clocks(folder, nanograv.FLOWN, nanograv.END)
    white, place = [], []
    for c in heard:
        roots = [np.linalg.cholesky(k.cov) * (k is c) for k in heard]
        most = max(len(root) for root in roots)
        wide = [np.pad(root, ((0, 0), (0, most - len(root)))) for root in roots]
        w = arrivals.weekly(heard, wide, nanograv.FLOWN, nanograv.END)
        white.append(w.y.reshape(3 * len(w.day), -1))
        place.append(w.fix.reshape(3 * len(w.day), -1))
    for columns, found, claimed in (
        (white, nees.sum(), 3.0 * len(nees)),
        (place, np.square(out["all/error"]).sum(), np.square(out["all/std"]).sum()),
    ):
        law = np.concatenate(columns, 1)
        cov = law @ law.T
        assert np.trace(cov) == pytest.approx(claimed)
        assert found == pytest.approx(claimed, abs=4.0 * np.sqrt(2.0) * np.linalg.norm(cov))


def test_a_jump_of_the_earth_is_found_where_it_went(tmp_path):
    jump = np.array([3.0, -2.0, 1.0])
    folder = made(
        tmp_path / "jump",
        noise_km=0.01,
        moved=lambda day: np.where(day[:, None] >= nanograv.FLOWN, jump, 0.0),
    )
    error = nanograv.fixes(folder, [])["all/error"][:40, 0]
    np.testing.assert_allclose(np.median(error, 0), jump, atol=0.05)


def test_a_fix_is_weighted_least_squares(folder):
    heard = arrivals.clocks(folder, nanograv.FLOWN, nanograv.END)
    w = arrivals.weekly(heard, [c.early for c in heard], nanograv.FLOWN, nanograv.END)
    first, W, z, H = w.day[7] - 3.5, [], [], []
    for c in heard:
        for k, day in enumerate(c.arrivals.day[c.after]):
            if first <= day < first + 7.0:
                W, z, H = [*W, 1.0 / c.cov[k, k]], [*z, c.early[k]], [*H, c.arrivals.n]
    H, W = np.array(H), np.diag(W)
    N = H.T @ W @ H
    np.testing.assert_allclose(w.fix[7], np.linalg.solve(N, H.T @ W @ z), atol=1e-9)
    assert w.std[7] == pytest.approx(np.sqrt(np.trace(np.linalg.inv(N))))


def test_what_every_timing_model_has_is_hidden_and_the_rest_is_seen(folder):
    """Constant, linear and yearly errors of the Earth vanish, because they are columns of every
    model. A fast oscillation remains.
    """
    heard = arrivals.clocks(folder, nanograv.FLOWN, nanograv.END)

    def left(moved):
        w = arrivals.weekly(
            heard, [c.seen(moved(c.arrivals), True) for c in heard], nanograv.FLOWN, nanograv.END
        )
        return np.abs(w.fix).max()

    still = np.array([100.0, -50.0, 20.0])
    assert left(lambda a: np.tile(still, (len(a.day), 1))) < 1e-6
    assert left(lambda a: np.outer((a.day - 54000.0) ** 2 / 1e6, still)) < 1e-6
    tilt = (
        np.cross(np.array([1e-6, 2e-6, -1e-6]), np.eye(3)) * AU_KM
    )  # rotated axes: a yearly error of about 300 km
    assert left(lambda a: a.earth @ tilt) < 1e-6
    assert left(lambda a: np.outer(np.sin(a.day / 5.0), still)) > 50.0


# -- ephemerides and flights -----------------------------------------------------------------------
def test_the_table_of_ephemerides_is_that_of_the_longer_one_where_both_are():
    """DE405 minus DE421 in 2015 and 2016, computed separately, every five hours."""
    other = read_npz(data("ephemeris_2015.npz"))
    mjd = (other["day"] - 2400000.5) + other["rest"]
    for body in ("earth", "sun"):
        ours = nanograv.differences()[f"de421/{body}"](mjd) - nanograv.differences()[
            f"de405/{body}"
        ](mjd)
        np.testing.assert_allclose(ours, other[f"de405-de421/{body}"], atol=1e-4)


def test_the_table_is_the_one_that_the_readme_names():
    digest = hashlib.sha256(data("ephemeris_years.npz").read_bytes()).hexdigest()
    assert digest in data("README.md").read_text(encoding="utf-8")


def test_errors_of_the_orbit_grow_as_those_of_the_orbit_itself():
    start, end, mu = 57800.0, 57900.0, GM["sun"]

    def fall(_, x):
        return np.concatenate([x[3:], -mu * x[:3] / np.linalg.norm(x[:3]) ** 3])

    (earth, v), (sun, u) = (de421().state(body, Tdb(2400000.5, start)) for body in ("earth", "sun"))
    x = np.concatenate([earth - sun, v - u])
    step = np.array([300.0, -200.0, 100.0, 1e-4, 2e-4, -1e-4])
    ends = [
        solve_ivp(fall, (0.0, 86400.0 * (end - start)), x + sign * step, rtol=1e-12, atol=1e-6).y[
            :, -1
        ]
        for sign in (1.0, -1.0)
    ]
    np.testing.assert_allclose(
        nanograv.transition(start, end) @ step, 0.5 * (ends[0] - ends[1]), rtol=2e-3
    )


def test_arrivals_that_remember_are_all_arrivals_at_once(folder):
    """The filter with clock states, after all weeks, equals a single weighted least-squares fit to
    all arrivals with their full covariance.
    """
    flight = nanograv.trial(nanograv.Flight(folder, "de405"), [])
    whole = nanograv.fly_all(nanograv.Flight(folder, "de405"), [None])
    heard = arrivals.clocks(folder, nanograv.FLOWN, nanograv.END)
    w = arrivals.weekly(heard, [c.early for c in heard], nanograv.FLOWN, nanograv.END)
    error = nanograv.differences()["de405/earth"]
    prior = np.concatenate([flight.prior.mean[0], np.zeros(6)])
    deviation = np.concatenate(
        [np.sqrt(flight.prior.cov.diagonal()), np.repeat([nanograv.SUN_KM, nanograv.DRIFT_KM], 3)]
    )
    N, b = np.diag(deviation**-2.0), prior / deviation**2
    total, moves = np.eye(12), []
    for k, day in enumerate(w.day):
        if k:
            step = np.eye(12)
            step[:6, :6] = nanograv.transition(w.day[k - 1], day)
            step[6:9, 9:] = (day - w.day[k - 1]) / 365.25 * np.eye(3)
            total = step @ total
        moves.append(total)
    for c in heard:
        k = np.searchsorted(w.day + 3.5, c.arrivals.day[c.after], "right")
        use = (k < len(w.day)) & (k > 0)  # nothing is measured at the first
        first = (k < len(w.day)) & (k == 0)
        A = np.array([c.arrivals.n @ (moves[i][:3] + moves[i][6:9]) for i in k[use]])
        z = (c.early + error(c.arrivals.day[c.after] + 0.5) @ c.arrivals.n)[use]
        # In the first week the filter models only the noise of the arrivals: condition on them with
        # unknown position.
        if first.any():
            F = np.array([c.arrivals.n @ (moves[0][:3] + moves[0][6:9])] * int(first.sum()))
            z0 = (c.early + error(c.arrivals.day[c.after] + 0.5) @ c.arrivals.n)[first]
            gain = np.linalg.solve(c.cov[np.ix_(first, first)], c.cov[np.ix_(first, use)]).T
            A, z, cov = (
                A - gain @ F,
                z - gain @ z0,
                c.cov[np.ix_(use, use)] - gain @ c.cov[np.ix_(first, use)],
            )
        else:
            cov = c.cov[np.ix_(use, use)]
        N, b = N + A.T @ np.linalg.solve(cov, A), b + A.T @ np.linalg.solve(cov, z)
    x = moves[-1] @ np.linalg.solve(N, b)
    both = np.hstack([np.eye(3), np.zeros((3, 3)), np.eye(3), np.zeros((3, 3))])
    np.testing.assert_allclose(whole["clocks/error"][-1, 0], both @ x - error(w.day[-1]), atol=1e-5)
    P = both @ moves[-1] @ np.linalg.solve(N, (both @ moves[-1]).T)
    np.testing.assert_allclose(whole["clocks/std"][-1, 0], np.sqrt(P.diagonal()), rtol=1e-5)


def test_on_made_arrivals_the_filter_that_remembers_is_consistent(tmp_path):
    """Over several sets of pulsars; a filter with independent weeks is not consistent."""
    nees = {name: [] for name in ("ekf", "clocks")}
    for seed in range(3):
        folder = made(tmp_path / str(seed), seed=seed, every=14.0)
        out = nanograv.fly_all(nanograv.Flight(folder), [None])
        for name, values in nees.items():
            values.append(out[f"{name}/nees"][-1, 0] / 3.0)
    assert 0.3 < np.mean(nees["clocks"]) < 2.2
    assert np.mean(nees["ekf"]) > 3.0


def test_the_whole_study_on_made_arrivals(folder, tmp_path):
    results = nanograv.STUDY.reproduce(nanograv=folder)
    verdicts = {claim.id: claim.verdict for claim in results.claims()}
    assert (
        verdicts["nanograv-fixes"]
        == verdicts["nanograv-ignored"]
        == verdicts["nanograv-swallowed"]
        == "shown"
    )
    for _, draw in nanograv.FIGURES.values():
        assert render(draw(results), "png")[:4] == b"\x89PNG"
    assert len(nanograv.TABLES["table_1"][1](results)) == 21
    assert nanograv.parts() == {}


# -- damaged files ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("row", "column", "value", "message"),
    [
        (3, 2, np.nan, "expected finite numbers, got row 3"),
        (5, 0, 12.0, "expected days after 1990"),
        (7, 1, 2.5, "expected an index of a pulsar among the names"),
        (7, 1, 99.0, "expected an index of a pulsar among the names"),
        (0, 3, 0.0, "expected a standard deviation above 0"),
        (9, 4, 2.0, "expected a direction of length 1"),
        (9, 7, 900.0, "expected the Earth within"),
    ],
)
def test_a_row_that_cannot_be_is_named(folder, tmp_path, row, column, value, message):
    stored = read_npz(folder / "daily_averages.npz")
    stored["epochs"][row, column] = value
    np.savez(tmp_path / "daily_averages.npz", **stored)
    with pytest.raises(InputError, match=message):
        arrivals.read(tmp_path)


def test_files_that_are_none_are_named(folder, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"daily_averages\.npz"):
        arrivals.read(tmp_path)
    whole = (folder / "daily_averages.npz").read_bytes()
    rng, path = np.random.default_rng(3), tmp_path / "daily_averages.npz"
    for trial in range(60):
        broken = bytearray(whole[: rng.integers(1, len(whole))] if trial % 2 else whole)
        for at in rng.integers(0, len(broken), 1 + 40 * (trial % 3)):
            broken[at] = rng.integers(256)
        path.write_bytes(bytes(broken))
        arrivals.read.cache_clear()
        with contextlib.suppress(InputError):  # nothing else
            arrivals.read(tmp_path)
    np.savez(path, names=np.array(["A"]), epochs=np.zeros((4, 3)))
    with pytest.raises(InputError, match=r"expected names \(pulsars,\) and epochs \(N, 11\)"):
        arrivals.read(tmp_path)


def test_too_few_pulsars_or_weeks_are_said(tmp_path):
    with pytest.raises(
        InputError, match="expected two weeks or more with 6 observed pulsars, got 0"
    ):
        nanograv.fixes(made(tmp_path / "few", count=4), [])
    with pytest.raises(
        InputError, match="expected pulsars with 3 years of observations before MJD 57754, got none"
    ):
        nanograv.fixes(made(tmp_path / "short", count=4, every=200.0), [])


# -- the real ones ---------------------------------------------------------------------------------
@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_the_earth_by_real_pulsars():
    out = nanograv.fixes(REAL, [])
    error = np.linalg.norm(out["all/error"][:, 0], axis=1)
    assert len(error) == 118
    assert 0.1 < np.median(error) < 0.25
    assert 0.3 < np.sqrt(np.square(error).mean()) < 0.6
    level, color = nanograv.tuned(REAL)
    assert 0.6 < level < 0.8
    assert abs(color) < 0.2
