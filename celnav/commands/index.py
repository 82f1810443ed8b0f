"""``out/index.html``, a page that can be opened from disk: claims of papers, our findings, all rows
of the papers' ledgers and all figures.

Users' studies and studies on real data follow the papers.
"""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any
from urllib.parse import quote

import celnav
from celnav import papers
from celnav.commands.arguments import load
from celnav.files import InputError, read_json
from celnav.show import viewer
from celnav.show.claims import answer, markdown, read_claims, tally
from celnav.study.ledger import KINDS, VERDICTS, Sentence

Claims = Sequence[Mapping[str, Any]]
USER = "study.json"
"""File with the data of a user's study for the page; the study's own file may no longer exist."""
SITE = "site"
"""Folder of the site beside the page, where ``python -m docs`` writes it."""
NOTEBOOKS = Path(celnav.__file__).resolve().parents[1] / "notebooks"


def index(out: Path) -> str:
    """The page for all papers and studies under ``out``."""
    from celnav.show.page import render

    every = {name: _shown(out, name, claims) for name, claims in reproduced(out).items()}
    studies = [study for name, study in every.items() if name not in papers.REAL]
    return render(
        "index.html",
        title="celnav: what holds",
        studies=studies,
        real=[study for name, study in every.items() if name in papers.REAL],
        papers={*every} - {*papers.REAL} <= {*papers.PAPERS},
        partial=partial(out, every),
        runs=dict.fromkeys(study["runs"] for study in every.values()),
        tally=tally(claim for study in studies for claim in study["claims"]["statement"]),
        absent={name: holds for name, holds in papers.REAL.items() if name not in every},
        elsewhere=_elsewhere(out),
    )


def _elsewhere(out: Path) -> dict[str, str]:
    """Name and address of the site, if it lies in ``out/site``, and of the notebooks."""
    site = {"The site": "site/index.html", "Notebooks": "site/notebooks/index.html"}
    if (out / SITE / "index.html").is_file():
        return site
    return {"Notebooks": _address(NOTEBOOKS, out)} if NOTEBOOKS.is_dir() else {}


def reproduced(out: Path) -> dict[str, list[dict[str, Any]]]:
    """Claims and checks of all studies under ``out``: of papers, of users, on real data."""
    users = sorted(path.parent.name for path in out.glob(f"*/{USER}"))
    return {
        name: [c for kind in ("claims", "checks") for c in read_claims(out / name / f"{kind}.json")]
        for name in (*papers.PAPERS, *users, *papers.REAL)
        if (out / name / "claims.json").exists()
    }


def page_data(study: Any, file: str) -> str:
    """The JSON of a user's study that `study_of` reads."""
    about: dict[str, Any] = {"file": str(Path(file).resolve())}
    about |= {name: getattr(study, name) for name in ("TITLE", "CITATION", "RECORDINGS")}
    for kind in ("FIGURES", "TABLES"):
        about[kind] = {stem: caption for stem, (caption, _) in getattr(study, kind).items()}
    about["STUDY"] = {name: getattr(study.STUDY, name) for name in ("says", "found", "figure")}
    return json.dumps(about, indent=1, ensure_ascii=False) + "\n"


def study_of(out: Path, name: str, word: str = "") -> Any:
    """The module of a study, or for a user's study an object from `page_data`, with the names that
    a page shows.

    word: the word that loads the study if there is no such file; by default its name.
    """
    path = out / name / USER
    if not path.exists():
        return load(word or name)
    try:
        about = read_json(path)
        study = about.pop("STUDY")
        study["found"] = [Sentence(text, dict(rests_on)) for text, rests_on in study["found"]]
        for kind in ("FIGURES", "TABLES"):
            about[kind] = {stem: (caption,) for stem, caption in about[kind].items()}
        return SimpleNamespace(STUDY=SimpleNamespace(**study), **about)
    except (AttributeError, KeyError, TypeError, ValueError):
        raise InputError(f"{path}: not what celnav writes; reproduce the study again") from None


def summary(
    names: Sequence[str],
    out: Path = Path("out"),
    claims: Mapping[str, Claims] = MappingProxyType({}),
) -> str:
    """Paragraphs in Markdown with the claims of studies and our findings; ``claims``: the available
    claims.
    """
    paragraphs = []
    for name in names:
        module = study_of(out, name)
        said = " ".join(sentence.text for sentence in module.STUDY.found)
        if name in claims:
            said = answer(module.STUDY.found, claims[name])
        source = f": {cited(module.CITATION)}" if module.CITATION else ""
        paragraph = f"**{module.TITLE}** (`{name}`{source})."
        if module.STUDY.says:
            paragraph += f" {_whose(name)}{module.STUDY.says}"
        paragraphs.append(f"{paragraph}\n*We find:* {said}" if said else paragraph)
    return "\n\n".join(paragraphs)


def _whose(name: str) -> str:
    """The words before a claim that name its source."""
    if name in papers.PAPERS:
        return "The paper: "
    return "" if name in papers.REAL else "The claim: "


def cited(citation: str) -> str:
    """Authors and year of a BibTeX entry."""

    def entry(key: str) -> str:
        match = re.search(rf"{key} *= *{{(.*?)}}", citation, re.DOTALL)
        return match[1] if match else ""

    names = [name.partition(",")[0].strip() for name in entry("author").split(" and ")]
    authors = ", ".join(names[:-1]) + " & " * (len(names) > 1) + names[-1]
    if len(names) > 4:
        authors = f"{names[0]} et al."
    year = entry("year")
    return f"{authors} ({year})" if year else authors


def verdicts(studies: Mapping[str, Claims]) -> str:
    """A table in Markdown with the number of statements of each paper for each verdict."""
    counts = {name: tally(_of_kind(claims, "statement")) for name, claims in studies.items()}
    shown = [verdict for verdict in VERDICTS if any(verdict in count for count in counts.values())]
    rows = [["paper", "statements", *shown], ["---", *["---:"] * (len(shown) + 1)]]
    for name, count in counts.items():
        numbers = [str(count.get(verdict, "")) for verdict in shown]
        rows.append([f"`{name}`", str(sum(count.values())), *numbers])
    return markdown(rows)


def deciding(claims: Claims) -> list[Mapping[str, Any]]:
    """The claims that decide about a study: its statements, or its findings if it has no
    statements.
    """
    return _of_kind(claims, "statement") or _of_kind(claims, "finding")


def _of_kind(claims: Claims, kind: str) -> list[Mapping[str, Any]]:
    return [claim for claim in claims if claim["kind"] == kind]


def _shown(out: Path, name: str, claims: Claims) -> dict[str, Any]:
    """The data of a study for the page."""
    module, folder = study_of(out, name), out / name
    record = _record(folder)
    by_kind = {kind: _of_kind(claims, kind) for kind in KINDS}
    deciding = "statement" if name in papers.PAPERS or by_kind["statement"] else "finding"
    files = [
        path.name
        for path in sorted(folder.iterdir())
        if path.suffix in (".rrd", ".json", ".npz") and not path.name.startswith(".")
    ]
    return {
        "id": name,
        "title": module.TITLE,
        "whose": _whose(name),
        "says": module.STUDY.says,
        "answer": answer(module.STUDY.found, claims),
        "first": answer(module.STUDY.found[:1], claims) or module.STUDY.says,
        "citation": module.CITATION,
        "cited": cited(module.CITATION),
        "notebook": _notebook(out, name, module),
        "claims": by_kind,
        "kind": deciding,
        "odd": sum(claim["surprise"] for claim in claims),
        "figures": {
            path.stem: _figure(path, name, module)
            for path in sorted((folder / "figures").glob("*.png"))
        },
        "decides": module.STUDY.figure,
        "tables": [_table(path, module) for path in sorted((folder / "tables").glob("*.csv"))],
        "recordings": [
            _recording(out, f"{name}/{file}") for file in module.RECORDINGS if file in files
        ],
        "files": files,
        "runs": _runs(record),
        "about": f"{record['versions']}; {record['cpu_s']:.0f} s of CPU time" if record else "",
    }


def _recording(out: Path, recording: str) -> dict[str, str]:
    """Name and size of a recording, its address in the browser, and its picture beside it if
    ``celnav view --picture`` has drawn one.
    """
    picture = Path(recording).with_suffix(".png")
    return {
        "name": picture.stem,
        "file": quote(recording),
        "size": f"{(out / recording).stat().st_size / 1e6:.1f} MB",
        "live": _live(out, recording),
        "picture": quote(picture.as_posix()) if (out / picture).is_file() else "",
    }


def _runs(record: Mapping[str, Any]) -> str:
    """Which runs were done, in words."""
    effort, seed = record.get("effort", 1.0), record.get("seed")
    runs = "All runs" if effort == 1.0 else f"Effort {effort:g}"
    return runs + ("." if seed is None else f", seed {seed}.")


def _live(out: Path, recording: str) -> str:
    """The address of a recording in the browser; "" if the viewer or its script is missing, or if
    the script belongs to an earlier recording.
    """
    script = out / viewer.script_name(recording)
    if not ((out / viewer.SCRIPT).is_file() and script.is_file()):
        return ""
    current = viewer.is_script_of(script.read_bytes(), (out / recording).read_bytes())
    return viewer.address(recording) if current else ""


def _notebook(out: Path, name: str, module: Any) -> dict[str, str]:
    """Name and address of a paper's notebook, on the site or in the checkout, or of a user's file;
    the address is "" if there is none.
    """
    if name in papers.PAPERS:
        path = next(NOTEBOOKS.glob(f"[0-9][0-9]_{name}.ipynb"), NOTEBOOKS / f"{name}.ipynb")
    else:
        path = NOTEBOOKS / "07_real_data.ipynb" if name in papers.REAL else Path(module.file)
    page = f"{SITE}/notebooks/{path.stem}.html"
    if path.parent == NOTEBOOKS and (out / page).is_file():
        return {"name": path.stem, "href": page}
    return {"name": path.name, "href": _address(path, out) if path.exists() else ""}


def _address(path: Path, out: Path) -> str:
    """The address of a file on a page in ``out``."""
    try:
        return quote(Path(os.path.relpath(path, out.resolve())).as_posix())
    except ValueError:  # on another drive of Windows
        return path.resolve().as_uri()


def _record(folder: Path) -> dict[str, Any]:
    """What ``timings.json`` of a study says of its runs and versions; empty without one."""
    try:
        record = read_json(folder / "timings.json")
        versions = ", ".join(f"{name} {version}" for name, version in record["about"].items())
        numbers = {"effort": float(record["effort"]), "cpu_s": float(record["cpu_s"])}
        return numbers | {"versions": versions, "seed": record.get("seed")}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def partial(out: Path, names: Iterable[str]) -> list[str]:
    """A line for each effort below 1, with the studies reproduced with this effort."""
    by_effort = dict[float, list[str]]()
    for name in names:
        by_effort.setdefault(_record(out / name).get("effort", 1.0), []).append(name)
    return [
        f"{', '.join(some)}: only {effort:.3g} of the runs: intervals are wide, "
        "and what they do not decide is undecided"
        for effort, some in by_effort.items()
        if effort < 1.0
    ]


def _table(path: Path, module: Any) -> dict[str, Any]:
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    head = [re.sub(_UNIT, _unit, name).replace("_", " ") for name in head]
    return {"caption": module.TABLES.get(path.stem, (path.stem,))[0], "head": head, "rows": rows}


_UNIT = re.compile(r"_(m_per_s|km|kpc|deg|m|s)$")


def _unit(found: re.Match[str]) -> str:
    """A unit at the end of a column's name, as a person writes it: "vx_m_per_s" is "vx (m/s)"."""
    return f" ({found[1].replace('_per_', '/')})"


def _figure(path: Path, name: str, module: Any) -> dict[str, str]:
    return {
        "caption": module.FIGURES.get(path.stem, (path.stem.replace("_", " "),))[0],
        "file": f"{name}/figures/{path.stem}",
    }
