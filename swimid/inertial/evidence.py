"""What ``swimid track imu`` says of a run: log, summary, checks, tables and methods."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swimid.inertial.checks import checks
from swimid.inertial.errorstate import PARTS
from swimid.inertial.figures import figures
from swimid.inertial.fusion import Fused
from swimid.inertial.record import Array
from swimid.inertial.run import Run
from swimid.inertial.sensor import BAND, DEG, MILLI_G
from swimid.logs import log
from swimid.logs.log import Log
from swimid.logs.logged import Logged
from swimid.notices import Notice
from swimid.results import blocks
from swimid.results.evidence import Check, Evidence, Table, Verdict

SHANG = (
    "Shang, L., Wang, S., Tan, M., Cheng, L. (2012). Swimming locomotion modeling for biomimetic underwater "
    "vehicle with two undulating long-fins. Robotica 30, 913-923. doi:10.1017/S0263574711001159"
)
RAUCH = (
    "Rauch, H. E., Tung, F., Striebel, C. T. (1965). Maximum likelihood estimates of linear dynamic systems. "
    "AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166"
)
GROVES = (
    "Groves, P. D. (2013). Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, "
    "2nd ed. Artech House."
)
VQF = (
    "Laidig, D., Seel, T. (2023). VQF: Highly accurate IMU orientation estimation with bias estimation and "
    "magnetic disturbance rejection. Information Fusion 91, 187-204. doi:10.1016/j.inffus.2022.10.014"
)


def result(run: Run, notices: Sequence[Notice], provenance: dict[str, Any]) -> Logged:
    """The log of a run with its evidence."""
    columns, data, checked = run.columns(), _facts(run), checks(run)
    kept = {k: v for k, v in run.record.metadata.items() if isinstance(v, int | float | str | bool)}
    head = {
        **kept,
        "source": run.record.name,
        "made_by": "swimid track imu",
        "method": run.options.method,
        "attitude_from": run.source.kind,
        "path_trusted_until_s": None if run.trust is None else run.trust.until_s,
        "clock_offset_s": None if run.fused is None else run.fused.offset.value_s,
        "stroke_hz": None if run.stroke is None else run.stroke.beat.frequency_hz,
    }
    metadata = {k: v for k, v in head.items() if v is not None}
    verdict = _verdict(run, checked)
    evidence = Evidence(
        verb="track imu",
        title=f"Motion of {run.record.name}",
        verdict=verdict,
        checks=checked,
        tables=_tables(run, data),
        figures=figures(run),
        notices=blocks.notices(notices),
        methods=_methods(run),
        references=_references(run),
        provenance=provenance,
    )
    return Logged(
        "track imu",
        f"{_summary(run, data, checked)}\n{verdict.level.upper()}: {verdict.text}",
        data,
        evidence=evidence,
        document=Log(Path(run.record.name).with_suffix(".csv"), metadata, log.numeric(columns), None),
        table=columns,
    )


def _facts(run: Run) -> dict[str, Any]:
    """The run for machines."""
    t = run.record.time_s
    out: dict[str, Any] = {
        "method": run.options.method,
        "samples": len(t),
        "duration_s": float(t[-1] - t[0]),
        "sample_time_s": run.record.step_s,
        "attitude_from": run.source.kind,
        "still_periods": [
            {
                "from_s": float(t[r.first]),
                "to_s": float(t[r.last - 1]),
                "at": r.at,
                "used_as_rest": r in run.still.rests,
            }
            for r in run.still.stretches
        ],
        "noise": {
            "acceleration_m_s2_per_rt_hz": run.still.noise.acceleration,
            "rate_rad_s_per_rt_hz": run.still.noise.rate,
            "source": run.still.noise.source,
        },
        "faults": [vars(finding) for finding in run.findings],
        "mounting": _mounting(run),
        "stroke": _stroke(run),
    }
    if run.paper is not None:
        out["motion_mode"] = run.options.motion_mode
        out["constant_part"] = {
            "acceleration_m_s2": run.paper.removed_acceleration.tolist(),
            "rate_rad_s": run.paper.removed_rate.tolist(),
        }
        return out
    assert run.motion is not None
    bias, rest_score = run.bias, run.rest_score
    if bias is not None:
        out["bias"] = {"acceleration_m_s2": bias[:3].tolist(), "rate_rad_s": bias[3:].tolist()}
    out["empty_share"] = float(np.mean(np.isnan(run.motion.velocity[:, 0])))
    out["impossible"] = list(run.impossible)
    out["surge_oscillation"] = {
        "rms_m_s": _rms(run.surge_osc),
        "sd_m_s": _rms(run.surge_osc_sd),
        "above_hz": run.cutoff_hz,
    }
    out["largest_band_95"] = {
        "position_m": _largest(BAND * run.motion.position_sd),
        "velocity_m_s": _largest(BAND * run.motion.velocity_sd),
        "yaw_rad": _largest(BAND * run.motion.angle_sd[:, 2]),
    }
    if run.trust is not None:
        out["path_trusted"] = {"until_s": run.trust.until_s, "seconds": run.trust.seconds}
    if rest_score is not None:
        out["rest_innovation_rms"] = rest_score
    if run.fused is not None:
        out["fusion"] = _fusion(run.fused)
    return out


def _rms(values: Array | None) -> float | None:
    """Root-mean-square value, None where there is none."""
    return None if values is None else _largest(np.sqrt(np.mean(np.square(values))))


def _largest(values: Any) -> float | None:
    """None where there is none."""
    there = np.asarray(values)[np.isfinite(values)]
    return float(there.max()) if there.size else None


def _mounting(run: Run) -> dict[str, Any]:
    roll, pitch = run.tilt
    out: dict[str, Any] = {"by": run.mount.by, "roll_at_rest_rad": roll, "pitch_at_rest_rad": pitch}
    if run.fused is not None:
        path = run.fused.smoothed.path
        out["body_to_sensor_rotation_vector_rad"] = run.body_to_sensor.as_rotvec().tolist()
        out["lever_m"] = (-run.body_to_sensor.inv().apply(path.lever)).tolist()
        variance = np.diag(run.fused.smoothed.errors.covariance[-1])
        out["lever_sd_m"] = np.sqrt(variance[PARTS["lever"]]).tolist()
        out["world_tilt_rad"] = path.tilt.tolist()
    return out


def _stroke(run: Run) -> dict[str, Any] | None:
    if run.stroke is None:
        return None
    beat = run.stroke.beat
    return {
        "channel": run.stroke.channel,
        "frequency_hz": beat.frequency_hz,
        "stderr_hz": beat.stderr_hz,
        "harmonics": [
            {"frequency_hz": h.order * beat.frequency_hz, "amplitude": h.amplitude, "stderr": h.stderr}
            for h in run.stroke.harmonics
        ],
        "stated_hz": run.stated_hz,
        "contradicts": run.contradicted,
    }


def _fusion(fused: Fused) -> dict[str, Any]:
    before, fixes = fused.clocks, fused.fixes
    scores = fused.smoothed.errors.scores
    return {
        "clock_offset_s": fused.offset.value_s,
        "clock_offset_95_s": [fused.offset.low_s, fused.offset.high_s],
        "before_fusing": {
            "by": before.by,
            "clock_offset_s": before.offset.value_s,
            "clock_offset_95_s": [before.offset.low_s, before.offset.high_s],
            "explained": before.offset.explained,
        },
        "fix_sd_m": fixes.noise[:3].tolist(),
        "fix_sd_rad": float(fixes.noise[3]) if fixes.turns.any() else None,
        "innovation_rms": {kind: fused.smoothed.score(kind) for kind in scores},
        "fixes_used": len(scores.get("position", ())),
        "fixes_stray": fused.stray,
        "clocks_agree": fused.agree,
        "widened_by_lasting_errors": fused.lasting,
        "held_out": None if fused.held_out is None else vars(fused.held_out),
    }


# ---------------------------------------------------------------- for readers


def _summary(run: Run, data: dict[str, Any], checked: Sequence[Check]) -> str:
    """The run for the terminal: what can be trusted first."""
    lines = [
        f"{run.record.name}: {data['samples']} samples over {data['duration_s']:.1f} s, method "
        f"{run.options.method}, attitude from {run.source.kind}",
        f"  {_reach(run)}",
    ]
    surge = data.get("surge_oscillation", {})
    if surge.get("rms_m_s") is not None and surge["sd_m_s"] is not None:
        lines.append(
            f"  surge within a stroke (above {run.cutoff_hz:.2f} Hz): {surge['rms_m_s']:.4f} m/s rms, "
            f"95 % band ± {BAND * surge['sd_m_s']:.4f} m/s (rms)"
        )
    for check in checked:
        limit = f"  ({check.limit})" if check.limit else ""
        lines.append(f"  {check.verdict:4}  {check.name}: {check.value}{limit}")
    return "\n".join(lines)


def _reach(run: Run) -> str:
    if run.paper is not None:
        mode = run.options.motion_mode
        return f"the paper's way, {mode} mode: it states no uncertainty; its velocity ends as it began"
    assert run.motion is not None
    if not np.isfinite(run.motion.position).any():
        return "no motion that can be: positions and velocities are empty, the attitude is the filter's"
    if run.fused is not None:
        half = BAND * np.max(run.motion.position_sd[:, :2], axis=1)
        usual, worst = np.median(half), np.max(half)
        return f"position to ± {usual:.4f} m (median of the 95 % band), ± {worst:.3f} m at worst"
    assert run.trust is not None
    if run.trust.seconds is None:
        widest = run.trust.widest_m
        return f"path: the 95 % band stays within 0.1 m or a tenth of the way (widest ± {widest:.3f} m)"
    return (
        f"path: NOT to be trusted after {run.trust.seconds:.1f} s of motion (t = {run.trust.until_s:.1f} s); "
        f"95 % band at worst ± {run.trust.widest_m:.1f} m"
    )


def _verdict(run: Run, checked: Sequence[Check]) -> Verdict:
    doubts = dict.fromkeys(c.name.lower() for c in checked if c.verdict in ("warn", "fail"))
    text = _reach(run)[0].upper() + _reach(run)[1:]
    text += f". Look at: {', '.join(doubts)}." if doubts else "."
    if any(c.verdict == "fail" for c in checked):
        return Verdict(level="bad", text=text)
    return Verdict(level="caution" if doubts or run.paper is not None else "good", text=text)


def _tables(run: Run, data: dict[str, Any]) -> list[Table]:
    columns = ["from (s)", "to (s)", "where", "taken as rest"]
    used = {True: "yes", False: "no"}
    rests = [
        dict(zip(columns, (*list(p.values())[:3], used[p["used_as_rest"]]), strict=True))
        for p in data["still_periods"]
    ]
    tables = [blocks.table("still", "Still periods", rests, columns=columns)]
    bias = run.bias
    if bias is not None:
        accelerometer, gyroscope = bias[:3] / MILLI_G, bias[3:] / DEG
        biases: list[dict[str, blocks.Cell]] = [
            {"axis": axis, "accelerometer (mg)": float(a), "gyroscope (deg/s)": float(w)}
            for axis, a, w in zip("xyz", accelerometer, gyroscope, strict=True)
        ]
        caption = "Sensor axes. At rest in one attitude a horizontal bias and a tilt cannot be told apart."
        tables.append(blocks.table("biases", "Biases at the end", biases, caption))
    return tables


def _methods(run: Run) -> list[str]:
    if run.paper is not None:
        return [
            "Velocity and position were computed from accelerations as by Shang et al. (2012): means removed "
            f"for {run.options.motion_mode} mode, readings below {run.options.threshold_m_s2:g} m/s² and "
            f"{run.options.threshold_rad_s:g} rad/s set to zero, rotation to earth axes (Eqs 10 and 11), "
            "trapezoidal integration (Eqs 12 and 13)."
        ]
    used, more = "an inertial unit", ""
    if run.fused is not None:
        used, more = f"{used} and a second log of the trial", ", mounting, lever arm and clock offset"
    text = [
        f"Motion was estimated from {used} by an error-state Kalman filter and Rauch-Tung-Striebel smoother "
        f"over position, velocity, attitude and sensor biases{more}; attitude from {run.source.kind}."
    ]
    declared = dict.fromkeys(run.options.zero_mean)
    if declared:
        text.append(f"Declared: mean {' and '.join(declared)} of zero over {run.options.window_s:g} s.")
    return text


def _references(run: Run) -> list[str]:
    filtered = [] if run.record.quaternion is not None else [VQF]
    return [SHANG, *filtered] if run.paper is not None else [RAUCH, GROVES, *filtered]
