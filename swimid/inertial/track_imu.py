"""Command ``swimid track imu``, which estimates a log of the motion from an inertial recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.imports import mapping
from swimid.inertial import estimate as estimation
from swimid.inertial import faults, smoother
from swimid.inertial import record as recording
from swimid.inertial.estimate import GATE, MAX_HELD_OUT, MAX_LASTING, MAX_STRAY, MotionEstimate
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import BAND, DEG, GRAVITY_M_S2, Array, Finding, ImuRecord, ImuSetup
from swimid.inertial.smoother import Motion, SmoothedMotion
from swimid.kinematics import frequency
from swimid.kinematics.frequency import read_frequency
from swimid.kinematics.logged import Logged
from swimid.kinematics.stroke import StrokeEstimate, find_stroke
from swimid.logs import log
from swimid.logs.log import Log, LogLike
from swimid.notices import Notice, Progress, record_warnings, silent, warn
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results.evidence import (
    Check,
    Evidence,
    Figure,
    Panel,
    Table,
    Trace,
    leaf_table,
    make_check,
    make_verdict,
)


class Integrated(Logged):
    """Result of ``track_imu``: log with velocity, position and attitude."""


@takes(TrackImuOptions)
def track_imu(
    imu: LogLike, *, options: TrackImuOptions, output: str | Path | None = None, progress: Progress = silent
) -> Integrated:
    """Compute velocity, position and attitude from an inertial recording, with 95 % bands.

    The other log (``other``) has positions (m), angles (rad), or both. ``map_path`` can be a dict.

    Parameters
    ----------
    imu : path, Log or DataFrame
        Recording with at least 64 rows and the columns ``t_s``, ``ax_m_s2`` to ``az_m_s2`` (specific force)
        and ``wx_rad_s`` to ``wz_rad_s`` (turn rate), in the sensor's axes. Optional columns are ``qw`` to
        ``qz`` (quaternion) and ``mx`` to ``mz`` (magnetic field). Logs with other columns need a mapping.
    output : path, optional
        Log to write, CSV or Parquet by its file name extension, with ``<stem>.evidence.json`` in the same
        folder. :meth:`~swimid.results.result.Result.save` writes the files later.
    progress : Progress
        Shows the progress of reading and smoothing.

    Returns
    -------
    Integrated
        ``.frame`` has one row for each sample: position (m), attitude (rad), velocity along body and world
        axes (m/s), all with standard deviations, turn rates (rad/s) and accelerations (m/s^2).

    Raises
    ------
    InputError, UsageError
        An input cannot be used, a fault cannot be repaired, or the options contradict each other.
    NoTrustworthyResult
        The two logs do not show the same motion.

    Notes
    -----
    The method is an error-state Kalman filter and the smoother of Rauch, Tung and Striebel (Groves, 2013,
    ch. 14). ``method="paper"`` follows Shang et al. (2012), doi:10.1017/S0263574711001159.

    Examples
    --------
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
    unread = log.unread(imu, name="imu")
    rules = None if options.map_path is None else mapping.read_mapping(options.map_path)
    given = _inputs(unread, rules, options)
    if output is not None:
        output = atomic.check_writable(output, inputs=given)
    with record_warnings(repeat=True) as notices:
        named = given[0 if rules is None else 1]
        run = _estimate(unread, rules, provenance.path_of(named), options, progress)
        result = _result(run, notices, provenance.collect(given, settings=options.settings()))
    return result.write_output(output)


def _inputs(
    unread: Path | Log, rules: mapping.Mapping | None, options: TrackImuOptions
) -> list[provenance.Input]:
    """Return all inputs: the recording, the mapping and the other log."""
    inputs: list[provenance.Input] = [unread]
    if rules is not None:
        inputs.append(options.map_path if isinstance(options.map_path, str | Path) else rules)
    if options.other is not None:
        inputs.append(log.unread(options.other, name="other"))
    return inputs


def _estimate(
    unread: Path | Log,
    rules: mapping.Mapping | None,
    named: Path,
    options: TrackImuOptions,
    progress: Progress,
) -> ImuRun:
    """Read and repair a recording, and estimate its motion; ``named`` is the file in messages on columns."""
    if options.method == "paper" and options.other is not None:
        hint = "omit --with, or give --method smoother"
        raise UsageError("--method paper cannot use a camera log (--with)", hint=hint)
    record, notes = recording.read_record(unread, rules, named, progress)
    record, findings = faults.repair(record)
    poses = None if options.other is None else recording.read_poses(log.as_log(options.other, name="other"))
    setup, more = recording.prepare_setup(record, options)
    with progress("smoothing", total=None) as step:
        run = estimate_by_method(replace(setup, advance=step), [*findings, *more], poses)
    for note in notes:
        warn("SWM004", f"{record.name}: {note}")
    return run


# ---------------------------------------------------------------- motion


#: Maximum half-width of the 95 % band of a position that can be used: in m, and relative to the distance
#: travelled. The larger of the two limits applies.
TRUSTED_WIDTH_M, TRUSTED_SHARE = 0.1, 0.1
#: Minimum frequency of an oscillation that counts as motion within a stroke: STROKE_SHARE relative to the
#: stroke frequency, or LOWEST_HZ in Hz if the stroke frequency is unknown.
STROKE_SHARE, LOWEST_HZ = 0.5, 0.3
#: Names of the three angles of an attitude.
ANGLE_NAMES = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class ImuRun:
    """Estimated motion of one recording, with its setup and all values for log, checks and figures."""

    #: Setup of the recording, with the error class of the sensor and the rests that were used.
    setup: ImuSetup
    findings: list[Finding]
    stroke: StrokeEstimate
    #: Stroke frequency that the metadata state, Hz; None if absent.
    stated_hz: float | None
    cutoff_hz: float
    #: Estimated motion. ``surge`` is the surge velocity within a stroke.
    motion: Motion
    poses: recording.Poses | None = None
    #: Estimate by the smoother; None for the method of Shang et al. (2012).
    found: MotionEstimate | None = None
    #: Time after which the position cannot be used, s; None if it can be used throughout.
    trusted_until_s: float | None = None
    #: Biases of accelerometer (m/s^2) and gyroscope (rad/s) at the last sample, shape (6,).
    bias: Array | None = None
    #: Root-mean-square innovation of the velocity at rests, in standard deviations.
    rest_score: float | None = None
    #: Reasons why positions and velocities are left empty; no reasons if they are written.
    impossible: Sequence[str] = ()

    @property
    def by_paper(self) -> bool:
        """Whether the motion was computed by :func:`compute_by_paper`, which gives no standard deviations."""
        return self.setup.options.method == "paper"

    @property
    def alone(self) -> bool:
        """Whether the motion was estimated from the inertial unit without another log."""
        return self.fusion is None and not self.by_paper

    @property
    def fusion(self) -> MotionEstimate | None:
        """Estimate from the recording and another log together; None without another log."""
        if self.found is None or self.found.fixes is None:
            return None
        return self.found

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body at rest, from the direction of gravity, rad."""
        mount = self.setup.mount.rotation if self.fusion is None else self.fusion.smoothed.path.mount
        up = mount.inv().apply(self.setup.mount.up)
        return float(np.arctan2(up[1], up[2])), float(np.arctan2(up[0], np.hypot(up[1], up[2])))

    @property
    def contradiction(self) -> str | None:
        """Message on a contradiction between measured and stated stroke frequency; None if the two agree."""
        stroke, stated_hz = self.stroke, self.stated_hz
        if stroke.beat is None or stated_hz is None:
            return None
        if stroke.maybe_double and frequency.contradiction(stroke.beat, 2 * stated_hz) is None:
            return None
        return frequency.contradiction(stroke.beat, stated_hz)

    def columns(self) -> dict[str, Any]:
        """Return the columns of the motion log by name, in the order of the log."""
        record, motion = self.setup.record, self.motion
        columns = {"t_s": record.time_s, **_columns(motion, "")}
        if self.by_paper:
            return columns
        columns |= {"u_osc_m_s": motion["surge"][:, 0]} | _columns(motion, "_sd")
        bridged = record.filled.any(axis=1).astype(int)
        return columns | {"u_osc_sd_m_s": motion["surge_sd"][:, 0], "bridged": bridged}


#: Names of the columns for each quantity of a motion, in their order in a log.
COLUMNS = {
    "position": ("{}{}_m", "xyz"),
    "angle": ("{}{}_rad", ANGLE_NAMES),
    "body_velocity": ("{}{}_m_s", "uvw"),
    "velocity": ("v{}{}_m_s", "xyz"),
    "rate": ("{}{}_rate_rad_s", ANGLE_NAMES),
    "acceleration": ("a{}{}_world_m_s2", "xyz"),
    "quaternion": ("q{}{}", "xyzw"),
}


def _columns(motion: Motion, ending: str) -> dict[str, Array]:
    """Return the columns of a log for the quantities of a motion, by column name.

    If ``ending`` is ``_sd``, return the columns of the standard deviations of these quantities.
    """
    known = {name: named for name, named in COLUMNS.items() if name + ending in motion}
    columns = {}
    for name, (pattern, parts) in known.items():
        for part, column in zip(parts, motion[name + ending].T, strict=True):
            columns[pattern.format(part, ending)] = column
    if not ending:
        columns["pitch_rate_rad_s"] = -columns["pitch_rate_rad_s"]
    return columns


def estimate_by_method(setup: ImuSetup, findings: list[Finding], poses: recording.Poses | None) -> ImuRun:
    """Estimate the motion of a recording by the method chosen in the options.

    Parameters
    ----------
    setup : Setup
    findings : list of Finding
        Faults that were found while the recording was read and repaired.
    poses : Poses or None
        Poses of another log of the trial.
    """
    body, record, options = setup.body, setup.record, setup.options
    t = record.time_s
    readings = dict(zip(recording.CHANNELS, body.channels.T, strict=True))
    stated_hz = read_frequency(record.metadata)
    stroke, cutoff = find_stroke(t, readings), LOWEST_HZ
    if stroke.frequency_hz is not None:
        cutoff = STROKE_SHARE * stroke.frequency_hz
    run = ImuRun(setup, findings, stroke, stated_hz, cutoff, {}, poses)
    if options.method == "paper":
        moved, constant = compute_by_paper(body, setup.attitude, options)
        return replace(run, motion=moved, bias=constant)
    found = estimation.estimate_motion(setup, poses)
    setup, smoothed = replace(found.setup, sensor=found.smoothed.sensor), found.smoothed
    run = replace(run, setup=setup, findings=[*findings, *found.findings], found=found)
    if found.impossible:
        turning = setup.mount.rotation.inv().apply(record.rate - setup.still_rate)
        acceleration = setup.source.rotation.apply(record.acceleration) + smoother.gravity(np.zeros(2))
        moved = smoother.attitude_only(setup.attitude, turning, acceleration, setup.attitude_sd)
        moved |= dict.fromkeys(("surge", "surge_sd"), np.full((len(t), 1), np.nan))
        run = replace(run, motion=moved, impossible=found.impossible)
    else:
        moved = smoother.at_reference(smoothed) | smoother.surge_within_stroke(smoothed, cutoff)
        bias = np.concatenate([smoothed.path.acceleration_bias[-1], smoothed.path.rate_bias[-1]])
        run = replace(run, motion=moved, rest_score=smoothed.score("rest"), bias=bias)
    return _drop_impossible(run) if run.alone else run


def _drop_impossible(run: ImuRun) -> ImuRun:
    """Return the result with NaN at impossible speeds, and with the time until which the path can be trusted.

    A sample is too fast if its speed exceeds the top speed by more than the 95 % band. It is also too fast if
    its speed exceeds GATE times the standard deviation that the smoother assumes for the speed.
    """
    moved, top_m_s = run.motion, run.setup.options.top_speed_m_s
    speed = np.linalg.norm(moved["velocity"], axis=1)
    squares = np.sum((moved["velocity"] * moved["velocity_sd"]) ** 2, axis=1)
    band = BAND * np.sqrt(squares) / np.maximum(speed, 1e-9)
    fast, impossible = (speed - band > top_m_s) | (speed > GATE * 0.5 * top_m_s), run.impossible
    if fast.any():
        text = f"the speed of {100 * fast.mean():.0f} % of the samples, up to {speed.max():.1f} m/s,"
        impossible = [f"{text} exceeds the maximum speed of the robot, {top_m_s:g} m/s"]
        hidden = np.where(fast[:, None], np.nan, 0.0)
        moved = moved | {name: moved[name] + hidden for name in smoother.EMPTIED}
    until_s = find_trust(run.setup.record.time_s, moved["position"], moved["position_sd"])
    return replace(run, motion=moved, impossible=impossible, trusted_until_s=until_s)


def compute_by_paper(record: ImuRecord, rotation: Rotation, options: TrackImuOptions) -> tuple[Motion, Array]:
    """Compute the motion from an inertial recording by the method of Shang et al. (2012).

    Parameters
    ----------
    record : Record
        Recording of n samples in body axes.
    rotation : Rotation
        Attitude from body to earth, shape (n,): the inverse of ``M_e^f`` of Shang et al. (2012).
    options : TrackImuOptions
        Thresholds ("discarded", sec. 5.2) and motion mode. In the modes ``marching`` and ``receding`` the
        constant parts of all six channels are errors and gravity, and are subtracted. In the mode
        ``rotating`` the mean yaw rate is motion, and is not subtracted.

    Returns
    -------
    Motion
        Motion without standard deviations.
    ndarray, shape (6,)
        Constant parts of the channels, m/s^2 and rad/s.

    Notes
    -----
    The method is that of Shang, Wang, Tan and Cheng (2012, doi:10.1017/S0263574711001159), section 5. The
    constant part of the readings is subtracted, small readings are set to zero, and accelerations are
    converted to the earth's axes (Eq 10). Velocity and position follow by the trapezoidal rule (Eqs 12 and
    13). The paper states neither its filter, nor the thresholds, nor an uncertainty. Because the mean
    acceleration is subtracted, the final velocity always equals the initial one.
    """
    constant = record.channels.mean(axis=0)
    if options.motion_mode == "rotating":
        constant[5] = 0.0
    readings = record.channels - constant
    thresholds = np.repeat([options.threshold_m_s2, options.threshold_rad_s], 3)
    readings[np.abs(readings) < thresholds] = 0.0
    acceleration = rotation.apply(readings[:, :3])
    velocity = recording.integral(record.time_s, acceleration)
    moved = {
        "position": recording.integral(record.time_s, velocity),
        "velocity": velocity,
        "body_velocity": rotation.inv().apply(velocity),
    }
    return smoother.attitude_only(rotation, readings[:, 3:], acceleration) | moved, constant


def find_trust(time_s: Array, position: Array, position_sd: Array) -> float | None:
    """Return the time from which the estimated position is too uncertain to be used.

    At this time the half-width of the horizontal 95 % band exceeds both 0.1 m and 10 % of the distance
    travelled for the first time.

    The time is on the clock of the log, s. The result is None if the whole position can be used.

    Parameters
    ----------
    position, position_sd : ndarray, shape (n, 3)
        Position and standard deviation, m. A position of NaN cannot be used.
    """
    half = BAND * np.max(position_sd[:, :2], axis=1)
    travelled = np.append(0.0, np.cumsum(np.hypot(*np.diff(position[:, :2], axis=0).T)))
    beyond = np.flatnonzero(~(half <= np.maximum(TRUSTED_WIDTH_M, TRUSTED_SHARE * travelled)))
    return float(time_s[beyond[0]]) if len(beyond) else None


# ---------------------------------------------------------------- log and evidence


SHANG = "Shang, Wang, Tan, Cheng (2012). Robotica 30, 913-923. doi:10.1017/S0263574711001159"
RAUCH = "Rauch, Tung, Striebel (1965). AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166"
VQF = "Laidig, Seel (2023). Information Fusion 91, 187-204. doi:10.1016/j.inffus.2022.10.014"
#: Maximum root-mean-square innovation of the velocity at rests, in standard deviations. Two rests give at
#: least six innovations, whose chi-square exceeds four times its degrees of freedom in 1 of 2000 cases.
MAX_REST_SCORE = 2.0
#: Maximum deviation of the scale of the gyroscope from 1, in standard deviations of the class of the sensor.
MAX_SCALE = 3.0
#: Maximum number of samples of a curve in a figure.
N_DRAWN = 2000
#: Level of the check and code of the warning that report a fault of the recording, by
#: :attr:`Finding.verdict`.
GRADES: dict[str, tuple[Literal["info", "warn", "fail"], str]] = {
    "noted": ("info", ""),
    "handled": ("warn", "SWM080"),
    "refuted": ("fail", "SWM090"),
}
#: Names of the checks that are failures if they do not pass. Any other check is only a warning.
FAIL = ("Possible motion", "Lasting errors of fixes", "Fixes left out")

#: Type of a check before it is evaluated: code of the warning, name, value, limit, whether the check passes,
#: and the reason if it does not.
Test = tuple[str, str, str, str, bool, str]


def _result(run: ImuRun, notices: Sequence[Notice], provenance: dict[str, Any]) -> Integrated:
    """Return the motion log with its checks, tables and figures. Warn of the checks that do not pass.

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
        "clock_offset_s": run.fusion and run.fusion.offset.value_s,
        "stroke_hz": run.stroke.frequency_hz,
    }
    metadata = {k: v for k, v in head.items() if v is not None}
    references = [SHANG if run.by_paper else RAUCH]
    if record.quaternion is None:
        references.append(VQF)
    evidence = Evidence(
        command="track imu",
        title=f"Motion of {record.name}",
        verdict=make_verdict(_answer(run), checks),
        facts={"Attitude": run.setup.source.kind, "Mounting": run.setup.mount.by},
        checks=checks,
        tables=_tables(run),
        figures=_figures(run),
        notices=list(notices),
        methods=_methods(run),
        references=references,
        provenance=provenance,
    )
    document = Log(Path(record.name).with_suffix(".csv"), metadata, log.numeric(columns), None)
    data = _data(run) | {"checks": [check.model_dump() for check in checks]}
    return Integrated("track imu", "", data, evidence=evidence, document=document, table=columns)


def _still_periods(run: ImuRun) -> list[dict[str, Any]]:
    """Return start, end and place of each still period, and whether it counts as a rest."""
    t, setup = run.setup.record.time_s.tolist(), run.setup
    return [
        {"from_s": t[r.first], "to_s": t[r.last - 1], "at": r.at, "used_as_rest": r in setup.rests}
        for r in setup.still
    ]


def _rms(values: Array) -> float | None:
    return _largest(np.sqrt(np.mean(np.square(values))))


def _largest(values: Any) -> float | None:
    """Return the maximum of the finite values of an array; None if there are none."""
    finite = np.asarray(values)[np.isfinite(values)]
    return float(finite.max()) if finite.size else None


# ---------------------------------------------------------------- document


def _data(run: ImuRun) -> dict[str, Any]:
    setup, stroke, fused, moved = run.setup, run.stroke, run.fusion, run.motion
    roll, pitch = run.tilt
    out: dict[str, Any] = {
        "method": setup.options.method,
        "attitude_from": setup.source.kind,
        "still_periods": _still_periods(run),
        "noise": vars(setup.noise),
        "faults": [vars(finding) for finding in run.findings],
        "mounting": {"by": setup.mount.by, "roll_at_rest_rad": roll, "pitch_at_rest_rad": pitch},
        "stroke": stroke.beat
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
        "surge_oscillation": {"rms_m_s": _rms(moved["surge"]), "above_hz": run.cutoff_hz},
        "largest_band_95": {"position_m": _largest(BAND * moved["position_sd"])},
    }
    if run.alone:
        out["path_trusted"] = {"until_s": run.trusted_until_s}
    if fused is not None:
        path, (lever, lever_sd) = fused.smoothed.path, _lever(fused.smoothed)
        out["mounting"] |= {
            "body_to_sensor_rotation_vector_rad": path.mount.as_rotvec().tolist(),
            "lever_m": lever.tolist(),
            "lever_sd_m": lever_sd.tolist(),
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
            "held_out": fused.held_out,
        }
    return out


# ---------------------------------------------------------------- checks


def _checks(run: ImuRun) -> list[Check]:
    """Return the checks of a recording; warn of each check that does not pass and has a code."""
    checks, name = [], run.setup.record.name
    for f in run.findings:
        grade, code = GRADES[f.verdict]
        if code:
            warn(code, f"{name}, {f.fault}: {f.text}")
        reason = f"the recording has a fault ({f.fault})"
        checks.append(Check(name=f.fault.capitalize(), value="", verdict=grade, text=f.text, reason=reason))
    tests = list(_motion_tests(run))
    if run.fusion is not None:
        tests += _fusion_tests(run.fusion, run.setup.options)
    for code, title, value, limit, passed, reason in tests:
        if code and not passed:
            warn(code, f"{name}: {reason}")
        otherwise: Literal["warn", "fail"] = "fail" if title in FAIL else "warn"
        checks.append(make_check(title, value, passed, limit, otherwise=otherwise, reason=reason))
    return checks


def _motion_tests(run: ImuRun) -> Iterator[Test]:
    setup = run.setup
    count = len(setup.still)
    reason = "no still period was found, so the biases are known only to the accuracy of the data sheet"
    yield "SWM082", "Still periods", str(count), "at least one", count > 0, reason
    size = float(np.mean(np.linalg.norm(recording.mean_accelerations(setup.record, setup.still), axis=1)))
    # Compute the half-width of the 95 % band of gravity, relative to g, from bias and scale error of the
    # sensor class.
    share = BAND * float(np.hypot(setup.sensor.acceleration_bias_sd / GRAVITY_M_S2, setup.sensor.scale_sd))
    value, limit = f"{size:.3f} m/s²", f"{GRAVITY_M_S2:.3f} ± {100 * share:.1f} %"
    reason = f"the measured gravity at rest is {value}, outside {limit}"
    yield "", "Gravity", value, limit, abs(size / GRAVITY_M_S2 - 1) <= share, reason
    if run.by_paper:
        reason = "the method 'paper' computes no uncertainty"
        yield "", "Uncertainty", "none", "a stated band", False, reason
    if run.impossible:
        yield "SWM086", "Possible motion", "no", "else left empty", False, "; ".join(run.impossible)
    if run.alone:
        until, limit = run.trusted_until_s, "95 % band within 0.1 m or a tenth of the way"
        value = "its end" if until is None else f"t = {until:.1f} s"
        reason = f"the integrated position is not to be trusted after {value}"
        yield "SWM081", "Path trusted until", value, limit, until is None, reason
    if run.rest_score is not None:
        value, passed = f"{run.rest_score:.2f} sd (rms)", run.rest_score <= MAX_REST_SCORE
        reason = f"the integrated motion is {run.rest_score:.2f} standard deviations (rms) off the rests"
        yield "SWM084", "Innovations at rests", value, f"below {MAX_REST_SCORE:g}", passed, reason
    stroke = run.stroke
    if stroke.beat is not None and run.stated_hz is not None:
        against, limit = run.contradiction, f"metadata: {run.stated_hz:g} Hz"
        reason = f"{stroke.channel} {against}; the metadata say {run.stated_hz:g} Hz"
        yield "SWM032", "Stroke", f"{stroke.beat.frequency_hz:.4g} Hz", limit, against is None, reason
    elif stroke.doubt:
        yield "SWM033", "Stroke", "in doubt", "one frequency", False, stroke.doubt


def _gyroscope_scale(fused: MotionEstimate) -> tuple[str, float, float]:
    """Return the gyroscope axis with the best determined scale, its scale factor and standard deviation.

    The factor is the reading of this axis divided by the true turn rate.
    """
    part = smoother.ERROR_SLICES["rate_scale"]
    variances = np.diag(fused.smoothed.errors.covariance[-1])[part].reshape(3, 3).diagonal()
    axis = int(np.argmin(variances))
    # Remove the bias of the estimate towards 1, which the prior causes.
    left = max(1.0 - float(variances[axis]) / fused.smoothed.sensor.scale_sd**2, 0.01)
    factor = 1.0 / (1.0 - float(fused.smoothed.path.rate_scale[axis, axis]) / left)
    return "xyz"[axis], factor, factor**2 * float(np.sqrt(variances[axis] / left))


def _lever(found: SmoothedMotion) -> tuple[Array, Array]:
    """Return the vector from reference point to sensor in body axes, and its standard deviation, m."""
    turn, part = found.path.mount.inv().as_matrix(), smoother.ERROR_SLICES["lever"]
    covariance = turn @ found.errors.covariance[-1][part, part] @ turn.T
    return -turn @ found.path.lever, np.sqrt(np.diag(covariance))


def _fusion_tests(fused: MotionEstimate, options: TrackImuOptions) -> Iterator[Test]:
    axis, factor, sd = _gyroscope_scale(fused)
    value, prior = f"{factor:.4f} ± {BAND * sd:.4f} (w{axis})", fused.smoothed.sensor.scale_sd
    reason = (
        f"the gyroscope reads {factor:.4f} ± {BAND * sd:.4f} times the turn rate w{axis} of the camera log: "
        f"give the unit or the factor {1 / factor:.4f} in a mapping (--map). The motion is already corrected"
    )
    limit = MAX_SCALE * np.hypot(prior, sd)
    yield "SWM087", "Gyroscope scale", value, f"1 ± {limit:.3g}", bool(abs(factor - 1) <= limit), reason
    offset, count, stray = fused.offset, len(fused.fixes.time_s), fused.stray
    limit = f"below {MAX_HELD_OUT:g}"
    value = f"{1e3 * offset.value_s:.2f} ms"
    reason = (
        f"the clocks of the two logs differ: {value} (95 %: {1e3 * offset.low_s:.1f} ... "
        f"{1e3 * offset.high_s:.1f} ms) is added to the times of the camera log"
    )
    agreed = offset.low_s <= 0.0 <= offset.high_s or options.clock_offset_s is not None
    yield "SWM083", "Clock offset", value, "0 within the 95 % interval", agreed, reason
    for kind, named in (("position", "positions"), ("orientation", "angles")):
        size = fused.smoothed.score(kind)
        if size is not None:
            value, reason = f"{size:.2f} sd (rms)", f"the {named} of the camera log disagree with the sensor"
            yield "", f"Innovations of {named}", value, limit, size <= MAX_HELD_OUT, reason
    reason = f"{stray} of {count} fixes of the camera log are over {GATE:g} standard deviations off"
    most = f"at most {100 * MAX_STRAY:.0f} %"
    yield "SWM087", "Stray fixes", f"{stray}", most, stray <= MAX_STRAY * count, reason
    reason = (
        "many successive fixes of the camera log have the same error: the logs contradict each other, or the "
        f"scale or marker of the camera log is wrong. Every band is widened {fused.lasting:.1f} times"
    )
    value, passed = f"band widened by {fused.lasting:.2f}", fused.lasting <= MAX_LASTING
    yield "SWM087", "Lasting errors of fixes", value, f"below {MAX_LASTING:g}", passed, reason
    held = fused.held_out
    if held is None:
        reason = "the camera log has too few fixes to test the motion on held-out fixes"
        yield "", "Fixes predicted", "none", limit, False, reason
        return
    deviations = f"{held['deviations']:.2f} sd (rms)"
    value, passed = f"{deviations} of {held['fixes']}", held["deviations"] <= MAX_HELD_OUT
    error = f"{held['deviations']:.2f} standard deviations (rms)"
    reason = f"the errors of predicted held-out fixes are {error}, not {limit}"
    yield "", "Fixes left out", value, limit, passed, reason


# ---------------------------------------------------------------- evidence


def _answer(run: ImuRun) -> str:
    if run.by_paper:
        return f"Velocity and position follow Shang et al. (2012), {run.setup.options.motion_mode} mode."
    if not np.isfinite(run.motion["position"]).any():
        return "Only the attitude is given: positions and velocities are empty."
    half = BAND * np.max(run.motion["position_sd"][:, :2], axis=1)
    if not run.alone:
        return f"The position is known to ± {np.median(half):.4f} m (median of the 95 % band)."
    if run.trusted_until_s is None:
        return f"The whole path can be used; its 95 % band reaches ± {_largest(half):.3f} m."
    return "Surge within a stroke (u_osc_m_s) and attitude can be used throughout."


def _tables(run: ImuRun) -> list[Table]:
    moved = run.motion
    rows: list[list[ev.Cell]] = []
    if run.fusion is not None:
        offset = run.fusion.offset
        rows.append(["clock offset (ms)", 1e3 * offset.value_s, 1e3 * BAND * offset.stderr_s])
        axis, factor, sd = _gyroscope_scale(run.fusion)
        rows.append([f"gyroscope w{axis}, reading over true rate", factor, BAND * sd])
        lever, sds = _lever(run.fusion.smoothed)
        rows += [
            [f"sensor from reference point, {name} (m)", at, BAND * sd]
            for name, at, sd in zip("xyz", lever.tolist(), sds.tolist(), strict=True)
        ]
    if not run.by_paper:
        half = BAND * np.max(moved["position_sd"][:, :2], axis=1)
        yaw, yaw_sd = moved["angle"][-1, 2], moved["angle_sd"][-1, 2]
        band, basis = _rms(BAND * moved["surge_sd"]), ""
        if run.alone and not run.setup.source.heading:
            basis = f", if the gyroscope's scale is right to {100 * run.setup.sensor.scale_sd:.2g} %"
        rows += [
            ["surge within a stroke, rms (m/s)", _rms(moved["surge"]), band],
            ["position in the plane, maximum (m)", None, _largest(half)],
            [f"heading at the end (deg){basis}", float(yaw / DEG), float(BAND * yaw_sd / DEG)],
        ]
    beat = run.stroke.beat
    if beat is not None:
        rows.append([f"stroke in {run.stroke.channel} (Hz)", beat.frequency_hz, BAND * beat.stderr_hz])
    columns = ["quantity", "value", "95 % band ±"]
    details = {name: value for name, value in _data(run).items() if name not in ("faults", "stroke")}
    caption = "Biases along the axes of the sensor equal a tilt at rest."
    motion = Table(id="motion", title="Motion", columns=columns, rows=rows)
    return [motion, leaf_table("details", "Details", details, caption)]


def _methods(run: ImuRun) -> list[str]:
    options = run.setup.options
    if run.by_paper:
        return [
            "Velocity and position were computed from accelerations as by Shang et al. (2012): means "
            f"subtracted for {options.motion_mode} mode, readings below {options.threshold_m_s2:g} m/s² and "
            f"{options.threshold_rad_s:g} rad/s set to zero, rotation to earth axes (Eqs 10 and 11), "
            "trapezoids (Eqs 12 and 13)."
        ]
    more = ", mounting, lever arm and clock offset against the camera log of the trial"
    return [
        "Motion was estimated from an inertial unit by an error-state Kalman filter and Rauch-Tung-Striebel "
        f"smoother over position, velocity, attitude and sensor biases{more * (run.fusion is not None)}; "
        f"attitude from {run.setup.source.kind}."
    ]


def _figures(run: ImuRun) -> list[Figure]:
    velocity = _panels(run, ["surge", "sway", "heave"], "m/s", "body_velocity")
    if not run.by_paper:
        velocity = [*_panels(run, ["surge within a stroke"], "m/s", "surge"), *velocity]
    parts = {
        "Body velocity": velocity,
        "Position": _panels(run, "xyz", "m", "position"),
        "Attitude": _panels(run, ANGLE_NAMES, "deg", "angle", 1 / DEG),
    }
    caption = "The estimate with its 95 % band, rests shaded; points are those of the camera log."
    return [ev.panels(title.split()[-1].lower(), title, caption, panels) for title, panels in parts.items()]


def _panels(run: ImuRun, names: Sequence[str], unit: str, quantity: str, factor: float = 1.0) -> list[Panel]:
    """Return one panel of a figure for each component of a quantity over time, with its 95 % band.

    The positions in the other log are shown with those of the motion. ``factor`` converts the quantity to
    ``unit``.
    """
    t, values, sds = run.setup.record.time_s, run.motion[quantity], run.motion[f"{quantity}_sd"]
    rests = [period for period in _still_periods(run) if period["used_as_rest"]]
    spans = [{"start": rest["from_s"], "end": rest["to_s"], "label": "rest"} for rest in rests]
    every = slice(None, None, max(len(t) // N_DRAWN, 1))
    panels = []
    for k, name in enumerate(names):
        x, y, half = t[every], factor * values[every, k], BAND * factor * sds[every, k]
        traces = [ev.band(x, y, half, label="estimate", group=0)]
        if quantity == "position" and run.poses is not None and run.fusion is not None:
            seen = slice(None, None, max(len(run.poses.time_s) // N_DRAWN, 1))
            x, y = run.poses.time_s[seen] + run.fusion.offset.value_s, run.poses.position[seen, k]
            traces.append(Trace(x=x, y=y, label="other log", style="points", group=1))
        panels.append(ev.panel("time (s)", f"{name} ({unit})", traces, spans=spans))
    return panels
