"""The checks of ``swimid track imu``: what each found, against which limit."""

from __future__ import annotations

import numpy as np

from swimid.inertial import mounting
from swimid.inertial.aiding import GATE
from swimid.inertial.fusion import FEW, FORETOLD, LASTING
from swimid.inertial.record import GRAVITY_M_S2
from swimid.inertial.rest import mean_accelerations
from swimid.inertial.sensor import DEG, MILLI_G
from swimid.inertial.track_imu_material import Material, contradicts, stated_frequency
from swimid.inertial.trust import BAND
from swimid.results import evidence as ev

#: Innovations larger than this, in their own deviations (rms), say that something stated is wrong. Two rests
#: make six at least, whose chi-square exceeds four times its freedom in 1 of 2000 cases when all is as
#: stated; their deviations hold the errors of the sensor's class (``swimid.inertial.sensor.CHIP``).
REST_LIMIT, FIX_LIMIT = 2.0, FORETOLD


def checks(m: Material) -> list[ev.Check]:
    """The checks of a run."""
    found = [_still_check(m), _gravity_check(m), _tilt_check(m)]
    found += [
        ev.Check(
            name=f.fault.capitalize(), value=f.text, verdict="warn" if f.verdict == "handled" else "info"
        )
        for f in m.findings
    ]
    if m.impossible:
        found.append(
            ev.Check(
                name="Possible motion",
                value="; ".join(m.impossible),
                limit="none; positions and velocities left empty",
                verdict="fail",
            )
        )
    found += _path_checks(m)
    found += _stroke_check(m)
    return found


def _still_check(m: Material) -> ev.Check:
    t = m.record.time_s
    seconds = sum(float(t[r.last - 1] - t[r.first]) for r in m.still.found)
    used = sum(float(t[r.last - 1] - t[r.first]) for r in m.still.used)
    return ev.Check(
        name="Still periods",
        value=f"{len(m.still.found)}, {seconds:.1f} s; {used:.1f} s of them taken as rest; noise "
        f"{m.still.noise.acceleration / MILLI_G:.2f} mg/√Hz, "
        f"{60 * m.still.noise.rate / DEG:.2f} deg/√h ({m.still.noise.source})",
        limit="at least one",
        verdict="pass" if m.still.found else "warn",
    )


def _gravity_check(m: Material) -> ev.Check:
    size = float(np.mean(np.linalg.norm(mean_accelerations(m.record, m.still.found), axis=1)))
    off = abs(size / GRAVITY_M_S2 - 1)
    # the 95 % band of the bias and scale of the sensor's class
    sensor = m.settings.sensor
    share = BAND * float(np.hypot(sensor.acceleration_bias_sd / GRAVITY_M_S2, sensor.scale_sd))
    return ev.Check(
        name="Gravity",
        value=f"{size:.3f} m/s²" + (" at rest" if m.still.found else " on average"),
        limit=f"{GRAVITY_M_S2:.3f} ± {100 * share:.1f} %",
        verdict="pass" if off <= share else "warn",
    )


def _tilt_check(m: Material) -> ev.Check:
    rotation = m.mount.rotation if m.fused is None else m.fused.smoothed.path.mount
    roll, pitch = mounting.tilt_at_rest(m.mount.up, rotation)
    return ev.Check(
        name="Tilt at rest",
        value=f"roll {roll / DEG:.2f} deg, pitch {pitch / DEG:.2f} deg (mounting: {m.mount.by})",
        verdict="info",
        text="A level robot tells the mounting so: --level-at-rest takes this tilt as the mounting's.",
    )


def _path_checks(m: Material) -> list[ev.Check]:
    if m.motion is None:
        return []
    found = []
    if m.trust is not None:
        value = "all of it" if m.trust.seconds is None else f"{m.trust.seconds:.1f} s of motion"
        found.append(
            ev.Check(
                name="Path trusted for",
                value=value,
                limit="95 % band within 0.1 m or a tenth of the way",
                verdict="pass" if m.trust.seconds is None else "warn",
            )
        )
        yaw = m.motion.angle_sd[-1, 2] / DEG
        found.append(
            ev.Check(
                name="Heading",
                value=f"± {BAND * yaw:.1f} deg at the end (95 %), "
                + ("held by its reference" if m.source.heading else "drifts: nothing holds it"),
                verdict="pass" if m.source.heading else "info",
            )
        )
    speed = np.linalg.norm(m.motion.velocity, axis=1)
    if m.fused is None and np.isfinite(speed).any():
        top, fastest = m.settings.declared.top_speed_m_s, float(np.nanmax(speed))
        found.append(
            ev.Check(
                name="Top speed",
                value=f"{fastest:.2f} m/s",
                limit=f"taken as never above {top:g} m/s (--top-speed-m-s)",
                verdict="pass" if np.isfinite(speed).all() and fastest <= top else "warn",
            )
        )
    if m.rest_score is not None:
        found.append(
            ev.Check(
                name="Rests agree with the motion",
                value=f"innovations {m.rest_score:.2f} of their deviation (rms)",
                limit=f"below {REST_LIMIT:g}",
                verdict="pass" if m.rest_score <= REST_LIMIT else "warn",
            )
        )
    if m.fused is not None:
        found += _fusion_checks(m)
    return found


def _fusion_checks(m: Material) -> list[ev.Check]:
    assert m.fused is not None
    offset, scores = m.fused.offset, m.fused.smoothed.errors.scores
    found = [
        ev.Check(
            name="Clock offset",
            value=f"{1e3 * offset.value_s:.2f} ms (95 %: {1e3 * offset.low_s:.2f} … "
            f"{1e3 * offset.high_s:.2f})",
            limit="0 within the interval",
            verdict="warn" if offset.excludes_zero and m.settings.clock_offset_s is None else "pass",
            text="To add to the other log's times; the output is on the inertial clock."
            + (" Clocks that agree explain both logs as well." if m.fused.agree else ""),
        )
    ]
    for kind, name in (("position", "Positions"), ("orientation", "Angles")):
        if kind not in scores:
            continue
        size = float(np.sqrt(np.nanmean(scores[kind] ** 2)))
        found.append(
            ev.Check(
                name=f"{name} agree with the sensor",
                value=f"innovations {size:.2f} of their deviation (rms)",
                limit=f"below {FIX_LIMIT:g}",
                verdict="pass" if size <= FIX_LIMIT else "warn",
            )
        )
    count, stray = len(m.fused.fixes.time_s), m.fused.stray
    found.append(
        ev.Check(
            name="Stray fixes",
            value=f"{stray} of {count} beyond {GATE:g} deviations",
            limit=f"at most {100 * FEW:.0f} %",
            verdict="pass" if stray <= FEW * count else "warn",
        )
    )
    found.append(
        ev.Check(
            name="Errors of the fixes last",
            value=f"the band is {m.fused.lasting:.2f} times as wide for it",
            limit=f"below {LASTING:g}",
            verdict="pass" if m.fused.lasting <= LASTING else "fail",
            text="1 where each fix is off by itself. A wrong scale or marker makes errors that last.",
        )
    )
    held_out = m.fused.held_out
    if held_out is None:
        text, verdict = "too few fixes to leave some out: the band is not held against any", "warn"
    else:
        text = f"{held_out.count} foretold to {held_out.deviations:.2f} of their deviation (rms)"
        if np.isfinite(held_out.rms_m):
            text += f", {held_out.rms_m:.4f} m"
        verdict = "pass" if held_out.deviations <= FIX_LIMIT else "fail"
    found.append(
        ev.Check(
            name="Fixes left out",
            value=text,
            limit=f"below {FIX_LIMIT:g}; every band is widened by what is more than 1",
            verdict=verdict,
        )
    )
    return found


def _stroke_check(m: Material) -> list[ev.Check]:
    if m.stroke is None:
        return []
    beat, stated = m.stroke.beat, stated_frequency(m)
    wrong = stated is not None and contradicts(m.stroke, stated)
    doubt = m.stroke.doubt if stated is None else ""
    harmonics = ", ".join(f"{h.order}×: {h.amplitude:.3g}" for h in m.stroke.harmonics)
    return [
        ev.Check(
            name="Stroke",
            value=f"{beat.frequency_hz:.4f} ± {BAND * beat.stderr_hz:.4f} Hz in "
            f"{m.stroke.channel}; harmonics {harmonics}",
            limit="" if stated is None else f"metadata: {stated:g} Hz",
            verdict="warn" if wrong or doubt else "info" if stated is None else "pass",
            text=doubt,
        )
    ]
