"""Linearization: the extended Kalman filter's way from a function of a Gaussian to a mean and columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import unmasked
from celnav.gaussian.linalg import Array, is_unit, matvec, side_by_side, solve_upper_transposed
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.gaussian.transform import KEEP, Image, Outputs


class Taylor:
    """First-order expansion about the mean: with it every filter here is an extended Kalman filter.

    Parameters
    ----------
    jacobians: ``(mean (..., N), epoch) -> tuple`` of Jacobians ``(..., k, n)``, one for each output of the function, such as
        ``Taylor(lambda x, epoch: (F,))`` in a predict part. None: central differences along the columns of the root. `KEEP`, the
        state itself, needs none.
    step: length of the difference, in standard deviations.
    about: ``(..., N)``, the point to expand about instead of the mean, as an iterated filter does. The belief stays where it
        is: its mean is mapped by the linear function.
    """

    def __init__(
        self,
        jacobians: Callable[[Array, Any], tuple[Array, ...]] | None = None,
        step: float = 1e-3,
        *,
        about: ArrayLike | None = None,
    ):
        if not (np.isfinite(step) and step > 0.0):
            raise ValueError(f"step: expected a positive number, got {step!r}")
        if jacobians is not None and not callable(jacobians):
            raise ValueError(
                f"jacobians: expected a function (mean, epoch) -> (J,), such as lambda x, epoch: (F,), got {jacobians!r:.80}"
            )
        self.jacobians = jacobians
        self.step = float(step)
        self.about = None if about is None else np.asarray(about, dtype=np.float64)
        self.sign = np.ones(1)
        self.sign.flags.writeable = False
        self.linear = jacobians is not None

    def __repr__(self) -> str:
        return f"Taylor({'differences' if self.jacobians is None else 'Jacobians'})"

    def points(self, mean: Array, root: Array, space: Space, extra: Sequence[Array] = ()) -> list[Array]:
        """The center alone, or the center and its neighbors; noise points vary in their own directions only.

        With a center of its own, the last two points lie on the way from there to the mean, a step to either side.
        """
        center = mean if self.about is None else self.about
        roots = [root, *extra]
        total = sum(E.shape[-1] for E in roots)
        batch = np.broadcast_shapes(mean.shape[:-1], *(E.shape[:-2] for E in roots))
        if self.jacobians is not None:
            alone = np.broadcast_to(center, (1, *batch, center.shape[-1])).copy()
            return [alone, *(np.zeros((1, *batch, E.shape[-2])) for E in extra)]
        directions = self.step * np.vstack([np.zeros((1, total)), np.eye(total), -np.eye(total)])
        spread, first = [], 0
        for E in roots:
            D = E @ directions[:, first : first + E.shape[-1]].T
            D = np.broadcast_to(D, (*batch, *D.shape[-2:]))
            spread.append(np.moveaxis(D, -1, 0))
            first += E.shape[-1]
        if self.about is not None:
            way: list[Any] = [self.step * space.minus(mean, center), *(0.0 for _ in extra)]
            ways = [np.broadcast_to(w, D.shape[1:]) for w, D in zip(way, spread, strict=True)]
            spread = [np.concatenate([D, [w, -w]]) for D, w in zip(spread, ways, strict=True)]
        return [space.plus(center, spread[0]), *spread[1:]]

    def transform(
        self,
        g: Callable[..., Outputs],
        mean: Array,
        root: Array,
        space: Space,
        spaces: Sequence[Space],
        extra: Sequence[Array] = (),
        room: int = 0,
        epoch: Any = None,
    ) -> tuple[list[Image], Array]:
        """See `Transform`. Jacobians cover the state, then each of the noises in ``extra``."""
        X = self.points(mean, root, space, extra)
        outputs = g(*X)
        batch = X[0].shape[1:-1]
        roots = [root, *extra]
        total = sum(E.shape[-1] for E in roots)
        at = mean if self.about is None else self.about
        given = None if self.jacobians is None else self.jacobians(at, epoch)
        if self.jacobians is not None:
            if not isinstance(given, tuple | list):
                raise ValueError(f"jacobians: expected a tuple, one matrix for each output, got {type(given).__name__}")
            given = tuple(np.asarray(unmasked("jacobians", J), dtype=np.float64) for J in given)
        if given is not None and len(given) != len(outputs):
            moved = [i for i, y in enumerate(outputs) if y is not KEEP]  # the state itself needs none
            if len(given) != len(moved):
                raise ValueError(f"jacobians: expected {len(moved)} matrices, got {len(given)}")
            by_output = dict(zip(moved, given, strict=True))
            given = tuple(by_output.get(i, mean) for i in range(len(outputs)))
        images = []
        for i, (y, sp) in enumerate(zip(outputs, spaces, strict=True)):
            center = mean if y is KEEP else y[0]
            shift: Any = None
            if y is KEEP:
                blocks = [root, *(np.zeros((root.shape[-2], E.shape[-1])) for E in extra)]
                columns = np.broadcast_to(side_by_side(blocks), (*batch, root.shape[-2], total))
            elif given is not None:
                J, first, parts = given[i], 0, []
                rows, width = y.shape[-1] if sp is EUCLIDEAN else J.shape[-2], sum(E.shape[-2] for E in roots)
                if J.shape[-2:] != (rows, width):
                    raise ValueError(f"jacobians: expected shape (..., {rows}, {width}), got {J.shape}")
                for E in roots:
                    own = J[..., first : first + E.shape[-2]]
                    parts.append(own if is_unit(E) else own @ E)
                    first += E.shape[-2]
                columns = side_by_side(parts) if len(parts) > 1 else parts[0]
                columns = np.broadcast_to(columns, (*batch, *columns.shape[-2:]))
                if self.about is not None:
                    shift = matvec(J[..., : root.shape[-2]], space.minus(mean, at))
            else:
                d = sp.minus(y, center)
                columns = np.moveaxis(d[1 : total + 1] - d[total + 1 : 2 * total + 1], 0, -1) / (2.0 * self.step)
                if self.about is not None:
                    shift = (d[-2] - d[-1]) / (2.0 * self.step)
            images.append(Image(center, np.zeros(columns.shape[-2]) if shift is None else shift, columns))
        A = np.empty((*batch, sum(im.columns.shape[-2] for im in images), total + room))
        top = 0
        for i, im in enumerate(images):
            k = im.columns.shape[-2]
            A[..., top : top + k, :total] = im.columns
            images[i] = im._replace(columns=A[..., top : top + k, :total])
            top += k
        return images, A

    def slope(self, image: Image, root: Array) -> Array:
        """Jacobian of an image, ``(..., k, n)``."""
        if is_unit(root):
            return image.columns[..., : len(root)]
        return solve_upper_transposed(root, image.columns[..., : root.shape[-1]].mT).mT
