"""GRACE-A: simulated files in the same formats, invalid files, parts of filters against independent
formulas, real files.
"""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import nbformat
import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from celnav.files import InputError, Outputs
from celnav.filters.colored import colored
from celnav.filters.records import Epoch, epochs
from celnav.filters.run import run
from celnav.filters.sequential import ukf
from celnav.gaussian.belief import Gaussian
from celnav.models import earth, ephemeris, gravity
from celnav.real import grace
from celnav.real.grace import positions, settings, show, study
from celnav.show.reading import read

REAL = Path(__file__).parents[3] / "shared" / "data" / "grace"
START, COUNT = 270820800.0, 320
HEAD = "earth_gravity_constant 0.3986004415E+15\nradius 0.63781363E+07\nnorm fully_normalized\nend_of_head\n"


def field_text():
    """A field to degree 16: two-body term, the Earth's flattening, and small
    terms of every degree.
    """
    lines = ["gfc 0 0 1.0 0.0", "gfc 2 0 -0.484165143790815d-03 0.0"]
    rng = np.random.default_rng(1)
    for n in range(2, 17):
        lines += [
            f"gfc {n} {m} {c:.15e} {s:.15e}"
            for m in range(1, n + 1)
            for c, s in [1e-6 / n**2 * rng.standard_normal(2)]
        ]
    return HEAD + "\n".join(lines) + "\n"


def orbit(field, count):
    """States every 10 s on Earth-fixed axes, integrated in inertial space by a high-order method,
    unlike the filters.
    """
    bodies, center = (
        [],
        ephemeris.de421().state(
            "earth", ephemeris.from_tt(*settings.orientation(np.array([START]))[1][0])
        ),
    )
    for name in ("sun", "moon"):
        state = ephemeris.de421().state(
            name, ephemeris.from_tt(*settings.orientation(np.array([START]))[1][0])
        )
        place, moving = (
            1e3 * (state.position - center.position),
            1e3 * (state.velocity - center.velocity),
        )
        bodies.append((1e9 * ephemeris.GM[name], place, moving))

    def turned(t):
        return settings.orientation(np.array([START + t]))[0][0]

    def rate(t, x):
        R = turned(t)
        pull = R.T @ field.acceleration(R @ x[:3])
        for gm, place, moving in bodies:
            s = place + moving * t
            pull = pull + gm * (
                (s - x[:3]) / np.linalg.norm(s - x[:3]) ** 3 - s / np.linalg.norm(s) ** 3
            )
        return np.concatenate([x[3:], pull])

    R, spin = turned(0.0), earth.spin(np.stack([turned(0.0), turned(10.0)]), 10.0)[0]
    r, v = np.array([686123.6, -6771705.2, 734394.0]), np.array([-280.0, -860.0, -7540.0])
    start = np.concatenate([R.T @ r, R.T @ (v + np.cross(spin, r))])
    times = settings.STEP_S * np.arange(count)
    found = solve_ivp(rate, (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-6).y.T
    fixed = [turned(t) for t in times]
    r = np.stack([A @ x[:3] for A, x in zip(fixed, found, strict=True)])
    v = np.stack([A @ x[3:] for A, x in zip(fixed, found, strict=True)]) - np.cross(spin, r)
    return np.concatenate([r, v], 1)


def written(path, times, xyz, pack=True):
    text = "".join(
        f"{t:14.3f} {x:14.3f} {y:14.3f} {z:14.3f} {1.0:13.3f}\n"
        for t, (x, y, z) in zip(times, xyz, strict=True)
        if x == x
    )
    path.write_bytes(gzip.compress(text.encode()) if pack else text.encode())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three days with 320 fixes, errors of 4 m with correlation 0.98, a gap, and an outlier; and
    the true positions.
    """
    where = tmp_path_factory.mktemp("grace")
    (where / "made.gfc").write_text(field_text())
    truth = orbit(gravity.read(where / "made.gfc"), COUNT)[:, :3]
    rng = np.random.default_rng(0)
    for day in (1, 2, 3):
        noise = rng.standard_normal((COUNT, 3))
        for k in range(1, COUNT):
            noise[k] = 0.98 * noise[k - 1] + np.sqrt(1.0 - 0.98**2) * noise[k]
        fixes = truth + 4.0 * noise
        fixes[40:45], fixes[100] = np.nan, fixes[100] + 60.0
        times = START + 86400.0 * (day - 1) + 10.0 * np.arange(COUNT)
        written(where / f"GPS1B_2008-08-0{day}_A_01.pos.spp.gz", times, fixes)
        if day == 1:
            written(where / "GPS1B_2008-08-01_A_01.pos.RCDL3.svr.atx05.gz", times[2:], truth[2:])
    return where


@pytest.fixture(scope="module")
def results(folder):
    """The study on the simulated files, in which a revolution is an eighth of the day."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "REVOLUTION", 40)
        patch.setattr(show, "REVOLUTION", 40)  # which copied the value at import
        patch.setattr(study, "TRAINED", 100)
        yield grace.STUDY.reproduce(grace=folder)


def test_a_file_is_what_was_written(folder, tmp_path):
    log = positions.read(folder / "GPS1B_2008-08-01_A_01.pos.spp.gz")
    assert log.times[0] == START
    assert log.z.shape == (COUNT, 3)
    assert np.isnan(log.z[40:45]).all()
    assert np.isfinite(np.delete(log.z, slice(40, 45), 0)).all()
    truth = positions.read(folder / "GPS1B_2008-08-01_A_01.pos.RCDL3.svr.atx05.gz")
    there = positions.aligned(log, truth)
    assert np.isnan(there[:2]).all()
    np.testing.assert_array_equal(there[2:], truth.z)
    written(tmp_path / "plain", log.times, log.z, pack=False)
    np.testing.assert_array_equal(positions.read(tmp_path / "plain").z, log.z)


LINE = " 270820800.000    686124.068  -6771707.196    734394.068         0.974\n"


def lines(count):
    return [LINE.replace("270820800", str(270820800 + 10 * k)) for k in range(count)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected at least 100 positions, got 0"),
        ("".join(lines(99)), "expected at least 100 positions, got 99"),
        (
            "".join([*lines(5), "garbage\n"]),
            "line 6: expected five numbers, seconds x y z quality, got 'garbage'",
        ),
        ("".join([*lines(5), " 270820850.0 1 2 3\n"]), "line 6: expected five numbers"),
        ("".join([*lines(5), " 270820850.0 1 2 3 4 5\n"]), "line 6: expected five numbers"),
        ("".join([*lines(5), " 270820850.0 nan 2 3 4\n"]), "line 6: expected five numbers"),
        ("".join([*lines(5), "\n"]), "line 6: expected five numbers"),
        (
            "".join([*lines(5), lines(5)[4]]),
            "line 6: expected increasing seconds at steps of 10, got 270820840",
        ),
        (
            "".join([*lines(5), LINE.replace("00.000", "53.000")]),
            "line 6: expected increasing seconds at steps of 10",
        ),
        (
            "".join([*lines(5), LINE.replace("270820800", "970820800")]),
            "line 6: expected increasing seconds",
        ),
        (
            "".join(lines(120))
            .replace("686124.068", "686.124")
            .replace("-6771707.196", "-6771.7")
            .replace("734394.068", "734.4"),
            "expected positions in m from the Earth's center, got a distance of 6845.88",
        ),
    ],
)
@pytest.mark.parametrize("pack", [False, True], ids=["plain", "gzipped"])
def test_what_is_no_such_file_is_refused_by_file_and_line(tmp_path, text, message, pack):
    path = tmp_path / "log"
    path.write_bytes(gzip.compress(text.encode()) if pack else text.encode())
    with pytest.raises(InputError) as error:
        positions.read(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)


def test_a_file_that_is_cut_off_garbled_or_too_large_is_refused(folder, tmp_path):
    content = (folder / "GPS1B_2008-08-02_A_01.pos.spp.gz").read_bytes()
    path = tmp_path / "log"
    for bad in (
        content[: len(content) // 2],
        content[:2],
        content[:200] + b"\0" * 50 + content[250:],
    ):
        path.write_bytes(bad)
        with pytest.raises(
            InputError, match=r"log: expected a whole gzipped file|log: line \d+: expected"
        ):
            positions.read(path)
    path.write_bytes(gzip.compress(b" " * 20_000_000))
    with pytest.raises(InputError, match="expected at most 10,000,000 bytes when unpacked"):
        positions.read(path)
    rng = np.random.default_rng(3)
    whole, told = gzip.decompress(content), []
    for _ in range(100):
        spoiled = bytearray(whole)
        for k in rng.integers(0, len(spoiled), 3):
            spoiled[k] = rng.integers(0, 256)
        path.write_bytes(bytes(spoiled))
        try:
            assert np.isfinite(positions.read(path).times).all()
        except InputError as error:
            told.append(str(error))
    assert len(told) > 50
    assert all(text.startswith(f"{path}: ") for text in told)


def test_a_step_is_the_orbit(folder):
    """Against a high-order integrator in inertial space, over three minutes."""
    field = gravity.read(folder / "made.gfc")
    states, u = orbit(field, 20), settings.around(START + settings.STEP_S * np.arange(20))
    x = states[0]
    for k in range(19):
        x = settings.step(x, Epoch(dt=settings.STEP_S, u=tuple(part[k] for part in u)), field)
    assert np.abs(x - states[-1])[:3].max() < 1e-3


def test_axes_are_radial_along_and_across(folder):
    truth = orbit(gravity.read(folder / "made.gfc"), 30)
    frame = positions.axes(truth[:, :3])
    np.testing.assert_allclose(
        frame @ frame.mT, np.broadcast_to(np.eye(3), frame.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.einsum("tij,tj->ti", frame, truth[:, :3])[:, 1:], 0.0, atol=1e-6)
    moving = np.einsum(
        "tij,tj->ti", frame, truth[:, 3:] + np.cross([0.0, 0.0, earth.ROTATION_RATE], truth[:, :3])
    )
    assert (moving[:, 1] > 7e3).all()
    assert np.abs(moving[1:-1, 2]).max() < 0.05  # differences over 20 s


def test_the_study_judges_made_files(results):
    """The errors as simulated: a correlation of 0.98, and one outlier, which the gate finds."""
    claims = {claim.id: claim for claim in results.claims()}
    assert set(claims) == {row.id for row in grace.STUDY.rows}
    assert claims["fixes-colored"].numbers[0].value == pytest.approx(0.98, abs=0.03)
    assert all(
        number.ci is None or number.ci[0] <= number.value <= number.ci[1]
        for c in claims.values()
        for number in c.numbers
    )
    assert claims["white-overconfident"].holds
    for name in study.NAMES:
        part = study.BEST
        assert np.isfinite(results.get(part, f"{name}/std")[4:40]).all()
        assert (0.0 < results.value(part, f"{name}/rejected", 0) < 0.05) == (
            name == "white, gated"
        ), name
    assert np.isnan(results.get(study.BEST, "colored/nis")[42, 0])
    assert all(
        results.get("settings", name).shape == (5 if "white" in name else 7,)
        for name in study.SEARCHED
    )


def test_a_range_of_time_constants_predicts_more_than_each_of_its_ends(results):
    """The filter for one time constant is optimal for it, so a bound is never below it."""
    fits = [settings.SETTINGS[name] for name in ("robust", "screened", "normal", "by correlation")]
    taus = [-settings.STEP_S / np.log(fit.phi) for fit in fits]
    np.testing.assert_allclose(settings.TAU_S, (min(taus), max(taus)))
    bound, *ends = (
        results.get(study.BEST, f"{name}/std") for name in ("bound", "shortest", "longest")
    )
    there = np.isfinite(bound)
    for end in ends:
        assert (bound >= end * (1.0 - 1e-9))[there].all()
        assert np.mean((bound / end)[there]) > 1.1


def test_what_is_shown_can_be_drawn(results, tmp_path):
    for _, function in grace.FIGURES.values():
        function(results).savefig(tmp_path / "a.png")
    (table,) = (function(results) for _, function in grace.TABLES.values())
    assert len(table) == 1 + len(study.NAMES) + 4
    assert len({tuple(row) for row in table}) == 1


def test_the_recording_has_its_date_and_what_became_of_the_fixes(results, tmp_path):
    assert show.record(results, Outputs(tmp_path)) == grace.RECORDINGS
    found = read(tmp_path / "grace.rrd")
    assert found.start_date == np.datetime64("2008-08-01T00:00:00")
    keep = slice(None, None, show.THIN)
    times = results.times(study.BEST)[keep]
    missing = np.isnan(positions.read(results.parts[study.BEST].config.fixes[0]).z[keep]).any(1)
    assert missing.any()
    for name, others in (("white", {"used"}), ("white, gated", {"used", "rejected"})):
        lane = found[f"states/{show.LANES[name].replace(' ', '_')}"]
        states = lane["state"][np.searchsorted(lane.times, times + 1e-6) - 1]
        used = np.isfinite(results.get(study.BEST, f"{name}/white")[keep]).all(1)
        np.testing.assert_array_equal(states == "missing", missing)
        np.testing.assert_array_equal(states == "used", used)
        assert set(states[~missing]) <= {*others, "used in part"}


def test_the_filters_of_a_batch_are_those_alone(folder):
    """Settings and hooks as runs of a batch: each setting run alone gives the same, and the white
    one equals a plain UKF.
    """
    field, log = (
        gravity.read(folder / "made.gfc", 2),
        positions.read(folder / "GPS1B_2008-08-01_A_01.pos.spp.gz"),
    )
    times, z, u, start = (
        log.times[:120] - log.times[0],
        log.z[:120],
        settings.around(log.times[:120]),
        settings.prior(log),
    )
    names = ("white", "colored", "white, gated", "robust", "without z_0")
    ((own, together),) = study.flights(field, names).items()
    assert own == names
    track = run(
        together,
        Gaussian(np.tile(start.mean, (5, 1)), start.cov),
        times,
        np.tile(z[:, None], (1, 5, 1)),
        u,
        keep="cov",
    )
    for i, name in enumerate(names):
        M, S, Phi = settings.believed(field, settings.SETTINGS[name])
        hooks = [study.HOOKED[name]] if name in study.HOOKED else []
        alone = (
            ukf(M, S, hooks=hooks)
            if name.startswith("white")
            else colored(M, S, Phi, hooks=hooks, first=name != "without z_0")
        )
        one = run(alone, start, times, z, u, keep="cov")
        np.testing.assert_allclose(track.mean[:, i], one.mean, rtol=0, atol=1e-5)
        np.testing.assert_allclose(track.cov[:, i], one.cov, rtol=1e-6, atol=1e-9)
        assert track.events["rejected"][i] == one.events["rejected"]
    assert track.events["rejected"][2] > 0


@pytest.fixture(scope="module")
def data(folder):
    """Data of a few fixes, with the true gravity field or nearly so."""
    paths = [folder / f"GPS1B_2008-08-0{day}_A_01.pos.spp.gz" for day in (2, 3)]
    return settings.training(paths, gravity.read(folder / "made.gfc", 2), 120)


def test_far_fixes_are_screened(data):
    assert np.isfinite(data.z[100]).all()
    assert np.isnan(data.screened().z[100]).all()  # the outlier
    assert np.isnan(data.screened().z).sum() == 2 * 3 * (
        5 + 2
    )  # and the fix that is compared with it


def test_the_linear_motion_of_a_search_is_the_motion(folder, data):
    """Likelihoods from the linearization about a trajectory equal the filter's likelihoods."""
    field = gravity.read(folder / "made.gfc", 2)
    logs = [positions.read(folder / f"GPS1B_2008-08-0{day}_A_01.pos.spp.gz") for day in (2, 3)]
    M, S, Phi = settings.believed(field, settings.SETTINGS["colored"])
    for i, log in enumerate(logs):
        u = settings.around(log.times[:120])
        whole = run(
            colored(M, S, Phi), settings.prior(log), log.times[:120] - log.times[0], log.z[:120], u
        )
        about = settings.trained(field, settings.SETTINGS["colored"])
        (start, F, c) = (
            part[i] if part.ndim == 2 else part[:, i] for part in (data.prior.mean, *data.u)
        )
        found = run(about, Gaussian(start, data.prior.cov), data.times, data.z[:, i], (F, c))
        assert found.log_likelihood == pytest.approx(whole.log_likelihood, abs=1e-4)


def test_the_density_of_an_innovation_is_that_of_students_t(folder, data):
    """For the last innovation, from scipy, before the weights; and the normal density for many
    degrees of freedom.
    """
    field = gravity.read(folder / "made.gfc", 2)
    M, S, Phi = settings.linear(settings.believed(field, settings.SETTINGS["robust"]))
    start = Gaussian(data.prior.mean[0], data.prior.cov)
    when = epochs(data.times, data.z[:, 0], tuple(part[:, 0] for part in data.u))
    one = start, when[:9]
    many = run(settings.Weighed(colored(M, S, Phi, hooks=settings.weighing(1e9))), *one)
    assert many.log_likelihood == pytest.approx(
        run(colored(M, S, Phi), *one).log_likelihood, abs=1e-4
    )
    plain = colored(M, S, Phi)
    flown = run(plain, start, when[:8])
    info = run(plain, *one)
    hooked = settings.Weighed(colored(M, S, Phi, hooks=[settings.weighing(4.0)[0]]))
    weighed = [run(hooked, start, when[:n]) for n in (8, 9)]
    u, normal = info.whitened[-1], info.log_likelihood - flown.log_likelihood
    expected = normal - stats.norm.logpdf(u).sum() + stats.t(4.0).logpdf(u).sum()
    assert weighed[1].log_likelihood - weighed[0].log_likelihood == pytest.approx(
        expected, abs=1e-9
    )


def students_scale(far):
    """The most probable scale s of Student's t for unit normal samples, some of which are far away,
    from ``E psi(u) = 0``; and the relative standard deviation of its estimate from one sample,
    ``sqrt(E psi^2) / E s dpsi/ds``.
    """
    nu = settings.DOF

    def mean(function):
        return quad(lambda u: function(u) * stats.norm.pdf(u), -12.0, 12.0)[0]

    def psi(u, s):
        return (nu + 1.0) * u * u / (nu * s * s + u * u) - 1.0

    s = brentq(lambda s: (1.0 - far) * mean(lambda u: psi(u, s)) + far * nu, 0.3, 3.0)
    slope = mean(lambda u: 2.0 * nu * s * s * (nu + 1.0) * u * u / (nu * s * s + u * u) ** 2)
    return s, np.sqrt(mean(lambda u: psi(u, s) ** 2)) / slope


@pytest.mark.parametrize("kind", ["colored", "tails"])
def test_likelihood_finds_what_made_the_fixes(folder, data, kind):
    """Within four standard deviations for so few samples; Student's t needs no samples left out."""
    field = gravity.read(folder / "made.gfc", 2)
    found = settings.fitted(
        data if kind == "tails" else data.screened(), field, settings.Setting(3.0, 0.97, 3e-4), kind
    )
    sigma, _, phi = found.parameters
    level, scatter, count = 1.0, np.sqrt(0.5), np.isfinite(data.screened().z).sum()
    if kind == "tails":
        count = np.isfinite(data.z).sum()
        level, scatter = students_scale(far=2 * 2 * 3 / count)  # into the far fix and out of it
    assert sigma * np.sqrt(1.0 - phi**2) / (4.0 * np.sqrt(1.0 - 0.98**2)) == pytest.approx(
        level, rel=4.0 * scatter / np.sqrt(count)
    )


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_the_real_files_are_as_their_source_says():
    fixes = positions.read(next(REAL.glob(study.FIXES[0])))
    truth = positions.read(next(REAL.glob(study.TRUTH)))
    assert (np.isfinite(fixes.z[:, 0]).sum(), np.isfinite(truth.z[:, 0]).sum()) == (8600, 8579)
    assert fixes.times[0] == truth.times[0] == START
    field = gravity.read(next(REAL.glob(study.FIELD)), 8)
    assert field.C[2, 0] == -0.484165143790815e-3


def test_shares_inside_of_an_interval_say_of_which_errors_they_are(results):
    """For all components in the ledger and the docs, for the radial errors in the figure."""
    root = Path(__file__).parents[2]
    page = " ".join((root / "docs" / "real_data.md").read_text(encoding="utf-8").split())
    said = re.search(
        r"error components \(radial, along and across the track\) (\d+) % \[(\d+), (\d+)\] lie",
        page,
    )
    cells = nbformat.read(root / "notebooks" / "07_real_data.ipynb", as_version=4).cells
    pages = [
        o.data.get("text/html", "") for c in cells for o in c.get("outputs", ()) if "data" in o
    ]
    label = "components within the predicted 95 % intervals, white"
    cell = rf"{label}</td><[^>]*>([\d.]+) \[([\d.]+), ([\d.]+)\]"
    share = re.search(cell, " ".join(pages)).groups()
    assert [round(100 * float(v)) for v in share] == [int(v) for v in said.groups()]
    (claim,) = [claim for claim in results.claims() if claim.id == "typical"]
    assert claim.numbers[3].label == label
    (row,) = [row for row in grace.STUDY.rows if row.id == "typical"]
    assert "components (radial, along and across the track)" in row.found
    titles = [axes.get_title() for axes in grace.FIGURES["figure_01"][1](results).axes]
    assert len(titles) == 3
    assert all(
        re.search(r": \d+% of the radial errors within the predicted 95 %$", t) for t in titles
    )
