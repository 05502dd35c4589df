"""Recording of an inertial unit, and quantities that are computed before the motion is estimated.

These quantities are the errors of the sensor, the rests, the noise, the mounting and the attitude. The module
also reads the poses in another log of the same trial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation, Slerp

from swimid.errors import InputError, UsageError, extra_needed
from swimid.files.provenance import path_of
from swimid.files.tabular import column_error
from swimid.imports import mapping
from swimid.imports.clocks import BAND as BAND
from swimid.imports.clocks import resample as resampled
from swimid.inertial.options import TrackImuOptions
from swimid.kinematics.attitude import angles, from_angles, with_angles
from swimid.kinematics.jumps import clean_track
from swimid.logs import log
from swimid.logs.log import Log, runs
from swimid.logs.sampling import usual_step
from swimid.notices import Progress, warn

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Names of the columns of an inertial log: specific force, turn rate, the two together, attitude (quaternion
#: from sensor to world), and magnetic field.
ACCELERATION = ("ax_m_s2", "ay_m_s2", "az_m_s2")
RATE = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
CHANNELS = (*ACCELERATION, *RATE)
QUATERNION = ("qw", "qx", "qy", "qz")
MAGNETIC = ("mx", "my", "mz")
#: Standard gravity, m/s^2 (CGPM 1901).
GRAVITY_M_S2 = 9.80665
#: Minimum number of samples of a recording.
MIN_RECORD_SAMPLES = 64
#: Maximum magnitude of a coordinate in the other log, m. Larger values are codes for a missing sample.
MAX_POSITION_M = 1e4
#: Minimum number of samples, and maximum sample time (s), of a track in another log that is searched for
#: jumps and repeated samples.
MIN_TRACK_SAMPLES, MAX_TRACK_STEP_S = 40, 0.25


@dataclass(frozen=True)
class ImuRecord:
    """Recording of n samples of an inertial unit, in the axes of the sensor."""

    time_s: Array
    #: Specific force (m/s^2) and turn rate (rad/s), each of shape (n, 3).
    acceleration: Array
    rate: Array
    #: Attitude from sensor to world as quaternions (w, x, y, z), shape (n, 4).
    quaternion: Array | None = None
    #: Magnetic field in any unit, shape (n, 3).
    magnetic: Array | None = None
    #: Flags of samples that are interpolated, shape (n, 2): one column for the accelerometer and one for the
    #: gyroscope.
    filled: Flags = field(default_factory=lambda: np.zeros((0, 2), dtype=bool))
    metadata: Mapping[str, Any] = field(default_factory=dict)
    #: Name of the recording in messages.
    name: str = "the log"

    def __post_init__(self) -> None:
        if len(self.filled) != len(self.time_s):
            object.__setattr__(self, "filled", np.zeros((len(self.time_s), 2), dtype=bool))

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def step_s(self) -> float:
        """Median time step of the record, s."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def channels(self) -> Array:
        """Accelerations and turn rates as columns in the order of :data:`CHANNELS`, shape (n, 6)."""
        return np.hstack([self.acceleration, self.rate])

    def take(self, rows: Any) -> ImuRecord:
        """Return a copy of the record with only the rows selected by indices or flags."""
        arrays = {name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)


@dataclass(frozen=True)
class Finding:
    """Fault that was found in a recording, and its treatment."""

    #: Name of the fault, as in ``docs/imu.md``.
    fault: str
    #: Treatment of the fault. "handled": the fault is repaired, or suspected with a warning. "noted": the
    #: fault is only reported. "refuted": a column is wrong and is not used.
    verdict: Literal["handled", "noted", "refuted"]
    #: Sentence on the fault that was found and on its treatment.
    text: str
    #: Number of affected samples; 0 if the fault does not concern single samples.
    count: int = 0


def rotations(quaternion: Array) -> Rotation:
    """Return the rotations that quaternions (w, x, y, z), shape (n, 4), describe."""
    return Rotation.from_quat(quaternion, scalar_first=True)


def turns_of(rotation: Rotation) -> Array:
    """Return the rotation vector about body axes from each attitude to the next, rad, shape (n - 1, 3)."""
    return np.asarray((rotation[:-1].inv() * rotation[1:]).as_rotvec())


def turn_to_angles(body: Rotation) -> Array:
    """Return the derivatives of roll, pitch and yaw with respect to a small rotation, shape (n, 3, 3).

    The small rotation is about world axes. The formula holds for a nearly level body: roll is then about the
    heading direction, pitch about the direction to starboard (nose up), and yaw about the vertical.
    """
    yaw = angles(body)[2]
    out = np.zeros((len(yaw), 3, 3))
    out[:, 0, 0], out[:, 0, 1] = np.cos(yaw), np.sin(yaw)
    out[:, 1, 0], out[:, 1, 1] = np.sin(yaw), -np.cos(yaw)
    out[:, 2, 2] = 1.0
    return out


@dataclass(frozen=True)
class Poses:
    """Poses of the robot at m times according to another log, on the clock of that log."""

    time_s: Array
    #: Positions along world axes, m, shape (m, 3); NaN where not measured.
    position: Array
    #: Roll, pitch and yaw, rad, with the signs of :func:`swimid.kinematics.attitude.angles`, shape (m, 3);
    #: NaN where not measured. A log has all three angles, or only yaw, or only pitch, or none. At each time,
    #: either all angles of the log are measured or none.
    angles: Array

    @property
    def has_angle(self) -> Flags:
        """Flags of roll, pitch and yaw: whether the other log measures the angle at any time, shape (3,)."""
        return np.asarray(np.isfinite(self.angles).any(axis=0))

    @property
    def rotation(self) -> Rotation:
        """Attitudes of the poses (rotations from body to world). A missing angle counts as 0."""
        return from_angles(*np.nan_to_num(self.angles).T)

    @property
    def has_attitude(self) -> Flags:
        """Flags of the poses in which all measured angles are known, shape (m,)."""
        return np.asarray(np.isfinite(self.angles).any(axis=1))


# ---------------------------------------------------------------- reading


def read_record(
    given: Path | Log, rules: mapping.Mapping | None, named: Path, progress: Progress
) -> tuple[ImuRecord, list[str]]:
    """Read a recording without repairing its faults; also return notes on the reading.

    Parameters
    ----------
    given : path or Log
    rules : Mapping or None
        Columns and units of a log that is not in the format of swimid.
    named : path
        File named in error messages about columns: the mapping, or the recording itself.
    progress : Progress

    Raises
    ------
    InputError
        The file or the mapping cannot be used, a column is missing, or the recording is too short.
    """
    path = path_of(given)
    mapped = mapping.apply(rules, given, progress=progress)
    columns = mapped.columns
    for names in (ACCELERATION, RATE, MAGNETIC):
        lacking = [name for name in names if name not in columns]
        if lacking and (names != MAGNETIC or len(lacking) < len(names)):
            text = f"an inertial log needs all of {', '.join(names)}"
            raise column_error(lacking[0], list(columns), named, None, text)
    if len(mapped) < MIN_RECORD_SAMPLES:
        text = f"has {len(mapped)} samples; at least {MIN_RECORD_SAMPLES} are needed"
        raise InputError(text, file=path)

    parts = [
        np.column_stack([columns[name] for name in names]) if set(names) <= set(columns) else None
        for names in (ACCELERATION, RATE, QUATERNION, MAGNETIC)
    ]
    record = ImuRecord(columns[log.TIME], *parts, metadata=mapped.metadata, name=path.name)  # type: ignore[arg-type,misc]
    return record, mapped.notes


def read_poses(read: Log) -> Poses:
    """Return the poses of the robot in another log. Interpolated samples count as missing.

    Measured positions (``x_raw_m``) are preferred to smoothed ones (``x_m``).

    Raises
    ------
    InputError
        The log has neither positions nor angles.
    """
    bridged = np.zeros(len(read), dtype=bool)
    for name, value in (("found", 0), ("interpolated", 1)):
        if name in read:
            bridged |= read[name] == value

    columns = with_angles(read.columns)

    def channel(name: str, unit: str) -> Array:
        for column in (f"{name}_raw_{unit}", f"{name}_{unit}"):
            if column in columns:
                return np.where(bridged, np.nan, columns[column])
        return np.full(len(read), np.nan)

    position = np.column_stack([channel(axis, "m") for axis in "xyz"])
    turn = np.column_stack([channel(name, "rad") for name in ("roll", "pitch", "yaw")])
    if not np.isfinite(position).any() and not np.isfinite(turn).any():
        text = "holds neither a position (x_m, y_m, z_m) nor an angle (roll_rad, pitch_rad, yaw_rad)"
        raise InputError(text, file=read.path, hint="tracks in pixels need a scale in their setup")
    _remove_wrong(read, position, turn)
    measured = np.isfinite(turn)
    turn[:, 2] = log.unwrap(turn[:, 2])
    if not measured.any(axis=0).all():
        single = 2 if measured[:, 2].any() else 1
        turn[:, np.arange(3) != single] = np.nan
    incomplete = np.isnan(turn) & np.isfinite(turn).any(axis=0)
    turn[incomplete.any(axis=1)] = np.nan
    return Poses(read.time_s, position, turn)


def _remove_wrong(read: Log, position: Array, turn: Array) -> None:
    """Set poses of another log to NaN, in place, where they repeat a picture of the camera or jump.

    In a log with few samples, or with a long sample time, only positions beyond ``MAX_POSITION_M`` are
    removed.
    """
    wrong = (np.abs(position) > MAX_POSITION_M).any(axis=1)
    position[wrong] = np.nan
    repeated = np.zeros_like(wrong)
    seen = np.flatnonzero(np.isfinite(position).any(axis=0))
    if len(read) >= MIN_TRACK_SAMPLES and usual_step(read.time_s) <= MAX_TRACK_STEP_S and len(seen) > 1:
        cleaning = clean_track(read.time_s, [position[:, k] for k in seen], list(turn.T))
        repeated, wrong = cleaning.repeated, wrong | cleaning.jumped
    out = repeated | wrong
    if out.any():
        position[out] = turn[out] = np.nan
        text = f"{int(repeated.sum())} repeated and {int(wrong.sum())} stray samples left out of the track"
        warn("SWM058", f"{read.path.name}: {text}")


# ---------------------------------------------------------------- dead reckoning


def integrate_attitude(time_s: Array, rate: Array, start: Rotation) -> Rotation:
    """Return the attitude at every sample, computed by integration of the turn rates.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    rate : ndarray, shape (n, 3)
        Turn rate in the axes of the sensor, rad/s, without bias.
    start : Rotation
        Attitude from sensor to world at the first sample.

    Notes
    -----
    The rotation in each step is the trapezoidal integral of the rates plus the coning term ``(w0 x w1) dt^2 /
    12`` (Bortz 1971, doi:10.1109/TAES.1971.310252, for rates that change linearly).
    """
    dt = np.diff(time_s)[:, None]
    turn = 0.5 * (rate[1:] + rate[:-1]) * dt + np.cross(rate[:-1], rate[1:]) * dt**2 / 12
    steps = [start.as_matrix(), *Rotation.from_rotvec(turn).as_matrix()]
    return Rotation.from_matrix(np.array(list(accumulate(steps, np.matmul))))


def integral(time_s: Array, values: Array, start: Any = 0.0) -> Array:
    """Return the trapezoidal integral of every column over time, from the first sample, shape (n, d).

    The integral begins with the value ``start``. The formulas are Eqs 12 and 13 of Shang et al. (2012), with
    the actual time steps between samples.
    """
    return np.asarray(cumulative_trapezoid(values, time_s, axis=0, initial=0)) + start


# ---------------------------------------------------------------- sensor errors


#: Conversion factors of units: 1 mg (milli-g) in m/s^2, and 1 degree in rad.
MILLI_G = 1e-3 * GRAVITY_M_S2
DEG = np.pi / 180


@dataclass(frozen=True)
class Sensor:
    """Standard deviations of the errors of an inertial unit.

    The default values are those of the MicroStrain 3DM-GX1.
    """

    #: Standard deviations of the biases before any calibration, m/s^2 and rad/s.
    acceleration_bias_sd: float = 10 * MILLI_G
    rate_bias_sd: float = 1.0 * DEG
    #: Standard deviations of the change of a bias in :data:`DRIFT_TIME_S`, m/s^2 and rad/s: 0.2 mg
    #: ("short-term stability", Table I of Shang et al. 2012) and 0.02 deg/s.
    acceleration_drift: float = 0.2 * MILLI_G
    rate_drift: float = 0.02 * DEG
    #: Standard deviation of the relative errors of scale and alignment, for accelerometer and gyroscope.
    scale_sd: float = 0.005
    #: Standard deviation of the relative change of the scale over the range of motion (nonlinearity), for
    #: accelerometer and gyroscope.
    bending_sd: float = 0.002


#: Errors of sensor chips that are not calibrated after soldering: limits of their data sheets divided by
#: sqrt(3) (uniform distribution). The chips are InvenSense MPU-6050 (PS-MPU-6000A rev. 3.4, sec. 6.1 and 6.2:
#: +-50 mg, +-20 deg/s, scale +-3 %, cross-axis +-2 %), ICM-20948 (DS-000189: +-50 mg on a board, +-5 deg/s,
#: +-1.5 %), Bosch BMI160 (+-40 mg, +-3 deg/s), and ST LSM6DSO (+-20 mg, +-1 deg/s, +-1 %). Once warm, these
#: chips have biases as constant as those of better units.
CHIP = Sensor(30 * MILLI_G, 5.0 * DEG, scale_sd=0.015)
#: Error classes of sensors, by description. One class replaces the default errors if the class explains a
#: recording better. A chip warms up by ten degrees in five minutes, and its biases change by 0.5 mg and 0.16
#: deg/s per degree (MPU-6050: +-35 mg over 70 degrees, +-20 deg/s over 125 degrees). The values for a warming
#: chip are the changes in 100 s.
CLASSES = {
    "a consumer's chip (biases of 30 mg, scales off by 1.5 %)": CHIP,
    "a consumer's chip that warms up (biases of 30 mg that change by 1.7 mg and 0.5 deg/s in 100 s)": (
        replace(CHIP, acceleration_drift=1.7 * MILLI_G, rate_drift=0.5 * DEG)
    ),
}
#: Time to which the stated drift of a bias refers, s.
DRIFT_TIME_S = 100.0


# ---------------------------------------------------------------- still periods


#: WINDOW_S is the length of the windows in which motion is detected, s. MIN_REST_S is the minimum length of a
#: still period, s: that of all its still windows together, so that a rest of 1.5 s is found.
WINDOW_S, MIN_REST_S = 0.5, 1.4
#: Fraction of the windows of a recording that are assumed to be still. The largest standard deviation of the
#: readings in these windows is taken for the noise.
STILL_SHARE = 0.05
#: Maximum standard deviation of the readings in a still window, divided by that of the noise.
NOISE_RATIO = 2.0
#: Minimum values of the limits below which a window is still: standard deviation of specific force (m/s^2)
#: and of turn rate (rad/s). They apply if the noise is so low that ``NOISE_RATIO`` times the noise is
#: smaller.
MIN_MOTION_ACCELERATION, MIN_MOTION_RATE = 0.03, 0.01
#: Maximum standard deviations of the specific force (m/s^2) and of the turn rate (rad/s) of a sensor at rest.
MAX_REST_ACCELERATION, MAX_REST_RATE = 0.25, 0.05
#: Maximum mean turn rate that a gyroscope at rest shows, rad/s: 20 deg/s on each axis (InvenSense MPU-6050).
MAX_STILL_RATE = 20 * np.sqrt(3) * DEG
#: Fraction of a recording that counts as its start, and fraction that counts as its end. A still period
#: within the first fraction is at the "start", and one within the last fraction at the "end".
EDGE_SHARE = 0.02


@dataclass(frozen=True)
class Rest:
    """Period in which the sensor is still: rows ``first`` to ``last`` (exclusive) of a record.

    ``at`` is its place in the record: "start", "end" or "between".
    """

    first: int
    last: int
    at: str

    @property
    def rows(self) -> slice:
        """Rows of the record that belong to the still period."""
        return slice(self.first, self.last)


def find_rests(record: ImuRecord) -> list[Rest]:
    """Return the periods of a record in which the sensor does not move.

    A window is still if the standard deviations of specific force and turn rate are at most ``NOISE_RATIO``
    times those of the least moving 5 % of the record. In addition, its mean turn rate must be close to the
    median of such windows.

    Notes
    -----
    The detector is that of Skog et al. (2010, doi:10.1109/TBME.2010.2060723, SHOE), with a threshold derived
    from the record. A body that glides without rotation looks still to any inertial sensor.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    if len(record) < 3 * size:
        return []
    deviations = [_deviation(values, size) for values in (record.acceleration, record.rate)]
    noises = [max(float(np.quantile(d, STILL_SHARE)), 1e-9) for d in deviations]
    limits = np.maximum(np.multiply(NOISE_RATIO, noises), (MIN_MOTION_ACCELERATION, MIN_MOTION_RATE))
    steady = (deviations[0] <= limits[0]) & (deviations[1] <= limits[1])
    if not steady.any() or noises[0] > MAX_REST_ACCELERATION or noises[1] > MAX_REST_RATE:
        return []
    mean_rate = _average_windows(record.rate, size)
    off = np.linalg.norm(mean_rate - np.median(mean_rate[steady], axis=0), axis=1)
    rests = []
    for first, last in runs(steady & (off <= limits[1])).tolist():
        # Shorten the still period by half a window at either end, because the outer half of its first and
        # last window may contain motion.
        begin = first + size // 2 * (first > 0)
        end = last - size // 2 * (last < len(record))
        margin = WINDOW_S / 2 * ((first > 0) + (last < len(record)))
        if end - begin >= 4 and record.time_s[last - 1] - record.time_s[first] + margin >= MIN_REST_S:
            rests.append(_rest(record, begin, end))
    return rests


def mean_accelerations(record: ImuRecord, rests: list[Rest]) -> Array:
    """Return the mean specific force in each still period, m/s^2, shape (periods, 3).

    Without still periods the result is the mean over the whole record.
    """
    parts = [record.acceleration[r.rows] for r in rests] or [record.acceleration]
    return np.array([part.mean(axis=0) for part in parts])


def mean_rate(record: ImuRecord, rests: list[Rest]) -> Array:
    """Return the median over still periods of the mean turn rate in each period, rad/s, shape (3,).

    Without still periods the result is 0.
    """
    if not rests:
        return np.zeros(3)
    return np.asarray(np.median([record.rate[r.rows].mean(axis=0) for r in rests], axis=0))


def _make_stated_rests(record: ImuRecord, windows: Sequence[tuple[float, float]]) -> list[Rest]:
    """Return the rests of the robot that the user states by start and end times, s.

    Raises
    ------
    UsageError
        A stated rest does not end after it begins.
    InputError
        The sensor rotates in a stated rest.
    """
    rests = []
    for start, end in windows:
        if not start < end:
            raise UsageError(f"--still {start:g} {end:g}: the end must be after the start")
        first, last = (int(row) for row in np.searchsorted(record.time_s, [start, end]))
        if last - first < 4:
            continue
        turning = float(np.mean(np.linalg.norm(record.rate[first:last], axis=1)))
        if turning > MAX_STILL_RATE:
            text = f"turns at {turning:.1f} rad/s from {start:g} to {end:g} s, which is stated as a rest"
            hint = "state a time in which the robot rests, or leave --still out"
            raise InputError(text, file=record.name, hint=hint)
        rests.append(_rest(record, first, last))
    return rests


def _rest(record: ImuRecord, first: int, last: int) -> Rest:
    edge = EDGE_SHARE * len(record)
    if first <= edge:
        return Rest(first, last, "start")
    return Rest(first, last, "end" if last >= len(record) - edge else "between")


@dataclass(frozen=True)
class SensorNoise:
    """Densities of the white noise of accelerometer and gyroscope, per square root of 1 Hz."""

    acceleration_m_s2_per_rt_hz: float
    rate_rad_s_per_rt_hz: float
    #: Source of the noise densities: "still periods" of the record, or "data sheet".
    source: str


#: Noise that is assumed for a record without still periods (MicroStrain 3DM-GX1 data sheet; Shang et al.
#: 2012, Table I).
DATA_SHEET = SensorNoise(0.4 * MILLI_G, 3.5 * DEG / 60.0, "data sheet")


def measure_noise(record: ImuRecord, rests: list[Rest]) -> SensorNoise:
    """Return the noise densities of the sensor, measured in its still periods and averaged over the axes.

    Without still periods the result is the noise of the data sheet.
    """
    if not rests:
        return DATA_SHEET
    densities = []
    for values in (record.acceleration, record.rate):
        steps = np.vstack([np.diff(values[r.rows], axis=0) for r in rests])
        densities.append(np.sqrt(record.step_s / 2) * float(np.sqrt(np.mean(steps**2))))
    acceleration, rate = densities
    return SensorNoise(acceleration, rate, "still periods")


def _average_windows(values: Array, size: int) -> Array:
    return np.asarray(uniform_filter1d(values, size, axis=0, mode="nearest"))


def _deviation(values: Array, size: int) -> Array:
    """Return the standard deviation of a sensor's readings in a window of ``size`` samples about each sample.

    The result has the shape (n,). It is the square root of the sum of the variances of all axes.
    """
    centred = values - values.mean(axis=0)
    spread = _average_windows(centred**2, size) - _average_windows(centred, size) ** 2
    return np.sqrt(np.maximum(spread.sum(axis=1), 0.0))


# ---------------------------------------------------------------- mounting and attitude


#: Name of the source of the attitude if the log itself has quaternions.
QUATERNIONS = "quaternion columns"
#: Standard deviation of the attitude, rad: QUATERNION_SD for quaternions in a log (3DM-GX1, Table I of Shang
#: et al. 2012), and FILTER_SD for an attitude filter.
QUATERNION_SD, FILTER_SD = 2.0 * DEG, 1.0 * DEG
#: Standard deviation of the mounting of the sensor, rad: GRAVITY_MOUNT_SD for a mounting that follows from
#: gravity, and STATED_MOUNT_SD for one that the user states.
GRAVITY_MOUNT_SD, STATED_MOUNT_SD = 3 * DEG, 0.5 * DEG
#: Maximum angle between the directions of gravity in two rests of the robot in the same attitude, rad.
UPRIGHT = 45 * DEG
#: Places of the still periods that count as rests of the robot, for each value of the option ``--rest``.
REST_PLACES = {"ends": ("start", "end"), "all": ("start", "between", "end"), "none": ()}


@dataclass(frozen=True)
class AttitudeSource:
    """Attitude of the sensor at every sample before smoothing, and its source."""

    #: Rotation from sensor to world axes at each of n samples.
    rotation: Rotation
    #: Whether the yaw is measured, by a compass or by the attitude filter in the sensor.
    heading: bool
    #: Name of the source of the attitude: "quaternion columns", "gyroscope and accelerometer" or "gyroscope,
    #: accelerometer and magnetometer".
    kind: str


@dataclass(frozen=True)
class Mount:
    """Mounting of the sensor on the body."""

    #: Mounting: rotation from body to sensor axes.
    rotation: Rotation
    #: Source of the mounting, as text: "given", "quaternions", "level at rest" or others.
    by: str
    #: Unit vector opposite to gravity when the robot is at rest, in sensor axes, shape (3,).
    up: Array
    #: Standard deviation of the mounting, rad.
    sd: float = GRAVITY_MOUNT_SD


@dataclass(frozen=True)
class ImuSetup:
    """Inertial record, with rests, noise, mounting and attitude, as known before the motion is estimated."""

    record: ImuRecord
    options: TrackImuOptions
    #: Still periods of the sensor, the still periods that count as rests of the robot, and noise of the
    #: sensor.
    still: list[Rest]
    rests: list[Rest]
    noise: SensorNoise
    mount: Mount
    source: AttitudeSource
    #: Standard deviations of the errors of the sensor.
    sensor: Sensor = Sensor()
    #: Function that shows the progress and is called after each application of the smoother.
    advance: Callable[[], Any] = lambda: None

    @property
    def attitude_sd(self) -> float:
        """Standard deviation of the attitude before smoothing, rad."""
        return QUATERNION_SD if self.source.kind == QUATERNIONS else FILTER_SD

    @property
    def still_rate(self) -> Array:
        """Median turn rate shown by the sensor in its still periods, rad/s, shape (3,)."""
        return mean_rate(self.record, self.still)

    @property
    def body(self) -> ImuRecord:
        """Record converted to body axes by the mounting, which follows from gravity or from the user."""
        turn, record = self.mount.rotation.inv(), self.record
        return replace(record, acceleration=turn.apply(record.acceleration), rate=turn.apply(record.rate))

    @property
    def attitude(self) -> Rotation:
        """Rotation from body to world before smoothing, at each of n samples."""
        return self.source.rotation * self.mount.rotation

    @property
    def lever(self) -> Array:
        """Vector from the sensor to the body's reference point (lever), in sensor axes, m, shape (3,)."""
        return np.asarray(self.mount.rotation.apply(-np.array(self.options.lever_m or (0.0, 0.0, 0.0))))

    def drop_rests(self, rests: list[Rest]) -> ImuSetup:
        """Return a copy of the setup without the given rests of the robot.

        An attitude from a filter is estimated again without these rests.
        """
        still, used = ([r for r in some if r not in rests] for some in (self.still, self.rests))
        return replace(self, still=still, rests=used, source=_attitude(self.record, still))


def prepare_setup(record: ImuRecord, options: TrackImuOptions) -> tuple[ImuSetup, list[Finding]]:
    """Find rests, noise, mounting and attitude of a record; return its setup and findings on the mounting."""
    stated, places = _make_stated_rests(record, options.still), REST_PLACES[options.rests]
    free = [r for r in find_rests(record) if not any(r.first < d.last and d.first < r.last for d in stated)]
    still = sorted([*stated, *free], key=lambda rest: rest.first)
    rests = [rest for rest in still if rest in stated or rest.at in places]
    mount, findings = find_mount(record, still, options)
    noise, source = measure_noise(record, still), _attitude(record, still)
    return ImuSetup(record, options, still, rests, noise, mount, source), findings


def find_mount(record: ImuRecord, rests: list[Rest], options: TrackImuOptions) -> tuple[Mount, list[Finding]]:
    """Find the mounting of the sensor on the body without another log.

    A log with quaternion columns is taken to be in body axes, since the quaternions convert from body to
    world. Otherwise the mounting follows from the direction of gravity at rest. If the robot comes to rest in
    another attitude than at the start, its first rest is used.

    Raises
    ------
    InputError
        Gravity points down the z axis: the sensor is upside down, or its signs are wrong.
    """
    seen = mean_accelerations(record, rests)
    seen = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    up = seen[0] if np.min(seen @ seen[0]) < np.cos(UPRIGHT) else seen.mean(axis=0)
    up = up / np.linalg.norm(up)
    if options.mount_deg is not None:
        roll, pitch, yaw = (np.array([angle * DEG]) for angle in options.mount_deg)
        return Mount(from_angles(roll, pitch, yaw)[0].inv(), "given", up, STATED_MOUNT_SD), []
    if record.quaternion is not None:
        return Mount(Rotation.identity(), "quaternions", up), []
    axis = int(np.argmax(np.abs(up)))
    name, by = f"{'-+'[int(up[axis] > 0)]}{'xyz'[axis]}", "as the sensor's axes"
    rotation = _level(np.sign(up[axis]) * np.eye(3)[axis])
    if options.level_at_rest:
        rotation, by = _level(up), "level at rest"
    if name == "+z":
        return Mount(rotation, by, up), []
    if name == "-z":
        raise InputError(
            "az is negative at rest; a sensor with z up shows +9.81",
            file=record.name,
            column="az_m_s2",
            hint="for a sensor of the other sign, give factor: -1 for all three axes in a mapping (--map); "
            "for a sensor mounted upside down, give --mount-deg 180 0 0",
        )
    text = (
        f"gravity lies along the sensor's {name} axis, not +z: the sensor is taken as turned by the smallest "
        "turn that puts this axis up; give --mount-deg if the body's forward axis comes out wrong"
    )
    return Mount(rotation, f"{name} axis up", up), [Finding("gravity axis", "handled", text)]


def _level(up: Array) -> Rotation:
    """Return the smallest rotation that turns the z axis into the direction ``up``."""
    return Rotation.align_vectors(up[None], [[0.0, 0.0, 1.0]])[0]


def _attitude(record: ImuRecord, rests: list[Rest]) -> AttitudeSource:
    """Return the attitude of the sensor before smoothing, and its source.

    The attitude is that of the quaternion columns. If there are none, it is estimated from turn rates,
    accelerations and the magnetic field by the offline form of VQF, which runs forwards and backwards (Laidig
    and Seel 2023, doi:10.1016/j.inffus.2022.10.014). Without a magnetic field the yaw of the first sample is
    0.
    """
    if record.quaternion is not None:
        return AttitudeSource(rotations(record.quaternion), True, QUATERNIONS)
    with extra_needed("an attitude from turn rates and accelerations", "imu"):
        import vqf

    t, step = record.time_s, record.step_s
    even = bool(np.ptp(np.diff(t)) < 1e-3 * step)
    grid = t if even else np.arange(t[0], t[-1] + step, step)
    rate, field = record.rate - mean_rate(record, rests), record.magnetic
    readings = [None if x is None else resampled(grid, t, x) for x in (rate, record.acceleration, field)]
    found = vqf.offlineVQF(*readings, step)
    rotation = rotations(np.asarray(found["quat6D" if field is None else "quat9D"]))
    if not even:
        rotation = Slerp(grid, rotation)(np.clip(t, grid[0], grid[-1]))
    if field is None:
        yaw = rotation[0].as_euler("ZYX")[0]
        return AttitudeSource(
            Rotation.from_rotvec([0.0, 0.0, -yaw]) * rotation, False, "gyroscope and accelerometer"
        )
    # Use the world axes of VQF, which are east, north and up, as they are. Yaw is measured from the x axis,
    # which is east.
    return AttitudeSource(rotation, True, "gyroscope, accelerometer and magnetometer")
