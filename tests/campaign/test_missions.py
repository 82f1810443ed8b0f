"""Mission files: valid contents, and the errors for invalid ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from celnav.campaign.missions import MissionError, read, study
from celnav.campaign.typed import unit_of
from celnav.papers import PAPERS, csrukf, load
from celnav.study.trial import evaluate_filter

MISSIONS = sorted((Path(__file__).parents[2] / "data" / "missions").glob("*.toml"))


def test_every_paper_is_a_mission_by_its_name_alone():
    for paper in PAPERS:
        found, module = study({"paper": paper}), load(paper)
        first = next(iter(module.PRESETS.values()))
        assert found.configurations[0].config == replace(first, **getattr(module, "MISSION", {}))
        assert found.filters == tuple(module.filters(first))
        assert (found.runs, found.seed, found.title, found.swept) == (
            first.runs,
            0,
            module.TITLE,
            {},
        )


@pytest.mark.parametrize("path", MISSIONS, ids=lambda p: p.stem)
def test_the_missions_that_come_along_can_be_read(path):
    found = read(path)
    assert found.title
    assert all(
        point.config not in load(found.paper).PRESETS.values() for point in found.configurations
    )


def test_there_are_three_missions_and_a_study():
    assert sum(not read(path).swept for path in MISSIONS) == 3
    assert sum(bool(read(path).swept) for path in MISSIONS) == 1


def test_lists_make_a_grid_whose_last_key_changes_fastest():
    found = study(
        {"paper": "csrukf", "config": {"phi": [0.0, 0.5], "sigma_km": [1, 2, 3], "steps": 10.0}}
    )
    assert found.swept == {"phi": (0.0, 0.5), "sigma_km": (1.0, 2.0, 3.0)}
    assert [tuple(p.values.values()) for p in found.configurations] == [
        (f, s) for f in (0.0, 0.5) for s in (1.0, 2.0, 3.0)
    ]
    for point in found.configurations:
        assert (point.config.phi, point.config.sigma_km, point.config.steps) == (
            *point.values.values(),
            10,
        )
        assert isinstance(point.config.sigma_km, float)


def test_a_list_is_the_value_of_a_parameter_that_is_one_and_a_list_of_lists_sweeps_it():
    one = study({"paper": "ssukf", "config": {"prior_deg": [1, 2, 3]}})
    assert one.swept == {}
    assert one.configurations[0].config.prior_deg == (1.0, 2.0, 3.0)
    two = study({"paper": "ssukf", "config": {"prior_deg": [[1, 2, 3], [4, 5, 6]]}})
    assert two.swept == {"prior_deg": ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))}
    inertia = [[52.0, 0, 0], [0, 47.0, 0], [0, 0, 61.0]]
    assert study({"paper": "ssukf", "config": {"inertia": inertia}}).swept == {}
    assert (
        len(
            study(
                {"paper": "tstdkf", "config": {"pulsars": [["B0531+21", "B1821-24", "B1937+21"]]}}
            ).configurations
        )
        == 1
    )


def test_tables_within_the_configuration_have_dotted_keys():
    found = study(
        {
            "paper": "tstdkf",
            "config": {"setting": {"F": [0.0, 0.5], "kappa": 1.0}, "pulled": [True, False]},
        }
    )
    assert found.swept == {"setting.F": (0.0, 0.5), "pulled": (True, False)}
    assert [
        (p.config.setting.F, p.config.setting.L, p.config.setting.kappa)
        for p in found.configurations[::2]
    ] == [(0.0, 0.5, 1.0), (0.5, 0.5, 1.0)]


def test_everything_else_can_be_chosen():
    found = study(
        {
            "paper": "csrukf",
            "preset": "stress",
            "title": "T",
            "filters": ["csrukf"],
            "runs": 7,
            "seed": 3,
            "block": 2,
            "every": 5,
            "settle_s": 10,
            "limits": {"position": 2},
        }
    )
    assert (found.title, found.filters, found.runs, found.seed, found.block, found.every) == (
        "T",
        ("csrukf",),
        7,
        3,
        2,
        5,
    )
    assert (found.settle_s, found.limits) == (10.0, {"position": 2.0})
    assert found.configurations[0].config.noise_position_km == 0.2


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, r"paper: expected one of csrukf, .*, got none"),
        (
            {"paper": "csrukf", "config": {"camera_deg": [0.1, 0.2]}},
            r".*camera_deg \(deg\): has no effect if",
        ),
        (
            {"paper": "csrukf", "config": {"measured": "angles", "sigma_km": 1.0}},
            r".*sigma_km \(km\): has no effect",
        ),
        (
            {"paper": "aukf", "preset": "quiet", "config": {"burst_sigma": 9.0}},
            r".*burst_sigma: has no effect without",
        ),
        (
            {"paper": "csrukf", "config": {"semi_major_axis_km": 7136635.0}},
            r".*axis_km \(km\): expected a number below 1e\+06",
        ),
        (
            {"paper": "csrukf", "config": {"semi_major_axis_km": 100.0}},
            r".*orbit above the Earth, from 6384",
        ),
        (
            {"paper": "csrukf", "config": {"inclination_deg": 400.0}},
            r".*inclination_deg \(deg\): expected a number of at least",
        ),
        (
            {"paper": "csrukf", "config": {"step_s": 0.0}},
            r"config.step_s \(s\): expected a positive number, got 0.0",
        ),
        ({"paper": "csrkf"}, r"paper: unknown paper 'csrkf'.*did you mean csrukf\?"),
        ({"paper": 3}, r"paper: expected a word, got 3"),
        ({"paper": "csrukf", "filter": []}, r"filter: unknown key; did you mean filters\?"),
        ({"paper": "csrukf", "wrong": 1}, r"wrong: unknown key; expected one of title, paper, "),
        ({"paper": "csrukf", "preset": "Q"}, r"preset: expected one of P, D, .*, got 'Q'"),
        ({"paper": "csrukf", "filters": "srukf"}, r"filters: expected a list, got 'srukf'"),
        ({"paper": "csrukf", "filters": []}, r"filters: expected some of srukf, .*, got none"),
        (
            {"paper": "csrukf", "settle_s": float("nan")},
            r"settle_s \(s\): expected a number, got nan",
        ),
        (
            {"paper": "csrukf", "settle_s": -5.0},
            r"settle_s \(s\): expected a number that is not negative, got -5.0",
        ),
        (
            {"paper": "csrukf", "limits": {"position": float("nan")}},
            r"limits.position: expected a number, got nan",
        ),
        (
            {"paper": "csrukf", "runs": 10**12},
            r"runs: expected at most 1000000 blocks of runs in all, got 10000000000",
        ),
        (
            {"paper": "csrukf", "settle_s": 601.0},
            r"settle_s \(s\): expected at most 600, the end of the run, got 601",
        ),
        (
            {"paper": "csrukf", "settle_s": 60.0, "config": {"steps": [100, 50]}},
            r"settle_s \(s\): expected at most 50, the end of the run where steps = 50, got 60",
        ),
        (
            {"paper": "aukf", "config": {"duration_s": 1e9}},
            r"config.duration_s \(s\): .* 1 to 10000000 steps, got 1e\+10",
        ),
        (
            {"paper": "aukf", "config": {"window": 10**9}},
            r"config.window: expected an integer from 1 to 100000, got 1000000000",
        ),
        (
            {"paper": "tstdkf", "config": {"pulsars": []}},
            r"config.pulsars: expected 3 names, got none",
        ),
        (
            {"paper": "aukf", "config": {"duration_s": 0.01}},
            r"config.duration_s \(s\): expected a run of 1 to .*, got 0.1",
        ),
        (
            {"paper": "ssukf", "config": {"duration_s": 1e9}},
            r"config.duration_s \(s\): .* 1 to 10000000 steps, got 4000000000",
        ),
        (
            {"paper": "ssukf", "config": {"gyro_hz": 4e9}},
            r"config.duration_s \(s\): .* 1 to 10000000 steps, got 2.4e",
        ),
        (
            {"paper": "tstdkf", "config": {"days": 1e9}},
            r"config.days: .* 1 to 10000000 steps, got 2.88e\+11",
        ),
        (
            {"paper": "tstdkf", "config": {"days": 1e-5}},
            r"config.days: .* 1 to 10000000 steps, got 0.00288",
        ),
        (
            {"paper": "aasghqf", "config": {"steps": 10**9}},
            r"config.steps: .* 1 to 10000000, got 1000000000",
        ),
        (
            {"paper": "csrukf", "config": {"steps": 10**9}},
            r"config.steps: .* 1 to 10000000, got 1000000000",
        ),
        (
            {"paper": "csrukf", "config": {"steps": [5, 10**7]}, "runs": 40},
            r"block: expected at most 200000000 steps at once, got 40 runs of 10000000 steps where "
            r"steps = 10000000; a",
        ),
        (
            {"paper": "ssukf", "config": {"inertia": [[1, 0, 0], [0, 1, 0], [0, 0, 10]]}},
            r"config.inertia: expected principal moments that satisfy the triangle inequality, got 1, 1 and 10$",
        ),
        ({"paper": "csrukf", "phi": 0.8}, r"phi: expected it under \[config\]"),
        (
            {"paper": "csrukf", "config": {"settle_s": 5.0}},
            r"config.settle_s: expected settle_s at the top of the file, outside of \[config\]",
        ),
        (
            {"paper": "csrukf", "config": {"first_noise": "white"}},
            r"config.first_noise: expected one of R, stationary, zero, got 'white'",
        ),
        (
            {
                "paper": "csrukf",
                "config": {"first_noise": "stationary", "noise_level": "increments", "phi": 1.0},
            },
            r"config.first_noise: expected R or zero for phi = 1",
        ),
        (
            {"paper": "csrukf", "config": {"eccentricity": 1.5}},
            r"config.eccentricity: expected a number of at least 0 and below 1",
        ),
        (
            {"paper": "csrukf", "config": {"sigma_km": 1e200}},
            r"config: expected numbers that can be computed with",
        ),
        (
            {"paper": "tstdkf", "config": {"setting": {"F": 2.0}}},
            r"config: F: expected a diagonal matrix .*\], \[0",
        ),
        ({"paper": "csrukf", "filters": ["srukf", "srukf"]}, r"filters: expected different names"),
        (
            {"paper": "csrukf", "filters": ["sruk"]},
            r"filters: expected some of srukf, .*, got 'sruk'; did you mean srukf\?",
        ),
        ({"paper": "csrukf", "runs": 0}, r"runs: expected a whole number of at least 1, got 0"),
        ({"paper": "csrukf", "runs": 1.5}, r"runs: expected a whole number, got 1.5"),
        ({"paper": "csrukf", "runs": True}, r"runs: expected a whole number, got True"),
        ({"paper": "csrukf", "runs": float("inf")}, r"runs: expected a whole number, got inf"),
        ({"paper": "csrukf", "runs": 10**400}, r"runs: expected a whole number, got 1000"),
        (
            {"paper": "csrukf", "config": {"sigma_km": 10**400}},
            r"config.sigma_km \(km\): expected a number, got 1000",
        ),
        ({"paper": "csrukf", "seed": -1}, r"seed: expected a whole number of at least 0, got -1"),
        ({"paper": "csrukf", "settle_s": "x"}, r"settle_s \(s\): expected a number, got 'x'"),
        (
            {"paper": "csrukf", "limits": {"position": 0}},
            r"limits.position: expected a positive number, got 0.0",
        ),
        (
            {"paper": "csrukf", "limits": {"positon": 1}},
            r"limits.positon: unknown key; did you mean limits.position\?",
        ),
        ({"paper": "csrukf", "limits": 3}, r"limits: expected a table, got 3"),
        ({"paper": "csrukf", "config": 3}, r"config: expected a table, got 3"),
        (
            {"paper": "csrukf", "config": {"runs": 3}},
            r"config.runs: expected runs at the top of the file",
        ),
        (
            {"paper": "csrukf", "config": {"sigma": 1}},
            r"config.sigma: unknown key; did you mean config.sigma_km\?",
        ),
        (
            {"paper": "csrukf", "config": {"sigma_km": "x"}},
            r"config.sigma_km \(km\): expected a number, got 'x'",
        ),
        (
            {"paper": "csrukf", "config": {"sigma_km": -1}},
            r"config.sigma_km \(km\): expected a positive number, got -1.0",
        ),
        (
            {"paper": "csrukf", "config": {"sigma_km": []}},
            r"config.sigma_km: expected at least one value, got an empty list",
        ),
        (
            {"paper": "csrukf", "config": {"sigma_km": [1, 1.0]}},
            r"config.sigma_km: expected different values",
        ),
        (
            {"paper": "csrukf", "config": {"sigma_km": [[1]]}},
            r"config.sigma_km \(km\): expected a number, got \[1\]",
        ),
        (
            {"paper": "csrukf", "config": {"sigma_km": float("nan")}},
            r"config.sigma_km \(km\): expected a number, got nan",
        ),
        (
            {"paper": "csrukf", "config": {"sigma_km": [1, -1], "phi": 0.5}},
            r"config.sigma_km \(km\): expected a positive",
        ),
        (
            {"paper": "csrukf", "config": {"sigma_km": [1, 2], "phi": [0.5, 2]}},
            r"config.phi: .* 2.0 \(where sigma_km = 1.0\)",
        ),
        (
            {"paper": "csrukf", "config": {"measured": "radar"}},
            r"config.measured: expected one of positions, angles, got 'radar'",
        ),
        (
            {"paper": "ssukf", "config": {"prior_deg": [1, 2]}},
            r"config.prior_deg \(deg\): expected 3 values, got 2",
        ),
        (
            {"paper": "ssukf", "config": {"prior_deg": 1}},
            r"config.prior_deg \(deg\): expected a list, got 1",
        ),
        (
            {"paper": "ssukf", "config": {"preintegrated": 1}},
            r"config.preintegrated: expected true or false, got 1",
        ),
        (
            {"paper": "ssukf", "config": {"tau_s": True}},
            r"config.tau_s \(s\): expected a number, got True",
        ),
        ({"paper": "tstdkf", "config": {"setting": 1}}, r"config.setting: expected a table, got 1"),
        (
            {"paper": "tstdkf", "config": {"setting": {"G": 1}}},
            r"config.setting.G: unknown key; expected one of F, L, kappa",
        ),
        (
            {
                "paper": "csrukf",
                "config": {"phi": [i * 1e-4 for i in range(400)], "sigma_km": list(range(1, 300))},
            },
            r"config: expected at most 100000 configurations, got 119600",
        ),
    ],
)
def test_what_cannot_be_is_refused_by_key_and_unit(table, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        study(table)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"paper = ", r"mission.toml: not a TOML file \(Invalid value"),
        (b"\xff\xfe", r"mission.toml: not a TOML file \("),
        (b"paper = " + b"[" * 5000 + b"]" * 5000, r"mission.toml: "),
        (b"#" * 1_000_001, r"mission.toml: not a TOML file \(expected at most 1000000 bytes"),
        (
            b'paper = "csrukf"\n[config]\nsigma_km = -1',
            r"mission.toml: config.sigma_km \(km\): expected a positive number, got -1.0",
        ),
    ],
)
def test_a_file_that_cannot_be_used_is_named(tmp_path, content, message):
    path = tmp_path / "mission.toml"
    path.write_bytes(content)
    with pytest.raises(MissionError, match=message):
        read(path)


def test_a_filter_of_some_configurations_is_known_and_one_of_none_is_not():
    config = {"phi": [1.0, 0.5], "noise_level": "increments", "steps": 5}
    assert study({"paper": "csrukf", "filters": ["srukf-reff"], "config": config}).filters == (
        "srukf-reff",
    )
    with pytest.raises(ValueError, match=r"^filters: .*got 'srukf-reff'"):
        study({"paper": "csrukf", "filters": ["srukf-reff"], "config": config | {"phi": 1.0}})


def test_the_effort_scales_the_runs(tmp_path):
    path = tmp_path / "mission.toml"
    path.write_text('paper = "csrukf"\nruns = 50')
    assert [read(path, effort).runs for effort in (1.0, 0.1, 0.001)] == [50, 5, 2]


def test_units_are_read_from_the_names():
    names = {
        "sigma_km": "km",
        "speed_m_per_s": "m/s",
        "drift_deg_per_h": "deg/h",
        "acceleration_m_per_s2": "m/s^2",
        "gyro_hz": "Hz",
        "angle_walk_deg_per_sqrt_h": "deg/sqrt(h)",
        "velocity_walk_ug_per_sqrt_hz": "ug/sqrt(Hz)",
        "tau_s": "s",
        "acceleration_noise_m2_per_s3": "m^2/s^3",
        "steps": "",
        "phi": "",
        "runs": "",
        "alpha": "",
        "acceleration_g": "g",
        "orbit_rate_rad_per_s": "rad/s",
    }
    assert {name: unit_of(name) for name in names} == names


def test_what_a_study_says_of_itself_differs_where_the_study_does():
    def said(**more):
        return study(
            {"paper": "csrukf", "config": {"steps": 5, "phi": [0.0, 0.5]} | more.pop("config", {})}
            | more
        ).to_dict()

    base = said()
    assert base == said()
    for more in (
        {"runs": 5},
        {"seed": 1},
        {"block": 3},
        {"every": 2},
        {"settle_s": 1.0},
        {"limits": {"position": 1.0}},
        {"filters": ["srukf"]},
        {"preset": "D"},
        {"config": {"phi": [0.0, 0.6]}},
        {"config": {"steps": 6}},
    ):
        assert said(**more) != base


def test_a_parameter_that_works_somewhere_may_be_swept():
    """The camera matters in half of these configurations."""
    found = study(
        {
            "paper": "csrukf",
            "config": {"measured": ["positions", "angles"], "camera_deg": [0.1, 0.2]},
        }
    )
    assert len(found.configurations) == 4


@pytest.mark.parametrize("measured", ["positions", "angles"])
def test_the_color_of_the_noise_does_not_change_how_large_it_is(measured):
    """If the mission file specifies increments instead, these stay fixed and the noise grows with
    the correlation.
    """
    key, value = {"positions": ("sigma_km", 0.1), "angles": ("camera_deg", 0.01)}[measured]
    config = {"phi": [0.0, 0.8, 0.95], key: value, "measured": measured, "steps": 400}
    rngs = [np.random.default_rng(i) for i in range(50)]
    stds = {}
    for level in ({}, {"noise_level": "stationary"}, {"noise_level": "increments"}):
        points = study({"paper": "csrukf", "config": config | level}).configurations
        stds[level.get("noise_level")] = [
            csrukf.simulate(p.config, rngs).noise.std((0, 1)) for p in points
        ]
    given = points[0].config.sigma if measured == "angles" else np.full(3, 0.1)
    for name in (None, "stationary"):
        np.testing.assert_allclose(stds[name], np.tile(given, (3, 1)), rtol=0.05)
    grown = 1.0 / np.sqrt(1.0 - np.square([[0.0], [0.8], [0.95]]))
    np.testing.assert_allclose(stds["increments"], grown * given, rtol=0.06)


@pytest.mark.parametrize("measured", ["positions", "angles"])
def test_filters_are_told_how_large_the_noise_is(measured):
    """The exact filter is consistent, and a filter that treats the noise as white uses its true
    variance.
    """
    trials = {}
    for phi in (0.0, 0.9):
        config = {
            "phi": phi,
            "measured": measured,
            "steps": 40,
            "prior_position_km": 1.0,
            "noise_position_km": 1e-4,
        }
        (point,) = study({"paper": "csrukf", "config": config}).configurations
        trials[phi] = csrukf.trial(point.config, [np.random.default_rng(i) for i in range(300)])
    exact = "csrukf+z0" if measured == "positions" else "angles+z0"
    white = "srukf" if measured == "positions" else "srukf-isotropic"
    assert evaluate_filter(trials[0.9], exact).nees[-1].mean() / 6 == pytest.approx(1.0, abs=0.1)
    stds = [evaluate_filter(trial, white).std[-1, 0, :3] for trial in trials.values()]
    np.testing.assert_allclose(*stds, rtol=1e-6)


@pytest.mark.parametrize(
    ("paper", "config"),
    [
        ("csrukf", {"steps": 5, "step_s": 0.3}),
        ("ssukf", {"duration_s": 1.1, "star_hz": 5.0}),
        ("ssukf", {"duration_s": 1.1, "preintegrated": False}),
        ("tstdkf", {"days": 0.02}),
        ("aasghqf", {"steps": 3, "step_s": 0.3}),
        ("aukf", {"duration_s": 0.7, "burst": "none"}),
    ],
)
def test_the_last_epoch_may_be_the_only_settled_one(paper, config):
    """Runs end at the times in their configurations."""
    last = study({"paper": paper, "config": config}).configurations[0].config.end_s
    found = study({"paper": paper, "config": config, "settle_s": last, "runs": 2})
    trial = load(paper).trial(
        found.configurations[0].config, [np.random.default_rng(i) for i in range(2)]
    )
    assert evaluate_filter(trial, found.filters[0]).times[-1] == last


def test_a_flat_plate_is_a_body():
    inertia = [[1, 0, 0], [0, 2, 0], [0, 0, 3]]
    assert (
        study({"paper": "ssukf", "config": {"inertia": inertia}})
        .configurations[0]
        .config.inertia[2][2]
        == 3.0
    )


def test_a_random_walk_has_increments_only():
    config = {"phi": [0.8, 1.0], "sigma_km": 0.1}
    with pytest.raises(
        ValueError,
        match=r"^config.noise_level: expected 'increments' for phi = 1: a random walk",
    ):
        study({"paper": "csrukf", "config": config})
    assert (
        len(
            study(
                {"paper": "csrukf", "config": config | {"noise_level": "increments"}}
            ).configurations
        )
        == 2
    )
    assert csrukf.Config(phi=1.0).noise_level == "increments"  # the paper's own
