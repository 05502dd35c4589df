"""``swimid track imu``: an inertial recording gives a log of motion and its evidence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.inertial import faults, motion
from swimid.inertial.aiding import AXES, GATE
from swimid.inertial.fusion import FEW, FORETOLD, LASTING, Fused
from swimid.inertial.motion import ANGLES, Run
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import GRAVITY_M_S2, Array, read_poses, read_record
from swimid.inertial.setup import BAND, DEG, MILLI_G, mean_accelerations, prepare
from swimid.inertial.smoother import PARTS
from swimid.logs import log, mapping
from swimid.logs.log import Log, LogLike
from swimid.logs.logged import Logged
from swimid.logs.rotation import angles
from swimid.notices import Notice, recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks
from swimid.results.evidence import Check, Evidence, Figure, Panel, Span, Table, Trace, check, judged


@takes(TrackImuOptions)
def track_imu(
    imu: LogLike, *, options: TrackImuOptions, output: str | Path | None = None, progress: Progress = silent
) -> Logged:
    """Make motion of an inertial recording: velocity, position and attitude with their bands.

    The other log may be a table too: positions (m), angles (rad), or both; and the mapping a dict of names
    and units of foreign columns.

    Parameters
    ----------
    imu : path, Log or DataFrame
        The recording, shape (n, k), n at least 64: ``t_s``, specific force ``ax_m_s2`` to ``az_m_s2``, turn
        rate ``wx_rad_s`` to ``wz_rad_s``, in the sensor's axes; ``qw`` to ``qz`` and ``mx`` to ``mz`` where
        it has them. Anything else with a mapping.
    output : path, optional
        The log, CSV or Parquet by its ending; ``<stem>.evidence.json`` goes beside it. Without it nothing is
        written; :meth:`~swimid.results.result.Result.save` writes the same later.
    progress : Progress
        Shows reading and smoothing.

    Returns
    -------
    Logged
        ``.frame`` has n rows: position (m), attitude (rad), velocity in the body and in the world (m/s),
        turn rates (rad/s), accelerations (m/s^2), each with its standard deviation.

    Raises
    ------
    InputError
        An input cannot be used, or a fault of recording cannot be repaired.
    NoTrustworthyResult
        The two logs do not move together.
    UsageError
        Settings that do not fit together.

    Notes
    -----
    An error-state Kalman filter and Rauch-Tung-Striebel smoother (Rauch, Tung and Striebel, 1965,
    doi:10.2514/3.3166; Groves, 2013, ch. 14); ``method="paper"`` follows Shang et al. (2012),
    doi:10.1017/S0263574711001159.

    Examples
    --------
    A sensor on a table, which knows that it does not move:

    >>> import numpy as np, pandas as pd
    >>> t, rng = np.arange(0.0, 8.0, 0.02), np.random.default_rng(1)
    >>> table = pd.DataFrame({"t_s": t})
    >>> for axis, gravity in zip("xyz", (0.0, 0.0, 9.80665)):
    ...     table[f"a{axis}_m_s2"] = gravity + 0.02 * rng.normal(size=len(t))
    ...     table[f"w{axis}_rad_s"] = 0.002 * rng.normal(size=len(t))
    >>> made = track_imu(table)
    >>> bool(made.frame[["vx_m_s", "vy_m_s", "vz_m_s"]].abs().to_numpy().max() < 0.01)
    True
    """
    map_path, other = options.map_path, options.other
    recording = log.unread(imu, name="imu")
    rules = None if map_path is None else mapping.of(map_path)
    given: list[provenance.Input] = [recording]
    if rules is not None:
        given.append(map_path if isinstance(map_path, str | Path) else rules)
    if other is not None:
        given.append(log.unread(other, name="other"))
    if output is not None:
        output = atomic.check_writable(output, inputs=given)
    if options.method == "paper" and other is not None:
        hint = "leave out --with, or take --method smoother"
        raise UsageError("--method paper fuses with nothing", hint=hint)
    with recorded(repeat=True) as notices:
        named = given[0 if rules is None else 1]
        record, notes = read_record(recording, rules, provenance.path_of(named), progress)
        record, findings = faults.mend(record)
        poses = None if other is None else read_poses(log.of(other, name="other"))
        setup, of_mounting = prepare(record, options)
        with progress("smoothing", total=None) as step:
            made = motion.estimate(replace(setup, advance=step), [*findings, *of_mounting], poses)
        for note in notes:
            warn("SWM004", f"{record.name}: {note}")
        origin = provenance.collect(given, settings=options.settings())
        result = _result(made, notices, origin)
    return result.saved(output)


# ---------------------------------------------------------------- log and evidence


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
#: Verdict of a check by that of a finding.
GRADES: dict[str, Literal["info", "warn", "fail"]] = {"noted": "info", "handled": "warn", "refuted": "fail"}
#: Checks that fail, where others warn.
FAIL = ("Possible motion", "Lasting errors of fixes", "Fixes left out")

#: Code of its warning, name, value and limit of a check, whether it passes, and the reason where it does not.
Test = tuple[str, str, str, str, bool, str]


def _result(run: Run, notices: Sequence[Notice], provenance: dict[str, Any]) -> Logged:
    """Return the log of a run with its evidence; warn of the checks that do not pass.

    Parameters
    ----------
    notices : sequence of Notice
        The warnings recorded so far; those of the checks are appended by their recorder.
    """
    columns, checks = run.columns(), _checks(run)
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
    data = _data(run) | {"checks": [check.model_dump() for check in checks]}
    return Logged("track imu", "", data, evidence=evidence, document=document, table=columns)


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
    out["impossible"] = list(run.impossible)
    out["rest_innovation_rms"] = run.rest_score
    surge = {"rms_m_s": _rms(run.surge_osc), "sd_m_s": _rms(run.surge_osc_sd), "above_hz": run.cutoff_hz}
    out["surge_oscillation"] = surge
    bands = {
        "position_m": motion.position_sd,
        "velocity_m_s": motion.velocity_sd,
        "yaw_rad": motion.angle_sd[:, 2],
    }
    out["largest_band_95"] = {name: _largest(BAND * sd) for name, sd in bands.items()}
    if run.trust is not None:
        out["path_trusted"] = {"until_s": run.trust.until_s, "seconds": run.trust.seconds}
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
    fixes, scores = fused.fixes, fused.smoothed.errors.scores
    return {
        "clock_offset_s": fused.offset.value_s,
        "clock_offset_95_s": [fused.offset.low_s, fused.offset.high_s],
        "clocks_by": fused.clocks.by,
        "clocks_explained": fused.clocks.offset.explained,
        "clocks_agree": fused.agree,
        "fix_sd_m": fixes.noise[:3].tolist(),
        "fix_sd_rad": float(fixes.noise[3]) if fixes.turns.any() else None,
        "innovation_rms": {kind: fused.smoothed.score(kind) for kind in scores},
        "fixes_used": len(scores.get("position", ())),
        "fixes_stray": fused.stray,
        "widened_by_lasting_errors": fused.lasting,
        "held_out": None if fused.held_out is None else vars(fused.held_out),
    }


# ---------------------------------------------------------------- checks


def _checks(run: Run) -> list[Check]:
    """Return the checks of a run; warn of each that has a code and does not pass."""
    checks, name = [], run.record.name
    for f in run.findings:
        if f.verdict != "noted":
            warn({"handled": "SWM080", "refuted": "SWM090"}[f.verdict], f"{name}, {f.fault}: {f.text}")
        reason = f"the recording has a fault ({f.fault})"
        grade = GRADES[f.verdict]
        checks.append(Check(name=f.fault.capitalize(), value="", verdict=grade, text=f.text, reason=reason))
    for code, title, value, limit, passed, reason in [*_motion_tests(run), *_fusion_tests(run)]:
        if code and not passed:
            warn(code, f"{name}: {reason}")
        otherwise: Literal["warn", "fail"] = "fail" if title in FAIL else "warn"
        checks.append(check(title, value, passed, limit, otherwise=otherwise, reason=reason))
    return checks


def _motion_tests(run: Run) -> Iterator[Test]:
    count = len(run.still.stretches)
    reason = "no still period found; the biases are known to data-sheet accuracy only"
    yield "SWM082", "Still periods", str(count), "at least one", count > 0, reason
    size = float(np.mean(np.linalg.norm(mean_accelerations(run.record, run.still.stretches), axis=1)))
    # the 95 % band of the bias and scale of the sensor's class
    share = BAND * float(np.hypot(run.sensor.acceleration_bias_sd / GRAVITY_M_S2, run.sensor.scale_sd))
    value, limit = f"{size:.3f} m/s²", f"{GRAVITY_M_S2:.3f} ± {100 * share:.1f} %"
    yield "", "Gravity", value, limit, abs(size / GRAVITY_M_S2 - 1) <= share, f"gravity is {value}"
    if run.by_paper:
        yield "", "Uncertainty", "none", "a stated band", False, "this method states no uncertainty"
    if run.impossible:
        yield "SWM086", "Possible motion", "no", "else left empty", False, "; ".join(run.impossible)
    if run.trust is not None:
        used, limit = run.trust.seconds, "95 % band within 0.1 m or a tenth of the way"
        value = "all of it" if used is None else f"{used:.1f} s of motion"
        reason = f"the integrated position is not to be trusted after {value}"
        yield "SWM081", "Path trusted for", value, limit, used is None, reason
    fastest, top = _largest(np.linalg.norm(run.motion.velocity, axis=1)), run.options.top_speed_m_s
    if run.fused is None and not run.by_paper and fastest is not None:
        passed = bool(np.isfinite(run.motion.velocity).all()) and fastest <= top
        limit, reason = f"{top:g} m/s (--top-speed-m-s)", f"the motion reaches more than {top:g} m/s"
        yield "", "Top speed", f"{fastest:.2f} m/s", limit, passed, reason
    if run.rest_score is not None:
        value, passed = f"{run.rest_score:.2f} sd (rms)", run.rest_score <= REST_LIMIT
        reason = f"the motion between rests does not close within its band ({value})"
        yield "SWM084", "Innovations at rests", value, f"below {REST_LIMIT:g}", passed, reason
    if run.stroke is not None and run.stated_hz is not None:
        (low, high), hz = run.stroke.beat.interval_hz, run.stroke.beat.frequency_hz
        reason = (
            f"the metadata says frequency_hz {run.stated_hz:g}, {run.stroke.channel} beats at {hz:.4g} Hz "
            f"(95 %: {low:.4g} ... {high:.4g})"
        )
        limit = f"metadata: {run.stated_hz:g} Hz"
        yield "SWM032", "Stroke", f"{hz:.4g} Hz", limit, not run.contradicted, reason
    elif run.doubt:
        yield "SWM033", "Stroke", "in doubt", "one frequency", False, run.doubt


def _fusion_tests(run: Run) -> Iterator[Test]:
    fused = run.fused
    if fused is None:
        return
    offset, count, stray, limit = fused.offset, len(fused.fixes.time_s), fused.stray, f"below {FORETOLD:g}"
    value = f"{1e3 * offset.value_s:.2f} ms"
    reason = (
        f"the clocks differ: {value} to add to the other log (95 %: {1e3 * offset.low_s:.1f} ... "
        f"{1e3 * offset.high_s:.1f} ms); the output is on the inertial clock"
    )
    agreed = not offset.excludes_zero or run.options.clock_offset_s is not None
    yield "SWM083", "Clock offset", value, "0 within the 95 % interval", agreed, reason
    for kind, named in (("position", "positions"), ("orientation", "angles")):
        size = fused.smoothed.score(kind)
        if size is not None:
            value, reason = f"{size:.2f} sd (rms)", f"the {named} of the other log disagree with the sensor"
            yield "", f"Innovations of {named}", value, limit, size <= FORETOLD, reason
    reason = f"{stray} of {count} fixes of the other log lie beyond {GATE:g} sd of the motion"
    yield "SWM087", "Stray fixes", f"{stray}", f"at most {100 * FEW:.0f} %", stray <= FEW * count, reason
    reason = (
        "many fixes of the other log on end are off by the same (as fused they scatter by "
        f"{np.max(fused.fixes.noise[:2]):.3g} m): the logs contradict each other, or its scale or marker is "
        f"wrong; every band is widened by {fused.lasting:.1f}"
    )
    value, passed = f"band widened by {fused.lasting:.2f}", fused.lasting <= LASTING
    yield "SWM087", "Lasting errors of fixes", value, f"below {LASTING:g}", passed, reason
    held = fused.held_out
    if held is None:
        yield "", "Fixes predicted", "none", limit, False, "too few fixes to leave some out and predict them"
        return
    value, passed = f"{held.deviations:.2f} sd (rms) of {held.fixes}", held.deviations <= FORETOLD
    reason = f"fixes that were left out are predicted to {held.deviations:.2f} sd (rms) only"
    yield "", "Fixes left out", value, limit, passed, reason


# ---------------------------------------------------------------- for readers


def _answer(run: Run) -> str:
    if run.by_paper:
        return f"Velocity and position follow Shang et al. (2012), {run.options.motion_mode} mode."
    if not np.isfinite(run.motion.position).any():
        return "Only the attitude is given: positions and velocities are empty."
    half = BAND * np.max(run.motion.position_sd[:, :2], axis=1)
    if run.trust is None:
        return f"The position is known to ± {np.median(half):.4f} m (median of the 95 % band)."
    if run.trust.seconds is None:
        return f"The whole path can be used; its 95 % band reaches ± {run.trust.widest_m:.3f} m."
    return "Surge within a stroke (u_osc_m_s) and attitude can be used throughout."


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
