"""The checks, tables and figures of a cruise fit, as data for the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.fitting import fit_common
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Array, Trial
from swimid.fitting.output_error import FitResult
from swimid.propulsion.model import SPEED
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.parameters import Estimate

#: A frequency at which all runs lie off the law by more than this share, and by more standard
#: errors than that, is left out of the fit and reported.
DEPARTURE_SHARE = 0.01
DEPARTURE_Z = 4.0
#: The exponents of the law.
LAWS = {"frequency_exponent": 3.0, "amplitude_exponent": 2.0}


def law_checks(departures: list[dict[str, Any]], exponents: dict[str, Estimate]) -> list[ev.Check]:
    """Whether every frequency, and each exponent set free, follows the law."""
    found = [
        ev.Check(
            name="every frequency follows the law",
            value="all"
            if not departures
            else ", ".join(f"{d['frequency_hz']:g} Hz: {100 * d['share']:+.1f} %" for d in departures),
            limit=f"within {100 * DEPARTURE_SHARE:g} % or {DEPARTURE_Z:g} standard errors",
            verdict="pass" if not departures else "warn",
            text="" if not departures else "left out of the fit",
        )
    ]
    for name, law in LAWS.items():
        e = exponents.get(f"free_{name}")
        if e is None:
            continue
        known = e.status == "estimated" and e.stderr is not None
        agrees = not known or abs(e.value - law) <= 3 * (e.stderr or 0.0)
        found.append(
            ev.Check(
                name=name.replace("_", " "),
                value=numbers.measured(e.value, e.stderr) if known else "not identifiable",
                limit=f"{law:g} (the law)",
                verdict="info" if not known else "pass" if agrees else "warn",
                text="of the power, set free with the offset",
            )
        )
    return found


def tables(
    experiment: Experiment,
    points: list[dict[str, Any]],
    offsets: list[list[Any]],
    departures: list[dict[str, Any]],
    everything: FitResult,
    result: FitResult,
) -> list[ev.Table]:
    """Fins, runs, offsets, and the fit with and without the departures."""
    fins = [
        [
            t.id,
            experiment.robot.fins[t.id].height_m,
            experiment.robot.fins[t.id].length_m,
            experiment.robot.fins[t.id].area_m2,
            None if t.cruise.inertia_kg_m2 is None else numbers.number(1e7 * t.cruise.inertia_kg_m2, 5),
        ]
        for t in experiment.trials
    ]
    tables = [
        ev.Table(
            id="fins",
            title="Fins",
            columns=["fin", "height (m)", "length (m)", "area (m²)", "hydrodynamic inertia (g cm²)"],
            rows=fins,
            caption="A rectangle's inertia follows from Eq 6; where none is shown it is not known.",
        ),
        ev.Table(
            id="points",
            title="Runs",
            columns=[
                "fin",
                "f (Hz)",
                "amplitude (deg)",
                "average speed (cm/s)",
                "terminal speed (cm/s)",
                "force (mN)",
                "Strouhal, fin",
                "Strouhal, axle",
                "efficiency (%)",
            ],
            rows=[
                [
                    p["fin"],
                    p["frequency_hz"],
                    round(p["amplitude_deg"], 3),
                    numbers.number(100 * p["mean_speed_m_s"], 4),
                    numbers.number(100 * p["terminal_speed_m_s"], 4),
                    numbers.number(1e3 * p["propulsive_force_N"], 4),
                    numbers.number(p["strouhal_fin"], 3),
                    numbers.number(p["strouhal_axle"], 3),
                    numbers.number(100 * p["efficiency"], 3) if p["efficiency"] is not None else None,
                ]
                for p in points
            ],
            caption="Force is drag at terminal speed. Strouhal number with the fin's length as lever "
            "of the wake "
            "width (the source's Eq 28) and with the distance from the axle to the trailing edge.",
        ),
    ]
    if offsets:
        tables.append(
            ev.Table(
                id="offsets",
                title="Amplitude offsets by fin and frequency",
                columns=["fin", "f (Hz)", "offset"],
                rows=offsets,
            )
        )
    if departures:
        names = [n for n in result.labels if "[" not in n]
        tables.append(
            ev.Table(
                id="departures",
                title="With and without the frequencies that depart from the law",
                columns=["parameter", "without", "with"],
                rows=[
                    [
                        n,
                        numbers.measured(result.value(n), result.stderr(n)),
                        numbers.measured(everything.value(n), everything.stderr(n)),
                    ]
                    for n in names
                ],
            )
        )
    return tables


def figures(experiment: Experiment, result: FitResult, points: list[dict[str, Any]]) -> list[ev.Figure]:
    """Speeds against frequency and amplitude, force, Strouhal number, residuals."""
    amplitude = _most_common([p["amplitude_deg"] for p in points])
    frequencies = [
        f
        for f in sorted({p["frequency_hz"] for p in points})
        if len({p["amplitude_deg"] for p in points if p["frequency_hz"] == f}) > 2
    ]
    by_frequency, by_amplitude, force, wake = [], [], [], []
    for group, trial in enumerate(experiment.trials):
        at = sorted(
            (p for p in points if p["fin"] == trial.id and abs(p["amplitude_deg"] - amplitude) < 1e-6),
            key=lambda p: p["frequency_hz"],
        )
        if at:
            f = np.linspace(0.0, max(p["frequency_hz"] for p in at), 60)[1:]
            by_frequency += [
                _runs(at, "frequency_hz", lambda p: 100 * p["mean_speed_m_s"], group),
                ev.Trace(x=f, y=100 * _law(result, trial, f, np.full(len(f), amplitude)), group=group),
            ]
            force.append(_runs(at, "frequency_hz", lambda p: 1e3 * p["propulsive_force_N"], group))
            wake.append(_runs(at, "frequency_hz", lambda p: p["strouhal"], group))
        for f0 in frequencies[:1]:
            swept = sorted(
                (p for p in points if p["fin"] == trial.id and p["frequency_hz"] == f0),
                key=lambda p: p["amplitude_deg"],
            )
            if swept:
                a = np.linspace(0.0, max(p["amplitude_deg"] for p in swept), 80)[1:]
                by_amplitude += [
                    _runs(swept, "amplitude_deg", lambda p: (100 * p["mean_speed_m_s"]) ** 1.5, group),
                    ev.Trace(x=a, y=(100 * _law(result, trial, np.full(len(a), f0), a)) ** 1.5, group=group),
                ]
    panels = [
        ev.Panel(
            x_label="frequency (Hz)",
            y_label="average speed (cm/s)",
            traces=by_frequency,
            title=f"at {amplitude:g}°",
        )
    ]
    if by_amplitude:
        panels.append(
            ev.Panel(
                x_label="amplitude (deg)",
                y_label="average speed^1.5 (cm/s)^1.5",
                traces=by_amplitude,
                title=f"at {frequencies[0]:g} Hz",
            )
        )
    return [
        ev.Figure(
            id="speeds",
            title="Average speed against frequency and amplitude",
            columns=2,
            panels=panels,
            caption="Points are runs, lines the fitted law: straight through the origin against "
            "frequency, straight "
            "with the offset as intercept against amplitude. Runs below their line at high frequency "
            "point to a flexing fin.",
        ),
        ev.Figure(
            id="force",
            title="Propulsive force and Strouhal number",
            columns=2,
            panels=[
                ev.Panel(
                    x_label="frequency (Hz)",
                    y_label="propulsive force (mN)",
                    traces=force,
                    title=f"at {amplitude:g}°",
                ),
                ev.Panel(
                    x_label="frequency (Hz)",
                    y_label="Strouhal number",
                    traces=wake,
                    title=f"at {amplitude:g}°",
                    marks=[ev.Mark(at=0.25), ev.Mark(at=0.4, label="efficient swimmers")],
                ),
            ],
            caption="Force grows with the square of frequency under the law; the Strouhal number "
            "then stays constant.",
        ),
        *fit_common.figures(result)[1:],
    ]


def _runs(points: list[dict[str, Any]], x: str, y: Callable[[dict[str, Any]], float], group: int) -> ev.Trace:
    return ev.Trace(
        x=[p[x] for p in points],
        y=[y(p) for p in points],
        style="points",
        label=points[0]["fin"],
        group=group,
    )


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


def _most_common(values: list[float]) -> float:
    rounded = np.round(values, 6)
    levels, counts = np.unique(rounded, return_counts=True)
    return float(levels[np.argmax(counts)])
