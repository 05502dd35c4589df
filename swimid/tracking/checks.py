"""Is this track to be trusted? Each test gives a value, a limit and a verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from swimid.notices import warn
from swimid.results.evidence import Check
from swimid.tracking import camera, motion
from swimid.tracking.pose import SYSTEMATIC_PX, Pose
from swimid.tracking.rawtrack import RawTrack
from swimid.tracking.reader import Frame, irregular
from swimid.tracking.setup import Setup

Grade = Literal["pass", "warn", "fail"]
Array = NDArray[np.float64]

#: Normalised innovation from which on a measurement counts as a jump.
JUMP_SIGMA = 6.0
#: Share of frames with a marker hidden in part that is worth saying: chance exceeds three sigma in 0.1 %.
HIDDEN_SHARE = 0.01


def _grade(value: float, good: float, bearable: float) -> Grade:
    return "pass" if value <= good else "warn" if value <= bearable else "fail"


def gaps(track_found: NDArray[np.bool_], times: Array) -> list[tuple[float, float]]:
    """Stretches without a measurement between the first and the last, (start, end) in s.

    A gap runs from the last sight before to the first sight after it.
    """
    seen = np.flatnonzero(track_found)
    holes = np.flatnonzero(np.diff(seen) > 1)
    return [(float(times[seen[k]]), float(times[seen[k + 1]])) for k in holes]


@dataclass(frozen=True)
class Presence:
    """From when to when the body is measured.

    Attributes
    ----------
    first, last : int
        Frames of the first and of the last measurement.
    enters, leaves : bool
        In the frame before the first, after the last, the edge of the picture cuts a marker: there the body
        is not lost but out of the picture.
    """

    first: int
    last: int
    enters: bool
    leaves: bool


def presence(track: RawTrack, pose: Pose, setup: Setup) -> Presence:
    """From when to when the body is measured, and whether it swims in or out of the picture."""
    first, last = (int(f) for f in np.flatnonzero(pose.measured)[[0, -1]])
    cut: NDArray[np.bool_] = np.any(track.at_edge[_roles(track, setup)], axis=0)
    return Presence(first, last, bool(cut[first - 1 : first].any()), bool(cut[last + 1 : last + 2].any()))


def _roles(track: RawTrack, setup: Setup) -> list[int]:
    """Rows of the markers the pose needs."""
    return [track.names.index(name) for name in (setup.head_name, setup.tail) if name is not None]


def run(track: RawTrack, pose: Pose, setup: Setup, kept: dict[int, Frame] | None = None) -> list[Check]:
    """Every self-check of a track, in the order a reader wants them; ``kept`` are some of its frames."""
    span = presence(track, pose, setup)
    found = [
        _found(pose, span),
        _in_the_picture(track, pose, setup, span),
        _longest_gap(pose, setup),
        _motion(track, pose, setup),
        *_camera(kept or {}),
        *_others(track, setup),
        *_separation(pose),
        *_against_robot(pose, setup),
        *_facing(pose, setup),
        _timing(pose),
        _edges(track, setup),
        _hidden(track, pose, setup),
        _jumps(pose),
        *_calibration(pose),
        _noise(pose),
    ]
    found += [_mistaken(track, name) for name in track.mistaken]
    for name, drift in track.drift.items():
        text = (
            f"hue {2 * drift[0]:+.0f} deg, saturation {drift[1] / 255:+.2f}, value {drift[2] / 255:+.2f} "
            "from its first sight"
        )
        found.append(
            Check(
                name=f"Colour of {name}",
                value=text,
                verdict="info",
                text="Exposure or white balance drifted; the colour model followed it.",
            )
        )
        warn("SWM046", f"the colour of marker '{name}' drifted ({text}); the colour model followed it")
    return found


def _found(pose: Pose, span: Presence) -> Check:
    count, total = int(pose.measured.sum()), len(pose.times)
    # Out of the picture a body is not lost; but a film that shows it for a part only is never all good.
    inside = slice(span.first if span.enters else 0, span.last + 1 if span.leaves else total)
    lost = 1 - float(pose.measured[inside].mean())
    grade = _grade(lost, 0.05, 0.5)
    if grade == "pass" and count < 0.95 * total:
        grade = "warn"
    if count < total:
        warn(
            "SWM040",
            f"{total - count} of {total} frames show no marker (not all of them, or not whole): "
            f"{int(pose.interpolated.sum())} are bridged and flagged interpolated, "
            f"{int((pose.segment == 0).sum())} are empty",
        )
    return Check(
        name="Frames found",
        value=f"{count} of {total} ({100 * count / total:.1f} %)",
        limit=">= 95 %",
        verdict=grade,
        text="Frames in which every marker the pose needs was really seen, and whole."
        + (f" While it was in the picture: {100 * (1 - lost):.1f} %." if span.enters or span.leaves else ""),
    )


def _in_the_picture(track: RawTrack, pose: Pose, setup: Setup, span: Presence) -> Check:
    """What is missing at the beginning and at the end is no gap between sights: it has its own line."""
    t, head = pose.times, track.names.index(setup.head_name)

    def place(frame: int) -> str:
        return f"frame {frame}, at {track.x[head, frame]:.0f}, {track.y[head, frame]:.0f} px"

    late, early = t[span.first] - t[0] > setup.max_gap_s, t[-1] - t[span.last] > setup.max_gap_s
    if late:
        came = "cut by the edge of the picture before" if span.enters else "nothing of it before"
        warn("SWM065", f"first seen at {t[span.first]:.2f} s ({place(span.first)}; {came})")
    if early:
        went = "then it left the picture" if span.leaves else "then it is lost for good"
        warn("SWM065", f"last seen at {t[span.last]:.2f} s of {t[-1]:.2f} s ({place(span.last)}; {went})")
    return Check(
        name="First and last sight",
        value=f"{t[span.first]:.2f} s and {t[span.last]:.2f} s of {t[-1]:.2f} s",
        limit=f"within {setup.max_gap_s:g} s of the ends",
        verdict="warn" if late or early else "pass",
        text="Before and after them nothing is measured, nor bridged.",
    )


def _longest_gap(pose: Pose, setup: Setup) -> Check:
    holes = [end - start for start, end in gaps(pose.measured, pose.times)]
    longest = max(holes, default=0.0)
    segments = int(pose.segment.max())
    if segments > 1:
        warn(
            "SWM047",
            f"the track has {segments} segments: gaps over max_gap_s = {setup.max_gap_s:g} s are left empty",
        )
    return Check(
        name="Longest gap",
        value=f"{longest:.3f} s" if holes else "none",
        limit=f"<= {setup.max_gap_s:g} s",
        verdict="pass" if segments == 1 else "warn",
        text=f"{len(holes)} gaps between the first and the last sight; the track has {segments} "
        f"segment{'s' if segments > 1 else ''}.",
    )


def _motion(track: RawTrack, pose: Pose, setup: Setup) -> Check:
    """Whether what was followed moves: a still thing is found in every frame and passes all else."""
    reaches = {n: motion.reach(track, n) for n in (setup.head_name, setup.tail) if n is not None}
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
    return Check(
        name="Motion",
        value=f"{farthest.away_px:.3g} px away, {farthest.radii:.2g} radii of '{name}'",
        limit=f">= {motion.LEAST_RADII:g} radius, and beyond {motion.NOISE_SIGMA * noise:.2g} px of noise",
        verdict="fail" if still else "pass" if farthest.moves else "warn",
        text="How far the marker gets from its usual place. What stays within its own size cannot be told "
        "from a still thing that ripples or is half covered at times.",
    )


def _camera(kept: dict[int, Frame]) -> list[Check]:
    """Whether the camera stood still, where most of the scene can be recognised."""
    shift = camera.shifts(list(kept.values()))
    if np.isfinite(shift[:, 0]).sum() < 2:
        return []
    largest = float(np.nanmax(np.hypot(*shift.T)))
    limit = camera.limit_px(next(iter(kept.values())).shape[1])
    if largest > limit:
        warn(
            "SWM068",
            f"the whole scene shifts by {largest:.1f} px in the film: the camera moves, and so do positions "
            "and speeds in the log",
        )
    return [
        Check(
            name="Camera",
            value=f"the scene shifts by {largest:.1f} px",
            limit=f"<= {limit:.1f} px",
            verdict="pass" if largest <= limit else "warn",
            text="Most corners of the scene, compared between a few frames: positions are seen from the "
            "camera.",
        )
    ]


def _others(track: RawTrack, setup: Setup) -> list[Check]:
    """How often the markers are seen that the pose does not need."""
    names = [n for n in track.names if n not in (setup.head_name, setup.tail)]
    if not names:
        return []
    shares = {n: float(track.found[track.names.index(n)].mean()) for n in names}
    worst = min(shares, key=lambda n: shares[n])
    still = [n for n in names if shares[n] > 0 and not motion.reach(track, n).moves]
    if still:
        warn(
            "SWM067",
            f"marker{'s' if len(still) > 1 else ''} {', '.join(still)} never left the radius of one place: "
            "still things of that colour?",
        )
    return [
        Check(
            name="Other markers found",
            value=f"{worst} in {100 * shares[worst]:.1f} %"
            + (f", the rest of {len(names)} in more" if len(names) > 1 else ""),
            limit=">= 95 %",
            verdict=_grade(1 - shares[worst], 0.05, 0.5),
            text="Markers besides head and tail: their columns are empty where they were not seen.",
        ),
        Check(
            name="Other markers move",
            value=f"all but {', '.join(still)}" if still else f"all {len(names)}",
            limit=f">= {motion.LEAST_RADII:g} radius",
            verdict="warn" if still else "pass",
            text="What stays in place while others move may be a still thing of the colour.",
        ),
    ]


def _separation(pose: Pose) -> list[Check]:
    if pose.separation is None:
        return []
    separation = np.where(pose.measured, pose.separation, np.nan)
    known = np.isfinite(separation)
    noise, middle = motion.scatter(separation[known]), float(np.nanmedian(separation))
    unit = pose.plane.unit
    spread = 1.4826 * float(np.median(np.abs(separation[known] - middle))) / middle
    design = np.column_stack([np.ones(known.sum()), *pose.raw[:, known]])
    design[:, 1:] -= design[:, 1:].mean(0)
    fit, *_ = np.linalg.lstsq(design, separation[known], rcond=None)
    trend = design[:, 1:] @ fit[1:]
    drift = float(np.ptp(trend)) / middle
    grade = _grade(drift, 0.02, 0.05)
    if grade != "pass":
        warn(
            "SWM042",
            f"the distance of head and tail marker changes by {100 * drift:.1f} % across the picture; the "
            "calibration (lens, perspective, marker height) or the mounting of a marker is off",
        )
    return [
        Check(
            name="Marker separation",
            value=f"{middle:.4g} {unit}, spread {100 * spread:.2f} %",
            limit=f"spread <= {100 * motion.KEPT[0]:g} %",
            verdict=_grade(spread, *motion.KEPT),
            text="Two markers on one rigid part keep their distance. Frame to frame it scatters by "
            f"{noise:.2g} {unit}, so one centroid by about {noise / math.sqrt(2):.2g} {unit}.",
        ),
        Check(
            name="Separation across the picture",
            value=f"{100 * drift:.2f} %",
            limit="<= 2 %",
            verdict=grade,
            text="A trend over the picture is an error of lens, perspective or marker height.",
        ),
    ]


def _against_robot(pose: Pose, setup: Setup) -> list[Check]:
    """The distance of the markers in the film against that on the robot: a length known in the picture."""
    if pose.separation is None or setup.places is None:
        return []
    (a, b), (c, d) = setup.places
    known = math.hypot(a - c, b - d)
    off = float(np.nanmedian(np.where(pose.measured, pose.separation, np.nan))) / known - 1
    grade = _grade(abs(off), 0.02, 0.05)
    if grade != "pass":
        warn(
            "SWM042",
            f"the distance of head and tail marker in the film is {100 * off:+.1f} % off the {known:g} m on "
            "the robot, and so is every length in the log (a scale taken at another distance from the "
            "camera, or in air); or their places on the robot are wrong",
        )
    return [
        Check(
            name="Marker distance against the robot",
            value=f"{100 * off:+.2f} % of {known:g} m",
            limit="within 2 %",
            verdict=grade,
            text="A scale taken at another distance from the camera, or out of the water, shows here.",
        )
    ]


def _facing(pose: Pose, setup: Setup) -> list[Check]:
    """Which way the robot looks, and whether it swims that way."""
    if setup.plane == "horizontal" or pose.angle is None or pose.separation is None:
        return []
    angle, (vx, vz) = pose.angle.position[0], pose.path.velocity
    ahead = float(np.nanmean(vx * np.cos(angle) + vz * np.sin(angle))) * float(np.ptp(pose.times))
    backwards = ahead < -float(np.nanmedian(pose.separation))
    side = "left" if pose.plane.runs_left else "right"
    return [
        Check(
            name="Facing",
            value=f"{side}, and swims {'backwards' if backwards else 'forwards'}",
            limit="forwards",
            verdict="warn" if backwards else "pass",
            text=f"x runs to the {side} of the picture, and pitch is nose up. Where a robot seems to swim "
            "backwards, head and tail marker may be exchanged in the setup.",
        )
    ]


def _timing(pose: Pose) -> Check:
    share, largest = irregular(pose.times)
    if share > 0.01:
        warn(
            "SWM043",
            f"{100 * share:.1f} % of the frames come at uneven steps (the longest is {largest:.1f} times the "
            "usual one): variable frame rate or dropped frames. The frames' own time stamps are used",
        )
    return Check(
        name="Frame timing",
        value=f"{100 * share:.1f} % uneven, longest step {largest:.2f} x usual",
        limit="<= 1 % uneven",
        verdict="pass" if share <= 0.01 else "warn",
        text="Times are the frames' own stamps, or set by the frame rate given.",
    )


def _edges(track: RawTrack, setup: Setup) -> Check:
    roles = _roles(track, setup)
    count = int(np.any(track.at_edge[roles], axis=0).sum())
    share = count / max(int(track.seen[roles].any(axis=0).sum()), 1)
    if count:
        warn(
            "SWM045",
            f"in {count} frames a marker is cut by the edge of the picture; its centre cannot be told there, "
            "so these frames count as not found",
        )
    return Check(
        name="At the edge of the picture",
        value=f"{count} frames ({100 * share:.1f} %)",
        limit="<= 1 %",
        verdict="pass" if share <= 0.01 else "warn",
        text="A marker cut by the edge is seen and followed, but not measured.",
    )


def _hidden(track: RawTrack, pose: Pose, setup: Setup) -> Check:
    off = pose.hidden[_roles(track, setup)].max(axis=0)
    count = int(np.sum(off > 0))
    share = count / max(int(pose.measured.sum()), 1)
    worst = f"; the centre may be {off.max():.1f} px off in frame {int(np.argmax(off))}" if count else ""
    if share > HIDDEN_SHARE:
        warn(
            "SWM066",
            f"in {count} frames a marker looks smaller than it is, hidden in part or seen aslant{worst}. The "
            "stated deviations contain that",
        )
    return Check(
        name="Hidden in part",
        value=f"{count} frames ({100 * share:.1f} %){worst}",
        limit=f"<= {100 * HIDDEN_SHARE:g} %",
        verdict="pass" if share <= HIDDEN_SHARE else "warn",
        text="The centre of what is seen of a marker is not the marker's.",
    )


def _mistaken(track: RawTrack, name: str) -> Check:
    """Something else came before the marker: which of the two is the marker is for the reader to say."""
    count, area = track.mistaken[name]
    now = float(np.nanmedian(track.area[track.names.index(name)]))
    text = f"{count} sights of a thing of {area:.0f} px, then one of {now:.0f} px"
    warn("SWM064", f"marker '{name}' was first taken for another thing: {text}, which stayed longer")
    return Check(
        name=f"What is {name}",
        value=text,
        limit="one thing",
        verdict="warn",
        text="The first thing of the marker's colour was given up for one that moved and stayed longer. Look "
        "at the overlay; area_px in the setup tells them apart.",
    )


def _jumps(pose: Pose) -> Check:
    innovations = [pose.path.innovation] + ([] if pose.angle is None else [pose.angle.innovation])
    worst = np.nanmax(np.abs(np.concatenate(innovations)), axis=0, initial=0.0)
    count = int(np.sum(worst > JUMP_SIGMA))
    share = count / max(int(pose.measured.sum()), 1)
    first = f"; the first in frame {int(np.argmax(worst > JUMP_SIGMA))}" if count else ""
    return Check(
        name="Jumps",
        value=f"{count} frames{first}",
        limit=f"0 beyond {JUMP_SIGMA:g} sigma",
        verdict="pass" if not count else _grade(share, -1.0, 0.02),
        text="Measurements far from what the path before them predicts: a collision, or another thing taken "
        "for the marker.",
    )


def _calibration(pose: Pose) -> list[Check]:
    plane = pose.plane
    if plane.unit == "px":
        return [
            Check(
                name="Calibration",
                value="none",
                verdict="warn",
                text="Positions are in pixels. A scale in the setup gives metres.",
            )
        ]
    if plane.residual_px <= 1e-2:
        return []
    return [
        Check(
            name="Calibration",
            value=f"{plane.residual_px:.2f} px, {1000 * plane.residual:.2f} mm rms",
            limit="<= 1 px",
            verdict=_grade(plane.residual_px, 1.0, 4.0),
            text="Misfit of the calibration points.",
        )
    ]


def _noise(pose: Pose) -> Check:
    unit, kind = pose.plane.unit, {2: "acceleration", 3: "jerk"}
    text = f"{pose.path.measurement_sd:.2g} {unit}"
    if pose.angle is not None:
        text += f", heading {pose.angle.measurement_sd:.2g} rad"
    seen = pose.path.innovation[np.isfinite(pose.path.innovation)]
    rms = float(np.sqrt(np.mean(seen**2))) if len(seen) else math.nan
    return Check(
        name="Measurement noise",
        value=text,
        verdict="info",
        text=f"Estimated with the process noise (white {kind[pose.path.order]}, "
        f"{pose.path.process_noise:.3g} {unit}²/s{ {2: '³', 3: '⁵'}[pose.path.order] }) from the likelihood "
        f"of the innovations, whose normalised size is {rms:.2f} (1 is consistent).",
    )
