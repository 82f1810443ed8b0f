"""Numbers in the sentences of the lessons are those of the ledgers, of the models, or of the cells'
outputs beside them.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache, partial
from html import unescape

import nbformat
import numpy as np
import pytest
from test_notebooks import LESSONS

from celnav.gaussian.rules import gauss_hermite
from celnav.gaussian.sparse_grid import point_count
from celnav.models import orbit
from celnav.models.orbit import EARTH
from celnav.papers import aukf, csrukf, tstdkf
from celnav.papers.ssukf.study import propagations
from celnav.papers.tstdkf import scenario as pulsars
from celnav.papers.tstdkf.study import PRINTED, ephemerides
from celnav.study.montecarlo import generator
from celnav.study.numbers import SAME_ORDER


@cache
def cells(paper):
    """The cells of a paper's notebook."""
    (path,) = [path for path in LESSONS if path.stem[3:] == paper]
    return nbformat.read(path, as_version=4).cells


@cache
def quantities(paper):
    """Numbers of the ledgers of an executed notebook, by row and quantity."""
    outputs = [output for cell in cells(paper) for output in cell.get("outputs", ())]
    html = unescape("".join(output.get("data", {}).get("text/html", "") for output in outputs))
    number = (
        r'<td role="cell"(?: data-name="Quantity")?>([^<]+)</td>'
        r'(?:<td role="cell"(?: data-name="Printed")?>[^<]*</td>)?'
        r'<td role="cell" data-name="Ours">([-\d.]+)'
    )
    return {
        (row, quantity): float(ours)
        for part in html.split('<tr id="')[1:]
        for row in [part.partition('"')[0]]
        for quantity, ours in re.findall(number, part)
    }


def of(paper, row, quantity):
    """A number of a ledger."""
    return quantities(paper)[row, quantity]


def printed(paper):
    """What the cells of a notebook print."""
    return "".join(
        output.get("text", "") for cell in cells(paper) for output in cell.get("outputs", ())
    )


def near(value, expected, digits=2):
    """Whether a value is the expected number in so many digits."""
    return f"{value:.{digits}g}" == f"{expected:.{digits}g}"


# -- notebook 01 -----------------------------------------------------------------------------------
def gravity_mm():
    """Displacements (mm) in a second by the change of gravity over a kilometer."""
    x = csrukf.PRESETS["P"].nominal()[0]
    one_km = np.eye(3, 6)
    moved = orbit.step(x + one_km, 1.0) - orbit.step(x, 1.0) - one_km
    return 1e6 * np.linalg.norm(moved[:, :3], axis=1)


P, D = csrukf.PRESETS["P"], csrukf.PRESETS["D"]
LARGEST = "largest factor between a printed value and ours"
CSRUKF = {
    "Ten minutes of positions with 0.2 km of noise hardly improve a velocity that is known to "
    "0.035 m/s": lambda _: (
        (P.steps * P.step_s, P.sigma_km, P.prior_velocity_m_per_s) == (600.0, 0.2, 0.035)
    ),
    "Table 2 within a factor of 3.2": lambda of: (
        of("table-2-levels", LARGEST) < SAME_ORDER and near(SAME_ORDER, 3.2)
    ),
    "by up to two orders of magnitude": lambda of: (
        round(np.log10(of("table-3-levels", LARGEST))) == 2
    ),
    "At $\\Phi = I$ its error is twice the bound after 3000 s": lambda of: near(
        of("long-arc", "position RMSE over the bound, Φ = I"), 2.0, 1
    ),
    "The paper's noise of 0.2 km is a ratio of 50": lambda _: (
        D.prior_position_km / D.sigma_km == 50.0
    ),
    "moves the satellite by about a millimeter in a second": lambda _: (
        gravity_mm().min() > 0.6 and gravity_mm().max() < 1.2
    ),
}


# -- notebook 02 -----------------------------------------------------------------------------------
def third(of):
    """Shares of the operations that are saved in the four cases, within the accepted range."""
    shares = [
        of(
            "third-less-time",
            f"share of operations saved at {per}:1 predictions to updates, {part}",
        )
        for per in (1, 25)
        for part in ("whole roots", "block roots")
    ]
    return sum(0.283 <= share <= 0.383 for share in shares) == 1


def order_two_from(rate_deg_per_s):
    """Whether one Euler step at 100 Hz exceeds 1/1000 of the star sensor's noise from a rate on."""
    errors = [
        propagations(0.01 * rate)["accuracy"][1, 0]
        for rate in (0.9 * rate_deg_per_s - 0.01, rate_deg_per_s)
    ]
    return errors[0] < 9.7e-10 < errors[1]


SSUKF = {
    "Over ten minutes the filters differ by 10⁻⁸ arcsec": lambda _: (
        "SSUKF and AUKF: at most 1e-08 arcsec apart" in printed("ssukf")
    ),
    "A linearized filter (MEKF) differs by 10⁻⁴ arcsec": lambda _: (
        "MEKF and AUKF: at most 1e-04 arcsec apart" in printed("ssukf")
    ),
    "It saves a third of the operations in one case of four": third,
    "A\nquaternion takes 52 operations and is exact; it takes 71 with conversions": lambda _: (
        propagations(1.0)["steps"][:2, 0].tolist() == [52, 71]
    ),
    "which is 10⁻⁹ rad per step": lambda of: (
        of(
            "quaternions-cheaper-to-propagate",
            "operations alone, over the cheapest method within 9.7e-10 rad a step",
        )
        > 0.0
    ),
    "From 0.4°/s on, order 2 is": lambda _: order_two_from(0.4),
    "$\\sqrt{15} \\cdot 60°$, wraps around": lambda _: np.sqrt(15.0) * 60.0 > 180.0,
    "an initial error of 179° is as small as one of 10°": lambda of: near(
        of(
            "remark-large-error",
            "attitude RMSE after a star sample, from 179° over from 10°, SSUKF",
        ),
        1.0,
    ),
    "A prior of 20 arcsec for an error of 10° is fatal": lambda of: (
        of(
            "overconfident-prior",
            "attitude RMSE from a prior of 20 arcsec over that from one of 10°",
        )
        > 20.0
    ),
}


# -- notebook 03 -----------------------------------------------------------------------------------
def orbital_rate():
    """Revolutions in a day."""
    a = pulsars.TABLE_5.elements[0]
    return pulsars.DAY_S / (2.0 * np.pi * np.sqrt(a**3 / EARTH.mu))


def near_the_sun():
    """Smallest angles (deg) between the Sun and the pulsars in a year."""
    year = replace(pulsars.TABLE_5, days=365.0, step_s=0.25 * pulsars.DAY_S)
    earth, sun, _ = pulsars.sky(year)
    to_sun = (sun - earth) / np.linalg.norm(sun - earth, axis=1, keepdims=True)
    return np.degrees(np.arccos((to_sun @ year.timing.directions.T).max(0)))


def step_response():
    """Days and RMSE before the step (km) of three filters, and half of the step (km)."""
    text = printed("tstdkf")
    found = re.findall(r"follows in +(\S+) days, RMSE before the step (\S+) km", text)
    half = float(re.search(r"half of the step: (\S+) km", text)[1])
    return [tuple(map(float, pair)) for pair in found], half


def random_walk():
    """Whether the nine states follow in four days and are less noisy than the others."""
    (*forms, (days, noise)), _ = step_response()
    return near(days, 4.0, 1) and all(noise < other for _, other in forms)


def beyond_ten():
    """Whether the noise of form B exceeds half of the step at ρ = 30, but not at ρ = 10."""
    ((_, ten), (_, thirty), _), half = step_response()
    return ten < half < thirty


def states_of_aug():
    """Number of states of the exact filter."""
    config = replace(pulsars.TABLE_5, days=0.01)
    sim = pulsars.linearized([config], [generator(0, 0, 0)])
    filter = tstdkf.filters(config, pulsars.LINEAR)["aug"]
    return filter.start(sim.prior).belief.mean.shape[-1]


ONE = pulsars.SETTINGS[1]
TSTDKF = {
    "In setting 1 the TSTDKF is a third more accurate than the TKF": lambda of: (
        30.0 < of("setting-1-position", "position RMSE below that of TKF (%)") < 37.0
    ),
    "and **AUG** has orbit, both noises and bias in 18 states": lambda _: states_of_aug() == 18,
    "= 1.33\\;\\Xi": lambda _: near(1.0 / (1.0 - ONE.F**2), 1.33, 3),
    "a variance of the motion's noise that is 32 times too small": lambda _: near(
        (1.0 + ONE.kappa**2) / (1.0 - ONE.L**2), 32.0
    ),
    "56.49 % below the EKF's and 35.18 % below the TKF's": lambda _: (
        list(map(float, PRINTED["position"])) == [56.49, 35.18]
    ),
    "error 27.66 % and 17.07 % below": lambda _: (
        list(map(float, PRINTED["velocity"])) == [27.66, 17.07]
    ),
    "After one revolution (0.07 days)": lambda _: near(1.0 / orbital_rate(), 0.07, 1),
    "the ephemeris error steps from 0 to 0.3 km on each axis": lambda _: (
        pulsars.TABLE_5.bias_prior_km == 0.3
    ),
    "beyond ρ = 10, the noise alone exceeds half of the step": lambda _: beyond_ten(),
    "A nine-state filter with a random-walk bias of 0.1 m per timing follows in four days": (
        lambda _: random_walk()
    ),
    "It is less than 2 km": lambda of: (
        of("de405-to-de421", "largest norm of DE405 - DE421 (km)") < 2
    ),
    "DE423 - DE421 indicates the error to expect: some hundred meters": lambda _: (
        0.2 < np.linalg.norm(ephemerides()[1]["de423/earth"], axis=1).mean() < 0.9
    ),
    "Its barycenter is displaced by 117 km": lambda of: near(
        of("de421-planets", "Sun from the barycenter, largest difference of DE421 and DE440 (km)"),
        117.0,
        3,
    ),
    "the orbital rate (14.4 cycles/day)": lambda _: near(orbital_rate(), 14.4, 3),
    "but only 3·10⁻⁴ of the noise": lambda of: near(
        of("measurement-noise-colored", "largest RMS of the omitted terms over σ of a timing"),
        3e-4,
        1,
    ),
    "two pulsars are within two degrees of it once a year": lambda _: (
        (near_the_sun() < 2.0).sum() == 2
    ),
    "Setting 1 has κ = 4.8 and setting 2 has κ = 0": lambda _: (
        (ONE.kappa, pulsars.SETTINGS[2].kappa) == (4.8, 0.0)
    ),
}


# -- notebook 04 -----------------------------------------------------------------------------------
AASGHQF = {
    "the grid is isotropic and has 417 points": lambda of: (
        point_count(13, 3) == of("table-4-points", "sigma points, SGHQF") == 417
    ),
    "more accurate than the 27 of the UKF": lambda of: (
        of("table-4-points", "sigma points, UKF") == 27
    ),
    "It has 75 points, where the paper says 99": lambda of: (
        of("erratum-1-points", "sigma points by the paper's rule") == 75
        and of("erratum-1-points", "sigma points if merged at the origin only") == 99
    ),
    "57 points by nonlinearity are as good as 417": lambda of: (
        of("nonlinear-equal", "sigma points by nonlinearity") == 57
        and of("nonlinear-equal", "misalignment RMSE, 57 over 417 points, T3") == 1.0
    ),
    "With a threshold of 5 the printed degrees give the printed weights": lambda of: (
        of("threshold-weights", "number of weights that differ with printed degrees, of 13") == 0
    ),
    "Marked: within a factor of 1.32 of the paper": lambda of: (
        of("table-3-levels", "printed values that differ by more than a factor of 1.32, of 21") > 0
    ),
    "In our runs AASGHQF has nearly twice the error of SGHQF in $\\varphi_y$": lambda of: (
        1.7 < of("alike-sghqf", "RMSE of φy, T3, AASGHQF over SGHQF") < 2.0
    ),
    "In a turn with more than 1 g, heading and tilt exchange their roles": lambda of: near(
        of(
            "gentle-flight",
            "horizontal over vertical specific force where the degree of φz exceeds 5",
        ),
        1.0,
    ),
    "From $n = 6$ on, the saved fraction increases when $n$ doubles": lambda of: (
        of("saving-grows", "smallest increase of the saved fraction of points (%)") > 0.0
    ),
    "A tensor rule of 729 points is not better than 109": lambda _: (
        (gauss_hermite(6, 3).num_sigmas(), point_count(6, 3)) == (729, 109)
    ),
    "The center of this UKF has the weight κ / (n + κ) = (3 - n) / 3": lambda _: (
        next(n for n in range(1, 14) if (3 - n) / 3 < 0) == 4
    ),
}


# -- notebook 05 -----------------------------------------------------------------------------------
BURST, M = aukf.PRESETS["burst"], 10
LINEAR_M = {meters: meters**2 / 2.0 / 20e6 for meters in (1.0, 1e4, 1e5)}
AUKF = {
    "A receiver circles with 4 g": lambda _: near(BURST.acceleration_g, 4.0),
    "From 60 s to 70 s": lambda _: tuple(BURST.burst_s) == (60.0, 70.0),
    "additional noise of 50 m": lambda _: BURST.burst_sigma == 50.0,
    "for an interval $T = 0.1$ s": lambda _: BURST.interval_s == 0.1,
    "With the right noise the AUKF is a few percent better than both": lambda of: all(
        0.95 < of("clearly-better-quiet", f"{axis}, RMSE over the UKF's") < 1.0 for axis in "XYZ"
    ),
    "In the burst the AUKF has a tenth of the UKF's error": lambda of: near(
        of("burst-suppressed", "ranges, 10 Hz: RMSE in the burst over the UKF's"), 0.09, 1
    ),
    "within $M = 10$ epochs, one second": lambda _: (
        BURST.window == M and near(M * BURST.interval_s, 1.0)
    ),
    "The window withstands\nseven of twelve": lambda of: (
        of(
            "outliers-limits",
            "an error of 50 m: number of bad ranges up to which the RMSE does not double",
        )
        == 7
    ),
    "At 10 Hz a window of 5 epochs has the smallest error in the burst": lambda of: (
        of("window-range", "10 Hz: best window in the burst (epochs)") == 5
    ),
    "At 1 Hz, where the burst has ten epochs,\nno window helps": lambda of: (
        of(
            "window-range",
            "1 Hz: windows with a smaller RMSE than the UKF's before and in the burst",
        )
        == 0
    ),
    "wrong by up to a\nfactor of 10 cost them less than twice the error": lambda of: (
        of("ukf-sensitive", "RMSE over that with the right values, σ of the ranges times 0.3") < 2.0
    ),
    "Up to an initial error of 10 km there is hardly a difference": lambda of: (
        0.9
        < of(
            "ukf-better-than-ekf",
            "median position error, EKF over UKF, from 10 km, after 5 epochs",
        )
        < 1.1
    ),
    "From 100 km on, the UKF is many times more accurate": lambda of: (
        of(
            "ukf-better-than-ekf",
            "median position error, EKF over UKF, from 100 km, after 5 epochs",
        )
        > 5.0
    ),
    "A UKF step takes half as many operations again as an EKF step": lambda of: near(
        of("no-extra-computation", "operations of a step over the EKF's"), 1.5
    ),
    "the window would need more than 3000 epochs": lambda _: 1.0 / (np.pi * 0.01**2) > 3000.0,
    "this is 25 nm for 1 m, 2.5 m for 10 km, about the noise, and 250 m for 100 km": lambda _: (
        list(LINEAR_M.values()) == pytest.approx([25e-9, 2.5, 250.0])
    ),
    "the factors of\nall ranges jump to some hundreds": lambda of: (
        200.0 < of("figure-7-factor", "mean factor of R of the ranges") < 400.0
    ),
}
SENTENCES = {
    "csrukf": CSRUKF,
    "ssukf": SSUKF,
    "tstdkf": TSTDKF,
    "aasghqf": AASGHQF,
    "aukf": AUKF,
}


@pytest.mark.parametrize(
    ("paper", "sentence"),
    [(paper, sentence) for paper, sentences in SENTENCES.items() for sentence in sentences],
)
def test_a_number_in_a_sentence_is_that_of_the_results(paper, sentence):
    prose = "".join(cell.source for cell in cells(paper) if cell.cell_type == "markdown")
    assert re.sub(r"\s+", " ", sentence) in re.sub(r"\s+", " ", prose)
    assert SENTENCES[paper][sentence](partial(of, paper))
