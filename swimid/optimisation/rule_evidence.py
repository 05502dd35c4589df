"""Checks, tables, figures and sentences of ``swimid optimise stiffness``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swimid.fitting.model import Array
from swimid.notices import Notice
from swimid.optimisation import trust
from swimid.optimisation.performance import BEAT
from swimid.optimisation.rule import Optimum, RuleFile
from swimid.results import blocks, numbers
from swimid.results import evidence as ev

#: The rule may lose so much of the speed (or so much more cost) that its own optima have.
LOSS = 0.02
#: Share of draws in which a rule is to reach the speed asked for.
SURE = 0.9
#: Points of a curve; fronts drawn.
POINTS, FRONTS = 60, 6
REFERENCES = [
    "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin",
    "D. Chen, Y. Xiong, B. Wang, R. Tong, Y. Meng, J. Yu: Performance Optimization for Bionic Robotic "
    "Dolphin with Active Variable Stiffness Control",
    "Deb, Pratap, Agarwal, Meyarivan (2002): A fast and elitist multiobjective genetic algorithm: NSGA-II. "
    "IEEE Transactions on Evolutionary Computation 6, doi:10.1109/4235.996017",
    "Blank, Deb (2020): pymoo: Multi-Objective Optimization in Python. IEEE Access 8, "
    "doi:10.1109/ACCESS.2020.2990567",
]


def evidence(file: RuleFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """What a rule rests on."""
    checks = [*_checks(file), *trust.coefficients_check(notices)]
    return ev.Evidence(
        verb="optimise stiffness",
        title=f"Stiffness rule of {file.robot}",
        verdict=ev.judged(answer(file), checks),
        checks=checks,
        tables=[_curves(file), _optima(file)],
        figures=_figures(file),
        notices=blocks.notices(notices),
        methods=_methods(file),
        references=REFERENCES,
        provenance=origin,
    )


# ------------------------------------------------------------ what it comes to


def _column(file: RuleFile, name: str) -> Array:
    """A number of every optimum, NaN where there is none."""
    return np.array([getattr(one, name) for one in file.optima], dtype=float)


def gain(file: RuleFile, name: str = "rule_speed_m_s") -> Array:
    """Speed of every optimum (or with the rule) over that with the reference stiffness, less one."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(_column(file, name) / _column(file, "reference_speed_m_s") - 1.0)


def loss(file: RuleFile) -> Array:
    """What the rule loses of what its own optima have: a share of speed, or of cost where that counts."""
    with np.errstate(invalid="ignore", divide="ignore"):
        if file.objective == "speed":
            return np.asarray(1.0 - _column(file, "rule_speed_m_s") / _column(file, "speed_m_s"))
        own, ruled = (_column(file, f"{p}cost_of_transport_J_m") for p in ("", "rule_"))
        return np.asarray(ruled / own - 1.0)


def largest_speeds(file: RuleFile) -> tuple[float, float]:
    """The highest speed with the rule and with the reference stiffness, m/s (tendon fish, section V.C)."""
    ruled, fixed = (np.nanmax(_column(file, f"{p}_speed_m_s")) for p in ("rule", "reference"))
    return float(ruled), float(fixed)


def _checks(file: RuleFile) -> list[ev.Check]:
    bound = sum(one.at_bound for one in file.optima)
    reached = sum(one.stiffness is not None for one in file.optima)
    count = len(file.optima)
    worst = float(np.nanmax(loss(file)))
    checks = [
        ev.check(
            "optima within the range searched",
            f"{reached - bound} of {reached}",
            not bound,
            "all",
            "the rest lie at an end: a better stiffness may lie beyond it" if bound else "",
        ),
        ev.check(
            "what the rule loses against its own optima",
            f"at most {numbers.percent(worst, 2)}",
            worst <= LOSS,
            f"≤ {numbers.percent(LOSS)}",
            "" if worst <= LOSS else "a quadratic function of the frequency does not follow them there",
        ),
    ]
    if reached < count:
        text = "elsewhere no stiffness reaches the speed"
        checks.insert(
            0, ev.check("the speed is reached", f"at {reached} of {count} points", False, "all", text)
        )
    if file.objective == "speed":
        surge = [-min(row[1] for row in o.front if row[1] is not None) for o in file.optima if o.front]
        checks += trust.forwards_check(surge)
    settled = sum(one.settling_time_s is not None for one in file.optima if one.stiffness is not None)
    checks.append(
        ev.check(
            "steady at the end of the run",
            f"{settled} of {reached}",
            settled == reached,
            "all",
            ""
            if settled == reached
            else "the rest still gain speed: a rule for runs of this length, --duration-s",
        )
    )
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT}
    grid = [{**drive, "frequency_hz": o.frequency_hz, "amplitude_deg": o.amplitude_deg} for o in file.optima]
    checks += [trust.region_check(file.identified, grid), *_sure(file)]
    beaten = [s for s in file.sweeps if s.rule_m < max(s.fixed_m)]
    if file.objective == "speed":
        checks.append(
            ev.check(
                "a frequency sweep with the rule is faster than with any fixed stiffness",
                f"at {len(file.sweeps) - len(beaten)} of {len(file.sweeps)} amplitudes",
                not beaten,
                "all",
            )
        )
    return checks


def _sure(file: RuleFile) -> list[ev.Check]:
    """Checks of the coefficients' uncertainty in the rule."""
    if not file.draws:
        text = (
            "it is told for --pick best only"
            if file.pick == "knee"
            else "give a parameter file with standard errors (--params), and --draws"
        )
        return [ev.check("uncertainty of the rule", "not known", None, text=text)]
    checks = [trust.draws_check(file.draws, file.inside, file.refused)]
    optima = [o for o in file.optima if o.stiffness is not None]
    if file.reach_speed_m_s is not None:
        least = min(o.reached_in_draws or 0.0 for o in optima)
        text = "the rule just reaches it with the estimates: ask for a somewhat higher speed"
        checks.append(
            ev.check(
                "draws in which the rule reaches the speed",
                f"{numbers.percent(least, 2)} or more",
                least >= SURE,
                f"≥ {numbers.percent(SURE)}",
                "" if least >= SURE else text,
            )
        )
        return checks
    lost = [o.loss_90 for o in optima]
    worst = max((v for v in lost if v is not None), default=None)
    sound = worst is not None and None not in lost and worst <= LOSS
    checks.append(
        ev.check(
            "what the rule loses in nine of ten draws of the coefficients",
            "runs break down" if worst is None or None in lost else f"at most {numbers.percent(worst, 2)}",
            sound,
            f"≤ {numbers.percent(LOSS)}",
            "" if sound else "the best stiffness depends on what the fit left open: see its intervals",
        )
    )
    return checks


def answer(file: RuleFile) -> str:
    """What the rule says and gains, as a sentence."""
    stiff = _column(file, "stiffness")
    f = _column(file, "frequency_hz")
    there = np.isfinite(stiff)
    low, high = (numbers.number(float(k), 3) for k in (np.nanmin(stiff), np.nanmax(stiff)))
    trend = "rising with" if np.corrcoef(f[there], stiff[there])[0, 1] > 0.3 else "over"
    text = (
        f"{file.coefficient} {low} to {numbers.number(float(np.nanmax(stiff)), 3, file.unit)}"
        if low != high
        else (f"{file.coefficient} {numbers.number(float(np.nanmax(stiff)), 3, file.unit)}")
    )
    text += f", {trend} frequency"
    if file.objective == "speed":
        ruled, fixed = largest_speeds(file)
        text += (
            f"; highest speed {numbers.number(ruled, 3, 'm/s')} against "
            f"{numbers.number(fixed, 3, 'm/s')} with "
            f"{numbers.number(file.reference, 3, file.unit)} ({100 * (ruled / fixed - 1):+.1f} %)"
        ).replace("-", "−")
    if file.least_effort is not None:
        o = file.least_effort
        text += (
            f"; {numbers.number(file.reach_speed_m_s, 3, 'm/s')} is reached with the least power, "
            f"{numbers.number(o.power_W, 3, 'W')}, at {numbers.number(o.frequency_hz, 3, 'Hz')} and "
            f"{numbers.number(o.stiffness, 3, file.unit)}"
        )
    return f"{text}."


def _widest(file: RuleFile) -> tuple[Optimum, tuple[float, float]] | None:
    """The point of the grid where the rule is least sure, and its interval there."""
    told = []
    for o in file.optima:
        ends = file.interval_for(o.frequency_hz, o.amplitude_deg, outside="hold")
        if ends is not None:
            told.append((o, ends))
    return max(told, key=lambda one: one[1][1] - one[1][0], default=None)


def _signed(value: float) -> str:
    return f"{'−' if value < 0 else '+'} {numbers.number(abs(value), 4)}"


def summary(file: RuleFile, evidence: ev.Evidence) -> str:
    """Plain text for the terminal."""
    lines = [f"{file.robot}, {file.params or 'the robot file'}: {file.coefficient} for {file.objective}", ""]
    for c in file.curves:
        c0, c1, c2 = c.coefficients
        lines.append(
            f"  {numbers.number(c.amplitude_deg, 3)} deg: {file.coefficient} = {numbers.number(c0, 4)} "
            f"{_signed(c1)} f {_signed(c2)} f²  "
            f"(rms {numbers.number(c.rms, 2, file.unit)})"
        )
    if (wide := _widest(file)) is not None:
        o, (low, high) = wide
        lines.append(
            f"  95 % by the coefficients, widest at {o.frequency_hz:g} Hz and {o.amplitude_deg:g} deg: "
            f"{numbers.interval(low, high, None, file.unit)}"
        )
    over = gain(file)
    if np.isfinite(over).any():
        k = int(np.nanargmax(over))
        one = file.optima[k]
        lines += [
            "",
            f"  speed with the rule against {numbers.number(file.reference, 3, file.unit)}: "
            f"{100 * np.nanmin(over):+.1f} to {100 * over[k]:+.1f} %".replace("-", "−")
            + f", most at {one.frequency_hz:g} Hz and {one.amplitude_deg:g} deg",
        ]
    for s in file.sweeps:
        best = int(np.argmax(s.fixed_m))
        lines.append(
            f"  sweep at {s.amplitude_deg:g} deg: {numbers.number(s.rule_m, 4, 'm')} with the rule, "
            f"{numbers.number(s.fixed_m[best], 4, 'm')} with the best fixed one "
            f"({numbers.number(s.fixed[best], 3, file.unit)})"
        )
    told = answer(file)
    lines += ["", f"  {told[0].upper()}{told[1:]}" if not told.startswith(file.coefficient) else f"  {told}"]
    lines.append(f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}")
    return "\n".join(lines)


# ------------------------------------------------------------ tables


def _curves(file: RuleFile) -> ev.Table:
    rows = []
    for c in file.curves:
        errors = c.stderr or (None, None, None)
        named = zip(("c0", "c1", "c2"), c.coefficients, errors, strict=True)
        row: dict[str, blocks.Cell] = {"amplitude": numbers.number(c.amplitude_deg, 3, "deg")}
        row |= {name: numbers.measured(value, error) for name, value, error in named}
        if c.drawn:
            row |= {
                f"{name}, sd in draws": numbers.number(float(sd), 2)
                for name, sd in zip(
                    ("c0", "c1", "c2"), np.nanstd(np.array(c.drawn, dtype=float), axis=0, ddof=1), strict=True
                )
            }
        row["rms left"] = numbers.number(c.rms, 2, file.unit)
        rows.append(row)
    caption = (
        f"{file.coefficient} = c0 + c1 f + c2 f², f in Hz, {file.coefficient} in "
        f"{numbers.unit_text(file.unit) or '1'}, held between {numbers.number(file.between[0])} and "
        f"{numbers.number(file.between[1])}; between amplitudes by straight lines. Errors by the scatter of "
        "the optima about the curve."
    )
    return blocks.table("rule", "The rule", rows, caption)


def _optima(file: RuleFile) -> ev.Table:
    rows = []
    for o, over, lost in zip(file.optima, gain(file), loss(file), strict=True):
        row: dict[str, blocks.Cell] = {
            "frequency": numbers.number(o.frequency_hz, 3, "Hz"),
            "amplitude": numbers.number(o.amplitude_deg, 3, "deg"),
            file.coefficient: numbers.number(o.stiffness, 3, file.unit)
            + (" (at bound)" if o.at_bound else ""),
            "95 %": numbers.interval(*o.stiffness_ci95),
            "knee": numbers.number(o.knee, 3, file.unit),
            "speed": numbers.number(o.speed_m_s, 3, "m/s"),
            "with the rule": numbers.number(o.rule_speed_m_s, 3, "m/s"),
            "with the reference": numbers.number(o.reference_speed_m_s, 3, "m/s"),
            "gain of the rule": numbers.percent(float(over), 2),
            "loss of the rule": numbers.percent(float(lost), 2),
            "cost": numbers.number(o.cost_of_transport_J_m, 3, "J/m"),
            "turning rate, range": _degrees(o.turn_rate_range_rad_s),
            "with the reference ": _degrees(o.reference_turn_rate_range_rad_s),
            "settles in": numbers.number(o.settling_time_s, 3, "s"),
        }
        rows.append(row)
    caption = (
        f"Of the Pareto front of {' against '.join(n.replace('_', ' ') for n in file.objectives)} the "
        f"{'knee' if file.pick == 'knee' else 'best of the first'}; gain against "
        f"{numbers.number(file.reference, 3, file.unit)}. No settling time: still faster at the end."
        + (" 95 %: where the optimum lies in draws of the coefficients." if file.draws else "")
    )
    return blocks.table("optima", "Optima over the grid", rows, caption)


def _degrees(rate: float | None) -> str:
    return numbers.NOTHING if rate is None else numbers.number(float(np.degrees(rate)), 3, "deg/s")


# ------------------------------------------------------------ figures


def _figures(file: RuleFile) -> list[ev.Figure]:
    figures = [_rule(file), _fronts(file), _speeds(file)]
    if file.sweeps:
        figures.append(_sweep(file))
    return figures


def _at(file: RuleFile, amplitude: float) -> list[Optimum]:
    return [o for o in file.optima if o.amplitude_deg == amplitude]


def _unit(file: RuleFile) -> str:
    return f"{file.coefficient} ({numbers.unit_text(file.unit) or '1'})"


def _rule(file: RuleFile) -> ev.Figure:
    traces = []
    x = np.linspace(*file.frequency_hz, POINTS)
    for group, c in enumerate(file.curves):
        optima = [o for o in _at(file, c.amplitude_deg) if o.stiffness is not None]
        label = f"{numbers.number(c.amplitude_deg, 3)} deg"
        traces.append(
            blocks.points(optima, lambda o: o.frequency_hz, lambda o: o.stiffness, label=label, group=group)
        )
        y = [file.stiffness_for(float(f), c.amplitude_deg, outside="hold") for f in x]
        traces.append(_curve(file, c.amplitude_deg, x, y, group))
    caption = "Points: the stiffness found at each frequency. Curves: the rule, a quadratic function each."
    if file.draws:
        caption += " Bands: 95 % of the rules in draws of the coefficients."
    return blocks.figure("rule", "Stiffness rule", caption, "frequency (Hz)", _unit(file), traces)


def _curve(file: RuleFile, amplitude: float, x: Array, y: Sequence[float], group: int) -> ev.Trace:
    """The rule at an amplitude, with its band where that is known."""
    ends = [file.interval_for(float(f), amplitude, outside="hold") for f in x]
    known = [end for end in ends if end is not None]
    if len(known) < len(x):
        return ev.Trace(x=x, y=y, group=group)
    low, high = np.array(known).T
    return ev.Trace(x=x, y=y, lower=low, upper=high, group=group)


def _fronts(file: RuleFile) -> ev.Figure:
    first, second = (numbers.column_title(name) for name in file.objectives)
    signs = (-1.0, 1.0) if file.objective == "speed" else (1.0, -1.0)
    panels = []
    for c in file.curves[:FRONTS]:
        traces = []
        for group, o in enumerate(
            _at(file, c.amplitude_deg)[:: max(len(_at(file, c.amplitude_deg)) // 4, 1)]
        ):
            if o.front:
                front = np.array(o.front, dtype=float)
                label = f"{numbers.number(o.frequency_hz, 3)} Hz"
                x, y = signs[0] * front[:, 1], signs[1] * front[:, 2]
                traces.append(ev.Trace(x=x, y=y, style="points", label=label, group=group))
        panels.append(blocks.panel(first, second, traces, title=f"{c.amplitude_deg:g} deg"))
    caption = "Pareto fronts by NSGA-II: no stiffness is better in both. One point: both have the same best."
    return blocks.panels("fronts", "Pareto fronts", caption, panels, columns=2)


def _speeds(file: RuleFile) -> ev.Figure:
    panels = []
    for c in file.curves[:FRONTS]:
        optima = _at(file, c.amplitude_deg)
        x = [o.frequency_hz for o in optima]
        traces = [
            ev.Trace(x=x, y=[o.rule_speed_m_s for o in optima], label="rule"),
            ev.Trace(
                x=x,
                y=[o.reference_speed_m_s for o in optima],
                style="dashed",
                label=numbers.number(file.reference, 3, file.unit),
            ),
        ]
        panels.append(
            blocks.panel("frequency (Hz)", "mean speed (m/s)", traces, title=f"{c.amplitude_deg:g} deg")
        )
    caption = f"Each point a run of {file.duration_s:g} s from rest (tendon fish, Fig 11)."
    return blocks.panels(
        "speeds", "Speed with the rule and with a fixed stiffness", caption, panels, columns=2
    )


def _sweep(file: RuleFile) -> ev.Figure:
    panels = []
    for s in file.sweeps[:FRONTS]:
        ways = [(s.rule_m, s.rule_m_s, "rule")]
        order = np.argsort(s.fixed_m)[::-1]
        ways += [
            (s.fixed_m[k], s.fixed_m_s[k], f"fixed {numbers.number(s.fixed[k], 3)}")
            for k in (order[0], order[len(order) // 2], order[-1])
        ]
        traces = [
            ev.Trace(
                x=s.frequencies_hz,
                y=speeds,
                label=f"{label}: {numbers.number(way, 4, 'm')}",
                style="line" if k == 0 else "dashed",
                group=k,
            )
            for k, (way, speeds, label) in enumerate(ways)
        ]
        title = f"{s.amplitude_deg:g} deg"
        panels.append(blocks.panel("frequency (Hz)", "mean speed (m/s)", traces, title=title))
    caption = (
        f"One run through all frequencies, {file.duration_s:g} s each: with the stiffness following the "
        "rule, and with the best, the middle and the worst of the fixed ones; the way each makes."
    )
    return blocks.panels("sweep", "A frequency sweep with the rule", caption, panels, columns=1)


def _methods(file: RuleFile) -> list[str]:
    first, second = (name.replace("_", " ") for name in file.objectives)
    settings = file.provenance.get("settings", {})
    return [
        f"At {len(file.optima)} points of frequency and amplitude the Pareto front of {first} and {second} "
        f"over {file.coefficient} was searched by NSGA-II (Deb et al. 2002, as implemented in pymoo; "
        f"population {settings.get('population')}, {settings.get('generations')} generations, seed "
        f"{settings.get('seed')}); each run of {file.duration_s:g} s began at rest. The chosen values were "
        "fitted by a quadratic function of the frequency for each amplitude.",
        *(
            [
                f"Optima were looked for anew, and the functions fitted anew, in {file.draws} draws of the "
                "coefficients from their covariance; intervals are percentiles of these."
            ]
            if file.draws
            else []
        ),
    ]
