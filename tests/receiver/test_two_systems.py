"""GPS together with BeiDou: one offset between their clocks, epochs without one of them, and ranges
that cannot be tested.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rinex_pair import (
    ALPHA,
    BETA,
    PLACE,
    TIMES,
    TOE,
    above,
    both,
    constellation,
    gps,
    modeled_errors,
    navigation,
    observations,
    observed,
    written,
)

from celnav.files import InputError
from celnav.filters.run import run
from celnav.models import pseudorange
from celnav.models.gnss import satellites
from celnav.receiver import position as positioning
from celnav.receiver import report
from celnav.receiver.filters import filters
from celnav.receiver.rinex import Navigation, read_ionosphere, read_navigation, read_observations
from celnav.receiver.sky import dilution, local_axes

LONG = TOE + 1800.0 + 30.0 * np.arange(40)
DRIFTING = 3e4 + 30.0 * (LONG - LONG[0])
OFFSET = -37.0


@pytest.fixture(scope="module")
def pair():
    b = above(both(), LONG[[0, -1]])
    return Navigation(Path("nav.rnx"), b, (np.array(ALPHA), np.array(BETA))), observed(
        b, LONG, DRIFTING, OFFSET
    )


@pytest.fixture(scope="module")
def noisy(pair):
    nav, obs = pair
    return nav, replace(
        obs, code=obs.code + 0.5 * np.random.default_rng(8).normal(size=obs.code.shape)
    )


def without(obs, names, rows=slice(None)):
    code = obs.code.copy()
    code[rows, [s for s, name in enumerate(obs.names) if name in names]] = np.nan
    return replace(obs, code=code)


def seen(log, letter):
    """Satellites of one system that are used all the time."""
    return [name for s, name in enumerate(log.names) if name[0] == letter and log.used[:, s].all()]


def test_a_fix_has_the_offset_of_the_second_clock(pair):
    nav, obs = pair
    log = positioning.prepare(obs, nav)
    assert log.systems == "CG"
    np.testing.assert_allclose(log.fixes[:, :3], np.broadcast_to(PLACE, (40, 3)), atol=1e-4)
    np.testing.assert_allclose(log.fixes[:, 6], DRIFTING, atol=1e-4)
    np.testing.assert_allclose(log.fixes[:, 8], OFFSET, atol=1e-4)
    assert (log.spare == log.used.sum(1) - 5).all()
    for name, filter in filters(len(log.names), second=log.second).items():
        mean = run(filter, log.prior(), log.epochs(), keep="mean").mean
        np.testing.assert_allclose(
            mean[:, :3], np.broadcast_to(PLACE, (40, 3)), atol=2e-3, err_msg=name
        )
        np.testing.assert_allclose(mean[:, 8], OFFSET, atol=2e-3, err_msg=name)


@pytest.mark.parametrize(
    ("systems", "names"),
    [("C", "BeiDou B1I"), ("G", "GPS L1 C/A"), (None, "BeiDou B1I and GPS L1 C/A")],
)
def test_each_system_alone_finds_the_receiver_too(pair, systems, names):
    nav, obs = pair
    log = positioning.prepare(replace(obs, others="RJ"), nav, systems=systems)
    np.testing.assert_allclose(log.fixes[:, :3], np.broadcast_to(PLACE, (40, 3)), atol=1e-4)
    assert {name[0] for name in log.names} == set(systems or "CG")
    assert log.fixes.shape[1] == (8 if systems else 9)
    said = report.summary(report.position(log, "ekf", PLACE))
    assert f"systems      {names}" in said
    assert "GLONASS, QZSS" in said
    assert ("longer by -37.00 m" in said) == (systems is None)


def test_the_one_system_that_has_orbits_is_chosen_and_a_missing_one_that_is_asked_for_is_told(pair):
    nav, obs = pair
    alone = replace(nav, sets=gps())
    log = positioning.prepare(obs, alone)
    assert log.systems == "G"
    assert log.others == ("BeiDou",)
    with pytest.raises(
        InputError,
        match=r"nav\.rnx: expected ranges and orbits of one system, got no BeiDou's orbits",
    ):
        positioning.prepare(obs, alone, systems="CG")
    with pytest.raises(InputError, match=r"got no BeiDou's orbits and no GPS's ranges"):
        positioning.prepare(obs.of("C"), alone)
    for systems in ("", "R", "CR"):
        with pytest.raises(
            ValueError, match=r"^systems: expected letters of C \(BeiDou\), G \(GPS\)"
        ):
            positioning.prepare(obs, nav, systems=systems)


@pytest.mark.parametrize("missing", ["C", "G"])
def test_where_one_system_is_missing_the_other_goes_on(pair, missing):
    nav, obs = pair
    rows = slice(10, 20)
    log = positioning.prepare(
        without(obs, [name for name in obs.names if name[0] == missing], rows), nav
    )
    np.testing.assert_allclose(log.fixes[:, :3], np.broadcast_to(PLACE, (40, 3)), atol=1e-4)
    assert np.isnan(log.fixes[rows, 8]).all()
    np.testing.assert_allclose(np.delete(log.fixes[:, 8], np.r_[rows]), OFFSET, atol=1e-4)
    assert (log.spare[rows] == log.used[rows].sum(1) - 4).all()
    assert np.isfinite(log.dilution.position).all()
    assert not log.jumps.any()
    for filter in ("ls", "ekf", "aukf", "group"):
        found = report.position(log, filter, None)
        np.testing.assert_allclose(found.mean[:, :3], np.broadcast_to(PLACE, (40, 3)), atol=2e-3)
        assert "nan" not in report.summary(found)


def test_a_systems_only_range_is_not_used_and_counted(pair):
    nav, obs = pair
    (one, *rest) = seen(positioning.prepare(obs, nav), "G")
    low = [name for name in obs.names if name[0] == "G" and name not in (one, *rest)]
    code = without(obs, [*rest, *low]).code
    code[:, obs.names.index(one)] += 1e4  # however wrong it is
    log = positioning.prepare(replace(obs, code=code), nav)
    assert not log.used[:, log.names.index(one)].any()
    assert log.left_out["the only range of a system, which nothing tests"] == 40
    np.testing.assert_allclose(log.fixes[:, :3], np.broadcast_to(PLACE, (40, 3)), atol=1e-4)


def test_a_faulty_satellite_of_either_system_is_excluded_and_of_two_both(noisy):
    nav, obs = noisy
    log = positioning.prepare(obs, nav)
    assert not log.excluded.any()
    for letter in "CG":
        wrong, code = seen(log, letter)[0], obs.code.copy()
        code[:, obs.names.index(wrong)] += 80.0
        found = positioning.prepare(replace(obs, code=code), nav)
        np.testing.assert_array_equal(
            np.flatnonzero(found.excluded[:, : len(found.names)].any(0)), found.names.index(wrong)
        )
        assert found.excluded[:, found.names.index(wrong)].all()
    two = seen(log, "G")[:2]
    code = without(obs, [name for name in obs.names if name[0] == "G" and name not in two]).code
    code[:, obs.names.index(two[1])] += 80.0
    found = positioning.prepare(replace(obs, code=code), nav)
    assert found.excluded[:, [found.names.index(name) for name in two]].all()
    assert np.abs(report.position(found, "aukf", None).mean[:, :3] - PLACE).max() < 5.0


def test_residuals_have_one_degree_less_for_the_offset(noisy):
    nav, obs = noisy
    rng = np.random.default_rng(2)
    obs = replace(obs, code=obs.code + modeled_errors(positioning.prepare(obs, nav), rng))
    log = positioning.prepare(obs, nav)
    assert log.noise[0].redundancy == log.used.sum() - 5 * 40
    size = np.sqrt(0.5**2 + log.modeled[log.used].mean())
    assert np.sqrt(np.square(log.sigma[:, : len(log.names)][log.used]).mean()) == pytest.approx(
        size, rel=0.1
    )
    assert report.position(log, "ls", PLACE).nis == pytest.approx(1.0, abs=0.1)
    without_gps = without(obs, [name for name in obs.names if name[0] == "G"], slice(0, 20))
    log = positioning.prepare(without_gps, nav)
    assert log.noise[0].redundancy == log.used.sum() - 4 * 20 - 5 * 20
    assert report.position(log, "ls", PLACE).nis == pytest.approx(1.0, abs=0.1)


def test_dilution_counts_the_offset():
    rng = np.random.default_rng(4)
    place, axes = np.array([6378137.0, 0.0, 0.0]), local_axes(0.0, 0.0)
    q = place + 2e7 * rng.normal(size=(3, 9, 3))
    second, used = np.repeat([0.0, 1.0], [5, 4]), np.ones((3, 9), bool)
    used[1, :5] = used[2, 5:] = False
    found = dilution(q, place, axes, used, second[None])
    for k, columns in enumerate(([0, 1, 2, 3, 4], [0, 1, 2, 3], [0, 1, 2, 3])):
        e = (q[k] - place) / np.linalg.norm(q[k] - place, axis=-1, keepdims=True)
        G = np.column_stack([-e, np.ones(9), second])[used[k]][:, columns]
        assert found.position[k] == pytest.approx(
            np.sqrt(np.trace(np.linalg.pinv(G.T @ G)[:3, :3]))
        )


def test_the_derivative_by_the_offset():
    b = both()
    seen = pseudorange.sources(b, TOE + 900.0, PLACE)
    x, h = np.concatenate([PLACE, [3.0, -2.0, 1.0, 3e4, 30.0, 20.0]]), 1.0
    J = pseudorange.jacobian(np.stack([x, x]), seen.q, seen.w, b.system[None])
    for column in range(9):
        step = h * np.eye(9)[column]
        up, down = (
            pseudorange.measure(x + sign * step, seen.q, seen.w, b.system[None])
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(J[1, :, column], (up - down) / (2.0 * h), atol=1e-6)


def test_files_of_both_are_read_as_written(tmp_path):
    b = both()
    whole = read_navigation(written(tmp_path, navigation(b), "nav.rnx"))
    c, g = (
        written(tmp_path, navigation(part), name)
        for part, name in ((constellation(), "c.rnx"), (gps(), "g.rnx"))
    )
    for found in (whole, read_navigation(c, g)):
        sets = found.sets.chosen(np.array([found.sets.names.index(name) for name in b.names]))
        np.testing.assert_allclose(
            satellites(sets, TOE + 60.0).position,
            satellites(b, TOE + 60.0).position,
            rtol=0,
            atol=1e-3,
        )
        np.testing.assert_allclose(
            satellites(sets, TOE + 60.0).clock, satellites(b, TOE + 60.0).clock, rtol=0, atol=1e-15
        )
    assert "g.rnx" in str(read_navigation(c, g).path)
    text, code, doppler = observations(b, TIMES, offset=OFFSET)
    obs = read_observations(written(tmp_path, text, "obs.rnx"))
    order = [obs.names.index(name) for name in b.names]
    np.testing.assert_allclose(obs.code[:, order], code, rtol=0, atol=6e-4)
    np.testing.assert_allclose(obs.doppler[:, order], doppler, rtol=0, atol=6e-4)
    log = positioning.prepare(obs, whole)
    np.testing.assert_allclose(log.fixes[:, 8], OFFSET, atol=0.01)


@pytest.mark.parametrize("into", [-7200.0, -14.0, 0.0, 7200.0])
def test_a_set_at_the_end_of_the_week_has_its_own_week(tmp_path, into):
    """For GPS, whose week ends 14 s before BeiDou's."""
    toe = 604800.0 * 956 + into
    b = replace(gps(), toe=np.full(24, toe), toc=np.full(24, toe))
    found = read_navigation(written(tmp_path, navigation(b, toe))).sets
    np.testing.assert_allclose(found.toe, toe)
    order = [found.names.index(name) for name in b.names]
    ours = satellites(found.chosen(np.array(order)), toe + 3600.0).position
    np.testing.assert_allclose(ours, satellites(b, toe + 3600.0).position, rtol=0, atol=1e-3)


def test_a_sick_satellite_of_gps_is_not_used(tmp_path):
    b = gps()
    found = read_navigation(
        written(tmp_path, navigation(replace(b, health=np.where(b.number == 7.0, 63.0, 0.0))))
    )
    assert found.nearest("G07", TOE) == -1
    assert found.nearest("G03", TOE + 7000.0) >= 0  # a medium orbit, though C03 is geostationary
    assert found.nearest("G03", TOE + 7300.0) == -1
    assert found.nearest("C08", TOE) == -1


def test_the_ionosphere_is_read_from_any_header(tmp_path):
    text = navigation(gps())
    found = read_ionosphere(written(tmp_path, text))
    np.testing.assert_allclose(found, [ALPHA, BETA])
    old = f"{'     2.11':<20}{'N: GPS NAV DATA':<40}RINEX VERSION / TYPE\n"
    for row, name in ((ALPHA, "ION ALPHA"), (BETA, "ION BETA")):
        old += f"{'  ' + ''.join(f'{v:12.4E}'.replace('E', 'D') for v in row):<60}{name}\n"
    old += f"{'':60}END OF HEADER\n"
    np.testing.assert_allclose(read_ionosphere(written(tmp_path, old)), [ALPHA, BETA])
    with pytest.raises(InputError, match=r"expected GPSA and GPSB in the header, got none"):
        read_ionosphere(written(tmp_path, text.replace("GPSA", "GAL ")))
    with pytest.raises(
        InputError,
        match=r"file\.rnx: expected coefficients of the ionosphere that a message can hold",
    ):
        read_ionosphere(written(tmp_path, text.replace("4.6566E-09", "4.6566E-01")))
    with pytest.raises(InputError, match=r"expected orbits of BeiDou, GPS or Galileo .* got none"):
        read_navigation(written(tmp_path, old))


REAL = Path(__file__).parents[3] / "shared" / "data"
STATIONS = [("rinex", ["*_MN.rnx.gz"]), ("nya1", ["*_CN.rnx.gz", "*_GN.rnx.gz"])]


@pytest.mark.skipif(not (REAL / "nya1").is_dir(), reason="no real files beside the checkout")
@pytest.mark.parametrize(("folder", "names"), STATIONS)
def test_real_receivers_stand_where_their_headers_say(folder, names):
    """Two hours, at epochs with PDOP below 10; both systems together are more accurate than the
    worse of the two.
    """
    obs = read_observations(next((REAL / folder).glob("*_MO.crx.gz")))
    obs, nav = (
        obs.part(slice(0, 240)),
        read_navigation(*(next((REAL / folder).glob(name)) for name in names)),
    )
    errors = {}
    for systems in ("C", "G", "CG"):
        log = positioning.prepare(obs, nav, systems=systems)
        good = log.dilution.position < 10.0
        assert good.mean() > 0.5  # BeiDou alone is thin over Spitsbergen
        errors[systems] = np.sqrt(np.square(log.fixes[good, :3] - obs.reference()).sum(-1).mean())
    assert max(errors.values()) < 4.0
    assert errors["CG"] < max(errors["C"], errors["G"])
