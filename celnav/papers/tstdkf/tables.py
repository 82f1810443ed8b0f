"""Tables 1 to 5 of the paper, and two beyond it. The bodies of the paper's are lost; 1 to 4 are what was inferred or chosen."""

from __future__ import annotations

from celnav.analysis.metrics import rms
from celnav.gaussian.linalg import Array
from celnav.models.pulsar import pulsars
from celnav.papers.tstdkf import published
from celnav.papers.tstdkf.config import SETTINGS
from celnav.papers.tstdkf.study import COMPARED, FAIR, Result
from celnav.papers.tstdkf.sweeps import COUPLINGS, PARAMETERS

Row = dict[str, str | float]


def table_1(result: Result) -> list[Row]:
    """Table 1: elements of the orbit (chosen)."""
    names = ("a (km)", "e (-)", "i (deg)", "Ω (deg)", "ω (deg)", "ν (deg)")
    return [dict(zip(names, result.config.elements, strict=True))]


def table_2(result: Result) -> list[Row]:
    """Table 2: parameters of the pulsars (inferred)."""
    return [
        {
            "pulsar": p.name,
            "right ascension (deg)": p.right_ascension_deg,
            "declination (deg)": p.declination_deg,
            "distance (kpc)": p.distance_kpc,
            "period (s)": p.period_s,
            "width (s)": p.width_s,
            "flux (photons/cm²/s)": p.flux,
            "pulsed fraction (-)": p.pulsed_fraction,
            "deviation of a timing (km)": deviation,
        }
        for p, deviation in zip(pulsars(result.config.pulsars), result.config.sigma_km.tolist(), strict=True)
    ]


def table_3(result: Result) -> list[Row]:
    """Table 3: the other parameters."""
    c = result.config
    rows = (
        ("time between timings (s)", c.step_s, "paper"),
        ("initial error of position, each axis (km)", c.error_km[0], "paper"),
        ("initial error of velocity, each axis (m/s)", c.error_m_per_s[0], "paper"),
        ("rho", ", ".join(f"{r:g}" for r in c.rho), "paper"),
        ("tau (timings)", c.tau, "paper"),
        ("noise of the position's rate (km/s)", c.rate_noise_km_per_s, "paper; unit inferred"),
        ("noise of the velocity's rate (km/s²)", c.acceleration_noise_km_per_s2, "paper; unit inferred"),
        ("amplitudes of the ephemeris error (km)", ", ".join(f"{a:g}" for a in c.amplitude_km), "chosen, tuned with κ"),
        ("deviation of the bias at the start (km)", c.bias_prior_km, "chosen"),
        ("step of the exact filter's bias (km)", c.walk_km, "chosen"),
    )
    return [{"parameter": name, "value": value, "source": source} for name, value, source in rows]


def table_4(_result: Result) -> list[Row]:
    """Table 4: the five settings of the noise (inferred)."""
    return [{"setting": i, "F": s.F, "L": s.L, "κ": s.kappa} for i, s in SETTINGS.items()]


def table_5(result: Result) -> list[Row]:
    """Table 5: RMSE of position (km) and velocity (m/s) of all filters in the five settings, and TSTDKF to the others (%)."""
    rows: list[Row] = []
    for i in SETTINGS:
        row: Row = {"setting": i}
        for name in COMPARED:
            row[f"{name.upper()} (km)"] = rms(result.squares(name, "position", i))
            row[f"{name.upper()} (m/s)"] = 1e3 * rms(result.squares(name, "velocity", i))
        for what, unit, printed in (("position", "km", published.POSITION_BELOW), ("velocity", "m/s", published.VELOCITY_BELOW)):
            for name in ("EKF", "TKF"):
                row[f"{what}, below {name} (%)"] = 100.0 * (1.0 - float(row[f"TSTDKF ({unit})"]) / float(row[f"{name} ({unit})"]))
                row[f"the paper's, {what}, {name}"] = printed[name.lower()] if i == 1 else ""
        rows.append(row)
    return rows


def _late(values: Array) -> float:
    return rms(values[len(values) // 2 :])


def table_6(result: Result) -> list[Row]:
    """Beyond the paper: setting 1 with every filter: position and velocity over the month, position and bias in its second half."""
    rows: list[Row] = []
    for name in (*FAIR, *COMPARED):
        row: Row = {"filter": name.upper(), "position (km)": rms(result.squares(name, "position"))}
        row["velocity (m/s)"] = 1e3 * rms(result.squares(name, "velocity"))
        row["position, second half (km)"] = _late(result.squares(name, "position"))
        row["bias, second half (km)"] = "" if name.startswith("ekf") else _late(result.squares(name, "bias"))
        rows.append(row)
    return rows


def table_7(result: Result) -> list[Row]:
    """Beyond the paper: what the percentages depend on: setting 1 with one thing changed."""
    rows: list[Row] = []
    for i, label in enumerate(PARAMETERS):
        found = {name: rms(result.data["parameters"][f"{i}/{name}/position"]) for name in ("ekf", "tkf", "tdkf", "tstdkf")}
        row: Row = {"changed": label} | {f"{name.upper()} (km)": value for name, value in found.items()}
        for name in ("ekf", "tkf"):
            row[f"TSTDKF below {name.upper()} (%)"] = 100.0 * (1.0 - found["tstdkf"] / found[name])
        rows.append(row)
    return rows


def table_8(result: Result) -> list[Row]:
    """Beyond the paper: the coupling κ of the noises, and what filters take it for: position (km), second half of ten days."""
    data, rows = result.data["couplings"], []
    for i, pair in enumerate(COUPLINGS):
        row: Row = {"κ": pair[0], "taken for": pair[1]}
        row |= {name.upper(): _late(data[f"{i}/{name}/position"]) for name in ("tkf", "tstdkf", "aug")}
        rows.append(row)
    return rows
