"""``python -m benchmarks.campaign``: what a campaign costs over the bare filter, how it scales,
what it needs and survives.

overhead: CPU time of a campaign in one process over that of the bare batched filter on the same
runs, and over the filter with errors and NEES taken down by hand; block by block in turn.
scaling: wall time with one process over that with two; and of the bare filter, in one and in two
    processes that know nothing of
each other: what the machine has to give.
memory: peak of 1,000 and of 100,000 runs. kills: the table after kill -9 at random moments, 20
    times.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

from celnav.campaign import campaign, from_executor, processes, serial
from celnav.campaign.missions import MissionStudy, study
from celnav.campaign.units import STUDY
from celnav.filters.records import Epoch
from celnav.filters.run import run
from celnav.gaussian.belief import nees
from celnav.papers.csrukf import trial
from celnav.study.montecarlo import blocks, generator
from celnav.study.study import Unit

FILTER = "csrukf+z0"


def workload(runs: int, steps: int = 600) -> MissionStudy:
    """The scenario of csrukf with colored noise, and its square-root filter in one transform."""
    return study(
        {
            "paper": "csrukf",
            "filters": [FILTER],
            "runs": runs,
            "config": {"phi": 0.8, "steps": steps},
        }
    )


def bare(work: MissionStudy) -> None:
    """The same runs, blocks and filter, and nothing else."""
    for part in blocks(work.runs, work.block):
        bare_block(work, part)


def bare_block(work: MissionStudy, part: range) -> None:
    """Simulate and filter the runs of a block."""
    made = trial(work.configurations[0].config, [generator(work.seed, STUDY, r) for r in part])
    run(made.filters[FILTER], made.prior, made.epochs(FILTER), keep="nothing", on_failure="flag")


def judged_block(work: MissionStudy, part: range) -> None:
    """The same with what a study of its own would take down at each epoch: errors, deviations,
    NEES, and NIS.
    """

    def also(epoch: Epoch, state: Any, _info: Any) -> dict[str, Any]:
        error, root = made.compare(epoch.truth, state.belief)
        return {"error": error, "nees": nees(error, root)}

    made = trial(work.configurations[0].config, [generator(work.seed, STUDY, r) for r in part])
    track = run(made.filters[FILTER], made.prior, made.epochs(FILTER), also=also, on_failure="flag")
    assert track.nis.shape == track.extra["nees"].shape


class InTurn(Executor):
    """Does each unit of a study in this process, and in turn with it the bare work of the same
    runs, and the judged one.
    """

    def __init__(self, work: MissionStudy) -> None:
        self._work = work
        self.times: dict[str, list[float]] = {"bare": [], "judged": [], "unit": []}

    def submit(self, fn: Callable[..., Any], /, unit: Unit, *args: Any) -> Future[Any]:  # type: ignore[override]
        """As `Executor` has it."""
        done: Future[Any] = Future()
        part = unit.runs
        functions: dict[str, Callable[[], object]] = {
            "bare": lambda: bare_block(self._work, part),
            "judged": lambda: judged_block(self._work, part),
            "unit": lambda: done.set_result(fn(unit, *args)),
        }
        turn = len(self.times["unit"]) % 3
        for name in [*functions, *functions][turn : turn + 3]:
            self.times[name].append(timed(functions[name], time.process_time))
        return done


def stored(work: MissionStudy, jobs: int = 1) -> None:
    """A campaign from an empty folder."""
    with tempfile.TemporaryDirectory() as folder:
        campaign(work, folder, serial() if jobs == 1 else processes(jobs))


def timed(function: Callable[[], object], clock: Callable[[], float]) -> float:
    """Seconds."""
    begin = clock()
    function()
    return clock() - begin


def overhead(runs: int) -> None:
    """CPU time. The campaign's has all that it does: plan, bound (one run of a configuration),
    store, read and merge.
    """
    work = workload(runs)
    executor = InTurn(work)
    with tempfile.TemporaryDirectory() as folder:
        whole = timed(lambda: campaign(work, folder, from_executor(executor)), time.process_time)
    bare, judged, units = (sum(executor.times[name]) for name in ("bare", "judged", "unit"))
    whole -= bare + judged
    print(
        f"{runs} runs of 600 steps, CPU s: bare {bare:.2f}, judged by hand {judged:.2f}, units "
        f"{units:.2f}, campaign {whole:.2f}"
    )
    for name in ("bare", "judged"):
        ratios = [
            u / b for u, b in zip(executor.times["unit"][1:], executor.times[name][1:], strict=True)
        ]
        each = f"{100 * (statistics.median(ratios) - 1):+.1f} % (median of {len(ratios)} units but the first)"
        print(
            f"overhead over {name}: {100 * (whole / sum(executor.times[name]) - 1):+.1f} %, of a "
            f"unit {each}"
        )


def scaling(rounds: int, runs: int) -> None:
    """Wall time."""
    work, half, gains, attainable = workload(runs), workload(runs // 2), [], []
    for _ in range(rounds):
        one, two = (
            timed(lambda: stored(work, 1), time.monotonic),
            timed(lambda: stored(work, 2), time.monotonic),
        )
        alone, both = (
            timed(lambda: _apart(half, 1), time.monotonic),
            timed(lambda: _apart(half, 2), time.monotonic),
        )
        gains.append(one / two)
        attainable.append(2.0 * alone / both)
        print(
            f"one process {one:.1f} s, two {two:.1f} s: {gains[-1]:.2f}; the machine gives "
            f"{attainable[-1]:.2f}",
            flush=True,
        )
    best = statistics.median(attainable)
    print(
        f"scaling: {statistics.median(gains):.2f} with two processes; two bare processes apart "
        f"attain {best:.2f}"
    )


def _apart(work: MissionStudy, count: int) -> None:
    """Processes that do the bare work at the same time."""
    command = [sys.executable, "-m", "benchmarks.campaign", "bare", "--runs", str(work.runs)]
    for process in [subprocess.Popen(command) for _ in range(count)]:
        process.wait()


def memory() -> None:
    """Peak resident memory, each in a process of its own."""
    peaks = []
    for runs in (1_000, 100_000):
        command = [sys.executable, "-m", "benchmarks.campaign", "peak", "--runs", str(runs)]
        begin = time.monotonic()
        out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        peaks.append(float(out))
        print(
            f"{runs} runs: peak {peaks[-1]:.1f} MiB, {time.monotonic() - begin:.0f} s", flush=True
        )
    print(f"memory: {100 * (peaks[1] / peaks[0] - 1):+.1f} % from 1,000 to 100,000 runs")


UNITS = 24
"""Of the study that is killed."""
STUDY_FILE = """
paper = "csrukf"
filters = ["srukf", "csrukf"]
runs = 240
block = 20
[config]
steps = 100
phi = [0.0, 0.8]
"""


def kills(trials: int, seed: int) -> int:
    """Kill a campaign at a random moment, go on, kill a worker at another, compare the table.
    Returns how many were the same.
    """
    rng, same = random.Random(seed), 0
    with tempfile.TemporaryDirectory() as top:
        file = Path(top, "study.toml")
        file.write_text(STUDY_FILE, encoding="utf-8")
        wanted = _finish(file, Path(top, "whole"))
        for i in range(trials):
            folder = Path(top, f"trial{i}")
            first = _killed(file, folder, rng.randrange(UNITS - 8), rng.random(), worker=False)
            second = _killed(
                file,
                folder,
                rng.randrange(min(_done(folder), UNITS - 2), UNITS),
                rng.random(),
                worker=True,
            )
            found = _finish(file, folder)
            same += found == wanted
            print(
                f"{i + 1}: killed {first} and {second}, {'same' if found == wanted else 'OTHER'} "
                "table",
                flush=True,
            )
    print(f"kills: {same} of {trials} tables have the same bytes")
    return same


def _start(file: Path, folder: Path) -> subprocess.Popen[str]:
    command = [
        sys.executable,
        "-m",
        "celnav",
        "campaign",
        str(file),
        "--out",
        str(folder),
        "--jobs",
        "2",
    ]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _finish(file: Path, folder: Path) -> str:
    process = _start(file, folder)
    error = process.communicate()[1]
    if process.returncode:
        raise RuntimeError(f"celnav campaign: {error}")
    return hashlib.sha256(
        (folder / "table.csv").read_bytes() + (folder / "table.parquet").read_bytes()
    ).hexdigest()


def _killed(file: Path, folder: Path, units: int, wait: float, *, worker: bool) -> str:
    """Start, wait for so many units and a little longer, then kill -9 the campaign (and see that no
    worker is left), or a worker (and let the campaign finish)."""
    process = _start(file, folder)
    while process.poll() is None and (_done(folder) < units or not _children(process.pid)):
        time.sleep(0.01)
    time.sleep(wait)
    children, done = _children(process.pid), _done(folder)
    if worker:
        if children:
            os.kill(children[-1], signal.SIGKILL)
        error = process.communicate()[1]
        return f"{'a' if children else 'no'} worker with {done} units done (exit {process.returncode}{error and ': '}{error})"
    process.kill()
    process.wait()
    deadline = time.monotonic() + 5.0
    while (
        left := [pid for pid in children if Path(f"/proc/{pid}").exists()]
    ) and time.monotonic() < deadline:
        time.sleep(0.1)
    if left:
        raise RuntimeError(f"processes {left} outlive the campaign")
    return f"the campaign with {done} units done"


def _done(folder: Path) -> int:
    return len(list(folder.glob("units/*.npz")))


def _children(pid: int) -> list[int]:
    try:
        return [
            int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        ]
    except OSError:
        return []


def main(arguments: list[str] | None = None) -> int:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign", description=__doc__)
    parser.add_argument("what", choices=("overhead", "scaling", "memory", "kills", "bare", "peak"))
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if options.what == "overhead":
        overhead(options.runs)
    elif options.what == "scaling":
        scaling(options.rounds, options.runs)
    elif options.what == "memory":
        memory()
    elif options.what == "bare":
        bare(workload(options.runs))
    elif options.what == "peak":
        stored(workload(options.runs))
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
    else:
        return 0 if kills(options.trials, options.seed) == options.trials else 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
