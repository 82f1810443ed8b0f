"""A filter run twice, with numpy and as machine code, and the comparison of both tracks."""

from __future__ import annotations

import numpy as np

import celnav

FIELDS = ("times", "mean", "std", "innovation", "whitened", "used", "log_likelihood", "failed_at")


def twice(filter, *arguments, of=None, engine="compiled", **options):
    """Tracks from the numpy engine and from another engine; ``of``: another filter for the numpy
    engine.
    """
    options = {"on_failure": "flag"} | options
    known = celnav.run(filter if of is None else of, *arguments, **options)
    return known, celnav.run(filter, *arguments, engine=engine, **options)


def assert_same(known, found, least=1e-9, engine="compiled"):
    """Compare every field: means and standard deviations within ``least`` of value and standard
    deviation, counts exactly.
    """
    assert found.engine == engine
    assert repr(found) == repr(known)
    mine, theirs = (
        {name: getattr(track, name) for name in FIELDS} | track.events for track in (found, known)
    )
    assert mine.keys() == theirs.keys()
    for name, x in theirs.items():
        y = mine[name]
        assert (y is None) == (x is None), name
        if x is not None:
            assert (y.shape, y.dtype) == (x.shape, x.dtype), name
            np.testing.assert_array_equal(
                *((np.isnan(y), np.isnan(x)) if y.dtype.kind == "f" else (y, x)), name
            )
    np.testing.assert_array_equal(found.times, known.times)
    if known.mean is not None:
        assert worst(found.mean - known.mean, np.abs(known.mean) + deviations(known)) < least
    if known.std is not None:
        assert worst(found.std - known.std, known.std) < least
    if known.whitened is not None:
        assert worst(found.whitened - known.whitened, 1.0 + np.abs(known.whitened)) < 1e3 * least
        assert worst(found.nis - known.nis, 1.0 + known.nis) < 1e3 * least
    assert (
        worst(found.log_likelihood - known.log_likelihood, 1.0 + np.abs(known.log_likelihood))
        < 1e3 * least
    )
    assert (found.belief is None) == (known.belief is None)
    if known.belief is not None:
        assert type(found.belief) is type(known.belief)
        assert (
            worst(found.cov - known.cov, known.std[..., :, None] * known.std[..., None, :])
            < 10.0 * least
        )


def deviations(track):
    """Standard deviations for the components of a mean, or the largest if their numbers differ; 1
    if none are stored.
    """
    if track.std is None:
        return 1.0
    return track.std if track.std.shape == track.mean.shape else track.std.max(-1, keepdims=True)


def worst(error, scale):
    """The largest relative error that is not nan."""
    ratio = np.abs(error) / np.where(scale > 0.0, scale, 1.0)
    return np.max(ratio[np.isfinite(ratio)], initial=0.0)


def told(call, *arguments, **options):
    """How a call ends: "" or the text of its error."""
    try:
        call(*arguments, **options)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""
