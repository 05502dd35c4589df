"""Command ``compare``: errors between recorded trials and their simulation, for every model.

Trials in which a robot in 3-D repeats a motion form one motion profile. The mean of their measurements is
compared with the mean of their simulations, over time and for each stroke (sea lion, Tables I and II).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.files import atomic, provenance
from swimid.fitting import fit_common, mistakes
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array, Trial
from swimid.kinematics.cycles import (
    CYCLE_QUANTITIES,
    QUANTITIES,
    cycle_quantities,
    whole_cycles,
    world_velocity,
)
from swimid.logs.sampling import slope
from swimid.logs.trials import TrialSet
from swimid.notices import Progress, record_warnings, silent
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results import parameters as parameters_format
from swimid.results.result import FileResult
from swimid.simulation import catalogue, compare_series
from swimid.simulation.cases import format_quantity
from swimid.simulation.catalogue import Applied
from swimid.simulation.compare_series import SIDES, ChannelScore, Compared, ComparisonFile, CycleComparison
from swimid.simulation.options import CompareOptions

if TYPE_CHECKING:
    import pandas as pd


class Comparison(FileResult[ComparisonFile]):
    """Result of ``compare``: errors between measured trials and their simulation.

    Attributes
    ----------
    scores : DataFrame
        A row for each channel of each trial: ``trial``, ``role``, ``channel``, ``unit``, ``rmse``, ``bias``,
        ``peak_error`` (in ``unit``, measured minus simulated), ``nrmse`` (divided by the measured range),
        ``vaf`` (variance accounted for), ``fit_percent`` (%), ``phase_error_rad`` (rad) and others.
    file : ComparisonFile
        Comparison file that :meth:`save` writes. Its ``channels`` have the scores over all trials together.
    """

    file_type = ComparisonFile

    @property
    def next_step(self) -> str:  # type: ignore[override]
        """Command that usually follows: a report if the verdict is good, and else a diagnosis."""
        if self.verdict == "good":
            return FileResult.next_step
        return "swimid diagnose {trials} --params {params} -o {free[gap.yaml]}{free.repair_option}"

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

    By default, every logged channel that the model simulates is compared. Surge, sway and turning rate are
    derived from the pose if they are not logged. If the parameter file has no start state for a trial, the
    start state is estimated from the trial, with all shared parameters fixed. Errors on fitted trials show
    how well the model describes these trials. To test predictions, compare trials that were not fitted.

    Parameters
    ----------
    trials : path or TrialSet
        Trials file, or the trials that :func:`swimid.load` returns.
    output : Path, optional
        Comparison file to write. The evidence file is written next to it.
    progress : Progress
        Progress over the trials.

    Returns
    -------
    Comparison
        ``.scores`` has a row for each channel of each trial: ``rmse`` and ``bias`` (in the unit of the
        channel, given in ``unit``), ``nrmse`` (divided by the measured range), ``vaf``, ``fit_percent`` (%),
        ``peak_error``, ``phase_error_rad``. ``.verdict`` follows from ``nrmse`` and the mean speeds.

    Raises
    ------
    UsageError, InputError
        If a file or an option is invalid.
    NoTrustworthyResult
        If a simulation diverges, or no channel can be compared.

    Examples
    --------
    >>> import swimid
    >>> drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> against = compare("sample_logs/rig/trials.yaml", params=drag)
    >>> bool((against.scores["nrmse"] < 0.002).all()), against.verdict
    (True, 'good')
    """
    with record_warnings(repeat=True) as notices:
        experiment, applied = catalogue.load(trials, options)
        if output is not None:
            atomic.check_writable(output, inputs=experiment.inputs)
        applied.model.prepare(progress)
        with progress("comparing", total=len(experiment.trials)) as step:
            done, chosen = compare_series.compare_trials(
                applied,
                experiment.trials,
                refit=options.refit_start,
                channels=options.channels,
                advance=step,
            )
        applied = applied.at_step(chosen.model)
        if not any(d.pairs for d in done):
            raise NoTrustworthyResult("the trials hold no channel that the model simulates")
        profiles = _compare_profiles(experiment, done)
        file = _make_file(experiment, done, profiles, options)
        checks = [
            *_channel_checks(file, applied, done),
            *fit_common.step_check([trial.id for trial in experiment.trials], chosen.changes),
        ]
        before = {d.trial.id: d.series for d in done}
        if options.refit_start and mistakes.is_suspect(checks, before):
            checks.append(_mistakes_check(experiment.trials, applied, before))
    evidence = ev.Evidence(
        command="compare",
        title=f"Measured against simulated: {experiment.robot.name}, {experiment.name}",
        verdict=ev.make_verdict(_answer(file), checks),
        facts=_facts(file),
        checks=checks,
        tables=_tables(file),
        figures=_figures(experiment, done, profiles, file),
        notices=list(notices),
        methods=_methods(file),
        references=list(experiment.robot.sources),
        provenance=file.provenance,
    )
    file.verdict = evidence.verdict.level
    return Comparison.of(file, evidence).write_output(output)


def _make_file(
    experiment: Experiment, done: Sequence[Compared], profiles: Sequence[Profile], options: CompareOptions
) -> ComparisonFile:
    """Return the content of the comparison file of compared trials."""
    file = ComparisonFile(
        verdict="caution",
        model=experiment.model.name,
        robot=experiment.robot.name,
        experiment=experiment.name,
        params=parameters_format.source_path(options.params).name,
        channels=compare_series.pool(done, experiment.model),
        trials=[d.record for d in done],
        profiles=[p.record for p in profiles],
        provenance=provenance.collect(experiment.inputs, settings=options.settings()),
    )
    if file.mean_speeds:
        _, measured, simulated = zip(*file.mean_speeds, strict=True)
        file.mean_speed_rmse_m_s = _rms(np.subtract(measured, simulated))
    return file


def _channel_checks(file: ComparisonFile, applied: Applied, done: Sequence[Compared]) -> list[ev.Check]:
    """Return the checks of the errors of channels. A channel without motion is not checked."""
    fitted: Iterable[str] = file.channels
    if applied.file is not None and applied.file.fit is not None:
        fitted = applied.file.fit.channels
    measured = {name: [d.own[name].measured for d in done if name in d.own] for name in file.channels}
    still = [name for name, series in measured.items() if fit_common.is_still(series)]
    return _checks(file, [name for name in fitted if name not in still], still)


def _mistakes_check(trials: Sequence[Trial], applied: Applied, before: mistakes.TrialSeries) -> ev.Check:
    """Check whether a common mistake in trials explains the errors, with shared parameters fixed."""
    known = mistakes.list_mistakes(applied.model, trials)

    def simulate(trial: Trial) -> list[dict[str, Array]]:
        values, _, _ = compare_series.start_of(applied, trial, True, mistakes.SCREEN_START_RTOL)
        return [applied.model.run(values, trial)]

    return mistakes.check_mistakes(mistakes.search(trials, known, before, simulate), len(known))


#: Columns with the errors of a channel in the tables of the evidence.
ERROR_COLUMNS = ("channel", "RMSE", "NRMSE", "VAF", "bias")
#: Settings of the drive that the table of mean speeds shows.
DRIVE_SETTINGS = ("frequency_hz", "amplitude_deg", "bias_deg", "asymmetry")
#: Maximum number of plotted samples of a curve, and of a curve of a motion profile.
MAX_SAMPLES, MAX_PROFILE_SAMPLES = 400, 200
#: Half-width of the window in which a derivative of a motion profile is computed, in cycles of the stroke.
HALF_WIDTH_CYCLES = 0.1
#: Channels of the figure of a motion profile, in the order of the sea lion paper (Kadapa et al.).
FIGURE_CHANNELS = ("x_m", "z_m", "speed_m_s", "pitch_rad", "roll_rad", "yaw_rad", "pitch_rate_rad_s")
#: Minimum bias that is shown, as a fraction of the RMSE. A smaller bias is a rounding error of a fitted start
#: state, and is shown as zero.
MIN_BIAS_SHARE = 1e-3


# ------------------------------------------------------------ motion profiles


class Profile(NamedTuple):
    """Motion profile: trials that repeat one motion, at common sample times.

    The common times are those sample times of the first trial that all trials cover.

    ``channels`` has the values of each channel, each with the shape (trials, 2, n): measured and simulated.
    ``record`` is the entry of the comparison file.
    """

    time_s: Array
    channels: dict[str, Array]
    record: compare_series.ProfileComparison


def _compare_profiles(experiment: Experiment, done: Sequence[Compared]) -> list[Profile]:
    """Return the motion profiles in the trials of a robot in 3-D; an empty list for other robots."""
    if not experiment.model.in_space:
        return []
    groups: dict[str, list[Compared]] = {}
    for one in done:
        if one.pairs:
            groups.setdefault(experiment.facts["profiles"][one.trial.id], []).append(one)
    return [_profile(name, members) for name, members in groups.items()]


def _with_speeds(done: Compared, side: str) -> dict[str, Array]:
    """Return the measured or the simulated channels of a trial, with pitch rate and speed added.

    The speed is the speed in the vertical plane. ``side`` is ``measured`` or ``simulated``.
    """
    stroke, time, half = done.trial.swim.stroke, done.trial.time_s, compare_series.HALF_WIDTH_S
    if stroke is not None:
        half = HALF_WIDTH_CYCLES / stroke.frequency_hz
    columns = {name: getattr(pair, side) for name, pair in done.pairs.items()}
    rates = {"pitch_rate_rad_s": "pitch_rad"}
    if not {"u_m_s", "w_m_s", "pitch_rad"} <= columns.keys():
        rates |= {"vx_m_s": "x_m", "vz_m_s": "z_m"}
    for rate, name in rates.items():
        if name in columns:
            columns.setdefault(rate, slope(time, columns[name], half))
    velocity = world_velocity(time, columns)
    if velocity is not None:
        columns["speed_m_s"] = np.hypot(*velocity)
    return columns


def _profile(name: str, members: Sequence[Compared]) -> Profile:
    """Return the motion profile of repeated trials, with the comparison of their means."""
    times = [done.trial.time_s for done in members]
    begin, end = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
    clock = times[0][(times[0] >= begin - 1e-9) & (times[0] <= end + 1e-9)]
    series = [[_with_speeds(done, side) for side in SIDES] for done in members]
    channels: dict[str, Array] = {}
    for n in series[0][0]:
        if all(n in sides[0] for sides in series):
            pairs = zip(times, series, strict=True)
            channels[n] = np.array([[_resample(clock, t, c[n]) for c in sides] for t, sides in pairs])
    means = {n: values.mean(axis=0) for n, values in channels.items()}
    record = compare_series.ProfileComparison(
        name=name,
        trials=[done.trial.id for done in members],
        cycles=_cycles(members, series),
        position_rmse_m=_distance(means, ("x_m", "y_m", "z_m")),
        orientation_rmse_rad=_distance(means, ("roll_rad", "pitch_rad", "yaw_rad")),
    )
    for n, ways in (("x_m", record.surge_m), ("z_m", record.heave_m)):
        values = means.get(n, np.empty((2, 0)))
        known = values[:, np.isfinite(values).all(axis=0)]
        if known.size:
            ways |= dict(zip(SIDES, (known[:, -1] - known[:, 0]).tolist(), strict=True))
    return Profile(clock, channels, record)


def _resample(clock: Array, time_s: Array, values: Array) -> Array:
    """Return the samples of a channel interpolated at the times ``clock``.

    The result is NaN outside the range of the valid samples.
    """
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(clock), np.nan)
    return np.asarray(np.interp(clock, time_s[known], values[known], left=np.nan, right=np.nan))


def _distance(means: Mapping[str, Array], names: Sequence[str]) -> float | None:
    """Return the root-mean-square distance between mean measured and mean simulated motion.

    The distance is computed from the channels ``names``, each of shape (2, n): measured and simulated values
    at n sample times. Return None if all these channels are missing.
    """
    squares = [np.diff(means[name], axis=0)[0] ** 2 for name in names if name in means]
    total = np.sum(squares, axis=0)
    if not np.isfinite(total).any() or not squares:
        return None
    return float(np.sqrt(np.nanmean(total)))


def _cycles(
    members: Sequence[Compared], series: Sequence[Sequence[Mapping[str, Array]]]
) -> list[CycleComparison]:
    """Return measured and simulated quantities of each whole stroke, averaged over repeated trials."""
    each = []
    for done, sides in zip(members, series, strict=True):
        time, stroke = done.trial.time_s, done.trial.swim.stroke
        windows = [] if stroke is None else whole_cycles(time, stroke.frequency_hz)
        each.append([[cycle_quantities(time, c, window) for c in sides] for window in windows])
    comparisons = []
    for k, repeats in enumerate(zip(*each, strict=False), 1):
        one = CycleComparison(cycle=k, measured={}, simulated={})
        for name in CYCLE_QUANTITIES:
            values = np.array([[side.get(name, np.nan) for side in sides] for sides in repeats])
            if np.isfinite(values).all():
                one.measured[name], one.simulated[name] = values.mean(axis=0).tolist()
                if len(values) > 1:
                    one.spread[name] = float(np.std(values[:, 0], ddof=1))
        comparisons.append(one)
    return comparisons


def _profile_tables(profiles: Sequence[compare_series.ProfileComparison]) -> list[ev.Table]:
    """Return the table of the motion profiles and the table of their strokes."""
    rows: list[list[Any]] = []
    strokes: list[list[Any]] = []
    for p in profiles:
        ways = [way.get(side) for way in (p.surge_m, p.heave_m) for side in SIDES]
        texts = [numbers.format_number(way, 3, "m") for way in (*ways, p.position_rmse_m)]
        rows.append([p.name, len(p.trials), *texts, format_quantity(p.orientation_rmse_rad, "rad")])
        for c in p.cycles:
            for side, known, sd in (("measured", c.measured, c.spread), ("simulated", c.simulated, {})):
                cells = [
                    format_quantity(known.get(n), QUANTITIES[n].unit, sd.get(n)) for n in CYCLE_QUANTITIES
                ]
                strokes.append([p.name, c.cycle, side, *cells])
    sides = [f"{way}, {side}" for way in ("surge", "heave") for side in SIDES]
    names = [numbers.split_unit(name)[0].replace("_", " ") for name in CYCLE_QUANTITIES]
    of_profiles = ev.Table(
        id="profiles",
        title="Motion profiles",
        columns=["profile", "trials", *sides, "position RMSE", "orientation RMSE"],
        rows=rows,
        caption="Means of trials that repeat a motion: displacement from first to last sample, "
        "and root-mean-square distance of mean simulated path and angles from the mean measured ones.",
    )
    of_strokes = ev.Table(
        id="strokes",
        title="Quantities of each stroke",
        columns=["profile", "stroke", "", *names],
        rows=strokes,
        caption="Tables I and II of the sea lion paper; mean and standard deviation of repeated trials. "
        "Maximum speeds and rates derived from noisy positions are too large by up to a few standard "
        "deviations of their noise; those of a smoothed track are not.",
    )
    return [of_profiles, of_strokes]


def _profile_figure(profile: Profile) -> ev.Figure:
    """Return the figure of a motion profile: mean measured and mean simulated channels against time."""
    record, count = profile.record, len(profile.record.trials)
    caption = "Mean measured and simulated motion."
    if count > 1:
        caption = (
            f"Mean of {count} trials on one clock with their standard deviation, and mean of their "
            "simulations."
        )
    keep = slice(None, None, max(len(profile.time_s) // MAX_PROFILE_SAMPLES, 1))
    time, panels = profile.time_s[keep], []
    for name in FIGURE_CHANNELS:
        measured = profile.channels.get(name, np.empty((1, 2, 0)))[:, 0]
        known = measured.mean(axis=0)[np.isfinite(measured).all(axis=0)]
        # leave out channels without motion, such as roll and yaw of a symmetric stroke
        if not len(known) or np.ptp(known) <= 1e-9:
            continue
        values = numbers.in_degrees(numbers.split_unit(name)[1])[0] * profile.channels[name][..., keep]
        error = None
        if count > 1:
            error = np.nan_to_num(np.std(values[:, 0], axis=0, ddof=1))
        traces = ev.pair((time, time), values.mean(axis=0), y_error=error)
        panels.append(ev.Panel(x_label="time (s)", y_label=numbers.column_title(name), traces=traces))
    return ev.Figure(id=f"profile-{record.name}", title=record.name, caption=caption, panels=panels)


# ------------------------------------------------------------ verdict


def _checks(file: ComparisonFile, fitted: Iterable[str], still: Iterable[str]) -> list[ev.Check]:
    """Return the checks of the errors of channels and mean speeds against their limits.

    Parameters
    ----------
    fitted, still : iterable of str
        Fitted channels with motion, and channels without motion.
    """
    graded = fit_common.score_checks(file.channels, fitted=fitted, noise=still)
    share = _speed_share(file)
    if share is not None:
        text = "root-mean-square difference over the trials, over the root mean square measured"
        graded.append(_speed_check("error of mean speeds", share, text))
    return graded + _cruise_checks(file)


def _speed_check(name: str, share: float, text: str) -> ev.Check:
    limits = (fit_common.GOOD_SPEED, fit_common.USABLE_SPEED)
    return fit_common.share_check(name, share, *limits, "measured speeds", text)


def _cruise_checks(file: ComparisonFile) -> list[ev.Check]:
    """Return the checks of the steady speed of the model, for trials that begin in motion."""
    begun = [(t, t.cruise) for t in file.trials if t.cruise is not None]
    if not begun:
        return []
    never = ", ".join(t.id for t, cruise in begun if cruise.settled is None)
    if never:
        text = (
            f"the speed of the model never becomes steady with the gait of {never}, because a model without "
            "drag is not slowed down. Its speed is the start speed, which is taken from the same trial"
        )
        reason = f"the model has no steady speed with the gait of {never}"
        limit = "a steady speed"
        return [ev.make_check("cruising speed", "none", False, limit, text, otherwise="fail", reason=reason)]
    rows = [
        (t.mean_speed.measured, cruise.settled)
        for t, cruise in begun
        if cruise.steady and t.mean_speed is not None and t.mean_speed.measured
    ]
    text = (
        "each simulation starts with a speed taken from its own trial; therefore the steady speed of the "
        "model is compared with the measured speed of the last beats"
    )
    if not rows:
        reason = "no trial swims steadily, so the cruising speed of the model is not tested"
        limit = "steady swimming in a trial"
        return [ev.make_check("cruising speed", "not tested", False, limit, text, reason=reason)]
    measured, settles = np.array(rows, dtype=float).T
    return [_speed_check("cruising speed", _rms(measured - settles) / _rms(measured), text)]


def _speed_share(file: ComparisonFile) -> float | None:
    """Return the RMS error of the mean speeds, divided by the RMS of the measured mean speeds."""
    measured = [speed for _, speed, _ in file.mean_speeds]
    if not any(measured) or file.mean_speed_rmse_m_s is None:
        return None
    return file.mean_speed_rmse_m_s / _rms(measured)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _answer(file: ComparisonFile) -> str:
    """Return the sentence of the verdict, with the errors of velocities and mean speeds.

    Without velocities, the sentence has the errors of the first channels.
    """
    names = _rates(file.channels) or list(file.channels)[:3]
    parts = [
        f"{numbers.percent(file.channels[n].nrmse)} of the range in {numbers.quantity(n)}" for n in names
    ]
    share = _speed_share(file)
    if share is not None:
        parts.append(f"{numbers.percent(share)} of the measured mean speeds")
    return f"The error is {' and '.join(', '.join(parts).rsplit(', ', 1))}."


def _rates(names: Iterable[str]) -> list[str]:
    """Return those of the given channel names that are surge velocities or turning rates."""
    return [n for n in names if n == "u_m_s" or n.endswith(("yaw_rate_rad_s", "pitch_rate_rad_s"))]


def _facts(file: ComparisonFile) -> dict[str, str]:
    facts = {
        "Robot": file.robot,
        "Model": file.model,
        "Experiment": file.experiment,
        "Parameters": file.params,
        "Trials": str(len(file.trials)),
    }
    own = sum(t.start == "estimated" for t in file.trials)
    if own:
        facts["Start states"] = f"estimated for {own} of {len(file.trials)} trials"
    return facts


def _methods(file: ComparisonFile) -> list[str]:
    """Return sentences on the comparison for the methods section of a paper."""
    sentences = [
        f"{len(file.trials)} {file.experiment} trials were compared with simulations under the parameters of "
        f"{file.params}. NRMSE is the root-mean-square error over the measured range (tendon fish, Eq 13), "
        "the peak error the difference of the maximum magnitudes (Eq 14), VAF the variance accounted for."
    ]
    if any(s.source == "pose" for t in file.trials for s in t.channels.values()):
        sentences.append(
            "Surge, sway and turning rate were derived from the measured pose and, in the same way, from the "
            f"simulated one, by a cubic fitted over {2 * compare_series.HALF_WIDTH_BEATS:g} beats around "
            "each sample."
        )
    if any(t.start == "estimated" for t in file.trials):
        sentences.append(
            "If the parameter file had no start state of a trial, it was estimated from the whole trial with "
            "all shared parameters held."
        )
    return sentences


# ------------------------------------------------------------ tables


def _tables(file: ComparisonFile) -> list[ev.Table]:
    """Return tables of errors by channel, motion profiles, mean speeds, and errors by trial."""
    pooled = ev.Table(
        id="channels",
        title="Errors of all trials together",
        columns=[*ERROR_COLUMNS, "samples"],
        rows=[[*_errors(name, s), s.samples] for name, s in file.channels.items()],
        caption="NRMSE is over the measured range; bias is the mean of measured minus simulated.",
    )
    tables = [pooled, *_profile_tables(file.profiles), _speeds(file), _scores(file)]
    return [table for table in tables if table.rows]


def _errors(name: str, s: ChannelScore) -> list[Any]:
    """Return the errors of a channel as the cells of the columns :data:`ERROR_COLUMNS`."""
    bias = s.bias
    if bias is not None and s.rmse is not None and abs(bias) < MIN_BIAS_SHARE * s.rmse:
        bias = 0.0
    channel = name + " (from pose)" * (s.source == "pose")
    shares = [numbers.percent(share) for share in (s.nrmse, s.vaf)]
    return [channel, format_quantity(s.rmse, s.unit), *shares, format_quantity(bias, s.unit)]


def _scores(file: ComparisonFile) -> ev.Table:
    roles = {"fit": "fit", "validate": "held out"}
    rows: list[list[Any]] = []
    for t in file.trials:
        for name, s in t.channels.items():
            fit, peak = (
                numbers.format_number(s.fit_percent, 3, "percent"),
                numbers.percent(s.peak_error_normalised),
            )
            texts = [format_quantity(s.peak_error, s.unit), format_quantity(s.phase_error_rad, "rad")]
            rows.append([t.id, roles[t.role], *_errors(name, s), fit, peak, *texts])
    return ev.Table(
        id="scores",
        title="Errors of every trial",
        columns=["trial", "role", *ERROR_COLUMNS, "fit", "of peak", "peak error", "phase"],
        rows=rows,
        caption="NRMSE is over the measured range (tendon fish, Eq 13), fit as MATLAB's compare prints it, "
        "the peak error the difference of the maximum magnitudes (Eq 14), the phase that by which the "
        "simulation leads the measurement at the beat.",
        folded=True,
    )


def _speeds(file: ComparisonFile) -> ev.Table:
    rows: list[list[Any]] = []
    for t, measured, simulated in file.mean_speeds:
        settles, share = "", None
        if t.cruise is not None:
            settles = "never"
            if t.cruise.settled is not None:
                settles = numbers.format_number(t.cruise.settled, 3, "m/s")
        if measured:
            share = (simulated - measured) / measured
        texts = [
            format_quantity(measured, "m/s"),
            format_quantity(simulated, "m/s"),
            numbers.percent(share, 2),
            settles,
        ]
        rows.append([t.id, *texts, *(numbers.format_number(t.drive.get(key), 4) for key in DRIVE_SETTINGS)])
    columns = ["trial", "measured", "simulated", "difference", "model settles at"]
    return ev.Table(
        id="speeds",
        title="Mean speed of the last beats",
        columns=[*columns, *(numbers.column_title(key) for key in DRIVE_SETTINGS)],
        rows=rows,
        caption="Path length between the mean positions of successive beats over time, or mean surge if no "
        "position is logged; over the last four whole beats.",
    )


# ------------------------------------------------------------ figures


def _figures(
    experiment: Experiment, done: Sequence[Compared], profiles: Sequence[Profile], file: ComparisonFile
) -> list[ev.Figure]:
    """Return the figures of the evidence.

    The figures show motion profiles. Without motion profiles, they show time series and mean speeds. Paths
    follow for a robot in a plane.
    """
    if experiment.model.timed_runs:
        runs = {d.trial.id: (p.measured, p.simulated) for d in done for p in d.pairs.values()}
        return [_agreement("overlay", "Measured and simulated", runs)]
    drawn = [_profile_figure(p) for p in profiles]
    if not drawn:
        drawn.append(_overlay(done))
        if file.mean_speeds:
            drawn.append(_speeds_figure(file))
    body = experiment.model.body
    if body is not None and body.free:
        names = body.pose[:2]
        paths = [_path(t, d, *names) for t, d in _select_trials(done).items() if set(names) <= d.pairs.keys()]
        caption = "Path of the reference point."
        drawn.append(ev.Figure(id="paths", title="Paths", caption=caption, panels=paths))
    return [figure for figure in drawn if figure.panels]


def _speeds_figure(file: ComparisonFile) -> ev.Figure:
    """Return the figure of simulated against measured mean speeds of fitted and of held-out trials."""
    groups: dict[str, tuple[Any, Any]] = {}
    for name, role in (("fitted", "fit"), ("held out", "validate")):
        speeds = np.array([(m, s) for t, m, s in file.mean_speeds if t.role == role], dtype=float)
        if len(speeds):
            groups[name] = speeds[:, 0], speeds[:, 1]
    return _agreement("speeds", "Mean speed of the last beats", groups)


def _select_trials(done: Sequence[Compared]) -> dict[str, Compared]:
    """Return the trials to plot, by the title of their panel.

    These are the fitted trials with the largest and the smallest error, and the held-out trial with the
    largest error.
    """

    def error(one: Compared) -> float:
        scores = one.record.channels
        return float(np.mean([scores[n].nrmse or 0.0 for n in _rates(scores) or scores]))

    ranked = sorted((d for d in done if d.pairs), key=error, reverse=True)
    held_out = [d for d in ranked if d.trial.role == "validate"]
    picked = {d.trial.id: d for d in (*ranked[:1], *held_out[:1], *ranked[-1:])}
    words = {ranked[0].trial.id: "largest error", ranked[-1].trial.id: "smallest error"}
    titles = {}
    for name, d in picked.items():
        known = [words.get(name, "") * (len(picked) > 1), "held out" * (d.trial.role == "validate")]
        remark = ", ".join(filter(None, known))
        titles[name + f" ({remark})" * bool(remark)] = d
    return titles


def _overlay(done: Sequence[Compared]) -> ev.Figure:
    panels = []
    for title, d in _select_trials(done).items():
        joints = [n for n in d.pairs if n.startswith("joint")]
        for name in (_rates(d.pairs) or joints or list(d.pairs))[:2]:
            p = d.pairs[name]
            factor, unit = numbers.in_degrees(p.channel.unit)
            curves = [ev.thin_curve(p.time_s, factor * y, MAX_SAMPLES) for y in (p.measured, p.simulated)]
            label = f"{p.channel.meaning or p.channel.name} ({numbers.unit_text(unit) or '1'})"
            traces = ev.pair(*zip(*curves, strict=True))
            panels.append(ev.Panel(x_label="time (s)", y_label=label, traces=traces, title=title))
    caption = "The trials with the largest and the smallest mean error over the measured range."
    title = "Measured and simulated"
    return ev.Figure(id="overlay", title=title, caption=caption, panels=panels)


def _agreement(id: str, title: str, groups: Mapping[str, tuple[Any, Any]]) -> ev.Figure:
    """Return a figure of simulated against measured mean speeds, with one point for each pair of speeds."""
    points = enumerate(groups.items())
    traces = [ev.Trace(x=x, y=y, style="points", label=name, group=k) for k, (name, (x, y)) in points]
    ends = [0.0, 1.1 * max(float(np.nanmax(x)) for x, _ in groups.values())]
    traces.append(ev.Trace(x=ends, y=ends, style="dashed", label="equal", group=len(groups)))
    panel = ev.Panel(
        x_label="measured mean speed (m/s)",
        y_label="simulated mean speed (m/s)",
        traces=traces,
        equal_aspect=True,
    )
    caption = "The line is where measured and simulated are equal."
    return ev.Figure(id=id, title=title, caption=caption, panels=[panel])


def _path(title: str, done: Compared, *names: str) -> ev.Panel:
    every = slice(None, None, max(1, len(done.trial.time_s) // MAX_SAMPLES))
    pairs = [done.pairs[name] for name in names]
    return ev.path(title, names, *((p.measured[every], p.simulated[every]) for p in pairs))
