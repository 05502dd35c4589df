"""The checks of ``swimid track imu``: what each found, against which limit; and what is warned of."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from swimid.inertial.aiding import GATE
from swimid.inertial.fusion import FEW, FORETOLD, LASTING, Fused
from swimid.inertial.record import GRAVITY_M_S2
from swimid.inertial.rest import mean_accelerations
from swimid.inertial.run import Run
from swimid.inertial.sensor import BAND, DEG, MILLI_G
from swimid.results import blocks
from swimid.results.evidence import Check, check

#: Innovations larger than this, in their own deviations (rms), say that something stated is wrong. Two rests
#: make six at least, whose chi-square exceeds four times its freedom in 1 of 2000 cases when all is as
#: stated; their deviations hold the errors of the sensor's class (``swimid.inertial.sensor.CHIP``).
REST_LIMIT, FIX_LIMIT = 2.0, FORETOLD


def checks(run: Run) -> list[Check]:
    """The checks of a run."""
    listed = [_still(run), _gravity(run), _tilt(run)]
    grades = {"noted": "info", "handled": "warn", "refuted": "fail"}
    listed += [
        Check(name=f.fault.capitalize(), value=f.text, verdict=grades[f.verdict]) for f in run.findings
    ]
    if run.impossible:
        value, limit = "; ".join(run.impossible), "none; positions and velocities left empty"
        listed.append(blocks.check("Possible motion", value, limit, False, otherwise="fail"))
    return [*listed, *_path(run), *_fusion(run), *_stroke(run)]


def _still(run: Run) -> Check:
    t = run.record.time_s
    seconds = sum(float(t[r.last - 1] - t[r.first]) for r in run.still.stretches)
    used = sum(float(t[r.last - 1] - t[r.first]) for r in run.still.rests)
    noise = run.still.noise
    value = (
        f"{len(run.still.stretches)}, {seconds:.1f} s; {used:.1f} s of them taken as rest; noise "
        f"{noise.acceleration / MILLI_G:.2f} mg/√Hz, {60 * noise.rate / DEG:.2f} deg/√h ({noise.source})"
    )
    return check("Still periods", value, bool(run.still.stretches), "at least one")


def _gravity(run: Run) -> Check:
    size = float(np.mean(np.linalg.norm(mean_accelerations(run.record, run.still.stretches), axis=1)))
    off = abs(size / GRAVITY_M_S2 - 1)
    # the 95 % band of the bias and scale of the sensor's class
    share = BAND * float(np.hypot(run.sensor.acceleration_bias_sd / GRAVITY_M_S2, run.sensor.scale_sd))
    value = f"{size:.3f} m/s²" + (" at rest" if run.still.stretches else " on average")
    return check("Gravity", value, off <= share, f"{GRAVITY_M_S2:.3f} ± {100 * share:.1f} %")


def _tilt(run: Run) -> Check:
    roll, pitch = run.tilt
    value = f"roll {roll / DEG:.2f} deg, pitch {pitch / DEG:.2f} deg (mounting: {run.mount.by})"
    text = "A level robot tells the mounting so: --level-at-rest takes this tilt as the mounting's."
    return check("Tilt at rest", value, None, text=text)


def _path(run: Run) -> Iterator[Check]:
    if run.motion is None:
        return
    if run.trust is not None:
        reach = run.trust.seconds
        value = "all of it" if reach is None else f"{reach:.1f} s of motion"
        yield check("Path trusted for", value, reach is None, "95 % band within 0.1 m or a tenth of the way")
        held = "held by its reference" if run.source.heading else "drifts: nothing holds it"
        value = f"± {BAND * run.motion.angle_sd[-1, 2] / DEG:.1f} deg at the end (95 %), {held}"
        yield check("Heading", value, True if run.source.heading else None)
    speed = np.linalg.norm(run.motion.velocity, axis=1)
    if run.fused is None and np.isfinite(speed).any():
        top, fastest = run.options.top_speed_m_s, float(np.nanmax(speed))
        passed = bool(np.isfinite(speed).all()) and fastest <= top
        limit = f"taken as never above {top:g} m/s (--top-speed-m-s)"
        yield check("Top speed", f"{fastest:.2f} m/s", passed, limit)
    yield from _innovations("Rests agree with the motion", run.rest_score, REST_LIMIT)


def _innovations(name: str, size: float | None, limit: float) -> Iterator[Check]:
    if size is not None:
        yield check(
            name, f"innovations {size:.2f} of their deviation (rms)", size <= limit, f"below {limit:g}"
        )


def _fusion(run: Run) -> Iterator[Check]:
    fused = run.fused
    if run.motion is None or fused is None:
        return
    o = fused.offset
    value = f"{1e3 * o.value_s:.2f} ms (95 %: {1e3 * o.low_s:.2f} … {1e3 * o.high_s:.2f})"
    text = "To add to the other log's times; the output is on the inertial clock."
    if fused.agree:
        text += " Clocks that agree explain both logs as well."
    agreed = not o.excludes_zero or run.options.clock_offset_s is not None
    yield check("Clock offset", value, agreed, "0 within the interval", text)
    for kind, name in (("position", "Positions"), ("orientation", "Angles")):
        yield from _innovations(f"{name} agree with the sensor", fused.smoothed.score(kind), FIX_LIMIT)
    count, stray = len(fused.fixes.time_s), fused.stray
    value = f"{stray} of {count} beyond {GATE:g} deviations"
    yield check("Stray fixes", value, stray <= FEW * count, f"at most {100 * FEW:.0f} %")
    value = f"the band is {fused.lasting:.2f} times as wide for it"
    text = "1 where each fix is off by itself. A wrong scale or marker makes errors that last."
    passed, limit = fused.lasting <= LASTING, f"below {LASTING:g}"
    yield blocks.check("Errors of the fixes last", value, limit, passed, otherwise="fail", text=text)
    limit = f"below {FIX_LIMIT:g}; every band is widened by what is more than 1"
    held_out = fused.held_out
    if held_out is None:
        value = "too few fixes to leave some out: the band is not held against any"
        yield blocks.check("Fixes left out", value, limit, False)
    else:
        place = "" if held_out.rms_m is None else f", {held_out.rms_m:.4f} m"
        value = f"{held_out.fixes} foretold to {held_out.deviations:.2f} of their deviation (rms){place}"
        passed = held_out.deviations <= FIX_LIMIT
        yield blocks.check("Fixes left out", value, limit, passed, otherwise="fail")


def _stroke(run: Run) -> Iterator[Check]:
    if run.stroke is None:
        return
    beat, stated = run.stroke.beat, run.stated_hz
    harmonics = ", ".join(f"{h.order}×: {h.amplitude:.3g}" for h in run.stroke.harmonics)
    value = (
        f"{beat.frequency_hz:.4f} ± {BAND * beat.stderr_hz:.4f} Hz in {run.stroke.channel}; "
        f"harmonics {harmonics}"
    )
    if stated is None:
        yield check("Stroke", value, False if run.doubt else None, text=run.doubt)
    else:
        yield check("Stroke", value, not run.contradicted, f"metadata: {stated:g} Hz")


# ---------------------------------------------------------------- warnings


def warnings(run: Run) -> Iterator[tuple[str, str]]:
    """Code and text of everything to warn of."""
    name, trust, fused, rest_score = run.record.name, run.trust, run.fused, run.rest_score
    for finding in run.findings:
        if finding.verdict == "handled":
            yield "SWM080", f"{name}, {finding.fault}: {finding.text}"
        elif finding.verdict == "refuted":
            yield "SWM090", f"{name}: {finding.text}"
    if run.impossible:
        text = (
            f"{name}: {'; '.join(run.impossible)}: no such motion can be; its positions and velocities are "
            "empty. Name the true rests with --still, or fuse a camera log (--with)"
        )
        yield "SWM086", text
    if not run.still.stretches:
        text = (
            f"{name}: no still period found; the biases are known to data-sheet accuracy only. Let the robot "
            "rest for some seconds before and after a run, or name a rest with --still"
        )
        yield "SWM082", text
    if trust is not None and trust.seconds is not None:
        text = (
            f"{name}: the integrated position is not to be trusted after {trust.seconds:.1f} s of motion "
            f"(at t = {trust.until_s:.1f} s its 95 % band exceeds 0.1 m and a tenth of the way)"
        )
        yield "SWM081", text
    if fused is not None:
        yield from _fusion_warnings(run, fused)
    if rest_score is not None and rest_score > REST_LIMIT:
        text = (
            f"{name}: the motion between rests does not close within its band ({rest_score:.1f} deviations "
            "rms): one of them is no rest of the body, or the sensor is worse than stated"
        )
        yield "SWM084", text
    if run.doubt:
        yield "SWM033", f"{name}: {run.doubt}"
    if run.stroke is not None and run.contradicted:
        low, high = run.stroke.beat.interval_hz
        text = (
            f"{name}: the metadata says frequency_hz {run.stated_hz:g}, {run.stroke.channel} beats at "
            f"{run.stroke.beat.frequency_hz:.4g} Hz (95 %: {low:.4g} ... {high:.4g})"
        )
        yield "SWM032", text


def _fusion_warnings(run: Run, fused: Fused) -> Iterator[tuple[str, str]]:
    name, o, count = run.record.name, fused.offset, len(fused.fixes.time_s)
    if run.options.clock_offset_s is None and o.excludes_zero:
        text = (
            f"the clocks differ: {1e3 * o.value_s:.1f} ms to add to the other log "
            f"(95 %: {1e3 * o.low_s:.1f} ... {1e3 * o.high_s:.1f} ms); the output is on the inertial clock"
        )
        yield "SWM083", text
    if fused.stray > FEW * count:
        text = (
            f"{name}: {fused.stray} of {count} fixes of the other log lie beyond "
            f"{GATE:g} deviations of the motion: the two logs contradict each other"
        )
        yield "SWM087", text
    if fused.lasting > LASTING:
        text = (
            f"{name}: many fixes of the other log on end are off by the same (as fused they scatter "
            f"by {np.max(fused.fixes.noise[:2]):.3g} m): the logs contradict each other, or its "
            f"scale or marker is wrong; every band is widened by {fused.lasting:.1f}"
        )
        yield "SWM087", text
