"""Facts, checks, tables and figures with which a pose from tracked points is reported."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from swimid.kinematics import wave
from swimid.points.film import FALSE_ALARM_POINTS
from swimid.points.film_bias import UNDETERMINED
from swimid.points.linkage import Array
from swimid.points.points import MAX_BIAS, MAX_PERSPECTIVE, WRONG_DISTANCE, Posed
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.evidence import Check, Figure, Table, Trace

POINT_METHODS = [
    "Pose and joint angles are weighted least-squares estimates from all tracked points of a frame. The "
    "noise of each point is estimated by restricted maximum likelihood. A point is left out if its residual "
    "exceeds the quantile of the chi-square distribution at which a film without faults loses a point with "
    f"{FALSE_ALARM_POINTS:.0%} probability (Bonferroni)."
]
REFERENCES = [
    "Triggs, B., McLauchlan, P. F., Hartley, R. I., Fitzgibbon, A. W. (2000). Bundle adjustment - a modern "
    "synthesis. Lecture Notes in Computer Science 1883, 298-372. doi:10.1007/3-540-44480-7_21"
]


def _scale(posed: Posed) -> str:
    if posed.scale is None:
        return posed.scale_source
    value, error = (1e3 * one for one in posed.scale)
    return f"{numbers.format_estimate(value, error)} mm/px {posed.scale_source}"


def facts(posed: Posed) -> dict[str, str]:
    """Return the facts on the points, their noise and the scale."""
    fit, count = posed.fit, len(posed.fit.linkage.names)
    noise = [numbers.format_number(float(value), 2) for value in (fit.noise.min(), fit.noise.max())]
    unit = posed.noise_unit
    text = f"{count} on {len(fit.linkage.parent)} links, noise {' to '.join(dict.fromkeys(noise))} {unit}"
    if fit.exponent:
        text += f", proportional to the likelihood to the power of −{fit.exponent:.2g}"
    found = {"Points": text}
    if posed.unit == "m":
        found["Scale"] = _scale(posed)
    swings = []
    for name, one in posed.swings.items():
        text = numbers.format_estimate(math.degrees(one.amplitude.value), math.degrees(one.stderr), "deg")
        swings.append(f"{name} {text} at {one.frequency_hz:.4g} Hz")
    if swings:
        found["Amplitudes"] = ", ".join(swings)
    return found


def checks(posed: Posed) -> Iterator[Check]:
    """Yield the checks for faults, undetermined samples, and wrong distances and places of points."""
    rows, kinds = len(posed.fit.used), dict.fromkeys(("exchanged", "merged", "stray", "lost"), 0)
    for kind, _, count, _ in posed.faults:
        kinds[kind] += count
    named = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
    reason = f"tracked points have faults: {named}"
    yield ev.make_check("Points at fault", named or "0", not named, "0", reason=reason)
    text = ", ".join(f"{name} in {count}" for name, count in posed.empty.items() if count)
    value, reason = f"{rows - max(posed.empty.values())} of {rows}", f"the points leave frames empty: {text}"
    name, reason = "Frames that the points determine", f"{reason} of {rows} frames"
    yield ev.make_check(name, value, not text, "all", reason=reason)
    if posed.distances:
        wrong = [
            f"{' and '.join(one.names)} {one.measured:.4g} {posed.unit} for {one.stated:.4g} {posed.unit}"
            for one in posed.distances
            if one.wrong
        ]
        limit = f"no bias above {MAX_BIAS:g} sd at {WRONG_DISTANCE:.0%}"
        reason = f"measured distances of points differ from the stated distances: {', '.join(wrong)}"
        if not posed.robot:
            reason = f"distances on the chain change within the film: {', '.join(wrong)}"
        value = f"{len(wrong)} of {len(posed.distances)} wrong"
        yield ev.make_check("Distances of points", value, not wrong, limit, reason=reason)
    value, passed = f"{100 * posed.perspective:.2g} %", posed.perspective <= MAX_PERSPECTIVE
    limit, reason = f"<= {100 * MAX_PERSPECTIVE:g} %", posed.perspective_text
    yield ev.make_check("Distances along the path", value, passed, limit, reason=reason)
    if posed.robot:
        reason = "the picture is mirrored: its mirror image fits the points on the robot better"
        value, passed = ("no", "yes")[int(posed.fit.mirrored)], not posed.fit.mirrored
        yield ev.make_check("Mirrored picture", value, passed, "no", otherwise="fail", reason=reason)
        names = ", ".join(posed.misplaced)
        reason = f"points are not at their stated positions on the robot: {names}"
        yield ev.make_check("Places of points", names or "as stated", not names, "as stated", reason=reason)
    if "places" in posed.fit.linkage.free:
        names = posed.free_coordinates_text
        reason = f"the film does not determine these coordinates of points on the robot: {names}"
        yield ev.make_check("Places not determined", names or "none", not names, "none", reason=reason)


def tables(posed: Posed, beat: wave.Wave | None) -> list[Table]:
    """Return the tables of points, faults, distances, estimated places, and of the body wave."""
    fit, linkage = posed.fit, posed.fit.linkage
    made = []
    if beat is not None:
        made.append(_wave_table(beat, posed.unit))
    if posed.swings:
        made.append(_swing_table(posed))
    rows: list[dict[str, Any]] = []
    for k, name in enumerate(linkage.names):
        offset = posed.offsets[k]
        row: dict[str, Any] = {
            "point": name,
            "link": linkage.links[linkage.link[k]],
            "noise": float(fit.noise[k]),
            "used": int(fit.used[:, k].sum()),
            "frames": len(fit.used),
        }
        if posed.robot:
            row |= {"mean forward, mm": 1e3 * float(offset.real), "to port, mm": 1e3 * float(offset.imag)}
        rows.append(row)
    caption = f"Noise of a coordinate in {posed.noise_unit}; means of the residuals in the axes of the link."
    made.append(_fold("points", "Tracked points", rows, caption))
    if posed.faults:
        rows = [
            {"fault": kind, "points": names or "several", "frames": count, "first": frames}
            for kind, names, count, frames in posed.faults
        ]
        caption = f"The probability of a chance removal is {fit.level:.2g} for a point in a frame."
        made.append(_fold("faults", "Points left out or exchanged back", rows, caption))
    if posed.distances:
        given, seen = ("stated", "measured") if posed.robot else ("first half", "second half")
        rows = [
            {
                "points": " and ".join(one.names),
                "link": one.link,
                f"{given}, {posed.unit}": one.stated,
                f"{seen}, {posed.unit}": one.measured,
                f"standard error, {posed.unit}": one.stderr,
                "wrong": one.wrong,
            }
            for one in posed.distances
        ]
        made.append(_fold("distances", "Distances of points on one link", rows))
    names = linkage.quantities
    errors = np.sqrt(np.maximum(np.diag(linkage.covariance), 0.0))
    if "lengths" in linkage.free:
        rows = [
            {"link": name, f"length, {posed.unit}": -float(rear), "standard error": float(errors[k])}
            for k, (name, rear) in enumerate(zip(linkage.links, linkage.rear.real, strict=True))
        ]
        made.append(ev.make_table("lengths", "Links of the chain", rows))
    if "places" in linkage.free:
        made.append(_places(posed, errors[len(names) - 2 * len(linkage.names) :]))
    return made


def _places(posed: Posed, errors: Array) -> Table:
    """Return the table of the places of points that were estimated from the film."""
    linkage, sd = posed.fit.linkage, posed.fit.place_sd_m
    rows = []
    for k, name in enumerate(linkage.names):
        place, stated = linkage.place[k], posed.stated.place[k]
        x, y = errors[k], errors[len(linkage.names) + k]
        weak = posed.free_coordinates.get(name, "")
        free = [
            word for word, error in (("x", x), ("y", y)) if word in weak or error**2 > UNDETERMINED * sd**2
        ]
        rows.append(
            {
                "point": name,
                "link": linkage.links[linkage.link[k]],
                "x, mm": 1e3 * place.real,
                "± x": 1e3 * float(x),
                "y, mm": 1e3 * place.imag,
                "± y": 1e3 * float(y),
                "moved, mm": 1e3 * abs(place - stated),
                "not determined": ", ".join(free) or "-",
            }
        )
    caption = (
        f"The stated places are in error by {1e3 * sd:.2g} mm (standard deviation, estimated). The film does "
        "not show the zero of a joint angle or of the heading: a rotation of all points of a link about its "
        "only joint is that of the stated places, and its uncertainty is part of the standard errors."
    )
    return ev.make_table("places", "Places of points, estimated from the film", rows, caption)


def _fold(id: str, title: str, rows: list[dict[str, Any]], caption: str = "") -> Table:
    return ev.make_table(id, title, rows, caption).model_copy(update={"folded": True})


# ---------------------------------------------------------------- body wave


def wave_of(posed: Posed | None, frequency_hz: float | None) -> wave.Wave | None:
    """Return the body wave at the stroke frequency; None if there is no wave or the film is too short.

    The stations are the front ends of the links from the base to the rear, and the rear end of the last.
    """
    if posed is None or frequency_hz is None or len(posed.fit.linkage.parent) < 2:
        return None
    linkage = posed.fit.linkage
    way = wave.spine(linkage.parent.tolist(), (linkage.parent >= 0).tolist())
    angles = posed.fit.state.angles
    ends, straight = (
        wave.stations_of(way, origins, origins + axes * linkage.rear)
        for axes, origins, _ in map(linkage.shape, (angles, np.zeros((1, angles.shape[1]))))
    )
    names = [f"x_{posed.unit}", *linkage.columns]
    known = np.ones(len(ends), dtype=bool)
    for name in names:
        known &= np.isfinite(posed.columns.get(name, np.full(len(ends), np.nan)))
    stations = posed.fit.state.position[:, None] / linkage.scale + ends
    stations = np.where(known[:, None], stations, np.nan)
    behind = wave.distances(straight[0])
    return wave.measure_wave(posed.time_s, stations, behind, angles[:, 0], frequency_hz)


def wave_data(beat: wave.Wave, unit: str) -> dict[str, Any]:
    """Return a body wave as plain data: a dict by quantity."""
    found: dict[str, Any] = {"frequency_hz": beat.frequency_hz, "windows": beat.windows}
    for name, one, of in (("wavelength", beat.length, unit), ("wave_speed", beat.speed, f"{unit}_s")):
        found |= {f"{name}_{of}": None, f"{name}_ci95": None}
        if one is not None:
            found |= {f"{name}_{of}": one.value, f"{name}_ci95": [one.low, one.high]}
    found[f"stations_{unit}"] = [float(value) for value in beat.behind]
    found[f"amplitude_{unit}"] = [one.value for one in beat.amplitude]
    found["amplitude_ci95"] = [[one.low, one.high] for one in beat.amplitude]
    found["phase_rad"] = [one.value for one in beat.phase]
    found["phase_ci95"] = [[one.low, one.high] for one in beat.phase]
    return found


def _swing_table(posed: Posed) -> Table:
    """Return the table of mean and amplitude of each joint angle that swings."""
    rows = []
    for name, one in posed.swings.items():
        ends = (one.amplitude.value, one.amplitude.low, one.amplitude.high)
        rows.append([name, one.frequency_hz, math.degrees(one.mean), *map(math.degrees, ends)])
    caption = "Constant and sine of a joint angle; the interval is that of single cycles."
    if posed.zero == "mean":
        caption += " The means are taken off in the log."
    columns = ["joint angle", "frequency, Hz", "mean, deg", "amplitude, deg", "95 % from", "to"]
    return Table(id="swings", title="Joint angles", columns=columns, rows=rows, caption=caption)


def _wave_table(beat: wave.Wave, unit: str) -> Table:
    rows: list[list[Any]] = []
    for name, one, of in (("wavelength", beat.length, unit), ("wave speed", beat.speed, f"{unit}/s")):
        if one is None:
            rows.append([f"{name}: no travelling wave", None, None, None])
        else:
            rows.append([f"{name}, {of}", one.value, one.low, one.high])
    for behind, size, lag in zip(beat.behind, beat.amplitude, beat.phase, strict=True):
        place = f"{numbers.format_number(float(behind), 3)} {unit} behind the front"
        rows.append([f"amplitude {place}, {unit}", size.value, size.low, size.high])
        rows.append([f"phase lag {place}, rad", lag.value, lag.low, lag.high])
    caption = (
        f"Lateral motion at {beat.frequency_hz:.4g} Hz, in {beat.windows} windows of {wave.CYCLES} cycles. "
        "The phase lag is that behind the station that moves most."
    )
    columns = ["body wave", "value", "95 % from", "to"]
    return Table(id="wave", title="Body wave", columns=columns, rows=rows, caption=caption)


def figures(posed: Posed, beat: wave.Wave | None) -> list[Figure]:
    """Return the figure of the body wave; no figure if there is no wave."""
    if beat is None:
        return []
    label, panels = f"distance behind the front end ({posed.unit})", []
    for name, found in (
        (f"lateral amplitude ({posed.unit})", beat.amplitude),
        ("phase lag (rad)", beat.phase),
    ):
        values = [one.value for one in found]
        lower, upper = [one.low for one in found], [one.high for one in found]
        trace = Trace(x=list(beat.behind), y=values, lower=lower, upper=upper, group=0)
        dots = Trace(x=list(beat.behind), y=values, style="points", group=0)
        panels.append(ev.panel(label, name, [trace, dots]))
    text = "No travelling wave is significant."
    if beat.length is not None and beat.speed is not None:
        length = numbers.interval(beat.length.low, beat.length.high, unit=posed.unit)
        speed = numbers.interval(beat.speed.low, beat.speed.high, unit=f"{posed.unit}/s")
        text = f"Wavelength {length}, wave speed {speed} (95 %)."
    caption = f"Lateral motion of the body at {beat.frequency_hz:.4g} Hz, with 95 % intervals. {text}"
    return [ev.panels("wave", "Body wave", caption, panels)]
