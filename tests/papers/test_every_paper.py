"""Properties of the studies of all papers."""

from __future__ import annotations

import json
import pickle
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from once import once

import celnav
from celnav import real
from celnav.engine import compiled
from celnav.files import data
from celnav.filters.run import ENGINE
from celnav.papers import PAPERS, load
from celnav.show.claims import dumps
from celnav.study.ledger import WORDS
from celnav.study.montecarlo import effort


@pytest.mark.parametrize("paper", PAPERS)
def test_units_go_to_processes_and_are_told_apart(paper):
    units = load(paper).STUDY.units(effort=0.1)
    sent = {pickle.loads(pickle.dumps(unit)).key for unit in units}
    assert len(set(units)) == len(sent) == len(units)


BY_ENGINE = {
    "csrukf": ["0", "I", "stress/I", "sensor/D/I", "linear"],
    "ssukf": ["augmented", "turns", "heads", "components"],
    "tstdkf": ["constant, nine", "sweep"],
    "aasghqf": ["bound"],
    "aukf": ["near/Q 1"],
    "mars": ["0.1 m², modeled"],
}
"""Parts by paper that are run by both engines. Together they contain all filters that compile."""


@pytest.mark.parametrize("paper", PAPERS)
def test_neither_verdicts_nor_numbers_depend_on_the_engine(paper, monkeypatch):
    """With so few runs compiling is not worthwhile and numpy would run all filters; here every
    filter is compiled if possible.
    """
    study = load(paper).STUDY
    by_numpy = once(study)
    monkeypatch.setattr(compiled, "operation_limit", lambda *_work: compiled.MOST_AUTO)
    token = ENGINE.set("auto")
    try:
        again = study.reproduce(effort=effort(), only=BY_ENGINE[paper]).data
    finally:
        ENGINE.reset(token)
    by_both = replace(by_numpy, data={**by_numpy.data, **again})
    for mine, other in zip(by_numpy.claims(), by_both.claims(), strict=True):
        assert other.verdict == mine.verdict, mine.id
        for a, b in zip(mine.numbers, other.numbers, strict=True):
            ours, theirs = ([one.value, *(one.ci or ())] for one in (a, b))
            assert theirs == pytest.approx(ours, rel=1e-5, abs=1e-9, nan_ok=True), a.label


@pytest.mark.parametrize("paper", PAPERS)
def test_the_ledger_of_a_paper_follows_the_schema(paper):
    schema = json.loads(data("claims.schema.json").read_text(encoding="utf-8"))
    document = json.loads(dumps(once(load(paper).STUDY).claims()))
    Draft202012Validator(schema).validate(document)
    assert {claim["kind"] for claim in document["claims"]} >= {"statement", "finding", "check"}


STUDIES = {name: partial(load, name) for name in PAPERS} | {
    name: partial(real.load, name) for name in real.STUDIES
}


@pytest.mark.parametrize("name", STUDIES)
def test_each_sentence_of_an_answer_rests_on_rows_that_are_expected_to_bear_it(name):
    """A changed verdict removes the sentence, and so does a changed number in it."""
    study = STUDIES[name]().STUDY
    expected = {row.id: row.expected or WORDS[row.kind][0] for row in study.rows}
    assert study.found
    for text, rests_on in study.found:
        assert rests_on, text
        assert rests_on == {id: expected.get(id) for id in rests_on}, text
        assert set(re.findall(r"\{([\w-]+)\[", text)) <= set(rests_on), text


EQUATIONS = {
    "Sun2015": {
        8,
        *range(10, 21),
        *range(24, 39),
        *range(40, 44),
    },  # 1 to 7 state the problem, 39 is short for 38; 21 to 23 draw points
    "Liang2014": {15, 16, 17, *range(19, 29)},  # those before are textbook rules of points
    "Xu2023": {19},  # the available text lacks the others, and all equations of Wu2012 and Fan
}


@pytest.mark.parametrize("key", EQUATIONS)
def test_an_equation_is_found_by_searching_for_it(key):
    """Tags such as [Sun2015, Eqs. 27, 29-32] stand where the equation is computed."""
    found = set()
    for path in (Path(celnav.__file__).parent).rglob("*.py"):
        for tag in re.findall(rf"\[{key}, Eqs?\. ([^\]]*)\]", path.read_text(encoding="utf-8")):
            for first, last in re.findall(r"(\d+)(?:\s*(?:-|–|to)\s*(\d+))?", tag):
                if (
                    int(last or first) - int(first) <= 10
                ):  # a longer range is a chapter, and finds nothing
                    found.update(range(int(first), int(last or first) + 1))
    assert EQUATIONS[key] <= found, EQUATIONS[key] - found
