"""Colors by meaning, in figures and recordings, and colors of stars and bodies.

The first nine are close to those of Okabe and Ito. They were moved until any two differ by at least
16 in CIELAB to normal, deuteranopic and protanopic eyes (Machado, Oliveira and Fernandes 2009).
"""

TRUTH = "#21A170"
ESTIMATE = "#E69F00"
COMPARISON = "#0272B2"
"""The method of the comparison."""
OPEN_LOOP = "#D683B4"
"""No measurements, or a third method."""
REFERENCE = "#919149"
"""A method beyond the paper, such as the exact filter."""
MEASUREMENT = "#56B4E9"
PAPER = "#D55E00"
"""The paper's value."""
BOUND = "#C0AD4D"
SIGMA = "#787B7F"
FAINT = "#4A5468"
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
    PAPER: "vermilion",
    BOUND: "khaki",
    SIGMA: "gray",
    FAINT: "slate",
    STAR: "pale yellow",
    BODY: "light gray",
    NEGATIVE: "white",
}
"""Names of colors in legends."""
