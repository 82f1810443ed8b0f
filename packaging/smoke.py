"""Install a wheel in an empty environment, and use it with nothing but numpy and scipy.

``python packaging/smoke.py dist/celnav-X.Y.Z-py3-none-any.whl`` fails at the first thing that is
wrong: another version, more packages than numpy and scipy, the first program of `README.md`, or a
command that does not say which extra it needs.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ALONE = """
from importlib.metadata import distributions
names = {found.name for found in distributions()} - {"pip", "setuptools"}
assert names == {"celnav", "numpy", "scipy"}, names
"""
NEEDS = r'reproduce needs matplotlib: .* -e "\.\[papers\]" brings it'


def run(*command: object, cwd: Path, fails: bool = False) -> str:
    """What a command prints, on both streams; ``fails``: whether it has to fail."""
    words = [str(word) for word in command]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        words,
        cwd=cwd,
        env=environment | {"PYTHONUTF8": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        check=False,
    )
    if (done.returncode != 0) != fails:
        sys.exit(f"{' '.join(words)}: exit status {done.returncode}\n{done.stdout}")
    return done.stdout


def smoke(wheel: Path) -> None:
    """Fail at the first thing that is wrong with a wheel."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    program = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)[0]
    version = wheel.name.split("-")[1]
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        venv.create(work / "empty", with_pip=True)
        programs = work / "empty" / ("Scripts" if sys.platform == "win32" else "bin")
        python, celnav = programs / "python", programs / "celnav"
        constraints = ROOT / "constraints.txt"
        run(python, "-m", "pip", "install", "--quiet", "-c", constraints, wheel, cwd=work)
        said = run(celnav, "--version", cwd=work).strip()
        if said != f"celnav {version}":
            sys.exit(f"celnav --version: expected celnav {version}, got {said}")
        run(python, "-c", ALONE, cwd=work)
        (work / "program.py").write_text(program, encoding="utf-8")
        report = run(python, "program.py", cwd=work)
        said = run(celnav, "reproduce", cwd=work, fails=True)
        if not re.search(NEEDS, said):
            sys.exit(f"celnav reproduce: expected a line like {NEEDS}, got\n{said}")
    sys.stdout.reconfigure(encoding="utf-8")  # type: ignore[union-attr]
    print(report)
    print(f"{wheel.name} works with Python {sys.version.split()[0]}, numpy and scipy alone")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python packaging/smoke.py WHEEL")
    smoke(Path(sys.argv[1]).resolve())
