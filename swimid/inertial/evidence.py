"""Log and evidence of ``swimid track imu``: facts, checks with their warnings, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.inertial.aiding import AXES, GATE
from swimid.inertial.errorstate import PARTS
from swimid.inertial.fusion import FEW, FORETOLD, LASTING, Fused
from swimid.inertial.record import GRAVITY_M_S2, Array
from swimid.inertial.rest import mean_accelerations
from swimid.inertial.run import ANGLES, Run
from swimid.inertial.sensor import BAND, DEG, MILLI_G
from swimid.logs import log
from swimid.logs.log import Log
from swimid.logs.logged import Logged
from swimid.logs.rotation import angles
from swimid.notices import Notice, warn
from swimid.results import blocks
from swimid.results.evidence import Check, Evidence, Figure, Panel, Span, Table, Trace, check, judged

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
#: Largest root-mean-square innovation at rests, in standard deviations. Two rests make at least six
#: innovations, whose chi-square exceeds four times its freedom in 1 of 2000 cases when all is as stated.
REST_LIMIT = 2.0
GRADES: dict[str, Literal["info", "warn", "fail"]] = {"noted": "info", "handled": "warn", "refuted": "fail"}


def result(run: Run, notices: Sequence[Notice], provenance: dict[str, Any]) -> Logged:
    """Return the log of a run with its evidence; warn of the checks that do not pass.

    Parameters
    ----------
    notices : sequence of Notice
        The warnings recorded so far; those of the checks are appended by their recorder.
    """
    columns, checks = run.columns(), [*_recording_checks(run), *_motion_checks(run)]
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
    filtered = [] if run.record.quaternion is not None else [VQF]
    evidence = Evidence(
        verb="track imu",
        title=f"Motion of {run.record.name}",
        verdict=judged(_answer(run), checks),
        facts=_facts(run),
        checks=checks,
        tables=_tables(run),
        figures=_figures(run),
        notices=blocks.notices(notices),
        methods=_methods(run),
        references=[SHANG, *filtered] if run.by_paper else [RAUCH, GROVES, *filtered],
        provenance=provenance,
    )
    document = Log(Path(run.record.name).with_suffix(".csv"), metadata, log.numeric(columns), None)
    return Logged("track imu", "", _data(run), evidence=evidence, document=document, table=columns)


# ---------------------------------------------------------------- numbers for machines


def _data(run: Run) -> dict[str, Any]:
    t, noise, motion = run.record.time_s, run.still.noise, run.motion
    roll, pitch = run.tilt
    out: dict[str, Any] = {
        "method": run.options.method,
        "samples": len(t),
        "duration_s": float(t[-1] - t[0]),
        "sample_time_s": run.record.step_s,
        "attitude_from": run.source.kind,
        "still_periods": [
            {"from_s": start, "to_s": end, "at": at, "used_as_rest": used}
            for start, end, at, used in _still_periods(run)
        ],
        "noise": {
            "acceleration_m_s2_per_rt_hz": noise.acceleration,
            "rate_rad_s_per_rt_hz": noise.rate,
            "source": noise.source,
        },
        "faults": [vars(finding) for finding in run.findings],
        "mounting": {"by": run.mount.by, "roll_at_rest_rad": roll, "pitch_at_rest_rad": pitch},
        "stroke": None if run.stroke is None else _stroke(run),
    }
    if run.bias is not None:
        out["bias"] = {"acceleration_m_s2": run.bias[:3].tolist(), "rate_rad_s": run.bias[3:].tolist()}
    if run.by_paper:
        return out | {"motion_mode": run.options.motion_mode}
    out["empty_share"] = float(np.mean(np.isnan(motion.velocity[:, 0])))
    out["impossible"] = list(run.impossible)
    out["surge_oscillation"] = {
        "rms_m_s": _rms(run.surge_osc),
        "sd_m_s": _rms(run.surge_osc_sd),
        "above_hz": run.cutoff_hz,
    }
    out["largest_band_95"] = {
        "position_m": _largest(BAND * motion.position_sd),
        "velocity_m_s": _largest(BAND * motion.velocity_sd),
        "yaw_rad": _largest(BAND * motion.angle_sd[:, 2]),
    }
    if run.trust is not None:
        out["path_trusted"] = {"until_s": run.trust.until_s, "seconds": run.trust.seconds}
    if run.rest_score is not None:
        out["rest_innovation_rms"] = run.rest_score
    if run.fused is not None:
        path, covariance = run.fused.smoothed.path, run.fused.smoothed.errors.covariance[-1]
        out["mounting"] |= {
            "body_to_sensor_rotation_vector_rad": run.body_to_sensor.as_rotvec().tolist(),
            "lever_m": (-run.body_to_sensor.inv().apply(path.lever)).tolist(),
            "lever_sd_m": np.sqrt(np.diag(covariance)[PARTS["lever"]]).tolist(),
            "world_tilt_rad": path.tilt.tolist(),
        }
        out["fusion"] = _fusion(run.fused)
    return out


def _still_periods(run: Run) -> Iterator[tuple[float, float, str, bool]]:
    """Start, end, place in the log, and whether it is taken as a rest, of each still period."""
    t = run.record.time_s
    for rest in run.still.stretches:
        yield float(t[rest.first]), float(t[rest.last - 1]), rest.at, rest in run.still.rests


def _rms(values: Array) -> float | None:
    return _largest(np.sqrt(np.mean(np.square(values))))


def _largest(values: Any) -> float | None:
    """Return the maximum; None where there is no finite value."""
    finite = np.asarray(values)[np.isfinite(values)]
    return float(finite.max()) if finite.size else None


def _stroke(run: Run) -> dict[str, Any]:
    assert run.stroke is not None
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
    before, fixes, scores = fused.clocks, fused.fixes, fused.smoothed.errors.scores
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


# ---------------------------------------------------------------- checks


def _test(
    run: Run,
    code: str,
    title: str,
    value: str,
    passed: bool,
    limit: str,
    reason: str,
    text: str = "",
    otherwise: Literal["warn", "fail"] = "warn",
) -> Check:
    """Return a check; warn with its code, where it has one, if it does not pass."""
    if code and not passed:
        warn(code, f"{run.record.name}: {reason}. {text}".rstrip(". "))
    return check(title, value, passed, limit, text, otherwise=otherwise, reason=reason)


def _recording_checks(run: Run) -> Iterator[Check]:
    count, size = len(run.still.stretches), _gravity(run)
    text = "Let the robot rest for some seconds before and after a run, or name a rest with --still"
    reason = "no still period found; the biases are known to data-sheet accuracy only"
    yield _test(run, "SWM082", "Still periods", str(count), count > 0, "at least one", reason, text)
    # the 95 % band of the bias and scale of the sensor's class
    share = BAND * float(np.hypot(run.sensor.acceleration_bias_sd / GRAVITY_M_S2, run.sensor.scale_sd))
    limit, near = f"{GRAVITY_M_S2:.3f} ± {100 * share:.1f} %", abs(size / GRAVITY_M_S2 - 1) <= share
    reason = f"gravity is {size:.3f} m/s² in the accelerometer"
    yield _test(run, "", "Gravity", f"{size:.3f} m/s²", near, limit, reason)
    for f in run.findings:
        reason = f"the recording has a fault ({f.fault})"
        if f.verdict == "handled":
            warn("SWM080", f"{run.record.name}, {f.fault}: {f.text}")
        elif f.verdict == "refuted":
            warn("SWM090", f"{run.record.name}: {f.text}")
        grade = GRADES[f.verdict]
        yield Check(name=f.fault.capitalize(), value=f.verdict, verdict=grade, text=f.text, reason=reason)


def _motion_checks(run: Run) -> Iterator[Check]:
    if run.impossible:
        reason, limit = "; ".join(run.impossible), "possible; else positions and velocities are left empty"
        text = "Name the true rests with --still, or fuse a camera log (--with)"
        yield _test(run, "SWM086", "Possible motion", "no", False, limit, reason, text, "fail")
    if run.by_paper:
        yield _test(
            run, "", "Uncertainty", "none", False, "a stated band", "this method states no uncertainty"
        )
    if run.trust is not None:
        used, until = run.trust.seconds, run.trust.until_s
        value, reason = "all of it", ""
        if used is not None:
            value = f"{used:.1f} s of motion"
            reason = (
                f"the integrated position is not to be trusted after {used:.1f} s of motion "
                f"(at t = {until:.1f} s its 95 % band exceeds 0.1 m and a tenth of the way)"
            )
        limit = "95 % band within 0.1 m or a tenth of the way"
        yield _test(run, "SWM081", "Path trusted for", value, used is None, limit, reason)
    fastest = _largest(np.linalg.norm(run.motion.velocity, axis=1))
    if run.fused is None and not run.by_paper and fastest is not None:
        top, complete = run.options.top_speed_m_s, bool(np.isfinite(run.motion.velocity).all())
        reason, limit = (
            f"the motion reaches more than {top:g} m/s",
            f"never above {top:g} m/s (--top-speed-m-s)",
        )
        yield _test(run, "", "Top speed", f"{fastest:.2f} m/s", complete and fastest <= top, limit, reason)
    if run.rest_score is not None:
        value, passed = f"{run.rest_score:.2f} sd (rms)", run.rest_score <= REST_LIMIT
        reason = f"the motion between rests does not close within its band ({value})"
        text = "One of them is no rest of the body, or the sensor is worse than stated"
        yield _test(
            run, "SWM084", "Innovations at rests", value, passed, f"below {REST_LIMIT:g}", reason, text
        )
    if run.fused is not None:
        yield from _fusion_checks(run, run.fused)
    if run.stroke is not None and run.stated_hz is not None:
        (low, high), hz = run.stroke.beat.interval_hz, run.stroke.beat.frequency_hz
        reason = (
            f"the metadata says frequency_hz {run.stated_hz:g}, {run.stroke.channel} beats at {hz:.4g} Hz "
            f"(95 %: {low:.4g} ... {high:.4g})"
        )
        limit = f"metadata: {run.stated_hz:g} Hz"
        yield _test(run, "SWM032", "Stroke", f"{hz:.4g} Hz", not run.contradicted, limit, reason)
    elif run.doubt:
        yield _test(run, "SWM033", "Stroke", "in doubt", False, "one frequency", run.doubt)


def _gravity(run: Run) -> float:
    """Return the mean size of the specific force at rest, or of the whole log, m/s^2."""
    return float(np.mean(np.linalg.norm(mean_accelerations(run.record, run.still.stretches), axis=1)))


def _fusion_checks(run: Run, fused: Fused) -> Iterator[Check]:
    offset, count, stray = fused.offset, len(fused.fixes.time_s), fused.stray
    value, limit = f"{1e3 * offset.value_s:.2f} ms", "0 within the 95 % interval"
    reason = (
        f"the clocks differ: {1e3 * offset.value_s:.1f} ms to add to the other log (95 %: "
        f"{1e3 * offset.low_s:.1f} ... {1e3 * offset.high_s:.1f} ms); the output is on the inertial clock"
    )
    agreed = not offset.excludes_zero or run.options.clock_offset_s is not None
    yield _test(run, "SWM083", "Clock offset", value, agreed, limit, reason)
    for kind, named in (("position", "positions"), ("orientation", "angles")):
        size = fused.smoothed.score(kind)
        if size is not None:
            value, reason = f"{size:.2f} sd (rms)", f"the {named} of the other log disagree with the sensor"
            yield _test(
                run, "", f"Innovations of {named}", value, size <= FORETOLD, f"below {FORETOLD:g}", reason
            )
    reason = (
        f"{stray} of {count} fixes of the other log lie beyond {GATE:g} standard deviations of the motion"
    )
    few, limit = stray <= FEW * count, f"at most {100 * FEW:.0f} %"
    yield _test(run, "SWM087", "Stray fixes", f"{stray} of {count}", few, limit, reason)
    reason = (
        "many fixes of the other log on end are off by the same (as fused they scatter by "
        f"{np.max(fused.fixes.noise[:2]):.3g} m): the logs contradict each other, or its scale or marker is "
        f"wrong; every band is widened by {fused.lasting:.1f}"
    )
    value, passed = f"band widened by {fused.lasting:.2f}", fused.lasting <= LASTING
    text = "1 where the errors of the fixes are independent. A wrong scale or marker makes errors that last."
    yield _test(
        run, "SWM087", "Lasting errors of fixes", value, passed, f"below {LASTING:g}", reason, text, "fail"
    )
    held, title, limit = fused.held_out, "Fixes left out", f"below {FORETOLD:g}"
    if held is None:
        reason = "too few fixes to leave some out and predict them"
        yield _test(run, "", title, "none", False, limit, reason)
        return
    reason = f"fixes that were left out are predicted to {held.deviations:.2f} standard deviations (rms) only"
    value, passed = f"{held.deviations:.2f} sd (rms) of {held.fixes}", held.deviations <= FORETOLD
    yield _test(run, "", title, value, passed, limit, reason, otherwise="fail")


# ---------------------------------------------------------------- for readers


def _answer(run: Run) -> str:
    if run.by_paper:
        return (
            f"Velocity and position follow the steps of Shang et al. (2012), {run.options.motion_mode} mode."
        )
    if not np.isfinite(run.motion.position).any():
        return "Only the attitude is given: positions and velocities are empty."
    half = BAND * np.max(run.motion.position_sd[:, :2], axis=1)
    if run.trust is None:
        return f"The position is known to ± {np.median(half):.4f} m (median of the 95 % band)."
    if run.trust.seconds is None:
        return f"The whole path can be used; its 95 % band reaches ± {run.trust.widest_m:.3f} m."
    return f"The path can be used for the first {run.trust.seconds:.1f} s of motion, u_osc_m_s throughout."


def _facts(run: Run) -> dict[str, str]:
    seconds = sum(end - start for start, end, _, _ in _still_periods(run))
    used = sum(end - start for start, end, _, rest in _still_periods(run) if rest)
    noise, (roll, pitch) = run.still.noise, run.tilt
    level = f"{noise.acceleration / MILLI_G:.2f} mg/√Hz, {60 * noise.rate / DEG:.2f} deg/√h"
    return {
        "Method": run.options.method,
        "Attitude": run.source.kind,
        "Still": f"{seconds:.1f} s, {used:.1f} s of them taken as rest",
        "Noise": f"{level} ({noise.source})",
        "Mounting": f"{run.mount.by}; roll {roll / DEG:.2f} deg, pitch {pitch / DEG:.2f} deg at rest",
    }


def _tables(run: Run) -> list[Table]:
    motion = run.motion
    half = BAND * np.max(motion.position_sd[:, :2], axis=1)
    rows: list[list[str | float | None]] = []
    if run.fused is not None:
        offset = run.fused.offset
        rows.append(["clock offset (ms)", 1e3 * offset.value_s, 1e3 * BAND * offset.stderr_s])
    if not run.by_paper:
        surge_sd = _rms(run.surge_osc_sd)
        rows.append(["surge within a stroke, rms (m/s)", _rms(run.surge_osc), surge_sd and BAND * surge_sd])
        rows.append(["position in the plane, median (m)", None, _largest(np.median(half))])
        rows.append(["position in the plane, maximum (m)", None, _largest(half)])
        yaw, yaw_sd = angles(motion.rotation)[2][-1], motion.angle_sd[-1, 2]
        rows.append(["heading at the end (deg)", float(yaw / DEG), float(BAND * yaw_sd / DEG)])
    if run.stroke is not None:
        beat = run.stroke.beat
        rows.append([f"stroke in {run.stroke.channel} (Hz)", beat.frequency_hz, BAND * beat.stderr_hz])
    columns = ["quantity", "value", "95 % band ±"]
    tables = [Table(id="motion", title="Motion", columns=columns, rows=rows)]
    columns = ["from (s)", "to (s)", "where", "taken as rest"]
    rests = [list(one) for one in _still_periods(run)]
    tables.append(Table(id="still", title="Still periods", columns=columns, rows=rests, folded=True))
    if run.bias is not None:
        by_axis = zip("xyz", (run.bias[:3] / MILLI_G).tolist(), (run.bias[3:] / DEG).tolist(), strict=True)
        columns = ["axis", "accelerometer (mg)", "gyroscope (deg/s)"]
        caption = "Axes of the sensor. At rest in one attitude a horizontal bias equals a tilt."
        biases = [list(one) for one in by_axis]
        tables.append(
            Table(id="biases", title="Biases", columns=columns, rows=biases, caption=caption, folded=True)
        )
    return tables


def _methods(run: Run) -> list[str]:
    o = run.options
    if run.by_paper:
        return [
            "Velocity and position were computed from accelerations as by Shang et al. (2012): means removed "
            f"for {o.motion_mode} mode, readings below {o.threshold_m_s2:g} m/s² and {o.threshold_rad_s:g} "
            "rad/s set to zero, rotation to earth axes (Eqs 10 and 11), trapezoids (Eqs 12 and 13)."
        ]
    used, more = "an inertial unit", ""
    if run.fused is not None:
        used, more = f"{used} and a second log of the trial", ", mounting, lever arm and clock offset"
    text = [
        f"Motion was estimated from {used} by an error-state Kalman filter and Rauch-Tung-Striebel smoother "
        f"over position, velocity, attitude and sensor biases{more}; attitude from {run.source.kind}."
    ]
    declared = dict.fromkeys(o.zero_mean)
    if declared:
        text.append(f"Declared: mean {' and '.join(declared)} of zero over {o.window_s:g} s.")
    return text


# ---------------------------------------------------------------- figures


def _figures(run: Run) -> list[Figure]:
    motion = run.motion
    velocity = _panels(run, AXES, "m/s", motion.body_velocity, motion.body_velocity_sd)
    if not run.by_paper:
        surge, surge_sd = run.surge_osc[:, None], run.surge_osc_sd[:, None]
        velocity = [*_panels(run, ["surge within a stroke"], "m/s", surge, surge_sd), *velocity]
    turn = np.column_stack(angles(motion.rotation)) / DEG
    parts = {
        "Body velocity": velocity,
        "Position": _panels(run, "xyz", "m", motion.position, motion.position_sd, fixes=True),
        "Attitude": _panels(run, ANGLES, "deg", turn, motion.angle_sd / DEG),
    }
    caption = "The estimate with its 95 % band, rests shaded; points are those of the other log."
    return [
        Figure(id=title.split()[-1].lower(), title=title, caption=caption, panels=panels)
        for title, panels in parts.items()
    ]


def _panels(
    run: Run, names: Sequence[str], unit: str, values: Array, sds: Array, *, fixes: bool = False
) -> list[Panel]:
    """Return a panel of each column over time with its band; ``fixes`` adds positions of the other log."""
    t = run.record.time_s
    spans = [Span(start=float(t[r.first]), end=float(t[r.last - 1]), label="rest") for r in run.still.rests]
    every = slice(None, None, max(len(t) // 2000, 1))
    panels = []
    for k, name in enumerate(names):
        x, y = t[every], values[every, k]
        traces = [blocks.band(x, y, BAND * sds[every, k], label="estimate", group=0)]
        if fixes and run.poses is not None and run.fused is not None:
            seen = np.flatnonzero(np.isfinite(run.poses.position[:, k]))
            seen = seen[:: max(len(seen) // 800, 1)]
            x, y = run.poses.time_s[seen] + run.fused.offset.value_s, run.poses.position[seen, k]
            traces.append(Trace(x=x, y=y, label="other log", style="points", group=1))
        panels.append(Panel(x_label="time (s)", y_label=f"{name} ({unit})", traces=traces, spans=spans))
    return panels
