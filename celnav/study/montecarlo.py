"""Monte Carlo: number of runs, a random generator for each run, blocks of runs.

The random numbers of a run depend only on ``(seed, study, run)``, where ``study`` is the number of
the configuration. They do not depend on block size, number of processes or order of computation.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence

from celnav.gaussian.checks import describe, integer, number, sequence
from celnav.gaussian.linalg import Array

MOST_NUMBERS = 1 << 22  # largest number of random numbers drawn ahead, for all runs: 32 MiB
_INIT_A, _MULT_A = 0x43B0D7E5, 0x931E8875  # from numpy's SeedSequence, whose streams are stable
_INIT_B, _MULT_B = 0x8B51F9DD, 0x58F38DED
_MIX_L, _MIX_R = 0xCA01F9DD, 0x4973F715
AHEAD = 64  # number of requests whose numbers are drawn together
MOST_STEPS = 10_000_000  # of one run, at its finest rate; more would need a day and gigabytes
BRIEF = 0.1
"""Effort below which studies also shorten their runs, because so few runs decide little."""


def generator(seed: int, study: int, run: int) -> np.random.Generator:
    """The random generator of one run of one study; ValueError for negative arguments."""
    key = (integer("study", study, 0), integer("run", run, 0))
    return np.random.default_rng(np.random.SeedSequence(integer("seed", seed, 0), spawn_key=key))


def renewed(rng: np.random.Generator) -> np.random.Generator:
    """A new copy of a `generator`, in its initial state."""
    seeds: Any = rng.bit_generator.seed_seq
    return np.random.default_rng(seeds)


def run_of(rng: np.random.Generator) -> int:
    """The run number of a `generator`."""
    seeds: Any = rng.bit_generator.seed_seq
    return int(seeds.spawn_key[-1])


class _Seeds(ISeedSequence):
    """A seed sequence with precomputed words for one generator."""

    def __init__(self, words: Array):
        self.words = words

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Any:  # noqa: ARG002
        return self.words


def generators(seed: int, study: int, runs: int) -> list[np.random.Generator]:
    """The generators of runs 0 to ``runs - 1``, as from `generator`, but computed together.

    `numpy.random.SeedSequence` mixes its words one after the other, and the run is the last word.
    So all runs share the earlier steps.
    """
    seed, study = integer("seed", seed, 0), integer("study", study, 0)
    if max(seed >> 128, study >> 32, runs >> 32):  # too large for the words used below
        return [generator(seed, study, run) for run in range(runs)]
    pool = np.random.SeedSequence(seed, spawn_key=(study,)).pool
    word, last = np.arange(runs, dtype=np.uint32), np.empty((4, runs), np.uint32)
    factor = _INIT_A * pow(_MULT_A, 20, 1 << 32)  # after 4 words, 12 pairs of them and the study
    for i, mixed in enumerate(pool.tolist()):
        hashed, factor = _hashed(word, factor, _MULT_A)
        combined = np.uint32(_MIX_L * mixed % (1 << 32)) - np.uint32(_MIX_R) * hashed
        last[i] = combined ^ (combined >> np.uint32(16))
    words, factor = np.empty((runs, 8), np.uint32), _INIT_B
    for i in range(8):
        words[:, i], factor = _hashed(last[i % 4], factor, _MULT_B)
    if sys.byteorder == "big":
        words = words[:, [1, 0, 3, 2, 5, 4, 7, 6]]
    seeds: list[Any] = [_Seeds(row) for row in words.view(np.uint64)]
    return [np.random.Generator(np.random.PCG64(each)) for each in seeds]


def _hashed(values: Array, factor: int, by: int) -> tuple[Any, int]:
    """Hash 32-bit words with a factor; return them and the next factor."""
    after = factor * by % (1 << 32)
    mixed = (values ^ np.uint32(factor % (1 << 32))) * np.uint32(after)
    return mixed ^ (mixed >> np.uint32(16)), after


def normals(rngs: Sequence[np.random.Generator], *shapes: tuple[int, ...]) -> list[Array]:
    """Standard normal arrays ``(..., runs, n)``, one for each shape ``(..., n)``; each generator
    draws one run.
    """
    for rng in (
        every := sequence(
            "rngs", rngs, "[celnav.study.montecarlo.generator(seed, study, run)]", least=1
        )
    ):
        if not hasattr(rng, "standard_normal"):
            raise ValueError(
                f"rngs: expected generators, such as np.random.default_rng(0), got {describe(rng)}"
            )

    draws = [[rng.standard_normal(shape) for shape in shapes] for rng in every]
    return [np.stack(column, -2) for column in zip(*draws, strict=True)]


class Draws:
    """Standard normal numbers for each run, equal to the numbers of separate calls of its
    generator, but drawn in chunks.

    `close` resets the generators to the state after the used numbers. ``owned``: whether nothing
    else uses the generators; then `close` has no effect.

    >>> draws = Draws(rngs)
    >>> noise = draws(3)  # (runs, 3)
    """

    def __init__(self, rngs: Sequence[np.random.Generator], owned: bool = False):
        self.rngs, self._owned = rngs, owned
        # Generators other than numpy's, such as `Noiseless`, are called for each request.
        self._ahead = all(type(rng) is np.random.Generator for rng in rngs)
        self._chunk = np.empty((len(rngs), 0))
        self._used, self._before = 0, list[Any]()

    def __call__(self, count: int) -> Array:
        """The next numbers ``(runs, count)``."""
        if not self._ahead:
            return np.stack([rng.standard_normal(count) for rng in self.rngs])
        left = self._chunk[:, self._used :]
        if left.shape[1] >= count:
            self._used += count
            return np.ascontiguousarray(left[:, :count])
        room = max(1, MOST_NUMBERS // len(self.rngs))
        fresh = np.empty((len(self.rngs), max(count - left.shape[1], min(room, AHEAD * count))))
        if not self._owned:
            self._before = [rng.bit_generator.state for rng in self.rngs]
        for rng, row in zip(self.rngs, fresh, strict=True):
            rng.standard_normal(out=row)
        self._used, self._chunk = count - left.shape[1], fresh
        return np.concatenate([left, fresh[:, : self._used]], 1)

    def close(self) -> None:
        """Reset the generators to the state after the used numbers."""
        if self._used < self._chunk.shape[1]:
            for rng, state in zip(self.rngs, self._before, strict=not self._owned):
                rng.bit_generator.state = state
                rng.standard_normal(self._used)


def blocks(runs: int, size: int) -> list[range]:
    """Consecutive ranges of at most ``size`` runs."""
    return [
        range(first, min(first + size, runs))
        for first in range(0, integer("runs", runs), integer("block", size))
    ]


def effort(value: str | float | None = None, default: float = 1.0) -> float:
    """The fraction in (0, 1] of the Monte-Carlo runs: ``value``, or the environment variable
    ``CELNAV_EFFORT``, or ``default``; ValueError for other numbers.
    """
    name, text = (
        ("effort", value)
        if value is not None
        else ("CELNAV_EFFORT", os.environ.get("CELNAV_EFFORT", default))
    )
    try:
        fraction = float(text)
    except (TypeError, ValueError):
        fraction = 0.0
    if not 0.0 < fraction <= 1.0:
        raise ValueError(f"{name}: expected a number in (0, 1], got {text!r}")
    return fraction


def run_count(full: int, runs: int | None, effort: float) -> int:
    """Number of runs of a study: ``runs``, or the full number times the effort; at least 2."""
    scaled = integer("full", full) * number("effort", effort, above=0.0, most=1.0)
    return integer("runs", max(2, round(scaled)) if runs is None else runs, 2)


def steps(name: str, count: float) -> int:
    """The number of steps of a run, rounded from ``count``; ValueError with ``name`` if it is below
    1 or too large.
    """
    if not 0.5 < count <= MOST_STEPS:
        raise ValueError(f"{name}: expected a run of 1 to {MOST_STEPS} steps, got {count:.10g}")
    return round(count)
