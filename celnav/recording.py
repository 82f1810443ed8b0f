"""Recordings for the Rerun viewer: whole columns on one timeline, the layout inside the file, files that are whole or not there.

Imports rerun; import it late, inside the function that records, so that filters run without it. A study opens a file with
`recording`, gives whole arrays to the `Recorder` (time first, nan where there is nothing) and lays out `celnav.views`. Two
recordings of the same arrays hold the same contents: ids are given and no wall clock is logged. Geometry is single precision in
the viewer; `Recorder.exact` keeps double.
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
import rerun as rr
from numpy.typing import ArrayLike
from rerun.error_utils import strict_mode
from scipy.spatial.transform import Rotation

from celnav import colors
from celnav.checks import numbers
from celnav.files import write_bytes
from celnav.linalg import Array
from celnav.views import TIMELINE, blueprint

APPLICATION = "celnav"


def rgba(color: str, alpha: float = 1.0) -> list[int]:
    """``#RRGGBB`` as four integers; ValueError for anything else."""
    if not re.fullmatch("#[0-9a-fA-F]{6}", color):
        raise ValueError(f"color: expected #RRGGBB, got {color!r}")
    return [*bytes.fromhex(color.lstrip("#")), round(255 * alpha)]


def ellipsoid_axes(covariance: Array, sigmas: float = 3.0) -> tuple[Array, Array]:
    """Half sizes ``(..., 3)`` and rotations ``(..., 4)`` (quaternions x, y, z, w) of the ellipsoids of covariances ``(..., 3, 3)``.

    Raises
    ------
    ValueError: if a covariance is not positive semidefinite beyond round-off.
    """
    eigenvalues, axes = np.linalg.eigh(covariance)
    if (eigenvalues[..., 0] < -1e-9 * np.abs(eigenvalues).max(-1, initial=0.0)).any():
        raise ValueError(f"covariance: expected positive semidefinite matrices, smallest eigenvalue {eigenvalues.min():.3g}")
    # The eigenvectors may be those of a reflection; the direction of an axis is free.
    axes[..., 0] *= np.where(np.linalg.det(axes) < 0.0, -1.0, 1.0)[..., None]
    quaternions = Rotation.from_matrix(axes.reshape(-1, 3, 3)).as_quat().reshape(*axes.shape[:-2], 4)
    return sigmas * np.sqrt(np.maximum(eigenvalues, 0.0)), quaternions


class Recorder:
    """An open recording over ``times (T,)`` s; every method logs the whole run of one entity. Lengths are in the unit of the view.

    Radii and line widths are in points of the screen, whatever the zoom.
    """

    def __init__(self, stream: rr.RecordingStream, times: Array, counter: str = "") -> None:
        self.stream = stream
        self.times = times
        self._index = [rr.TimeColumn(TIMELINE, duration=times)]
        if counter:
            self._index.append(rr.TimeColumn(counter, sequence=np.arange(len(times))))

    def _send(self, entity: str, columns: Any) -> None:
        self.stream.send_columns(entity, self._index, columns)

    def _style(self, entity: str, style: Any) -> None:
        self.stream.log(entity, style, static=True)

    def _array(self, entity: str, values: ArrayLike, shape: tuple[int | None, ...]) -> Array:
        """``values`` as float64 of shape ``(T, *shape)``, None for any length; ValueError names the entity."""
        array = np.asarray(values, dtype=np.float64)
        expected = (len(self.times), *shape)
        if array.ndim != len(expected) or any(want not in (None, got) for want, got in zip(expected, array.shape)):
            sizes = ", ".join("any" if size is None else str(size) for size in expected)
            raise ValueError(f"{entity}: expected shape ({sizes}), got {array.shape}")
        return array

    def text(self, entity: str, markdown: str) -> None:
        """A text panel."""
        self._style(entity, rr.TextDocument(markdown, media_type="text/markdown"))

    def curve(self, entity: str, values: ArrayLike, color: str, name: str, *, width: float = 1.5, shown: bool = True) -> None:
        """A curve ``(T,)`` in a plot, with gaps at nan; hidden until clicked in the legend unless ``shown``."""
        scalars = self._array(entity, values, ())
        self._style(entity, rr.SeriesLines(colors=rgba(color), widths=width, names=name, visible_series=shown))
        # An empty row is a gap too, and two files with a nan never compare equal.
        there = np.isfinite(scalars)
        self._send(entity, rr.Scalars.columns(scalars=scalars[there]).partition(there.astype(int)))

    def log_curve(self, entity: str, values: ArrayLike, color: str, name: str, *, width: float = 1.5) -> None:
        """A curve of the decimal logarithms of values ``(T,)``, since plots have no logarithmic axis; gaps where there is none."""
        array = self._array(entity, values, ())
        logarithm = np.log10(array, out=np.full(array.shape, np.nan), where=array > 0.0)
        self.curve(entity, logarithm, color, name, width=width)

    def bounds(
        self, entity: str, sigma: ArrayLike, name: str, *, center: ArrayLike = 0.0, shown: bool = True, color: str = colors.SIGMA
    ) -> None:
        """Curves ``entity/+3s`` and ``entity/-3s``: three deviations ``(T,)`` about ``center``."""
        deviation, middle = self._array(entity, sigma, ()), np.asarray(center, dtype=np.float64)
        for sign, factor in (("+", 3.0), ("-", -3.0)):
            self.curve(f"{entity}/{sign}3s", middle + factor * deviation, color, f"±3σ {name}", width=1.0, shown=shown)

    def level(self, entity: str, value: float, name: str, color: str = colors.SIGMA) -> None:
        """A horizontal line in a plot."""
        ends = self.times[[0, -1]]
        self._style(entity, rr.SeriesLines(colors=rgba(color), widths=1.0, names=name))
        self.stream.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=ends)], rr.Scalars.columns(scalars=[value, value]))

    def trail(self, entity: str, points: ArrayLike, color: str, *, radius: float = 1.0) -> None:
        """A line through ``points (T, 3)`` that grows with time: a segment per step. The view must list it as ``growing``."""
        p = self._array(entity, points, (3,))
        segments = np.stack([p[:-1], p[1:]], 1)
        there = np.isfinite(segments).all((1, 2))
        self._style(entity, rr.LineStrips3D.from_fields(colors=rgba(color), radii=rr.Radius.ui_points(radius)))
        counts = np.concatenate([[0], there.astype(int)])
        self._send(entity, rr.LineStrips3D.columns(strips=segments[there]).partition(counts))

    def path(self, entity: str, strips: Sequence[Array], color: str, *, radius: float = 0.5) -> None:
        """Lines ``(points, 3)`` that stay for the whole run."""
        self._style(entity, rr.LineStrips3D(strips, colors=rgba(color), radii=rr.Radius.ui_points(radius)))

    def strips(
        self, entity: str, strips: ArrayLike, colors: Sequence[str], *, labels: Sequence[str] = (), radius: float = 1.0
    ) -> None:
        """``k`` lines ``(T, k, points, 3)`` that move; lines that are partly nan are left out."""
        lines = self._array(entity, strips, (len(colors), None, 3))
        there = np.isfinite(lines).all((2, 3))
        self._style(entity, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(radius)))
        palette = np.array([rgba(color) for color in colors], np.uint8)[np.nonzero(there)[1]]
        names = {"labels": np.array(labels)[np.nonzero(there)[1]].tolist()} if labels else {}
        self._send(entity, rr.LineStrips3D.columns(strips=lines[there], colors=palette, **names).partition(there.sum(1)))

    def arrow(self, entity: str, origins: ArrayLike, vectors: ArrayLike, color: str, label: str, *, radius: float = 1.5) -> None:
        """An arrow from ``origins (T, 3)`` along ``vectors (T, 3)``."""
        start, vector = self._array(entity, origins, (3,)), self._array(entity, vectors, (3,))
        there = np.isfinite(start + vector).all(1)
        self._style(entity, rr.Arrows3D.from_fields(colors=rgba(color), radii=rr.Radius.ui_points(radius), labels=label))
        self._send(entity, rr.Arrows3D.columns(origins=start[there], vectors=vector[there]).partition(there.astype(int)))

    def pose(self, entity: str, origins: ArrayLike, quaternions: ArrayLike) -> None:
        """Where everything below ``entity`` is: origins ``(T, 3)`` and attitudes ``(T, 4)`` (see `celnav.attitude`)."""
        start, q = self._array(entity, origins, (3,)), self._array(entity, quaternions, (4,))
        self._send(entity, rr.Transform3D.columns(translation=start, quaternion=q))

    def axes(self, entity: str, length: float, colors: Sequence[str], labels: Sequence[str] = (), *, radius: float = 1.5) -> None:
        """Three arrows along the axes of ``entity``, as long as the run."""
        names = {"labels": list(labels)} if labels else {}
        vectors, palette = length * np.eye(3), [rgba(color) for color in colors]
        self._style(entity, rr.Arrows3D(vectors=vectors, colors=palette, radii=rr.Radius.ui_points(radius), **names))

    def points(
        self, entity: str, points: ArrayLike, color: str, *, alpha: float = 1.0, radius: float = 2.0, label: str = ""
    ) -> None:
        """Points ``(T, 3)`` or, ``k`` at a time, ``(T, k, 3)``; those that are partly nan are left out."""
        p = np.asarray(points, dtype=np.float64)
        p = self._array(entity, p[:, None] if p.ndim == 2 else p, (None, 3))
        there = np.isfinite(p).all(2)
        style = {"colors": rgba(color, alpha), "radii": rr.Radius.ui_points(radius), "point_shading": "flat"}
        self._style(entity, rr.Points3D.from_fields(**style, **({"labels": label} if label else {})))
        self._send(entity, rr.Points3D.columns(positions=p[there]).partition(there.sum(1)))

    def ellipsoids(
        self, entity: str, centers: ArrayLike, covariance: ArrayLike, color: str, *, sigmas: float = 3.0, alpha: float = 0.35
    ) -> None:
        """Ellipsoids of covariances ``(T, 3, 3)`` about ``centers (T, 3)``; none where either is nan.

        Raises
        ------
        ValueError: if a covariance is not positive semidefinite.
        """
        c, P = self._array(entity, centers, (3,)), self._array(entity, covariance, (3, 3))
        there = np.isfinite(c).all(1) & np.isfinite(P).all((1, 2))
        half, quaternions = ellipsoid_axes(P[there], sigmas)
        mode = rr.components.FillMode.TransparentFillMajorWireframe
        style = rr.Ellipsoids3D.from_fields(colors=rgba(color, alpha), fill_mode=mode, line_radii=rr.Radius.ui_points(0.7))
        self._style(entity, style)
        columns = rr.Ellipsoids3D.columns(centers=c[there], half_sizes=half, quaternions=quaternions)
        self._send(entity, columns.partition(there.astype(int)))

    def globe(self, entity: str, radius: float, *, color: str = "#16324F", grid: str = "#3C6E9F") -> None:
        """A sphere about the origin, with circles of latitude and half circles of longitude every 15 degrees."""
        self._style(entity, rr.Ellipsoids3D(radii=[radius], colors=rgba(color), fill_mode="solid"))
        around, up = np.linspace(-np.pi, np.pi, 121), np.linspace(-0.5 * np.pi, 0.5 * np.pi, 61)
        step = np.deg2rad(15.0)
        parallels = [_sphere(latitude, around) for latitude in step * np.arange(-5, 6)]
        meridians = [_sphere(up, longitude) for longitude in step * np.arange(24)]
        # A little above the ground, or the two surfaces fight for the same pixels.
        self.path(f"{entity}/grid", [1.003 * radius * line for line in parallels + meridians], grid, radius=0.4)

    def bars(self, entity: str, values: ArrayLike, color: str) -> None:
        """Bars ``(k,)`` that stay for the whole run."""
        self._style(entity, rr.BarChart(np.asarray(values, dtype=np.float64), color=rgba(color)))

    def event(self, entity: str, seconds: float, message: str) -> None:
        """A line in a log, at a time."""
        columns = rr.TextLog.columns(text=[message])
        self.stream.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=np.array([seconds]))], columns)

    def exact(self, entity: str, **values: ArrayLike) -> None:
        """Arrays ``(T, ...)`` in double precision, flattened row by row, for reading back."""
        columns: list[Any] = []
        for name, value in values.items():
            rows = np.asarray(value, dtype=np.float64)
            if rows.ndim == 0 or len(rows) != len(self.times):
                raise ValueError(f"{entity} {name}: expected {len(self.times)} rows, got shape {rows.shape}")
            rows = rows.reshape(len(rows), -1)
            columns += rr.AnyValues.columns(**{name: rows.ravel()}).partition(np.full(len(rows), rows.shape[1]))
        self._send(entity, columns)


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
    properties: Mapping[str, Any] | None = None,
    counter: str = "",
) -> Iterator[Recorder]:
    """Write a recording when the block ends: to a temporary file beside ``path`` that then takes its place, or not at all.

    Parameters
    ----------
    path: of the file. One that celnav recorded before is replaced, any other is left alone.
    times: ``(T,)`` s, increasing.
    name: what the viewer calls it, and its id.
    layout: a view or container of `celnav.views`.
    properties: facts about the whole recording, such as parameters and seed.
    counter: name of a second timeline that counts the rows; none if empty.

    Raises
    ------
    ValueError: if ``times`` are not finite, increasing seconds, or ``path`` is a file that celnav did not make.
    OSError: naming ``path``, if it cannot be written.
    """
    t = numbers("times", times)
    if t.ndim != 1 or len(t) < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0.0).all():
        raise ValueError(f"times: expected two or more finite, increasing seconds, got shape {t.shape}")
    target = Path(path)
    if target.suffix != ".rrd":
        raise ValueError(f"path: expected the name of an .rrd file, got {str(target)!r}")
    _check_ours(target)
    strict = strict_mode()
    # Otherwise a wrong call is only a warning and its data are missing.
    rr.set_strict_mode(True)
    try:
        stream = rr.RecordingStream(_slug(f"{APPLICATION} {name}"), recording_id=_slug(name), send_properties=False)
        # Not to a file: its writer works in the background, keeps a full disk to itself and then waits for ever.
        memory = stream.memory_recording()
        try:
            stream.set_log_time_enabled(False)
            with stream:
                stream.send_blueprint(blueprint(layout, t), make_active=False, make_default=True)
                stream.send_recording_name(name)
                if properties:
                    stream.send_property("study", rr.AnyValues(**properties))
                yield Recorder(stream, t, counter)
            write_bytes(target, memory.drain_as_bytes())
        finally:
            stream.disconnect()
    finally:
        rr.set_strict_mode(strict)


def _slug(name: str) -> str:
    """An identifier out of a title: the layout belongs to it, so that two recordings do not share one."""
    return re.sub(r"\W+", "-", unicodedata.normalize("NFKD", name.replace("Φ", "Phi")), flags=re.ASCII).strip("-")


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
        raise ValueError(f"path: expected a new file or a recording of celnav, got another file, which is left alone: {target}")
