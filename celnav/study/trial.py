"""A trial: simulated runs of one configuration, filters for them, and the evaluation of the
estimates.

Each paper has a function ``trial(config, rngs) -> Trial``. Missions, campaigns and the linear bound
use only this function of the paper.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.records import Epoch, Filter, Info, epochs
from celnav.filters.run import ENGINE, explain, steps
from celnav.gaussian.belief import Gaussian, any_lost, nees
from celnav.gaussian.checks import choice, finite, instance, integer, sequence
from celnav.gaussian.linalg import Array, Belief, outer
from celnav.gaussian.spaces import EUCLIDEAN, Space

__all__ = [
    "Evaluation",
    "Group",
    "Noiseless",
    "Trial",
    "bound",
    "check_groups",
    "evaluate_filter",
    "scales",
    "squares",
    "trial_from_arrays",
]

TOGETHER = 8
"""Number of epochs evaluated at once; more would displace the filter's arrays from the cache."""


class Group(NamedTuple):
    """Components of the error that are evaluated together, such as a position.

    part: slice of the error's components.
    scale: factor from the state's units to ``unit``, one number or one for each component.
    axes: names of the components, for recordings; if empty, x, y and z, or numbers.

    >>> position = celnav.Group("position", "m", slice(0, 3), 1000.0)  # of errors in km
    """

    name: str
    unit: str
    part: slice
    scale: float | tuple[float, ...] = 1.0
    axes: Sequence[str] = ()

    @property
    def names(self) -> Sequence[str]:
        """Names of the components."""
        count = self.part.stop - self.part.start
        return self.axes or ("xyz" if count == 3 else [str(i + 1) for i in range(count)])


class Trial(NamedTuple):
    """Simulated runs of a configuration.

    groups: components that are evaluated. filters: by name. prior: of all runs, ``(runs, n)``.
    epochs: ``name ->`` epochs for the filter with this name; each call starts again. Epochs with a
        ``truth`` are evaluated.
    compare: ``(truth, belief) ->`` errors ``(runs, n)`` and roots ``(runs, n, n)`` of their
        predicted covariances.
    reference: name of a filter that is optimal for small errors, for `bound`; empty if there is
        none.
    place: function from states ``(..., n)`` to geocentric positions ``(..., 3)`` km; None if the
        state is not an orbit.
    """

    groups: tuple[Group, ...]
    filters: Mapping[str, Filter]
    prior: Gaussian
    epochs: Callable[[str], Iterable[Epoch]]
    compare: Callable[[Any, Belief], tuple[Array, Array]]
    reference: str = ""
    place: Callable[[Array], Array] | None = None


def check_groups(groups: Any, n: int) -> None:
    """Raise ValueError unless all are groups with a slice of the ``n`` components."""
    for group in sequence("groups", groups, "[Group('position', 'm', slice(0, 3))]"):
        instance("groups", group, Group, "each a Group")
        if not isinstance(group.part, slice) or not len(range(n)[group.part]):
            raise ValueError(
                f"groups: expected a slice of {n} components for {group.name}, got {group.part!r}"
            )


def trial_from_arrays(
    groups: Sequence[Group],
    filters: Mapping[str, Filter],
    prior: Gaussian,
    times: Array,
    z: Any,
    truth: Array,
    *,
    u: Any = None,
    space: Space = EUCLIDEAN,
    reference: str = "",
) -> Trial:
    """A `Trial` from arrays of runs; errors are estimate minus truth in the space of the states.

    prior: of one run. times: ``(T,)`` s. z, u: as for `celnav.epochs`. truth: ``(T, runs, N)``. The
        other arguments: see `Trial`.

    >>> truth, z = celnav.simulate(motion, radar, prior, times, runs=rngs)
    >>> filters = {"ukf": celnav.ukf(motion, radar)}
    >>> trial = celnav.study.trial.trial_from_arrays(groups, filters, prior, times, z, truth)
    """
    instance("filters", filters, Mapping, "filters by name, such as {'ukf': filter}")
    choice("reference", reference, ("", *filters))
    instance("prior", prior, Gaussian, "celnav.Gaussian(mean, cov)")
    check_groups(groups, prior.cov.shape[-1])
    instance("space", space, Space, "a Space, such as celnav.attitude()")
    states = finite("truth", truth, (None, None, prior.mean.shape[-1]))
    every = epochs(times, z, u, states)

    def compare(truth: Any, belief: Belief) -> tuple[Array, Array]:
        return -space.minus(
            truth, belief.mean
        ), belief.sqrt_cov  # the square root of the covariance of tangents at the mean

    start = Gaussian(np.tile(prior.mean, (states.shape[1], 1)), prior.cov)
    return Trial(tuple(groups), filters, start, lambda _name: every, compare, reference)


def squares(groups: Sequence[Group], values: Array) -> Array:
    """Sums of squares ``(..., groups)`` of errors or standard deviations ``(..., n)``, in the
    groups' units.
    """
    parts = [np.square(values[..., group.part] * np.asarray(group.scale)) for group in groups]
    # Add components one by one: numpy's reductions over so few numbers are several times slower.
    return np.stack([reduce(np.add, np.moveaxis(part, -1, 0)) for part in parts], -1)


def scales(groups: Sequence[Group], n: int) -> Array:
    """Factors ``(n,)`` that convert the components of an error to the units of the groups."""
    factors = np.ones(n)
    for group in groups:
        factors[group.part] = group.scale
    return factors


class Noiseless:
    """A generator that draws zeros, for the undisturbed run."""

    def standard_normal(self, shape: tuple[int, ...]) -> Array:
        """Zeros of a shape."""
        return np.zeros(shape)


class Evaluation(NamedTuple):
    """Results of a filter at the K evaluated epochs; nan where a run has no estimate.

    times: ``(K,)`` s. error, std: ``(K, runs, n)``, errors and predicted standard deviations.
    nees, nis, dof: ``(K, runs)``; ``dof`` is the number of measured components in ``nis``.
    cov: ``(K, n, n)``, predicted covariance of the first run.
    lost: ``(run, t, why)`` for each run that has failed. epochs: number of all epochs, evaluated or
        not.
    """

    times: Array
    error: Array
    std: Array
    nees: Array
    nis: Array
    dof: Array
    cov: Array
    lost: list[tuple[int, float, str]]
    epochs: int


def evaluate_filter(trial: Trial, name: str, every: int = 1) -> Evaluation:
    """`Evaluation` of the filter ``name``, at every ``every``-th epoch with a truth and at the last
    one; ValueError for an unknown name.
    """
    instance("trial", trial, Trial, "a Trial, such as problem.trial(filters, rngs)")
    filter, every = trial.filters[choice("name", name, trial.filters)], integer("every", every)
    records: Iterable[tuple[Epoch, Any, tuple[Info, ...]]]
    if (engine := ENGINE.get()) == "numpy":
        records = steps(filter, trial.prior, trial.epochs(name))
    else:
        from celnav.engine.compiled import steps_by

        records = steps_by(engine, filter, trial.prior, trial.epochs(name))
    lost: dict[int, tuple[float, str]] = {}
    count = 0

    def judged() -> Iterator[tuple[Any, ...]]:
        nonlocal count
        judgeable, before, skipped = 0, None, None
        for epoch, state, infos in records:
            count += 1
            why = ""
            if any_lost(state.belief):
                # Did a run fail in this step? A filter without memory may have failed earlier.
                start = filter.start(trial.prior) if before is None else before
                if (state.belief.lost() & ~start.belief.lost()).any():
                    why = explain(filter, start, state, epoch)
            before = state
            due = epoch.truth is not None and judgeable % every == 0
            if epoch.truth is not None:
                judgeable, skipped = judgeable + 1, None if due else (epoch, state.belief, infos)
            if due or why:
                _note_lost(lost, epoch, state.belief, why)
            if due:
                yield _row(trial, epoch, state.belief, infos)
        if skipped is not None:  # the last epoch with a truth
            _note_lost(lost, *skipped[:2])
            yield _row(trial, *skipped)

    rows, blocks = judged(), []
    for block in iter(lambda: list(islice(rows, TOGETHER)), []):
        times, error, root, nis, dof = (
            np.array(column, np.float64) for column in zip(*block, strict=True)
        )
        with np.errstate(invalid="ignore"):  # a failed run is nan
            std, normalized = np.sqrt(np.einsum("...ij,...ij->...i", root, root)), nees(error, root)
            cov = outer(root.reshape(len(root), -1, *root.shape[-2:])[:, 0])
        blocks.append((times, error, std, normalized, nis, dof, cov))
    if not blocks:
        raise ValueError("epochs: expected epochs with a truth, got none")
    arrays = (np.concatenate(column) for column in zip(*blocks, strict=True))
    failures = [(run, *what) for run, what in sorted(lost.items())]
    return Evaluation._make([*arrays, failures, count])


def _row(trial: Trial, epoch: Epoch, belief: Belief, infos: tuple[Info, ...]) -> tuple[Any, ...]:
    """Time, errors, roots of their covariances, NIS and its degrees of freedom at an epoch."""
    with np.errstate(invalid="ignore"):
        error, root = trial.compare(epoch.truth, belief)
    runs = error.shape[:-1]
    nis = sum((value for info in infos if (value := info.nis) is not None), np.zeros(runs))
    dof = sum((info.used.sum(-1) for info in infos if info.used is not None), np.zeros(runs))
    return epoch.t, error, np.broadcast_to(root, (*runs, *root.shape[-2:])), nis, dof


def _note_lost(
    lost: dict[int, tuple[float, str]], epoch: Epoch, belief: Belief, why: str = ""
) -> None:
    """Record the runs without an estimate; remove those that have an estimate again, as filters
    without memory may.
    """
    is_finite = np.atleast_1d(np.isfinite(belief.mean).all(-1))
    for i in np.flatnonzero(~is_finite).tolist():
        lost.setdefault(i, (float(epoch.t), why or "the estimate is not finite"))
    for i in [i for i in lost if is_finite[i]]:
        del lost[i]


def bound(trial: Trial, every: int = 1) -> Array | None:
    """Linearized posterior Cramer-Rao bound of the mean square errors, ``(K, groups)``; None
    without a reference filter.

    ``trial`` has one `Noiseless` run. The bound is the variance of the reference filter along this
    undisturbed run. For small process noise and errors in the linear range, no filter with the same
    model and measurements has smaller mean square errors.
    """
    instance("trial", trial, Trial, "a Trial, such as problem.trial(filters, rngs)")
    return (
        squares(trial.groups, evaluate_filter(trial, trial.reference, every).std)[:, 0]
        if trial.reference
        else None
    )
