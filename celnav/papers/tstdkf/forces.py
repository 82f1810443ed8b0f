"""What the dynamics leave out: the accelerations of the satellite by other bodies, and their spectrum (Figs 7 and 8)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.models.ephemeris import BODIES, GM, de421
from celnav.models.orbit import third_body
from celnav.papers.tstdkf.config import DAY_S, Config
from celnav.papers.tstdkf.scenario import nominal_orbit

PULLING = tuple(body for body in BODIES if body != "earth")


def accelerations(config: Config) -> dict[str, Array]:
    """Acceleration ``(T, 3)`` km/s^2 of the satellite on its nominal orbit by each body, relative to the Earth's."""
    dates = config.start.after(config.step_s * np.arange(config.steps + 1))
    position, earth = nominal_orbit(config)[:, :3], de421().state("earth", dates).position
    return {body: third_body(position, de421().state(body, dates).position - earth, GM[body]) for body in PULLING}


class Spectrum(NamedTuple):
    """Frequencies ``(K,)`` (cycles a day) and power ``(K, 3)`` of a sequence, and its correlation ``(3,)`` with the next sample."""

    cycles: Array
    power: Array
    correlation: Array

    def strongest(self, axis: int, above: float = 0.0) -> float:
        """Frequency of the largest line above another one, cycles a day."""
        return float(self.cycles[int(np.argmax(np.where(self.cycles > above, self.power[:, axis], 0.0)))])

    @property
    def flatness(self) -> Array:
        """Geometric to arithmetic mean of the power ``(3,)``: 1 for white noise."""
        return np.asarray(np.exp(np.log(self.power).mean(0)) / self.power.mean(0))

    def concentrated(self, part: float = 0.01) -> Array:
        """Share ``(3,)`` of the power that lies in the strongest part of the bins."""
        ordered = np.sort(self.power, 0)[::-1]
        return np.asarray(ordered[: max(1, round(part * len(ordered)))].sum(0) / ordered.sum(0))


def spectrum(values: Array, step_s: float) -> Spectrum:
    """Power by frequency (mean removed, Hann window)."""
    less = values - values.mean(0)
    window = np.hanning(len(less))[:, None]
    power = np.square(np.abs(np.fft.rfft(window * less, axis=0)))
    correlation = (less[1:] * less[:-1]).sum(0) / np.square(less).sum(0)
    return Spectrum(np.fft.rfftfreq(len(less), step_s) * DAY_S, power, correlation)
