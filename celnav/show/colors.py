"""Okabe-Ito colors by meaning, in figures and recordings; also those of stars and bodies."""

TRUTH = "#009E73"
ESTIMATE = "#E69F00"
COMPARISON = "#0072B2"
"""The method of the comparison."""
OPEN_LOOP = "#CC79A7"
"""No measurements, or a third method."""
REFERENCE = "#999933"
"""A method beyond the paper, such as the exact filter."""
MEASUREMENT = "#56B4E9"
PAPER = "#D55E00"
"""The paper's value."""
BOUND = "#C9B400"  # a darker yellow than Okabe and Ito's, which is lost on white paper
SIGMA = "#888888"
FAINT = "#5A6478"
STAR = "#FFF3C4"
"""Directions to stars, pulsars and the Sun."""
BODY = "#BBBBBB"
"""Bodies of the sky: Earth, Moon."""
NEGATIVE = "#FFFFFF"
"""Sigma points with a negative weight."""
STATES = {
    "used": TRUTH,
    "used in part": BOUND,
    "rejected": PAPER,
    "missing": SIGMA,
    "failed": "#C1121F",
}
"""What became of a measurement."""

NAMES = {
    TRUTH: "green",
    ESTIMATE: "orange",
    COMPARISON: "blue",
    OPEN_LOOP: "purple",
    REFERENCE: "olive",
    MEASUREMENT: "sky blue",
    PAPER: "red",
    BOUND: "yellow",
    SIGMA: "gray",
    STAR: "pale yellow",
    BODY: "light gray",
    NEGATIVE: "white",
}
"""Names of colors in legends."""
