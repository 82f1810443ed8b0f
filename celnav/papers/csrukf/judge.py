"""How a claim is made from a result: a number, or a statistic of the runs with its interval."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celnav.claims import Claim
from celnav.linalg import Array
from celnav.metrics import bootstrap
from celnav.papers.csrukf.study import Result

Bounds = tuple[float | None, float | None]


class Judge:
    """Makes claims of one result; keeps the repeated arguments in one place."""

    def __init__(self, result: Result):
        self.result = result

    def fixed(
        self,
        id: str,
        kind: str,
        statement: str,
        value: float,
        accept: Bounds,
        *,
        paper: Any = None,
        ci: tuple[float, float] | None = None,
        note: str = "",
        expected: bool = True,
    ) -> Claim:
        """A claim on a number without sampling error, or with an interval known otherwise."""
        return Claim(
            id=id,
            kind=kind,
            statement=statement,
            value=float(value),
            accept=accept,
            expected=expected,
            paper=paper,
            ci=ci,
            full=self.result.full,
            note=note,
        )

    def sampled(
        self,
        id: str,
        kind: str,
        statement: str,
        statistic: Callable[..., Any],
        samples: list[Array],
        accept: Bounds,
        *,
        paper: Any = None,
        note: str = "",
        expected: bool = True,
    ) -> Claim:
        """A claim on a statistic of runs (the first axis of each sample), with its bootstrap interval."""
        return Claim(
            id=id,
            kind=kind,
            statement=statement,
            value=float(statistic(*samples)),
            accept=accept,
            expected=expected,
            paper=paper,
            ci=bootstrap(statistic, *samples),
            full=self.result.full,
            note=note,
        )

    def get(self, study: str, name: str) -> Array:
        return self.result.data[study][name]

    def final(self, study: str, name: str) -> Array:
        """Errors at the end, ``(runs, 6)`` km, m/s."""
        return np.asarray(self.get(study, f"{name}/error")[-1])


def rms3(error: Array) -> float:
    """3-D RMSE of ``(runs, 3)``."""
    return float(np.sqrt(np.square(error).sum(-1).mean()))


def ratio3(a: Array, b: Array) -> float:
    return rms3(a) / rms3(b)
