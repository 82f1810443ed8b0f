"""A filter shown while it runs: each epoch goes to the Rerun viewer at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from tempfile import TemporaryFile
from typing import Any

import numpy as np

from celnav.files import write_bytes
from celnav.filters.records import Epoch, Info
from celnav.gaussian.checks import finite, instance, sequence
from celnav.lazy import requires_extra
from celnav.show import colors
from celnav.show.estimates import measurement_states
from celnav.show.reading import SHAPE

__all__ = ["live"]

Show = Callable[[Epoch, Any, tuple[Info, ...]], None]
"""Shows what `celnav.steps` yields."""


@contextmanager
def live(
    name: str, components: Sequence[str], *, to: str | os.PathLike[str] = ""
) -> Iterator[Show]:
    """Show a filter in the Rerun viewer while it runs: estimates ±3σ, innovations and NIS of each
    sensor, and which measurements are used, rejected or missing. Needs rerun.

    Parameters
    ----------
    name: title in the viewer.
    components: names of the n components of the state, with units.
    to: a viewer that runs already, such as ``"rerun+http://127.0.0.1:9876/proxy"``, or an ``.rrd``
        file, which is written when the block ends; empty: a viewer is started.

    Returns
    -------
    A function of ``epoch, state, infos``, which `celnav.steps` yields for one run.

    Raises
    ------
    ValueError: if the state has other components, or several runs.
    OSError: if there is no display for a window, or the viewer ends.

    >>> with celnav.show.live("falling body", ["height, m", "speed, m/s"]) as show:
    ...     for step in celnav.steps(filter, prior, celnav.epochs(times, z)):
    ...         show(*step)
    """
    with requires_extra("a live view", "record"):
        import rerun as rr
    from celnav.show.recording import new_file, open_stream, rgba, typed
    from celnav.show.views import TIMELINE, blueprint, plot, rows, states, tabs

    names = [
        instance("components", n, str, "a text")
        for n in sequence("components", components, '["x, m"]', 1)
    ]
    place = os.fspath(instance("to", to, str | os.PathLike, "a path or an address"))
    file = None if not place or "://" in place else new_file(place)
    layout = rows(
        tabs(*(plot(f"estimate/{k}", name) for k, name in enumerate(names))),
        plot("innovation", "innovations"),
        plot("nis", "NIS over its degrees of freedom (1 is consistent)"),
        states("states", "measurements"),
        row_shares=(3, 3, 3, 2),
    )
    with open_stream(name, rr.ChunkBatcherConfig.LOW_LATENCY()) as stream:
        memory = None if file is None else stream.memory_recording()
        if file is None and place:
            stream.connect_grpc(place)
        elif file is None:
            stream.connect_grpc(_opened())
        stream.send_blueprint(blueprint(layout, None), make_active=True, make_default=True)
        stream.send_recording_name(name)
        for k, component in enumerate(names):
            style = rr.SeriesLines(
                colors=[rgba(colors.ESTIMATE)] * 3,
                widths=[2.0, 1.0, 1.0],
                names=[f"{component} ±3σ"] * 3,
            )
            stream.log(f"estimate/{k}", style, static=True)
        shapes = {
            f"mean{SHAPE}": [-1, len(names)],
            f"covariance{SHAPE}": [-1, len(names), len(names)],
        }
        stream.log("state", rr.AnyValues(**shapes), static=True)
        shades = list(colors.STATES.values())
        lane = rr.StateConfiguration(values=list(colors.STATES), colors=[*map(rgba, shades)])

        def show(epoch: Epoch, state: Any, infos: tuple[Info, ...]) -> None:
            mean, std = np.asarray(state.belief.mean), np.asarray(state.belief.std)
            if mean.shape != (len(names),) or std.shape != mean.shape:
                raise ValueError(
                    f"components: expected names of a state {mean.shape} with σ {std.shape} of one "
                    f"run, got {len(names)}"
                )
            stream.set_time(TIMELINE, duration=float(finite("epoch.t", epoch.t, ())))
            for k, (x, sigma) in enumerate(zip(mean, 3.0 * std, strict=True)):
                stream.log(f"estimate/{k}", rr.Scalars([x, x - sigma, x + sigma]))
            stream.log(
                "state",
                rr.AnyValues(mean=typed(mean), covariance=typed(np.ravel(state.belief.cov))),
            )
            for k, info in enumerate(infos, 1):
                if info.innovation is None or info.used is None:
                    continue
                y, used = np.asarray(info.innovation), np.asarray(info.used)
                nis = float(np.asarray(info.nis)) / used.sum() if used.any() else np.nan
                stream.log(f"innovation/sensor_{k}", rr.Scalars(y))
                stream.log(f"nis/sensor_{k}", rr.Scalars(nis))
                (held,) = measurement_states(y[None], used[None])
                stream.log(f"states/sensor_{k}", lane, static=True)
                stream.log(f"states/sensor_{k}", rr.StateChange(state=str(held)))

        with stream:
            yield show
        if file is not None and memory is not None:
            write_bytes(file, memory.drain_as_bytes())


def _opened() -> str:
    """The address of a viewer that is started in a window, and stays open when the run ends."""
    from celnav.show import window

    window.require_display("give a file or a viewer that runs already as to=")
    with TemporaryFile() as said:
        viewer = window.start(said, *window.SIZE)
        try:
            viewer.ask(lambda _client: None)
        except (RuntimeError, TimeoutError) as error:
            raise OSError(f"the viewer opened no window {error}") from None
    viewer.process.returncode = 0  # or Python warns of a process that outlives its object
    return viewer.address
