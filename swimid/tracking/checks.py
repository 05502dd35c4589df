"""Is this track to be trusted? Each test gives a value, a limit and a verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from swimid.logs.log import runs
from swimid.notices import warn
from swimid.results.evidence import Check, check
from swimid.tracking import camera, motion
from swimid.tracking.pose import SYSTEMATIC_PX, Pose
from swimid.tracking.rawtrack import RawTrack
from swimid.tracking.reader import Frame, irregular
from swimid.tracking.setup import Setup

Array = NDArray[np.float64]

#: Normalised innovation from which on a measurement counts as a jump.
JUMP_SIGMA = 6.0
#: Share of frames with a marker hidden in part that is worth saying: chance exceeds three sigma in 0.1 %.
HIDDEN_SHARE = 0.01
#: Share of frames without a marker, and share of lengths that differ: good, and bearable, up to here.
UNSEEN, LENGTH_ERROR = (0.05, 0.5), (0.02, 0.05)


def graded(name: str, value: str, limit: str, size: float, ends: tuple[float, float], text: str) -> Check:
    """A check of a size that is good up to the first end, worth a look up to the second, and bad beyond."""
    good, bearable = ends
    verdict: Literal["pass", "warn", "fail"] = (
        "pass" if size <= good else "warn" if size <= bearable else "fail"
    )
    return Check(name=name, value=value, limit=limit, verdict=verdict, text=text)


@dataclass(frozen=True)
class Presence:
    """From when to when the body is measured, and whether it swims in or out of the picture."""

    #: Frames of the first and of the last measurement.
    first: int
    last: int
    #: In the frame before the first, after the last, the edge of the picture cuts a marker: there the body
    #: is not lost but out of the picture.
    enters: bool
    leaves: bool

    @classmethod
    def of(cls, track: RawTrack, pose: Pose) -> Presence:
        """That of a track."""
        first, last = (int(f) for f in np.flatnonzero(pose.measured)[[0, -1]])
        cut: NDArray[np.bool_] = np.any(track.at_edge[pose.rows], axis=0)
        return cls(first, last, bool(cut[first - 1 : first].any()), bool(cut[last + 1 : last + 2].any()))


def run(track: RawTrack, pose: Pose, setup: Setup, kept: dict[int, Frame] | None = None) -> list[Check]:
    """Every self-check of a track, in the order a reader wants them; ``kept`` are some of its frames."""
    span = Presence.of(track, pose)
    return [
        _found(pose, span),
        _in_the_picture(track, pose, setup, span),
        _longest_gap(pose, setup),
        _motion(track, setup),
        *_camera(kept or {}),
        *_others(track, setup),
        *_separation(pose),
        *_against_robot(pose, setup),
        *_direction(pose, setup, track),
        _timing(pose),
        *_repeated(pose),
        _edges(track, pose),
        _hidden(pose),
        _jumps(pose),
        *_calibration(pose),
        _noise(pose),
        *_mistaken(track),
        *_drifted(track),
    ]


def _found(pose: Pose, span: Presence) -> Check:
    fresh = ~pose.held.repeated
    count, total = int(pose.measured.sum()), int(fresh.sum())
    # Out of the picture a body is not lost; but a film that shows it for a part only is never all good.
    inside = slice(span.first if span.enters else 0, span.last + 1 if span.leaves else len(fresh))
    lost = 1 - float(pose.measured[inside][fresh[inside]].mean())
    if count < total:
        warn(
            "SWM040",
            f"{total - count} of {total} frames show no marker (not all of them, or not whole): "
            f"{int((pose.interpolated & fresh).sum())} are bridged and flagged interpolated, "
            f"{int(((pose.segment == 0) & fresh).sum())} are empty",
        )
    text = "Frames in which every marker the pose needs was really seen, and whole."
    if span.enters or span.leaves:
        text += f" While it was in the picture: {100 * (1 - lost):.1f} %."
    value = f"{count} of {total} ({100 * count / total:.1f} %)"
    good = UNSEEN[0] if count >= 0.95 * total else -1.0
    return graded("Frames found", value, ">= 95 %", lost, (good, UNSEEN[1]), text)


def _in_the_picture(track: RawTrack, pose: Pose, setup: Setup, span: Presence) -> Check:
    """What is missing at the beginning and at the end is no gap between sights: it has its own line."""
    t, head = pose.times, pose.rows[0]

    def place(frame: int) -> str:
        return f"frame {frame}, at {track.x[head, frame]:.0f}, {track.y[head, frame]:.0f} px"

    late, early = t[span.first] - t[0] > setup.max_gap_s, t[-1] - t[span.last] > setup.max_gap_s
    if late:
        came = "cut by the edge of the picture before" if span.enters else "nothing of it before"
        warn("SWM065", f"first seen at {t[span.first]:.2f} s ({place(span.first)}; {came})")
    if early:
        went = "then it left the picture" if span.leaves else "then it is lost for good"
        warn("SWM065", f"last seen at {t[span.last]:.2f} s of {t[-1]:.2f} s ({place(span.last)}; {went})")
    value = f"{t[span.first]:.2f} s and {t[span.last]:.2f} s of {t[-1]:.2f} s"
    limit = f"within {setup.max_gap_s:g} s of the ends"
    text = "Before and after them nothing is measured, nor bridged."
    return check("First and last sight", value, not (late or early), limit, text)


def _longest_gap(pose: Pose, setup: Setup) -> Check:
    holes = [end - start for start, end in pose.gaps]
    segments = int(pose.segment.max())
    if segments > 1:
        warn(
            "SWM047",
            f"the track has {segments} segments: gaps over max_gap_s = {setup.max_gap_s:g} s are left empty",
        )
    text = f"{len(holes)} gaps between the first and the last sight; the track has {segments} segment"
    value = f"{max(holes):.3f} s" if holes else "none"
    limit = f"<= {setup.max_gap_s:g} s"
    return check("Longest gap", value, segments == 1, limit, f"{text}{'s' if segments > 1 else ''}.")


def _motion(track: RawTrack, setup: Setup) -> Check:
    """Whether what was followed moves: a still thing is found in every frame and passes all else."""
    reaches = {name: motion.reach(track, name) for name in setup.roles}
    name, farthest = max(reaches.items(), key=lambda item: item[1].radii)
    noise = math.hypot(farthest.noise_px, SYSTEMATIC_PX)
    still = farthest.away_px <= motion.NOISE_SIGMA * noise
    if still or not farthest.moves:
        warn(
            "SWM067",
            f"marker '{name}' stays within {farthest.away_px:.2g} px of one place, {farthest.radii:.2g} of "
            f"its radius{', which is its noise' if still else ''}: is it the marker, or a still thing of "
            "its colour?",
        )
    value = f"{farthest.away_px:.3g} px away, {farthest.radii:.2g} radii of '{name}'"
    limit = f">= {motion.LEAST_RADII:g} radius, and beyond {motion.NOISE_SIGMA * noise:.2g} px of noise"
    text = (
        "How far the marker gets from its usual place. What stays within its own size cannot be told from a "
        "still thing that ripples or is half covered at times."
    )
    verdict: Literal["pass", "warn", "fail"] = "fail" if still else "pass" if farthest.moves else "warn"
    return Check(name="Motion", value=value, limit=limit, verdict=verdict, text=text)


def _camera(kept: dict[int, Frame]) -> Iterator[Check]:
    """Whether the camera stood still, where most of the scene can be recognised."""
    shift = camera.shifts(list(kept.values()))
    if np.isfinite(shift[:, 0]).sum() < 2:
        return
    width = next(iter(kept.values())).shape[1]
    farthest, limit = camera.farthest(shift, width, ", and so do positions and speeds in the log")
    text = "Most corners of the scene, compared between a few frames: positions are seen from the camera."
    value = f"the scene shifts by {farthest:.1f} px"
    yield check("Camera", value, farthest <= limit, f"<= {limit:.1f} px", text)


def _others(track: RawTrack, setup: Setup) -> Iterator[Check]:
    """How often the markers are seen that the pose does not need, and whether they move."""
    names = [n for n in track.names if n not in setup.roles]
    if not names:
        return
    shares = {n: float(track.found[track.row(n)].mean()) for n in names}
    worst = min(shares, key=lambda n: shares[n])
    value = f"{worst} in {100 * shares[worst]:.1f} %"
    value += f", the rest of {len(names)} in more" if len(names) > 1 else ""
    text = "Markers besides head and tail: their columns are empty where they were not seen."
    yield graded("Other markers found", value, ">= 95 %", 1 - shares[worst], UNSEEN, text)
    still = [n for n in names if shares[n] > 0 and not motion.reach(track, n).moves]
    listed = ", ".join(still)
    if still:
        warn(
            "SWM067",
            f"marker{'s' if len(still) > 1 else ''} {listed} never left the radius of one place: "
            "still things of that colour?",
        )
    value = f"all but {listed}" if still else f"all {len(names)}"
    text = "What stays in place while others move may be a still thing of the colour."
    yield check("Other markers move", value, not still, f">= {motion.LEAST_RADII:g} radius", text)


def _separation(pose: Pose) -> Iterator[Check]:
    if pose.separation is None:
        return
    known = pose.measured & np.isfinite(pose.separation)
    separation, unit = pose.separation[known], pose.plane.unit
    noise, middle = motion.scatter(separation), float(np.median(separation))
    spread = 1.4826 * float(np.median(np.abs(separation - middle))) / middle
    text = (
        "Two markers on one rigid part keep their distance. Frame to frame it scatters by "
        f"{noise:.2g} {unit}, so one centroid by about {noise / math.sqrt(2):.2g} {unit}."
    )
    value, limit = (
        f"{middle:.4g} {unit}, spread {100 * spread:.2f} %",
        f"spread <= {100 * motion.DISTANCE_SPREAD[0]:g} %",
    )
    yield graded("Marker separation", value, limit, spread, motion.DISTANCE_SPREAD, text)
    design = np.column_stack([np.ones(known.sum()), *pose.raw[:, known]])
    design[:, 1:] -= design[:, 1:].mean(0)
    fit, *_ = np.linalg.lstsq(design, separation, rcond=None)
    drift = float(np.ptp(design[:, 1:] @ fit[1:])) / middle
    if not drift <= LENGTH_ERROR[0]:
        warn(
            "SWM042",
            f"the distance of head and tail marker changes by {100 * drift:.1f} % across the picture; the "
            "calibration (lens, perspective, marker height) or the mounting of a marker is off",
        )
    text = "A trend over the picture is an error of lens, perspective or marker height."
    value = f"{100 * drift:.2f} %"
    yield graded("Separation across the picture", value, "<= 2 %", drift, LENGTH_ERROR, text)


def _against_robot(pose: Pose, setup: Setup) -> Iterator[Check]:
    """The distance of the markers in the film against that on the robot: a length known in the picture."""
    if pose.separation is None or setup.places is None:
        return
    known = math.dist(*setup.places)
    off = float(np.nanmedian(np.where(pose.measured, pose.separation, np.nan))) / known - 1
    if not abs(off) <= LENGTH_ERROR[0]:
        warn(
            "SWM042",
            f"the distance of head and tail marker in the film is {100 * off:+.1f} % off the {known:g} m on "
            "the robot, and so is every length in the log (a scale taken at another distance from the "
            "camera, or in air); or their places on the robot are wrong",
        )
    name, value = "Marker distance against the robot", f"{100 * off:+.2f} % of {known:g} m"
    text = "A scale taken at another distance from the camera, or out of the water, shows here."
    yield graded(name, value, "within 2 %", abs(off), LENGTH_ERROR, text)


def _direction(pose: Pose, setup: Setup, track: RawTrack) -> Iterator[Check]:
    """Whether the robot swims the way that head and tail say.

    It swims the other way if that is most of its way, and it gets that way by more than the distance of the
    markers, or by more than a marker's radius and than its longest stretch in the stated direction: a robot
    on the spot moves to and fro.
    """
    if pose.body_velocity is None or pose.separation is None:
        return
    step = np.gradient(pose.times) * pose.body_velocity[0]
    step = np.where(np.isfinite(step), step, 0.0) * (1 if setup.swims == "head-first" else -1)
    ahead, astern = float(step[step > 0].sum()), float(-step[step < 0].sum())
    longest = max((float(step[a:b].sum()) for a, b in runs(step > 0)), default=0.0)
    head = pose.rows[0]
    x, y, area = (float(np.nanmedian(values[head])) for values in (track.x, track.y, track.area))
    radius = math.sqrt(area / math.pi) * pose.plane.size_of_pixel(x, y)
    least = min(float(np.nanmedian(pose.separation)), max(radius, longest))
    wrong, share = astern - ahead > least, ahead / max(ahead + astern, 1e-300)
    way = setup.swims.replace("-", " ")
    if wrong:
        warn(
            "SWM100",
            f"the robot swims {way} over {100 * share:.0f} % of its way only: exchange head "
            f"'{setup.head}' and tail "
            f"'{setup.tail}' in the setup, or say there how it swims (swims: head-first or tail-first)",
        )
    text = (
        "The way that the reference point makes along the heading. Exchanged markers turn the "
        "heading by 180 deg."
    )
    value = f"{100 * share:.0f} % of the way"
    if setup.plane == "vertical":
        side = "left" if pose.plane.runs_left else "right"
        value += f"; faces {side}"
        text += f" x runs to the {side} of the picture, and pitch is nose up."
    verdict: Literal["pass", "fail"] = "fail" if wrong else "pass"
    yield Check(name=f"Swims {way}", value=value, limit="most of the way", verdict=verdict, text=text)


def _timing(pose: Pose) -> Check:
    share, largest = irregular(pose.times)
    if share > 0.01:
        warn(
            "SWM043",
            f"{100 * share:.1f} % of the frames come at uneven steps (the longest is {largest:.1f} times the "
            "usual one): variable frame rate or dropped frames. The frames' own time stamps are used",
        )
    value = f"{100 * share:.1f} % uneven, longest step {largest:.2f} x usual"
    text = "Times are the frames' own stamps, or set by the frame rate given."
    return check("Frame timing", value, share <= 0.01, "<= 1 % uneven", text)


def _repeated(pose: Pose) -> Iterator[Check]:
    count, total = int(pose.held.repeated.sum()), len(pose.times)
    if not count:
        return
    rate = 1 / pose.held.period_s
    warn(
        "SWM058",
        f"{count} of {total} pictures repeat the one before: the camera took {rate:.4g} pictures a "
        f"second. They are "
        "left out, and the others were taken up to "
        f"{1000 * pose.held.lateness_s:.3g} ms before their stamps, which the stated deviations contain",
    )
    text = (
        "A recorder that is faster than the camera repeats its last picture. Record at the rate of "
        "the camera."
    )
    yield check("Repeated pictures", f"{count} of {total}; {rate:.4g} pictures/s", False, "none", text)


def _edges(track: RawTrack, pose: Pose) -> Check:
    count = int(np.any(track.at_edge[pose.rows], axis=0).sum())
    share = count / max(int(track.seen[pose.rows].any(axis=0).sum()), 1)
    if count:
        warn(
            "SWM045",
            f"in {count} frames a marker is cut by the edge of the picture; its centre cannot be told there, "
            "so these frames count as not found",
        )
    text = "A marker cut by the edge is seen and followed, but not measured."
    value = f"{count} frames ({100 * share:.1f} %)"
    return check("At the edge of the picture", value, share <= 0.01, "<= 1 %", text)


def _hidden(pose: Pose) -> Check:
    off = pose.hidden[pose.rows].max(axis=0)
    count = int(np.sum(off > 0))
    share = count / max(int(pose.measured.sum()), 1)
    worst = f"; the centre may be {off.max():.1f} px off in frame {int(np.argmax(off))}" if count else ""
    if share > HIDDEN_SHARE:
        warn(
            "SWM066",
            f"in {count} frames a marker looks smaller than it is, hidden in part or seen aslant{worst}. The "
            "stated deviations contain that",
        )
    value, limit = f"{count} frames ({100 * share:.1f} %){worst}", f"<= {100 * HIDDEN_SHARE:g} %"
    text = "The centre of what is seen of a marker is not the marker's."
    return check("Hidden in part", value, share <= HIDDEN_SHARE, limit, text)


def _jumps(pose: Pose) -> Check:
    innovations = [pose.path.innovation] + ([] if pose.angle is None else [pose.angle.innovation])
    far = np.nanmax(np.abs(np.concatenate(innovations)), axis=0, initial=0.0) > JUMP_SIGMA
    count = int(far.sum())
    share = count / max(int(pose.measured.sum()), 1)
    value = f"{count} frames" + (f"; the first in frame {int(np.argmax(far))}" if count else "")
    text = (
        "Measurements far from what the path before them predicts: a collision, or another thing taken for "
        "the marker."
    )
    return graded("Jumps", value, f"0 beyond {JUMP_SIGMA:g} sigma", share, (0.0, 0.02), text)


def _calibration(pose: Pose) -> Iterator[Check]:
    plane = pose.plane
    if plane.exact:
        text = "Four points fit any camera: their error is not known, and not in the stated deviations."
        yield check("Calibration", "four points", None, "five points or more tell their error", text)
    if plane.unit == "px":
        text = "Positions are in pixels. A scale in the setup gives metres."
        yield check("Calibration", "none", False, text=text)
    elif plane.residual_px > 1e-2:
        value = f"{plane.residual_px:.2f} px, {1000 * plane.residual:.2f} mm rms"
        text = "Misfit of the calibration points."
        yield graded("Calibration", value, "<= 1 px", plane.residual_px, (1.0, 4.0), text)


def _noise(pose: Pose) -> Check:
    unit, kind = pose.plane.unit, {2: "acceleration", 3: "jerk"}
    value = f"{pose.path.measurement_sd:.2g} {unit}"
    if pose.angle is not None:
        value += f", heading {pose.angle.measurement_sd:.2g} rad"
    seen = pose.path.innovation[np.isfinite(pose.path.innovation)]
    rms = float(np.sqrt(np.mean(seen**2))) if len(seen) else math.nan
    text = (
        f"Estimated with the process noise (white {kind[pose.path.order]}, "
        f"{pose.path.process_noise:.3g} {unit}²/s{ {2: '³', 3: '⁵'}[pose.path.order] }) from the likelihood "
        f"of the innovations, whose normalised size is {rms:.2f} (1 is consistent)."
    )
    return check("Measurement noise", value, None, text=text)


def _mistaken(track: RawTrack) -> Iterator[Check]:
    """Something else came before the marker: which of the two is the marker is for the reader to say."""
    for name, (count, area) in track.mistaken.items():
        now = float(np.nanmedian(track.area[track.row(name)]))
        value = f"{count} sights of a thing of {area:.0f} px, then one of {now:.0f} px"
        warn("SWM064", f"marker '{name}' was first taken for another thing: {value}, which stayed longer")
        text = (
            "The first thing of the marker's colour was given up for one that moved and stayed longer. Look "
            "at the overlay; area_px in the setup tells them apart."
        )
        yield check(f"What is {name}", value, False, "one thing", text)


def _drifted(track: RawTrack) -> Iterator[Check]:
    for name, drift in track.drift.items():
        value = (
            f"hue {2 * drift[0]:+.0f} deg, saturation {drift[1] / 255:+.2f}, value {drift[2] / 255:+.2f} "
            "from its first sight"
        )
        warn("SWM046", f"the colour of marker '{name}' drifted ({value}); the colour model followed it")
        text = "Exposure or white balance drifted; the colour model followed it."
        yield check(f"Colour of {name}", value, None, text=text)
