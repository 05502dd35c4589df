"""Is this track to be trusted? Each test gives a value, a limit and a verdict."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from swimid.formats.evidence import Check
from swimid.formats.setup import Setup
from swimid.notices import warn
from swimid.tracking.pose import Pose
from swimid.tracking.rawtrack import RawTrack
from swimid.tracking.reader import irregular

Grade = Literal["pass", "warn", "fail"]
Array = NDArray[np.float64]

#: Normalised innovation from which on a measurement counts as a jump.
JUMP_SIGMA = 6.0


def _grade(value: float, good: float, bearable: float) -> Grade:
    return "pass" if value <= good else "warn" if value <= bearable else "fail"


def gaps(track_found: NDArray[np.bool_], times: Array) -> list[tuple[float, float]]:
    """Stretches without a measurement between the first and the last, (start, end) in s.

    A gap runs from the last sight before to the first sight after it.
    """
    seen = np.flatnonzero(track_found)
    holes = np.flatnonzero(np.diff(seen) > 1)
    return [(float(times[seen[k]]), float(times[seen[k + 1]])) for k in holes]


def run(track: RawTrack, pose: Pose, setup: Setup) -> list[Check]:
    """Every self-check of a track, in the order a reader wants them."""
    found = [
        _found(pose),
        _longest_gap(pose, setup),
        *_separation(pose),
        *_against_robot(pose, setup),
        *_facing(pose, setup),
        _timing(pose),
        _edges(track, setup),
        _jumps(pose),
        *_calibration(pose),
        _noise(pose),
    ]
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


def _found(pose: Pose) -> Check:
    count, total = int(pose.measured.sum()), len(pose.times)
    lost = 1 - count / total
    if count < total:
        warn(
            "SWM040",
            f"{total - count} of {total} frames show no marker (or not all of them): "
            f"{int(pose.interpolated.sum())} are bridged and flagged interpolated, "
            f"{int((pose.segment == 0).sum())} are empty",
        )
    return Check(
        name="Frames found",
        value=f"{count} of {total} ({100 * count / total:.1f} %)",
        limit=">= 95 %",
        verdict=_grade(lost, 0.05, 0.5),
        text="Frames in which every marker the pose needs was really seen.",
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
        text=f"{len(holes)} gaps; the track has {segments} segment{'s' if segments > 1 else ''}.",
    )


def separation_noise(separation: Array) -> tuple[float, float]:
    """Slow-free scatter of the marker separation and its median.

    The scatter is that of second differences (over sqrt 6), which slow changes by lens and
    height leave alone.
    """
    known = separation[np.isfinite(separation)]
    if len(known) < 5:
        return math.nan, float(np.median(known)) if len(known) else math.nan
    second = known[2:] - 2 * known[1:-1] + known[:-2]
    scatter = 1.4826 * float(np.median(np.abs(second - np.median(second)))) / math.sqrt(6)
    return scatter, float(np.median(known))


def _separation(pose: Pose) -> list[Check]:
    if pose.separation is None:
        return []
    separation = np.where(pose.measured, pose.separation, np.nan)
    noise, middle = separation_noise(separation)
    unit = pose.plane.unit
    known = np.isfinite(separation)
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
            limit="spread <= 2 %",
            verdict=_grade(spread, 0.02, 0.06),
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
    roles = [track.names.index(n) for n in (setup.head_name, setup.tail) if n is not None]
    count = int(np.any(track.at_edge[roles], axis=0).sum())
    share = count / max(int(track.found[roles].any(axis=0).sum()), 1)
    if count:
        warn(
            "SWM045",
            f"in {count} frames a marker is cut by the edge of the picture and its centre is biased inwards; "
            "these frames carry little weight",
        )
    return Check(
        name="At the edge of the picture",
        value=f"{count} frames ({100 * share:.1f} %)",
        limit="<= 1 %",
        verdict=_grade(share, 0.01, 0.2),
        text="A marker cut by the edge has a biased centre.",
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
