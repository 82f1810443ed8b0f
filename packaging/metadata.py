"""Metadata of a release, made from `pyproject.toml`, `packaging/owner.toml`, `CHANGELOG.md` and
`data/references.bib`.

``python packaging/metadata.py`` writes `CITATION.cff`, `codemeta.json`, `.zenodo.json`,
`paper/paper.bib` and the blocks between ``owner: NAME`` and ``end of owner`` of other files.
``--check`` writes nothing and fails if a file is not up to date. ``--version 1.2.3`` first makes
that the version, and dates what is unreleased. ``--ready`` fails while something is missing that a
release needs.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tomllib
from collections.abc import Callable, Container
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

ROOT = Path(__file__).resolve().parents[1]
PLACEHOLDER = "owner.invalid"
PAPERS = ("Sun2015", "Wu2012", "Xu2023", "Liang2014", "Fan", "Deng2013")
"""Keys of the six papers in `data/references.bib`."""
TITLE = (
    "celnav: batched square-root filters for navigation, and six papers on them "
    "reproduced and judged"
)
WORDS = {"true", "false", "yes", "no", "on", "off", "y", "n", "null"}
"""What YAML does not read as text."""
REQUIRED = {
    "authors",
    "repository",
    "documentation",
    "reports",
    "conda_maintainers",
    "ai_usage",
    "funding",
}
OPTIONAL = {"software_doi", "paper_doi", "codechecker", "codecheck_report"}
"""Names in `packaging/owner.toml`."""
VERSIONED = {
    "pyproject.toml": r'^version = "(.*)"$',
    "celnav/__init__.py": r'^__version__ = "(.*)"$',
    "packaging/recipe.yaml": r'^  version: "(.*)"$',
}
"""Files that state the version -> pattern of the line."""
UNRELEASED = re.compile(r"^## Unreleased\n(.*?)(?=^## )", re.DOTALL | re.MULTILINE)
BLOCK = re.compile(
    r"(?P<head>^[^\n]*owner: (?P<name>\w+)[^\n]*\n).*?(?P<end>^[^\n]*end of owner)",
    re.DOTALL | re.MULTILINE,
)
MARKED = (
    "pyproject.toml",
    "packaging/recipe.yaml",
    "paper/paper.md",
    "SECURITY.md",
    "CODE_OF_CONDUCT.md",
    ".github/ISSUE_TEMPLATE/config.yml",
    "codecheck.yml",
    "docs/try.md",
)
"""Files with blocks that `packaging/owner.toml` fills."""


@dataclass(frozen=True)
class Release:
    """What the files say of a release.

    project: table of `pyproject.toml`. owner: `packaging/owner.toml`. released: date of the
    version in `CHANGELOG.md`, None if it has none. papers: entries of the six papers, by field.
    """

    project: dict[str, Any]
    owner: dict[str, Any]
    released: date | None
    papers: list[dict[str, str]]

    @property
    def version(self) -> str:
        """As in `pyproject.toml`."""
        return str(self.project["version"])


def read(path: str) -> str:
    """Text of a file of the repository."""
    return (ROOT / path).read_text(encoding="utf-8")


def bibliography() -> dict[str, dict[str, str]]:
    """Key -> fields of each entry of `data/references.bib`; braces and line ends are removed."""
    entries = {}
    for entry in re.split(r"^@", read("data/references.bib"), flags=re.MULTILINE)[1:]:
        kind, key = re.match(r"(\w+)\{(\w+),", entry).groups()  # type: ignore[union-attr]
        fields = {"kind": kind, "key": key}
        for name, value in re.findall(r"^ +(\w+) *= \{(.*?)\},?$", entry, re.DOTALL | re.MULTILINE):
            fields[name] = re.sub(r"\s+", " ", re.sub(r"[{}]|\\(?=&)", "", value))
        entries[key] = fields
    return entries


def owner() -> dict[str, Any]:
    """`packaging/owner.toml`, whose names are checked."""
    table = tomllib.loads(read("packaging/owner.toml"))
    if set(table) != REQUIRED | OPTIONAL:
        names = ", ".join(sorted(REQUIRED | OPTIONAL))
        raise SystemExit(f"packaging/owner.toml: expected {names}; got {', '.join(sorted(table))}")
    for author in table["authors"]:
        if not {"given", "family", "affiliation"} <= set(author) or not all(author.values()):
            raise SystemExit(
                "packaging/owner.toml: expected given, family and affiliation of each author, "
                f"and orcid or nothing; got {author}"
            )
    return table


def load() -> Release:
    """The release that the files of this checkout describe."""
    project = tomllib.loads(read("pyproject.toml"))["project"]
    heading = rf"^## {re.escape(project['version'])} \((\d{{4}}-\d\d-\d\d)"
    dated = re.search(heading, read("CHANGELOG.md"), re.MULTILINE)
    entries = bibliography()
    return Release(
        project=project,
        owner=owner(),
        released=date.fromisoformat(dated[1]) if dated else None,
        papers=[entries[key] for key in PAPERS],
    )


def missing(release: Release) -> list[str]:
    """What a release needs and does not have, one sentence each."""
    lines = [
        f"packaging/owner.toml: {name} is a placeholder, {value!r}"
        for name, value in release.owner.items()
        if name not in OPTIONAL and (not value or PLACEHOLDER in str(value))
    ]
    if release.released is None:
        lines.append(f"CHANGELOG.md: version {release.version} has no date")
    unreleased = UNRELEASED.search(read("CHANGELOG.md"))
    if unreleased and unreleased[1].strip():
        lines.append(
            'CHANGELOG.md: "Unreleased" is not empty; '
            "packaging/metadata.py --version X.Y.Z dates it"
        )
    return lines


# -- people and papers -----------------------------------------------------------------------------
def authors(release: Release, person: Callable[[dict[str, str]], Any], nobody: Any) -> list[Any]:
    """One item for each author, or ``nobody`` until the owner has named one."""
    return [person(author) for author in release.owner["authors"]] or [nobody]


def full_name(author: dict[str, str]) -> str:
    """Given name and family name."""
    return f"{author['given']} {author['family']}"


def names(entry: dict[str, str]) -> list[dict[str, str]]:
    """Authors of an entry of the bibliography, as CITATION.cff has them."""
    split = [name.split(", ") for name in entry["author"].split(" and ")]
    return [{"family-names": family, "given-names": given} for family, given in split]


def reference(entry: dict[str, str]) -> dict[str, Any]:
    """A paper as CITATION.cff has it; its fields are those that the bibliography has."""
    start, _, end = entry.get("pages", "").partition("--")
    fields = {
        "type": "article",
        "title": entry["title"],
        "authors": names(entry),
        "journal": entry.get("journal"),
        "volume": entry.get("volume"),
        "issue": entry.get("number"),
        "start": start,
        "end": end,
        "year": int(entry["year"]) if "year" in entry else None,
        "doi": entry.get("doi"),
        "notes": entry.get("note"),
    }
    return {name: value for name, value in fields.items() if value}


def sentence(entry: dict[str, str]) -> str:
    """A paper as one line of a list of references."""
    people = ", ".join(f"{a['family-names']} {a['given-names']}" for a in names(entry))
    where = ", ".join(entry[name] for name in ("journal", "volume", "year") if name in entry)
    parts = [people, entry["title"], where, entry.get("doi", "")]
    return ". ".join(part for part in parts if part)


# -- whole files -----------------------------------------------------------------------------------
def scalar(value: Any) -> str:
    """A value of one line in YAML; a text that could be read as something else is quoted."""
    text = str(value)
    plain = re.fullmatch(r"[A-Z][\w.-]*( [\w.(),-]+)*|[a-z]+(-[a-z]+)*|\d+\.\d+\.\d+", text)
    if isinstance(value, str) and (not plain or text.lower() in WORDS):
        return json.dumps(value, ensure_ascii=False)
    return text


def yaml_lines(value: Any, indent: str = "") -> list[str]:
    """A mapping in YAML's block style."""
    lines = []
    for name, item in value.items():
        if isinstance(item, dict):
            lines += [f"{indent}{name}:", *yaml_lines(item, f"{indent}  ")]
        elif isinstance(item, list):
            lines.append(f"{indent}{name}:")
            for element in item:
                inner = (
                    yaml_lines(element, f"{indent}    ")
                    if isinstance(element, dict)
                    else [f"{indent}    {scalar(element)}"]
                )
                inner[0] = f"{indent}  - {inner[0].strip()}"
                lines += inner
        else:
            lines.append(f"{indent}{name}: {scalar(item)}")
    return lines


def citation(release: Release) -> str:
    """CITATION.cff, in the format 1.2.0."""

    def person(author: dict[str, str]) -> dict[str, str]:
        fields = {
            "family-names": author["family"],
            "given-names": author["given"],
            "affiliation": author["affiliation"],
            "orcid": f"https://orcid.org/{author['orcid']}" if author.get("orcid") else "",
        }
        return {name: value for name, value in fields.items() if value}

    people = authors(release, person, {"name": "The celnav authors"})
    dated = {"date-released": str(release.released)} if release.released else {}
    owner = release.owner
    software = {"title": TITLE, "authors": people, "version": release.version, **dated}
    if owner["paper_doi"]:
        preferred = {
            "type": "article",
            "title": TITLE,
            "authors": people,
            "journal": "Journal of Open Source Software",
            "doi": owner["paper_doi"],
        }
    else:
        preferred = {"type": "software", **software, "repository-code": owner["repository"]}
    fields = {
        "cff-version": "1.2.0",
        "message": "If you use celnav, please cite it, and the paper whose filter you use "
        "(celnav list shows them).",
        **software,
        "title": "celnav",
        "abstract": release.project["description"] + ".",
        "type": "software",
        "license": release.project["license"],
        "repository-code": owner["repository"],
        "url": owner["documentation"],
        **({"doi": owner["software_doi"]} if owner["software_doi"] else {}),
        "keywords": release.project["keywords"],
        "preferred-citation": preferred,
        "references": [reference(entry) for entry in release.papers],
    }
    head = "# Written by packaging/metadata.py. cffconvert --validate checks it."
    return "\n".join([head, *yaml_lines(fields)]) + "\n"


def as_json(fields: dict[str, Any]) -> str:
    """A file of JSON; empty values are left out."""
    kept = {name: value for name, value in fields.items() if value}
    return json.dumps(kept, indent=2, ensure_ascii=False) + "\n"


def codemeta(release: Release) -> str:
    """codemeta.json, in the vocabulary of CodeMeta 3.0."""

    def person(author: dict[str, str]) -> dict[str, Any]:
        fields = {
            "@id": f"https://orcid.org/{author['orcid']}" if author.get("orcid") else "",
            "@type": "Person",
            "givenName": author["given"],
            "familyName": author["family"],
            "affiliation": {"@type": "Organization", "name": author["affiliation"]},
        }
        return {name: value for name, value in fields.items() if value}

    def article(entry: dict[str, str]) -> dict[str, Any]:
        doi = f"https://doi.org/{entry['doi']}" if "doi" in entry else ""
        fields = {
            "@type": "ScholarlyArticle",
            "@id": doi,
            "name": entry["title"],
            "datePublished": entry.get("year"),
        }
        return {name: value for name, value in fields.items() if value}

    owner, project = release.owner, release.project
    return as_json(
        {
            "@context": "https://w3id.org/codemeta/3.0",
            "@type": "SoftwareSourceCode",
            "name": project["name"],
            "description": project["description"],
            "version": release.version,
            "dateModified": str(release.released or ""),
            "license": f"https://spdx.org/licenses/{project['license']}",
            "author": authors(
                release, person, {"@type": "Organization", "name": "The celnav authors"}
            ),
            "identifier": owner["software_doi"],
            "codeRepository": owner["repository"],
            "issueTracker": f"{owner['repository']}/issues",
            "softwareHelp": owner["documentation"],
            "developmentStatus": "https://www.repostatus.org/#active",
            "programmingLanguage": "Python",
            "runtimePlatform": f"Python {project['requires-python']}",
            "softwareRequirements": [
                {
                    "@type": "SoftwareSourceCode",
                    "name": re.match(r"[\w-]+", line)[0],  # type: ignore[index]
                    "version": re.sub(r"^[\w-]+", "", line),
                }
                for line in project["dependencies"]
            ],
            "operatingSystem": ["Linux", "macOS", "Windows"],
            "keywords": project["keywords"],
            "referencePublication": [article(entry) for entry in release.papers],
        }
    )


def zenodo(release: Release) -> str:
    """.zenodo.json, in the format of the archive's deposits."""

    def person(author: dict[str, str]) -> dict[str, str]:
        fields = {
            "name": f"{author['family']}, {author['given']}",
            "affiliation": author["affiliation"],
            "orcid": author.get("orcid", ""),
        }
        return {name: value for name, value in fields.items() if value}

    project = release.project
    return as_json(
        {
            "title": TITLE,
            "description": project["description"] + ".",
            "upload_type": "software",
            "version": release.version,
            "publication_date": str(release.released or ""),
            "access_right": "open",
            "license": project["license"],
            "language": "eng",
            "creators": authors(release, person, {"name": "The celnav authors"}),
            "keywords": project["keywords"],
            "related_identifiers": [
                {"identifier": entry["doi"], "relation": "references", "scheme": "doi"}
                for entry in release.papers
                if "doi" in entry
            ],
            "references": [sentence(entry) for entry in release.papers],
        }
    )


def entries_of(cited: Container[str]) -> str:
    """The entries of `data/references.bib` with the cited keys."""
    every = re.split(r"\n(?=@)", read("data/references.bib"))
    return "\n".join(entry for entry in every if entry.partition("{")[2].partition(",")[0] in cited)


def paper_bibliography(_release: Release) -> str:
    """`paper/paper.bib`: the entries that `paper/paper.md` cites."""
    return entries_of(set(re.findall(r"@(\w+)", read("paper/paper.md"))))


WHOLE = {
    "CITATION.cff": citation,
    "codemeta.json": codemeta,
    ".zenodo.json": zenodo,
    "paper/paper.bib": paper_bibliography,
}
"""Files that are written as a whole."""


# -- blocks of other files -------------------------------------------------------------------------
def project_authors(release: Release) -> str:
    """Authors in `pyproject.toml`."""
    people = authors(release, full_name, "The celnav authors")
    return "authors = [" + ", ".join(f'{{ name = "{name}" }}' for name in people) + "]"


def project_urls(release: Release) -> str:
    """Links in `pyproject.toml`."""
    repository = release.owner["repository"]
    links = {
        "Homepage": repository,
        "Documentation": release.owner["documentation"],
        "Source": repository,
        "Issues": f"{repository}/issues",
        "Changelog": f"{repository}/blob/main/CHANGELOG.md",
    }
    return "\n".join(["[project.urls]", *(f'{name} = "{url}"' for name, url in links.items())])


def project_readme(release: Release) -> str:
    """Substitutions that make pictures and links of `README.md` absolute."""
    repository = release.owner["repository"]
    away = "(?![a-z]+:|#)"  # not an address, not a place on the page
    pairs = {
        rf"!\[(.*?)\]\({away}(.*?)\)": rf"![\1]({repository}/raw/main/\2)",
        rf"\]\({away}(.*?)\)": rf"]({repository}/blob/main/\1)",
    }
    lines = [f"    {{ pattern = '{old}', replacement = '{new}' }}," for old, new in pairs.items()]
    return "\n".join(["substitutions = [", *lines, "]"])


def paper_authors(release: Release) -> str:
    """Authors, affiliations and date in the head of `paper/paper.md`."""
    places = list(dict.fromkeys(author["affiliation"] for author in release.owner["authors"]))
    people: list[dict[str, Any]] = [
        {
            "name": full_name(author),
            **({"orcid": author["orcid"]} if author.get("orcid") else {}),
            "affiliation": str(places.index(author["affiliation"]) + 1),
        }
        for author in release.owner["authors"]
    ]
    nobody = {"name": "The celnav authors", "affiliation": "1"}
    affiliations = [
        {"index": index, "name": place}
        for index, place in enumerate(places or [PLACEHOLDER], start=1)
    ]
    fields: dict[str, Any] = {"authors": people or [nobody], "affiliations": affiliations}
    if release.released:
        fields["date"] = f"{release.released.day} {release.released:%B %Y}"
    return "\n".join(yaml_lines(fields))


def recipe_about(release: Release) -> str:
    """What the conda recipe says of the package."""
    fields = {
        "summary": release.project["description"],
        "homepage": release.owner["repository"],
        "repository": release.owner["repository"],
        "documentation": release.owner["documentation"],
    }
    return "\n".join(yaml_lines(fields, "  "))


def recipe_maintainers(release: Release) -> str:
    """Maintainers of the conda recipe."""
    people = release.owner["conda_maintainers"] or [PLACEHOLDER]
    return "\n".join(yaml_lines({"recipe-maintainers": people}, "  "))


def contact_links(release: Release) -> str:
    """Links beside the forms for issues."""
    links = [
        {
            "name": "Vulnerability",
            "url": f"{release.owner['repository']}/blob/main/SECURITY.md",
            "about": "Report it in private; SECURITY.md says how.",
        },
        {
            "name": "Documentation",
            "url": release.owner["documentation"],
            "about": "How-to pages, reference, glossary and derivations.",
        },
    ]
    return "\n".join(yaml_lines({"contact_links": links}))


def codecheck(release: Release) -> str:
    """What `codecheck.yml` says of the paper, the repository and the check."""
    people = authors(
        release,
        lambda author: {
            "name": f"{author['given']} {author['family']}",
            **({"ORCID": author["orcid"]} if "orcid" in author else {}),
        },
        {"name": "The celnav authors"},
    )
    doi, repository = release.owner["paper_doi"], release.owner["repository"]
    manuscript = f"{repository}/blob/main/paper/paper.md"
    fields = {
        "paper": {
            "title": TITLE,
            "authors": people,
            "reference": f"https://doi.org/{doi}" if doi else manuscript,
        },
        "repository": repository,
        "codechecker": [{"name": release.owner["codechecker"] or PLACEHOLDER}],
        "report": release.owner["codecheck_report"] or PLACEHOLDER,
    }
    return "\n".join(yaml_lines(fields))


def notebook_links(repository: str) -> dict[str, str]:
    """Service that runs notebooks of a public repository -> address of the folder `notebooks` there.

    Binder takes any address that git can clone. Colab takes repositories of GitHub only.
    """
    host, path = urlsplit(repository).netloc, urlsplit(repository).path.strip("/")
    binder = {"github.com": f"gh/{path}", "gitlab.com": f"gl/{quote(path, safe='')}"}
    place = binder.get(host, f"git/{quote(repository, safe='')}")
    links = {"Binder": f"https://mybinder.org/v2/{place}/main?urlpath=lab/tree/notebooks/"}
    if host == "github.com":
        links["Colab"] = f"https://colab.research.google.com/github/{path}/blob/main/notebooks/"
    return links


def try_notebooks(release: Release) -> str:
    """What `docs/try.md` says of Binder and Colab; without an address it has no link."""
    repository = release.owner["repository"]
    if PLACEHOLDER in repository:
        return (
            "The folder `binder/` describes an environment for the notebooks. The links to Binder\n"
            "and Colab will stand here as soon as the repository has a public address."
        )
    links = notebook_links(repository)
    lines = [
        f"| notebook | {' | '.join(links)} |",
        f"|---|{'---|' * len(links)}",
    ]
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        first = json.loads(path.read_text(encoding="utf-8"))["cells"][0]["source"]
        title = "".join(first).partition("\n")[0].removeprefix("# ")
        cells = [f"[open]({folder}{path.name})" for folder in links.values()]
        lines.append(f"| {title} | {' | '.join(cells)} |")
    lines += [
        "",
        "Binder installs all packages before it opens a notebook, which takes some minutes.",
    ]
    if "Colab" in links:
        lines += [
            "Colab does not install them. Add a first cell to the notebook, and run it:",
            "",
            "```",
            f"!git clone --quiet --depth 1 {repository} celnav",
            '!pip install --quiet "./celnav[papers,rinex,real]"',
            "%cd celnav/notebooks",
            "```",
            "",
            "celnav needs a newer numpy than Colab may have loaded. If Colab asks for it, restart the",
            "session. Then run `%cd celnav/notebooks` and the rest of the notebook.",
        ]
    return "\n".join(lines)


BLOCKS: dict[str, Callable[[Release], str]] = {
    "authors": project_authors,
    "urls": project_urls,
    "readme": project_readme,
    "paper": paper_authors,
    "ai_usage": lambda release: str(release.owner["ai_usage"]),
    "funding": lambda release: str(release.owner["funding"]),
    "about": recipe_about,
    "maintainers": recipe_maintainers,
    "links": contact_links,
    "codecheck": codecheck,
    "try": try_notebooks,
    "reports": lambda release: f"<{release.owner['reports']}>",
}
"""Names of blocks -> what they hold."""


def written(release: Release) -> dict[str, str]:
    """Path -> text of each file that holds metadata."""
    texts = {path: make(release) for path, make in WHOLE.items()}

    def filled(block: re.Match[str]) -> str:
        return f"{block['head']}{BLOCKS[block['name']](release)}\n{block['end']}"

    for path in MARKED:
        texts[path] = BLOCK.sub(filled, read(path))
    return texts


def stale(release: Release) -> list[str]:
    """Files that do not say what `packaging/owner.toml` and `pyproject.toml` say."""
    return [
        path
        for path, text in written(release).items()
        if not (ROOT / path).exists() or read(path) != text
    ]


def set_version(version: str) -> None:
    """Make it the version, and date what is unreleased in `CHANGELOG.md`."""
    if not re.fullmatch(r"\d+\.\d+\.\d+(rc\d+)?", version):
        raise SystemExit(f"--version: expected X.Y.Z or X.Y.ZrcN, got {version!r}")
    changes = read("CHANGELOG.md")
    if not UNRELEASED.search(changes):
        raise SystemExit('CHANGELOG.md: expected a section "## Unreleased" above the others')
    heading = f"## {version} ({date.today()})"
    crate = "celnav/commands/crate.py"
    dated = re.sub(r"^(RELEASED = ).*", rf'\1"{date.today()}"', read(crate), flags=re.MULTILINE)
    texts = {"CHANGELOG.md": changes.replace("## Unreleased\n", f"{heading}\n", 1), crate: dated}
    for path, pattern in VERSIONED.items():
        line = re.search(pattern, read(path), re.MULTILINE)
        if line is None:
            raise SystemExit(f"{path}: expected a line like {pattern}")
        text = read(path)
        texts[path] = text[: line.start(1)] + version + text[line.end(1) :]
    for path, text in texts.items():
        (ROOT / path).write_text(text, encoding="utf-8", newline="\n")


def main() -> None:
    """The command line; see the top of this file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--version", metavar="X.Y.Z", help="make this the version first")
    parser.add_argument("--check", action="store_true", help="fail if a file is not up to date")
    parser.add_argument("--ready", action="store_true", help="fail if a release is not possible")
    parser.add_argument("--tag", help="with --ready: the tag, which has to be v and the version")
    given = parser.parse_args()
    if given.version:
        set_version(given.version)
    release = load()
    if given.check or given.ready:
        lines = [f"{path} is not up to date: run packaging/metadata.py" for path in stale(release)]
        lines += missing(release) if given.ready else []
        if given.tag and given.tag != f"v{release.version}":
            lines.append(f"tag: expected v{release.version}, got {given.tag}")
        if lines:
            sys.exit("\n".join(lines))
        return
    for path, text in written(release).items():
        (ROOT / path).write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
