"""Real processes and a real cluster: the same bytes, and nothing left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
from machine import children, gone, interruptible

from celnav.campaign import campaign, dask, processes, serial
from celnav.campaign.missions import read
from celnav.campaign.table import columns, to_csv, to_parquet

STUDY = """
paper = "csrukf"
filters = ["srukf", "csrukf"]
runs = 40
block = 5
[config]
steps = 30
phi = [0.0, 0.8]
"""
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("a study") / "study.toml"
    path.write_text(STUDY)
    return path


@pytest.fixture(scope="module")
def wanted(file, tmp_path_factory):
    return table(campaign(read(file), tmp_path_factory.mktemp("serial"), serial()))


def table(outcome):
    cells = columns(outcome.rows)
    return to_csv(cells).encode(), to_parquet(cells)


@pytest.mark.parametrize("jobs", [1, 3])
def test_processes_give_the_same_bytes(file, wanted, tmp_path, jobs):
    assert table(campaign(read(file), tmp_path, processes(jobs))) == wanted


@pytest.mark.filterwarnings("ignore")  # warnings from distributed
def test_a_local_dask_cluster_gives_the_same_bytes(file, wanted, tmp_path):
    assert table(campaign(read(file), tmp_path, dask(jobs=2))) == wanted


@pytest.fixture
def cluster():
    """A scheduler and two workers, in three separate processes, over loopback."""
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    base = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    scheduler = [
        *base,
        "--host",
        "127.0.0.1",
        "--port",
        address.rpartition(":")[2],
        "--no-dashboard",
    ]
    worker = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        address,
        "--nworkers",
        "2",
        "--nthreads",
        "1",
        "--no-dashboard",
        "--host",
        "127.0.0.1",
    ]
    running = [
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for command in (scheduler, worker)
    ]
    yield address
    for process in reversed(running):
        process.terminate()
        process.wait(20)


@pytest.mark.filterwarnings("ignore")  # warnings from distributed
def test_a_running_cluster_gives_the_same_bytes(file, wanted, tmp_path, cluster):
    assert table(campaign(read(file), tmp_path, dask(cluster))) == wanted


SCRIPT = """
import sys
from celnav.campaign import campaign, processes
from celnav.campaign.table import columns, to_csv, to_parquet
from celnav.files import write_bytes
from celnav.campaign.missions import read

if __name__ == "__main__":
    file, folder = sys.argv[1:]
    cells = columns(campaign(read(file), folder, processes(2)).rows)
    write_bytes(f"{folder}/table.csv", to_csv(cells).encode())
    write_bytes(f"{folder}/table.parquet", to_parquet(cells))
"""


def start(file, folder):
    script = file.with_name("script.py")
    script.write_text(SCRIPT)
    return subprocess.Popen(
        [sys.executable, str(script), str(file), str(folder)], stderr=subprocess.PIPE, text=True
    )


def workers_at_work(process, folder, units):
    """Wait until some units are done; returns the worker processes."""
    deadline = time.monotonic() + 200.0
    while time.monotonic() < deadline and process.poll() is None:
        if len(list((folder / "units").glob("*.npz"))) >= units:
            return children(process.pid)
        time.sleep(0.01)
    raise AssertionError(f"the campaign did not get that far: {process.communicate()}")


def tables_of(folder):
    return (folder / "table.csv").read_bytes(), (folder / "table.parquet").read_bytes()


@LINUX
def test_a_killed_campaign_and_killed_workers_lose_nothing(file, wanted, tmp_path):
    process = start(file, tmp_path)
    pids = workers_at_work(process, tmp_path, 4)
    process.kill()
    process.communicate()
    assert gone(pids)
    assert not (tmp_path / "table.csv").exists()

    process = start(file, tmp_path)
    os.kill(workers_at_work(process, tmp_path, 9)[-1], signal.SIGKILL)
    _, error = process.communicate(timeout=120)
    assert (process.returncode, error) == (0, "")
    assert tables_of(tmp_path) == wanted
    assert not list(tmp_path.rglob(".celnav-*"))


@LINUX
def test_an_interrupt_ends_it_and_leaves_no_process(file, wanted, tmp_path):
    folder = tmp_path / "interrupted"
    options = ["--out", str(folder), "--jobs", "2", "--effort", "1"]
    command = interruptible("-m", "celnav", "campaign", str(file), *options)
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True)
    pids = workers_at_work(process, folder, 1)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=60)  # takes less than a second on an idle machine
    assert process.returncode == 130
    assert (
        error
        == f"celnav: interrupted; finished work is kept in {folder}; the same command resumes\n"
    )
    assert gone(pids)
    assert table(campaign(read(file), folder, serial())) == wanted
