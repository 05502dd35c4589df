"""What ``swimid track imu`` says of a run: result, summary, checks, tables and methods."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from swimid.inertial import mounting
from swimid.inertial.alignment import Poses
from swimid.inertial.errorstate import LEVER
from swimid.inertial.sensor import DEG, MILLI_G
from swimid.inertial.track_imu_checks import checks
from swimid.inertial.track_imu_figures import figures
from swimid.inertial.track_imu_material import Material, contradicts, stated_frequency
from swimid.inertial.trust import BAND
from swimid.notices import Notice
from swimid.results import evidence as ev


def result(m: Material) -> dict[str, Any]:
    """The run for machines."""
    t = m.record.time_s
    out: dict[str, Any] = {
        "method": m.settings.method,
        "samples": len(t),
        "duration_s": float(t[-1] - t[0]),
        "sample_time_s": m.record.step_s,
        "attitude_from": m.source.kind,
        "still_periods": [
            {
                "from_s": float(t[r.first]),
                "to_s": float(t[r.last - 1]),
                "at": r.at,
                "used_as_rest": r in m.still.used,
            }
            for r in m.still.found
        ],
        "noise": {
            "acceleration_m_s2_per_rt_hz": m.still.noise.acceleration,
            "rate_rad_s_per_rt_hz": m.still.noise.rate,
            "source": m.still.noise.source,
        },
        "faults": [
            {"fault": f.fault, "verdict": f.verdict, "text": f.text, "count": f.count} for f in m.findings
        ],
        "mounting": _mounting(m),
        "stroke": _stroke(m),
    }
    if m.paper is not None:
        out["motion_mode"] = m.settings.mode
        out["constant_part"] = {
            "acceleration_m_s2": m.paper.removed_acceleration.tolist(),
            "rate_rad_s": m.paper.removed_rate.tolist(),
        }
        return out
    assert m.motion is not None
    if m.bias is not None:
        out["bias"] = {"acceleration_m_s2": m.bias[:3].tolist(), "rate_rad_s": m.bias[3:].tolist()}
    out["empty_share"] = float(np.mean(np.isnan(m.motion.velocity[:, 0])))
    out["impossible"] = list(m.impossible)
    out["surge_oscillation"] = {
        "rms_m_s": None if m.surge_osc is None else _largest(np.sqrt(np.mean(np.square(m.surge_osc)))),
        "sd_m_s": m.surge_osc_sd,
        "above_hz": m.cutoff_hz,
    }
    out["largest_band_95"] = {
        "position_m": _largest(BAND * m.motion.position_sd),
        "velocity_m_s": _largest(BAND * m.motion.velocity_sd),
        "yaw_rad": _largest(BAND * m.motion.angle_sd[:, 2]),
    }
    if m.trust is not None:
        out["path_trusted"] = {"until_s": m.trust.until_s, "seconds": m.trust.seconds}
    if m.rest_score is not None:
        out["rest_innovation_rms"] = m.rest_score
    if m.fused is not None:
        out["fusion"] = _fusion(m)
    return out


def _largest(values: Any) -> float | None:
    """None where there is none."""
    there = np.asarray(values)[np.isfinite(values)]
    return float(there.max()) if there.size else None


def _mounting(m: Material) -> dict[str, Any]:
    rotation = m.mount.rotation if m.fused is None else m.fused.smoothed.path.mount
    roll, pitch = mounting.tilt_at_rest(m.mount.up, rotation)
    out: dict[str, Any] = {"by": m.mount.by, "roll_at_rest_rad": roll, "pitch_at_rest_rad": pitch}
    if m.fused is not None:
        path = m.fused.smoothed.path
        out["body_to_sensor_rotation_vector_rad"] = rotation.as_rotvec().tolist()
        out["lever_m"] = (-rotation.inv().apply(path.lever)).tolist()
        out["lever_sd_m"] = np.sqrt(np.diag(m.fused.smoothed.errors.covariance[-1])[LEVER]).tolist()
        out["world_tilt_rad"] = path.tilt.tolist()
    return out


def _stroke(m: Material) -> dict[str, Any] | None:
    if m.stroke is None:
        return None
    beat, stated = m.stroke.beat, stated_frequency(m)
    return {
        "channel": m.stroke.channel,
        "frequency_hz": beat.frequency_hz,
        "stderr_hz": beat.stderr_hz,
        "harmonics": [
            {"frequency_hz": h.order * beat.frequency_hz, "amplitude": h.amplitude, "stderr": h.stderr}
            for h in m.stroke.harmonics
        ],
        "stated_hz": stated,
        "contradicts": stated is not None and contradicts(m.stroke, stated),
    }


def _fusion(m: Material) -> dict[str, Any]:
    assert m.fused is not None
    offset, before = m.fused.offset, m.fused.clocks
    scores = m.fused.smoothed.errors.scores
    return {
        "clock_offset_s": offset.value_s,
        "clock_offset_95_s": [offset.low_s, offset.high_s],
        "before_fusing": {
            "by": before.by,
            "clock_offset_s": before.offset.value_s,
            "clock_offset_95_s": [before.offset.low_s, before.offset.high_s],
            "explained": before.offset.explained,
        },
        "fix_sd_m": m.fused.fixes.position_sd.tolist(),
        "fix_sd_rad": None if m.fused.fixes.rotation is None else m.fused.fixes.rotation_sd,
        "innovation_rms": {k: float(np.sqrt(np.nanmean(v**2))) for k, v in scores.items()},
        "fixes_used": len(scores.get("position", ())),
        "fixes_stray": m.fused.stray,
        "clocks_agree": m.fused.agree,
        "widened_by_lasting_errors": m.fused.lasting,
        "held_out": None
        if m.fused.held_out is None
        else {
            "fixes": m.fused.held_out.count,
            "rms_m": _largest(m.fused.held_out.rms_m),
            "deviations": m.fused.held_out.deviations,
        },
    }


# ---------------------------------------------------------------- for readers


def summary(m: Material, machine: dict[str, Any]) -> str:
    """The run for the terminal: what can be trusted first."""
    n, d = machine["samples"], machine["duration_s"]
    lines = [
        f"{m.record.name}: {n} samples over {d:.1f} s, method "
        f"{m.settings.method}, attitude from {m.source.kind}"
    ]
    lines += [f"  {_reach(m)}"]
    if m.motion is not None and m.surge_osc is not None:
        rms = machine["surge_oscillation"]["rms_m_s"]
        if m.surge_osc_sd is not None and rms is not None:
            lines.append(
                f"  surge within a stroke (above {m.cutoff_hz:.2f} Hz): {rms:.4f} m/s "
                f"rms, ± {BAND * m.surge_osc_sd:.4f}"
            )
    for check in checks(m):
        lines.append(
            f"  {check.verdict:4}  {check.name}: {check.value}"
            + (f"  ({check.limit})" if check.limit else "")
        )
    return "\n".join(line for line in lines if line)


def _reach(m: Material) -> str:
    if m.paper is not None:
        mode = m.settings.mode
        return f"the paper's way, {mode} mode: it states no uncertainty; its velocity ends as it began"
    assert m.motion is not None
    if not np.isfinite(m.motion.position).any():
        return "no motion that can be: positions and velocities are empty, the attitude is the filter's"
    if m.fused is not None:
        half = BAND * np.max(m.motion.position_sd[:, :2], axis=1)
        usual, worst = np.median(half), np.max(half)
        return f"position to ± {usual:.4f} m (median of the 95 % band), ± {worst:.3f} m at worst"
    assert m.trust is not None
    if m.trust.seconds is None:
        widest = m.trust.widest_m
        return f"path: the 95 % band stays within 0.1 m or a tenth of the way (widest ± {widest:.3f} m)"
    return (
        f"path: NOT to be trusted after {m.trust.seconds:.1f} s of motion (t = {m.trust.until_s:.1f} s); "
        f"95 % band at worst ± {m.trust.widest_m:.1f} m"
    )


def record(
    m: Material, poses: Poses | None, machine: dict[str, Any], notices: list[Notice], block: dict[str, Any]
) -> ev.Evidence:
    """Everything the report shows of a run."""
    found = checks(m)
    doubts = [c.name.lower() for c in found if c.verdict in ("warn", "fail")]
    text = _reach(m)[0].upper() + _reach(m)[1:]
    failed = any(c.verdict == "fail" for c in found)
    level: Literal["good", "caution", "bad"] = (
        "bad" if failed else "caution" if doubts or m.paper is not None else "good"
    )
    return ev.Evidence(
        verb="track imu",
        title=f"Motion of {m.record.name}",
        verdict=ev.Verdict(
            level=level, text=text + (f". Look at: {', '.join(dict.fromkeys(doubts))}." if doubts else ".")
        ),
        checks=found,
        tables=_tables(m, machine),
        figures=figures(m, poses),
        notices=[ev.NoticeRecord(code=n.code, text=n.text) for n in notices],
        methods=_methods(m),
        references=_references(m),
        provenance=block,
    )


def _tables(m: Material, machine: dict[str, Any]) -> list[ev.Table]:
    rows: list[list[Any]] = [
        [p["from_s"], p["to_s"], p["at"], "yes" if p["used_as_rest"] else "no"]
        for p in machine["still_periods"]
    ]
    tables = [
        ev.Table(
            id="still",
            title="Still periods",
            columns=["from (s)", "to (s)", "where", "taken as rest"],
            rows=rows,
        )
    ]
    if m.bias is not None:
        tables.append(
            ev.Table(
                id="biases",
                title="Biases at the end",
                columns=["axis", "accelerometer (mg)", "gyroscope (deg/s)"],
                rows=[
                    [a, float(m.bias[i] / MILLI_G), float(m.bias[3 + i] / DEG)] for i, a in enumerate("xyz")
                ],
                caption="Sensor axes. At rest in one attitude a horizontal bias and a tilt "
                "cannot be told apart.",
            )
        )
    return tables


def _methods(m: Material) -> list[str]:
    if m.paper is not None:
        return [
            "Velocity and position were computed from accelerations as by Shang et "
            "al. (2012): means removed for "
            f"{m.settings.mode} mode, readings below {m.settings.threshold_m_s2:g} m/s² and "
            f"{m.settings.threshold_rad_s:g} rad/s set to zero, rotation to earth "
            f"axes (Eqs 10 and 11), trapezoidal "
            "integration (Eqs 12 and 13)."
        ]
    used = "an inertial unit" if m.fused is None else "an inertial unit and a second log of the trial"
    text = [
        f"Motion was estimated from {used} by an error-state Kalman filter and "
        f"Rauch-Tung-Striebel smoother over "
        "position, velocity, attitude and sensor biases"
        + (", mounting, lever arm and clock offset" if m.fused is not None else "")
        + f"; attitude from {m.source.kind}.",
    ]
    if m.settings.declared.zero_mean:
        text.append(
            f"Declared: mean {' and '.join(m.settings.declared.zero_mean)} of zero "
            f"over {m.settings.declared.window_s:g} s."
        )
    return text


def _references(m: Material) -> list[str]:
    shang = (
        "Shang, L., Wang, S., Tan, M., Cheng, L. (2012). Swimming locomotion "
        "modeling for biomimetic underwater "
        "vehicle with two undulating long-fins. Robotica 30, 913-923. doi:10.1017/S0263574711001159"
    )
    rauch = (
        "Rauch, H. E., Tung, F., Striebel, C. T. (1965). Maximum likelihood "
        "estimates of linear dynamic systems. "
        "AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166"
    )
    groves = (
        "Groves, P. D. (2013). Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, "
        "2nd ed. Artech House."
    )
    vqf = (
        "Laidig, D., Seel, T. (2023). VQF: Highly accurate IMU orientation "
        "estimation with bias estimation and "
        "magnetic disturbance rejection. Information Fusion 91, 187-204. doi:10.1016/j.inffus.2022.10.014"
    )
    filtered = [] if m.record.quaternion is not None else [vqf]
    return [shang, *filtered] if m.paper is not None else [rauch, groves, *filtered]


def settings(m: Material) -> dict[str, Any]:
    """The options of a run, for its provenance."""
    s, d = m.settings, m.settings.declared
    return {
        "method": s.method,
        "motion_mode": s.mode,
        "still_s": [list(w) for w in d.still],
        "rest": d.rests,
        "zero_mean": list(d.zero_mean),
        "top_speed_m_s": d.top_speed_m_s,
        "mount_deg": None if s.mount_deg is None else list(s.mount_deg),
        "level_at_rest": s.level_at_rest,
        "lever_m": None if d.lever_m is None else [float(v) for v in d.lever_m],
        "clock_offset_s": s.clock_offset_s,
        "fix_sd_m": s.fix_sd_m,
        "sensor": dict(vars(s.sensor)),
    }
