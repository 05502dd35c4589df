"""Recordings of an inertial unit, poses in another log of the same trial, and dead reckoning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.files.provenance import path_of
from swimid.files.tabular import missing_column
from swimid.logs import log, mapping, tracks
from swimid.logs.kinematics import angles, from_angles, with_angles
from swimid.logs.log import Log
from swimid.logs.sampling import usual_step
from swimid.notices import Progress, warn

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Names of the columns of specific force, turn rate, both together, attitude (sensor to world) and magnetic
#: field.
ACCELERATION = ("ax_m_s2", "ay_m_s2", "az_m_s2")
RATE = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
CHANNELS = (*ACCELERATION, *RATE)
QUATERNION = ("qw", "qx", "qy", "qz")
MAGNETIC = ("mx", "my", "mz")
#: Standard gravity, m/s^2 (CGPM 1901).
GRAVITY_M_S2 = 9.80665
#: Minimum number of samples of a recording.
MIN_SAMPLES = 64
#: Maximum coordinate of a position, m. Larger values are codes for "no sample".
MAX_POSITION_M = 1e4
#: Minimum number of samples and maximum sample time (s) of a track that is searched for jumps.
MIN_TRACK_SAMPLES, MAX_TRACK_STEP_S = 40, 0.25


@dataclass(frozen=True)
class Record:
    """Recording of n samples of an inertial unit, in the axes of the sensor."""

    time_s: Array
    #: Specific force, m/s^2, and turn rate, rad/s, each of shape (n, 3).
    acceleration: Array
    rate: Array
    #: Attitude from sensor to world as quaternions (w, x, y, z), shape (n, 4).
    quaternion: Array | None = None
    #: Magnetic field in any unit, shape (n, 3).
    magnetic: Array | None = None
    #: Flags of samples that were interpolated, each of shape (n,).
    filled_acceleration: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    filled_rate: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    metadata: Mapping[str, Any] = field(default_factory=dict)
    #: Name of the file in messages.
    name: str = "the log"

    def __post_init__(self) -> None:
        for flags in ("filled_acceleration", "filled_rate"):
            if len(getattr(self, flags)) != len(self.time_s):
                object.__setattr__(self, flags, np.zeros(len(self.time_s), dtype=bool))

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def step_s(self) -> float:
        """Median sample time, s."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def channels(self) -> Array:
        """Accelerations and turn rates in the order of :data:`CHANNELS`, shape (n, 6)."""
        return np.hstack([self.acceleration, self.rate])

    def take(self, rows: Any) -> Record:
        """Return the record with the rows selected by indices or flags."""
        arrays = {name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)


@dataclass(frozen=True)
class Finding:
    """Fault that was found in a recording."""

    #: Name of the fault, as in ``docs/imu.md``.
    fault: str
    #: "handled": repaired, or suspected; "noted": reported only; "refuted": a column is wrong and is not
    #: used.
    verdict: Literal["handled", "noted", "refuted"]
    #: Sentence that says what was found and what was done.
    text: str
    #: Number of affected samples; 0 if the fault does not concern single samples.
    count: int = 0


def resampled(at_s: Array, time_s: Array, values: Array) -> Array:
    """Return columns, shape (n, k), interpolated linearly to the times ``at_s``, shape (m, k)."""
    return np.column_stack([np.interp(at_s, time_s, column) for column in values.T])


def rotations(quaternion: Array) -> Rotation:
    """Return the rotations given by quaternions (w, x, y, z), shape (n, 4)."""
    return Rotation.from_quat(quaternion, scalar_first=True)


def turns_of(rotation: Rotation) -> Array:
    """Return the rotation vectors from each attitude to the next about body axes, rad, shape (n - 1, 3)."""
    return np.asarray((rotation[:-1].inv() * rotation[1:]).as_rotvec())


def turn_to_angles(body: Rotation) -> Array:
    """Return the derivatives of roll, pitch and yaw with respect to small rotations, shape (n, 3, 3).

    The rotations are about world axes, and the body is nearly level. Roll is then about the heading
    direction, pitch about starboard (nose up), and yaw about the vertical.
    """
    yaw = angles(body)[2]
    out = np.zeros((len(yaw), 3, 3))
    out[:, 0, 0], out[:, 0, 1] = np.cos(yaw), np.sin(yaw)
    out[:, 1, 0], out[:, 1, 1] = np.sin(yaw), -np.cos(yaw)
    out[:, 2, 2] = 1.0
    return out


@dataclass(frozen=True)
class Poses:
    """Poses of the robot at m times in another log, on the clock of that log."""

    time_s: Array
    #: Position along world axes, m, shape (m, 3); NaN where not measured.
    position: Array
    #: Roll, pitch and yaw, rad, with the signs of :func:`swimid.logs.kinematics.angles`, shape (m, 3); NaN
    #: where not measured. A log has all three, or only yaw, or only pitch, or none, and a row has all of them
    #: or none.
    angles: Array

    @property
    def measured(self) -> Flags:
        """Flags of the angles that were measured at any time, shape (3,)."""
        return np.asarray(np.isfinite(self.angles).any(axis=0))

    @property
    def rotation(self) -> Rotation:
        """Attitudes from body to world, with missing angles set to 0."""
        return from_angles(*np.nan_to_num(self.angles).T)

    @property
    def turned(self) -> Flags:
        """Flags of the rows in which all measured angles are known, shape (m,)."""
        return np.asarray(np.isfinite(self.angles).any(axis=1))


# ---------------------------------------------------------------- reading


def read_record(
    given: Path | Log, rules: mapping.Mapping | None, named: Path, progress: Progress
) -> tuple[Record, list[str]]:
    """Return a recording without repairing its faults, and notes on how it was read.

    Parameters
    ----------
    given : path or Log
    rules : Mapping or None
        Columns and units of a foreign log.
    named : path
        File that defines the columns, for error messages: the mapping, or the recording itself.
    progress : Progress

    Raises
    ------
    InputError
        When the file or the mapping cannot be used, a column is missing, or the recording is too short.
    """
    path = path_of(given)
    mapped = mapping.apply(rules, given, progress=progress)
    columns = mapped.columns
    for name in (*ACCELERATION, *RATE):
        if name not in columns:
            raise missing_column(name, list(columns), named, None, "an inertial log needs this column")
    if len(mapped) < MIN_SAMPLES:
        text = f"has {len(mapped)} samples; at least {MIN_SAMPLES} are needed"
        raise InputError(text, file=path)

    parts = [
        np.column_stack([columns[name] for name in names]) if set(names) <= set(columns) else None
        for names in (ACCELERATION, RATE, QUATERNION, MAGNETIC)
    ]
    record = Record(columns[log.TIME], *parts, metadata=mapped.metadata, name=path.name)  # type: ignore[arg-type,misc]
    return record, mapped.notes


def read_poses(read: Log) -> Poses:
    """Return positions and angles in another log; interpolated samples count as missing.

    Measured columns (``x_raw_m``) are preferred to smoothed ones (``x_m``).

    Raises
    ------
    InputError
        When the log has neither positions nor angles.
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
    turn[measured[:, 2], 2] = np.unwrap(turn[measured[:, 2], 2])
    if not measured.any(axis=0).all():
        single = 2 if measured[:, 2].any() else 1
        turn[:, np.arange(3) != single] = np.nan
    incomplete = np.isnan(turn) & np.isfinite(turn).any(axis=0)
    turn[incomplete.any(axis=1)] = np.nan
    return Poses(read.time_s, position, turn)


def _remove_wrong(read: Log, position: Array, turn: Array) -> None:
    """Set samples of a dense track to NaN, in place, if they repeat a picture or jump."""
    wrong = (np.abs(position) > MAX_POSITION_M).any(axis=1)
    position[wrong] = np.nan
    repeated = np.zeros_like(wrong)
    seen = np.flatnonzero(np.isfinite(position).any(axis=0))
    if len(read) >= MIN_TRACK_SAMPLES and usual_step(read.time_s) <= MAX_TRACK_STEP_S and len(seen) > 1:
        cleaning = tracks.clean(read.time_s, [position[:, k] for k in seen], list(turn.T))
        repeated, wrong = cleaning.repeated, wrong | cleaning.jumped
    out = repeated | wrong
    if out.any():
        position[out] = turn[out] = np.nan
        text = f"{int(repeated.sum())} repeated and {int(wrong.sum())} stray samples left out of the track"
        warn("SWM058", f"{read.path.name}: {text}")


# ---------------------------------------------------------------- dead reckoning


def integrated_attitude(time_s: Array, rate: Array, start: Rotation) -> Rotation:
    """Return the attitude at every sample by integration of turn rates.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    rate : ndarray, shape (n, 3)
        Turn rate in the axes of the sensor, rad/s, without bias.
    start : Rotation
        Attitude from sensor to world at the first sample.

    Notes
    -----
    Each step rotates by the trapezoidal integral of the rates plus the coning term ``(w0 x w1) dt^2 / 12``
    (Bortz 1971, doi:10.1109/TAES.1971.310252, for rates that change linearly).
    """
    dt = np.diff(time_s)[:, None]
    turn = 0.5 * (rate[1:] + rate[:-1]) * dt + np.cross(rate[:-1], rate[1:]) * dt**2 / 12
    steps = [start.as_matrix(), *Rotation.from_rotvec(turn).as_matrix()]
    return Rotation.from_matrix(np.array(list(accumulate(steps, np.matmul))))


def integral(time_s: Array, values: Array, start: Any = 0.0) -> Array:
    """Return the trapezoidal integral of every column from the first sample, shape (n, d).

    The formulas are Eqs 12 and 13 of Shang et al. (2012), with the actual time steps between samples.
    """
    return np.asarray(cumulative_trapezoid(values, time_s, axis=0, initial=0)) + start
