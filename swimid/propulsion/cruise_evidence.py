"""The checks, tables and figures of a cruise fit, as data for the report."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

from swimid.fitting import fit_common
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Array, Trial
from swimid.fitting.output_error import FitResult
from swimid.propulsion.model import SPEED
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.parameters import Estimate

#: A frequency at which all runs lie off the law by more than this share, and by more standard
#: errors than that, is left out of the fit and reported.
DEPARTURE_SHARE = 0.01
DEPARTURE_Z = 4.0
#: The exponents of the law.
LAWS = {"frequency_exponent": 3.0, "amplitude_exponent": 2.0}
FREQUENCY, AMPLITUDE = itemgetter("frequency_hz"), itemgetter("amplitude_deg")


def law_checks(departures: list[dict[str, Any]], exponents: dict[str, Estimate]) -> list[ev.Check]:
    """Whether every frequency, and each exponent set free, follows the law."""
    off = ", ".join(f"{d['frequency_hz']:g} Hz: {100 * d['share']:+.1f} %" for d in departures)
    checks = [
        blocks.check(
            "every frequency follows the law",
            off or "all",
            f"within {100 * DEPARTURE_SHARE:g} % or {DEPARTURE_Z:g} standard errors",
            not departures,
            text="left out of the fit" if departures else "",
        )
    ]
    for name, law in LAWS.items():
        e = exponents.get(f"free_{name}")
        if e is None:
            continue
        known = e.status == "estimated" and e.stderr is not None
        agrees = not known or abs(e.value - law) <= 3 * (e.stderr or 0.0)
        checks.append(
            ev.Check(
                name=name.replace("_", " "),
                value=numbers.measured(e.value, e.stderr) if known else "not identifiable",
                limit=f"{law:g} (the law)",
                verdict="info" if not known else "pass" if agrees else "warn",
                text="of the power, set free with the offset",
            )
        )
    return checks


def tables(
    experiment: Experiment,
    points: list[dict[str, Any]],
    offsets: list[dict[str, blocks.Cell]],
    departures: list[dict[str, Any]],
    everything: FitResult,
    result: FitResult,
) -> list[ev.Table]:
    """Fins, runs, offsets, and the fit with and without the departures."""
    fins: list[dict[str, blocks.Cell]] = []
    for t in experiment.trials:
        fin, inertia = experiment.robot.fins[t.id], t.cruise.inertia_kg_m2
        fins.append(
            {
                "fin": t.id,
                "height (m)": fin.height_m,
                "length (m)": fin.length_m,
                "area (m²)": fin.area_m2,
                "hydrodynamic inertia (g cm²)": None if inertia is None else numbers.number(1e7 * inertia, 5),
            }
        )
    runs: list[dict[str, blocks.Cell]] = [
        {
            "fin": p["fin"],
            "f (Hz)": p["frequency_hz"],
            "amplitude (deg)": round(p["amplitude_deg"], 3),
            "average speed (cm/s)": numbers.number(100 * p["mean_speed_m_s"], 4),
            "terminal speed (cm/s)": numbers.number(100 * p["terminal_speed_m_s"], 4),
            "force (mN)": numbers.number(1e3 * p["propulsive_force_N"], 4),
            "Strouhal, fin": numbers.number(p["strouhal_fin"], 3),
            "Strouhal, axle": numbers.number(p["strouhal_axle"], 3),
            "efficiency (%)": None if p["efficiency"] is None else numbers.number(100 * p["efficiency"], 3),
        }
        for p in points
    ]
    about_fins = "A rectangle's inertia follows from Eq 6; where none is shown it is not known."
    about_runs = (
        "Force is drag at terminal speed. Strouhal number with the fin's length as lever of the wake width "
        "(the source's Eq 28) and with the distance from the axle to the trailing edge."
    )
    tables = [
        blocks.table("fins", "Fins", fins, about_fins),
        blocks.table("points", "Runs", runs, about_runs),
    ]
    if offsets:
        tables.append(blocks.table("offsets", "Amplitude offsets by fin and frequency", offsets))
    if departures:
        rows: list[dict[str, blocks.Cell]] = [
            {
                "parameter": n,
                "without": numbers.measured(result.value(n), result.stderr(n)),
                "with": numbers.measured(everything.value(n), everything.stderr(n)),
            }
            for n in result.labels
            if "[" not in n
        ]
        title = "With and without the frequencies that depart from the law"
        tables.append(blocks.table("departures", title, rows))
    return tables


def figures(experiment: Experiment, result: FitResult, points: list[dict[str, Any]]) -> list[ev.Figure]:
    """Speeds against frequency and amplitude, force, Strouhal number, residuals."""
    levels, counts = np.unique(np.round(list(map(AMPLITUDE, points)), 6), return_counts=True)
    amplitude = float(levels[np.argmax(counts)])
    frequencies = [
        f
        for f in sorted(set(map(FREQUENCY, points)))
        if len({p["amplitude_deg"] for p in points if p["frequency_hz"] == f}) > 2
    ]
    by_frequency, by_amplitude, force, wake = [], [], [], []
    for group, trial in enumerate(experiment.trials):
        cloud = partial(blocks.points, label=trial.id, group=group)
        mine = [p for p in points if p["fin"] == trial.id]
        at = sorted((p for p in mine if abs(p["amplitude_deg"] - amplitude) < 1e-6), key=FREQUENCY)
        if at:
            f = np.linspace(0.0, max(map(FREQUENCY, at)), 60)[1:]
            speed = 100 * _law(result, trial, f, np.full(len(f), amplitude))
            by_frequency.append(cloud(at, FREQUENCY, lambda p: 100 * p["mean_speed_m_s"]))
            by_frequency.append(ev.Trace(x=f, y=speed, group=group))
            force.append(cloud(at, FREQUENCY, lambda p: 1e3 * p["propulsive_force_N"]))
            wake.append(cloud(at, FREQUENCY, itemgetter("strouhal")))
        for f0 in frequencies[:1]:
            swept = sorted((p for p in mine if p["frequency_hz"] == f0), key=AMPLITUDE)
            if swept:
                a = np.linspace(0.0, max(map(AMPLITUDE, swept)), 80)[1:]
                speed = 100 * _law(result, trial, np.full(len(a), f0), a)
                by_amplitude.append(cloud(swept, AMPLITUDE, lambda p: (100 * p["mean_speed_m_s"]) ** 1.5))
                by_amplitude.append(ev.Trace(x=a, y=speed**1.5, group=group))

    over_frequency = partial(blocks.panel, "frequency (Hz)", title=f"at {amplitude:g}°")
    panels = [over_frequency("average speed (cm/s)", by_frequency)]
    if by_amplitude:
        title = f"at {frequencies[0]:g} Hz"
        panels.append(
            blocks.panel("amplitude (deg)", "average speed^1.5 (cm/s)^1.5", by_amplitude, title=title)
        )
    efficient = [ev.Mark(at=0.25), ev.Mark(at=0.4, label="efficient swimmers")]
    return [
        blocks.panels(
            "speeds",
            "Average speed against frequency and amplitude",
            "Points are runs, lines the fitted law: straight through the origin against frequency, straight "
            "with the offset as intercept against amplitude. Runs below their line at high frequency point "
            "to a flexing fin.",
            panels,
        ),
        blocks.panels(
            "force",
            "Propulsive force and Strouhal number",
            "Force grows with the square of frequency under the law; the Strouhal number then stays "
            "constant.",
            [
                over_frequency("propulsive force (mN)", force),
                over_frequency("Strouhal number", wake, marks=efficient),
            ],
        ),
        *fit_common.figures(result)[1:],
    ]


def _law(result: FitResult, trial: Trial, frequency: Array, amplitude_deg: Array) -> Array:
    runs = replace(
        trial,
        time_s=np.arange(len(frequency), dtype=float),
        inputs={
            "frequency_hz": frequency,
            "amplitude_rad": np.deg2rad(amplitude_deg),
            "distance_m": np.full(len(frequency), float(np.median(trial.inputs["distance_m"]))),
        },
    )
    return result.model.simulate(result.values(trial.id), runs)[SPEED]
