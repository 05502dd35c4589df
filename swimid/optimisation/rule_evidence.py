"""Checks, tables, figures and sentences of ``swimid optimise stiffness``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swimid.fitting.model import Array
from swimid.notices import Notice
from swimid.optimisation import trust
from swimid.optimisation.performance import BEAT
from swimid.optimisation.rule import Curve, RuleFile
from swimid.results import blocks, numbers
from swimid.results import evidence as ev

#: Largest loss of speed, or rise of cost, of the rule against its own optima.
MAX_LOSS = 0.02
#: Number of points of a curve, and of panels of a figure.
N_POINTS, MAX_PANELS = 60, 6


def evidence(file: RuleFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the evidence of a rule."""
    first, second = (name.replace("_", " ") for name in file.objectives)
    return trust.evidence(
        file,
        "optimise stiffness",
        answer(file),
        _checks(file),
        {
            "Stiffness": f"{file.coefficient}, {numbers.interval(*file.between, None, file.unit)}",
            "Objective": file.objective,
            "Frequency": numbers.interval(*file.frequency_hz, None, "Hz"),
            "Amplitude": numbers.interval(*file.amplitude_deg, None, "deg"),
        },
        notices,
        origin,
        tables=[_curves(file), _optima(file)],
        figures=[_rule(file), _speeds(file)],
        methods=[
            f"At {len(file.optima)} points of frequency and amplitude the Pareto front of {first} and "
            f"{second} over {file.coefficient} was searched by NSGA-II (Deb et al. 2002, as implemented in "
            f"pymoo); each run of {file.duration_s:g} s began at rest. The best values of the first were "
            "fitted by a quadratic function of the frequency for each amplitude. Intervals, where known, are "
            f"percentiles of the same over {file.draws} draws of the coefficients from their covariance."
        ],
    )


# ------------------------------------------------------------ what it comes to


def _column(file: RuleFile, name: str) -> Array:
    """A number of every optimum, NaN where there is none."""
    return np.array([getattr(one, name) for one in file.optima], dtype=float)


def loss(file: RuleFile) -> Array:
    """Return what the rule loses against its own optima: a share of speed, or of cost where that counts."""
    with np.errstate(invalid="ignore", divide="ignore"):
        if file.objective == "speed":
            return np.asarray(1.0 - _column(file, "rule_speed_m_s") / _column(file, "speed_m_s"))
        own, ruled = (_column(file, f"{p}cost_of_transport_J_m") for p in ("", "rule_"))
        return np.asarray(ruled / own - 1.0)


def largest_speeds(file: RuleFile) -> tuple[float, float]:
    """Return the highest speed with the rule and with the reference, m/s (tendon fish, section V.C)."""
    ruled, fixed = (np.nanmax(_column(file, f"{p}_speed_m_s")) for p in ("rule", "reference"))
    return float(ruled), float(fixed)


def _checks(file: RuleFile) -> list[ev.Check]:
    count, inside = len(file.optima), sum(not one.at_bound for one in file.optima)
    text = "" if inside == count else "the rest lie at an end: a better stiffness may lie beyond it"
    name = "optima within the range searched"
    checks = [ev.check(name, f"{inside} of {count}", inside == count, "all", text)]
    worst = float(np.nanmax(loss(file)))
    name, text = "what the rule loses against its own optima", "the optima are no quadratic function there"
    checks.append(_at_most(name, worst, text))
    if file.objective == "speed":
        surge = [-min(row[1] for row in o.front if row[1] is not None) for o in file.optima]
        checks += trust.forwards_check(surge)
    checks.append(trust.steady_check(sum(one.settling_time_s is not None for one in file.optima), count))
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT}
    grid = [{**drive, "frequency_hz": o.frequency_hz, "amplitude_deg": o.amplitude_deg} for o in file.optima]
    checks.append(trust.region_check(file.identified, grid))
    if file.inside is None:
        checks.append(trust.unknown_check("uncertainty of the rule"))
    else:
        worst = max(one.loss_90 or 0.0 for one in file.optima)
        text = "the best stiffness depends on what the fit left open: see its intervals"
        name = "what the rule loses in nine of ten draws of the coefficients"
        checks += [trust.draws_check(file.inside), _at_most(name, worst, text)]
    if file.sweeps:
        won = sum(s.rule_m >= max(s.fixed_m) for s in file.sweeps)
        name = "a frequency sweep with the rule is faster than with any fixed stiffness"
        value = f"at {won} of {len(file.sweeps)} amplitudes"
        checks.append(ev.check(name, value, won == len(file.sweeps), "all"))
    return checks


def _at_most(name: str, worst: float, text: str) -> ev.Check:
    """Check that a loss is small everywhere."""
    sound = worst <= MAX_LOSS
    value, limit = f"at most {numbers.percent(worst, 2)}", f"≤ {numbers.percent(MAX_LOSS)}"
    return ev.check(name, value, sound, limit, "" if sound else text)


def _signed(value: float, digits: int = 4) -> str:
    return f"{'−' if value < 0 else '+'} {numbers.number(abs(value), digits)}"


def answer(file: RuleFile) -> str:
    """Return what the rule says and gains as a sentence."""
    stiffness, f = _column(file, "stiffness"), _column(file, "frequency_hz")
    low, high = float(stiffness.min()), float(stiffness.max())
    trend = "over"
    if high > low and np.corrcoef(f, stiffness)[0, 1] > 0.3:
        trend = "rising with"
    text = f"{file.coefficient} {numbers.number(low, 3)} to {numbers.number(high, 3, file.unit)}, "
    text += f"{trend} frequency"
    if file.objective == "speed":
        ruled, fixed = largest_speeds(file)
        text += (
            f"; highest speed {numbers.number(ruled, 3, 'm/s')} against {numbers.number(fixed, 3, 'm/s')} "
            f"with {numbers.number(file.reference, 3, file.unit)} ({_signed(100 * (ruled / fixed - 1), 3)} %)"
        )
    return f"{text}."


# ------------------------------------------------------------ tables


def _curves(file: RuleFile) -> ev.Table:
    rows = []
    for c in file.curves:
        named = zip(("c0", "c1", "c2"), c.coefficients, c.stderr or (None, None, None), strict=True)
        row: dict[str, blocks.Cell] = {"amplitude": numbers.number(c.amplitude_deg, 3, "deg")}
        row |= {name: numbers.measured(value, error) for name, value, error in named}
        row["rms left"] = numbers.number(c.rms, 2, file.unit)
        rows.append(row)
    caption = (
        f"{file.coefficient} = c0 + c1 f + c2 f², f in Hz, held within {numbers.interval(*file.between)}; "
        "between amplitudes by straight lines."
    )
    return blocks.table("rule", "The rule", rows, caption)


def _optima(file: RuleFile) -> ev.Table:
    rows = []
    for o, lost in zip(file.optima, loss(file), strict=True):
        row: dict[str, blocks.Cell] = {
            "frequency": numbers.number(o.frequency_hz, 3, "Hz"),
            "amplitude": numbers.number(o.amplitude_deg, 3, "deg"),
            file.coefficient: numbers.number(o.stiffness, 3, file.unit),
            "95 %": numbers.interval(*o.stiffness_ci95),
            "speed": numbers.number(o.speed_m_s, 3, "m/s"),
            "with the rule": numbers.number(o.rule_speed_m_s, 3, "m/s"),
            "with the reference": numbers.number(o.reference_speed_m_s, 3, "m/s"),
            "loss of the rule": numbers.percent(float(lost), 2),
            "cost": numbers.number(o.cost_of_transport_J_m, 3, "J/m"),
            "settles in": numbers.number(o.settling_time_s, 3, "s"),
        }
        rows.append(row)
    reference = numbers.number(file.reference, 3, file.unit)
    caption = f"The reference is {reference}; without a settling time the robot still gains speed at the end."
    return blocks.table("optima", "Optima over the grid", rows, caption)


# ------------------------------------------------------------ figures


def _rule(file: RuleFile) -> ev.Figure:
    traces = []
    x = np.linspace(*file.frequency_hz, N_POINTS)
    for group, c in enumerate(file.curves):
        optima = [o for o in file.optima if o.amplitude_deg == c.amplitude_deg]
        label = f"{numbers.number(c.amplitude_deg, 3)} deg"
        traces += [
            blocks.points(optima, lambda o: o.frequency_hz, lambda o: o.stiffness, label=label, group=group),
            _curve(file, c, x, group),
        ]
    caption = "Points are the stiffness found, curves the rule, bands its 95 % interval over draws."
    y_label = f"{file.coefficient} ({numbers.unit_text(file.unit) or '1'})"
    return blocks.figure("rule", "Stiffness rule", caption, "frequency (Hz)", y_label, traces)


def _curve(file: RuleFile, curve: Curve, x: Array, group: int) -> ev.Trace:
    """The rule at an amplitude, with its band where that is known."""
    y = [file.stiffness_for(float(f), curve.amplitude_deg, outside="hold") for f in x]
    trace = ev.Trace(x=x, y=y, group=group)
    if file.draws:
        ends = [file.interval_for(float(f), curve.amplitude_deg, outside="hold") for f in x]
        trace.lower, trace.upper = np.array(ends, dtype=float).T.tolist()
    return trace


def _speeds(file: RuleFile) -> ev.Figure:
    panels = []
    for c in file.curves[:MAX_PANELS]:
        optima = [o for o in file.optima if o.amplitude_deg == c.amplitude_deg]
        x, fixed = [o.frequency_hz for o in optima], numbers.number(file.reference, 3, file.unit)
        traces = [
            ev.Trace(x=x, y=[o.rule_speed_m_s for o in optima], label="rule"),
            ev.Trace(x=x, y=[o.reference_speed_m_s for o in optima], style="dashed", label=fixed),
        ]
        title = f"{c.amplitude_deg:g} deg"
        panels.append(blocks.panel("frequency (Hz)", "mean speed (m/s)", traces, title=title))
    caption = f"Each point is a run of {file.duration_s:g} s from rest (tendon fish, Fig 11)."
    title = "Speed with the rule and with a fixed stiffness"
    return blocks.panels("speeds", title, caption, panels, columns=2)
