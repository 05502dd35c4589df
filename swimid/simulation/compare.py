"""``compare``: measured trials against their simulation, for every model, and the evidence of that."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.files import atomic, provenance
from swimid.fitting import metrics, mistakes
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Trial
from swimid.logs.trials import TrialSet
from swimid.notices import recorded
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results import parameters as parameters_format
from swimid.results.result import FileResult
from swimid.simulation import cases, catalogue, compare_series, compare_strokes
from swimid.simulation.catalogue import Applied
from swimid.simulation.compare_series import (
    WINDOW_BEATS,
    ChannelScore,
    Compared,
    ComparisonFile,
    ProfileComparison,
)
from swimid.simulation.compare_strokes import SIDES, Mean, Profile
from swimid.simulation.options import CompareOptions
from swimid.swimmer.run_quantities import QUANTITIES

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Comparison(FileResult[ComparisonFile]):
    """Measured trials against their simulation, as ``compare`` gives it.

    Attributes
    ----------
    scores : DataFrame
        A row for each channel of each trial: ``trial``, ``role``, ``channel``, ``unit``, ``rmse``, ``bias``,
        ``peak_error`` (in ``unit``, measured minus simulated), ``nrmse`` (over the measured range), ``vaf``,
        ``fit_percent`` (%), ``phase_error_rad`` (rad) and others.
    file : ComparisonFile
        What :meth:`save` writes; its ``channels`` hold the scores of all trials together.
    """

    file_type = ComparisonFile

    @property
    def scores(self) -> pd.DataFrame:
        """Errors of each channel of each trial: RMSE in the channel's unit, NRMSE, variance accounted for."""
        import pandas as pd

        return pd.DataFrame(
            [
                {"trial": trial.id, "role": trial.role, "channel": channel, **score.model_dump()}
                for trial in self.file.trials
                for channel, score in trial.channels.items()
            ]
        )


@takes(CompareOptions)
def compare(
    trials: str | Path | TrialSet,
    *,
    options: CompareOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Compare recorded trials with their simulation.

    By default every logged channel is compared that the model simulates, and surge, sway and turning rate
    from the pose where they are not logged. A start state that is estimated is estimated from its trial, all
    shared parameters held. Errors on trials that were fitted say how well the model describes them, not how
    well it predicts: for that, compare trials that no fit has seen.

    Parameters
    ----------
    trials : path or TrialSet
        Trials: a file, or what :func:`swimid.load` gives.
    output : Path, optional
        Comparison file to write; its evidence goes beside it.
    progress : Progress
        Shows the trials.

    Returns
    -------
    Comparison
        ``.scores`` has a row for each channel of each trial: ``rmse`` and ``bias`` (in ``unit``, that of the
        channel), ``nrmse`` (over the measured range), ``vaf``, ``fit_percent`` (%), ``peak_error``,
        ``phase_error_rad``. ``.verdict`` is by ``nrmse`` and mean speeds.

    Raises
    ------
    UsageError, InputError
        For bad files and options.
    NoTrustworthyResult
        When a simulation breaks down, or nothing can be compared.

    References
    ----------
    .. [1] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Eqs 13 and 14: errors of speed and turning rate.
    .. [2] S. Kadapa, N. Marcouiller, A. Drago, J. L. Tangorra, H. G. Kwatny, "Tuning hydrodynamic
       coefficients using a genetic algorithm for a numerical model of a bio-robotic sea lion".
       Tables I and II: speeds and angles of each stroke.

    Examples
    --------
    >>> import swimid
    >>> drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> against = compare("sample_logs/rig/trials.yaml", params=drag)
    >>> bool((against.scores["nrmse"] < 0.002).all()), against.verdict
    (True, 'good')
    """
    with recorded(repeat=True) as notices:
        experiment, applied = catalogue.load(trials, options)
        if output is not None:
            atomic.check_writable(output, inputs=experiment.inputs)
        done = []
        with progress("comparing", total=len(experiment.trials)) as step:
            for trial in experiment.trials:
                one = compare_series.compared(
                    experiment, applied, trial, refit=options.refit_start, channels=options.channels
                )
                done.append(one)
                step()
        if not any(d.pairs for d in done):
            raise NoTrustworthyResult("the trials hold no channel that the model simulates")
        buoyancy = options.buoyancy_band_percent / 100.0
        profiles = compare_strokes.profiles(experiment, done, buoyancy=buoyancy)
        file = ComparisonFile(
            verdict="caution",
            model=experiment.model.name,
            robot=experiment.robot.name,
            experiment=experiment.name,
            params=parameters_format.place(options.params).name,
            channels=compare_series.pooled(done, experiment.model),
            trials=[d.record for d in done],
            profiles=[p.record for p in profiles],
            provenance=provenance.collect(
                experiment.inputs, settings=options.settings(buoyancy_band=buoyancy)
            ),
        )
        if file.mean_speeds:
            errors = [measured - simulated for _, measured, simulated in file.mean_speeds]
            file.mean_speed_rmse_m_s = float(np.sqrt(np.mean(np.square(errors))))
        known = applied.file.fit if applied.file is not None else None
        checks = _checks(file, file.channels if known is None else known.channels)
        before = {d.trial.id: d.errors for d in done}
        if options.refit_start and mistakes.is_suspect(checks, before):
            usual = mistakes.catalogue(experiment.model, experiment.trials)
            tried = len(usual) * (len(done) + 1)
            found = _explained(experiment.trials, applied, usual, tried, before)
            checks.append(mistakes.check(found, len(usual)))
    verdict = ev.judged(_answer(file), checks)
    file.verdict = verdict.level
    evidence = ev.Evidence(
        verb="compare",
        title=f"Measured against simulated: {experiment.robot.name}, {experiment.name}",
        verdict=verdict,
        facts=_facts(file),
        checks=checks,
        tables=_tables(file),
        figures=_figures(experiment, done, profiles, file),
        notices=blocks.notices(notices),
        methods=_methods(file, profiles, buoyancy),
        references=list(experiment.robot.sources),
        provenance=file.provenance,
    )
    return Comparison.of(file, evidence).saved(output)


def _explained(
    trials: Sequence[Trial],
    applied: Applied,
    known: Sequence[mistakes.Mistake],
    tried: int,
    before: Mapping[str, mistakes.Errors],
) -> mistakes.Explanation | None:
    """Return a usual mistake that explains the errors, with all shared parameters held."""

    def evaluate(trial: Trial) -> mistakes.Errors:
        values, _, _ = compare_series.start_of(applied, trial, True, mistakes.START_TOLERANCE)
        return mistakes.misfits(trial, applied.model.attempt(values, trial))

    best: mistakes.Explanation | None = None
    for mistake, each in mistakes.screened(trials, known, before, evaluate):
        gained = [k for k, (_, _, gain) in each.items() if gain >= mistakes.DECISIVE]
        after = {k: each[k][1] for k in gained}
        found = mistakes.explained(mistake.says, gained, len(trials), tried, before, after)
        if found is not None and (best is None or found.gain > best.gain):
            best = found
    return best


#: Columns of the errors of a channel.
ERRORS = ("channel", "RMSE", "NRMSE", "VAF", "bias")
#: Settings of a drive that a mean speed is drawn over.
SETTINGS = ("frequency_hz", "amplitude_deg", "bias_deg", "asymmetry")
#: Maximum number of samples of a curve.
MAX_SAMPLES = 400
#: Headings of the quantities of a stroke.
HEADINGS = {
    "max_speed_m_s": "max. speed",
    "mean_speed_m_s": "mean speed",
    "final_pitch_rad": "final pitch",
    "max_pitch_rate_rad_s": "max. rate",
    "mean_pitch_rate_rad_s": "mean rate",
    "surge_m": "surge",
    "heave_m": "heave",
}
#: Tables by stroke: id, title, endings of their quantities, and their place in the sea lion paper.
BY_STROKE = (
    ("cycle-velocity", "Speed in each stroke", ("speed_m_s",), "Table I"),
    ("cycle-angles", "Pitch and pitch rate in each stroke", ("pitch_rad", "pitch_rate_rad_s"), "Table II"),
    ("cycle-way", "Distance made in each stroke", ("surge_m", "heave_m"), "Figs 3 and 5"),
)
#: Channels of the figure of a profile, in the order of the paper.
PROFILE_CHANNELS = ("x_m", "z_m", "speed_m_s", "pitch_rad", "roll_rad", "yaw_rad", "pitch_rate_rad_s")


# ------------------------------------------------------------ verdict


def _checks(file: ComparisonFile, fitted: Iterable[str]) -> list[ev.Check]:
    """Return the checks of errors and speeds against their limits.

    Parameters
    ----------
    fitted : iterable of str
        Channels that the parameters were fitted to.
    """
    graded = metrics.error_checks(file.channels, fitted=fitted)
    share = _speed_share(file)
    if share is not None:
        what = "root-mean-square difference over the trials, over the root mean square measured"
        limits = (metrics.GOOD_SPEED, metrics.USABLE_SPEED)
        graded.append(metrics.share_check("error of mean speeds", share, *limits, "measured", what))
    return graded + _cruise_checks(file)


def _cruise_checks(file: ComparisonFile) -> list[ev.Check]:
    """Return the checks of the speed at which the model settles, where trials begin in motion."""
    begun = [(t, t.cruise) for t in file.trials if t.cruise is not None]
    if not begun:
        return []
    never = ", ".join(t.id for t, cruise in begun if cruise.settled is None)
    if never:
        text = (
            f"under the drive of {never} the speed of the model never settles: without drag, nothing slows "
            "it down. The simulated speed is the start speed, which comes from the trial itself"
        )
        reason = f"the model has no steady speed under the drive of {never}"
        limit = "a steady speed"
        return [ev.check("cruising speed", "none", False, limit, text, otherwise="fail", reason=reason)]
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
        reason = "no trial swims steadily, so the cruising speed of the model is not tested"
        limit = "steady swimming in a trial"
        return [ev.check("cruising speed", "not tested", False, limit, text, reason=reason)]
    measured, settles = np.array(rows).T
    share = float(np.sqrt(np.mean((measured - settles) ** 2) / np.mean(measured**2)))
    limits = (metrics.GOOD_SPEED, metrics.USABLE_SPEED)
    return [metrics.share_check("cruising speed", share, *limits, "measured", text)]


def _speed_share(file: ComparisonFile) -> float | None:
    """Return the error of the mean speeds over their size."""
    measured = [speed for _, speed, _ in file.mean_speeds]
    size = float(np.sqrt(np.mean(np.square(measured)))) if measured else 0.0
    return file.mean_speed_rmse_m_s / size if file.mean_speed_rmse_m_s is not None and size > 0 else None


def _answer(file: ComparisonFile) -> str:
    """Return the errors of the velocities, else of the first channels, and of mean speeds as a sentence."""
    names = _rates(file.channels) or list(file.channels)[:3]
    parts = [
        f"{numbers.percent(file.channels[n].nrmse)} of the range in {numbers.quantity(n)}" for n in names
    ]
    share = _speed_share(file)
    if share is not None:
        parts.append(f"{numbers.percent(share)} of the measured mean speeds")
    return f"The error is {' and '.join(', '.join(parts).rsplit(', ', 1))}."


def _rates(names: Iterable[str]) -> list[str]:
    """Return surge and turning rate among the names of channels."""
    return [n for n in names if n == "u_m_s" or n.endswith(("yaw_rate_rad_s", "pitch_rate_rad_s"))]


def _facts(file: ComparisonFile) -> dict[str, str]:
    """Return the particulars of a comparison."""
    own = sum(t.start == "estimated" for t in file.trials)
    found = {
        "Robot": file.robot,
        "Model": file.model,
        "Experiment": file.experiment,
        "Parameters": file.params,
        "Trials": str(len(file.trials)),
    }
    return {**found, "Start states": f"estimated for {own} of {len(file.trials)} trials"} if own else found


def _methods(file: ComparisonFile, profiles: Sequence[Profile], buoyancy: float) -> list[str]:
    """Return sentences for a paper."""
    sentences = [
        f"{len(file.trials)} {file.experiment} trials were compared with simulations under the parameters of "
        f"{file.params}. NRMSE is the root-mean-square error over the measured range (tendon fish, Eq 13), "
        "the peak error the difference of the largest magnitudes (Eq 14), VAF the variance accounted for."
    ]
    if any(s.source == "pose" for t in file.trials for s in t.channels.values()):
        sentences.append(
            "Surge, sway and turning rate were derived from the measured pose and, in the same way, from the "
            f"simulated one, by a cubic fitted over {2 * WINDOW_BEATS:g} beats around each sample."
        )
    if any(t.start == "estimated" for t in file.trials):
        sentences.append(
            "Where the parameter file held no start state of a trial it was estimated from the whole trial "
            "with all shared parameters held."
        )
    if any(len(p.record.trials) > 1 for p in profiles):
        sentences.append(
            "Trials that repeat a motion were averaged on one clock, and so were their simulations."
        )
    if any(m.band is not None for p in profiles for m in p.means.values()):
        sentences.append(
            f"The band of the simulations is that of {100 * buoyancy:g} % less and more displaced volume, "
            "all else held (sea lion, section III)."
        )
    return sentences


# ------------------------------------------------------------ tables


def _tables(file: ComparisonFile) -> list[ev.Table]:
    """Return errors by channel, motion profiles, mean speeds, and the errors of every trial and stroke."""
    pooled = ev.Table(
        id="channels",
        title="Errors of all trials together",
        columns=[*ERRORS, "samples"],
        rows=[[*_errors(name, s), s.samples] for name, s in file.channels.items()],
        caption="NRMSE is over the measured range; bias is the mean of measured minus simulated.",
    )
    stroked = [p for p in file.profiles if p.cycles]
    found = [
        pooled,
        _profiles(file.profiles),
        *(_by_stroke(stroked, *which) for which in BY_STROKE),
        _speeds(file),
        _scores(file),
        _cycles(file),
    ]
    return [table for table in found if table.rows]


def _text(value: float | None, unit: str, digits: int = 3) -> str:
    """Return a number as people read it: angles in degrees."""
    factor, shown = numbers.in_degrees(unit)
    return numbers.number(None if value is None else factor * value, digits, shown)


def _errors(name: str, s: ChannelScore) -> list[Any]:
    """Return the cells of the columns :data:`ERRORS`."""
    bias = s.bias
    # a fitted start leaves only rounding errors of a bias
    if bias is not None and s.rmse is not None and abs(bias) < 1e-3 * s.rmse:
        bias = 0.0
    channel = name + (" (from pose)" if s.source == "pose" else "")
    shares = [numbers.percent(share) for share in (s.nrmse, s.vaf)]
    return [channel, _text(s.rmse, s.unit), *shares, _text(bias, s.unit)]


def _scores(file: ComparisonFile) -> ev.Table:
    rows: list[list[Any]] = []
    for t in file.trials:
        role = "held out" if t.role == "validate" else "fit"
        for name, s in t.channels.items():
            fit, peak = numbers.number(s.fit_percent, 3, "percent"), numbers.percent(s.peak_error_normalised)
            sizes = ((s.peak_error, s.unit), (s.phase_error_rad, "rad"), (s.dtw_distance, s.unit))
            rows.append([t.id, role, *_errors(name, s), fit, peak, *(_text(*size) for size in sizes)])
    return ev.Table(
        id="scores",
        title="Errors of every trial",
        columns=["trial", "role", *ERRORS, "fit", "of peak", "peak error", "phase", "DTW"],
        rows=rows,
        caption="NRMSE is over the measured range (tendon fish, Eq 13), fit as MATLAB's compare prints it, "
        "the peak error the difference of the largest magnitudes (Eq 14), the phase that of the simulation "
        "ahead of the measurement at the beat, DTW the error left when time may be stretched within a "
        "quarter of a beat.",
        folded=True,
    )


def _speeds(file: ComparisonFile) -> ev.Table:
    rows: list[list[Any]] = []
    for t, measured, simulated in file.mean_speeds:
        settles = ""
        if t.cruise is not None:
            settles = "never" if t.cruise.settled is None else numbers.number(t.cruise.settled, 3, "m/s")
        share = numbers.percent((simulated - measured) / measured if measured else None, 2)
        drive = [numbers.number(t.drive.get(key), 4) for key in SETTINGS]
        rows.append([t.id, *(_text(v, "m/s") for v in (measured, simulated)), share, settles, *drive])
    columns = ["trial", "measured", "simulated", "difference", "model settles at"]
    return ev.Table(
        id="speeds",
        title="Mean speed of the last beats",
        columns=[*columns, *(numbers.column_title(key) for key in SETTINGS)],
        rows=rows,
        caption="Path length between the mean positions of successive beats over time, or mean surge where "
        "no position is logged; over the last four whole beats.",
    )


def _cycles(file: ComparisonFile) -> ev.Table:
    rows: list[list[Any]] = []
    for t in file.trials:
        for name in _rates(t.cycles) or list(t.cycles)[:2]:
            c, unit = t.cycles[name], t.channels[name].unit
            values = (c.mean_measured, c.mean_simulated, c.peak_measured, c.peak_simulated)
            for k, time in enumerate(c.time_s):
                rows.append([t.id, name, time, *(_text(v[k], unit) for v in values)])
    kinds = ["mean, measured", "mean, simulated", "peak, measured", "peak, simulated"]
    return ev.Table(
        id="cycles",
        title="Every stroke",
        columns=["trial", "channel", "time (s)", *kinds],
        rows=rows,
        caption="Mean and largest magnitude within each whole stroke.",
        folded=True,
    )


def _profiles(profiles: Sequence[ProfileComparison]) -> ev.Table:
    rows: list[list[Any]] = []
    for p in profiles:
        ways = [way.get(side) for way in (p.surge_m, p.heave_m) for side in SIDES]
        errors = (_text(p.position_rmse_m, "m"), _text(p.orientation_rmse_rad, "rad"))
        rows.append([p.name, len(p.trials), *(_text(way, "m") for way in ways), *errors])
    sides = [f"{way}, {side}" for way in ("surge", "heave") for side in SIDES]
    return ev.Table(
        id="profiles",
        title="Motion profiles",
        columns=["profile", "trials", *sides, "position RMSE", "orientation RMSE"],
        rows=rows,
        caption="Means of the trials that repeat a motion: distance from the first sample to the last, and "
        "root-mean-square distance of the mean simulated path and angles from the mean measured ones.",
    )


def _by_stroke(
    profiles: Sequence[ProfileComparison], id: str, title: str, endings: tuple[str, ...], source: str
) -> ev.Table:
    names = [name for name in HEADINGS if name.endswith(endings)]
    most = max((len(p.cycles) for p in profiles), default=0)
    rows: list[list[Any]] = []
    for p in profiles:
        for side in SIDES:
            row = [p.name, side]
            for k in range(most):
                for name in names:
                    value, spread = None, None
                    if k < len(p.cycles):
                        value = getattr(p.cycles[k], side).get(name)
                        spread = p.cycles[k].spread.get(name) if side == "measured" else None
                    factor, _ = numbers.in_degrees(QUANTITIES[name])
                    if value is not None and spread:
                        row.append(numbers.measured(factor * value, factor * spread))
                    else:
                        row.append(numbers.number(None if value is None else factor * value, 3))
            rows.append(row)
    units = {name: numbers.unit_text(numbers.in_degrees(QUANTITIES[name])[1]) for name in names}
    headings = [f"{k + 1}: {HEADINGS[name]} ({units[name]})" for k in range(most) for name in names]
    return ev.Table(
        id=id,
        title=title,
        columns=["profile", "", *headings],
        rows=rows,
        caption=f"As {source} of the sea lion paper; of a repeated motion the mean and the standard "
        "deviation of the trials. Largest speeds and rates derived from noisy positions come out too large "
        "by up to a few standard deviations of their noise; those of a smoothed track do not.",
    )


# ------------------------------------------------------------ figures


def _figures(
    experiment: Experiment, done: Sequence[Compared], profiles: Sequence[Profile], file: ComparisonFile
) -> list[ev.Figure]:
    """Return motion profiles, else the time courses, the mean speeds over a setting and the paths."""
    if experiment.model.timed_runs:
        return [_runs(done)]
    drawn = [_profile(p) for p in profiles] or [_overlay(experiment, done), *_speed_figure(file)]
    body = experiment.model.body
    if body is not None and body.free:
        names = body.pose[:2]
        shown = [d for d in _telling(done) if all(n in d.pairs for n in names)]
        paths = [_path(d, *names) for d in shown]
        caption = "Path of the reference point, to scale."
        drawn.append(ev.Figure(id="paths", title="Paths", caption=caption, panels=paths, columns=2))
    return [figure for figure in drawn if figure.panels]


def _telling(done: Sequence[Compared]) -> list[Compared]:
    """Return the trials with the largest and the smallest error, and the worst held-out one."""

    def error(one: Compared) -> float:
        scores = one.record.channels
        return float(np.mean([scores[n].nrmse or 0.0 for n in _rates(scores) or scores]))

    ranked = sorted((d for d in done if d.pairs), key=error, reverse=True)
    held_out = [d for d in ranked if d.trial.role == "validate"]
    picked = {d.trial.id: d for d in (*ranked[:1], *held_out[:1], *ranked[-1:])}
    return list(picked.values())


def _pair(x: Sequence[Any], y: Sequence[Any], tail: str = "", group: int = 0) -> list[ev.Trace]:
    """Return a measured curve as points and the simulated one as a line."""
    measured = ev.Trace(x=x[0], y=y[0], style="points", label=f"measured{tail}", group=group)
    return [measured, ev.Trace(x=x[1], y=y[1], label=f"simulated{tail}", group=group)]


def _overlay(experiment: Experiment, done: Sequence[Compared]) -> ev.Figure:
    panels = []
    for d in _telling(done):
        names = (_rates(d.pairs) or [n for n in d.pairs if n.startswith("joint")] or list(d.pairs))[:2]
        for p in (d.pairs[n] for n in names):
            factor, unit = numbers.in_degrees(p.channel.unit)
            curves = [ev.thinned(p.time_s, factor * y, MAX_SAMPLES) for y in (p.measured, p.simulated)]
            label = f"{p.channel.meaning or p.channel.name} ({numbers.unit_text(unit) or '1'})"
            traces = _pair(*zip(*curves, strict=True))
            title = d.trial.id
            if d.trial.role == "validate":
                title += " (held out)"
            abscissa = experiment.model.abscissa
            panels.append(ev.Panel(x_label=abscissa, y_label=label, traces=traces, title=title))
    caption = "The trials with the largest and the smallest error."
    title = "Measured and simulated"
    return ev.Figure(id="overlay", title=title, caption=caption, panels=panels, columns=2)


def _runs(done: Sequence[Compared]) -> ev.Figure:
    """Return the simulated over the measured values of the runs of a table."""
    traces, largest, label = [], 0.0, ""
    for group, d in enumerate(d for d in done if d.pairs):
        (p,) = d.pairs.values()
        traces.append(ev.Trace(x=p.measured, y=p.simulated, style="points", label=d.trial.id, group=group))
        largest, label = max(largest, float(np.nanmax(p.measured))), f"{p.channel.meaning} (m/s)"
    traces.append(
        ev.Trace(x=[0.0, largest], y=[0.0, largest], style="dashed", label="equal", group=len(done))
    )
    panel = ev.Panel(x_label=f"measured {label}", y_label=f"simulated {label}", traces=traces)
    caption = "Every run of the table; the line is where measured and simulated are equal."
    return ev.Figure(id="overlay", title="Measured and simulated", caption=caption, panels=[panel])


def _path(done: Compared, *names: str) -> ev.Panel:
    step = max(1, len(done.trial.time_s) // MAX_SAMPLES)
    x, y = ((done.pairs[n].measured[::step], done.pairs[n].simulated[::step]) for n in names)
    labels = [numbers.column_title(name) for name in names]
    title = done.trial.id
    return ev.Panel(x_label=labels[0], y_label=labels[1], traces=_pair(x, y), title=title, equal_aspect=True)


def _speed_figure(file: ComparisonFile) -> list[ev.Figure]:
    """Return the mean speed over the setting of the drive with most values, one curve for each other one."""
    known = [row for row in file.mean_speeds if row[0].drive]
    counts = {key: len({t.drive.get(key) for t, _, _ in known}) for key in SETTINGS}
    # a setting that hardly any two trials share was measured, not set: it is no axis
    varied = [key for key in SETTINGS if 1 < counts[key] <= max(12, len(known) // 2)]
    if not varied:
        return []
    axis = max(varied, key=lambda key: counts[key])
    groups: dict[str, list[tuple[float, float, float]]] = {}
    for t, measured, simulated in known:
        settings = {key: t.drive.get(key, 0.0) for key in varied if key != axis}
        tail = "".join(f", {cases.setting(key, value)}" for key, value in settings.items())
        groups.setdefault(tail, []).append((float(t.drive[axis]), measured, simulated))
    # a single value of the setting makes no curve
    curves = [tail for tail, rows in groups.items() if len({row[0] for row in rows}) > 1]
    traces = []
    for group, tail in enumerate(sorted(curves, key=lambda tail: -len(groups[tail]))[:3]):
        x, y, z = np.array(sorted(groups[tail])).T
        levels = np.unique(x)
        # repeats of one setting make one point of the line
        means = np.array([float(np.mean(z[x == level])) for level in levels])
        if len(levels) > 2:
            traces += _pair((x, levels), (y, means), tail, group)
            continue
        measured = [float(np.mean(y[x == level])) for level in levels]
        for k, (word, bars) in enumerate({"measured": measured, "simulated": means}.items()):
            traces.append(
                ev.Trace(x=levels, y=bars, style="bars", label=f"{word}{tail}", group=2 * group + k)
            )
    title = numbers.column_title(axis)
    panels = [ev.Panel(x_label=title, y_label="mean speed (m/s)", traces=traces)] if traces else []
    caption = "Mean speed over the last whole beats of each trial."
    return [ev.Figure(id="speeds", title=f"Mean speed over {title}", caption=caption, panels=panels)]


def _profile(profile: Profile) -> ev.Figure:
    means, record = profile
    caption = "Mean measured and simulated motion."
    if len(record.trials) > 1:
        caption = f"Mean of {len(record.trials)} trials with their standard deviation."
    if any(m.band is not None for m in means.values()):
        caption += " Shaded: simulated with less and with more buoyancy."
    panels = [_mean(means[n]) for n in PROFILE_CHANNELS if n in means and _moves(means[n])]
    return ev.Figure(
        id=f"profile-{record.name}", title=record.name, caption=caption, panels=panels, columns=2
    )


def _moves(mean: Mean) -> bool:
    """Return whether the channel moves: a symmetric stroke has neither roll nor yaw."""
    values = mean.measured[np.isfinite(mean.measured)]
    return bool(len(values)) and float(np.ptp(values)) > 1e-9


def _mean(mean: Mean) -> ev.Panel:
    scale, unit = numbers.in_degrees(mean.channel.unit)
    step = max(len(mean.time_s) // (MAX_SAMPLES // 2), 1)
    time = mean.time_s[::step]
    error = scale * np.nan_to_num(mean.spread[::step]) if np.isfinite(mean.spread).any() else None
    low, high = mean.band or (None, None)
    band = {name: scale * end[::step] for name, end in (("lower", low), ("upper", high)) if end is not None}
    points, line = (scale * series[::step] for series in (mean.measured, mean.simulated))
    traces = [
        ev.Trace(x=time, y=points, style="points", label="measured", group=0, y_error=error),
        ev.Trace(x=time, y=line, label="simulated", group=0, **band),
    ]
    label = f"{mean.channel.meaning} ({numbers.unit_text(unit)})"
    return ev.Panel(x_label="time (s)", y_label=label, traces=traces)
