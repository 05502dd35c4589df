"""Tables and figures of ``swimid compare``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from swimid.fitting.body import Body
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Array
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.simulation import compare_strokes_evidence
from swimid.simulation.compare_series import Compared, Pair
from swimid.simulation.comparison_file import ChannelScore, ComparisonFile, CycleTable, TrialComparison

#: Trials drawn one by one.
MAX_TRIALS = 8
#: Channels drawn for each of them.
MAX_PANELS = 4
#: A setting with more values than this, and than half the trials, is no axis.
MOST_LEVELS = 12
#: What a mean speed is drawn over, by how many values of it were driven.
AXES = {
    "frequency_hz": "frequency (Hz)",
    "amplitude_deg": "amplitude (°)",
    "bias_deg": "bias (°)",
    "asymmetry": "asymmetry",
}


def tables(file: ComparisonFile) -> list[ev.Table]:
    """Errors of every trial, mean speeds, and every stroke."""
    found = [_scores(file)]
    if any(t.mean_speed is not None for t in file.trials):
        found.append(_speeds(file))
    if any(t.cycles for t in file.trials):
        found.append(_cycles(file))
    return found


def _degrees(value: float | None, unit: str) -> tuple[float | None, str]:
    """An angle as people read it."""
    if unit in ("rad", "rad/s"):
        return None if value is None else math.degrees(value), f"deg{unit[3:]}"
    return value, unit


def _text(value: float | None, unit: str) -> str:
    shown, its = _degrees(value, unit)
    return numbers.number(shown, 3, its)


def settled(s: ChannelScore) -> float | None:
    """The bias, or zero where a fitted start has left nothing of it."""
    if s.bias is not None and s.rmse is not None and abs(s.bias) < 1e-3 * s.rmse:
        return 0.0
    return s.bias


def _scores(file: ComparisonFile) -> ev.Table:
    rows: list[list[str | float | int | bool | None]] = []
    for t in file.trials:
        for name, s in t.channels.items():
            rows.append(
                [
                    t.id,
                    "held out" if t.role == "validate" else "fit",
                    name + (" (from pose)" if s.source == "pose" else ""),
                    _text(s.rmse, s.unit),
                    numbers.percent(s.nrmse),
                    numbers.percent(s.vaf),
                    numbers.number(s.fit_percent, 3, "percent"),
                    _text(settled(s), s.unit),
                    _text(s.peak_error, s.unit),
                    numbers.percent(s.peak_error_normalised),
                    _text(s.phase_error_rad, "rad"),
                    _text(s.dtw_distance, s.unit),
                ]
            )
    columns = ["trial", "role", "channel", "RMSE", "NRMSE", "VAF", "fit", "bias", "peak error", "of peak"]
    columns += ["phase", "DTW"]
    # without a beat there is neither phase nor time warping
    kept = [k for k in range(len(columns)) if k < 3 or any(row[k] != numbers.NOTHING for row in rows)]
    rows = [[row[k] for k in kept] for row in rows]
    return ev.Table(
        id="scores",
        title="Errors of every trial",
        columns=[columns[k] for k in kept],
        rows=rows,
        caption="RMSE and its share of the measured range (E_V and its normalised value, tendon fish, "
        "Eq 13); variance accounted for; fit as MATLAB's compare prints it; mean of measured minus "
        "simulated; difference of the largest magnitudes and its share of the measured one (Eq 14); phase "
        "of the simulation ahead of the measurement at the beat; error left when time may be stretched "
        "within a quarter of a beat.",
    )


def _speeds(file: ComparisonFile) -> ev.Table:
    rows: list[list[str | float | int | bool | None]] = []
    for t in file.trials:
        if t.mean_speed is None or t.mean_speed.measured is None or t.mean_speed.simulated is None:
            continue
        measured, simulated = t.mean_speed.measured, t.mean_speed.simulated
        rows.append(
            [
                t.id,
                *(numbers.number(t.drive.get(key), 4) if t.drive else numbers.NOTHING for key in AXES),
                numbers.number(measured, 3, "m/s"),
                numbers.number(simulated, 3, "m/s"),
                numbers.number(simulated - measured, 2, "m/s"),
                numbers.percent((simulated - measured) / measured if measured else None, 2),
            ]
        )
    return ev.Table(
        id="speeds",
        title="Mean speed of the last beats",
        columns=["trial", *AXES.values(), "measured", "simulated", "difference", "of measured"],
        rows=rows,
        caption="Path length between the mean positions of successive beats over time, or mean surge where "
        "no position is logged; over the last four whole beats. Root-mean-square difference: "
        f"{numbers.number(file.mean_speed_rmse_m_s, 3, 'm/s')}.",
    )


def _cycles(file: ComparisonFile) -> ev.Table:
    rows: list[list[str | float | int | bool | None]] = []
    for t in file.trials:
        for name in _rates(t):
            c = t.cycles[name]
            unit = t.channels[name].unit
            for k, time in enumerate(c.time_s):
                values = (c.mean_measured[k], c.mean_simulated[k], c.peak_measured[k], c.peak_simulated[k])
                rows.append([t.id, name, time, *(_text(v, unit) for v in values)])
    return ev.Table(
        id="cycles",
        title="Every stroke",
        columns=[
            "trial",
            "channel",
            "time (s)",
            "mean, measured",
            "mean, simulated",
            "peak, measured",
            "peak, simulated",
        ],
        rows=rows,
        caption="Mean and largest magnitude within each whole stroke.",
    )


def _rates(t: TrialComparison) -> list[str]:
    """Channels worth a stroke-by-stroke look: surge and turning rate, else what there is."""
    wanted = [n for n in t.cycles if n == "u_m_s" or n.endswith(("yaw_rate_rad_s", "pitch_rate_rad_s"))]
    return wanted or list(t.cycles)[:2]


# ------------------------------------------------------------ figures


def figures(experiment: Experiment, done: Sequence[Compared], file: ComparisonFile) -> list[ev.Figure]:
    """Overlays, mean speeds by setting, strokes, phases and paths."""
    shown = _spread(done)
    missing = "" if len(shown) == len(done) else f" {len(shown)} of {len(done)} trials are shown."
    speeds = _speed_figure(file)
    found = [speeds] if speeds else []
    draw = _runs if experiment.model.timed_runs else _overlay
    found += [draw(experiment, d, missing) for d in shown if d.pairs]
    model = experiment.model
    if model.body is not None:
        found += _paths(model.body, shown, missing)
        found += _stroke_figures(file, missing)
    return found


T = TypeVar("T")


def _spread(members: Sequence[T]) -> list[T]:
    """At most :data:`MAX_TRIALS` of them, from the first to the last."""
    index = np.unique(np.linspace(0, len(members) - 1, MAX_TRIALS).round().astype(int))
    return [members[i] for i in index if i >= 0] if members else []


def _runs(experiment: Experiment, done: Compared, missing: str) -> ev.Figure:
    """Runs of a cruise table over frequency, one pair of curves for each amplitude."""
    (p,) = done.pairs.values()
    frequency = done.trial.inputs["frequency_hz"]
    amplitude = np.round(np.degrees(done.trial.inputs["amplitude_rad"]), 6)
    traces = []
    for k, a in enumerate(np.unique(amplitude)):
        mine = np.flatnonzero(amplitude == a)
        mine = mine[np.argsort(frequency[mine])]
        label = _setting("amplitude_deg", float(a))
        x = frequency[mine]
        traces.append(ev.Trace(x=x, y=p.measured[mine], style="points", label=f"measured, {label}", group=k))
        traces.append(ev.Trace(x=x, y=p.simulated[mine], label=f"simulated, {label}", group=k))
    return ev.Figure(
        id=f"overlay-{done.trial.id}",
        title=f"{done.trial.id}: measured and simulated",
        caption=f"Points are measured, lines simulated. Good: the lines run through the points.{missing}",
        panels=[ev.Panel(x_label="frequency (Hz)", y_label=f"{p.meaning} (m/s)", traces=traces)],
    )


def _overlay(experiment: Experiment, done: Compared, missing: str) -> ev.Figure:
    pairs = _most_telling(done)
    panels = []
    for p in pairs:
        factor, unit = _degrees(1.0, p.unit)
        scale = factor or 1.0
        traces = []
        style: tuple[tuple[str, Array, str], ...] = (
            ("measured", p.measured, "points"),
            ("simulated", p.simulated, "line"),
        )
        for k, (label, values, how) in enumerate(style):
            x, y = ev.thinned(p.time_s, scale * values, 800)
            traces.append(ev.Trace(x=x, y=y, style=how, label=label, group=k))  # type: ignore[arg-type]
        note = ", from the pose" if p.source == "pose" else ""
        label = f"{p.meaning or p.channel}{note} ({numbers.unit_text(unit) or '1'})"
        panels.append(ev.Panel(x_label=experiment.model.abscissa, y_label=label, traces=traces))
    said = ", ".join(_setting(k, v) for k, v in done.drive.items() if k in AXES and v)
    return ev.Figure(
        id=f"overlay-{done.trial.id}",
        title=f"{done.trial.id}: measured and simulated",
        caption=f"{said + '. ' if said else ''}Good: the line runs through the points, from the start "
        f"on.{missing}",
        panels=panels,
    )


def _setting(key: str, value: float) -> str:
    """One number of a drive in words: ``amplitude 20°``."""
    name = AXES[key].split(" (")[0]
    unit = numbers.split_unit(key)[1]
    return f"{name} {numbers.number(value, 4, unit)}"


def _most_telling(done: Compared) -> list[Pair]:
    """Surge and turning rate first, then passive joints, then the rest."""

    def rank(name: str) -> int:
        if name == "u_m_s":
            return 0
        if name.endswith(("yaw_rate_rad_s", "pitch_rate_rad_s")):
            return 1
        return 2 if name.startswith("joint") and not name.endswith("_rate_rad_s") else 3

    names = sorted(done.pairs, key=rank)
    if any(rank(n) < 2 for n in names):
        names = [n for n in names if rank(n) < 3] or names
    return [done.pairs[n] for n in names[:MAX_PANELS]]


def _speed_figure(file: ComparisonFile) -> ev.Figure | None:
    """Mean speed over what was driven, one pair of curves for each setting of the rest."""
    known = [
        t
        for t in file.trials
        if t.drive and t.mean_speed and None not in (t.mean_speed.measured, t.mean_speed.simulated)
    ]
    counts = {key: len({t.drive.get(key) for t in known}) for key in AXES}
    # a setting that hardly any two trials share was measured, not set: it is no axis
    varied = [key for key in AXES if 1 < counts[key] <= max(MOST_LEVELS, len(known) // 2)]
    if not varied:
        return None
    axis = max(varied, key=lambda key: counts[key])
    others = [key for key in varied if key != axis]
    groups: dict[tuple[float, ...], list[TrialComparison]] = {}
    for t in known:
        groups.setdefault(tuple(float(t.drive.get(key, 0.0)) for key in others), []).append(t)
    traces = []
    for k, (setting, members) in enumerate(sorted(groups.items())):
        members.sort(key=lambda t: float(t.drive[axis]))
        x = [float(t.drive[axis]) for t in members]
        label = ", ".join(_setting(o, v) for o, v in zip(others, setting, strict=True))
        measured = [t.mean_speed.measured for t in members if t.mean_speed]
        tail = f", {label}" if label else ""
        traces.append(ev.Trace(x=x, y=measured, style="points", label=f"measured{tail}", group=k))
        # repeats of one setting make one point of the line
        levels = sorted(set(x))
        means = [
            float(np.mean([t.mean_speed.simulated for t in members if t.drive[axis] == v and t.mean_speed]))
            for v in levels
        ]
        traces.append(ev.Trace(x=levels, y=means, style="line", label=f"simulated{tail}", group=k))
    return ev.Figure(
        id="speeds",
        title=f"Mean speed over {AXES[axis].split(' (')[0]}",
        caption="Points are measured, lines simulated. Root-mean-square difference "
        f"{numbers.number(file.mean_speed_rmse_m_s, 3, 'm/s')}. Good: the lines follow the points.",
        panels=[ev.Panel(x_label=AXES[axis], y_label="mean speed (m/s)", traces=traces)],
    )


def _paths(body: Body, shown: Sequence[Compared], missing: str) -> list[ev.Figure]:
    names = body.pose[:2]
    panels = []
    for d in shown:
        if not body.free or any(n not in d.pairs for n in names):
            continue
        step = max(1, len(d.trial.time_s) // 800)
        x, y = (d.pairs[n] for n in names)
        panels.append(
            ev.Panel(
                title=d.trial.id,
                x_label=numbers.column_title(names[0]),
                y_label=numbers.column_title(names[1]),
                equal_aspect=True,
                traces=[
                    ev.Trace(
                        x=x.measured[::step], y=y.measured[::step], style="points", label="measured", group=0
                    ),
                    ev.Trace(x=x.simulated[::step], y=y.simulated[::step], label="simulated", group=1),
                ],
            )
        )
    if not panels:
        return []
    return [
        ev.Figure(
            id="paths",
            title="Paths",
            caption=f"The reference point's path, to scale. Good: one curve on the other.{missing}",
            panels=panels,
            columns=2 if len(panels) > 1 else 1,
        )
    ]


def _stroke_figures(file: ComparisonFile, missing: str) -> list[ev.Figure]:
    members = _spread([t for t in file.trials if t.cycles])
    names = list(dict.fromkeys(n for t in members for n in _rates(t)))
    if not names:
        return []
    means, bins = [], []
    for name in names:
        unit = next(t.channels[name].unit for t in members if name in t.channels)
        factor, shown = _degrees(1.0, unit)
        scale, label = factor or 1.0, f"{numbers.column_title(name).split(' (')[0]}"
        y_label = f"{label} ({numbers.unit_text(shown) or '1'})"
        traces, left = [], []
        for k, t in enumerate(t for t in members if name in t.cycles):
            c, p = t.cycles[name], t.phases[name]
            for values, how in _sides(c):
                y = scale * np.array(values, dtype=float)
                traces.append(
                    ev.Trace(x=c.time_s, y=y, style=how, label=t.id if how == "points" else "", group=k)  # type: ignore[arg-type]
                )
            residual, error = (scale * np.array(v, dtype=float) for v in (p.residual, p.stderr))
            left.append(
                ev.Trace(
                    x=np.degrees(np.array(p.phase_rad, dtype=float)),
                    y=residual,
                    lower=residual - 2 * error,
                    upper=residual + 2 * error,
                    label=t.id,
                    group=k,
                )
            )
        means.append(ev.Panel(x_label="time (s)", y_label=f"mean {y_label}", traces=traces))
        bins.append(
            ev.Panel(
                x_label="phase of the beat (°)",
                y_label=f"residual, {y_label}",
                traces=left,
                marks=[ev.Mark(at=0.0)],
            )
        )
    return [
        ev.Figure(
            id="cycles",
            title="Stroke by stroke",
            caption="Means over each whole stroke: points measured, lines simulated. Good: the same "
            f"start-up and the same steady level.{missing}",
            panels=means,
        ),
        ev.Figure(
            id="phases",
            title="Over the phase of the beat",
            caption="Mean of measured minus simulated in twelve parts of the beat, with twice its standard "
            "error between strokes; zero is where the command starts. Good: flat about zero. A wave says in "
            f"which part of the stroke the model lacks something.{missing}",
            panels=bins,
        ),
    ]


def _sides(c: CycleTable) -> list[tuple[list[float | None], str]]:
    return [(c.mean_measured, "points"), (c.mean_simulated, "line")]


def summary(file: ComparisonFile, evidence: ev.Evidence) -> str:
    """Plain text for the terminal."""
    lines = [f"{file.robot}, {file.experiment}: {len(file.trials)} trials against {file.params}", ""]
    width = max(len(n) for n in file.channels)
    lines.append(f"  {'':<{width}}  {'RMSE':>14}  {'NRMSE':>8}  {'VAF':>8}  {'fit':>8}  {'bias':>14}")
    for name, s in file.channels.items():
        lines.append(
            f"  {name:<{width}}  {numbers.number(s.rmse, 3, s.unit):>14}  {numbers.percent(s.nrmse):>8}  "
            f"{numbers.percent(s.vaf):>8}  {numbers.number(s.fit_percent, 3):>6} %  "
            f"{numbers.number(settled(s), 3, s.unit):>14}"
        )
    speeds = [(t.id, t.mean_speed) for t in file.trials if t.mean_speed is not None]
    if speeds:
        wide = max(len(i) for i, _ in speeds)
        lines += ["", "  mean speed of the last beats, measured and simulated"]
        for name, speed in speeds:
            pair = [numbers.number(v, 3, "m/s") for v in (speed.measured, speed.simulated)]
            lines.append(f"  {name:<{wide}}  {pair[0]:>12}  {pair[1]:>12}")
    lines += compare_strokes_evidence.summary(file.profiles)
    estimated = sum(t.start == "estimated" for t in file.trials)
    if estimated:
        lines += ["", f"  start states estimated for {estimated} of {len(file.trials)} trials"]
    lines += ["", f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}"]
    return "\n".join(lines)
