"""Rows of a ledger: numbers, tiers, verdicts, and their text."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from celnav.analysis.metrics import bootstrap
from celnav.show import claims, page
from celnav.show.claims import TYPES, Ledger, answer, dumps, plain, style, written
from celnav.study.ledger import (
    KINDS,
    VERDICTS,
    WORDS,
    Number,
    Row,
    Sentence,
    estimate,
    order,
    read_ledger,
    read_printed,
)


def table(rows):
    """The rows of a page."""
    return page.macro("ledger", rows)


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
    (0.5, "reproduced"),
    (0.95, "undecided"),
    (1.5, "in part"),
    (2.95, "undecided"),
    (4.0, "not reproduced"),
]


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
    assert found.surprise is (verdict != "reproduced")
    few = Row("statement", "one", "It is so", lambda _: tiers).judged(None, full=False)
    assert few.surprise is (verdict not in ("reproduced", "undecided"))


@pytest.mark.parametrize(
    ("tier", "holds"),
    [
        ("reproduced", True),
        ("reproduced with fitted parameters", True),
        ("level only", False),
        ("in part", False),
    ],
)
def test_a_statement_holds_as_it_is_said_or_not(tier, holds):
    row = Row("statement", "one", "It is so", lambda _: {tier: [Number("x", 0.5, (0.0, 1.0))]})
    found = row.judged(None)
    assert (found.verdict, found.holds) == (tier, holds)
    assert written(found)["holds"] is holds


def test_a_statement_is_not_reproduced_by_an_interval_that_excludes_what_is_printed():
    number = Number("x", 0.5, (0.0, 1.0), (0.4, 0.6), printed=0.55)
    for printed, verdict in ((0.55, "reproduced"), (0.7, "not reproduced")):
        assert claim(number._replace(printed=printed), kind="statement").verdict == verdict
    assert claim(number._replace(printed=0.7), kind="erratum").verdict == "paper in error"


@pytest.mark.parametrize(
    ("tier", "verdict"),
    [
        ("reproduced", "not reproduced"),
        ("reproduced with fitted parameters", "not reproduced"),
        ("level only", "level only"),
        ("in part", "in part"),
    ],
)
def test_what_is_reproduced_agrees_with_what_is_printed_and_less_need_not(tier, verdict):
    number = Number("x", 0.5, (0.0, 1.0), (0.4, 0.6), printed=0.9)
    row = Row("statement", "one", "It is so", lambda _: {tier: [number]})
    assert row.judged(None).verdict == verdict


@pytest.mark.parametrize(("printed_runs", "agrees"), [(0, False), (1600, False), (100, True)])
def test_a_printed_number_has_sampling_error_too(printed_runs, agrees):
    """The means of 1600 and of 100 runs from one distribution differ by the errors of both."""
    samples = np.random.default_rng(0).normal(5.0, 2.0, 1600)
    error = 2.0 / np.sqrt(1600)
    printed = samples.mean() + 2.9 * error
    number = estimate("mean", np.mean, [samples], printed=printed, printed_runs=printed_runs)
    assert number.reproduces is agrees
    if printed_runs:
        half = 1.96 * 2.0 * np.sqrt(1 / 1600 + 1 / printed_runs)
        np.testing.assert_allclose(
            number.agreement, [samples.mean() - half, samples.mean() + half], rtol=0.01
        )
    assert number._replace(printed=None).agreement is None


def test_a_printed_number_of_as_many_runs_is_met_as_often_as_it_should():
    """The paper's number and ours are drawn from one distribution: 95 % of the pairs agree."""
    rng = np.random.default_rng(1)
    agree = [
        estimate("rms", lambda x: np.sqrt(x.mean()), [ours], printed=theirs, printed_runs=50)
        for ours, theirs in zip(
            rng.chisquare(3, (200, 400)), np.sqrt(rng.chisquare(3, (200, 50)).mean(1)), strict=True
        )
    ]
    assert 0.9 <= np.mean([number.reproduces is True for number in agree]) <= 0.99
    two = agree[0]._replace(printed_count=2).agreement
    assert two[1] - agree[0].value == pytest.approx(
        2.2414 / 1.96 * (agree[0].agreement[1] - agree[0].value), rel=1e-4
    )


def test_the_number_that_decides_is_the_one_that_keeps_the_best_tier_from_holding():
    """Its printed value is shown with it, and so is the criterion that failed."""
    good = Number("a", 0.5, (0.0, 1.0), (0.4, 0.6), printed=0.55)
    bad = Number("b", 0.5, (0.0, 1.0), (0.4, 0.6), printed=0.9)
    tiers = {"reproduced": [good, bad], "in part": [good, bad]}
    found = Row("statement", "one", "It is so", lambda _: tiers, expected="in part").judged(None)
    assert found.verdict == "in part"
    assert found.decisive == bad
    told = written(found)
    assert (told["printed_value"], told["surprise"]) == (0.9, False)
    assert [(n["tier"], n["holds"]) for n in told["numbers"]] == [
        ("reproduced", True),
        ("reproduced", False),
        ("in part", True),
        ("in part", True),
    ]
    assert claims.ours(told["numbers"][1]) == "0.500 [0.400, 0.600]"
    assert claims.accepted(told["numbers"][1]) == "0 to 1; the printed value from 0.400 to 0.600"
    shown = [claims.outcome(number) for number in told["numbers"]]
    assert shown == ["met", "not met", "met", "met"]
    page = table([told])
    assert page.index('data-name="Accepted range">0 to 1') < page.index("<details")
    assert page.count(">not met</td>") == 1


def test_what_the_paper_prints_is_not_rounded_and_stands_beside_the_same_quantity_only():
    beside = claim(Number("x", 7136.6, printed=7136.635), kind="statement", printed=[7136.635, 3])
    assert written(beside)["printed"] == [7136.635, 3]
    page = table([written(beside)])
    assert 'data-name="Printed">7136.635</td>' in page
    assert "The paper prints 7136.635, 3." in page
    assert 'data-name="Ours">7136.60</td>' in page
    few = Number("x", 2.5, ci=(-np.inf, np.inf), printed=3.0)  # of too few runs for an interval
    assert 'data-name="Ours">2.50</td>' in table([written(claim(few, kind="statement"))])
    other = table([written(claim(Number("x", 2.0), kind="statement", printed="1/3"))])
    assert "Printed</th>" not in other
    assert "The paper prints 1/3." in other


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (Number("x", 1.0, ci=(1.0, 1.0)), "1"),
        (Number("x", 56967.2, (67.0, None), (46722.8, 68520.9)), "57000 [46700, 68500]"),
        (Number("x", 1.00056, ci=(1.00007, 1.00121)), "1.0006 [1.0001, 1.0012]"),
        (Number("x", 57.52, ci=(57.3, 57.7)), "57.5 [57.3, 57.7]"),
        (Number("x", 0.9996, (None, 1.0)), "0.9996"),
        (Number("x", 1390.0), "1390"),
        (Number("x", 8.12496e-16), "8.12·10⁻¹⁶"),
        (Number("x", 0.0, ci=(0.0, 0.31)), "0.00 [0.00, 0.310]"),
        (
            Number("x", 0.0312, ci=(3.93e-8, 958.3)),
            "0.0312 [3.93·10⁻⁸, 958], few runs or a heavy tail",
        ),
        (Number("x", np.nan), ""),
    ],
)
def test_numbers_have_the_digits_that_decide_and_no_exponent(number, text):
    assert claims.ours(plain(number)) == text


@pytest.mark.parametrize(
    ("accept", "text"),
    [
        ((None, None), ""),
        ((None, 1e6), "≤ 1000000"),
        ((0.5, None), "≥ 0.5"),
        ((0.5, 2.0), "0.5 to 2"),
        ((31, 31), "31"),
        ((1.0 + 1e-9, None), "> 1"),  # 1 is refused, so the row must not say "at least 1"
        ((None, 1.0 - 1e-9), "< 1"),
    ],
)
def test_an_accepted_range_does_not_contradict_the_verdict(accept, text):
    (number,) = written(claim(Number("x", 1.0, accept)))["numbers"]
    assert claims.accepted(number) == text


def test_an_interval_of_few_runs_or_a_heavy_tail_is_told():
    for ci, heavy in (((0.4, 12.3), True), ((4.0, 6.0), False), ((-1.0, 12.0), False)):
        page = table([written(claim(Number("NEES", 5.2, (None, 9.0), ci)))])
        assert ("few runs or a heavy tail" in page) is heavy


def test_what_was_found_is_said_with_the_verdict_that_it_was_written_for():
    number = Number("x", 0.5, (0.0, 1.0), (0.4, 0.6))
    assert claim(number, found="It is {0}.").note == "It is 0.5 [0.4, 0.6]."
    assert claim(number._replace(ci=(0.4, 1.6)), found="It is {0}.").note == ""
    assert claim(number, found="It is {0}.", expected="not shown").note == ""


SENTENCES = [
    Sentence("It is {a[0]:.1f} times as much.", {"a": "shown"}),
    Sentence("That is so, and b is not.", {"a": "shown", "b": "not shown"}),
]


def test_an_answer_is_made_of_the_sentences_whose_rows_have_their_verdicts():
    rows = {id: replace(claim(Number("x", 0.52, (0.0, 1.0))).row, id=id) for id in "ab"}
    a, b = (written(row.judged(None)) for row in rows.values())
    low = written(replace(rows["b"], decide=lambda _: Number("x", 2.0, (0.0, 1.0))).judged(None))
    assert answer(SENTENCES, [a, low]) == "It is 0.5 times as much. That is so, and b is not."
    left = "Not said here, since rows that it rests on have other verdicts: b"
    assert answer(SENTENCES, [a, b]) == f"It is 0.5 times as much. {left} (shown)."
    assert answer(SENTENCES, [a]) == f"It is 0.5 times as much. {left} (not among these rows)."
    assert "cannot be made" in answer([Sentence("{a[7]}", {"a": "shown"})], [a])


def test_with_a_part_of_the_runs_a_ledger_says_so_first():
    few = claim(Number("x", 0.5, (0.0, 1.0))).row.judged(None, full=False)
    for shown in (str(Ledger([few], "finding")), Ledger([few], "finding")._repr_markdown_()):
        assert shown.startswith("Only a part of the runs was done")
    html = Ledger([few], "finding")._repr_html_()
    assert html.startswith("<p>Only a part of the runs")
    assert ".cards.cards" in html  # the style of its table, which a notebook does not have
    assert str(Ledger([claim(Number("x", 0.5, (0.0, 1.0)))], "finding")).startswith("shown")
    said = str(Ledger([few], "finding", [Sentence("So it is.", {"one": "shown"})]))
    assert said.splitlines()[1] == "We find: So it is."


def test_a_number_that_could_not_be_computed_is_a_failure():
    found = claim(Number("x", np.nan), kind="check")
    assert (found.verdict, found.holds, found.surprise) == ("no number", None, True)


def test_what_is_expected_is_no_surprise_and_a_success_may_be_one():
    bad = Number("x", 2.0, (0.0, 1.0))
    assert not claim(bad, kind="statement", expected="not reproduced").surprise
    assert claim(bad._replace(value=0.5), kind="statement", expected="not reproduced").surprise


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
    (written,) = json.loads(dumps([found]))["claims"]
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
    """And the page has a different color for each of the five classes."""
    assert {verdict: style(verdict) for verdict in VERDICTS} == STYLES
    text = page.render("base.html", title="t")
    for name in set(STYLES.values()):
        assert f".{name}{{color:var(--{name})" in text
    colors = [text.split(f"--{name}:light-dark(")[1].split(")")[0] for name in {*STYLES.values()}]
    assert len(set(colors)) == 5


@pytest.mark.parametrize(
    ("value", "kind", "cell"),
    [
        (0.5, "finding", ' class="good">shown</td>'),
        (2.0, "finding", ' class="bad">not shown <b>(not as expected)</b></td>'),
        (2.0, "erratum", ' class="bad">not shown <b>(not as expected)</b></td>'),
        (0.5, "erratum", ' class="error">paper in error</td>'),
        (np.nan, "check", ' class="open">no number <b>(not as expected)</b></td>'),
    ],
)
def test_a_row_of_a_page_has_the_color_of_its_verdict(value, kind, cell):
    row = table([written(claim(Number("x", value, (0.0, 1.0)), kind=kind))])
    assert row.count(cell) == 1


@pytest.mark.parametrize("block", [1, 5])
def test_an_estimate_has_the_bootstrap_interval_of_its_blocks(block):
    """The number of runs is recorded, the number of epochs is not."""
    samples = np.cumsum(np.random.default_rng(3).standard_normal((2, 60)), 1) ** 2

    def ratio(a, b):
        return a.mean() / b.mean()

    found = estimate("ratio", ratio, samples, (0.5, 2.0), block)
    assert found.value == ratio(*samples)
    assert tuple(found.ci) == bootstrap(ratio, *samples, block=block)
    assert found.runs == (60 if block == 1 else 0)


# -- prose in a file ---------------------------------------------------------------------------------
PROSE = """
[[row]]
kind = "statement"
id = "halves"
says = '''
It halves
the error.'''
printed = [0.5, 1]

[[row]]
kind = "erratum"
id = "sign"
says = "A minus is missing."

[[sentence]]
text = "It does halve it."
rests_on = { halves = "reproduced" }
"""
HALF = {"halves": lambda _: Number("error", 0.5, (0.4, 0.6))}


@pytest.fixture
def prose(tmp_path):
    def read(text=PROSE, decisions=HALF):
        path = tmp_path / "ledger.toml"
        path.write_text(text, encoding="utf-8")
        return read_ledger(path, decisions)

    return read


def test_rows_are_read_in_the_order_of_the_file_and_decided_by_their_ids(prose):
    (halves, sign), (sentence,) = prose()
    assert halves == Row(
        "statement", "halves", "It halves the error.", HALF["halves"], printed=[0.5, 1]
    )
    assert (sign.kind, sign.decide) == ("erratum", None)
    assert halves.judged(None).verdict == "reproduced"
    assert sentence == Sentence("It does halve it.", {"halves": "reproduced"})


def test_what_is_printed_is_read_by_the_rows_that_say_it(tmp_path):
    (tmp_path / "ledger.toml").write_text(PROSE, encoding="utf-8")
    assert read_printed(tmp_path / "ledger.toml") == {"halves": [0.5, 1]}


def test_a_row_that_nothing_can_decide_needs_no_decision(prose):
    (row, _), _ = prose(PROSE.replace("printed", 'expected = "not decidable"\nprinted'), {})
    assert row.judged(None).verdict == "not decidable"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[[row]]", "[[raw]]", "table: expected one of row, sentence, got 'raw'; did you mean row"),
        ("[[row]]", "[[row", "ledger.toml: expected TOML, got an error: .*; fix that line"),
        ("says =", "say =", "row 'halves': field: .* got 'say'; did you mean says"),
        ("halves", "halve", "row 'halve': expected a decision for this id, got none; add it"),
        (
            'id = "sign"',
            'id = "halves"',
            "row 'halves': expected different ids, got this id twice",
        ),
        ("erratum", "eratum", "row 'sign': kind: .* got 'eratum'; did you mean erratum"),
        ("erratum", "finding", "row 'sign': expected a decision for this id, got none; add it"),
        ('kind = "erratum"', "", "row 'sign': kind: expected a value, got none; add it"),
        ('"A minus is missing."', "1", "row 'sign': says: expected a str, got 1"),
        ('= { halves = "reproduced" }', '= "halves"', "rests_on: expected a dict, got 'halves'"),
        ("{ halves", "{ halve", "sentence 'It does halve it.': rests_on: .* did you mean halves"),
        ("reproduced", "reprodced", "rests_on 'halves': .* did you mean reproduced"),
    ],
)
def test_prose_that_does_not_go_with_its_decisions_is_refused_by_name(prose, old, new, message):
    with pytest.raises(ValueError, match=message) as error:
        prose(PROSE.replace(old, new, 1))
    assert "ledger.toml" in str(error.value)


def test_a_decision_without_a_row_is_refused_by_name(prose):
    message = "ledger.toml, decision 'halve': add its .* got 'halve'; did you mean halves"
    with pytest.raises(ValueError, match=message):
        prose(decisions=HALF | {"halve": HALF["halves"]})
