"""The checks of ``swimid track imu``: what each found, against which limit."""

from __future__ import annotations

import numpy as np

from swimid.formats import evidence as ev
from swimid.inertial import mounting
from swimid.inertial.record import GRAVITY_M_S2
from swimid.inertial.rest import mean_acceleration
from swimid.inertial.sensor import DEG, MILLI_G
from swimid.inertial.trust import BAND
from swimid.verbs.track_imu_material import Material, contradicts, stated_frequency

#: Innovations larger than this, in their own deviations (rms), say that something stated is wrong.
REST_LIMIT, FIX_LIMIT = 2.0, 1.5
#: Gravity at rest may be off by this share before it is worth a warning.
GRAVITY_SHARE = 0.02


def checks(m: Material) -> list[ev.Check]:
    """The checks of a run."""
    found = [_still_check(m), _gravity_check(m), _tilt_check(m)]
    found += [
        ev.Check(
            name=f.fault.capitalize(), value=f.text, verdict="warn" if f.verdict == "handled" else "info"
        )
        for f in m.findings
    ]
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
    size = float(np.linalg.norm(mean_acceleration(m.record, m.still.found)))
    off = abs(size / GRAVITY_M_S2 - 1)
    return ev.Check(
        name="Gravity",
        value=f"{size:.3f} m/s²" + (" at rest" if m.still.found else " on average"),
        limit=f"{GRAVITY_M_S2:.3f} ± {100 * GRAVITY_SHARE:.0f} %",
        verdict="pass" if off <= GRAVITY_SHARE else "warn",
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
    if m.fused is None:
        top, fastest = m.settings.declared.top_speed_m_s, np.linalg.norm(m.motion.velocity, axis=1).max()
        found.append(
            ev.Check(
                name="Top speed",
                value=f"{fastest:.2f} m/s",
                limit=f"taken as never above {top:g} m/s (--top-speed-m-s)",
                verdict="pass" if fastest <= top else "warn",
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
            text="To add to the other log's times; the output is on the inertial clock.",
        )
    ]
    for kind, name in (("position", "Positions"), ("orientation", "Angles")):
        if kind not in scores:
            continue
        size = float(np.sqrt(np.nanmean(scores[kind] ** 2)))
        lost = m.fused.smoothed.errors.rejected.get(kind, 0)
        found.append(
            ev.Check(
                name=f"{name} agree with the sensor",
                value=f"innovations {size:.2f} of their deviation (rms), {lost} of "
                f"{lost + len(scores[kind])} left out",
                limit=f"below {FIX_LIMIT:g}",
                verdict="pass" if size <= FIX_LIMIT and lost <= 0.02 * len(scores[kind]) else "warn",
            )
        )
    return found


def _stroke_check(m: Material) -> list[ev.Check]:
    if m.stroke is None:
        return []
    beat, stated = m.stroke.beat, stated_frequency(m)
    wrong = stated is not None and contradicts(m.stroke, stated)
    harmonics = ", ".join(f"{h.order}×: {h.amplitude:.3g}" for h in m.stroke.harmonics)
    return [
        ev.Check(
            name="Stroke",
            value=f"{beat.frequency_hz:.4f} ± {BAND * beat.stderr_hz:.4f} Hz in "
            f"{m.stroke.channel}; harmonics {harmonics}",
            limit="" if stated is None else f"metadata: {stated:g} Hz",
            verdict="info" if stated is None else "warn" if wrong else "pass",
        )
    ]
