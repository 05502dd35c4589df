"""``swimid track video``: a film and a setup give a log, its evidence, and frames with the track drawn in."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance
from swimid.logs import log, swimming
from swimid.logs.log import Log, runs
from swimid.logs.logged import Logged
from swimid.logs.swimming import Swimming
from swimid.logs.tracks import Estimate
from swimid.notices import Notice, recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, drawing, numbers
from swimid.results import evidence as ev
from swimid.tracking import pose, quality, reader
from swimid.tracking import setup as setup_format
from swimid.tracking.detect import CUT, LOST, STATUS, RawTrack, describe_colours
from swimid.tracking.options import TrackVideoOptions
from swimid.tracking.pose import SYSTEMATIC_PX, Plane, Pose
from swimid.tracking.reader import SEEN, Frame, Video, reduced, write_text
from swimid.tracking.setup import Setup
from swimid.tracking.smooth import Smoothed
from swimid.tracking.tracker import Run, follow

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Track(Logged):
    """The track of a film, as ``track_video`` gives it.

    Attributes
    ----------
    pose : Pose
        Path and heading with their standard deviations; None where the log was read from a file.
    setup : Setup
        How the film was read, with what was left out in a second look.
    """

    pose: Pose | None = None
    setup: Setup | None = None

    def _write(self, path: Path) -> list[Path]:
        written = super()._write(path)
        if self.evidence is None or atomic.is_device(path):
            return written
        plot = path.with_suffix(".png")
        shown = [figure for figure in self.evidence.figures if figure.id in ("path", "pose")]
        drawing.write(plot, shown, title=self.evidence.title)
        return [*written, plot]


@takes(TrackVideoOptions)
def track_video(
    video: str | Path,
    *,
    options: TrackVideoOptions,
    output: str | Path | None = None,
    metadata: dict[str, Any] | None = None,
    progress: Progress = silent,
) -> Track:
    """Track the markers of a video: pose, speeds and stroke of the robot.

    The setup is a file, a Setup or a dict: colours of the markers, scale, camera; ``track_setup`` drafts one.
    The log holds every frame, whatever part speeds and stroke of the result are over.

    Parameters
    ----------
    video : path
        The film; or a folder of pictures, or a pattern of their names (``%05d.png``).
    output : path, optional
        The log, CSV or Parquet by its ending. Beside it go ``<stem>.evidence.json`` and ``<stem>.png``.
        Without it nothing is written; :meth:`~swimid.results.result.Result.save` writes the same files later.
    metadata : dict, optional
        Further ``# key: value`` lines of the log.
    progress : Progress
        Shows the passes over the video.

    Returns
    -------
    Track
        ``.frame`` has a row for each of the n frames: ``t_s``, pose (m, rad; px without a scale), speeds
        (m/s, rad/s), their standard deviations, what was measured, and each marker. ``.data["swimming"]`` is
        speed, stroke and accelerations with their 95 % intervals.

    Raises
    ------
    InputError
        The video or the setup cannot be used.
    NoTrustworthyResult
        No marker, or hardly any frame with one.
    UsageError
        An option out of its range, or a window that holds next to nothing of the track.

    Notes
    -----
    Positions are smoothed by a Kalman filter and a Rauch-Tung-Striebel smoother (Rauch, Tung and Striebel,
    1965, doi:10.2514/3.3166); the steady part is found by the marginal standard error rule (White, 1997,
    doi:10.1177/003754979706900601).

    Examples
    --------
    >>> made = track_video("pool.mp4", setup="setup.yaml")  # doctest: +SKIP
    >>> made.frame[["t_s", "x_m", "y_m", "yaw_rad"]].plot(x="t_s")  # doctest: +SKIP
    """
    video, setup, overlay_path = Path(video), options.setup, options.overlay_path
    if output is not None:
        output = atomic.check_writable(output, inputs=(video, setup))
        reader.check_output(video, output)
    if overlay_path is not None:
        overlay_path = atomic.check_writable(overlay_path, inputs=(video, setup, output))
    changed = {"frame_rate_hz": options.fps, "max_gap_s": options.max_gap_s}
    rules = setup_format.of(setup)
    source = setup if isinstance(setup, str | Path) else rules
    rules = rules.model_copy(update={k: v for k, v in changed.items() if v is not None})
    with recorded(repeat=True) as notices:
        with progress(f"tracking {video.name}") as step:
            run = follow(video, rules, step=step, file=str(provenance.path_of(source)))
        result, painter = _judged(run, source, options, metadata or {}, notices)
        with atomic.together():
            remark = "" if overlay_path is None else painter.write(overlay_path, progress)
            if remark and result.evidence is not None:
                result = replace(result, evidence=result.evidence.model_copy(update={"notes": [remark]}))
            result = result.saved(output)
    return result if overlay_path is None else replace(result, outputs=[*result.outputs, overlay_path])


def _judged(
    run: Run,
    source: str | Path | Setup,
    options: TrackVideoOptions,
    metadata: dict[str, Any],
    notices: list[Notice],
) -> tuple[Track, Painter]:
    """Return the track with its evidence, and its painter."""
    track, video, rules = run.track, run.video, run.setup
    ground = pose.plane_of(rules, video.width, video.height, file=str(provenance.path_of(source)))
    _demand_markers(run)
    ground = pose.facing(track, rules, ground)
    made = pose.build(track, rules, ground)
    found = quality.checks(track, made, rules, run.kept)
    swum = _swum(made, (options.from_s, options.to_s))
    found += _stroke_check(swum)
    columns = pose.columns(made, track, rules)
    head = _metadata(run, ground, made.times) | metadata
    # a scale that is wrong by a factor shows as speeds no swimmer reaches
    units: tuple[str, ...] = ("t_s", "x_m", "y_m", "z_m", "u_m_s", "v_m_s", "w_m_s")
    shown = {name: columns[name] for name in units if name in columns}
    log.warn_units(Log(video.path, head, shown))
    painter = Painter(run, made)
    verdict = ev.judged(_answer(made, swum), found)
    proof = ev.Evidence(
        verb="track video",
        title=f"Track of {video.path.name}",
        verdict=verdict,
        facts=_facts(made, rules, swum),
        checks=found,
        tables=[_table(swum, rules, ground.unit), _segment_table(made)],
        figures=_figures(made, rules, swum),
        images=painter.images(),
        notices=blocks.notices(notices),
        methods=_methods(rules, made),
        references=REFERENCES,
        provenance=provenance.collect(
            [],
            digests=provenance.digest_together(video.path, video.files) | provenance.digests_of([source]),
            settings=options.settings(setup=rules.model_dump(mode="json", exclude_none=True)),
        ),
    )
    data = _data(track, made, rules, swum) | {
        "verdict": verdict.model_dump(),
        "checks": [check.model_dump() for check in found],
    }
    document = Log(Path(f"{video.path.stem}.csv"), head, log.numeric(columns), None)
    return Track("track video", "", data, (), proof, document, columns, made, rules), painter


def _metadata(run: Run, ground: Plane, times: NDArray[np.float64]) -> dict[str, Any]:
    """The comment lines of the log: the film, and what its pose is that of."""
    rules = run.setup
    head: dict[str, Any] = {
        "source": run.video.path.name,
        "made_by": "swimid track video",
        "frame_rate_hz": float(f"{1 / float(np.median(np.diff(times))):.6g}"),
    }
    if math.isfinite(run.video.first_stamp_s):
        head["first_stamp_s"] = run.video.first_stamp_s
    head |= {"image_size_px": [run.video.width, run.video.height], "plane": rules.plane}
    if rules.plane == "vertical":
        head["facing"] = "left" if ground.runs_left else "right"
    if rules.places is None:
        return head | {"reference": rules.head_name, "reference_offset_m": list(rules.reference_offset_m)}
    places = {name: list(place) for name, place in zip(rules.roles, rules.places, strict=True)}
    return head | {"reference": rules.robot or "robot", "markers_at_m": places}


def _demand_markers(run: Run) -> None:
    """Raise unless every marker the pose needs is seen often enough."""
    track = run.track
    total = len(track.times)
    if total < 2:
        hint = "is it a picture? Name its folder, or a pattern as %05d.png"
        raise InputError(f"has {total} frame; a track needs several", hint=hint)
    for name in run.setup.roles:
        row = track.row(name)
        count, cut = int(track.found[row].sum()), int(track.at_edge[row].sum())
        if count >= max(quality.LEAST_SHARE * total, pose.SHORTEST_SEGMENT):
            continue
        what = f"in {count} of {total} frames only" if count else f"in no frame of {total}"
        what += f" (in {cut} the edge of the picture cuts it)" if cut else ""
        raise NoTrustworthyResult(
            f"marker '{name}' was found {what}; that is no track. "
            f"{describe_colours(list(run.kept.values()))}",
            hint="'swimid track setup VIDEO -o setup.yaml' proposes markers from the video itself and draws "
            "them; or correct hsv and area_px in the setup",
        )


# ---------------------------------------------------------------- speeds and stroke


Row = tuple[str, str, Estimate | None, str]

REFERENCES = [
    "Rauch, H. E., Tung, F., Striebel, C. T. (1965). Maximum likelihood estimates of linear dynamic systems. "
    "AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166",
    "White, K. P. (1997). An effective truncation heuristic for bias reduction in simulation output. "
    "Simulation 69(6), 323-334. doi:10.1177/003754979706900601",
]


def _swum(pose: Pose, window_s: tuple[float | None, float | None]) -> Swimming:
    """Return speeds, accelerations and stroke of a pose, over a window (s) or the steady part.

    Raises
    ------
    UsageError
        The window holds next to nothing of the track.
    """
    seen = pose.times[pose.measured]
    begin, end = (v if v is not None else d for v, d in zip(window_s, (seen[0], seen[-1]), strict=True))
    inside = int(((seen >= begin) & (seen <= end)).sum())
    if inside < swimming.MIN_SAMPLES and window_s != (None, None):
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
    track = swimming.Track(
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
    return swimming.measure(track, window_s)


def _stroke_check(found: Swimming) -> list[ev.Check]:
    """Return whether the channels of the track agree on one stroke; warn where they do not."""
    if found.stroke is None:
        return []
    if found.doubt:
        warn("SWM033", found.doubt)
    value, limit = f"{found.stroke.frequency_hz:.4g} Hz", "heading and path agree"
    return [ev.check("One stroke", value, not found.doubt, limit, reason=found.doubt)]


# ---------------------------------------------------------------- numbers for machines


def _data(track: RawTrack, pose: Pose, setup: Setup, found: Swimming) -> dict[str, Any]:
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


def _facts(pose: Pose, setup: Setup, found: Swimming) -> dict[str, str]:
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


def _table(found: Swimming, setup: Setup, unit: str) -> ev.Table:
    """Return the speeds, accelerations and amplitudes with their intervals; angles in degrees."""
    rows: list[list[str | float | int | bool | None]] = []
    for key, name, value, kind in _rows(found, setup, unit):
        if value is None or (key == "advance_speed" and found.steady):
            continue
        factor, shown = numbers.in_degrees(kind)
        rows.append([name, *(factor * one for one in astuple(value)), numbers.unit_text(shown)])
    return ev.Table(
        id="swimming",
        title="Speed and stroke",
        columns=["quantity", "value", "95 % from", "to", "unit"],
        rows=rows,
        caption="The path speed holds sway and turns; steady and advance speed are those of the path "
        "averaged over a stroke. Amplitudes are half of peak to peak of the fundamental.",
    )


def _segment_table(pose: Pose) -> ev.Table:
    """Return start, end, frames and path length of each segment."""
    rows: list[list[str | float | int | bool | None]] = []
    for number in range(1, int(pose.segment.max()) + 1):
        part = pose.segment == number
        t, length = pose.times[part], float(np.sum(np.hypot(*np.diff(pose.path.position[:, part], axis=1))))
        measured = int((part & pose.measured).sum())
        rows.append([number, float(t[0]), float(t[-1]), int(part.sum()), measured, length])
    columns = ["segment", "from (s)", "to (s)", "frames", "measured", f"path length ({pose.plane.unit})"]
    return ev.Table(id="segments", title="Segments", columns=columns, rows=rows, folded=True)


def _answer(pose: Pose, found: Swimming) -> str:
    """Return the sentence of the verdict: frames found, speed and stroke."""
    speed = found.advance if found.steady else found.path_speed
    text = f"Markers found in {100 * pose.measured.mean():.1f} % of the frames"
    if speed is not None:
        kind = "steady speed" if found.steady else "path speed"
        text += f", {kind} {numbers.number(speed.value, 4, f'{pose.plane.unit}/s')}"
    if found.frequency_hz is not None:
        text += f", stroke {numbers.number(found.frequency_hz.value, 4, 'Hz')}"
    return f"{text}."


def _methods(setup: Setup, pose: Pose) -> list[str]:
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


def _figures(pose: Pose, setup: Setup, found: Swimming) -> list[ev.Figure]:
    """Return path, coordinates with their bands, and speeds with the window of the table."""
    unit, t = pose.plane.unit, pose.times
    up, turn, side = setup.axes
    spans = [ev.Span(start=a, end=b, label="gap") for a, b in pose.gaps][:60]
    # a parametric curve has no envelope in x: every k-th point is taken instead
    every = slice(None, None, max(len(t) // 1500, 1))
    (x, y), (raw_x, raw_y) = pose.path.position[:, every], pose.raw[:, every]

    def over_time(label: str, traces: Sequence[ev.Trace], marks: Sequence[ev.Mark] = ()) -> ev.Panel:
        return ev.Panel(x_label="time (s)", y_label=label, traces=[*traces], spans=spans, marks=[*marks])

    def banded(values: Smoothed, row: int, raw: Array, factor: float = 1.0) -> list[ev.Trace]:
        smooth, sd = factor * values.position[row, every], factor * values.position_sd[row, every]
        return [
            ev.Trace(x=t[every], y=factor * raw, label="measured", style="points", group=0),
            blocks.band(t[every], smooth, 1.96 * sd, label="smoothed", group=0),
        ]

    coordinates = [
        over_time(f"x ({unit})", banded(pose.path, 0, raw_x)),
        over_time(f"{up} ({unit})", banded(pose.path, 1, raw_y)),
    ]
    names = (f"speed along x ({unit}/s)", f"speed along {up} ({unit}/s)")
    speeds = dict(zip(names, pose.path.velocity, strict=True))
    if pose.angle is not None and pose.raw_angle is not None and pose.body_velocity is not None:
        degrees = np.degrees(1.0)
        coordinates.append(over_time(f"{turn} (°)", banded(pose.angle, 0, pose.raw_angle[every], degrees)))
        sideways = numbers.BODY_SPEEDS[f"{side}_m_s"]
        names = (f"surge speed ({unit}/s)", f"{sideways} ({unit}/s)")
        speeds = dict(zip(names, pose.body_velocity, strict=True))
        speeds[f"{turn} rate (°/s)"] = degrees * pose.angle.velocity[0]
    window = [
        ev.Mark(at=found.begin_s, axis="x", label="begin and end of the means"),
        ev.Mark(at=found.end_s, axis="x"),
    ]
    path = [
        ev.Trace(x=raw_x, y=raw_y, label="measured", style="points", group=0),
        ev.Trace(x=x, y=y, label="smoothed", group=0),
    ]
    curves = {k: ev.Trace(**dict(zip("xy", ev.thinned(t, v), strict=True))) for k, v in speeds.items()}
    return [
        blocks.figure("path", "Path", "", f"x ({unit})", f"{up} ({unit})", path, equal_aspect=True),
        ev.Figure(
            id="pose",
            title="Pose over time",
            caption="Measured and smoothed, with the 95 % band; gaps are shaded.",
            panels=coordinates,
        ),
        ev.Figure(
            id="speed",
            title="Speeds",
            caption="From the smoother; the means of the table are taken between the dashed lines.",
            panels=[over_time(label, [curve], window) for label, curve in curves.items()],
        ),
    ]


# ---------------------------------------------------------------- frames with the track drawn in


#: Below a frame in the report.
CAPTION = (
    "Circles: markers as found, purple where the edge of the picture cuts them. Cross and arrow: smoothed "
    "reference point and heading, orange where measured, purple where bridged. Blue: the path of the last "
    "two seconds."
)
# Okabe-Ito colours, BGR: told apart by colour-blind readers.
GUESSED, TRAIL = (167, 121, 204), (233, 180, 86)


class Painter:
    """Draws a finished track into the frames of its film."""

    def __init__(self, run: Run, pose: Pose) -> None:
        self.run, self.track, self.pose = run, run.track, pose
        self._path = pose.plane.to_image(*pose.path.position)
        self._tip: Array | None = None
        if pose.angle is not None and pose.separation is not None:
            length = float(np.nanmedian(pose.separation))
            ahead = pose.path.position + length * np.stack(
                [np.cos(pose.angle.position[0]), np.sin(pose.angle.position[0])]
            )
            self._tip = pose.plane.to_image(*ahead)

    def draw(self, index: int, frame: Frame) -> Frame:
        """The frame, drawn into: trail, markers, heading, a line of text. ``frame`` is changed."""
        size = max(frame.shape[1] / 960, 0.5)
        line = max(round(1.5 * size), 1)
        times, i = self.track.times, index
        # Seconds of path drawn behind the markers.
        first = int(np.searchsorted(times, times[i] - 2.0))
        trail = self._path[:, first : i + 1]
        for start, end in runs(np.isfinite(trail[0])):
            if end - start > 1:
                # OpenCV draws with sub-pixel accuracy in fixed point, here eighths of a pixel.
                part = np.round(8 * trail[:, start:end].T).astype(np.int32).reshape(-1, 1, 2)
                cv2.polylines(frame, [part], False, TRAIL, line, cv2.LINE_AA, shift=3)
        for m in range(len(self.track.names)):
            if self.track.status[m, i] != LOST:
                centre = (self.track.x[m, i], self.track.y[m, i])
                radius = int(np.sqrt(self.track.area[m, i] / np.pi) + 4 * size)
                colour = GUESSED if self.track.at_edge[m, i] else SEEN
                cv2.circle(frame, _point(*centre), 8 * radius, colour, line, cv2.LINE_AA, shift=3)
        if np.isfinite(self._path[0, i]):
            colour = SEEN if self.pose.measured[i] else GUESSED
            here = self._path[:, i]
            if self._tip is not None and np.isfinite(self._tip[0, i]):
                cv2.arrowedLine(
                    frame, _point(*here), _point(*self._tip[:, i]), colour, line, cv2.LINE_AA, 3, 0.2
                )
            at = tuple(np.round(here).astype(int))
            cv2.drawMarker(frame, at, colour, cv2.MARKER_CROSS, int(14 * size), line, cv2.LINE_AA)
        where = (int(8 * size), int(frame.shape[0] - 10 * size))
        write_text(frame, f"{times[i]:.2f} s  frame {i}  {self._word(i)}", where, 0.55 * size, line)
        return frame

    def _word(self, i: int) -> str:
        if self.pose.measured[i]:
            worst = max(int(s) for s in self.track.status[:, i])
            return STATUS[worst]
        word = CUT if self.track.at_edge[:, i].any() else STATUS[LOST]
        return f"{word}, interpolated" if self.pose.interpolated[i] else word

    def images(self) -> list[ev.Image]:
        """The kept frames, drawn into and compressed, for the report."""
        out = []
        for index, frame in self.run.kept.items():
            # Largest width of such a frame, px.
            drawn = reduced(self.draw(index, frame.copy()), 640)
            _, data = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 80])
            out.append(
                ev.Image(
                    id=f"frame-{index}",
                    title=f"Frame {index}, t = {self.track.times[index]:.2f} s",
                    caption=CAPTION,
                    media_type="image/jpeg",
                    base64=base64.b64encode(data.tobytes()).decode(),
                )
            )
        return out

    def write(self, path: Path, progress: Progress) -> str:
        """Read the video a second time and write it with the track drawn in; returns a remark, if any.

        What is drawn is the finished track: smoothed and bridged, without the sights that were taken back.
        None of it is known while the video is read first, and all its frames do not fit into memory. The
        second decoding is an eighth of what tracking with an overlay costs; encoding is most of it.
        """
        from swimid.files.video import REMARK, Mpeg4, open_writer

        times, source = self.track.times, self.run.video
        width, height = source.width // 2 * 2, source.height // 2 * 2
        rate = 1 / float(np.median(np.diff(times)))
        again = Video(source.path, apply_rotation=self.run.setup.apply_rotation).frames()
        with atomic.replacing(path) as temporary, progress("overlay", total=len(times)) as step:
            writer = open_writer(temporary, rate, width, height)
            try:
                for index, (time, (_, frame)) in enumerate(zip(times, again, strict=False)):
                    writer.write(float(time), self.draw(index, frame)[:height, :width])
                    step()
            finally:
                writer.close()
        return REMARK.format("overlay") if isinstance(writer, Mpeg4) else ""


def _point(x: float, y: float) -> tuple[int, int]:
    return round(8 * float(np.clip(x, -1e5, 1e5))), round(8 * float(np.clip(y, -1e5, 1e5)))
