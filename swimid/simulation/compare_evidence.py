"""Checks, tables, figures and sentences of ``swimid compare``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

import numpy as np

from swimid.fitting import metrics
from swimid.fitting.experiment import Experiment
from swimid.fitting.metrics import GOOD_SPEED, USABLE_SPEED
from swimid.fitting.model import Array
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.simulation import compare_series, compare_strokes_evidence
from swimid.simulation.compare_series import Compared, Pair
from swimid.simulation.comparison_file import ChannelScore, ComparisonFile, TrialComparison
from swimid.swimmer.planar.body import Body

#: Trials drawn one by one.
MAX_TRIALS = 8
#: Channels drawn for each of them, and samples of each.
MAX_PANELS, MAX_SAMPLES = 4, 800
#: A setting with more values than this, and than half the trials, is no axis.
MOST_LEVELS = 12
#: What a mean speed is drawn over, by how many values of it were driven.
AXES = {
    "frequency_hz": "frequency (Hz)",
    "amplitude_deg": "amplitude (°)",
    "bias_deg": "bias (°)",
    "asymmetry": "asymmetry",
}
T = TypeVar("T")


# ------------------------------------------------------------ verdict


def checks(file: ComparisonFile, fitted: Iterable[str]) -> list[ev.Check]:
    """Checks of errors and speeds against their limits, and which start states were estimated.

    Parameters
    ----------
    fitted : iterable of str
        Channels that the parameters were fitted to.
    """
    graded = metrics.error_checks(file.channels, fitted=fitted)
    share = _speed_share(file)
    if share is not None:
        what = "root-mean-square difference over the trials, over the root mean square measured"
        graded.append(
            metrics.share_check("error of mean speeds", share, GOOD_SPEED, USABLE_SPEED, "measured", what)
        )
    graded += _cruise_checks(file)
    own = [t.id for t in file.trials if t.start == "estimated"]
    if own:
        what = (
            "from the trials themselves, all shared parameters held: offsets of pose and start speed do not "
            "count as errors (--no-refit-start)"
        )
        value = f"estimated for {len(own)} of {len(file.trials)} trials"
        graded.append(ev.check("start states", value, None, text=what))
    return graded


def _cruise_checks(file: ComparisonFile) -> list[ev.Check]:
    """Checks of the speed at which the model settles, where trials begin in motion."""
    begun = [(t, t.cruise) for t in file.trials if t.cruise is not None]
    if not begun:
        return []
    never = [t.id for t, cruise in begun if cruise.settled is None]
    if never:
        text = (
            f"under the drive of {', '.join(never)} the speed of the model never settles: without drag, "
            "nothing slows it down. The simulated speed is the start speed, which comes from the trial itself"
        )
        return [blocks.check("cruising speed", "none", "a steady speed", False, otherwise="fail", text=text)]
    rows = [
        (t.mean_speed.measured, cruise.settled)
        for t, cruise in begun
        if cruise.steady and t.mean_speed is not None and t.mean_speed.measured and cruise.settled is not None
    ]
    text = (
        "the start speeds of these trials come from the trials themselves; the speed at which the model "
        "settles is compared with the measured speed of the last beats"
    )
    if not rows:
        text += ", but that is not steady in any of them"
        return [blocks.check("cruising speed", "not tested", "steady swimming in a trial", False, text=text)]
    measured, settles = np.array(rows).T
    share = float(np.sqrt(np.mean((measured - settles) ** 2) / np.mean(measured**2)))
    return [metrics.share_check("cruising speed", share, GOOD_SPEED, USABLE_SPEED, "measured", text)]


def _speed_share(file: ComparisonFile) -> float | None:
    """Error of the mean speeds over their size."""
    measured = [speed for _, speed, _ in file.mean_speeds]
    size = float(np.sqrt(np.mean(np.square(measured)))) if measured else 0.0
    return file.mean_speed_rmse_m_s / size if file.mean_speed_rmse_m_s is not None and size > 0 else None


def answer(file: ComparisonFile) -> str:
    """Errors of the velocities, else of the first channels, as a sentence."""
    parts = []
    for name in _rates(file.channels) or list(file.channels)[:3]:
        s = file.channels[name]
        parts.append(
            f"{name}: RMSE {numbers.number(s.rmse, 3, s.unit)} ({numbers.percent(s.nrmse)} of its range), "
            f"VAF {numbers.percent(s.vaf)}"
        )
    if file.mean_speed_rmse_m_s is not None:
        parts.append(f"mean speeds: RMSE {numbers.number(file.mean_speed_rmse_m_s, 3, 'm/s')}")
    return "; ".join(parts) + "."


def _rates(names: Iterable[str]) -> list[str]:
    """Surge, and turning rate."""
    return [n for n in names if n == "u_m_s" or n.endswith(("yaw_rate_rad_s", "pitch_rate_rad_s"))]


def methods(file: ComparisonFile) -> list[str]:
    """Sentences for a paper."""
    sentences = [
        f"{len(file.trials)} {file.experiment} trials were compared with simulations under the parameters of "
        f"{file.params}. NRMSE is the root-mean-square error over the measured range (tendon fish, Eq 13), "
        "the peak error the difference of the largest magnitudes (Eq 14), VAF the variance accounted for."
    ]
    if any(s.source == "pose" for t in file.trials for s in t.channels.values()):
        sentences.append(
            "Surge, sway and turning rate were derived from the measured pose and, in the same way, from "
            "the simulated one, by a cubic fitted over "
            f"{2 * compare_series.WINDOW_BEATS:g} beats around each sample."
        )
    if any(t.start == "estimated" for t in file.trials):
        sentences.append(
            "Where the parameter file held no start state of a trial it was estimated from the whole trial "
            "with all shared parameters held."
        )
    return sentences


# ------------------------------------------------------------ tables


def tables(file: ComparisonFile) -> list[ev.Table]:
    """Errors of every trial, mean speeds, and every stroke."""
    return [_scores(file), *_speeds(file), *_cycles(file)]


def _text(value: float | None, unit: str) -> str:
    """A number as people read it: angles in degrees."""
    factor, shown = numbers.in_degrees(unit)
    return numbers.number(None if value is None else factor * value, 3, shown)


def settled(s: ChannelScore) -> float | None:
    """The bias, or zero where a fitted start has left nothing of it but rounding errors."""
    if s.bias is not None and s.rmse is not None and abs(s.bias) < 1e-3 * s.rmse:
        return 0.0
    return s.bias


def _scores(file: ComparisonFile) -> ev.Table:
    rows = [
        {
            "trial": t.id,
            "role": "held out" if t.role == "validate" else "fit",
            "channel": name + (" (from pose)" if s.source == "pose" else ""),
            "RMSE": _text(s.rmse, s.unit),
            "NRMSE": numbers.percent(s.nrmse),
            "VAF": numbers.percent(s.vaf),
            "fit": numbers.number(s.fit_percent, 3, "percent"),
            "bias": _text(settled(s), s.unit),
            "peak error": _text(s.peak_error, s.unit),
            "of peak": numbers.percent(s.peak_error_normalised),
            "phase": _text(s.phase_error_rad, "rad"),
            "DTW": _text(s.dtw_distance, s.unit),
        }
        for t in file.trials
        for name, s in t.channels.items()
    ]
    # without a beat there is neither phase nor time warping
    kept = [c for k, c in enumerate(rows[0]) if k < 3 or any(row[c] != numbers.NOTHING for row in rows)]
    caption = (
        "RMSE and its share of the measured range (E_V and its normalised value, tendon fish, "
        "Eq 13); variance accounted for; fit as MATLAB's compare prints it; mean of measured minus "
        "simulated; difference of the largest magnitudes and its share of the measured one (Eq 14); phase "
        "of the simulation ahead of the measurement at the beat; error left when time may be stretched "
        "within a quarter of a beat."
    )
    return blocks.table("scores", "Errors of every trial", rows, caption, kept)


def _speeds(file: ComparisonFile) -> list[ev.Table]:
    rows = [
        {
            "trial": t.id,
            **{title: numbers.number(t.drive.get(key), 4) for key, title in AXES.items()},
            "measured": numbers.number(measured, 3, "m/s"),
            "simulated": numbers.number(simulated, 3, "m/s"),
            "difference": numbers.number(simulated - measured, 2, "m/s"),
            "of measured": numbers.percent((simulated - measured) / measured if measured else None, 2),
        }
        for t, measured, simulated in file.mean_speeds
    ]
    caption = (
        "Path length between the mean positions of successive beats over time, or mean surge where "
        "no position is logged; over the last four whole beats. Root-mean-square difference: "
        f"{numbers.number(file.mean_speed_rmse_m_s, 3, 'm/s')}."
    )
    return [blocks.table("speeds", "Mean speed of the last beats", rows, caption)] if rows else []


def _cycles(file: ComparisonFile) -> list[ev.Table]:
    rows: list[dict[str, blocks.Cell]] = []
    for t in file.trials:
        for name in _by_stroke(t):
            c = t.cycles[name]
            kinds = {
                "mean, measured": c.mean_measured,
                "mean, simulated": c.mean_simulated,
                "peak, measured": c.peak_measured,
                "peak, simulated": c.peak_simulated,
            }
            for k, time in enumerate(c.time_s):
                texts = {kind: _text(values[k], t.channels[name].unit) for kind, values in kinds.items()}
                rows.append({"trial": t.id, "channel": name, "time (s)": time, **texts})
    caption = "Mean and largest magnitude within each whole stroke."
    return [blocks.table("cycles", "Every stroke", rows, caption)] if rows else []


def _by_stroke(t: TrialComparison) -> list[str]:
    """Channels worth a stroke-by-stroke look: surge and turning rate, else what there is."""
    return _rates(t.cycles) or list(t.cycles)[:2]


# ------------------------------------------------------------ figures


def figures(experiment: Experiment, done: Sequence[Compared], file: ComparisonFile) -> list[ev.Figure]:
    """Overlays, mean speeds by setting, strokes, phases and paths."""
    shown = _spread(done)
    missing = "" if len(shown) == len(done) else f" {len(shown)} of {len(done)} trials are shown."
    draw = _runs if experiment.model.timed_runs else _overlay
    figures = [*_speed_figure(file), *(draw(experiment, d, missing) for d in shown if d.pairs)]
    body = experiment.model.body
    if body is not None:
        figures += [*_paths(body, shown, missing), *_stroke_figures(file, missing)]
    return figures


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
    return blocks.figure(
        f"overlay-{done.trial.id}",
        f"{done.trial.id}: measured and simulated",
        f"Points are measured, lines simulated. Good: the lines run through the points.{missing}",
        "frequency (Hz)",
        f"{p.channel.meaning} (m/s)",
        traces,
    )


def _overlay(experiment: Experiment, done: Compared, missing: str) -> ev.Figure:
    panels = []
    for p in _most_telling(done):
        factor, unit = numbers.in_degrees(p.channel.unit)
        x, y = ev.thinned(p.time_s, factor * p.measured, MAX_SAMPLES)
        measured = ev.Trace(x=x, y=y, style="points", label="measured", group=0)
        x, y = ev.thinned(p.time_s, factor * p.simulated, MAX_SAMPLES)
        simulated = ev.Trace(x=x, y=y, label="simulated", group=1)
        note = ", from the pose" if p.source == "pose" else ""
        label = f"{p.channel.meaning or p.channel.name}{note} ({numbers.unit_text(unit) or '1'})"
        traces = [measured, simulated]
        panels.append(blocks.panel(experiment.model.abscissa, label, traces))
    drive = ", ".join(_setting(k, v) for k, v in done.record.drive.items() if k in AXES and v)
    return blocks.panels(
        f"overlay-{done.trial.id}",
        f"{done.trial.id}: measured and simulated",
        f"{drive + '. ' if drive else ''}Good: the line runs through the points, from the start on.{missing}",
        panels,
        columns=1,
    )


def _setting(key: str, value: float) -> str:
    """One number of a drive in words: ``amplitude 20°``."""
    return f"{AXES[key].split(' (')[0]} {numbers.number(value, 4, numbers.split_unit(key)[1])}"


def _most_telling(done: Compared) -> list[Pair]:
    """Surge and turning rate first, then passive joints, then the rest."""

    def rank(name: str) -> int:
        if _rates([name]):
            return 0 if name == "u_m_s" else 1
        return 2 if name.startswith("joint") and not name.endswith("_rate_rad_s") else 3

    names = sorted(done.pairs, key=rank)
    if any(rank(n) < 2 for n in names):
        names = [n for n in names if rank(n) < 3] or names
    return [done.pairs[n] for n in names[:MAX_PANELS]]


def _speed_figure(file: ComparisonFile) -> list[ev.Figure]:
    """Mean speed over what was driven, one pair of curves for each setting of the rest."""
    known = [row for row in file.mean_speeds if row[0].drive]
    counts = {key: len({t.drive.get(key) for t, _, _ in known}) for key in AXES}
    # a setting that hardly any two trials share was measured, not set: it is no axis
    varied = [key for key in AXES if 1 < counts[key] <= max(MOST_LEVELS, len(known) // 2)]
    if not varied:
        return []
    axis = max(varied, key=lambda key: counts[key])
    others = [key for key in varied if key != axis]
    groups: dict[tuple[float, ...], list[tuple[float, float, float]]] = {}
    for t, measured, simulated in known:
        setting = tuple(float(t.drive.get(key, 0.0)) for key in others)
        groups.setdefault(setting, []).append((float(t.drive[axis]), measured, simulated))
    traces = []
    for k, (setting, rows) in enumerate(sorted(groups.items())):
        rows.sort(key=lambda row: row[0])
        tail = "".join(f", {_setting(key, v)}" for key, v in zip(others, setting, strict=True))
        x, y, _ = zip(*rows, strict=True)
        traces.append(ev.Trace(x=x, y=y, style="points", label=f"measured{tail}", group=k))  # type: ignore[arg-type]
        # repeats of one setting make one point of the line
        levels = sorted(set(x))
        means = [float(np.mean([z for at, _, z in rows if at == level])) for level in levels]
        traces.append(ev.Trace(x=levels, y=means, label=f"simulated{tail}", group=k))  # type: ignore[arg-type]
    caption = (
        "Points are measured, lines simulated. Root-mean-square difference "
        f"{numbers.number(file.mean_speed_rmse_m_s, 3, 'm/s')}. Good: the lines follow the points."
    )
    title = f"Mean speed over {AXES[axis].split(' (')[0]}"
    return [blocks.figure("speeds", title, caption, AXES[axis], "mean speed (m/s)", traces)]


def _paths(body: Body, shown: Sequence[Compared], missing: str) -> list[ev.Figure]:
    names = body.pose[:2]
    x_label, y_label = (numbers.column_title(name) for name in names)
    panels = []
    for d in shown:
        if not body.free or any(n not in d.pairs for n in names):
            continue
        step = max(1, len(d.trial.time_s) // MAX_SAMPLES)
        x, y = (d.pairs[n] for n in names)
        measured = ev.Trace(
            x=x.measured[::step], y=y.measured[::step], style="points", label="measured", group=0
        )
        simulated = ev.Trace(x=x.simulated[::step], y=y.simulated[::step], label="simulated", group=1)
        panels.append(
            blocks.panel(x_label, y_label, [measured, simulated], title=d.trial.id, equal_aspect=True)
        )
    if not panels:
        return []
    caption = f"The reference point's path, to scale. Good: one curve on the other.{missing}"
    columns = 2 if len(panels) > 1 else 1
    return [blocks.panels("paths", "Paths", caption, panels, columns=columns)]


def _stroke_figures(file: ComparisonFile, missing: str) -> list[ev.Figure]:
    members = _spread([t for t in file.trials if t.cycles])
    names = list(dict.fromkeys(n for t in members for n in _by_stroke(t)))
    if not names:
        return []
    panels = [_stroke_panels(name, [t for t in members if name in t.cycles]) for name in names]
    return [
        blocks.panels(
            "cycles",
            "Stroke by stroke",
            "Means over each whole stroke: points measured, lines simulated. Good: the same "
            f"start-up and the same steady level.{missing}",
            [means for means, _ in panels],
            columns=1,
        ),
        blocks.panels(
            "phases",
            "Over the phase of the beat",
            "Mean of measured minus simulated in twelve parts of the beat, with twice its standard "
            "error between strokes; zero is where the command starts. Good: flat about zero. A wave says in "
            f"which part of the stroke the model lacks something.{missing}",
            [phases for _, phases in panels],
            columns=1,
        ),
    ]


def _stroke_panels(name: str, members: Sequence[TrialComparison]) -> tuple[ev.Panel, ev.Panel]:
    """A channel's means over each stroke, and its residual over the phase of the beat."""
    scale, unit = numbers.in_degrees(members[0].channels[name].unit)
    label = f"{numbers.column_title(name).split(' (')[0]} ({numbers.unit_text(unit) or '1'})"

    def scaled(values: Sequence[float | None]) -> Array:
        return scale * np.array(values, dtype=float)

    means, residuals = [], []
    for k, t in enumerate(members):
        c, p = t.cycles[name], t.phases[name]
        means.append(ev.Trace(x=c.time_s, y=scaled(c.mean_measured), style="points", label=t.id, group=k))
        means.append(ev.Trace(x=c.time_s, y=scaled(c.mean_simulated), group=k))
        phase = np.degrees(np.array(p.phase_rad, dtype=float))
        residuals.append(blocks.band(phase, scaled(p.residual), 2 * scaled(p.stderr), label=t.id, group=k))
    return (
        blocks.panel("time (s)", f"mean {label}", means),
        blocks.panel("phase of the beat (°)", f"residual, {label}", residuals, marks=[ev.Mark(at=0.0)]),
    )


def _settles(t: TrialComparison) -> str:
    """Speed at which the model settles, for the terminal; empty where the trial begins at rest."""
    if t.cruise is None:
        return ""
    if t.cruise.settled is None:
        return "  never settles"
    return f"  settles at {numbers.number(t.cruise.settled, 3, 'm/s')}"


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
    if file.mean_speeds:
        lines += ["", "  mean speed of the last beats, measured and simulated"]
        wide = max(len(t.id) for t, _, _ in file.mean_speeds)
        for t, *speeds in file.mean_speeds:
            measured, simulated = (numbers.number(v, 3, "m/s") for v in speeds)
            lines.append(f"  {t.id:<{wide}}  {measured:>12}  {simulated:>12}{_settles(t)}")
    lines += compare_strokes_evidence.summary(file.profiles)
    estimated = sum(t.start == "estimated" for t in file.trials)
    if estimated:
        lines += ["", f"  start states estimated for {estimated} of {len(file.trials)} trials"]
    lines += [line for c in evidence.checks if c.name == "usual mistakes" for line in ("", c.text)]
    lines += ["", f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}"]
    return "\n".join(lines)
