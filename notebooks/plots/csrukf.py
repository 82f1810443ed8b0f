"""Drawings of notebook 01."""

from __future__ import annotations

import numpy as np

from celnav.papers.csrukf.show import BOUND, CSRUKF, OPEN, SRUKF
from celnav.show import colors
from celnav.show.draw import Line, Panel, curve, level, panels
from celnav.show.notebook import Table

NOISE = Line("colored noise V", colors.COMPARISON)
WHITE = Line("differenced noise V*", colors.ESTIMATE, "--")
FILTERS = {"srukf": SRUKF, "csrukf": CSRUKF, "csrukf+z0": BOUND, "openloop": OPEN}


def idea(phi=0.95, steps=300, seed=4):
    """Scalar colored noise and its differences, and their correlation with the process noise."""
    rng = np.random.default_rng(seed)
    w, zeta = rng.standard_normal((2, steps))  # process noise, increments of V
    V = np.zeros(steps)
    for k in range(1, steps):
        V[k] = phi * V[k - 1] + zeta[k]
    V_star = w + zeta  # z*_k - h(x_k), with H = 1
    J = 0.5  # Psi / R* = Q / (Q + R)
    lags = np.arange(31)
    chance = 1.96 / np.sqrt(steps)
    paths = [curve(np.arange(steps), V, NOISE), curve(np.arange(steps), V_star, WHITE)]
    both = [
        curve(lags, correlation(V, lags), NOISE, marker="o", markersize=3),
        curve(lags, correlation(V_star, lags), WHITE, marker="s", markersize=3),
        level(chance, -chance, label="95 % of white noise"),
    ]
    cloud = {"marker": ".", "markersize": 3, "linestyle": ""}
    line = np.array([-5.0, 5.0])
    removed = curve(line, J * line, color=colors.PAPER, linestyle="-.", label="J V*")
    limits = {"xlim": (-5.0, 5.0), "ylim": (-4.0, 4.0)}
    x = "differenced noise V* (σ)"
    before = [curve(V_star, w, color=colors.TRUTH, **cloud), removed]
    after = [curve(V_star, w - J * V_star, color=colors.TRUTH, **cloud)]
    return panels(
        [
            Panel(
                f"One path, φ = {phi:g}", paths, "step k", "noise (σ)", more={"xlim": (0, steps)}
            ),
            Panel("Differences are white", both, "lag (steps)", "autocorrelation (-)"),
        ],
        [
            Panel("They contain the process noise w", before, x, "w (σ)", more=limits),
            Panel("w - J V* is uncorrelated", after, x, "w - J V* (σ)", more=limits),
        ],
        height=2.0,
    )


def correlation(noise, lags):
    """Sample autocorrelation of a scalar noise."""
    centered = noise - noise.mean()
    n = len(noise)
    return np.array([centered[lag:] @ centered[: n - lag] for lag in lags]) / (centered @ centered)


def errors(t, cases, y):
    """RMSE over time by filter, a panel for each title of ``cases``."""
    rows = [
        Panel(
            title,
            [curve(t, rmse, FILTERS[name]) for name, rmse in filters.items()],
            "time (s)",
            y,
            "y",
            {"xlim": (0.0, t[-1])},
        )
        for title, filters in cases.items()
    ]
    return panels(rows, height=2.6)


def parted(tables):
    """RMSE ``(6,)`` by table, Φ, filter and source: "paper", or "ours" at the end of a run."""
    return {
        (title, row.get("Phi", ""), row["filter"], row["source"].split(",")[0]): np.array(
            [value for name, value in row.items() if name.endswith(("km", "per_s"))]
        )
        for title, rows in tables.items()
        for row in rows
        if "average" not in row["source"]
    }


def ratios(tables):
    """Our RMSE over the printed one, for each entry of Tables 1 to 3."""
    found, drawn = parted(tables), []
    names = ["x", "y", "z", "$v_x$", "$v_y$", "$v_z$"]
    for title, phi, shown in (
        ("table_1", "", "Table 1, Φ = 0"),
        ("table_2", "", "Table 2, Φ = I"),
        ("table_3", "0.8", "Table 3, Φ = 0.8 I"),
        ("table_3", "I", "Table 3, Φ = I"),
    ):
        items = [
            level(1.0, label="equal"),
            level(1 / 3.2, 3.2, label="a factor of 3.2", style="--"),
        ]
        for name, line, marker in (("SRUKF", SRUKF, "o"), ("CSRUKF", CSRUKF, "s")):
            ours, paper = (found[title, phi, name, source] for source in ("ours", "paper"))
            items.append(curve(names, ours / paper, line, marker=marker, linestyle=""))
        drawn.append(Panel(shown, items, "", "ours over printed (-)", "y", {"ylim": (0.004, 10.0)}))
    return panels(drawn[:2], drawn[2:], height=2.0)


def growth(tables):
    """3-D position RMSE over Φ, ours and printed."""
    found, drawn = parted(tables), []
    for name, line in (("SRUKF", SRUKF), ("CSRUKF", CSRUKF)):

        def length(source, *tables, name=name):
            return [np.linalg.norm(found[table, phi, name, source][:3]) for table, phi in tables]

        first, third = [("table_1", ""), ("table_2", "")], [("table_3", "0.8"), ("table_3", "I")]
        ours = length("ours", first[0], third[0], first[1])
        look = {"color": colors.PAPER, "markersize": 6, "linestyle": ""}
        items = [
            curve(range(3), ours, line._replace(label=f"{name}, ours"), marker="o"),
            curve([0, 2], length("paper", *first), **look, marker="x", label="Tables 1 and 2"),
            curve([1, 2], length("paper", *third), **look, marker="^", label="Table 3"),
        ]
        ticks = {"xticks": range(3), "xticklabels": ["0", "0.8 I", "I"]}
        drawn.append(Panel(name, items, "Φ (-)", "3-D position RMSE (km)", "y", ticks))
    return panels(drawn, height=2.4, sharey=True)


def numbers(tables):
    """Tables 1 to 3 with printed RMSE, ours and their ratio: km and m/s."""
    found, rows = parted(tables), []
    for (title, phi, name, source), ours in found.items():
        if source == "ours":
            paper = found[title, phi, name, "paper"]
            head = f"{title[-1]} {phi}".strip(), name
            for label, values in (("printed", paper), ("ours", ours), ("ratio", ours / paper)):
                rows.append([*head, label, *(f"{value:.3g}" for value in values)])
    return Table(["table", "filter", "", "x", "y", "z", "v_x", "v_y", "v_z"], rows)
