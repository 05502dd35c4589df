"""Evidence of ``fit-graybox``: paths, starts, errors of every trial, methods."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.fitting import covariance, fit_common, global_search, metrics
from swimid.fitting.drives import Beat
from swimid.fitting.experiment import Experiment
from swimid.fitting.metrics import FitResult, Series
from swimid.logs.beat import find_beat
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.robots.file import Robot
from swimid.robots.planar import Multilink
from swimid.robots.spatial import Multibody


def body_of(robot: Robot) -> Multilink | Multibody:
    """Return the links of a robot: in space where its file says how, else in its plane."""
    body = robot.multibody or robot.multilink
    assert body is not None
    return body


def track(experiment: Experiment, result: FitResult) -> list[ev.Figure]:
    """Draw the paths where the pose was fitted; in space from above and from the side."""
    body = body_of(experiment.robot)
    if isinstance(body, Multibody):
        views = [_path(result, "x_m", "z_m", "from the side"), _path(result, "x_m", "y_m", "from above")]
    else:
        view = "from above" if body.plane == "horizontal" else "from the side"
        across, along, *_ = result.model.swimmer.pose
        views = [_path(result, across, along, view)]
    panels = [panel for panel in views if panel.traces]
    caption = "Points are measured, lines simulated with the estimated parameters."
    return [ev.Figure(id="track", title="Paths", caption=caption, panels=panels, columns=2)] if panels else []


def _path(result: FitResult, across: str, along: str, view: str) -> ev.Panel:
    """Draw the paths of the worst and the best fitted trial, and of the worst held-out one."""
    paths = {}
    for trial in result.trials:
        series = {s.channel: s for s in result.series if s.trial == trial.id}
        if across in series and along in series:
            error = np.nanmean(series[across].weighted ** 2) + np.nanmean(series[along].weighted ** 2)
            paths[trial.id] = float(error), series
    by_error = sorted(paths, key=lambda name: -paths[name][0])
    fitted = [name for name in by_error if paths[name][1][across].role == "fit"]
    held_out = [name for name in by_error if name not in fitted]
    chosen = {
        **dict.fromkeys(held_out[:1], "worst held out"),
        **dict.fromkeys(fitted[-1:], "best"),
        **dict.fromkeys(fitted[:1], "worst"),
    }
    traces = []
    for group, (name, word) in enumerate(chosen.items()):
        x, y = (paths[name][1][channel] for channel in (across, along))
        step = max(len(x.measured) // 200, 1)
        measured, simulated = (x.measured[::step], y.measured[::step]), (x.simulated, y.simulated)
        for style, (xs, ys) in (("points", measured), ("line" if x.role == "fit" else "dashed", simulated)):
            label = f"{name} ({word})" if style == "points" else ""
            traces.append(ev.Trace(x=xs, y=ys, style=style, label=label, group=group))
    return ev.Panel(
        x_label=f"{across[:-2]} (m)",
        y_label=f"{along[:-2]} (m)",
        title=view,
        traces=traces,
        equal_aspect=True,
    )


def starts_check(ends: Sequence[global_search.Start], *, asked: bool) -> ev.Check:
    """Count the starts that end in the reported minimum; for information unless the user asked for them."""
    agree = global_search.agreeing(ends)
    value = f"{agree} of {len(ends)} starts end in it"
    text = "the other starts end higher; the lowest is reported" if agree < len(ends) else ""
    passed = agree == len(ends) if asked else None
    reason = f"only {agree} of {len(ends)} starts end in the reported minimum"
    return ev.check("one minimum", value, passed, "every start", text, reason=reason)


def tables(experiment: Experiment, result: FitResult, ends: Sequence[global_search.Start]) -> list[ev.Table]:
    """List errors of trials, parameters by identifiability, starts, and readings of the source."""
    ranking = [[label, share, result.status[label]] for label, share in covariance.ranked(result)]
    starts = [[k, end.converged, float(end.cost)] for k, end in enumerate(ends, start=1)]
    readings = experiment.robot.readings.items()
    found = [
        ev.Table(
            id="metrics",
            title="Errors of every trial",
            columns=["trial", "data", "channel", "RMSE", "NRMSE", "VAF", "peak", "DTW", "phase"],
            rows=_error_rows(result),
            caption="NRMSE: over the measured range (tendon fish, Eq 13). Peak: difference of the largest "
            "magnitudes over the measured one (Eq 14). DTW: distance per sample after warping within 5 % of "
            "the record. Phase: at the beat.",
            folded=True,
        ),
        ev.Table(
            id="ranking",
            title="Parameters by identifiability",
            columns=["parameter", "share of its own", "status"],
            rows=ranking if len(ranking) > 1 else [],
            caption="The share is the part of the sensitivity to a parameter that those above it, and the "
            "start states, cannot imitate.",
            folded=True,
        ),
        ev.Table(
            id="starts",
            title="Starts",
            columns=["start", "converged", "cost"],
            rows=starts,
            caption="The cost is the mean squared residual, averaged geometrically over the channels.",
            folded=True,
        ),
        ev.Table(
            id="readings",
            title="Readings of the source",
            columns=["reading", "question", "chosen", "meaning"],
            rows=[[name, r.question, r.chosen, r.options[r.chosen].says] for name, r in readings],
            caption="Other readings are options of the robot file (--reading NAME=OPTION).",
            folded=True,
        ),
    ]
    return [table for table in found if table.rows]


def _error_rows(result: FitResult) -> list[list[str]]:
    rows = []
    units = {c.name: c.unit for c in result.model.channels}
    drives = {t.id: t.swim.beat for t in result.trials}
    for s in result.series:
        unit = units[s.channel]
        score = fit_common.scores(result, s.role, [s.trial])[s.channel]
        warped = metrics.dtw_distance(s.measured, s.simulated, band=max(1, len(s.measured) // 20))
        rows.append(
            [
                s.trial,
                "held out" if s.role == "validate" else "fit",
                s.channel,
                numbers.number(score.rmse, 3, unit),
                numbers.percent(score.nrmse),
                numbers.percent(score.vaf, 4),
                numbers.percent(metrics.peak_error(s.measured, s.simulated)[1]),
                numbers.number(warped, 3, unit),
                _phase(s, drives[s.trial]),
            ]
        )
    return rows


def _phase(s: Series, drive: Beat | None) -> str:
    there = np.isfinite(s.measured)
    highest = None
    if drive is not None and there.sum() > 1:
        rate = 1.0 / float(np.median(np.diff(s.time_s[there])))
        # surge beats at twice the frequency of the drive
        highest = min(3.5 * drive.frequency_hz, 0.45 * rate)
    beat = find_beat(s.time_s[there], s.measured[there], highest_hz=highest)
    if beat is None:
        return ""
    error = metrics.phase_error(s.measured, s.simulated, s.time_s, frequency_hz=beat.frequency_hz)
    return numbers.number(float(np.degrees(error)), 2, "deg")


def methods(
    experiment: Experiment,
    result: FitResult,
    ends: Sequence[global_search.Start],
    left_out: list[str],
    method: str,
) -> list[str]:
    """Describe the fit in sentences for a methods section."""
    fitted = sum(t.role == "fit" for t in result.trials)
    body = body_of(experiment.robot)
    kind = "planar model" if isinstance(body, Multilink) else "model in space"
    by = "the search on the front" if method == "nsga2" else "output-error maximum likelihood"
    said = [
        f"{', '.join(result.shared)} were estimated from {fitted} {experiment.name} trials "
        f"({result.samples} samples of {', '.join(result.noise)}) by {by} with a {kind} of "
        f"{len(body.links)} links, integrated by a fourth-order Runge-Kutta method with steps of at most "
        f"{1e3 * result.model.swimmer.max_step:g} ms; halving them changes no sample by more than "
        f"{result.step_error:.2g} standard deviations of its noise.",
        fit_common.COVARIANCE,
    ]
    if result.loss == "huber":
        said.append("Huber's loss was used.")
    if ends:
        drawn = "on the front" if method == "hybrid" else "drawn evenly within the bounds"
        agree = global_search.agreeing(ends)
        said.append(f"{agree} of {len(ends)} starts, {drawn}, end in the reported minimum.")
    if left_out:
        said.append(f"{', '.join(left_out)} could not be identified and were held at the whole fit's values.")
    own = dict.fromkeys(label.split("[")[0] for label in result.labels if "[" in label)
    if own:
        said.append(f"Each trial has its own {', '.join(own)}; on held-out trials with the rest held.")
    return said
