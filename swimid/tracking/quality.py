"""Quality of a track: motion of markers, distance between markers, motion of the camera, and checks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from swimid.logs.log import runs
from swimid.notices import warn
from swimid.results.evidence import Check, check
from swimid.tracking.detect import RawTrack
from swimid.tracking.pose import SYSTEMATIC_PX, Pose, noise_px
from swimid.tracking.reader import Frame, reduced
from swimid.tracking.setup import Setup

Array = NDArray[np.float64]

#: Minimum number of detections for statistics of a marker.
MIN_DETECTIONS = 10
#: Minimum range of motion of a marker, in radii. A motionless object that is seen through ripples, or is
#: covered at times, has a smaller range.
MIN_RADII = 1.0
#: Minimum fraction of frames in which a marker is found.
MIN_SHARE = 0.05
#: Maximum relative deviations, each as a pair: above the first value a check does not pass, and above the
#: second it fails. They apply to the standard deviation of the distance between two markers on a rigid part,
#: to the fraction of frames without a marker, and to errors of lengths.
MAX_DISTANCE_SD, MAX_UNSEEN, MAX_LENGTH_ERROR = (0.02, 0.06), (0.05, 0.5), (0.02, 0.05)
#: Width to which frames are reduced before they are compared, px.
SCENE_WIDTH = 480
#: Maximum shift of the scene for a camera at rest, px of the reduced picture.
MAX_SHIFT_PX = 2.0
#: Maximum deviation of a regular time step from the median step, relative to the median step.
JITTER = 0.25
#: Minimum normalised innovation of a measurement that counts as a jump.
JUMP_SIGMA = 6.0
#: Maximum fraction of frames in which a marker is partly hidden, or is cut by the edge of the picture.
MAX_HIDDEN_SHARE = 0.01


def measure_range(track: RawTrack, name: str, scene: Array | None = None) -> tuple[float, float]:
    """Return the range of motion of a marker, in px and in radii of the marker.

    Both are 0 if the marker is found in less than :data:`MIN_SHARE` of the frames.
    The range is the 95th percentile of the distance from the median position, over detections of the whole
    marker. ``scene``, shape (2, n), is the shift of the whole scene in each frame, px.
    """
    i = track.row(name)
    seen = track.found[i]
    if seen.mean() < MIN_SHARE:
        return 0.0, 0.0
    area = track.area[i]
    usual = float(np.median(area[seen]))
    # Detections with another area show only a part of the marker. The centre of this part moves if the
    # covered part changes. With this limit of the area, the centre of a bar 20 times as long as wide moves by
    # 0.6 radii if objects pass in front of it.
    whole = seen & (np.abs(area - usual) <= 0.15 * usual)
    part = whole if whole.sum() >= MIN_DETECTIONS else seen
    place = np.stack([track.x[i], track.y[i]])
    if scene is not None:
        place = place - scene
    away = np.hypot(*(place[:, part] - np.median(place[:, part], axis=1, keepdims=True)))
    reach = float(np.percentile(away, 95))
    return reach, reach / max(math.sqrt(usual / math.pi), 1.0)


def marker_fault(
    track: RawTrack, name: str, min_share: float = MIN_SHARE, scene: Array | None = None
) -> tuple[str, str]:
    """Return the code and the text of a warning if a marker is hardly found or does not move.

    Code and text are empty otherwise. ``scene`` is that of :func:`measure_range`.
    """
    share, (_, radii) = float(track.found[track.row(name)].mean()), measure_range(track, name, scene)
    if share < min_share:
        return "SWM040", f"cannot be followed (found in {100 * share:.1f} % of the frames)"
    if radii < MIN_RADII:
        return "SWM067", f"does not move (stays within {radii:.2g} of its radius of one place)"
    return "", ""


def head_first(track: RawTrack, head: str, tail: str) -> float | None:
    """Return the fraction of steps in which two markers move towards the head.

    The result is None for fewer than 4 steps.
    """
    i, j = track.row(head), track.row(tail)
    # the film is divided into about 100 steps
    every = slice(None, None, max(len(track.times) // 100, 1))
    front, rear = (np.stack(track.centre(row))[:, every] for row in (i, j))
    line = front - rear
    length = np.hypot(*line)
    # If a distance is far from its median, one of the detections is false. An inclined camera changes the
    # distance by less.
    sound = np.abs(length / np.nanmedian(length) - 1) <= 0.3
    ahead = np.sum(np.diff(front + rear, axis=1) * line[:, :-1], axis=0)[sound[1:] & sound[:-1]]
    return float(np.mean(ahead > 0)) if len(ahead) >= 4 else None


def distance_change(track: RawTrack, one: str, other: str) -> float | None:
    """Return the relative change of the distance between two markers, without the effect of perspective.

    The change is the larger of two values: the robust standard deviation of the distance after rectification,
    and the change due to the rectification that the areas of the markers do not confirm. It is None if the
    markers are hardly ever found together.

    Notes
    -----
    An inclined camera shows a length smaller where it is further away, and shorter along the view than across
    it. Therefore the picture is first rectified by the homography ``M p / (1 + l p)``, with M symmetric of
    trace 2, for which the distance varies least. Equal lengths determine the homography up to a similarity
    (Liebowitz and Zisserman 1998, Metric rectification for perspective images of planes, CVPR,
    doi:10.1109/CVPR.1998.698649). M is the identity if the heading changes by no more than the body may bend.
    The same homography changes the areas of the markers. A change of the distance without the corresponding
    change of the areas is not due to perspective.
    """
    i, j = track.row(one), track.row(other)
    both = track.found[i] & track.found[j]
    if both.sum() < MIN_DETECTIONS:
        return None
    points = np.stack([track.x[[i, j]][:, both], track.y[[i, j]][:, both]])  # (xy, marker, frame)
    middle = points.mean(axis=(1, 2), keepdims=True)
    points = (points - middle) / max(float(np.abs(points - middle).max()), 1.0)
    heading = np.unwrap(np.arctan2(*(points[:, 0] - points[:, 1])[::-1]))
    # if the heading changes by less, a bend of the body may change the distance
    turns = float(np.ptp(heading)) > math.radians(60.0)

    def scatter_of(view: Array) -> Array:
        apart = np.log(np.maximum(np.hypot(*np.diff(_rectified(points, view), axis=1)[:, 0]), 1e-9))
        return np.asarray(apart - np.median(apart))

    bound = np.array([0.7, 0.7, 0.6, 0.6])[: 4 if turns else 2]
    view = least_squares(scatter_of, np.zeros(len(bound)), bounds=(-bound, bound), loss="soft_l1").x
    left = scatter_of(view)
    place = points.mean(axis=1)
    shrunk = -1.5 * np.log1p(view[:2] @ place)
    size = 0.5 * np.log(track.area[[i, j]][:, both].sum(axis=0))
    design = np.column_stack([np.ones(both.sum()), *place])
    smooth, unshared = (design @ np.linalg.lstsq(design, v, rcond=None)[0] for v in (size, size + shrunk))
    # the outline of a patch is known to one pixel, so that the areas of small markers are uncertain
    blurred = float(np.ptp(math.sqrt(2 * math.pi) / np.exp(smooth)))
    drift = min(float(np.ptp(shrunk)), max(float(np.ptp(unshared)) - blurred, 0.0))
    return max(1.4826 * float(np.median(np.abs(left))), drift)


def _rectified(points: Array, view: Array) -> Array:
    """Return image points, shape (2, m, n), rectified; ``view`` contains l and the two parameters of M."""
    a, b = (*view[2:], 0.0, 0.0)[:2]
    x, y = points
    return np.stack([(1 + a) * x + b * y, b * x + (1 - a) * y]) / (1 + view[0] * x + view[1] * y)


def scene_shifts(frames: Sequence[Frame]) -> Array:
    """Return the shift of the scene in each frame from the first frame.

    Parameters
    ----------
    frames : sequence of n frames
        Frames of one size.

    Returns
    -------
    ndarray, shape (n, 2)
        Shift in px, x to the right and y down; NaN if most corners have no common shift (ripples, plain
        water, another scene).

    Notes
    -----
    Corners of the first frame are followed forwards and backwards by the pyramidal optical flow of Lucas and
    Kanade (Bouguet 2001). The shift is the median over the corners that return to their initial position.
    """
    out = np.full((len(frames), 2), np.nan)
    if not frames:
        return out
    factor = max(frames[0].shape[1] / SCENE_WIDTH, 1.0)
    greys = (np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), np.uint8) for frame in frames)
    small = [reduced(grey, SCENE_WIDTH) for grey in greys]
    # up to 300 corners are used, and at least 12 are needed
    corners = cv2.goodFeaturesToTrack(small[0], 300, 0.02, 7)
    if corners is None or len(corners) < 12:
        return out
    for k, picture in enumerate(small):
        there, found, _ = cv2.calcOpticalFlowPyrLK(small[0], picture, corners, None)
        back, again, _ = cv2.calcOpticalFlowPyrLK(picture, small[0], there, None)
        sound = (found[:, 0] > 0) & (again[:, 0] > 0)
        # the corner that is followed backwards must end within half a pixel of its start
        sound &= np.linalg.norm((back - corners)[:, 0], axis=1) < 0.5
        if not sound.any():
            continue
        flow = (there - corners)[sound, 0]
        middle = np.median(flow, axis=0)
        # corners belong to the scene if their shift is within one pixel of the median
        alike = np.linalg.norm(flow - middle, axis=1) < 1.0
        # These corners must be half of all corners, and must be in 8 of 4 x 4 cells of the picture: a robot
        # near the camera may contain most of the corners.
        cells = (corners[sound, 0][alike] * 4 / np.array(picture.shape[::-1])).astype(int)
        if alike.sum() >= 0.5 * len(corners) and len(np.unique(cells, axis=0)) >= 8:
            out[k] = factor * middle
    return out


def interpolate_shifts(shift: Array, indices: NDArray[np.int64], count: int) -> Array | None:
    """Return the shift in all ``count`` frames, interpolated from some frames, shape (2, count).

    The result is None if the shift is known in fewer than two frames.
    """
    known = np.isfinite(shift[:, 0])
    if known.sum() < 2:
        return None
    frames = np.arange(count)
    return np.array([np.interp(frames, indices[known], row[known]) for row in shift.T])


def check_camera(shift: Array, width: int, consequence: str) -> tuple[float, float]:
    """Return the maximum shift of the scene and its limit for a ``width`` in px; warn if it is exceeded."""
    largest = float(np.nanmax(np.hypot(*shift.T), initial=0.0))
    limit = MAX_SHIFT_PX * max(width / SCENE_WIDTH, 1.0)
    if largest > limit:
        text = f"the whole scene shifts by {largest:.1f} px in the film: the camera moves"
        warn("SWM068", f"{text}{consequence}")
    return largest, limit


# ---------------------------------------------------------------- checks


def _judged(
    code: str, name: str, value: str, limit: str, passed: bool, reason: str, *, fails: bool = False
) -> Check:
    """Return a check that warns or fails. Record a warning if the check does not pass and has a code."""
    if code and not passed:
        warn(code, reason)
    return check(name, value, passed, limit, otherwise="fail" if fails else "warn", reason=reason)


def _graded(
    code: str, name: str, value: str, limit: str, size: float, limits: tuple[float, float], reason: str
) -> Check:
    """Return a check of a size that passes up to the first limit, and fails beyond the second limit."""
    return _judged(code, name, value, limit, size <= limits[0], reason, fails=not size <= limits[1])


def checks(track: RawTrack, pose: Pose, setup: Setup, kept: dict[int, Frame] | None = None) -> list[Check]:
    """Return all checks of a track in order of importance; ``kept`` are some of its frames."""
    return [
        *_presence(track, pose, setup),
        _motion(track, setup),
        *_camera(kept or {}),
        *_others(track, setup),
        *_separation(pose, setup),
        *_direction(pose, setup, track),
        *_timing(pose),
        *_sight(track, pose),
        *_calibration(pose),
        *_looks(track),
    ]


def _presence(track: RawTrack, pose: Pose, setup: Setup) -> Iterator[Check]:
    fresh, t, head = ~pose.held.repeated, pose.times, pose.rows[0]
    first, last = (int(f) for f in np.flatnonzero(pose.measured)[[0, -1]])
    # if the edge of the picture cuts a marker just before the first detection, or just after the last, the
    # body is not lost but outside the picture
    cut = np.any(track.at_edge[pose.rows], axis=0)
    enters, leaves = bool(cut[first - 1 : first].any()), bool(cut[last + 1 : last + 2].any())
    count, total = int(pose.measured.sum()), int(fresh.sum())
    # frames before the robot enters and after it leaves are not losses, but do not count as found either
    inside = slice(first if enters else 0, last + 1 if leaves else len(fresh))
    lost = 1 - float(pose.measured[inside][fresh[inside]].mean())
    bridged, empty = int((pose.interpolated & fresh).sum()), int(((pose.segment == 0) & fresh).sum())
    reason = (
        f"{total - count} of {total} frames show no marker (not all of them, or not whole): {bridged} are "
        f"bridged and flagged interpolated, {empty} are empty"
    )
    if count < total:
        warn("SWM040", reason)
    value = f"{count} of {total} ({100 * count / total:.1f} %)"
    passed, fails = max(lost, 1 - count / total) <= MAX_UNSEEN[0], lost > MAX_UNSEEN[1]
    yield _judged("", "Frames found", value, ">= 95 %", passed, reason, fails=fails)
    reasons = []
    if t[first] - t[0] > setup.max_gap_s:
        before = "cut by the edge of the picture before" if enters else "nothing of it before"
        place = f"frame {first}, at {track.x[head, first]:.0f}, {track.y[head, first]:.0f} px"
        reasons.append(f"first seen at {t[first]:.2f} s ({place}; {before})")
    if t[-1] - t[last] > setup.max_gap_s:
        after = "then it left the picture" if leaves else "then it is lost for good"
        place = f"frame {last}, at {track.x[head, last]:.0f}, {track.y[head, last]:.0f} px"
        reasons.append(f"last seen at {t[last]:.2f} s of {t[-1]:.2f} s ({place}; {after})")
    value, limit = f"{t[first]:.2f} s and {t[last]:.2f} s", f"within {setup.max_gap_s:g} s of the ends"
    yield _judged("SWM065", "First and last sight", value, limit, not reasons, "; ".join(reasons))
    longest, segments = max((end - start for start, end in pose.gaps), default=0.0), int(pose.segment.max())
    reason = f"the track has {segments} segments: gaps over max_gap_s = {setup.max_gap_s:g} s are left empty"
    limit = f"<= {setup.max_gap_s:g} s"
    yield _judged("SWM047", "Longest gap", f"{longest:.3f} s", limit, segments == 1, reason)


def _motion(track: RawTrack, setup: Setup) -> Check:
    """Check that the marker with the largest range moves. A motionless object passes all other checks."""
    reaches = {name: measure_range(track, name) for name in setup.roles}
    name, (away, radii) = max(reaches.items(), key=lambda item: item[1][1])
    # distance that the noise of a motionless point exceeds in 0.3 % of the frames (Rayleigh distribution)
    noise = math.sqrt(-2 * math.log(0.003)) * math.hypot(noise_px(track, track.row(name)), SYSTEMATIC_PX)
    still = away <= noise
    extent = f"{away:.2g} px of one place, {radii:.2g} of its radius"
    reason = f"marker '{name}' stays within {extent}"
    if still:
        reason += ", which is its noise"
    reason += ": is it the marker, or a motionless object of its colour?"
    value, limit = f"{radii:.2g} radii", f">= {MIN_RADII:g} radius and {noise:.2g} px of noise"
    passed = radii >= MIN_RADII and not still
    return _judged("SWM067", "Motion", value, limit, passed, reason, fails=still)


def _camera(kept: dict[int, Frame]) -> Iterator[Check]:
    """Check that the camera is at rest, if most of the scene can be recognised."""
    shift = scene_shifts(list(kept.values()))
    if np.isfinite(shift[:, 0]).sum() < 2:
        return
    width = next(iter(kept.values())).shape[1]
    largest, limit = check_camera(shift, width, ", and so do positions and speeds in the log")
    reason = f"the camera moves: the whole scene shifts by {largest:.1f} px"
    yield _judged("", "Camera", f"{largest:.1f} px", f"<= {limit:.1f} px", largest <= limit, reason)


def _others(track: RawTrack, setup: Setup) -> Iterator[Check]:
    """Check how often the markers that the pose does not need are found, and whether they move."""
    shares = {n: float(track.found[track.row(n)].mean()) for n in track.names if n not in setup.roles}
    if not shares:
        return
    worst = min(shares, key=lambda n: shares[n])
    value = f"{worst} in {100 * shares[worst]:.1f} %"
    reason = f"marker '{worst}' is found in {100 * shares[worst]:.1f} % of the frames only"
    yield _graded("", "Other markers found", value, ">= 95 %", 1 - shares[worst], MAX_UNSEEN, reason)
    still = [n for n in shares if shares[n] > 0 and measure_range(track, n)[1] < MIN_RADII]
    reason = f"markers never left the radius of one place: {', '.join(still)}. Are they still things?"
    value, limit = f"{len(shares) - len(still)} of {len(shares)}", f">= {MIN_RADII:g} radius"
    yield _judged("SWM067", "Other markers move", value, limit, not still, reason)


def _separation(pose: Pose, setup: Setup) -> Iterator[Check]:
    """Check that the distance between two markers is constant and equal to that on the robot.

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
    yield _graded("", "Marker separation", value, "± 2 %", spread, MAX_DISTANCE_SD, reason)
    design = np.column_stack([np.ones(known.sum()), *pose.raw[:, known]])
    design[:, 1:] -= design[:, 1:].mean(0)
    fit, *_ = np.linalg.lstsq(design, separation, rcond=None)
    drift = float(np.ptp(design[:, 1:] @ fit[1:])) / middle
    reason = f"the distance of head and tail marker changes by {100 * drift:.1f} % across the picture"
    name, value = "Separation across the picture", f"{100 * drift:.2f} %"
    yield _graded("SWM042", name, value, "<= 2 %", drift, MAX_LENGTH_ERROR, reason)
    if setup.places is None:
        return
    known_m = math.dist(*setup.places)
    off = middle / known_m - 1
    reason = (
        f"the distance of head and tail marker is {100 * off:+.1f} % off the {known_m:g} m on the robot, and "
        "so is every length in the log, or their places on the robot are wrong"
    )
    name, value = "Marker distance against the robot", f"{100 * off:+.2f} % of {known_m:g} m"
    yield _graded("SWM042", name, value, "within 2 %", abs(off), MAX_LENGTH_ERROR, reason)


def _direction(pose: Pose, setup: Setup, track: RawTrack) -> Iterator[Check]:
    """Check that the robot swims in the direction that head and tail define.

    The check compares the distances travelled in the other and in the stated direction. It fails if their
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
        f"the robot swims {way} over {100 * share:.0f} % of its way only: exchange head '{setup.head}' and "
        f"tail '{setup.tail}' in the setup, or say there how it swims (swims: head-first or tail-first)"
    )
    value, passed = f"{100 * share:.0f} % of the way", not astern - ahead > least
    yield _judged("SWM100", f"Swims {way}", value, "most of the way", passed, reason, fails=True)


def _timing(pose: Pose) -> Iterator[Check]:
    steps = np.diff(pose.times) / np.median(np.diff(pose.times))
    share, largest = float(np.mean(np.abs(steps - 1) > JITTER)), float(steps.max())
    reason = f"{100 * share:.1f} % of the frames come at uneven steps (up to {largest:.1f} times the usual)"
    value = f"{100 * share:.1f} % uneven"
    yield _judged("SWM043", "Frame timing", value, "<= 1 % uneven", share <= 0.01, reason)
    count, total = int(pose.held.repeated.sum()), len(pose.times)
    if count:
        reason = (
            f"{count} of {total} pictures repeat the one before and are left out: the camera took "
            f"{1 / pose.held.period_s:.4g} pictures/s, up to {1e3 * pose.held.lateness_s:.3g} ms early"
        )
        yield _judged("SWM058", "Repeated pictures", f"{count} of {total}", "none", False, reason)


def _sight(track: RawTrack, pose: Pose) -> Iterator[Check]:
    """Check whether the edge of the picture cuts markers, and whether markers are partly hidden or jump."""
    count, seen = int(np.any(track.at_edge[pose.rows], axis=0).sum()), track.seen[pose.rows].any(axis=0)
    share = count / max(int(seen.sum()), 1)
    reason = f"in {count} frames the edge of the picture cuts a marker; these frames count as not found"
    if count:
        warn("SWM045", reason)
    value = f"{count} frames"
    yield _judged("", "At the edge of the picture", value, "<= 1 %", share <= MAX_HIDDEN_SHARE, reason)
    off, measured = pose.hidden[pose.rows].max(axis=0), max(int(pose.measured.sum()), 1)
    count = int(np.sum(off > 0))
    reason = (
        f"in {count} frames a marker is hidden in part or seen aslant; its centre may be {off.max():.1f} "
        f"px off in frame {int(np.argmax(off))}"
    )
    passed = count / measured <= MAX_HIDDEN_SHARE
    yield _judged("SWM066", "Hidden in part", f"{count} frames", "<= 1 %", passed, reason)
    innovations = [one.innovation for one in (pose.path, pose.angle) if one is not None]
    far = np.nanmax(np.abs(np.concatenate(innovations)), axis=0, initial=0.0) > JUMP_SIGMA
    count, limit = int(far.sum()), f"0 beyond {JUMP_SIGMA:g} sigma"
    reason = f"{count} measurements jump, the first in frame {int(np.argmax(far))}: is it the marker?"
    yield _graded("", "Jumps", f"{count} frames", limit, count / measured, (0.0, 0.02), reason)


def _calibration(pose: Pose) -> Iterator[Check]:
    plane = pose.plane
    if plane.unit == "px":
        reason = "positions are in pixels: the setup has no scale"
        yield _judged("", "Calibration", "none", "a scale", False, reason)
    elif plane.residual_px > 1e-2:
        value = f"{plane.residual_px:.2f} px, {1000 * plane.residual:.2f} mm rms"
        reason = f"the calibration points misfit by {plane.residual_px:.1f} px"
        yield _graded("", "Calibration", value, "<= 1 px", plane.residual_px, (1.0, 4.0), reason)


def _looks(track: RawTrack) -> Iterator[Check]:
    """Check whether another object was taken for a marker first."""
    for name, (count, area) in track.mistaken.items():
        now = float(np.nanmedian(track.area[track.row(name)]))
        value = f"an object of {area:.0f} px in {count} frames, then one of {now:.0f} px"
        reason = f"marker '{name}' was first confused with another object: {value}, which stayed longer"
        yield _judged("SWM064", f"Object followed as {name}", value, "one object", False, reason)
