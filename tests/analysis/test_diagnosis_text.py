"""The text of a diagnosis, from statistics given by hand."""

from __future__ import annotations

import numpy as np
import pytest

from celnav.analysis.diagnose import Coloring, Component, Diagnosis, Factors, Mixture, Model
from celnav.analysis.diagnose import SensorConsistency as Sensor

WHITE = Component(
    name="z0",
    sensor=0,
    samples=100,
    step=2.0,
    rms=1.5,
    predicted=1.25,
    bias=0.1,
    bias_interval=(-0.2, 0.4),
    bias_p=0.5,
    effective=100.0,
    size=1.44,
    size_band=(0.8, 1.2),
    effective_squares=100.0,
    autocorrelation=np.array([0.05, -0.3, 0.1]),
    band=np.array([0.2, 0.2, np.nan]),
    ljung_box=3.25,
    p=0.2,
    coloring=None,
)
FIT = Coloring(0.5, (0.4, 0.6), 2.0, (1.5, 2.5), 0.125, 0.3, Mixture(0.8, 1.0, 0.5, 0.25, 7.5, 0.4))
COLORED = WHITE._replace(p=1e-16, effective=25.0, coloring=FIT)
SOUND = Sensor(("z0",), 1.1, (0.8, 1.2), np.ones(3), np.ones(3), 1.0)
FACTORS = Factors(
    Q=4.0,
    R=0.25,
    Q_interval=(2.0, 8.0),
    R_interval=(0.125, 0.5),
    gain=10.0,
    predicted=np.array([2.5, 0.75]),
    p=np.array([0.25, 0.5]),
    degenerate="",
)
MODEL = Model(
    name="colored",
    Phi=np.diag([0.5, 0.25]),
    R=np.diag([4.0, 9.0]),
    phi_interval=np.array([[0.4, 0.6], [0.1, 0.4]]),
    sigma_interval=np.array([[1.5, 2.5], [2.0, 4.0]]),
    gain=50.0,
    factors=FACTORS,
    not_compared="",
    predicted=np.array([1.5, 0.25]),
    white_predicted=np.array([1.0, 0.125]),
    p=np.array([0.5, 0.75]),
    degenerate="",
)


def page(*components, sensors=(SOUND,), model=None, wraps=(), why="", **changed):
    """Lines of a page by their first word, the table under "", each as one string without line
    breaks.
    """
    found = Diagnosis(np.arange(100.0) * 2.0, 2.0, 1, 0.95, components, sensors, wraps, model, why)
    head, table, body = str(found._replace(**changed)).split("\n\n")
    lines = body.replace("\n         ", " ").splitlines()
    assert all(line[8] == " " for line in lines)
    return head, table.splitlines(), [(line[:8].strip(), line[9:]) for line in lines]


def said(word, *components, **changed):
    return [line for head, line in page(*components, **changed)[2] if head == word]


def test_the_heading():
    one, two = WHITE, WHITE._replace(name="z1", samples=90)
    assert page(one)[0] == "one run, 100 epochs over 198 s, 2 s apart"
    assert page(one, two)[0] == "one run, 100 epochs over 198 s, 2 s apart; 10 components missing"
    several = page(WHITE._replace(samples=250), runs=3, step=None)[0]
    assert several == "3 runs, 100 epochs over 198 s, at irregular times; 50 components missing"


def test_the_table_has_a_dash_for_what_is_unknown():
    bare = WHITE._replace(
        name="north", predicted=None, step=None, p=np.nan, band=np.full(3, np.nan), bias=-12.0
    )
    assert page(WHITE, bare)[1] == [
        "component  samples  rms  predicted σ  mean       (95 %)     lag 1   correlation at lag 1  "
        "p if white",
        "z0             100  1.5         1.25   0.1  -0.2 to 0.4       2 s  0.050 (white: ±0.200)  "
        "       0.2",
        "north          100  1.5            -   -12  -0.2 to 0.4  1 sample               no pairs  "
        "         -",
    ]


@pytest.mark.parametrize(
    ("nis", "component", "expected"),
    [
        (0.8, WHITE, "as large as predicted; NIS per degree of freedom is 0.8"),
        (1.2, WHITE, "as large as predicted; NIS per degree of freedom is 1.2"),
        (
            0.64,
            WHITE,
            "conservative, 0.8 times as large as predicted; NIS per degree of freedom is 0.64",
        ),
        (0.64, COLORED, "0.8 times as large as predicted; NIS per degree of freedom is 0.64"),
        (
            2.25,
            WHITE,
            "overconfident, 1.5 times as large as predicted; NIS per degree of freedom is 2.25",
        ),
        (
            2.25,
            COLORED,
            "overconfident, 1.5 times as large as predicted; NIS per degree of freedom is 2.25",
        ),
    ],
)
def test_what_is_said_of_the_size(nis, component, expected):
    """A band includes its ends; small innovations are called conservative only if they are white."""
    line = said("size", component, sensors=(SOUND._replace(nis=nis),))
    assert line == [f"z0: {expected}, expected 0.8 to 1.2 (95 %, correlation counted)"]


def test_the_size_of_each_component_of_a_sensor_of_several():
    """Only for components of this sensor, and only for components that have a size."""
    pair = WHITE._replace(name="a"), WHITE._replace(name="b", size=0.25)
    other = WHITE._replace(name="c", sensor=1, p=1e-16, effective=25.0, coloring=FIT)
    lost = WHITE._replace(name="d", size=None)
    sensors = (
        SOUND._replace(names=("a", "b", "d"), nis=0.5),
        SOUND._replace(names=("c",), nis=np.nan),
    )
    assert said("size", *pair, other, lost, sensors=sensors) == [
        "a, b, d: conservative, 0.707 times as large as predicted (a 1.2, b 0.5); "
        "NIS per degree of freedom is 0.5, expected 0.8 to 1.2 (95 %, correlation counted)",
        "c: no predicted σ is given, so nothing is said of the size",
    ]


def test_what_is_said_of_bias_and_whiteness():
    """Four components share the significance level of 5 %, and the less white component comes
    first.
    """
    biased = WHITE._replace(name="b", bias=-0.75, bias_p=0.0124, effective=40.0)
    nearly = WHITE._replace(name="n", p=0.0124, effective=90.0, bias_p=0.0126)
    unknown = WHITE._replace(name="u", p=np.nan, band=np.full(3, np.nan), step=None)
    parts = unknown, COLORED._replace(name="c"), nearly, biased
    assert said("bias", *parts) == [
        "b: -0.75 (-0.2 to 0.4), 50% of its rms; its 100 samples count as 40 independent ones",
        "u, c, n: none detected",
    ]
    assert said("bias", biased._replace(bias=0.75, bias_p=0.0)) == [
        "b: 0.75 (-0.2 to 0.4), 50% of its rms; its 100 samples count as 40 independent ones"
    ]
    test = "Ljung-Box 3.25 of 2 lags of 2 s, p"
    assert said("white", *parts) == [
        f"b: yes ({test} 0.2; 1 beyond the band)",
        f"n: nearly: detectably not, to little effect ({test} 0.012; 1 beyond the band); "
        "σ of its mean is 1.05 times that of white noise",
        f"c: no ({test} < 1e-15; 1 beyond the band); σ of its mean is 2 times that of white noise",
        "u: cannot tell: too few pairs of its samples lie within 3 lags of 1 sample; "
        "bias and size assume independent samples",
    ]


NOISE = "z0: Phi from sample to sample = 0.500 (0.400 to 0.600, 95 %)"
AR1 = "celnav.colored(motion, sensor, Phi=[[0.500]]) with R=[[4]]"
MEAN = "for the mean of these samples it predicts σ = 0.125"


def test_what_is_said_of_noise_that_is_of_first_order():
    """A correlation time only for a coefficient within (0, 1), and an interval only if it differs
    from the epochs' interval.
    """
    time, size = ", a correlation time of 2.89 s", ", σ = 2 (1.5 to 2.5)"
    fine = "z0: first-order noise is accepted: its innovations are white (p 0.3)"
    assert said("noise", COLORED) == [NOISE + time + size, fine]
    assert said("model", COLORED) == [f"z0: suggested: {AR1}; {MEAN}, white noise 0.2"]
    slow = COLORED._replace(step=8.0)
    assert said("noise", slow)[0] == NOISE + ", a correlation time of 11.5 s" + size
    assert said("model", slow) == [
        f"z0: suggested: {AR1}, an epoch each 8 s; {MEAN}, white noise 0.2"
    ]
    assert said("noise", COLORED._replace(step=None)) == [NOISE + size, fine]
    assert said("model", COLORED._replace(step=None)) == said("model", COLORED)
    for phi in (-0.5, 0.0, 1.0):
        swinging = COLORED._replace(coloring=FIT._replace(phi=phi))
        assert said("noise", swinging)[0] == NOISE.replace("0.500", f"{phi:.3f}") + size


def test_innovations_are_not_the_noise_itself():
    """They have a size, but a filter for them cannot be suggested."""
    innovations = COLORED._replace(predicted=None)
    time = ", a correlation time of 2.89 s"
    assert said("noise", innovations)[0] == NOISE.replace("Phi", "Phi of its innovations") + time
    assert said("model", innovations) == []
    assert said("model", innovations, why="no data") == ["no data"]
    assert said("model", innovations._replace(size=None)) == said("model", COLORED)


@pytest.mark.parametrize("p", [0.04, 0.06])
def test_white_noise_beside_it_is_tried_where_first_order_noise_is_rejected(p):
    """And it is suggested if it is accepted at the level of 5 % for one component."""
    mixed = COLORED._replace(coloring=FIT._replace(p=0.04, mixture=FIT.mixture._replace(p=p)))
    verdict = "accepted: its innovations are" if p > 0.05 else "rejected: its innovations are not"
    assert said("noise", mixed)[1:] == [
        "z0: first-order noise is rejected: its innovations are not white (p 0.04)",
        f"z0: with white noise beside it, it is {verdict} white (p {p}); "
        "the log-likelihood grows by 7.5",
    ]
    state = (
        "z0: suggested: a state V' = 0.800 V + zeta{}, zeta of variance 0.36 and V of 1, "
        "measured as h(x) + V with R=[[0.25]]; for the mean of these samples it predicts "
        "σ = 0.25, the first-order noise alone 0.125, white noise 0.2"
    )
    none = f"z0: none suggested; {AR1}{{}}: {MEAN}, white noise 0.2, the autocorrelation of the samples 0.4"
    expected = state if p > 0.05 else none
    assert said("model", mixed) == [expected.format("")]
    assert said("model", mixed._replace(step=3.0)) == [expected.format(", an epoch each 3 s")]
    alone = COLORED._replace(coloring=FIT._replace(p=0.04, mixture=None))
    assert said("model", alone) == [none.format("")]
    assert len(said("noise", alone)) == 2


def test_a_wrap_hides_the_noise():
    assert said("noise", COLORED, wraps=("z0: turns",)) == []
    assert said("wrap", COLORED, wraps=("z0: turns",)) == ["z0: turns"]


FITTED = (
    "celnav.colored(motion, sensor, Phi=np.diag([0.500, 0.250])) with R=np.diag([4, 9]); at the "
    "end it predicts σ = 1.5, 0.25, the given filter 1, 0.125"
)
COLOR = "the noise is colored"
WRONG = "these data do not distinguish color from wrong dynamics"


def of_track(**changed):
    """The sentences about a model of a track."""
    assert said("noise", COLORED, WHITE, model=MODEL) == []
    return said("model", COLORED, WHITE, model=MODEL._replace(**changed))


def colored(word, gain, verdict, innovations):
    return [
        f"{word}: {FITTED}",
        "Phi lies in 0.4 to 0.6, 0.1 to 0.4, σ of its noise in 1.5 to 2.5, 2 to 4 (95 %)",
        f"the log-likelihood grows by 50 with it, by {gain} with other Q and R alone: {verdict}",
        f"its innovations are {innovations}",
    ]


def scaled(word, gain, innovations="white (p 0.25, 0.5)", ends=None):
    return [
        f"{word}: the given filter with Q times 4 and R times 0.25; at the end it predicts "
        "σ = 2.5, 0.75, the given filter 1, 0.125",
        ends or "the factor of Q lies in 2 to 8, that of R in 0.125 to 0.5 (95 %)",
        f"the log-likelihood grows by {gain} with them; its innovations are {innovations}",
    ]


@pytest.mark.parametrize(
    ("p", "word", "innovations"),
    [
        (0.75, "suggested", "white (p 0.5, 0.75)"),
        (0.02, "fitted, not suggested", "still not white (p 0.5, 0.02)"),
        (0.03, "suggested", "white (p 0.5, 0.03)"),
    ],
)
def test_colored_noise_that_is_more_probable_stands_alone(p, word, innovations):
    lines = of_track(p=np.array([0.5, p]))
    assert lines == colored(word, 10, COLOR, innovations)


def test_other_white_noise_that_is_as_probable_stands_beside_it():
    rival = FACTORS._replace(gain=49.9)
    assert of_track(factors=rival) == [
        *scaled("fitted, not suggested", 49.9),
        *colored("fitted, not suggested", 49.9, WRONG, "white (p 0.5, 0.75)"),
    ]


@pytest.mark.parametrize("p", [0.02, 0.03])
def test_other_white_noise_that_is_more_probable_is_suggested_if_it_leaves_nothing(p):
    rival = FACTORS._replace(gain=60.0, p=np.array([p, 0.5]))
    sound = p > 0.025  # 5 % shared by two components
    word = "suggested" if sound else "fitted, not suggested"
    assert of_track(factors=rival) == [
        *scaled(word, 60, f"{'' if sound else 'still not '}white (p {p}, 0.5)"),
        "celnav.colored is not suggested: the log-likelihood grows by 50 with it, by 60 with other "
        "Q and R alone",
    ]
    edge = rival._replace(p=FACTORS.p, degenerate="R ran to the end of its range")
    uncertain = "the likelihood has no clear maximum there (R ran to the end of its range)"
    lines = scaled("fitted, not suggested", 60, ends=uncertain)
    assert of_track(factors=edge)[:3] == lines


@pytest.mark.parametrize("gain", [10.0, 60.0])
def test_a_degenerate_fit_of_colored_noise_is_left_out(gain):
    """It is left out whether or not its likelihood is larger; the factors are then not suggested
    either.
    """
    lines = of_track(factors=FACTORS._replace(gain=gain), degenerate="Phi z0 ran to the end")
    assert lines == [
        *scaled("suggested" if gain > 50.0 else "fitted, not suggested", f"{gain:.0f}"),
        "celnav.colored is left out: the likelihood has no clear maximum in Phi and R "
        "(Phi z0 ran to the end); the log-likelihood grows by 50 with it",
    ]
    alone = of_track(factors=None, not_compared="Q is unknown", degenerate="Phi z0 ran to the end")
    other = "other Q and R alone were not compared (Q is unknown)"
    assert alone == [f"{lines[-1]}; {other}"]


def test_a_fitted_filter_of_correlated_noise_without_a_rival():
    R = np.array([[4.0, 0.5], [0.5, 9.0]])
    model = MODEL._replace(R=R, factors=None, not_compared="Q is unknown", name="augmented")
    first, _, compared, _ = said("model", WHITE, WHITE, model=model)
    assert first == (
        "fitted, not suggested: "
        + FITTED.replace("colored", "augmented").replace(
            "np.diag([4, 9])", "np.array([[4.0, 0.5], [0.5, 9.0]])"
        )
    )
    assert compared == (
        "the log-likelihood grows by 50 with it; "
        "other Q and R alone were not compared (Q is unknown)"
    )


@pytest.mark.parametrize(
    ("phi", "printed"),
    [(0.8, "0.800"), (-0.41, "-0.410"), (0.9, "0.900"), (0.91777, "0.9178"), (0.998124, "0.99812")],
)
def test_a_coefficient_near_1_has_the_digits_that_its_noise_needs(phi, printed):
    near = COLORED._replace(coloring=FIT._replace(phi=phi))
    assert said("noise", near)[0].startswith(f"z0: Phi from sample to sample = {printed} (")
    assert f"Phi=[[{printed}]]" in said("model", near)[0]
