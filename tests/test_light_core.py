"""With only numpy and scipy, filters and studies work, and everything else names the command that
installs what it needs.
"""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import numpy as np
import pytest
from taped import inputs

import celnav
from celnav import cli, lazy
from celnav.tape.tape import CannotCompile, Tape

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ALONE = """
import sys

class NothingElse:
    def find_spec(self, name, path=None, target=None):
        root = name.partition(".")[0]
        if root not in {"numpy", "scipy", "celnav", *sys.stdlib_module_names} and not root.startswith("_"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NothingElse())
"""


def alone(program, *arguments, cwd=None):
    """A process that finds only numpy, scipy and celnav."""
    words = [sys.executable, "-W", "error", "-c", ALONE + program, *arguments]
    return subprocess.run(words, capture_output=True, text=True, check=False, cwd=cwd)


def test_numpy_and_scipy_are_all_that_is_required():
    assert [re.match(r"[\w-]+", line)[0] for line in PROJECT["dependencies"]] == ["numpy", "scipy"]
    done = alone("import matplotlib")
    assert "No module named 'matplotlib'" in done.stderr


def test_the_program_of_the_readme_runs():
    program = re.findall(
        r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL
    )[0]
    assert len([line for line in program.splitlines() if line.strip()]) <= 22
    done = alone(program)
    assert done.returncode == 0, done.stderr
    assert "NEES     over 3: 1.001, consistent" in done.stdout


EVERYTHING = """
import numpy as np
import celnav
from celnav import EUCLIDEAN, Epoch, Group, Track

F = np.array([[1.0, 1.0], [0.0, 1.0]])
motion, gps = celnav.Motion(F, Q=0.01 * np.eye(2)), celnav.Sensor(np.eye(1, 2), R=np.eye(1))
changing = celnav.Motion(celnav.Linear(lambda epoch: F), Q=0.01 * np.eye(2))
compass = celnav.Sensor(lambda x, epoch: x[..., :1], R=np.eye(1), space=celnav.angles([0]))
turned = celnav.product((celnav.attitude(), 4, 3), (EUCLIDEAN, 3, 3))
prior, times = celnav.Gaussian(np.zeros(2), np.eye(2)), np.arange(9.0)
truth, z = celnav.simulate(motion, gps, prior, times, runs=3)

class Points:  # of filterpy's interface
    n, Wm, Wc = 2, np.full(4, 0.25), np.full(4, 0.25)
    def sigma_points(self, x, P):
        return x + np.sqrt(2.0) * np.concatenate([np.eye(2), -np.eye(2)])

rules = [celnav.unscented, celnav.cubature, celnav.gauss_hermite, celnav.simplex, lambda n: celnav.smolyak(n, 2),
         celnav.from_filterpy(Points()), celnav.Taylor()]
assert isinstance(celnav.cubature(2), celnav.Rule) and turned.minus is not None
filters: list[celnav.Filter] = [celnav.sigma_point(motion, gps, rule=rule) for rule in rules]
filters += [make(motion, gps) for make in (celnav.ukf, celnav.ekf, celnav.ckf, celnav.ghkf, celnav.sparse_grid_filter)]
filters += [celnav.ukf(changing, gps), celnav.ukf(motion, compass), celnav.imm([filters[0], filters[1]], [[0.9, 0.1], [0.1, 0.9]])]
filters += [make(motion, gps, np.eye(1) / 2) for make in (celnav.colored, celnav.augmented, celnav.decorrelated)]
filters += [celnav.two_stage(motion, gps, np.eye(1), celnav.Gaussian(np.zeros(1), np.eye(1)))]
for filter in filters:
    track = celnav.run(filter, prior, times, z, keep="cov")
    assert hasattr(filter, "step") and isinstance(track, Track) and np.isfinite(track.mean).all(), filter
smoothed = celnav.smooth(celnav.run(filters[7], prior, times, z, keep="cov"))
merged = celnav.merge(imu=(times, np.ones((9, 1))), fixes=(times[::2], z[::2]))
assert np.array_equal(merged.times, times) and np.isnan(merged.z[1]).all()
assert (smoothed.std <= celnav.run(filters[7], prior, times, z).std + 1e-12).all()
assert np.isfinite(celnav.iterated_smoother(filters[7], prior, times, z).mean).all()
for epoch, state, infos in celnav.steps(filters[0], prior, celnav.epochs(times, z)):
    assert isinstance(epoch, Epoch) and np.isfinite(state.belief.mean).all()
problem = celnav.Problem(motion, gps, prior, times, groups=[Group("place", "m", slice(0, 1))])
rows = celnav.compare({"walk": problem}, {"UKF": lambda p: celnav.ukf(p.motion, p.sensor)}, runs=5)
assert len(rows) == 1
try:
    celnav.run(celnav.ukf(celnav.Motion(lambda x, epoch: np.nan * x, Q=np.eye(2)), gps), prior, times, z)
except celnav.FilterError as error:
    print(error)
celnav.export_c(filters[7], "filter.c", prior, dt=1.0)
print(celnav.analysis.diagnose.diagnose(track, prior=prior, z=z))
print(celnav.run(filters[7], prior, times, z, keep="cov").report(truth))
print(celnav.run(filters[7], prior, times, z, engine="auto").engine)
for flies in (celnav.compiled(filters[7]).run, celnav.compiled(filters[7], engine="cuda").run):
    try:
        flies(prior, times, z)
    except (ImportError, RuntimeError) as error:
        print(error)
"""


def test_every_public_name_works(tmp_path):
    used = set(re.findall(r"\b(?:celnav\.)?(\w+)\b", EVERYTHING))
    assert set(celnav.__all__) <= used, set(celnav.__all__) - used
    done = alone(EVERYTHING, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "machine code needs llvmlite" in done.stdout
    assert (tmp_path / "filter.c").stat().st_size > 1000


BROWSER = """
import threading

FORBIDDEN = {"subprocess.Popen", "os.fork", "os.posix_spawn", "os.system"}
ABSENT = {"multiprocessing", "_multiprocessing", "fcntl", "resource", "termios", "grp", "pwd"}

def refuse(event, arguments):
    if event in FORBIDDEN or event == "ctypes.dlopen" and arguments[0] is not None:
        raise RuntimeError(f"a browser has no {event}")
    if event == "import" and arguments[0] in ABSENT:
        raise ModuleNotFoundError(f"a browser has no {arguments[0]}", name=arguments[0])

def start(thread):
    raise RuntimeError("a browser has no threads")

threading.Thread.start = start
sys.addaudithook(refuse)
"""
"""What Pyodide lacks: threads, processes, libraries of the system, and some modules."""


def test_filters_run_where_a_browser_runs_them(tmp_path):
    """Filters, reports and C code need no thread, no process and no library of the system."""
    program, _, native = EVERYTHING.partition("for flies in")
    assert native
    done = alone(BROWSER + program, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    attempts = (
        "threading.Thread(target=print).start()",
        "import subprocess; subprocess.run([sys.executable, '--version'])",
        "import ctypes; ctypes.CDLL('libc.so.6')",
        "import multiprocessing",
    )
    for attempt in attempts:
        assert "a browser has no" in alone(BROWSER + attempt).stderr


def test_counts_are_recorded_where_integers_have_32_bits(monkeypatch):
    """In WebAssembly an ``int`` of numpy is int32, and a filter counts what it used."""
    x = inputs(Tape(), (3,))[0]
    with pytest.raises(CannotCompile, match="not as int32"):
        np.add.reduce(x > 0.0, -1, np.int32)
    monkeypatch.setattr(np, "intp", np.int32)
    assert np.add.reduce(x > 0.0, -1, np.int32).shape == ()


def test_the_cure_in_a_browser_is_not_pip(monkeypatch):
    monkeypatch.setattr(lazy.sys, "platform", "emscripten")
    error = lazy.MissingError("a figure", "matplotlib", "plot")
    assert str(error) == (
        "a figure needs matplotlib: await micropip.install('matplotlib') brings it if Pyodide has it"
    )


def test_import_is_small():
    """Submodules of scipy and the compiler are imported on first use, because importing them takes
    longer than everything else.
    """
    late = {"scipy.linalg", "scipy.special", "celnav.engine.recording", "celnav.tape.llvm"}
    program = f"import celnav\nprint(*{late} & set(sys.modules))"
    assert alone(program).stdout == "\n"


def test_help_speaks_of_every_package_and_every_module_is_there_or_says_what_it_needs():
    program = """
import celnav, importlib, pkgutil, pydoc
from celnav.lazy import MissingError
assert "Conventions" in pydoc.render_doc(celnav) and "index(self, value" not in pydoc.render_doc(celnav)
for found in pkgutil.walk_packages(celnav.__path__, "celnav.", onerror=lambda name: None):
    package, _, name = found.name.rpartition(".")
    if name == "__main__":
        continue
    try:
        pydoc.render_doc(importlib.import_module(found.name))
    except MissingError as error:
        print(found.name, error)
        owner = sys.modules.get(package)
        assert owner is None or (name in dir(owner) and not hasattr(owner, name))
try:
    celnav.models.ephemeris
except AttributeError as error:
    print("attribute:", error)
for name in ("celnav.models.ephemeris", "celnav.papers.aukf.Config"):
    try:
        exec(f"from {name.rpartition('.')[0]} import {name.rpartition('.')[2]}")
    except ImportError as error:
        print(f"from-{name}", error)
"""
    done = alone(program)
    assert done.returncode == 0, done.stderr
    missing = {line.partition(" ")[0]: line for line in done.stdout.splitlines()}
    core = tuple(
        f"celnav.{room}." for room in ("gaussian", "filters", "models", "analysis", "study", "tape")
    )
    assert {name for name in missing if name.startswith(core)} == {
        "celnav.models.ephemeris",
        "celnav.filters.dropin",
    }
    assert cure("filterpy") in missing["celnav.filters.dropin"]
    assert all(
        cure("papers") in missing[name] for name in ("attribute:", "from-celnav.models.ephemeris")
    )
    assert cure("rinex") in missing["from-celnav.papers.aukf.Config"]


def cure(extra):
    return (
        f'in the folder of celnav, {lazy.PIP} install -c constraints.txt -e ".[{extra}]" brings it'
    )


WORDS = {
    "run": ["x.toml"],
    "campaign": ["x.toml"],
    "view": ["x.rrd"],
    "position": ["OBS", "NAV"],
    "diagnose": ["x.csv", "--out", "x"],
}


@pytest.mark.parametrize("name", [name for name in cli._parser()[1] if name != "new"])
def test_a_command_says_what_it_needs_before_it_does_anything(name, tmp_path):
    program = "from celnav.cli import main\nsys.exit(main(sys.argv[1:]))"
    done = alone(program, name, *WORDS.get(name, []), cwd=tmp_path)
    extra, package = cli.NEEDS.get(name, ("papers", "matplotlib"))[:2]
    said = "diagnose --out" if name == "diagnose" else name
    assert done.stderr == f"celnav: {said} needs {package}: {cure(extra)}\n"
    assert (done.returncode, done.stdout, list(tmp_path.iterdir())) == (1, "", [])


def test_help_needs_nothing(tmp_path):
    program = """
from celnav.cli import main
for name in sys.argv[1:]:
    try:
        main([name, "--help"])
    except SystemExit as done:
        print("status", done.code)
"""
    names = list(cli._parser()[1])
    done = alone(program, *names, cwd=tmp_path)
    assert (done.stdout.count("status 0\n"), done.stderr) == (len(names), "")


def test_a_study_of_ones_own_is_begun(tmp_path):
    done = alone("from celnav.cli import main\nsys.exit(main(['new', 'mine.py']))", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "mine.py").is_file()


def test_diagnose_answers_in_words(tmp_path):
    (tmp_path / "x.csv").write_text(
        "t,x\n" + "".join(f"{t},{(t * 7919) % 13 - 6}\n" for t in range(60)), encoding="utf-8"
    )
    done = alone("from celnav.cli import main\nsys.exit(main(['diagnose', 'x.csv']))", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "white" in done.stdout


def brought(extra):
    """Distributions of an extra, and of the extras that it names."""
    out = set()
    for line in PROJECT["optional-dependencies"][extra]:
        name, others = re.match(r"([\w-]+)(?:\[(.*?)\])?", line).groups()
        out |= {name.lower()} if name != "celnav" else set().union(*map(brought, others.split(",")))
    return out


def test_recordings_are_made_by_versions_of_rerun_that_were_tested():
    """Pictures need its experimental client, which changes with each minor version."""
    (line,) = [one for one in PROJECT["optional-dependencies"]["record"] if "rerun" in one]
    least, beyond = re.fullmatch(r"rerun-sdk>=([\d.]+),<([\d.]+)", line).groups()
    pinned = re.search(r"^rerun-sdk==([\d.]+)$", (ROOT / "constraints.txt").read_text(), re.M)[1]
    first, tested, end = ([int(n) for n in v.split(".")] for v in (least, pinned, beyond))
    assert first <= tested < end
    assert end[:2] == [tested[0], tested[1] + 1]
    client = importlib.import_module("rerun.experimental").ViewerClient
    assert all(hasattr(client, name) for name in ("open", "set_time", "take_screenshot"))


def asked_for():
    """``(extra, module)`` for every import from an extra in the sources."""
    for path in sorted(Path(celnav.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            call = node.items[0].context_expr if isinstance(node, ast.With) else node
            if (
                isinstance(call, ast.Call)
                and getattr(call.func, "id", "") in ("requires_extra", "require")
                and len(call.args) > 1
            ):
                extra, *names = (
                    arg.value if isinstance(arg, ast.Constant) else None for arg in call.args[1:]
                )
                for inside in ast.walk(node) if isinstance(node, ast.With) else ():
                    names += [inside.module] if isinstance(inside, ast.ImportFrom) else []
                    names += (
                        [name.name for name in inside.names]
                        if isinstance(inside, ast.Import)
                        else []
                    )
                yield from ((extra, name.partition(".")[0]) for name in names)
    yield from ((extra, name) for extra, *names in cli.NEEDS.values() for name in names)


def test_an_extra_brings_what_is_said_of_it():
    asked, made_of = set(asked_for()), packages_distributions()
    assert {extra for extra, _ in asked} == {
        "papers",
        "plot",
        "record",
        "filterpy",
        "rinex",
        "cluster",
        "compiled",
        "real",
        "notebooks",
    }
    for extra, module in sorted(asked):
        assert {name.lower() for name in made_of.get(module, [f"{module}-sdk"])} & brought(extra), (
            extra,
            module,
        )


def test_what_the_readme_installs_is_pinned():
    pinned = {
        line.partition("==")[0]
        for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    }
    needed = (
        {re.match(r"[\w-]+", line)[0] for line in PROJECT["dependencies"]}
        | brought("notebooks")
        | brought("test")
    )
    assert needed <= pinned, needed - pinned
