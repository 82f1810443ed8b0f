"""Types as a user's own mypy sees them: the programs of the README and of the site, checked
strictly.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
BARE = re.compile(r"^( *)def (\w+)\(([^)]*)\):", re.MULTILINE)


def typed(program: str) -> str:
    """A program with annotated functions, as a user of strict mypy writes it."""

    def annotated(match: re.Match[str]) -> str:
        names = [name.strip() for name in match[3].split(",")]
        return f"{match[1]}def {match[2]}({', '.join(f'{name}: Any' for name in names)}) -> Any:"

    return "from typing import Any\n" + BARE.sub(annotated, program)


def test_programs_type_check(tmp_path):
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    for path in pages:
        programs = re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)
        # A user's study starts without annotations.
        programs = [p for p in programs if "mpi4py" not in p and "celnav.study.Timed" not in p]
        if programs:
            (tmp_path / f"{path.stem.lower()}_page.py").write_text(
                typed("\n".join(programs)), encoding="utf-8"
            )
    files = sorted(str(path) for path in tmp_path.glob("*.py"))
    assert len(files) > 8
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--ignore-missing-imports",
        "--no-error-summary",
        *files,
    ]
    done = subprocess.run(
        [*command, "--cache-dir", str(ROOT / ".mypy_cache" / "users")],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
