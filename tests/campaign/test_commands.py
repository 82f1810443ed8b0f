"""``celnav run`` and ``celnav campaign`` from a user's view."""

from __future__ import annotations

import csv
import re
import shutil

import numpy as np
import pandas as pd
import pytest
from machine import mounted

import celnav.study.store as stores
from celnav import cli
from celnav.campaign import campaign, serial
from celnav.campaign.figures import figures
from celnav.campaign.missions import read
from celnav.campaign.page import write
from celnav.files import Outputs, locked
from celnav.papers import csrukf

MISSION = """
title = "A <short> mission"
paper = "csrukf"
filters = ["srukf", "csrukf"]
runs = 12
[config]
steps = 20
phi = 0.8
"""
STUDY = MISSION.replace(
    "phi = 0.8", 'first_noise = ["R", "stationary"]\nsigma_km = [0.1, 0.2, 0.4]'
)


@pytest.fixture(autouse=True)
def whole(monkeypatch, tmp_path):
    monkeypatch.setenv("CELNAV_EFFORT", "1")
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def mission(tmp_path):
    path = tmp_path / "my mission.toml"
    path.write_text(MISSION)
    return path


@pytest.fixture
def sweep(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(STUDY)
    return path


@pytest.fixture
def undrawn(monkeypatch):
    """Replace figures by nothing, because drawing takes most of the time of a small study."""
    monkeypatch.setattr("celnav.show.drawing.render", lambda drawing, kind: b"")


def files(folder):
    return {
        str(p.relative_to(folder))
        for p in folder.rglob("*")
        if p.is_file() and not p.name.startswith(".")
    }


def test_a_mission_is_flown_and_everything_is_written(mission, tmp_path, capsys, monkeypatch):
    with monkeypatch.context() as patch:  # empty figures, which the second run replaces
        patch.setattr("celnav.show.drawing.render", lambda drawing, kind: b"")
        assert cli.main(["run", str(mission)]) == 0
    assert cli.main(["run", str(mission)]) == 0
    out = tmp_path / "out" / "missions" / "my-mission"
    drawn = {
        f"figures/{stem}.{kind}"
        for kind in ("png", "svg")
        for stem in (
            "accuracy_position",
            "accuracy_velocity",
            "consistency",
            "time_position",
            "time_velocity",
            "errors",
        )
    }
    assert files(out) == drawn | {
        "table.csv",
        "table.parquet",
        "times.csv",
        "summary.txt",
        "index.html",
        "mission.rrd",
        "mission.json",
    }
    printed = capsys.readouterr().out
    assert "12/12 runs" in printed
    assert (out / "summary.txt").read_text() in printed
    page = (out / "index.html").read_text()
    assert "A &lt;short&gt; mission" in page
    assert page.count("<img") == 6
    assert "http" not in page
    assert all((out / name).stat().st_size > 1000 for name in drawn)
    with (out / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["filter"] for row in rows] == ["srukf", "csrukf"]
    assert float(rows[1]["anees"]) < 2 < float(rows[0]["anees"])
    frame = pd.read_parquet(out / "table.parquet")
    np.testing.assert_array_equal(
        frame["position_rms_km"], [float(row["position_rms_km"]) for row in rows]
    )


def test_a_campaign_writes_a_row_for_each_configuration_and_filter_and_resumes(
    sweep, undrawn, tmp_path, capsys
):
    assert cli.main(["campaign", str(sweep), "--jobs", "1", "--out", "here"]) == 0
    first = capsys.readouterr().out
    frame = pd.read_parquet(tmp_path / "here" / "table.parquet")
    assert len(frame) == 2 * 3 * 2
    assert list(frame.columns[:5]) == ["first_noise", "sigma_km", "filter", "runs", "failed"]
    assert {
        "position_rms_km",
        "position_low_km",
        "position_high_km",
        "position_bound_km",
        "position_efficiency",
        "anees",
        "band_low",
    } <= set(frame.columns)
    assert (frame.runs == 12).all()
    better = frame[frame.first_noise == "stationary"].position_bound_km
    assert (better.diff().dropna() >= 0).all()  # a worse sensor, a larger bound
    content = (tmp_path / "here" / "table.csv").read_bytes()
    assert cli.main(["campaign", str(sweep), "--jobs", "1", "--out", "here"]) == 0
    again = capsys.readouterr().out
    assert "0/72 runs" in first
    assert "72/72 runs" in again
    assert again.index("72/72 runs") == again.index("runs") - 6  # there was no work left
    assert (tmp_path / "here" / "table.csv").read_bytes() == content
    times = pd.read_csv(tmp_path / "here" / "times.csv")
    assert (times.us_per_run_step > 0).all()


def test_the_figures_of_a_sweep_show_the_numbers_of_its_table(sweep, tmp_path):
    outcome = campaign(read(sweep), tmp_path / "store")
    drawn = figures(outcome)
    assert list(drawn) == [
        "accuracy_position",
        "accuracy_velocity",
        "consistency",
        "time_position",
        "time_velocity",
    ]
    fig = drawn["accuracy_position"]
    assert [ax.get_title() for ax in fig.axes] == [
        "(a) first_noise = R",
        "(b) first_noise = stationary",
    ]
    for ax, noise in zip(fig.axes, ("R", "stationary"), strict=True):
        for name, container in zip(("srukf", "csrukf"), ax.containers, strict=True):
            rows = [
                row for row in outcome.rows if row["filter"] == name and row["first_noise"] == noise
            ]
            np.testing.assert_array_equal(container[0].get_xdata(), [0.1, 0.2, 0.4])
            np.testing.assert_array_equal(
                container[0].get_ydata(), [row["position_rms_km"] for row in rows]
            )


def test_where_the_first_exception_came_from_is_on_the_page(mission, tmp_path, monkeypatch):
    trial = csrukf.trial

    def broken(config, rngs):
        if len(rngs) > 1:
            raise ValueError("no <such> star")
        return trial(config, rngs)

    monkeypatch.setattr(csrukf, "trial", broken)
    outcome = campaign(read(mission), tmp_path / "store")
    assert [row["failed"] for row in outcome.rows] == [0, 0]  # single runs can be simulated
    write(outcome, {}, Outputs(tmp_path / "store"))
    page = (tmp_path / "store" / "index.html").read_text()
    assert "<h2>The first exception</h2><pre>Traceback" in page
    assert "ValueError: no &lt;such&gt; star" in page


def test_the_effort_scales_the_runs(mission, undrawn, capsys):
    assert cli.main(["campaign", str(mission), "--jobs", "1", "--effort", "0.2"]) == 0
    assert "2/2 runs" in capsys.readouterr().out
    assert cli.main(["campaign", str(mission), "--jobs", "1"]) == 0
    assert "12/12 runs" in capsys.readouterr().out  # fewer runs do not make another study
    assert cli.main(["campaign", str(mission), "--jobs", "1", "--effort", "0.2"]) == 2
    assert "belongs to another study (runs: 12 -> 2)" in capsys.readouterr().err


def test_a_mission_of_failures_only_has_a_page_and_reasons(mission, tmp_path, capsys):
    mission.write_text(MISSION.replace("runs = 12", "runs = 3\nlimits = { position = 1e-9 }"))
    assert cli.main(["run", str(mission)]) == 1
    printed = capsys.readouterr().out
    assert "srukf: failed: 3 x position: error above 1e-09 km at the end" in printed
    assert (
        "3 x position: error above 1e-09 km at the end"
        in (tmp_path / "out" / "missions" / "my-mission" / "table.csv").read_text()
    )


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["run"], 2, "MISSION.toml"),
        (["run", "absent.toml"], 2, "absent.toml"),
        (["run", "."], 2, "."),
        (
            ["run", "sweep.toml"],
            2,
            "config.first_noise, config.sigma_km: a list of values is a study; use: celnav "
            "campaign",
        ),
        (
            ["run", "mission.toml", "--jobs", "0"],
            2,
            "celnav: --jobs: expected a whole number of at least 1, got '0'",
        ),
        (
            ["run", "mission.toml", "--effort", "2"],
            2,
            "effort: expected a number in (0, 1], got '2'",
        ),
        (
            ["run", "wrong.toml"],
            2,
            "wrong.toml: config.sigma_km (km): expected a positive number, got -1.0",
        ),
        (
            ["campaign", "sweep.toml", "--jobs", "-1"],
            2,
            "jobs: expected a whole number of at least 1",
        ),
        (
            ["campaign", "sweep.toml", "--jobs", "many"],
            2,
            "jobs: expected a whole number of at least 1",
        ),
        (
            ["campaign", "sweep.toml", "--executor", "slurm"],
            2,
            "expected one of processes, dask, got 'slurm'",
        ),
        (
            ["campaign", "sweep.toml", "--address", "tcp://127.0.0.1:1"],
            2,
            "--address: expected --executor dask with it",
        ),
        (["campaign", "wrong.toml"], 2, "wrong.toml: config.sigma_km"),
        (["campaign", "sweep.toml", "--out", "sweep.toml"], 2, "sweep.toml"),
        (["list", "csrkf"], 2, "did you mean csrukf?"),
        (["view", "absent.rrd"], 2, "absent.rrd: no such recording"),
    ],
)
def test_a_mistake_is_one_line_and_an_exit_code(
    mission, sweep, tmp_path, capsys, arguments, status, text
):
    shutil.copy(mission, tmp_path / "mission.toml")
    (tmp_path / "wrong.toml").write_text('paper = "csrukf"\n[config]\nsigma_km = -1')
    try:
        found = cli.main(arguments)
    except SystemExit as stop:
        found = stop.code
    error = capsys.readouterr().err
    assert found == status
    assert text in error
    assert "Traceback" not in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists() or not files(tmp_path / "out")


def test_a_scheduler_that_is_not_there_is_one_line(sweep, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("celnav.campaign.executors.PATIENCE_S", 1.0)
    assert (
        cli.main(["campaign", str(sweep), "--executor", "dask", "--address", "tcp://127.0.0.1:1"])
        == 1
    )
    captured = capsys.readouterr()
    assert "tcp://127.0.0.1:1" in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""  # no progress is printed


@pytest.mark.parametrize("address", ["nonsense", "ftp://127.0.0.1:1", "tcp://", "127.0.0.1:70000"])
def test_an_address_that_is_none_is_one_line(sweep, capsys, address):
    assert cli.main(["campaign", str(sweep), "--executor", "dask", "--address", address]) == 2
    assert (
        capsys.readouterr().err == f"celnav: --address: expected tcp://HOST:PORT, got {address!r}\n"
    )


def test_a_second_campaign_in_a_folder_is_told(sweep, tmp_path, capsys):
    (tmp_path / "here").mkdir()
    with locked(tmp_path / "here"):
        assert cli.main(["campaign", str(sweep), "--out", "here", "--jobs", "1"]) == 1
    assert "here: in use by another celnav process" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["table.csv", "index.html", "figures/accuracy_position.png"])
def test_a_foreign_file_is_told_before_anything_is_computed(sweep, tmp_path, capsys, name):
    path = tmp_path / "here" / name
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    assert cli.main(["campaign", str(sweep), "--out", "here", "--jobs", "1"]) == 2
    captured = capsys.readouterr()
    assert f"here/{name}: exists, and celnav did not write it" in captured.err
    assert "runs" not in captured.out
    assert path.read_text() == "mine"


def test_a_full_disk_names_the_file_and_keeps_what_is_done(sweep, tmp_path, capsys, monkeypatch):
    replacing, count = stores.replacing, []

    def full(path):
        count.append(path)
        if len(count) == 4:
            raise OSError(28, "no space left to write the file", str(path))
        return replacing(path)

    monkeypatch.setattr(stores, "replacing", full)
    assert cli.main(["campaign", str(sweep), "--out", "here", "--jobs", "1"]) == 1
    error = capsys.readouterr().err
    assert error == f"celnav: {count[3]}: no space left to write the file\n"
    assert len(list((tmp_path / "here" / "units").iterdir())) == 3
    monkeypatch.setattr(stores, "replacing", replacing)
    done = []
    campaign(read(sweep), tmp_path / "here", progress=lambda runs, total: done.append(runs))
    assert done == [36, 48, 60, 72]


def test_a_limit_of_file_sizes_names_the_file_and_keeps_what_is_done(
    sweep, undrawn, tmp_path, capsys
):
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    words = ["campaign", str(sweep), "--out", "here", "--jobs", "1"]
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        assert cli.main(words) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    error = capsys.readouterr().err
    assert re.fullmatch(
        r"celnav: here/units/\w+\.npz: larger than the limit of file sizes; raise the limit "
        r"\(ulimit -f\), or choose another file system\n",
        error.splitlines(keepends=True)[-1],
    )
    assert not list((tmp_path / "here").rglob(".celnav-*"))
    assert not list((tmp_path / "here" / "units").iterdir())
    assert cli.main(words) == 0


def test_a_small_file_system_that_is_full_is_one_line(sweep, tmp_path, capsys):
    with mounted(tmp_path / "small", "size=64k"):
        assert cli.main(["campaign", str(sweep), "--out", "small", "--jobs", "1"]) == 1
        error = capsys.readouterr().err
        assert "no space left to write the file" in error
        assert "small" in error
        assert error.count("\n") == 1
        done = list((tmp_path / "small" / "units").glob("*.npz"))
        assert done
        assert not list((tmp_path / "small").rglob(".celnav-*"))


def test_a_folder_that_cannot_be_written_is_told_before_anything_is_computed(
    sweep, tmp_path, capsys
):
    with mounted(tmp_path / "fixed", "ro"):
        assert cli.main(["campaign", str(sweep), "--out", "fixed", "--jobs", "1"]) == 1
        captured = capsys.readouterr()
    assert "fixed" in captured.err
    assert captured.err.count("\n") == 1
    assert "runs" not in captured.out


def test_the_parameters_of_a_paper_are_listed_with_units(capsys):
    assert cli.main(["list", "ssukf"]) == 0
    printed = capsys.readouterr().out
    assert "drift_deg_per_h = 0.02 deg/h stationary standard deviation of the gyro's" in printed
    assert "preset 100 Hz: preintegrated = false\n" in printed


def test_a_thousand_processes_are_not_started(mission, undrawn, capsys, monkeypatch):
    started = []

    def processes(jobs):
        started.append(jobs)
        return serial()

    monkeypatch.setattr("celnav.campaign.executors.processes", processes)
    monkeypatch.setattr("celnav.commands.arguments.cores", lambda: 2)
    assert cli.main(["campaign", str(mission), "--jobs", "1000", "--effort", "0.2"]) == 0
    assert started == [8]
    assert (
        "--jobs: 1000 processes on 2 cores would slow each other down; 8 are started"
        in capsys.readouterr().err
    )


def test_results_of_another_file_are_not_replaced(mission, sweep, undrawn, tmp_path, capsys):
    """Results of another mission are not replaced, nor a mission's by a campaign or the reverse;
    results of the same file are.
    """
    other = tmp_path / "other" / mission.name
    other.parent.mkdir()
    other.write_text(MISSION.replace("0.8", "0.5"))
    assert cli.main(["run", str(mission)]) == 0
    mission.write_text(MISSION.replace("0.8", "0.7"))
    assert cli.main(["run", str(mission)]) == 0
    kept = (tmp_path / "out" / "missions" / "my-mission" / "table.csv").read_bytes()
    capsys.readouterr()
    assert cli.main(["run", str(other)]) == 2
    assert f"contains the mission {mission}; choose another --out" in capsys.readouterr().err
    assert cli.main(["campaign", str(sweep), "--out", "out/missions/my-mission"]) == 2
    assert "contains a mission; choose another --out" in capsys.readouterr().err
    assert (tmp_path / "out" / "missions" / "my-mission" / "table.csv").read_bytes() == kept
    assert cli.main(["campaign", str(sweep), "--jobs", "1"]) == 0
    assert cli.main(["run", str(mission), "--out", "out/campaigns/sweep"]) == 2
    assert "contains a campaign; choose another --out" in capsys.readouterr().err


def test_a_file_where_a_folder_should_be_is_told_before_flying(mission, tmp_path, capsys):
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "figures").write_text("mine")
    assert cli.main(["run", str(mission), "--out", "here"]) == 2
    assert capsys.readouterr().err == "celnav: here/figures: expected a folder to write to\n"
