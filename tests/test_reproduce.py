"""``celnav reproduce`` with real processes: interrupted, killed, twice at once, on a full and on a read-only disk."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from machine import children, gone, interruptible, mounted
from test_cli import tiny

from celnav import cli, papers

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
SCRIPT = f"""
import sys, time
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_cli import numbers, tiny
from celnav import cli, papers


def slow(size, rngs):
    time.sleep(0.4)
    with open({{log!r}}, "a") as file:
        file.write("x")
    return numbers(size, rngs)


module = tiny(work=slow, blocks=8)
papers.PAPERS = {{{{"tiny": "tiny"}}}}
papers.import_module = lambda name: module
if __name__ == "__main__":
    raise SystemExit(cli.main(sys.argv[1:]))
"""


def start(folder, out):
    """Reproduce a paper of eight slow units in two processes; returns when two units are done."""
    script = folder / "script.py"
    script.write_text(SCRIPT.format(log=str(folder / "log")))
    given = ["reproduce", "--out", str(out), "--effort", "1", "--jobs", "2"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(
        interruptible(str(script), *given), **pipes, text=True, start_new_session=True
    )
    seen = ""
    while seen.count("tiny: all") < 2:
        line = process.stdout.readline()
        assert line, f"{seen}{process.communicate()}"
        seen += line
    return process, children(process.pid)


def finished(folder, out):
    """Run it to the end."""
    process, _ = start(folder, out)
    process.communicate(timeout=60)
    assert process.returncode == 0
    assert (out / "index.html").exists()
    assert (out / "tiny/claims.json").exists()
    assert not list(out.rglob(".celnav-*"))
    assert not list(out.rglob("*.tmp"))
    assert len(list((out / "tiny/.results/units").iterdir())) == 8


@LINUX
def test_an_interrupt_half_way_leaves_nothing_half_written_and_no_process(tmp_path):
    process, pids = start(tmp_path, tmp_path / "out")
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=30)
    assert process.returncode == 130
    assert error.splitlines()[-1] == "celnav: interrupted"
    assert gone(pids)
    left = {
        p.suffix for p in (tmp_path / "out").rglob("*") if p.is_file() and p.name != ".celnav.lock"
    }
    assert left == {".npz", ".json"}  # of what is finished
    finished(tmp_path, tmp_path / "out")


@LINUX
def test_a_killed_one_leaves_no_process_and_another_goes_on_from_there(tmp_path):
    process, pids = start(tmp_path, tmp_path / "out")
    process.kill()
    process.communicate()
    assert gone(pids)
    done = len(list((tmp_path / "out").rglob("*.npz")))
    before = len((tmp_path / "log").read_text())
    assert done >= 2
    command = [
        sys.executable,
        str(tmp_path / "script.py"),
        "reproduce",
        "--out",
        str(tmp_path / "out"),
        "--effort",
        "1",
        "--jobs",
        "2",
    ]
    again = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "was done before" in again.stdout
    assert len((tmp_path / "log").read_text()) - before == 8 - done
    alone = tmp_path / "alone"
    subprocess.run(
        [*command[:4], str(alone), "--effort", "1", "--jobs", "1"], capture_output=True, check=True
    )
    for name in ("claims.json", "checks.json", "result.npz"):
        assert (tmp_path / "out/tiny" / name).read_bytes() == (alone / "tiny" / name).read_bytes()


@LINUX
def test_a_second_one_says_so_and_stops(tmp_path):
    process, _ = start(tmp_path, tmp_path / "out")
    command = [
        sys.executable,
        str(tmp_path / "script.py"),
        "reproduce",
        "--out",
        str(tmp_path / "out"),
        "--jobs",
        "1",
    ]
    second = subprocess.run(command, capture_output=True, text=True, check=False)
    assert second.returncode == 1
    assert second.stderr.count("\n") == 1
    assert "another" in second.stderr
    process.communicate(timeout=60)
    assert process.returncode == 0


@LINUX
def test_a_killed_worker_is_replaced(tmp_path):
    process, pids = start(tmp_path, tmp_path / "out")
    os.kill(pids[-1], signal.SIGKILL)
    process.communicate(timeout=60)
    assert process.returncode == 0
    assert (tmp_path / "out/tiny/claims.json").exists()
    assert gone(pids)


@pytest.fixture
def study(monkeypatch):
    large = tiny(size=30_000)
    monkeypatch.setattr(papers, "PAPERS", {"tiny": "tiny"})
    monkeypatch.setattr("celnav.papers.import_module", lambda name: large)


def test_a_read_only_folder_is_one_line_before_anything_is_computed(study, tmp_path, capsys):
    with mounted(tmp_path / "fixed", "ro"):
        assert cli.main(["reproduce", "--out", str(tmp_path / "fixed"), "--jobs", "1"]) == 1
    captured = capsys.readouterr()
    assert "fixed" in captured.err
    assert captured.err.count("\n") == 1


def test_a_full_disk_is_one_line_and_leaves_whole_files(study, tmp_path, capsys):
    with mounted(tmp_path / "small", "size=200k"):
        assert cli.main(["reproduce", "--out", str(tmp_path / "small"), "--jobs", "1"]) == 1
        error = capsys.readouterr().err.splitlines()
        assert len(error) == 1
        assert "no space left to write the file" in error[0]
        assert ".npz" in error[0]
        left = {p.name for p in (tmp_path / "small").rglob("*") if p.is_file()}
    assert left <= {".celnav.lock", "manifest.json"}


def test_what_fails_is_one_line_and_the_rest_is_kept(study, tmp_path, monkeypatch, capsys):
    def bad(size, rngs):
        raise ValueError("no such star")

    monkeypatch.setattr("celnav.papers.import_module", lambda name: tiny(work=bad))
    assert cli.main(["reproduce", "--out", str(tmp_path), "--effort", "1", "--jobs", "1"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "2 units are not done: tiny: all, runs 0 to 1 (ValueError: no such star); " in error


@pytest.mark.parametrize("paper", papers.PAPERS)
def test_units_of_every_paper_can_be_handed_to_another_process(paper):
    units = papers.load(paper).STUDY.units(effort=0.01)
    assert [pickle.loads(pickle.dumps(unit)).key for unit in units] == [unit.key for unit in units]
    assert len({unit.key for unit in units}) == len(units)


def test_what_the_command_has_done_is_not_done_again(study, tmp_path, monkeypatch):
    module = papers.load("tiny")
    assert cli.main(["reproduce", "--out", str(tmp_path), "--effort", "0.5", "--jobs", "1"]) == 0
    fresh = module.STUDY.reproduce(effort=0.5)
    monkeypatch.setattr(
        "celnav.study.study.Unit.do", lambda unit: pytest.fail(f"{unit.title} is computed again")
    )
    for part, arrays in module.STUDY.reproduce(effort=0.5, out=tmp_path).data.items():
        for name in set(arrays) - {"cpu_s"}:
            assert arrays[name].tobytes() == fresh.get(part, name).tobytes()
    assert cli.main(["reproduce", "--out", str(tmp_path), "--effort", "0.5", "--jobs", "1"]) == 0
    with pytest.raises(pytest.fail.Exception, match="computed again"):
        module.STUDY.reproduce(effort=0.5, seed=1, out=tmp_path)


def test_what_is_at_hand_is_everything_or_a_small_part(study, tmp_path, monkeypatch):
    for name in ("CELNAV_EFFORT", "CELNAV_OUT"):
        monkeypatch.delenv(name, raising=False)
    module = papers.load("tiny")
    assert module.STUDY.at_hand(tmp_path, small=0.25).effort == 0.25
    assert cli.main(["reproduce", "--out", str(tmp_path), "--jobs", "1"]) == 0
    monkeypatch.setattr(
        "celnav.study.study.Unit.do", lambda unit: pytest.fail(f"{unit.title} is computed again")
    )
    assert module.STUDY.at_hand(tmp_path).full
    monkeypatch.setenv("CELNAV_OUT", str(tmp_path))
    assert module.STUDY.at_hand(tmp_path / "elsewhere").full
    monkeypatch.setenv("CELNAV_EFFORT", "0.5")
    with pytest.raises(pytest.fail.Exception, match="computed again"):
        module.STUDY.at_hand(tmp_path)
