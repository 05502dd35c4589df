"""What ``fit-graybox`` shows of a fit: paths, starts, errors of every trial, how it was done."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.fitting import fit_common, identifiability, metrics, multistart
from swimid.fitting.drives import Beat
from swimid.fitting.experiment import Experiment
from swimid.fitting.fit_result import FitResult, Series
from swimid.logs.beat import find_beat
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.parameters import ParameterFile
from swimid.robots.file import Robot
from swimid.robots.planar import Multilink
from swimid.robots.spatial import Multibody

#: A channel's beat is looked for up to this multiple of the drive's frequency: surge beats at twice it.
BEAT_HARMONICS = 3.5


def body_of(robot: Robot) -> Multilink | Multibody:
    """The links of a robot: in space where its file says how, else in its plane."""
    body = robot.multibody or robot.multilink
    assert body is not None
    return body


def track(experiment: Experiment, result: FitResult) -> list[ev.Figure]:
    """The paths in the plane of motion, where the pose was fitted; in space from above and from the side."""
    swimmer, body = result.model.swimmer, body_of(experiment.robot)
    assert swimmer is not None
    if isinstance(body, Multilink):
        view = "from above" if body.plane == "horizontal" else "from the side"
        return _path(result, swimmer.pose[0], swimmer.pose[1], view)
    return [*_path(result, "x_m", "z_m", "from the side"), *_path(result, "x_m", "y_m", "from above")]


def _path(result: FitResult, across: str, along: str, view: str) -> list[ev.Figure]:
    traces = []
    for group, trial in enumerate(t.id for t in result.trials):
        series = {s.channel: s for s in result.series if s.trial == trial}
        if across not in series or along not in series:
            continue
        held_out = ", held out" if series[across].role == "validate" else ""
        for style, part in (("points", "measured"), ("line" if not held_out else "dashed", "simulated")):
            x, y = getattr(series[across], part), getattr(series[along], part)
            step = max(len(x) // 200, 1) if style == "points" else 1
            label = f"{trial}{held_out}" if style == "points" else ""
            traces.append(ev.Trace(x=x[::step], y=y[::step], style=style, label=label, group=group))
    if not traces:
        return []
    return [
        blocks.figure(
            "track" if view == "from above" else "track-side",
            f"Paths {view}",
            "Points are measured, lines simulated with the estimated parameters.",
            f"{across[:-2]} (m)",
            f"{along[:-2]} (m)",
            traces,
            equal_aspect=True,
        )
    ]


def starts_check(ends: Sequence[multistart.Start], *, asked: bool) -> ev.Check:
    """Number of starts that end in the reported minimum; a doubt where the user asked for the starts."""
    agree = multistart.agreeing(ends)
    value = f"{agree} of {len(ends)} starts end in it"
    text = "the other starts end higher; the lowest is reported" if agree < len(ends) else ""
    if not asked:
        return ev.check("one minimum", value, None, text=text)
    return blocks.check("one minimum", value, "every start", agree == len(ends), text=text)


def tables(experiment: Experiment, result: FitResult, ends: Sequence[multistart.Start]) -> list[ev.Table]:
    """Errors of every trial, what is known best, the starts, and how the source was read."""
    tables = [_metrics_table(result)]
    ranking: list[dict[str, blocks.Cell]] = [
        {"parameter": label, "share of its own": round(share, 4), "status": result.status[label]}
        for label, share in identifiability.ranked(result)
    ]
    if len(ranking) > 1:
        caption = (
            "From the best to the least identifiable parameter. The share is the part of the trials' "
            "sensitivity to it that those above it, and the start states, cannot imitate."
        )
        tables.append(blocks.table("ranking", "What the trials know best", ranking, caption))
    starts = [
        {"start": k, "converged": end.converged, "cost": float(end.cost)}
        for k, end in enumerate(ends, start=1)
    ]
    if starts:
        caption = "The cost is the mean squared residual, averaged geometrically over the channels."
        tables.append(blocks.table("starts", "Starts", starts, caption))
    readings = [
        {"reading": k, "question": r.question, "chosen": r.chosen, "meaning": r.options[r.chosen].says}
        for k, r in experiment.robot.readings.items()
    ]
    if readings:
        caption = "Other readings are options of the robot file (--reading NAME=OPTION)."
        tables.append(blocks.table("readings", "How the source was read", readings, caption))
    return tables


def _metrics_table(result: FitResult) -> ev.Table:
    rows: list[dict[str, blocks.Cell]] = []
    units = {c.name: c.unit for c in result.model.channels}
    drives = {t.id: t.swim.beat for t in result.trials}
    for s in result.series:
        score = fit_common.scores(result, s.role, [s.trial])[s.channel]
        _, relative = metrics.peak_error(s.measured, s.simulated)
        warped = metrics.dtw_distance(s.measured, s.simulated, band=max(1, len(s.measured) // 20))
        rows.append(
            {
                "trial": s.trial,
                "role": "held out" if s.role == "validate" else "fit",
                "channel": s.channel,
                "RMSE": numbers.number(score.rmse, 3, units[s.channel]),
                "NRMSE": numbers.percent(score.nrmse),
                "VAF": numbers.number(100 * score.vaf, 4, "%"),
                "peak error": numbers.number(100 * relative, 3, "%"),
                "DTW distance": numbers.number(warped, 3, units[s.channel]),
                "phase error": _phase(s, drives[s.trial]),
            }
        )
    return blocks.table(
        "metrics",
        "Errors of every trial",
        rows,
        "NRMSE is over the measured range (tendon fish, Eq 13); the peak error is the difference of the "
        "largest magnitudes over the measured one (Eq 14); DTW is the distance per sample after warping "
        "within 5 % of the record; the phase error is taken at the beat.",
    )


def _phase(s: Series, drive: Beat | None) -> str:
    there = np.isfinite(s.measured)
    highest = None
    if drive is not None and there.sum() > 1:
        rate = 1.0 / float(np.median(np.diff(s.time_s[there])))
        highest = min(BEAT_HARMONICS * drive.frequency_hz, 0.45 * rate)
    beat = find_beat(s.time_s[there], s.measured[there], highest_hz=highest)
    if beat is None:
        return ""
    error = metrics.phase_error(s.measured, s.simulated, s.time_s, frequency_hz=beat.frequency_hz)
    return numbers.number(float(np.degrees(error)), 2, "deg")


def methods(
    experiment: Experiment,
    result: FitResult,
    ends: Sequence[multistart.Start],
    left_out: list[str],
    method: str,
) -> list[str]:
    """How it was done, in sentences."""
    fitted = [t for t in result.trials if t.role == "fit"]
    body = body_of(experiment.robot)
    kind = "planar model" if isinstance(body, Multilink) else "model in space"
    swimmer = result.model.swimmer
    assert swimmer is not None
    by = "the search on the front" if method == "nsga2" else "output-error maximum likelihood"
    said = [
        f"{', '.join(result.shared)} were estimated from {len(fitted)} {experiment.name} trials "
        f"({result.samples} samples of {', '.join(result.noise)}) by {by} with a {kind} of "
        f"{len(body.links)} links, integrated by a fourth-order Runge-Kutta method with steps of at most "
        f"{1e3 * swimmer.max_step:g} ms; halving them changes no sample by more than "
        f"{result.step_error:.2g} standard deviations of its noise.",
        "Standard errors follow from the Jacobian at the optimum with the residuals' autocorrelation "
        "accounted for.",
    ]
    if result.loss == "huber":
        said.append("Huber's loss was used.")
    if ends:
        said.append(
            f"{multistart.agreeing(ends)} of {len(ends)} starts, "
            f"{'on the front' if method == 'hybrid' else 'drawn evenly within the bounds'}, end in the "
            "reported minimum."
        )
    if left_out:
        said.append(f"{', '.join(left_out)} could not be identified and were held at the whole fit's values.")
    if any("[" in label for label in result.labels):
        kinds = dict.fromkeys(label.split("[")[0] for label in result.labels if "[" in label)
        said.append(
            f"Each trial has its own {', '.join(kinds)}; on held-out trials these are estimated with the "
            "rest held."
        )
    return said


def scores(file: ParameterFile) -> list[str]:
    """Errors by channel, for the terminal."""
    assert file.fit is not None
    lines = []
    for title, block in (("fit", file.fit.channels), ("held out", file.fit.validation.get("channels", {}))):
        for channel, score in block.items():
            rmse = numbers.number(score["rmse"], 3, score["unit"])
            nrmse = numbers.percent(score["nrmse"])
            vaf = numbers.number(100 * score["vaf"], 4)
            lines.append(f"  {title}, {channel}: RMSE {rmse}, NRMSE {nrmse}, VAF {vaf} %")
    return lines
