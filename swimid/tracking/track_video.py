"""Command ``track video``, which computes a log, with checks and figures, from a film and a setup."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance
from swimid.files.video import REMARK, Mpeg4, check_length, open_writer
from swimid.kinematics import swimming
from swimid.kinematics.logged import Logged
from swimid.kinematics.speed import TrackEstimate
from swimid.kinematics.swimming import MIN_WINDOW_SAMPLES, Swimming, measure_swimming
from swimid.logs import log
from swimid.logs.log import Log, runs
from swimid.notices import Notice, Progress, record_warnings, silent, warn
from swimid.options import takes
from swimid.points import point_evidence, point_files, points
from swimid.points.plane import Plane
from swimid.points.points import Posed
from swimid.results import drawing, numbers
from swimid.results import evidence as ev
from swimid.robots import file as robot_format
from swimid.tracking import frames, pose
from swimid.tracking import setup as setup_format
from swimid.tracking.frames import Array, Frame, RawTrack, Video
from swimid.tracking.options import TrackVideoOptions
from swimid.tracking.pose import SYSTEMATIC_PX, Pose, SmoothedPath
from swimid.tracking.setup import Setup
from swimid.tracking.tracker import FilmTrack, follow

#: Type of a row in the table of results: key, name, value and unit of a quantity.
Row = tuple[str, str, TrackEstimate | None, str]

#: Columns of the log whose values are checked for a wrong scale.
SCALED = ("t_s", "x_m", "y_m", "z_m", "u_m_s", "v_m_s", "w_m_s")
#: Maximum number of points of a curve in a figure (MAX_POINTS), and maximum number of shaded gaps (MAX_GAPS).
MAX_POINTS, MAX_GAPS = 1500, 60
#: Width of the film frames in the report, px, and duration of the path that is drawn into a frame, s.
IMAGE_WIDTH, TRAIL_S = 640, 2.0
#: Colours of interpolated points and of the drawn path, BGR (Okabe and Ito, for colour-blind readers).
INTERPOLATED, TRAIL = (167, 121, 204), (233, 180, 86)
#: Limits of the fraction of frames without a marker (MAX_UNSEEN), and of the relative error of a length
#: (MAX_LENGTH_ERROR). Each is a pair of values: above the first one a check warns, and above the second one
#: the check fails.
MAX_UNSEEN, MAX_LENGTH_ERROR = (0.05, 0.5), (0.02, 0.05)
#: Maximum deviation of a regular time step from the median time step, relative to the median.
JITTER = 0.25
#: Minimum normalised innovation of a measured position that counts as a jump.
JUMP_SIGMA = 6.0
#: Maximum fraction of frames in which a marker is partly hidden, or is cut by the edge of the picture.
MAX_HIDDEN_SHARE = 0.01
CAPTION = (
    "Circles: detected markers, purple where the edge of the picture cuts them. Cross and arrow: smoothed "
    "reference point and heading, orange if measured, purple if interpolated. Blue: path of the last two "
    "seconds."
)
REFERENCES = [
    "Rauch, H. E., Tung, F., Striebel, C. T. (1965). Maximum likelihood estimates of linear dynamic systems. "
    "AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166",
    "White, K. P. (1997). An effective truncation heuristic for bias reduction in simulation output. "
    "Simulation 69(6), 323-334. doi:10.1177/003754979706900601",
]


@dataclass(frozen=True, eq=False)
class Track(Logged):
    """Result of ``track_video``: log with the track of a film.

    Attributes
    ----------
    pose : Pose
        Path and heading with their standard deviations; None if the log was read from a file.
    setup : Setup
        Setup of the film. Boxes around motionless objects were added to ``ignore_px``, so that no marker is
        searched for in these boxes.
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
    """Track the markers of a film, and estimate pose, speeds and stroke of the robot.

    The setup is a file, a Setup or a dict. The log has all frames of the film, even if the speeds are
    computed from a part of it.

    Parameters
    ----------
    video : path
        A film, a folder of pictures, or a pattern of their names (``%05d.png``).
    output : path, optional
        Log to write, CSV or Parquet by its file name extension, with ``<stem>.evidence.json`` and
        ``<stem>.png`` in the same folder. :meth:`~swimid.results.result.Result.save` writes the files later.
    metadata : dict, optional
        Additional ``# key: value`` lines of the log.
    progress : Progress
        Shows the progress of each reading of the film.

    Returns
    -------
    Track
        ``.frame`` has a row for each frame: pose (m, rad; px without a scale), speeds (m/s, rad/s), their
        standard deviations, and each marker. ``.data["swimming"]`` has speed and stroke with 95 % intervals.

    Raises
    ------
    InputError, UsageError
        The film, the setup or an option cannot be used, or the window has too few frames with the markers.
    NoTrustworthyResult
        A marker is found in no frame, or in too few.

    Notes
    -----
    Positions are smoothed by the method of Rauch, Tung and Striebel (1965, doi:10.2514/3.3166). The steady
    part is found by the marginal standard error rule (White, 1997, doi:10.1177/003754979706900601).

    Examples
    --------
    >>> track_video("pool.mp4", setup="setup.yaml").frame.plot("t_s", "x_m")  # doctest: +SKIP
    """
    video, setup, overlay_path = Path(video), options.setup, options.overlay_path
    if output is not None:
        output = atomic.check_writable(output, inputs=(video, setup))
    if overlay_path is not None:
        overlay_path = atomic.check_writable(overlay_path, inputs=(video, setup, output))
    with record_warnings(repeat=True) as notices:
        run, source = _follow_film(video, options, progress)
        result, painter = _evaluate(run, source, options, metadata or {}, notices)
        if overlay_path is None:
            return result.write_output(output)
        with atomic.write_together():
            painter.write(overlay_path, progress, result)
            result = result.write_output(output)
    return replace(result, outputs=[*result.outputs, overlay_path])


def _follow_film(
    video: Path, options: TrackVideoOptions, progress: Progress
) -> tuple[FilmTrack, str | Path | Setup]:
    """Follow the markers through a film; return the track in pixels, and the setup file or the setup."""
    rules = setup_format.read_setup(options.setup)
    source = options.setup if isinstance(options.setup, str | Path) else rules
    changed = {"frame_rate_hz": options.fps, "max_gap_s": options.max_gap_s}
    rules = rules.model_copy(update={key: value for key, value in changed.items() if value is not None})
    if options.overlay_path is not None:
        film = Video(video)
        check_length(options.overlay_path, film.claimed, film.width, film.height)
    with progress(f"tracking {video.name}") as step:
        return follow(video, rules, step=step, file=str(provenance.path_of(source))), source


def _evaluate(
    run: FilmTrack,
    source: str | Path | Setup,
    options: TrackVideoOptions,
    metadata: dict[str, Any],
    notices: list[Notice],
) -> tuple[Track, Painter]:
    """Compute pose, stroke, checks, tables and figures of a tracked film; return result and painter.

    The painter draws the track into the frames of the film.
    """
    track, video, rules = run.track, run.video, run.setup
    plane = video.plane(rules, str(provenance.path_of(source)))
    _demand_markers(run)
    faults = [notice.text for notice in notices if notice.code in ("SWM043", "SWM044")]
    plane = pose.orient_plane(track, rules, plane)
    made = pose.build(track, rules, plane)
    swum = _swimming(made, (options.from_s, options.to_s))
    checks = checks_of(track, made, rules, run.kept, swum)
    if faults:
        reason = "; ".join(faults)
        checks.insert(0, ev.make_check("Frames of the film", "not all", False, "all", reason=reason))
    if swum.stroke.beat is not None:
        doubt = swum.stroke.doubt
        value, limit = f"{swum.stroke.frequency_hz:.4g} Hz", "heading and path agree"
        checks.append(_judge("SWM033", "One stroke", value, limit, not doubt, doubt))
    columns = pose.columns(made, track, rules)
    joints = _joints(columns, rules, run, provenance.path_of(source).parent)
    head = _metadata(run, plane, made.times) | metadata
    log.warn_units(Log(video.path, head, {name: columns[name] for name in SCALED if name in columns}))
    painter, facts = Painter(run, made), _facts(made, rules, swum)
    if video.pixel_aspect != 1:
        facts["Pixels"] = f"{video.pixel_aspect:.4g} times as wide as high; px count those of the file"
    if joints is not None:
        checks += point_evidence.checks(joints)
    rows = _rows(swum, rules, plane.unit)
    settings = options.settings(setup=rules.model_dump(mode="json", exclude_none=True))
    evidence = ev.Evidence(
        command="track video",
        title=f"Track of {video.path.name}",
        verdict=ev.make_verdict(_answer(made, swum), checks),
        facts=facts,
        checks=checks,
        tables=[_table(rows, swum.steady)],
        figures=_figures(made, rules, swum),
        images=painter.images(),
        notices=list(notices),
        methods=_methods(rules, made),
        references=[*REFERENCES],
        provenance=provenance.collect([video.path, source], settings=settings),
    )
    data = _data(made, rows, swum)
    if joints is not None:
        _add_joints(evidence, joints, swum)
        data["points"] = joints.data
    data["verdict"] = evidence.verdict.model_dump()
    data["checks"] = [check.model_dump() for check in checks]
    document = Log(Path(f"{video.path.stem}.csv"), head, log.numeric(columns), None)
    return Track("track video", "", data, (), evidence, document, columns, made, rules), painter


def _add_joints(evidence: ev.Evidence, joints: Posed, swum: Swimming) -> None:
    """Add facts, tables, figures and methods on the joint angles to the evidence, in place."""
    beat = point_evidence.wave_of(joints, swum.stroke.frequency_hz)
    evidence.facts["Joints"] = point_evidence.facts(joints)["Points"]
    evidence.tables += point_evidence.tables(joints, beat)
    evidence.figures += point_evidence.figures(joints, beat)
    evidence.methods += point_evidence.POINT_METHODS
    evidence.references += point_evidence.REFERENCES


def _metadata(run: FilmTrack, plane: Plane, times: Array) -> dict[str, Any]:
    """Return the metadata of the log: those of the film, and the reference point of the pose."""
    rules, video = run.setup, run.video
    head: dict[str, Any] = {
        "source": video.path.name,
        "made_by": "swimid track video",
        "frame_rate_hz": float(f"{1 / float(np.median(np.diff(times))):.6g}"),
    }
    if math.isfinite(video.first_stamp_s):
        head["first_stamp_s"] = video.first_stamp_s
    head |= {"image_size_px": [video.width, video.height], "plane": rules.plane}
    if video.pixel_aspect != 1:
        head["pixel_aspect"] = video.pixel_aspect
    if rules.plane == "vertical":
        head["facing"] = plane.faces
    if rules.places is None:
        return head | {"reference": rules.head_name}
    places = {name: list(place) for name, place in zip(rules.roles, rules.places, strict=True)}
    return head | {"reference": rules.robot or "robot", "markers_at_m": places}


def _joints(columns: dict[str, Any], setup: Setup, run: FilmTrack, folder: Path) -> Posed | None:
    """Add the joint angles that markers on other links show to the columns of a log, in place.

    The robot file places the markers (``points``). Return None without a marker on a further link.
    """
    if setup.robot is None:
        return None
    path = robot_format.locate(setup.robot, folder)
    body, up = robot_format.read(str(path)).multilink, setup.axes[0]
    if body is None:
        return None
    names = [name for name in run.track.names if name in body.points]
    if all(body.points[name].link == body.links[0].name for name in names):
        return None
    given = {"t_s": columns["t_s"]}
    for name in names:
        for ending in ("x_m", f"{up}_m", "confidence"):
            given[f"{name}_{ending}"] = np.asarray(columns[f"{name}_{ending}"], dtype=float)
    found = points.pose_of(given, point_files.Request(str(path), None, False), run.video.path)
    after = {name: columns.pop(name) for name in list(columns)[list(columns).index("frame") :]}
    columns |= {name: values for name, values in found.columns.items() if name.startswith("joint")} | after
    return found


def _demand_markers(run: FilmTrack) -> None:
    """Raise an error if a marker that the pose needs is found too rarely."""
    track, total = run.track, len(run.track.times)
    if total < 2:
        hint = "for a series of pictures name the folder, or a pattern such as %05d.png"
        text = f"has too few frames: {total}; at least 2 are needed"
        raise InputError(text, file=run.video.path, hint=hint)
    for name in run.setup.roles:
        row = track.row(name)
        count, cut = int(track.is_whole[row].sum()), int(track.at_edge[row].sum())
        if count >= max(frames.MIN_FOUND_SHARE * total, pose.MIN_SEGMENT):
            continue
        text = f"in no frame of {total}"
        if count:
            text = f"in {count} of {total} frames only"
        if cut:
            text += f" (in {cut} frames the edge of the picture cuts the marker)"
        raise NoTrustworthyResult(
            f"marker '{name}' was found {text}, which is too few for a track. "
            f"{frames.describe_colours(list(run.kept.values()))}",
            hint="'swimid track setup VIDEO -o setup.yaml' proposes markers from the video itself and draws "
            "them; or correct hsv and area_px in the setup",
        )


# ---------------------------------------------------------------- speeds and stroke


def _swimming(pose: Pose, window_s: tuple[float | None, float | None]) -> Swimming:
    """Return speeds, accelerations and stroke over a window of the track, s.

    By default the window is the steady part of the track.

    Raises
    ------
    UsageError
        The window contains too few frames with the markers.
    """
    seen, path = pose.times[pose.measured], pose.path
    begin, end = (one if one is not None else seen[k] for one, k in zip(window_s, (0, -1), strict=True))
    inside = int(((seen >= begin) & (seen <= end)).sum())
    if inside < MIN_WINDOW_SAMPLES and window_s != (None, None):
        raise UsageError(
            f"only {inside} frames with the markers are between {begin:g} and {end:g} s; the track runs from "
            f"{seen[0]:.4g} to {seen[-1]:.4g} s",
            hint="give --from and --to in seconds from the first frame",
        )
    (x,), (y,) = pose.plane.to_image(*np.nanmedian(path.position, axis=1, keepdims=True))
    error = SYSTEMATIC_PX * pose.plane.size_of_pixel(float(x), float(y))
    angle, angle_error = None, 0.0
    if pose.angle is not None and pose.separation is not None:
        angle = pose.angle.position[0]
        angle_error = math.sqrt(2) * error / max(float(np.nanmedian(pose.separation)), 1e-12)
    track = swimming.SwimTrack(
        time_s=pose.times,
        measured=pose.measured,
        raw=pose.raw,
        smooth=path.position,
        velocity=path.velocity,
        raw_angle=pose.raw_angle,
        angle=angle,
        error=error,
        angle_error=angle_error,
    )
    return measure_swimming(track, window_s)


def _rows(found: Swimming, setup: Setup, unit: str) -> list[Row]:
    """Return a row of the table of results for each speed, acceleration and amplitude of a track."""
    up, turn, _ = setup.axes
    sway = {"horizontal": "sway", "vertical": "heave"}[setup.plane]
    advance, steady = "advance speed, not steady", None
    if found.stroke.beat is None:
        advance = "displacement over time"
    if found.steady:
        steady = found.advance
    speed, rate = f"{unit}/s", f"{unit}/s^2"
    across = found.acceleration_xy or (None, None)
    rows: list[Row] = [
        ("path_speed", "path speed", found.path_speed, speed),
        ("steady_speed", "steady speed", steady, speed),
        ("advance_speed", advance, found.advance, speed),
        ("speed_change", "change of the advance speed", found.change, speed),
        ("acceleration", "acceleration along the path", found.acceleration, rate),
        ("acceleration_x", "acceleration in x", across[0], rate),
        (f"acceleration_{up}", f"acceleration in {up}", across[1], rate),
        ("stroke_frequency", "stroke frequency", found.frequency_hz, "Hz"),
    ]
    for key, name, kind in (("sway", sway, unit), ("turn", turn, "rad")):
        if key in found.amplitudes or found.stroke.beat is not None:
            rows.append((f"{name}_amplitude", f"{name} amplitude", found.amplitudes.get(key), kind))
    return rows


def _data(pose: Pose, rows: list[Row], found: Swimming) -> dict[str, Any]:
    """Return the results of a track for ``--json``; None for a value that the window does not determine."""
    count, total, unit = int(pose.measured.sum()), len(pose.times), pose.plane.unit
    noise = {unit: pose.path.measurement_sd}
    if pose.angle is not None:
        noise["rad"] = pose.angle.measurement_sd
    return {
        "frames": total,
        "found": count,
        "found_share": count / total,
        "duration_s": float(pose.times[-1]),
        "interpolated": int(pose.is_interpolated.sum()),
        "segments": int(pose.segment.max()),
        "gaps": len(pose.gaps),
        "longest_gap_s": max((end - start for start, end in pose.gaps), default=0.0),
        "unit": unit,
        "measurement_sd": noise,
        "swimming": {
            "window": found.window,
            "from_s": found.begin_s,
            "to_s": found.end_s,
            "steady": found.steady,
            "stroke_unknown": found.stroke.unknown,
            **{key: value and asdict(value) | {"unit": kind} for key, _, value, kind in rows},
        },
    }


# ---------------------------------------------------------------- checks


def _judge(
    code: str, name: str, value: str, limit: str, passed: bool, reason: str, *, fails: bool = False
) -> ev.Check:
    """Return a check. If it does not pass, it is a warning, or a failure if ``fails`` is true.

    If the check does not pass and has a code, a warning with this code is recorded, too.
    """
    if code and not passed:
        warn(code, reason)
    return ev.make_check(name, value, passed, limit, otherwise="fail" if fails else "warn", reason=reason)


def _grade(
    code: str, name: str, value: str, limit: str, size: float, limits: tuple[float, float], reason: str
) -> ev.Check:
    """Return a check of a value that warns above the first limit and fails above the second limit."""
    return _judge(code, name, value, limit, size <= limits[0], reason, fails=not size <= limits[1])


def checks_of(
    track: RawTrack,
    pose: Pose,
    setup: Setup,
    kept: dict[int, Frame] | None = None,
    swum: Swimming | None = None,
) -> list[ev.Check]:
    """Return all checks of a track in order of importance.

    ``kept`` are some frames of the film, and ``swum`` are the speeds and the stroke of the track.
    """
    return [
        *_presence(track, pose, setup),
        _motion(track, setup, swum),
        *_camera(kept or {}),
        *_looks(track),
        *_others(track, setup),
        *_separation(pose, setup),
        *_direction(pose, setup, track),
        *_timing(pose),
        *_sight(track, pose),
        *_calibration(pose),
    ]


def _presence(track: RawTrack, pose: Pose, setup: Setup) -> Iterator[ev.Check]:
    fresh, t, head = ~pose.held.repeated, pose.times, pose.rows[0]
    first, last = (int(f) for f in np.flatnonzero(pose.measured)[[0, -1]])
    # Detect that the body enters or leaves the picture: the edge of the picture cuts a marker just before the
    # first detection, or just after the last. In this case the frames without the body are not counted as
    # losses.
    cut = np.any(track.at_edge[pose.rows], axis=0)
    enters, leaves = bool(cut[first - 1 : first].any()), bool(cut[last + 1 : last + 2].any())
    count, total = int(pose.measured.sum()), int(fresh.sum())
    # Frames before the robot enters the picture and after it leaves are not losses. These frames do not count
    # as detections either.
    inside = slice(first if enters else 0, last + 1 if leaves else len(fresh))
    lost = 1 - float(pose.measured[inside][fresh[inside]].mean())
    bridged, empty = int((pose.is_interpolated & fresh).sum()), int(((pose.segment == 0) & fresh).sum())
    reason = (
        f"{total - count} of {total} frames do not show all markers whole: {bridged} of these frames are "
        f"bridged and flagged interpolated, {empty} are empty"
    )
    if count < total:
        warn("SWM040", reason)
    value = f"{count} of {total} ({100 * count / total:.1f} %)"
    passed, fails = max(lost, 1 - count / total) <= MAX_UNSEEN[0], lost > MAX_UNSEEN[1]
    yield _judge("", "Frames found", value, ">= 95 %", passed, reason, fails=fails)
    reasons = []
    if t[first] - t[0] > setup.max_gap_s:
        before = "cut by the edge of the picture before" if enters else "not detected before"
        place = f"frame {first}, at {track.x[head, first]:.0f}, {track.y[head, first]:.0f} px"
        reasons.append(f"the markers are first detected at {t[first]:.2f} s ({place}; {before})")
    if t[-1] - t[last] > setup.max_gap_s:
        after = "then they left the picture" if leaves else "not detected afterwards"
        place = f"frame {last}, at {track.x[head, last]:.0f}, {track.y[head, last]:.0f} px"
        reasons.append(f"the markers are last detected at {t[last]:.2f} of {t[-1]:.2f} s ({place}; {after})")
    value, limit = f"{t[first]:.2f} s and {t[last]:.2f} s", f"within {setup.max_gap_s:g} s of the ends"
    yield _judge("SWM065", "First and last detection", value, limit, not reasons, "; ".join(reasons))
    longest, segments = max((end - start for start, end in pose.gaps), default=0.0), int(pose.segment.max())
    reason = f"the track has {segments} segments: gaps over max_gap_s = {setup.max_gap_s:g} s are left empty"
    limit = f"<= {setup.max_gap_s:g} s"
    yield _judge("SWM047", "Longest gap", f"{longest:.3f} s", limit, segments == 1, reason)


def _motion(track: RawTrack, setup: Setup, swum: Swimming | None) -> ev.Check:
    """Check that at least one marker moves, because a motionless object passes all other checks.

    A robot that hardly leaves its place passes if its stroke turns the line between its markers by more than
    the noise. Waves also rock a floating object, but they move all of its markers in nearly the same way.
    """
    reaches = {name: track.measure_range(name) for name in setup.roles}
    name, (away, radii) = max(reaches.items(), key=lambda item: item[1][1])
    # Compute the distance that the noise of a motionless point exceeds in 0.3 % of the frames (Rayleigh
    # distribution).
    noise = math.sqrt(-2 * math.log(0.003)) * math.hypot(pose.noise_px(track, track.row(name)), SYSTEMATIC_PX)
    still = away <= noise
    extent = f"{away:.2g} px of one place, {radii:.2g} of its radius"
    reason = f"marker '{name}' stays within {extent}"
    if still:
        reason += ", which is not above the noise"
    reason += ": it may be a motionless object of the colour of the marker"
    value, limit = f"{radii:.2g} radii", f">= {frames.MIN_RADII:g} radius and {noise:.2g} px of noise"
    turns = False
    if swum is not None and "turn" in swum.amplitudes and not swum.stroke.doubt:
        head, tail = (track.row(role) for role in setup.roles)
        span = np.nanmedian(np.hypot(track.x[head] - track.x[tail], track.y[head] - track.y[tail]))
        turns = bool(swum.amplitudes["turn"].value * span > noise)
    if turns:
        limit = f">= {noise:.2g} px of noise, with a stroke that turns the robot"
    passed = (radii >= frames.MIN_RADII or turns) and not still
    return _judge("SWM067", "Motion", value, limit, passed, reason, fails=still)


def _camera(kept: dict[int, Frame]) -> Iterator[ev.Check]:
    """Check that the camera is at rest, if most of the scene can be recognised."""
    shift = frames.scene_shifts(list(kept.values()))
    if np.isfinite(shift[:, 0]).sum() < 2:
        return
    width = next(iter(kept.values())).shape[1]
    largest, limit = frames.check_camera(shift, width, ", and so do positions and speeds in the log")
    reason = f"the camera moves: the whole scene shifts by {largest:.1f} px"
    yield _judge("", "Camera", f"{largest:.1f} px", f"<= {limit:.1f} px", largest <= limit, reason)


def _others(track: RawTrack, setup: Setup) -> Iterator[ev.Check]:
    """Check how often markers other than head and tail are found, and whether they move."""
    shares = {n: float(track.is_whole[track.row(n)].mean()) for n in track.names if n not in setup.roles}
    if not shares:
        return
    worst = min(shares, key=lambda n: shares[n])
    value = f"{worst} in {100 * shares[worst]:.1f} %"
    reason = f"marker '{worst}' is found in only {100 * shares[worst]:.1f} % of the frames"
    yield _grade("", "Other markers found", value, ">= 95 %", 1 - shares[worst], MAX_UNSEEN, reason)
    still = [n for n in shares if shares[n] > 0 and track.measure_range(n)[1] < frames.MIN_RADII]
    reason = f"{', '.join(still)} stayed within one radius of one position: another object of this colour?"
    value, limit = f"{len(shares) - len(still)} of {len(shares)}", f">= {frames.MIN_RADII:g} radius"
    yield _judge("SWM067", "Other markers move", value, limit, not still, reason)


def _separation(pose: Pose, setup: Setup) -> Iterator[ev.Check]:
    """Check that the distance between head and tail marker is constant and equal to that on the robot.

    The distance must be constant over time and position.
    """
    if pose.separation is None:
        return
    known = pose.measured & np.isfinite(pose.separation)
    separation = pose.separation[known]
    middle = float(np.median(separation))
    spread = 1.4826 * float(np.median(np.abs(separation - middle))) / middle
    value = f"{middle:.4g} {pose.plane.unit} ± {100 * spread:.2f} %"
    reason = f"the distance of head and tail marker scatters by {100 * spread:.1f} %"
    yield _grade("", "Marker separation", value, "± 2 %", spread, frames.MAX_DISTANCE_SD, reason)
    design = np.column_stack([np.ones(known.sum()), *pose.raw[:, known]])
    design[:, 1:] -= design[:, 1:].mean(0)
    fit, *_ = np.linalg.lstsq(design, separation, rcond=None)
    drift = float(np.ptp(design[:, 1:] @ fit[1:])) / middle
    reason = f"the distance of head and tail marker changes by {100 * drift:.1f} % across the picture"
    name, value = "Separation across the picture", f"{100 * drift:.2f} %"
    yield _grade("SWM042", name, value, "<= 2 %", drift, MAX_LENGTH_ERROR, reason)
    if setup.places is None:
        return
    known_m = math.dist(*setup.places)
    off = middle / known_m - 1
    reason = (
        f"the distance of head and tail marker differs by {100 * off:+.1f} % from the {known_m:g} m on the "
        "robot: the scale, or the places of the markers on the robot are wrong"
    )
    name, value = "Marker distance against the robot", f"{100 * off:+.2f} % of {known_m:g} m"
    yield _grade("SWM042", name, value, "within 2 %", abs(off), MAX_LENGTH_ERROR, reason)


def _direction(pose: Pose, setup: Setup, track: RawTrack) -> Iterator[ev.Check]:
    """Check that the robot swims in the direction that head and tail define.

    The check compares the distances travelled in the opposite and in the stated direction. It fails if their
    difference exceeds the distance between the markers. It also fails if the difference exceeds both the
    radius of a marker and the longest continuous path in the stated direction. Smaller differences are
    allowed, because a robot that stays in place moves back and forth.
    """
    if pose.body_velocity is None or pose.separation is None:
        return
    step = np.gradient(pose.times) * pose.body_velocity[0]
    step = np.where(np.isfinite(step), step, 0.0)
    if setup.swims == "tail-first":
        step = -step
    ahead, astern = float(step[step > 0].sum()), float(-step[step < 0].sum())
    longest = max((float(step[a:b].sum()) for a, b in runs(step > 0)), default=0.0)
    head = pose.rows[0]
    x, y, area = (float(np.nanmedian(values[head])) for values in (track.x, track.y, track.area))
    radius = math.sqrt(area / math.pi) * pose.plane.size_of_pixel(x, y)
    least = min(float(np.nanmedian(pose.separation)), max(radius, longest))
    share, way = ahead / max(ahead + astern, 1e-300), setup.swims.replace("-", " ")
    reason = (
        f"the robot swims {way} over only {100 * share:.0f} % of the way: exchange head '{setup.head}' and "
        f"tail '{setup.tail}' in the setup, or state 'swims: head-first' or 'swims: tail-first'"
    )
    value, passed = f"{100 * share:.0f} % of the way", not astern - ahead > least
    yield _judge("SWM100", f"Swims {way}", value, "most of the way", passed, reason, fails=True)


def _timing(pose: Pose) -> Iterator[ev.Check]:
    steps = np.diff(pose.times) / np.median(np.diff(pose.times))
    share, largest = float(np.mean(np.abs(steps - 1) > JITTER)), float(steps.max())
    reason = f"{100 * share:.1f} % of the time steps are uneven (up to {largest:.1f} times the usual step)"
    value = f"{100 * share:.1f} % uneven"
    yield _judge("SWM043", "Frame timing", value, "<= 1 % uneven", share <= 0.01, reason)
    count, total = int(pose.held.repeated.sum()), len(pose.times)
    if count:
        reason = (
            f"{count} of {total} frames repeat the previous picture and are left out: pictures were taken at "
            f"{1 / pose.held.period_s:.4g} Hz, up to {1e3 * pose.held.lateness_s:.3g} ms before the frames"
        )
        yield _judge("SWM058", "Repeated pictures", f"{count} of {total}", "none", False, reason)


def _sight(track: RawTrack, pose: Pose) -> Iterator[ev.Check]:
    """Check whether markers are cut by the edge of the picture, are partly hidden, or jump."""
    count, seen = int(np.any(track.at_edge[pose.rows], axis=0).sum()), track.is_visible[pose.rows].any(axis=0)
    share = count / max(int(seen.sum()), 1)
    reason = f"in {count} frames the edge of the picture cuts a marker; these frames count as not found"
    if count:
        warn("SWM045", reason)
    value = f"{count} frames"
    yield _judge("", "At the edge of the picture", value, "<= 1 %", share <= MAX_HIDDEN_SHARE, reason)
    off, measured = pose.hidden[pose.rows].max(axis=0), max(int(pose.measured.sum()), 1)
    count = int(np.sum(off > 0))
    reason = (
        f"in {count} frames a marker is hidden in part or seen at an angle; the centre may be wrong by "
        f"{off.max():.1f} px in frame {int(np.argmax(off))}"
    )
    passed = count / measured <= MAX_HIDDEN_SHARE
    yield _judge("SWM066", "Hidden in part", f"{count} frames", "<= 1 %", passed, reason)
    innovations = [one.innovation for one in (pose.path, pose.angle) if one is not None]
    far = np.nanmax(np.abs(np.concatenate(innovations)), axis=0, initial=0.0) > JUMP_SIGMA
    count, limit = int(far.sum()), f"0 beyond {JUMP_SIGMA:g} sigma"
    reason = f"{count} measurements jump: check the overlay, for example at frame {int(np.argmax(far))}"
    yield _grade("", "Jumps", f"{count} frames", limit, count / measured, (0.0, 0.02), reason)


def _calibration(pose: Pose) -> Iterator[ev.Check]:
    plane = pose.plane
    if plane.unit == "px":
        reason = "positions are in pixels: the setup has no scale"
        yield _judge("", "Calibration", "none", "a scale", False, reason)
    elif plane.residual_px > 1e-2:
        value = f"{plane.residual_px:.2f} px, {1000 * plane.residual:.2f} mm rms"
        reason = f"the calibration points have a residual of {plane.residual_px:.1f} px"
        yield _grade("", "Calibration", value, "<= 1 px", plane.residual_px, (1.0, 4.0), reason)


def _looks(track: RawTrack) -> Iterator[ev.Check]:
    """Check whether another object was taken for a marker, or may be the true marker."""
    for name, text in track.others.items():
        yield _judge("SWM172", f"Objects like {name}", "more than markers", "one each", False, text)
    for name, (count, area) in track.mistaken.items():
        now = float(np.nanmedian(track.area[track.row(name)]))
        value = f"an object of {area:.0f} px in {count} frames, then an object of {now:.0f} px"
        reason = f"marker '{name}' was first confused with another object: {value}, which stayed longer"
        yield _judge("SWM064", f"Object followed as {name}", value, "one object", False, reason)


# ---------------------------------------------------------------- evidence


def _answer(pose: Pose, found: Swimming) -> str:
    """Return the verdict on a track as a sentence: fraction of frames with markers, speed, and frequency."""
    text = f"Markers found in {100 * pose.measured.mean():.1f} % of the frames"
    kind, speed = "path", found.path_speed
    if found.steady:
        kind, speed = "steady", found.advance
    if speed is not None:
        text += f", {kind} speed {numbers.format_number(speed.value, 4, f'{pose.plane.unit}/s')}"
    if found.frequency_hz is not None:
        text += f", stroke {numbers.format_number(found.frequency_hz.value, 4, 'Hz')}"
    return f"{text}."


def _facts(pose: Pose, setup: Setup, found: Swimming) -> dict[str, str]:
    """Return the main properties of a track as short texts, each with its name."""
    unit, count = pose.plane.unit, int(pose.measured.sum())
    noise = f"{pose.path.measurement_sd:.2g} {unit}"
    if pose.angle is not None:
        noise += f", heading {pose.angle.measurement_sd:.2g} rad"
    facts = {
        "Found": f"{count} of {len(pose.times)} frames, {int(pose.is_interpolated.sum())} bridged",
        "Measurement noise": noise,
    }
    if setup.plane == "vertical":
        facts["Faces"] = pose.plane.faces
    windows = {"given": "as given", "whole track": "the whole track: no part of it is steady"}
    window = windows.get(found.window, "the steady part")
    facts["Speeds over"] = f"{found.begin_s:.4g} to {found.end_s:.4g} s, {window}"
    if found.stroke.beat is None:
        facts["Stroke"] = f"unknown: {found.stroke.unknown}"
    return facts


def _table(rows: list[Row], steady: bool) -> ev.Table:
    """Return the table of speeds, accelerations and amplitudes with intervals. Angles are in degrees."""
    shown: list[dict[str, ev.Cell]] = []
    for key, name, value, kind in rows:
        if value is not None and not (key == "advance_speed" and steady):
            factor, unit = numbers.in_degrees(kind)
            best, low, high = (factor * one for one in astuple(value))
            words = numbers.unit_text(unit)
            shown.append({"quantity": name, "value": best, "95 % from": low, "to": high, "unit": words})
    return ev.make_table(
        "swimming",
        "Speed and stroke",
        shown,
        "The path speed includes sway and turns; steady and advance speed are those of the path averaged "
        "over a stroke. Amplitudes are half of peak to peak of the fundamental.",
        columns=["quantity", "value", "95 % from", "to", "unit"],
    )


def _methods(setup: Setup, pose: Pose) -> list[str]:
    """Return sentences that describe the tracking method, for the methods section of a paper."""
    kinds = {2: "constant velocity with white acceleration", 3: "constant acceleration with white jerk"}
    markers = {1: "a marker", 2: "two markers"}[len(setup.roles)]
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
    """Return the figures of a track: path, coordinates with their bands, and speeds with the window."""
    unit, t = pose.plane.unit, pose.times
    up, turn, side = setup.axes
    spans = [ev.Span(start=start, end=end, label="gap") for start, end in pose.gaps][:MAX_GAPS]
    every = slice(None, None, max(len(t) // MAX_POINTS, 1))
    raw_x, raw_y = pose.raw[:, every]

    def over_time(label: str, traces: Sequence[ev.Trace], marks: Sequence[ev.Mark] = ()) -> ev.Panel:
        return ev.panel("time (s)", label, traces, spans=spans, marks=list(marks))

    def plot_coordinate(
        label: str, values: SmoothedPath, row: int, raw: Array, factor: float = 1.0
    ) -> ev.Panel:
        smooth, sd = factor * values.position[row, every], factor * values.position_sd[row, every]
        marks = ev.select_marks(t[every], raw)
        seen_t, seen = t[every][marks], factor * raw[marks]
        measured = ev.Trace(x=seen_t, y=seen, label="measured", style="points", group=0)
        return over_time(label, [measured, ev.band(t[every], smooth, 1.96 * sd, label="smoothed", group=0)])

    coordinates = [
        plot_coordinate(f"x ({unit})", pose.path, 0, raw_x),
        plot_coordinate(f"{up} ({unit})", pose.path, 1, raw_y),
    ]
    names = (f"speed along x ({unit}/s)", f"speed along {up} ({unit}/s)")
    speeds = dict(zip(names, pose.path.velocity, strict=True))
    if pose.angle is not None and pose.raw_angle is not None and pose.body_velocity is not None:
        degrees, raw_angle = np.degrees(1.0), pose.raw_angle[every]
        coordinates.append(plot_coordinate(f"{turn} (°)", pose.angle, 0, raw_angle, degrees))
        sideways = numbers.BODY_SPEEDS[f"{side}_m_s"]
        names = (f"surge speed ({unit}/s)", f"{sideways} ({unit}/s)")
        speeds = dict(zip(names, pose.body_velocity, strict=True))
        speeds[f"{turn} rate (°/s)"] = degrees * pose.angle.velocity[0]
    begin = ev.Mark(at=found.begin_s, axis="x", label="averaging window")
    window = [begin, ev.Mark(at=found.end_s, axis="x")]
    seen = np.ones(len(t), dtype=bool)
    for start, end in pose.gaps:
        seen &= (t <= start) | (t >= end)
    curves = {label: ev.Trace(x=t[every], y=np.where(seen, v, np.nan)[every]) for label, v in speeds.items()}
    return [
        _path_figure(pose, f"x ({unit})", f"{up} ({unit})", every),
        ev.panels(
            "pose",
            "Pose over time",
            "Measured points, thinned, and the smoothed pose; gaps are shaded.",
            coordinates,
        ),
        ev.panels(
            "speed",
            "Speeds",
            "Derivatives of the smoothed pose, without gaps. Mean values are taken between the dashed lines.",
            [over_time(label, [curve], window) for label, curve in curves.items()],
        ),
    ]


def _path_figure(pose: Pose, x_title: str, y_title: str, every: slice) -> ev.Figure:
    """Return the figure of the measured and the smoothed path, thinned to some frames."""
    (x, y), (raw_x, raw_y) = pose.path.position[:, every], pose.raw[:, every]
    first = np.flatnonzero(np.isfinite(x) & np.isfinite(y))[:1]
    path = [
        ev.Trace(x=raw_x, y=raw_y, label="measured", style="points", group=0),
        ev.Trace(x=x, y=y, label="smoothed", group=0),
        ev.Trace(x=x[first], y=y[first], style="points", label="start", group=1),
    ]
    about = "Path of the reference point."
    if pose.gaps:
        about += " The line without points is a gap."
    return ev.make_figure("path", "Path", about, x_title, y_title, path, equal_aspect=True)


# ---------------------------------------------------------------- frames with the track drawn in


class Painter:
    """Painter that draws a track into the frames of its film."""

    def __init__(self, run: FilmTrack, pose: Pose) -> None:
        self.run, self.track, self.pose = run, run.track, pose
        self._path = pose.plane.to_image(*pose.path.position)
        self._tip: Array | None = None
        if pose.angle is not None and pose.separation is not None:
            length, angle = float(np.nanmedian(pose.separation)), pose.angle.position[0]
            ahead = pose.path.position + length * np.stack([np.cos(angle), np.sin(angle)])
            self._tip = pose.plane.to_image(*ahead)

    def draw(self, i: int, frame: Frame) -> Frame:
        """Draw path, markers, heading and a line of text into frame ``i``, in place; return the frame."""
        size = max(frame.shape[1] / 960, 0.5)
        line = max(round(1.5 * size), 1)
        times = self.track.times
        trail = self._path[:, np.searchsorted(times, times[i] - TRAIL_S) : i + 1]
        for start, end in runs(np.isfinite(trail[0])):
            if end - start > 1:
                points = np.round(8 * trail[:, start:end].T).astype(np.int32).reshape(-1, 1, 2)
                cv2.polylines(frame, [points], False, TRAIL, line, cv2.LINE_AA, shift=3)
        for m in np.flatnonzero(self.track.status[:, i] != frames.LOST):
            radius = int(np.sqrt(self.track.area[m, i] / np.pi) + 4 * size)
            colour = INTERPOLATED if self.track.at_edge[m, i] else frames.MEASURED
            centre = _to_fixed_point(self.track.x[m, i], self.track.y[m, i])
            cv2.circle(frame, centre, 8 * radius, colour, line, cv2.LINE_AA, shift=3)
        here = self._path[:, i]
        if np.isfinite(here[0]):
            colour = frames.MEASURED if self.pose.measured[i] else INTERPOLATED
            if self._tip is not None and np.isfinite(self._tip[0, i]):
                ends = _to_fixed_point(*here), _to_fixed_point(*self._tip[:, i])
                cv2.arrowedLine(frame, *ends, colour, line, cv2.LINE_AA, 3, 0.2)
            place = tuple(np.round(here).astype(int))
            cv2.drawMarker(frame, place, colour, cv2.MARKER_CROSS, int(14 * size), line, cv2.LINE_AA)
        place = (int(8 * size), int(frame.shape[0] - 10 * size))
        frames.draw_text(frame, f"{times[i]:.2f} s  frame {i}", place, 0.55 * size, line)
        return frame

    def images(self) -> list[ev.Image]:
        """Return the stored frames of the film for the report, with the track drawn into them."""
        images = []
        for i, frame in self.run.kept.items():
            drawn = frames.reduce_frame(
                self.run.video.to_square_pixels(self.draw(i, frame.copy())), IMAGE_WIDTH
            )
            data = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
            title = f"Frame {i}, t = {self.track.times[i]:.2f} s"
            image = {"media_type": "image/jpeg", "base64": base64.b64encode(data).decode()}
            images.append(ev.Image(id=f"frame-{i}", title=title, caption=CAPTION, **image))
        return images

    def write(self, path: Path, progress: Progress, result: Track) -> None:
        """Write a copy of the film with the track drawn into it; add a remark on its format to the evidence.

        The film is decoded again, because the track is known only after the film was read once, and its
        frames do not fit into memory. The second decoding takes an eighth of the time of tracking with an
        overlay.
        """
        times, source = self.track.times, self.run.video
        width, height = round(source.pixel_aspect * source.width) // 2 * 2, source.height // 2 * 2
        rate = 1 / float(np.median(np.diff(times)))
        again = Video(source.path).frames()
        with atomic.replace_file(path) as temporary, progress("overlay", total=len(times)) as step:
            writer = open_writer(temporary, rate, width, height)
            try:
                for i, (time, (_, frame)) in enumerate(zip(times, again, strict=False)):
                    drawn = source.to_square_pixels(self.draw(i, frame))
                    writer.write(float(time), drawn[:height, :width])
                    step()
            finally:
                writer.close()
        if isinstance(writer, Mpeg4) and result.evidence is not None:
            result.evidence.notes.append(REMARK.format("overlay"))


def _to_fixed_point(x: float, y: float) -> tuple[int, int]:
    """Return a picture position in eighths of a pixel, the unit in which OpenCV draws with ``shift=3``."""
    return round(8 * float(np.clip(x, -1e5, 1e5))), round(8 * float(np.clip(y, -1e5, 1e5)))
