"""Rows of a ledger: numbers, tiers, verdicts, and what is written of them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from celnav.show import page
from celnav.show.claims import TYPES, dumps, plain, style, table, written
from celnav.study.ledger import KINDS, VERDICTS, WORDS, Number, Row, estimate, order


def claim(*numbers, kind="finding", **more):
    return Row(kind, "one", "It is so", lambda _: list(numbers), **more).judged(None)


@pytest.mark.parametrize(
    ("ci", "holds"),
    [
        ((0.2, 0.8), True),
        ((1.2, 1.8), False),
        ((-2.0, -1.0), False),
        ((0.5, 1.5), None),
        ((-1.0, 2.0), None),
    ],
)
def test_a_number_with_an_interval_holds_if_all_of_it_does(ci, holds):
    number = Number("x", 0.5 * sum(ci), (0.0, 1.0), ci)
    assert number.holds is holds
    assert number._replace(strict=True).holds is (holds or False)
    assert claim(number).verdict == {True: "shown", False: "not shown", None: "undecided"}[holds]


@pytest.mark.parametrize(
    ("value", "holds"), [(0.0, True), (1.0, True), (1.0 + 1e-12, False), (-5.0, False)]
)
def test_a_number_without_sampling_error_is_inside_or_outside(value, holds):
    assert Number("x", value, (0.0, 1.0)).holds is holds
    assert Number("x", value, (None, None)).holds is True
    assert Number("x", np.nan, (0.0, 1.0)).holds is None


def test_all_numbers_have_to_hold_and_one_that_does_not_decides():
    good, bad, open_ = (
        Number("a", 0.5, (0, 1)),
        Number("b", 2.0, (0, 1)),
        Number("c", 1.0, (0, 1), (0.5, 1.5)),
    )
    assert claim(good, good).verdict == "shown"
    assert claim(good, open_).verdict == "undecided"
    assert claim(good, open_, bad).verdict == "not shown"
    assert written(claim(good, bad))["value"] == 2.0


TIERS = [
    (0.5, "reproduced"), (0.95, "undecided"), (1.5, "in part"), (2.95, "undecided"), (4.0, "not reproduced")
]  # fmt: skip


@pytest.mark.parametrize(("value", "verdict"), TIERS)
def test_the_verdict_is_that_of_the_first_tier_that_holds(value, verdict):
    ci = (value - 0.1, value + 0.1)
    tiers = {
        "reproduced": [Number("x", value, (None, 1.0), ci)],
        "in part": [Number("x", value, (None, 3.0), ci)],
    }
    found = Row("statement", "one", "It is so", lambda _: tiers).judged(None)
    assert found.verdict == verdict
    assert found.holds is {"reproduced": True, "undecided": None}.get(verdict, False)
    assert found.failure is (verdict not in ("reproduced", "undecided"))


def test_a_statement_is_not_reproduced_by_an_interval_that_excludes_what_is_printed():
    number = Number("x", 0.5, (0.0, 1.0), (0.4, 0.6), printed=0.55)
    for printed, verdict in ((0.55, "reproduced"), (0.7, "not reproduced")):
        assert claim(number._replace(printed=printed), kind="statement").verdict == verdict
    assert claim(number._replace(printed=0.7), kind="erratum").verdict == "paper in error"


def test_a_number_that_could_not_be_computed_is_a_failure():
    found = claim(Number("x", np.nan), kind="check")
    assert (found.verdict, found.holds, found.failure) == ("no number", None, True)


def test_what_is_expected_is_no_surprise_and_a_success_may_be_one():
    bad = Number("x", 2.0, (0.0, 1.0))
    assert not claim(bad, kind="statement", expected="not reproduced").failure
    assert claim(bad._replace(value=0.5), kind="statement", expected="not reproduced").failure


def test_a_row_without_numbers_says_so():
    assert (
        Row("statement", "one", "It is so", expected="not decidable").judged(None).verdict
        == "not decidable"
    )
    assert Row("statement", "one", "It is so").judged(None).verdict == "not addressed"
    assert Row("erratum", "one", "It is so").judged(None).verdict == "paper in error"
    assert (
        Row("statement", "one", "It is so", lambda _: Number("x", np.nan)).judged(None).verdict
        == "no number"
    )


def test_kinds_and_verdicts_are_checked():
    with pytest.raises(ValueError, match=r"^kind: expected one of statement, erratum"):
        Row("claim", "one", "It is so")
    with pytest.raises(ValueError, match=r"^expected: .*did you mean reproduced"):
        Row("statement", "one", "It is so", expected="reproducd")
    with pytest.raises(ValueError, match=r"^verdict: "):
        Row("statement", "one", "It is so", lambda _: {"partly": [Number("x", 0.0)]}).judged(None)
    assert set(KINDS) == set(WORDS)
    assert len(set(VERDICTS)) == len(VERDICTS)


def test_the_interval_is_that_of_the_runs():
    samples = np.random.default_rng(0).normal(5.0, 2.0, 400)
    number = estimate("mean", np.mean, [samples], (4.0, 6.0))
    assert number.value == samples.mean()
    half = 1.96 * samples.std() / 20.0
    np.testing.assert_allclose(number.ci, (number.value - half, number.value + half), rtol=0.02)


def test_what_we_find_has_the_numbers_at_hand():
    number = Number("x", 0.05321, (0, 1), (0.0481, 0.0592))
    assert (
        claim(number, found="Only {0}, or {0.value:.1f}.").note
        == "Only 0.0532 [0.0481, 0.0592], or 0.1."
    )
    assert f"{number:.1f}" == "0.1 [0.0, 0.1]"
    assert f"{Number('x', 3.0)}" == "3"
    assert claim(Number("x", np.nan), found="Only {0}.").note == ""


def test_it_is_written_as_plain_json_in_the_order_of_its_types():
    number = Number("x", 1.23456789, (None, 2.0), (1.0, 1.5), printed=1.2)
    found = Row(
        "statement",
        "one",
        "It is so",
        lambda _: number,
        "§1",
        "because",
        printed={"a": [1.0, np.nan]},
    ).judged(None)
    (written,) = json.loads(dumps([found]))
    assert list(written) == list(TYPES)
    assert all(type(written[key]) in TYPES[key] for key in TYPES)
    assert (written["value"], written["ci"], written["accept"]) == (
        1.23457,
        [1.0, 1.5],
        [None, 2.0],
    )
    assert written["printed"] == {"a": [1.0, None]}
    assert written["numbers"][0]["printed"] == 1.2
    with pytest.raises(ValueError, match="different ids, got one"):
        dumps([found, found])


def test_plain_values():
    assert plain((np.float64(1.0), np.bool_(True), "a", None, np.inf)) == [
        1.0,
        True,
        "a",
        None,
        None,
    ]
    assert order(3e-9) == 1e-8
    assert order(0.0) == 0.0


STYLES = {
    "reproduced": "good",
    "shown": "good",
    "holds": "good",
    "reproduced with fitted parameters": "good",
    "not reproduced": "bad",
    "not shown": "bad",
    "does not hold": "bad",
    "paper in error": "error",
    "undecided": "open",
    "not addressed": "open",
    "not decidable": "open",
    "no number": "open",
    "level only": "part",
    "in part": "part",
    "reconstructed": "part",
    "noted": "part",
}


def test_each_verdict_has_its_color():
    """And the page has a color of its own for each of the five classes."""
    assert {verdict: style(verdict) for verdict in VERDICTS} == STYLES
    text = page.document("t")
    for name in set(STYLES.values()):
        assert f".{name}{{color:var(--{name})" in text
    colors = [text.split(f"--{name}:#")[1][:6].split("}")[0] for name in set(STYLES.values())]
    assert len(set(colors)) == 5


@pytest.mark.parametrize(
    ("value", "kind", "cell"),
    [
        (0.5, "finding", '<td class="good">shown</td>'),
        (2.0, "finding", '<td class="bad">not shown <b>(not as expected)</b></td>'),
        (2.0, "erratum", '<td class="bad">not shown <b>(not as expected)</b></td>'),
        (0.5, "erratum", '<td class="error">paper in error</td>'),
        (np.nan, "check", '<td class="open">no number <b>(not as expected)</b></td>'),
    ],
)
def test_a_row_of_a_page_has_the_color_of_its_verdict(value, kind, cell):
    row = table([written(claim(Number("x", value, (0.0, 1.0)), kind=kind))])
    assert row.endswith(f"{cell}</tr></tbody></table>")
