"""Truncated or damaged files: the values read equal those written, and losses are reported."""

from __future__ import annotations

import re
from dataclasses import fields

import numpy as np
import pytest
from rinex_pair import TOE, both, navigation, observations, written

from celnav.files import InputError
from celnav.receiver.rinex import read_navigation, read_observations

TIMES = TOE + 1800.0 + 30.0 * np.arange(6)
FIELDS = {"observations": (3, 16, (0, 14, 15)), "navigation": (4, 19, (0,))}
"""For lines: start and width of the fields, and valid lengths of the last field."""


@pytest.fixture(scope="module")
def texts():
    return {"observations": observations(both(), TIMES)[0], "navigation": navigation(both())}


HOW = ["letter", "cut", "lost", "twice"]


def cut(rng, line, kind):
    """A line that ends within a field; a line that ends with a field is complete in RINEX."""
    start, width, whole = FIELDS[kind]
    pieces = [line[:k].rstrip() for k in range(start + 1, len(line))]
    return str(
        rng.choice([p for p in pieces if (len(p) - start) % width not in whole] or [line[:1]])
    )


def damaged(rng, lines, k, how, kind):
    """Lines with one damaged line."""
    before, line, after = lines[:k], lines[k], lines[k + 1 :]
    match how:
        case "letter":
            at = int(rng.integers(max(len(line), 1)))
            return [*before, line[:at] + str(rng.choice([*"#x~_"])) + line[at + 1 :], *after]
        case "cut":
            return [*before, cut(rng, line, kind), *after]
        case "lost":
            return before + after
        case "twice":
            return [*before, line, line, *after]
        case "end":
            return [*before, cut(rng, line, kind)]


def block_of(lines, kind, k):
    """The epoch or broadcast set to which a line belongs."""
    head = ">" if kind == "observations" else ("C", "G")
    body = lines[next(i for i, line in enumerate(lines) if "END OF HEADER" in line) + 1 :]
    first = len(lines) - len(body)
    return sum(line.startswith(head) for line in body[: k - first + 1]) - 1


def values(found):
    """The values read, by time or by satellite."""
    if hasattr(found, "times"):
        return {
            float(t): {
                n: (found.code[k, s], found.doppler[k, s]) for s, n in enumerate(found.names)
            }
            for k, t in enumerate(found.times)
        }
    return {
        name: tuple(getattr(found.sets, f.name)[k] for f in fields(found.sets))
        for k, name in enumerate(found.sets.names)
    }


def same(one, other):
    """A satellite that is missing in all epochs may also be missing in the result."""
    if isinstance(one, dict):
        return all(np.array_equal(one[n], other.get(n, (np.nan,) * 2), equal_nan=True) for n in one)
    return one == other


READ = {"observations": read_observations, "navigation": read_navigation}


def attempt(read, path):
    """The values read, or the error."""
    try:
        return read(path), ""
    except InputError as error:
        return None, str(error)


@pytest.mark.parametrize("kind", READ)
def test_what_one_damage_leaves_is_read_as_written_and_the_rest_is_said(texts, tmp_path, kind):
    read, lines = READ[kind], texts[kind].splitlines()
    first = next(i for i, line in enumerate(lines) if "END OF HEADER" in line) + 1
    whole = values(read(written(tmp_path, texts[kind])))
    order = list(whole)
    if kind == "navigation":
        order = [line[:3] for line in lines[first:] if line[0] in "CG"]
    lost, refused = 0, 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        k, how = int(rng.integers(first, len(lines))), str(rng.choice([*HOW, "end"]))
        changed = damaged(rng, lines, k, how, kind)
        path, block = written(tmp_path, "\n".join(changed) + "\n"), block_of(lines, kind, k)
        found, refusal = attempt(read, path)
        if found is None:
            assert re.match(rf"{re.escape(str(path))}, line \d+: expected", refusal), seed
            assert (how, block) == ("end", 0), seed
            refused += 1
            continue
        left = values(found)
        assert all(same(whole[name], left[name]) for name in left), seed
        missing = {order.index(name) for name in whole if name not in left}
        # Without its first line a broadcast set cannot be distinguished from the set before.
        touched = {block, block - 1} if (how, kind) == ("lost", "navigation") else {block}
        touched = set(range(block, len(order))) if how == "end" else touched
        assert missing <= touched, seed
        if missing:
            lost += 1
            numbers = [int(re.search(r", line (\d+): expected", said)[1]) for said in found.damaged]
            assert min(abs(n - 1 - k) for n in numbers) <= len(lines) // len(order) + 1, seed
            assert len(numbers) <= 2, seed
            with pytest.raises(InputError, match=re.escape(found.damaged[0])):
                read(path, strict=True)
    assert lost > 200
    assert refused < 60


@pytest.mark.parametrize("kind", READ)
def test_what_much_damage_leaves_is_read_as_written_or_refused(texts, tmp_path, kind):
    read, lines = READ[kind], texts[kind].splitlines()
    first = next(i for i, line in enumerate(lines) if "END OF HEADER" in line) + 1
    whole = values(read(written(tmp_path, texts[kind])))
    blocks = [block_of(lines, kind, k) for k in range(first, len(lines))]
    refused = 0
    for seed in range(150):
        rng, changed = np.random.default_rng(1000 + seed), lines
        # Change only one line of a block: a lost line and a repeated line together keep the number
        # of lines.
        some = rng.choice(blocks[-1] + 1, rng.integers(1, blocks[-1] + 2), replace=False)
        for block in sorted(some.tolist(), reverse=True):
            k = first + int(rng.choice(np.flatnonzero(np.equal(blocks, block))))
            changed = damaged(rng, changed, k, str(rng.choice(HOW)), kind)
        path = written(tmp_path, "\n".join(changed) + "\n")
        found, refusal = attempt(read, path)
        if found is None:
            assert re.match(rf"{re.escape(str(path))}, line \d+: expected", refusal), seed
            refused += 1
        else:
            left = values(found)
            assert all(same(whole[name], left[name]) for name in left), seed
            assert len(left) == len(whole) or found.damaged, seed
    assert 20 < refused < 130
