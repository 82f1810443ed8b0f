"""Recordings for the Rerun viewer: whole columns on one timeline, with the layout in the file. A
file is written completely or not at all.

This module imports rerun. Import it inside the function that records, so that filters run without
rerun. A study opens a file with `recording`, gives whole arrays to the `Recorder` (time first, nan
where there is nothing) and lays out `celnav.show.views`. Two recordings of the same arrays have the
same contents, since ids are given and no wall clock is logged. Geometry is single precision in the
viewer; `Recorder.exact` keeps double precision.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from celnav.files import write_bytes
from celnav.gaussian.checks import finite, instance, number, numbers, sequence
from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra
from celnav.show import colors
from celnav.show.reading import APPLICATION, SHAPE, START, STUDY
from celnav.show.views import DATE, TIMELINE, blueprint

with requires_extra("a recording", "record"):
    import rerun as rr
    from rerun.error_utils import strict_mode


__all__ = ["Recorder", "recording"]


def rgba(color: str, alpha: float = 1.0, name: str = "color") -> list[int]:
    """``#RRGGBB`` as four integers; ValueError for anything else."""
    if not isinstance(color, str) or not re.fullmatch("#[0-9a-fA-F]{6}", color):
        raise ValueError(f"{name}: expected #RRGGBB, got {color!r:.80}")
    return [*bytes.fromhex(color.lstrip("#")), round(255 * number("alpha", alpha, 0.0, 1.0))]


def _text(name: str, value: Any) -> str:
    return str(instance(name, value, str, "a text"))


def _size(radius: float) -> Any:
    return rr.Radius.ui_points(number("radius", radius, 0.0))


def _colors(colors: Sequence[str], count: int | None = None) -> list[list[int]]:
    palette = [rgba(color, name="colors") for color in sequence("colors", colors, '["#112233"]')]
    if not palette or count not in (None, len(palette)):
        raise ValueError(f"colors: expected {count or 'one or more'}, got {len(palette)}")
    return palette


def _labels(labels: Sequence[str], count: int) -> list[str]:
    names = [_text("labels", label) for label in sequence("labels", labels, '["x"]')]
    if names and len(names) != count:
        raise ValueError(f"labels: expected {count}, got {len(names)}")
    return names


def ellipsoid_axes(covariance: Array, sigmas: float = 3.0) -> tuple[Array, Array]:
    """Half sizes ``(..., 3)`` and rotations ``(..., 4)`` (quaternions x, y, z, w) of the ellipsoids
    of covariances ``(..., 3, 3)``.

    Raises
    ------
    ValueError: if a covariance is not positive semidefinite beyond round-off.
    """
    eigenvalues, axes = np.linalg.eigh(finite("covariance", covariance, (..., 3, 3)))
    sigmas = number("sigmas", sigmas, 0.0)
    if (eigenvalues[..., 0] < -1e-9 * np.abs(eigenvalues).max(-1, initial=0.0)).any():
        raise ValueError(
            "covariance: expected positive semidefinite matrices, smallest eigenvalue "
            f"{eigenvalues.min():.3g}"
        )
    # The eigenvectors may form a reflection. Reversing one axis then gives a rotation.
    axes[..., 0] *= np.where(np.linalg.det(axes) < 0.0, -1.0, 1.0)[..., None]
    quaternions = (
        Rotation.from_matrix(axes.reshape(-1, 3, 3)).as_quat().reshape(*axes.shape[:-2], 4)
    )
    return sigmas * np.sqrt(np.maximum(eigenvalues, 0.0)), quaternions


class Recorder:
    """An open recording over ``times (T,)`` s; every method logs the whole run of one entity.
    Lengths are in the unit of the view. Radii and line widths are in points of the screen at any
    zoom.

    >>> out.curve("error/x", error, "#E69F00", "UKF"); out.bounds("error/x", std, "UKF")
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        times: Array,
        counter: str = "",
        start_date: np.datetime64 | None = None,
    ) -> None:
        self.stream = stream
        self.times = times
        self._counter = counter
        self._start_date = start_date

    def _send(self, entity: str, columns: Any, rows: Any = slice(None)) -> None:
        """Log columns at some rows of the times, on every timeline."""
        times = self.times[rows]
        index = [rr.TimeColumn(TIMELINE, duration=times)]
        if self._start_date is not None:
            since = np.rint(1e9 * times).astype("timedelta64[ns]")
            index.append(rr.TimeColumn(DATE, timestamp=self._start_date + since))
        if self._counter:
            steps = np.arange(len(self.times))[rows]
            index.append(rr.TimeColumn(self._counter, sequence=steps))
        self.stream.send_columns(_text("entity", entity), index, columns)

    def _style(self, entity: str, style: Any) -> None:
        self.stream.log(_text("entity", entity), style, static=True)

    def _moving(
        self, entity: str, archetype: Any, style: Any, things: bool = False, **columns: Array
    ) -> None:
        """Log a moving entity: its style once, and its columns where all numbers are finite.

        Columns are ``(T, ...)``, or with ``things`` ``(T, k, ...)`` for k parts that move
        separately.
        """
        self._style(entity, archetype.from_fields(**style))
        lead = 2 if things else 1
        there = np.all(
            [
                np.isfinite(x).all(tuple(range(lead, x.ndim)))
                for x in columns.values()
                if x.dtype.kind != "U"
            ],
            0,
        )
        rows = {name: values[there] for name, values in columns.items()}
        counts = there.reshape(len(there), -1).sum(1)
        self._send(entity, archetype.columns(**rows).partition(counts))

    def _array(
        self, entity: str, name: str, values: ArrayLike, shape: tuple[int | None, ...]
    ) -> Array:
        """``values`` as float64 of shape ``(T, *shape)``, None for any length; ValueError names the
        entity and the argument.
        """
        return numbers(f"{_text('entity', entity)} {name}", values, (len(self.times), *shape))

    def text(self, entity: str, markdown: str) -> None:
        """A text panel."""
        self._style(
            entity, rr.TextDocument(_text("markdown", markdown), media_type="text/markdown")
        )

    def curve(
        self,
        entity: str,
        values: ArrayLike,
        color: str,
        name: str,
        *,
        width: float = 1.5,
        shown: bool = True,
    ) -> None:
        """Log a curve ``(T,)`` in a plot, with gaps at nan.

        Unless ``shown``, it is hidden until clicked in the legend.
        """
        y = self._array(entity, "values", values, ())
        names, widths = [_text("name", name)], [number("width", width, 0.0)]
        self.curves(entity, y[:, None], color, names, widths=widths, shown=[shown])

    def curves(
        self,
        entity: str,
        values: ArrayLike,
        color: str,
        names: Sequence[str],
        *,
        widths: Sequence[float],
        shown: Sequence[bool],
        rows: Any = slice(None),
    ) -> None:
        """Log k curves ``(T, k)`` of a color as one entity, with gaps where one of them is nan.

        The legend joins curves of the same name. ``rows``: of the times, where not at all.
        """
        texts = [_text("names", name) for name in sequence("names", names, '["x"]', 1)]
        k, count = len(texts), len(self.times[rows])
        visible = [
            instance("shown", seen, bool | np.bool_, "True or False")
            for seen in sequence("shown", shown, "[True]")
        ]
        if len(visible) != k:
            raise ValueError(f"shown: expected {k}, got {len(visible)}")
        y = numbers(f"{_text('entity', entity)} values", values, (count, k))
        style = rr.SeriesLines(
            colors=[rgba(color)] * k,
            names=texts,
            widths=finite("widths", widths, (k,)),
            visible_series=visible,
        )
        self._style(entity, style)
        # Gaps are empty rows, since two files with a nan never compare equal.
        there = np.isfinite(y).all(1)
        columns = rr.Scalars.columns(scalars=y[there].ravel())
        self._send(entity, columns.partition(k * there.astype(int)), rows)

    def bounds(
        self,
        entity: str,
        sigma: ArrayLike,
        name: str,
        *,
        center: ArrayLike = 0.0,
        shown: bool = True,
        color: str = colors.SIGMA,
    ) -> None:
        """Log ``entity/3s``, two curves: ``center`` ± three standard deviations ``(T,)``."""
        deviation, middle = self._array(entity, "sigma", sigma, ()), numbers("center", center)
        middle = self._array(
            entity, "center", middle if middle.ndim else np.full(len(self.times), middle), ()
        )
        both = np.stack([middle - 3.0 * deviation, middle + 3.0 * deviation], 1)
        names = [f"{_text('name', name)} ±3σ"] * 2
        self.curves(f"{entity}/3s", both, color, names, widths=[1.0] * 2, shown=[shown] * 2)

    def level(self, entity: str, value: ArrayLike, name: str, color: str = colors.SIGMA) -> None:
        """A horizontal line in a plot, or k of them ``(k,)``, such as the ends of a band."""
        values = np.atleast_1d(finite("value", value))
        k = len(values)
        about: Any = {"widths": [1.0] * k, "shown": [True] * k, "rows": [0, -1]}
        names = [_text("name", name)] * k
        self.curves(entity, np.stack([values, values]), color, names, **about)

    def states(
        self, entity: str, names: Sequence[str], colors: Mapping[str, str] = colors.STATES
    ) -> None:
        """Log which of several states holds at each time: used, rejected or missing measurements,
        or the model of an IMM. `celnav.show.views.states` shows each entity as a colored lane.

        names: ``(T,)`` texts; "" where no state holds. colors: ``#RRGGBB`` by state.

        >>> out.states("states/radar", ["used", "used", "rejected"])
        """
        held = np.array([_text("names", name) for name in sequence("names", names, '["used"]')])
        if held.shape != self.times.shape:
            raise ValueError(f"names: expected {len(self.times)} texts, got {len(held)}")
        shades = instance("colors", colors, Mapping, 'a table, such as {"used": "#009E73"}')
        if unknown := sorted({*held.tolist()} - {*shades, ""}):
            raise ValueError(f"colors: expected a color of each state, got none of {unknown}")
        style = rr.StateConfiguration(
            values=list(shades), labels=list(shades), colors=_colors(list(shades.values()))
        )
        self._style(entity, style)
        rows = np.flatnonzero(np.concatenate([[True], held[1:] != held[:-1]]))
        self._send(entity, rr.StateChange.columns(state=held[rows]), rows)

    def trail(self, entity: str, points: ArrayLike, color: str, *, radius: float = 1.0) -> None:
        """Log a line through ``points (T, 3)`` that grows by a segment per step. The view must list
        it as ``growing``.
        """
        p = self._array(entity, "points", points, (3,))
        segments = np.stack([np.concatenate([p[:1] * np.nan, p[:-1]]), p], 1)
        style = {"colors": rgba(color), "radii": _size(radius)}
        self._moving(entity, rr.LineStrips3D, style, strips=segments)

    def path(
        self, entity: str, strips: Sequence[Array], color: str, *, radius: float = 0.5
    ) -> None:
        """Lines ``(points, 3)`` that stay for the whole run."""
        lines = [
            numbers("strips", strip, ("points", 3))
            for strip in sequence("strips", strips, "[np.zeros((2, 3))]")
        ]
        self._style(entity, rr.LineStrips3D(lines, colors=rgba(color), radii=_size(radius)))

    def strips(
        self,
        entity: str,
        strips: ArrayLike,
        colors: Sequence[str],
        *,
        labels: Sequence[str] = (),
        radius: float = 1.0,
    ) -> None:
        """``k`` lines ``(T, k, points, 3)`` that move; lines that are partly nan are left out."""
        shades = _colors(colors)
        lines = self._array(entity, "strips", strips, (len(shades), None, 3))
        about = {
            "colors": np.array(shades, np.uint8),
            "labels": np.array(_labels(labels, len(shades))),
        }
        each: Any = {
            name: np.broadcast_to(values, (len(lines), *values.shape))
            for name, values in about.items()
            if len(values)
        }
        self._moving(entity, rr.LineStrips3D, {"radii": _size(radius)}, True, strips=lines, **each)

    def arrow(
        self, entity: str, origins: ArrayLike, vectors: ArrayLike, color: str, label: str
    ) -> None:
        """An arrow from ``origins (T, 3)`` along ``vectors (T, 3)``."""
        start, vector = (
            self._array(entity, "origins", origins, (3,)),
            self._array(entity, "vectors", vectors, (3,)),
        )
        style = {"colors": rgba(color), "radii": _size(1.5), "labels": _text("label", label)}
        self._moving(entity, rr.Arrows3D, style, origins=start, vectors=vector)

    def pose(self, entity: str, origins: ArrayLike, quaternions: ArrayLike) -> None:
        """Log the frame of everything below ``entity``: origins ``(T, 3)`` and attitudes ``(T, 4)``
        (see `celnav.gaussian.attitude`).
        """
        start, q = (
            self._array(entity, "origins", origins, (3,)),
            self._array(entity, "quaternions", quaternions, (4,)),
        )
        self._send(entity, rr.Transform3D.columns(translation=start, quaternion=q))

    def axes(
        self,
        entity: str,
        length: float,
        colors: Sequence[str],
        labels: Sequence[str] = (),
        *,
        radius: float = 1.5,
    ) -> None:
        """Log three arrows along the axes of ``entity`` for the whole run."""
        texts = _labels(labels, 3)
        names = {"labels": texts} if texts else {}
        vectors, palette = number("length", length) * np.eye(3), _colors(colors, 3)
        self._style(
            entity, rr.Arrows3D(vectors=vectors, colors=palette, radii=_size(radius), **names)
        )

    def points(
        self,
        entity: str,
        points: ArrayLike,
        color: str,
        *,
        alpha: float = 1.0,
        radius: float = 2.0,
        label: str = "",
    ) -> None:
        """Log points ``(T, 3)``, or ``k`` at a time ``(T, k, 3)``, without partly nan points."""
        p = numbers(f"{entity} points", points)
        p = self._array(entity, "points", p[:, None] if p.ndim == 2 else p, (None, 3))
        style = {"colors": rgba(color, alpha), "radii": _size(radius), "point_shading": "flat"}
        style |= {"labels": label} if _text("label", label) else {}
        self._moving(entity, rr.Points3D, style, True, positions=p)

    def ellipsoids(
        self,
        entity: str,
        centers: ArrayLike,
        covariance: ArrayLike,
        color: str,
        *,
        sigmas: float = 3.0,
        alpha: float = 0.35,
    ) -> None:
        """Ellipsoids of covariances ``(T, 3, 3)`` about ``centers (T, 3)``; none where either is
        nan.

        Raises
        ------
        ValueError: if a covariance is not positive semidefinite.
        """
        c, P = (
            self._array(entity, "centers", centers, (3,)),
            self._array(entity, "covariance", covariance, (3, 3)),
        )
        there = np.asarray(np.isfinite(c).all(1) & np.isfinite(P).all((1, 2)))
        half, quaternions = ellipsoid_axes(np.where(there[:, None, None], P, 0.0), sigmas)
        c = np.where(there[:, None], c, np.nan)
        mode = rr.components.FillMode.TransparentFillMajorWireframe
        style = {"colors": rgba(color, alpha), "fill_mode": mode, "line_radii": _size(0.7)}
        shape: Any = {"centers": c, "half_sizes": half, "quaternions": quaternions}
        self._moving(entity, rr.Ellipsoids3D, style, **shape)

    def globe(self, entity: str, radius: float) -> None:
        """A sphere about the origin, with circles of latitude and longitude every 15 degrees."""
        radius = number("radius", radius, above=0.0)
        self._style(
            entity, rr.Ellipsoids3D(radii=[radius], colors=rgba("#16324F"), fill_mode="solid")
        )
        around, up = np.linspace(-np.pi, np.pi, 121), np.linspace(-0.5 * np.pi, 0.5 * np.pi, 61)
        step = np.deg2rad(15.0)
        parallels = [_sphere(latitude, around) for latitude in step * np.arange(-5, 6)]
        meridians = [_sphere(up, longitude) for longitude in step * np.arange(24)]
        # Slightly above the ground, or both surfaces would flicker at the same depth.
        self.path(
            f"{entity}/grid",
            [1.003 * radius * line for line in parallels + meridians],
            "#3C6E9F",
            radius=0.4,
        )

    def bars(self, entity: str, values: ArrayLike, color: str) -> None:
        """Bars ``(k,)`` that stay for the whole run."""
        self._style(entity, rr.BarChart(numbers("values", values, (None,)), color=rgba(color)))

    def exact(self, entity: str, **values: ArrayLike) -> None:
        """Arrays ``(T, ...)`` in double precision, which `celnav.show.read` gives back."""
        columns: list[Any] = []
        shapes: dict[str, Any] = {}
        for name, value in values.items():
            rows = numbers(f"{entity} {name}", value)
            if rows.shape[:1] != self.times.shape:
                raise ValueError(
                    f"{entity} {name}: expected {len(self.times)} rows, got shape {rows.shape}"
                )
            shapes[f"{name}{SHAPE}"] = rows.shape
            rows = rows.reshape(len(rows), -1)
            columns += rr.AnyValues.columns(**{name: typed(rows.ravel())}).partition(
                np.full(len(rows), rows.shape[1])
            )
        self._send(entity, columns)
        self._style(entity, rr.AnyValues(**shapes))


def typed(values: Any) -> Any:
    """Values as an array of their own type. To other values rerun gives the type that their name
    had first in this process, so real numbers could become integers.
    """
    import pyarrow as pa

    return pa.array(values)


def _sphere(latitude: ArrayLike, longitude: ArrayLike) -> Array:
    """Points ``(..., 3)`` of the unit sphere."""
    lat, lon = np.broadcast_arrays(latitude, longitude)
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], -1)


@contextlib.contextmanager
def recording(
    path: str | os.PathLike[str],
    times: ArrayLike,
    *,
    name: str,
    layout: Any,
    properties: Mapping[str, Any] = {},
    counter: str = "",
    start: float | None = None,
    start_date: str | None = None,
) -> Iterator[Recorder]:
    """The recorder of a file, which is written when the block ends, or not at all.

    Parameters
    ----------
    path: of the file. An earlier recording of celnav is replaced; any other file is left alone.
    times: ``(T,)`` s, increasing.
    name: title in the viewer, and id. layout: a view or container of `celnav.show.views`.
    properties: facts about the whole recording. counter: name of a timeline that counts the rows;
        none if empty.
    start: time s at which the viewer and pictures show the recording first; None: the end.
    start_date: date and time of ``t = 0``, such as ``"2015-10-17T04:00:00"``; with it the recording
        has a second timeline of dates, "date".

    Raises
    ------
    ValueError: if ``times`` are not finite, increasing seconds, or ``path`` is a file that celnav
        did not make.
    OSError: naming ``path``, if it cannot be written.

    >>> layout = celnav.show.views.plot("error", "error, m")
    >>> with celnav.show.recording.recording("a.rrd", times, name="a", layout=layout) as out: ...
    """
    t = numbers("times", times)
    if t.ndim != 1 or len(t) < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0.0).all():
        raise ValueError(
            f"times: expected two or more finite, increasing seconds, got shape {t.shape}"
        )
    target = new_file(path)
    _text("counter", counter)
    instance("properties", properties, Mapping, "a table, such as {'seed': 0}")
    shown = number("start", t[-1] if start is None else start, t[0], t[-1])
    date = None if start_date is None else _date(start_date)
    # Batches that end by a clock would make the file depend on the load of the machine.
    with open_stream(name, rr.ChunkBatcherConfig.NEVER()) as stream:
        # Not to a file: its writer works in the background, reports no full disk, and then waits
        # for ever.
        memory = stream.memory_recording()
        with stream:
            # Without make_active the viewer in a browser makes a layout of its own.
            stream.send_blueprint(blueprint(layout, t), make_active=True, make_default=True)
            stream.send_recording_name(name)
            facts = {**properties, START: shown}
            arrays = {key: typed([value]) for key, value in facts.items()}
            stream.send_property(STUDY, rr.AnyValues(**arrays))
            yield Recorder(stream, t, counter, date)
        write_bytes(target, memory.drain_as_bytes())


@contextlib.contextmanager
def open_stream(name: str, batches: Any) -> Iterator[rr.RecordingStream]:
    """A stream of rerun that raises errors, logs no wall clock and is closed at the end."""
    with contextlib.ExitStack() as stack:
        stack.callback(rr.set_strict_mode, strict_mode())
        rr.set_strict_mode(True)  # or a wrong call is only a warning and its data are missing
        stream = rr.RecordingStream(
            _slug(f"{APPLICATION} {_text('name', name)}"),
            recording_id=_slug(name),
            send_properties=False,
            batcher_config=batches,
        )
        stack.callback(stream.disconnect)
        stream.set_log_time_enabled(False)
        yield stream


def new_file(path: str | os.PathLike[str]) -> Path:
    """The path of a recording to write, which is new or an earlier one of celnav.

    Raises
    ------
    ValueError: if it is not an ``.rrd`` file, or is a file that celnav did not make.
    OSError: naming it, if there can be no such file.
    """
    target = Path(instance("path", path, str | os.PathLike, "a path, such as 'flight.rrd'"))
    if target.suffix != ".rrd":
        raise ValueError(f"path: expected the name of an .rrd file, got {str(target)!r}")
    _check_ours(target)
    return target


def _date(start_date: str) -> np.datetime64:
    try:
        return np.datetime64(_text("start_date", start_date), "ns")
    except ValueError:
        raise ValueError(
            f"start_date: expected a date, such as '2015-10-17T04:00:00', got {start_date!r}"
        ) from None


def _slug(name: str) -> str:
    """An identifier from a title, so that each recording has its own layout."""
    return re.sub(
        r"\W+", "-", unicodedata.normalize("NFKD", name.replace("Φ", "Phi")), flags=re.ASCII
    ).strip("-")


def _check_ours(target: Path) -> None:
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(target))
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "its folder does not exist", str(target))
    if not target.exists():
        return
    try:
        makers = [entry.application_id for entry in rr.chunk.RrdReader(target).recordings()]
    except Exception:  # whatever the reader says of a file that is no recording
        makers = []
    if not makers or not all(maker.startswith(APPLICATION) for maker in makers):
        raise ValueError(
            "path: expected a new file or a recording of celnav, got another file, which is left "
            f"alone: {target}"
        )
