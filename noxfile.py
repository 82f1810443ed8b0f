"""What `.ci/run` runs, by parts, each in an environment of its own, and what a release needs.

``nox`` runs the parts of `.ci/run` with the Python that nox has; ``nox -P 3.13`` takes another.
``nox -s tests -- -n0 tests/filters/test_exact.py`` hands what follows ``--`` to pytest.
``nox -l`` lists the sessions.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "uv|virtualenv"
nox.options.sessions = ["tests", "style", "types", "site", "wheel"]
PINNED = "-c", "constraints.txt"
RUNTIME = ".[papers,rinex,real,cluster]"
"""All that the package itself can use, with the notebooks' and tests' tools left out."""


@nox.session
def tests(session: nox.Session) -> None:
    """The tests, notebooks among them."""
    session.install(*PINNED, "-e", ".[test]")
    session.run("pytest", *session.posargs)


@nox.session
def style(session: nox.Session) -> None:
    """ruff: faults and layout."""
    session.install(*PINNED, "ruff")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")


@nox.session
def types(session: nox.Session) -> None:
    """mypy, for this system and for Windows."""
    session.install(*PINNED, "-e", ".[test]")
    session.run("mypy", "--strict", "celnav")
    session.run("mypy", "--strict", "--platform", "win32", "celnav")


@nox.session
def site(session: nox.Session) -> None:
    """The site, in `out/site`; a warning is an error."""
    session.install(*PINNED, "-e", ".[docs]")
    session.run("python", "-m", "docs", *session.posargs)


@nox.session
def wheel(session: nox.Session) -> None:
    """The wheel in an empty environment, with nothing but numpy and scipy."""
    session.install(*PINNED, "build")
    folder = session.create_tmp()
    session.run("python", "-m", "build", "--wheel", "--outdir", folder)
    (built,) = Path(folder).glob("*.whl")
    session.run("python", "packaging/smoke.py", str(built))
    built.unlink()


# -- releases --------------------------------------------------------------------------------------
@nox.session(venv_backend="uv", python="3.11")
def oldest(session: nox.Session) -> None:
    """The tests of the package with the oldest versions that `pyproject.toml` allows."""
    session.install("--resolution", "lowest-direct", "-e", RUNTIME)
    session.install("pytest>=9", "pytest-xdist>=3.8", "nbmake>=1.5.5", "hypothesis>=6.100")
    session.install("pandas", "xarray", "pymap3d")
    rooms = ("gaussian", "filters", "engine", "models", "analysis", "study", "show", "receiver")
    # Old packages use names that newer ones, which they ask for, call deprecated. One test counts
    # calls of functions, and old scipy's are others.
    old = "-W", "ignore::DeprecationWarning", "-k", "not half_again_of_filterpys_calls"
    session.run("pytest", *old, *(session.posargs or [f"tests/{room}" for room in rooms]))


@nox.session
def metadata(session: nox.Session) -> None:
    """Both archives, in `dist`, and what package indexes ask of them."""
    session.install("build", "twine", "check-wheel-contents", "validate-pyproject[all]")
    session.run("python", "packaging/metadata.py", "--check")
    session.run("validate-pyproject", "pyproject.toml")
    shutil.rmtree("dist", ignore_errors=True)
    session.run("python", "-m", "build")
    archives = [str(path) for path in sorted(Path("dist").iterdir())]
    session.run("twine", "check", "--strict", *archives)
    session.run("check-wheel-contents", *(path for path in archives if path.endswith(".whl")))


@nox.session
def citation(session: nox.Session) -> None:
    """CITATION.cff, by its schema."""
    session.install("cffconvert>=2")
    session.run("cffconvert", "--validate")


@nox.session
def workflows(session: nox.Session) -> None:
    """Workflows, forms and Dependabot: their schemas, and what is unsafe in them."""
    session.install("zizmor", "check-jsonschema")
    session.run("zizmor", "--offline", ".github")
    folder = Path(".github")
    for schema, pattern in {
        "vendor.github-workflows": "workflows/*.yml",
        "vendor.dependabot": "dependabot.yml",
        "vendor.github-issue-forms": "ISSUE_TEMPLATE/[!c]*.yml",
    }.items():
        paths = [str(path) for path in sorted(folder.glob(pattern))]
        session.run("check-jsonschema", "--builtin-schema", schema, *paths)


RENDER = """
from rattler_build import Stage0Recipe
for variant in Stage0Recipe.from_file("packaging/recipe.yaml").render():
    print(variant)
"""


@nox.session
def recipe(session: nox.Session) -> None:
    """The conda recipe, rendered; building it needs a channel."""
    session.install("py-rattler-build")
    session.run("python", "-c", RENDER)


@nox.session
def ready(session: nox.Session) -> None:
    """Whether the owner has filled in everything, and the changes are dated."""
    session.run("python", "packaging/metadata.py", "--ready")
