"""``ro-crate-metadata.json``: what a run of ``celnav reproduce`` read and wrote, in the form of
RO-Crate 1.1 with the profile Process Run Crate 0.5.

The same command writes the same bytes. So the file has no time of the run, and no hash of the files
whose bytes depend on it (`CHANGING`).
"""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Iterable, Mapping
from importlib import metadata
from itertools import chain
from mimetypes import MimeTypes
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import quote

import celnav
from celnav.files import data, sha256
from celnav.study.store import DATA, code

NAME = "ro-crate-metadata.json"
RELEASED = "2026-11-23"
"""Date of this version of celnav; a crate must have a date, and has this one."""
CHANGING = re.compile(r"(^index\.html|/timings\.json|\.rrd|\.rrd\.js)$")
"""Files that have another content each time."""
SPECIFICATION, PROFILE = "https://w3id.org/ro/crate/1.1", "https://w3id.org/ro/wfrun/process/0.5"
MIT = "https://spdx.org/licenses/MIT"
SHA256 = {"sha256": "https://w3id.org/ro/terms/workflow-run#sha256"}
TYPES = {
    ".js": "text/javascript",
    ".md": "text/markdown",
    ".npz": "application/x-npz",
    ".py": "text/x-python",
    ".toml": "application/toml",
}
"""Media types; others are those that Python knows on every system."""
FIELD = re.compile(r"(\w+)\s*=\s*\{((?:[^{}]|\{[^{}]*\})*)\}")
Entity = dict[str, Any]


def versions() -> dict[str, str]:
    """Versions of celnav, Python and the packages that determine results and figures."""
    packages = ("numpy", "scipy", "matplotlib")
    named = {"celnav": celnav.__version__, "python": platform.python_version()}
    return named | {package: metadata.version(package) for package in packages}


def crate(
    out: Path,
    command: str,
    written: Iterable[str],
    inputs: Mapping[str, Path],
    studies: Mapping[str, ModuleType],
    license: str = "",
) -> str:
    """The text of the file.

    out: folder of the crate. command: command line. written: names of files in ``out``; missing
    ones are left out. inputs: files that were read, by name; those that come with celnav are
    added. studies: modules by name. license: of the crate, in words; by default celnav's.
    """
    files = [
        _file(out / name, quote(name)) | {"@type": "File"}
        for name in written
        if (out / name).is_file()
    ]
    read = [
        _file(path, f"#input/{quote(name)}") | {"@type": "CreativeWork"}
        for name, path in ({name: data(name) for name in DATA} | dict(inputs)).items()
    ]
    software = [_software(name, version) for name, version in versions().items()]
    software[0]["softwareVersion"] += f"+code.{code()['code']}"
    software[0]["softwareRequirements"] = _references(software[1:])
    cited = [_cited(module.CITATION) for module in studies.values() if "{" in module.CITATION]
    papers = [entities[0] for entities in cited]
    titles = {name: module.TITLE for name, module in studies.items()}
    mit: Entity = {"@id": MIT, "@type": "CreativeWork", "name": "MIT License"}
    mit["description"] = "The license of celnav, its figures, tables and recordings."
    terms = mit | {"@id": "#license", "name": license, "description": license} if license else mit
    software[0]["license"] = {"@id": MIT}
    action: Entity = {
        "@id": "#run",
        "@type": "CreateAction",
        "name": command,
        "description": "Simulates, filters and judges. Times are in timings.json of each study.",
        "instrument": {"@id": "#celnav"},
        "object": _references(read),
        "result": _references(files),
    }
    root: Entity = {
        "@id": "./",
        "@type": "Dataset",
        "name": f"celnav reproduce: {', '.join(titles)}",
        "description": "; ".join(titles.values()),
        "datePublished": RELEASED,
        "license": {"@id": terms["@id"]},
        "conformsTo": {"@id": PROFILE},
        "citation": _references(papers),
        "hasPart": _references(files),
        "mentions": {"@id": action["@id"]},
    }
    about: Entity = {
        "@id": NAME,
        "@type": "CreativeWork",
        "conformsTo": {"@id": SPECIFICATION},
        "about": {"@id": "./"},
    }
    profile: Entity = {
        "@id": PROFILE,
        "@type": "CreativeWork",
        "name": "Process Run Crate",
        "version": "0.5",
    }
    graph = chain([about, root, profile, action, mit, terms], software, files, read, *cited)
    unique = {entity["@id"]: entity for entity in graph}
    document = {"@context": [f"{SPECIFICATION}/context", SHA256], "@graph": [*unique.values()]}
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _references(entities: Iterable[Entity]) -> Any:
    """References to entities: a list, or the reference to the only one."""
    each = [{"@id": entity["@id"]} for entity in entities]
    return each[0] if len(each) == 1 else each


def _software(name: str, version: str) -> Entity:
    """A program. The address of celnav is in the metadata of its installation, where it may be a
    placeholder, which is left out.
    """
    entity = {"@id": f"#{name}", "@type": "SoftwareApplication", "name": name}
    entity["softwareVersion"] = version
    if name == "python":
        entity["@id"] = entity["url"] = f"https://docs.python.org/release/{version}/"
        return entity
    if name != "celnav":
        entity["@id"] = f"pkg:pypi/{name}@{version}"  # a package URL
    try:
        fields = metadata.metadata(name).get_all("Project-URL") or ()
    except metadata.PackageNotFoundError:  # a checkout that is not installed
        fields = ()
    for field in fields:
        label, _, url = field.partition(", ")
        if label.lower() == "homepage" and ".invalid/" not in url:
            entity["url"] = url
    return entity


def _file(path: Path, id: str) -> Entity:
    kind = TYPES.get(path.suffix) or MimeTypes().guess_type(path.name)[0]
    entity = {"@id": id, "name": path.name, "encodingFormat": kind or "application/octet-stream"}
    if not CHANGING.search(id):
        entity |= {"contentSize": str(path.stat().st_size), "sha256": sha256(path)}
    return entity


def _cited(citation: str) -> list[Entity]:
    """A paper and its authors, from its BibTeX entry."""
    fields = {
        name: re.sub(r"\s+", " ", re.sub(r"[{}]|\\(?=&)", "", text))
        for name, text in FIELD.findall(citation)
    }
    names = fields.get("author", "").split(" and ")
    authors: list[Entity] = [
        {"@id": f"#{quote(name)}", "@type": "Person", "name": name} for name in filter(None, names)
    ]
    key = citation.partition("{")[2].partition(",")[0]
    doi = fields.get("doi")
    paper = {
        "@id": f"https://doi.org/{doi}" if doi else f"#{quote(key)}",
        "@type": "ScholarlyArticle",
        "name": fields.get("title", key),
        "author": _references(authors),
    }
    if "year" in fields:
        paper["datePublished"] = fields["year"]
    return [paper, *authors]
