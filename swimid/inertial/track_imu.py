"""The command ``swimid track imu``: from an inertial recording to a log of motion and its evidence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.inertial import faults, motion
from swimid.inertial.alone import GATE
from swimid.inertial.fusion import MAX_HELD_OUT, MAX_LASTING, MAX_STRAY, Fused
from swimid.inertial.motion import Run
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import GRAVITY_M_S2, Array, read_poses, read_record
from swimid.inertial.setup import BAND, DEG, mean_accelerations, prepare
from swimid.inertial.smoother import PARTS
from swimid.logs import log, mapping
from swimid.logs.kinematics import angles
from swimid.logs.log import Log, LogLike
from swimid.logs.tracks import Logged
from swimid.notices import Notice, Progress, recorded, silent, warn
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results.evidence import (
    Check,
    Evidence,
    Figure,
    Panel,
    Span,
    Table,
    Trace,
    check,
    judged,
    leaf_table,
)


@takes(TrackImuOptions)
def track_imu(
    imu: LogLike, *, options: TrackImuOptions, output: str | Path | None = None, progress: Progress = silent
) -> Logged:
    """Compute velocity, position and attitude from an inertial recording, with 95 % bands.

    The other log (``other``) can be a table with positions (m), angles (rad), or both. The mapping
    (``map_path``) can be a dict of names and units of foreign columns.

    Parameters
    ----------
    imu : path, Log or DataFrame
        Recording with at least 64 rows and the columns ``t_s``, ``ax_m_s2`` to ``az_m_s2`` (specific force)
        and ``wx_rad_s`` to ``wz_rad_s`` (turn rate), in the sensor's axes. Optional columns are ``qw`` to
        ``qz`` (quaternion) and ``mx`` to ``mz`` (magnetic field). Logs with other columns need a mapping.
    output : path, optional
        Log to write, CSV or Parquet by its ending. ``<stem>.evidence.json`` is written to the same folder.
        Without ``output`` nothing is written; :meth:`~swimid.results.result.Result.save` writes the files
        later.
    progress : Progress
        Shows the progress of reading and smoothing.

    Returns
    -------
    Logged
        ``.frame`` has one row for each sample: position (m), attitude (rad), velocity along body axes and
        along world axes (m/s), all with standard deviations, and turn rates (rad/s) and accelerations
        (m/s^2).

    Raises
    ------
    InputError
        When an input cannot be used, or a fault of the recording cannot be repaired.
    NoTrustworthyResult
        When the two logs do not move together.
    UsageError
        When the options contradict each other.

    Notes
    -----
    The method is an error-state Kalman filter and Rauch-Tung-Striebel smoother (Rauch, Tung and Striebel,
    1965, doi:10.2514/3.3166; Groves, 2013, ch. 14). ``method="paper"`` follows Shang et al. (2012),
    doi:10.1017/S0263574711001159.

    Examples
    --------
    A sensor at rest on a table:

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
        record, findings = faults.repair(record)
        poses = None if other is None else read_poses(log.of(other, name="other"))
        setup, more = prepare(record, options)
        with progress("smoothing", total=None) as step:
            made = motion.estimate(replace(setup, advance=step), [*findings, *more], poses)
        for note in notes:
            warn("SWM004", f"{record.name}: {note}")
        origin = provenance.collect(given, settings=options.settings())
        result = _result(made, notices, origin)
    return result.saved(output)


# ---------------------------------------------------------------- log and evidence


SHANG = "Shang, Wang, Tan, Cheng (2012). Robotica 30, 913-923. doi:10.1017/S0263574711001159"
RAUCH = "Rauch, Tung, Striebel (1965). AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166"
VQF = "Laidig, Seel (2023). Information Fusion 91, 187-204. doi:10.1016/j.inffus.2022.10.014"
#: Maximum root-mean-square innovation of the velocity at rests, in standard deviations. Two rests give at
#: least six innovations. Their chi-square exceeds four times its degrees of freedom in 1 of 2000 cases.
MAX_REST_SCORE = 2.0
#: Maximum number of samples of a trace in a figure.
N_DRAWN = 2000
#: Verdict of a check and code of its warning, for each verdict of a finding.
GRADES: dict[str, tuple[Literal["info", "warn", "fail"], str]] = {
    "noted": ("info", ""),
    "handled": ("warn", "SWM080"),
    "refuted": ("fail", "SWM090"),
}
#: Names of the checks that fail if they do not pass. The other checks warn.
FAIL = ("Possible motion", "Lasting errors of fixes", "Fixes left out")

#: Code of the warning, name, value and limit of a check, whether it passes, and the reason if it does not.
Test = tuple[str, str, str, str, bool, str]


def _result(run: Run, notices: Sequence[Notice], provenance: dict[str, Any]) -> Logged:
    """Return the log of a recording with its evidence; warn of the checks that do not pass.

    Parameters
    ----------
    notices : sequence of Notice
        Warnings recorded so far. The recorder adds those of the checks.
    """
    record, options = run.setup.record, run.setup.options
    columns, checks = run.columns(), _checks(run)
    head = {
        **{k: v for k, v in record.metadata.items() if isinstance(v, int | float | str | bool)},
        "source": record.name,
        "made_by": "swimid track imu",
        "method": options.method,
        "attitude_from": run.setup.source.kind,
        "path_trusted_until_s": run.trusted_until_s,
        "clock_offset_s": run.fused and run.fused.offset.value_s,
        "stroke_hz": run.stroke and run.stroke.beat.frequency_hz,
    }
    metadata = {k: v for k, v in head.items() if v is not None}
    references = [SHANG if run.by_paper else RAUCH]
    if record.quaternion is None:
        references.append(VQF)
    evidence = Evidence(
        command="track imu",
        title=f"Motion of {record.name}",
        verdict=judged(_answer(run), checks),
        facts={"Attitude": run.setup.source.kind, "Mounting": run.setup.mount.by},
        checks=checks,
        tables=_tables(run),
        figures=_figures(run),
        notices=ev.notices(notices),
        methods=_methods(run),
        references=references,
        provenance=provenance,
    )
    document = Log(Path(record.name).with_suffix(".csv"), metadata, log.numeric(columns), None)
    data = _data(run) | {"checks": [check.model_dump() for check in checks]}
    return Logged("track imu", "", data, evidence=evidence, document=document, table=columns)


def _still_periods(run: Run) -> list[dict[str, Any]]:
    """Return start, end and position of each still period, and whether it is used as a rest."""
    t, setup = run.setup.record.time_s.tolist(), run.setup
    return [
        {"from_s": t[r.first], "to_s": t[r.last - 1], "at": r.at, "used_as_rest": r in setup.rests}
        for r in setup.still
    ]


def _rms(values: Array) -> float | None:
    return _largest(np.sqrt(np.mean(np.square(values))))


def _largest(values: Any) -> float | None:
    """Return the maximum of the finite values; None if there are none."""
    finite = np.asarray(values)[np.isfinite(values)]
    return float(finite.max()) if finite.size else None


# ---------------------------------------------------------------- document


def _data(run: Run) -> dict[str, Any]:
    setup, stroke, fused = run.setup, run.stroke, run.fused
    roll, pitch = run.tilt
    out: dict[str, Any] = {
        "method": setup.options.method,
        "attitude_from": setup.source.kind,
        "still_periods": _still_periods(run),
        "noise": vars(setup.noise),
        "faults": [vars(finding) for finding in run.findings],
        "mounting": {"by": setup.mount.by, "roll_at_rest_rad": roll, "pitch_at_rest_rad": pitch},
        "stroke": stroke
        and {
            "channel": stroke.channel,
            "frequency_hz": stroke.beat.frequency_hz,
            "stderr_hz": stroke.beat.stderr_hz,
            "stated_hz": run.stated_hz,
            "contradicts": run.contradiction is not None,
        },
    }
    if run.bias is not None:
        out["bias"] = {"acceleration_m_s2": run.bias[:3].tolist(), "rate_rad_s": run.bias[3:].tolist()}
    if run.by_paper:
        return out | {"motion_mode": setup.options.motion_mode}
    out |= {
        "impossible": list(run.impossible),
        "rest_innovation_rms": run.rest_score,
        "surge_oscillation": {"rms_m_s": _rms(run.surge_osc), "above_hz": run.cutoff_hz},
        "largest_band_95": {"position_m": _largest(BAND * run.motion.position_sd)},
    }
    if run.alone:
        out["path_trusted"] = {"until_s": run.trusted_until_s}
    if fused is not None:
        path, covariance = fused.smoothed.path, fused.smoothed.errors.covariance[-1]
        out["mounting"] |= {
            "body_to_sensor_rotation_vector_rad": path.mount.as_rotvec().tolist(),
            "lever_m": (-path.mount.inv().apply(path.lever)).tolist(),
            "lever_sd_m": np.sqrt(np.diag(covariance)[PARTS["lever"]]).tolist(),
            "world_tilt_rad": path.tilt.tolist(),
        }
        out["fusion"] = {
            "clock_offset_s": fused.offset.value_s,
            "clock_offset_95_s": [fused.offset.low_s, fused.offset.high_s],
            "clocks_agree": fused.agree,
            "fix_sd_m": fused.fixes.noise[:3].tolist(),
            "fixes_used": len(fused.smoothed.errors.scores.get("position", ())),
            "fixes_stray": fused.stray,
            "widened_by_lasting_errors": fused.lasting,
            "held_out": fused.held_out and vars(fused.held_out),
        }
    return out


# ---------------------------------------------------------------- checks


def _checks(run: Run) -> list[Check]:
    """Return the checks of a recording; warn of each check that does not pass and has a code."""
    checks, name = [], run.setup.record.name
    for f in run.findings:
        grade, code = GRADES[f.verdict]
        if code:
            warn(code, f"{name}, {f.fault}: {f.text}")
        reason = f"the recording has a fault ({f.fault})"
        checks.append(Check(name=f.fault.capitalize(), value="", verdict=grade, text=f.text, reason=reason))
    tests = list(_motion_tests(run))
    if run.fused is not None:
        tests += _fusion_tests(run.fused, run.setup.options)
    for code, title, value, limit, passed, reason in tests:
        if code and not passed:
            warn(code, f"{name}: {reason}")
        otherwise: Literal["warn", "fail"] = "fail" if title in FAIL else "warn"
        checks.append(check(title, value, passed, limit, otherwise=otherwise, reason=reason))
    return checks


def _motion_tests(run: Run) -> Iterator[Test]:
    setup = run.setup
    count = len(setup.still)
    reason = "no still period found; the biases are known to data-sheet accuracy only"
    yield "SWM082", "Still periods", str(count), "at least one", count > 0, reason
    size = float(np.mean(np.linalg.norm(mean_accelerations(setup.record, setup.still), axis=1)))
    # half-width of the 95 % band, relative to g, from bias and scale of the sensor's class
    share = BAND * float(np.hypot(setup.sensor.acceleration_bias_sd / GRAVITY_M_S2, setup.sensor.scale_sd))
    value, limit = f"{size:.3f} m/s²", f"{GRAVITY_M_S2:.3f} ± {100 * share:.1f} %"
    yield "", "Gravity", value, limit, abs(size / GRAVITY_M_S2 - 1) <= share, f"gravity is {value}"
    if run.by_paper:
        yield "", "Uncertainty", "none", "a stated band", False, "this method states no uncertainty"
    if run.impossible:
        yield "SWM086", "Possible motion", "no", "else left empty", False, "; ".join(run.impossible)
    if run.alone:
        until, limit = run.trusted_until_s, "95 % band within 0.1 m or a tenth of the way"
        value = "its end" if until is None else f"t = {until:.1f} s"
        reason = f"the integrated position is not to be trusted after {value}"
        yield "SWM081", "Path trusted until", value, limit, until is None, reason
    if run.rest_score is not None:
        value, passed = f"{run.rest_score:.2f} sd (rms)", run.rest_score <= MAX_REST_SCORE
        reason = f"the motion between rests does not close within its band ({value})"
        yield "SWM084", "Innovations at rests", value, f"below {MAX_REST_SCORE:g}", passed, reason
    stroke = run.stroke
    if stroke is not None and run.stated_hz is not None:
        against, limit = run.contradiction, f"metadata: {run.stated_hz:g} Hz"
        reason = f"{stroke.channel} {against}; the metadata say {run.stated_hz:g} Hz"
        yield "SWM032", "Stroke", f"{stroke.beat.frequency_hz:.4g} Hz", limit, against is None, reason
    elif stroke is not None and stroke.doubt:
        yield "SWM033", "Stroke", "in doubt", "one frequency", False, stroke.doubt


def _fusion_tests(fused: Fused, options: TrackImuOptions) -> Iterator[Test]:
    offset, count, stray = fused.offset, len(fused.fixes.time_s), fused.stray
    limit = f"below {MAX_HELD_OUT:g}"
    value = f"{1e3 * offset.value_s:.2f} ms"
    reason = (
        f"the clocks differ: {value} to add to the other log (95 %: {1e3 * offset.low_s:.1f} ... "
        f"{1e3 * offset.high_s:.1f} ms); the output is on the inertial clock"
    )
    agreed = offset.low_s <= 0.0 <= offset.high_s or options.clock_offset_s is not None
    yield "SWM083", "Clock offset", value, "0 within the 95 % interval", agreed, reason
    for kind, named in (("position", "positions"), ("orientation", "angles")):
        size = fused.smoothed.score(kind)
        if size is not None:
            value, reason = f"{size:.2f} sd (rms)", f"the {named} of the other log disagree with the sensor"
            yield "", f"Innovations of {named}", value, limit, size <= MAX_HELD_OUT, reason
    reason = f"{stray} of {count} fixes of the other log lie beyond {GATE:g} sd of the motion"
    most = f"at most {100 * MAX_STRAY:.0f} %"
    yield "SWM087", "Stray fixes", f"{stray}", most, stray <= MAX_STRAY * count, reason
    reason = (
        "many successive fixes of the other log have the same error: the logs contradict each other, or its "
        f"scale or marker is wrong; every band is widened by {fused.lasting:.1f}"
    )
    value, passed = f"band widened by {fused.lasting:.2f}", fused.lasting <= MAX_LASTING
    yield "SWM087", "Lasting errors of fixes", value, f"below {MAX_LASTING:g}", passed, reason
    held = fused.held_out
    if held is None:
        reason = "too few fixes to hold some out and predict them"
        yield "", "Fixes predicted", "none", limit, False, reason
        return
    value, passed = f"{held.deviations:.2f} sd (rms) of {held.fixes}", held.deviations <= MAX_HELD_OUT
    reason = f"held-out fixes are predicted to {held.deviations:.2f} sd (rms) only"
    yield "", "Fixes left out", value, limit, passed, reason


# ---------------------------------------------------------------- evidence


def _answer(run: Run) -> str:
    if run.by_paper:
        return f"Velocity and position follow Shang et al. (2012), {run.setup.options.motion_mode} mode."
    if not np.isfinite(run.motion.position).any():
        return "Only the attitude is given: positions and velocities are empty."
    half = BAND * np.max(run.motion.position_sd[:, :2], axis=1)
    if not run.alone:
        return f"The position is known to ± {np.median(half):.4f} m (median of the 95 % band)."
    if run.trusted_until_s is None:
        return f"The whole path can be used; its 95 % band reaches ± {_largest(half):.3f} m."
    return "Surge within a stroke (u_osc_m_s) and attitude can be used throughout."


def _tables(run: Run) -> list[Table]:
    moved = run.motion
    rows: list[list[ev.Cell]] = []
    if run.fused is not None:
        offset = run.fused.offset
        rows.append(["clock offset (ms)", 1e3 * offset.value_s, 1e3 * BAND * offset.stderr_s])
    if not run.by_paper:
        half = BAND * np.max(moved.position_sd[:, :2], axis=1)
        yaw, yaw_sd = angles(moved.rotation)[2][-1], moved.angle_sd[-1, 2]
        band = _rms(BAND * run.surge_osc_sd)
        rows += [
            ["surge within a stroke, rms (m/s)", _rms(run.surge_osc), band],
            ["position in the plane, maximum (m)", None, _largest(half)],
            ["heading at the end (deg)", float(yaw / DEG), float(BAND * yaw_sd / DEG)],
        ]
    if run.stroke is not None:
        beat = run.stroke.beat
        rows.append([f"stroke in {run.stroke.channel} (Hz)", beat.frequency_hz, BAND * beat.stderr_hz])
    columns = ["quantity", "value", "95 % band ±"]
    details = {name: value for name, value in _data(run).items() if name not in ("faults", "stroke")}
    return [
        Table(id="motion", title="Motion", columns=columns, rows=rows),
        leaf_table(
            "details", "Details", details, "Biases along the axes of the sensor equal a tilt at rest."
        ),
    ]


def _methods(run: Run) -> list[str]:
    options = run.setup.options
    if run.by_paper:
        return [
            "Velocity and position were computed from accelerations as by Shang et al. (2012): means "
            f"subtracted for {options.motion_mode} mode, readings below {options.threshold_m_s2:g} m/s² and "
            f"{options.threshold_rad_s:g} rad/s set to zero, rotation to earth axes (Eqs 10 and 11), "
            "trapezoids (Eqs 12 and 13)."
        ]
    more = ", mounting, lever arm and clock offset against a second log of the trial"
    return [
        "Motion was estimated from an inertial unit by an error-state Kalman filter and Rauch-Tung-Striebel "
        f"smoother over position, velocity, attitude and sensor biases{more * (run.fused is not None)}; "
        f"attitude from {run.setup.source.kind}."
    ]


def _figures(run: Run) -> list[Figure]:
    moved = run.motion
    velocity = _panels(run, ["surge", "sway", "heave"], "m/s", moved.body_velocity, moved.body_velocity_sd)
    if not run.by_paper:
        surge, surge_sd = run.surge_osc[:, None], run.surge_osc_sd[:, None]
        velocity = [*_panels(run, ["surge within a stroke"], "m/s", surge, surge_sd), *velocity]
    turn = np.column_stack(angles(moved.rotation)) / DEG
    parts = {
        "Body velocity": velocity,
        "Position": _panels(run, "xyz", "m", moved.position, moved.position_sd, fixes=True),
        "Attitude": _panels(run, motion.ANGLES, "deg", turn, moved.angle_sd / DEG),
    }
    caption = "The estimate with its 95 % band, rests shaded; points are those of the other log."
    return [
        Figure(id=title.split()[-1].lower(), title=title, caption=caption, panels=panels)
        for title, panels in parts.items()
    ]


def _panels(
    run: Run, names: Sequence[str], unit: str, values: Array, sds: Array, *, fixes: bool = False
) -> list[Panel]:
    """Return a panel over time for each column, with its band; ``fixes`` adds positions in the other log."""
    t = run.setup.record.time_s
    rests = [period for period in _still_periods(run) if period["used_as_rest"]]
    spans = [Span(start=rest["from_s"], end=rest["to_s"], label="rest") for rest in rests]
    every = slice(None, None, max(len(t) // N_DRAWN, 1))
    panels = []
    for k, name in enumerate(names):
        x, y = t[every], values[every, k]
        traces = [ev.band(x, y, BAND * sds[every, k], label="estimate", group=0)]
        if fixes and run.poses is not None and run.fused is not None:
            seen = slice(None, None, max(len(run.poses.time_s) // N_DRAWN, 1))
            x, y = run.poses.time_s[seen] + run.fused.offset.value_s, run.poses.position[seen, k]
            traces.append(Trace(x=x, y=y, label="other log", style="points", group=1))
        panels.append(Panel(x_label="time (s)", y_label=f"{name} ({unit})", traces=traces, spans=spans))
    return panels
