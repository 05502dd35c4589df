"""Evidence of ``swimid track video``: facts, speeds and stroke, figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, astuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import UsageError
from swimid.logs import swimming
from swimid.logs.swimming import Swimming, Track
from swimid.logs.tracks import Estimate
from swimid.notices import warn
from swimid.results import blocks, numbers
from swimid.results.evidence import Check, Figure, Mark, Panel, Span, Table, Trace, check, thinned
from swimid.tracking.detect import RawTrack
from swimid.tracking.pose import SYSTEMATIC_PX, Pose
from swimid.tracking.setup import Setup
from swimid.tracking.smooth import Smoothed

Array = NDArray[np.float64]
Row = tuple[str, str, Estimate | None, str]

REFERENCES = [
    "Rauch, H. E., Tung, F., Striebel, C. T. (1965). Maximum likelihood estimates of linear dynamic systems. "
    "AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166",
    "White, K. P. (1997). An effective truncation heuristic for bias reduction in simulation output. "
    "Simulation 69(6), 323-334. doi:10.1177/003754979706900601",
]


def swum(pose: Pose, window_s: tuple[float | None, float | None]) -> Swimming:
    """Return speeds, accelerations and stroke of a pose, over a window (s) or the steady part.

    Raises
    ------
    UsageError
        The window holds next to nothing of the track.
    """
    seen = pose.times[pose.measured]
    begin, end = (v if v is not None else d for v, d in zip(window_s, (seen[0], seen[-1]), strict=True))
    inside = int(((seen >= begin) & (seen <= end)).sum())
    if inside < swimming.SHORTEST and window_s != (None, None):
        raise UsageError(
            f"only {inside} frames with the markers are between {begin:g} and {end:g} s; the track runs from "
            f"{seen[0]:.4g} to {seen[-1]:.4g} s",
            hint="give --from and --to in seconds from the first frame",
        )
    angle = None if pose.angle is None else pose.angle.position[0]
    path = pose.path
    middle = np.nanmedian(path.position, axis=1, keepdims=True)
    (x,), (y,) = pose.plane.to_image(*middle)
    error = SYSTEMATIC_PX * pose.plane.size_of_pixel(float(x), float(y))
    separation = math.inf if pose.separation is None else float(np.nanmedian(pose.separation))
    track = Track(
        time_s=pose.times,
        measured=pose.measured,
        raw=pose.raw,
        smooth=path.position,
        velocity=path.velocity,
        raw_angle=pose.raw_angle,
        angle=angle,
        error=error,
        angle_error=math.sqrt(2) * error / max(separation, 1e-12),
    )
    return swimming.figures(track, window_s)


def stroke_check(found: Swimming) -> list[Check]:
    """Return whether the channels of the track agree on one stroke; warn where they do not."""
    if found.stroke is None:
        return []
    if found.doubt:
        warn("SWM033", found.doubt)
    value, limit = f"{found.stroke.frequency_hz:.4g} Hz", "heading and path agree"
    return [check("One stroke", value, not found.doubt, limit, reason=found.doubt)]


# ---------------------------------------------------------------- numbers


def data(track: RawTrack, pose: Pose, setup: Setup, found: Swimming) -> dict[str, Any]:
    """Return the numbers of a track for ``--json``; None where the window does not tell one."""
    seen, total, unit = np.flatnonzero(pose.measured), len(pose.times), pose.plane.unit
    gaps = [end - start for start, end in pose.gaps]
    noise = {unit: pose.path.measurement_sd}
    if pose.angle is not None:
        noise["rad"] = pose.angle.measurement_sd
    speeds = {
        key: None if value is None else asdict(value) | {"unit": kind}
        for key, _, value, kind in _rows(found, setup, unit)
    }
    return {
        "frames": total,
        "found": len(seen),
        "found_share": len(seen) / total,
        "first_seen_s": float(pose.times[seen[0]]),
        "last_seen_s": float(pose.times[seen[-1]]),
        "duration_s": float(pose.times[-1]),
        "interpolated": int(pose.interpolated.sum()),
        "segments": int(pose.segment.max()),
        "gaps": len(gaps),
        "longest_gap_s": max(gaps, default=0.0),
        "unit": unit,
        "markers": {
            name: {"found": int(track.found[i].sum()), "at_edge": int(track.at_edge[i].sum())}
            for i, name in enumerate(track.names)
        },
        "measurement_sd": noise,
        "process_noise": {"order": pose.path.order, "value": pose.path.process_noise},
        "swimming": {
            "window": found.window,
            "from_s": found.begin_s,
            "to_s": found.end_s,
            "steady": found.steady,
            "stroke_unknown": found.unknown,
            **speeds,
        },
    }


def _rows(found: Swimming, setup: Setup, unit: str) -> list[Row]:
    """Return key, name, value and unit of every speed, acceleration and amplitude."""
    up, turn, _ = setup.axes
    sway = "sway" if setup.plane == "horizontal" else "heave"
    advance = "displacement over time" if found.stroke is None else "advance speed, not steady"
    speed, rate = f"{unit}/s", f"{unit}/s^2"
    across = found.acceleration_xy or (None, None)
    rows: list[Row] = [
        ("path_speed", "path speed", found.path_speed, speed),
        ("steady_speed", "steady speed", found.advance if found.steady else None, speed),
        ("advance_speed", advance, found.advance, speed),
        ("speed_change", "change of the advance speed", found.change, speed),
        ("acceleration", "acceleration along the path", found.acceleration, rate),
        ("acceleration_x", "acceleration in x", across[0], rate),
        (f"acceleration_{up}", f"acceleration in {up}", across[1], rate),
        ("stroke_frequency", "stroke frequency", found.frequency_hz, "Hz"),
    ]
    for key, name, kind in (("sway", sway, unit), ("turn", turn, "rad")):
        if key in found.amplitudes or found.stroke is not None:
            rows.append((f"{name}_amplitude", f"{name} amplitude", found.amplitudes.get(key), kind))
    return rows


# ---------------------------------------------------------------- for readers


def facts(pose: Pose, setup: Setup, found: Swimming) -> dict[str, str]:
    """Return short particulars of a track."""
    unit, count = pose.plane.unit, int(pose.measured.sum())
    noise = f"{pose.path.measurement_sd:.2g} {unit}"
    if pose.angle is not None:
        noise += f", heading {pose.angle.measurement_sd:.2g} rad"
    told = {
        "Found": f"{count} of {len(pose.times)} frames, {int(pose.interpolated.sum())} bridged",
        "Segments": str(int(pose.segment.max())),
        "Measurement noise": noise,
    }
    if setup.plane == "vertical":
        told["Faces"] = "left" if pose.plane.runs_left else "right"
    if pose.plane.exact:
        told["Calibration"] = "four points, which do not tell their error"
    windows = {"given": "as given", "whole track": "the whole track: no part of it is steady"}
    told["Speeds over"] = (
        f"{found.begin_s:.4g} to {found.end_s:.4g} s, {windows.get(found.window, 'the steady part')}"
    )
    if found.advance is not None and found.change is not None and not found.steady:
        change = 100 * found.change.value / max(found.advance.value, 1e-300)
        told["Speeds over"] += f"; the speed changes by {change:+.0f} % over it"
    if found.stroke is None:
        told["Stroke"] = f"unknown: {found.unknown}"
    return told


def table(found: Swimming, setup: Setup, unit: str) -> Table:
    """Return the speeds, accelerations and amplitudes with their intervals; angles in degrees."""
    rows: list[list[str | float | int | bool | None]] = []
    for key, name, value, kind in _rows(found, setup, unit):
        if value is None or (key == "advance_speed" and found.steady):
            continue
        factor, shown = numbers.in_degrees(kind)
        rows.append([name, *(factor * one for one in astuple(value)), numbers.unit_text(shown)])
    return Table(
        id="swimming",
        title="Speed and stroke",
        columns=["quantity", "value", "95 % from", "to", "unit"],
        rows=rows,
        caption="The path speed holds sway and turns; steady and advance speed are those of the path "
        "averaged over a stroke. Amplitudes are half of peak to peak of the fundamental.",
    )


def segment_table(pose: Pose) -> Table:
    """Return start, end, frames and path length of each segment."""
    rows: list[list[str | float | int | bool | None]] = []
    for number in range(1, int(pose.segment.max()) + 1):
        part = pose.segment == number
        t, length = pose.times[part], float(np.sum(np.hypot(*np.diff(pose.path.position[:, part], axis=1))))
        measured = int((part & pose.measured).sum())
        rows.append([number, float(t[0]), float(t[-1]), int(part.sum()), measured, length])
    columns = ["segment", "from (s)", "to (s)", "frames", "measured", f"path length ({pose.plane.unit})"]
    return Table(id="segments", title="Segments", columns=columns, rows=rows, folded=True)


def answer(pose: Pose, found: Swimming) -> str:
    """Return the sentence of the verdict: frames found, speed and stroke."""
    speed = found.advance if found.steady else found.path_speed
    text = f"Markers found in {100 * pose.measured.mean():.1f} % of the frames"
    if speed is not None:
        kind = "steady speed" if found.steady else "path speed"
        text += f", {kind} {numbers.number(speed.value, 4, f'{pose.plane.unit}/s')}"
    if found.frequency_hz is not None:
        text += f", stroke {numbers.number(found.frequency_hz.value, 4, 'Hz')}"
    return f"{text}."


def methods(setup: Setup, pose: Pose) -> list[str]:
    """Return sentences for a paper's methods section."""
    kinds = {2: "constant velocity with white acceleration", 3: "constant acceleration with white jerk"}
    markers = "a marker" if setup.tail is None else "two markers"
    rate, clock = "", ", and frames were timed by their own stamps"
    if setup.frame_rate_hz is not None:
        rate, clock = f" at {setup.frame_rate_hz:g} Hz", ""
    return [
        f"The robot's path was taken from video{rate} by tracking {markers} by colour; centroids were found "
        f"with sub-pixel resolution by soft membership{clock}.",
        f"Positions were smoothed with a Kalman filter ({kinds[pose.path.order]}) and a Rauch-Tung-Striebel "
        "smoother whose noise powers maximise the likelihood of the innovations (measurement noise "
        f"{pose.path.measurement_sd:.2g} {pose.plane.unit}). Dropouts up to {setup.max_gap_s:g} s were "
        "bridged by the smoother and are flagged; longer ones were left empty.",
        "The path was averaged over a stroke and cut into blocks of one stroke. The steady part was found by "
        "the marginal standard error rule on both ends; speeds, accelerations and amplitudes are means over "
        "blocks, and their intervals Student's over the means of blocks.",
    ]


def figures(pose: Pose, setup: Setup, found: Swimming) -> list[Figure]:
    """Return path, coordinates with their bands, and speeds with the window of the table."""
    unit, t = pose.plane.unit, pose.times
    up, turn, side = setup.axes
    spans = [Span(start=a, end=b, label="gap") for a, b in pose.gaps][:60]
    # a parametric curve has no envelope in x: every k-th point is taken instead
    every = slice(None, None, max(len(t) // 1500, 1))
    (x, y), (raw_x, raw_y) = pose.path.position[:, every], pose.raw[:, every]

    def over_time(label: str, traces: Sequence[Trace], marks: Sequence[Mark] = ()) -> Panel:
        return Panel(x_label="time (s)", y_label=label, traces=list(traces), spans=spans, marks=list(marks))

    def banded(values: Smoothed, row: int, raw: Array) -> list[Trace]:
        smooth, sd = values.position[row, every], values.position_sd[row, every]
        return [
            Trace(x=t[every], y=raw, label="measured", style="points", group=0),
            blocks.band(t[every], smooth, 1.96 * sd, label="smoothed", group=1),
        ]

    coordinates = [
        over_time(f"x ({unit})", banded(pose.path, 0, raw_x)),
        over_time(f"{up} ({unit})", banded(pose.path, 1, raw_y)),
    ]
    speeds = dict(zip((f"vx ({unit}/s)", f"v{up} ({unit}/s)"), pose.path.velocity, strict=True))
    if pose.angle is not None and pose.raw_angle is not None and pose.body_velocity is not None:
        coordinates.append(over_time(f"{turn} (rad)", banded(pose.angle, 0, pose.raw_angle[every])))
        speeds = dict(zip((f"u ({unit}/s)", f"{side} ({unit}/s)"), pose.body_velocity, strict=True))
        speeds[f"{turn} rate (rad/s)"] = pose.angle.velocity[0]
    window = [
        Mark(at=found.begin_s, axis="x", label="window"),
        Mark(at=found.end_s, axis="x"),
    ]
    path = [
        Trace(x=raw_x, y=raw_y, label="measured", style="points", group=0),
        Trace(x=x, y=y, label="smoothed", group=0),
    ]
    curves = {
        label: Trace(**dict(zip("xy", thinned(t, values), strict=True))) for label, values in speeds.items()
    }
    return [
        blocks.figure("path", "Path", "", f"x ({unit})", f"{up} ({unit})", path, equal_aspect=True),
        Figure(
            id="pose",
            title="Pose over time",
            caption="Measured and smoothed, with the 95 % band; gaps are shaded.",
            panels=coordinates,
        ),
        Figure(
            id="speed",
            title="Speeds",
            caption="From the smoother; dashed lines bound the window of the table.",
            panels=[over_time(label, [curve], window) for label, curve in curves.items()],
        ),
    ]
