"""One recording of an inertial unit, and another log of its trial: how they are read, and dead reckoning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.files.provenance import path_of
from swimid.files.tabular import missing_column
from swimid.logs import log, mapping, tracks
from swimid.logs.log import Log
from swimid.logs.rotation import angles, from_angles
from swimid.logs.sampling import usual_step
from swimid.notices import warn
from swimid.progress import Progress

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

ACCELERATION = ("ax_m_s2", "ay_m_s2", "az_m_s2")
RATE = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
CHANNELS = (*ACCELERATION, *RATE)
QUATERNION = ("qw", "qx", "qy", "qz")
MAGNETIC = ("mx", "my", "mz")
#: Standard gravity, m/s^2 (CGPM 1901).
GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class Record:
    """Samples of one inertial unit, in the sensor's axes."""

    #: Shape (n,).
    time_s: Array
    #: Shape (n, 3). Specific force, m/s^2.
    acceleration: Array
    #: Shape (n, 3). Turn rate, rad/s.
    rate: Array
    #: Shape (n, 4). w, x, y, z; sensor to world.
    quaternion: Array | None = None
    #: Shape (n, 3). Magnetic field, any unit.
    magnetic: Array | None = None
    #: Shape (n,). Samples that were not measured but bridged.
    filled_acceleration: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    filled_rate: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    metadata: Mapping[str, Any] = field(default_factory=dict)
    #: The file's name, for messages.
    name: str = "the log"

    def __post_init__(self) -> None:
        for flags in ("filled_acceleration", "filled_rate"):
            if len(getattr(self, flags)) != len(self.time_s):
                object.__setattr__(self, flags, np.zeros(len(self.time_s), dtype=bool))

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def step_s(self) -> float:
        """Typical sample time, s."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def channels(self) -> Array:
        """Accelerations and turn rates, columns as in :data:`CHANNELS`, shape (n, 6)."""
        return np.hstack([self.acceleration, self.rate])

    def with_channels(self, values: Array) -> Record:
        """The same with other accelerations and turn rates, shape (n, 6)."""
        acceleration, rate = (np.ascontiguousarray(half) for half in np.hsplit(values, 2))
        return replace(self, acceleration=acceleration, rate=rate)

    def take(self, rows: Any) -> Record:
        """Only these rows."""
        arrays = {name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)


@dataclass(frozen=True)
class Finding:
    """A fault of recording that was found."""

    #: Name of the fault, as in ``docs/imu.md``.
    fault: str
    #: "handled": repaired, or a doubt; "noted": left as it is, said; "refuted": a column is wrong.
    verdict: Literal["handled", "noted", "refuted"]
    #: What was found and what was done, one sentence.
    text: str
    #: Samples concerned; 0 where it is not a matter of samples.
    count: int = 0


def resampled(at_s: Array, time_s: Array, values: Array) -> Array:
    """Every column of ``values``, shape (n, k), at other times, linearly between samples, shape (m, k)."""
    return np.column_stack([np.interp(at_s, time_s, column) for column in values.T])


def rotations(quaternion: Array) -> Rotation:
    """Rotations of quaternions written w, x, y, z, shape (n, 4)."""
    return Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])


def level(up: Array) -> Rotation:
    """The smallest turn that makes ``up``, shape (3,), the z axis.

    >>> level(np.array([0.0, 2.0, 0.0])).apply([0.0, 1.0, 0.0]).round(9).tolist()
    [0.0, 0.0, 1.0]
    """
    unit = np.asarray(up, dtype=float) / np.linalg.norm(up)
    axis = np.cross(unit, [0.0, 0.0, 1.0])
    size = float(np.linalg.norm(axis))
    if size < 1e-12:
        return Rotation.identity() if unit[2] > 0 else Rotation.from_rotvec([np.pi, 0.0, 0.0])
    return Rotation.from_rotvec(axis / size * np.arctan2(size, unit[2]))


@dataclass(frozen=True)
class Poses:
    """What another log says of the robot."""

    #: Shape (m,). On its own clock.
    time_s: Array
    #: Shape (m, 3). World axes, m; NaN where not measured.
    position: Array
    #: Shape (m, 3). Roll, pitch and yaw, rad, signs of :func:`swimid.logs.rotation.angles`; NaN where not
    #: measured. All three are, or yaw, or pitch, or none.
    angles: Array

    @property
    def measured(self) -> np.ndarray:
        """Which of the angles are, shape (3,)."""
        return np.asarray(np.isfinite(self.angles).any(axis=0))

    @property
    def full(self) -> bool:
        """Whether all three angles are there."""
        return bool(self.measured.all())

    @property
    def rotation(self) -> Rotation:
        """Body to world, m of them; angles that are not there or missing are 0."""
        return from_angles(*np.nan_to_num(self.angles).T)

    @property
    def turned(self) -> np.ndarray:
        """Which rows have every angle that the log has, shape (m,)."""
        there = self.measured
        return np.asarray(there.any() & np.isfinite(self.angles[:, there]).all(axis=1))

    @property
    def turns(self) -> np.ndarray:
        """Which angles of which rows are compared: those of rows that have all, shape (m, 3)."""
        return np.isfinite(self.angles) & self.turned[:, None]


# ---------------------------------------------------------------- reading


#: Fewest samples that make a motion.
FEWEST_SAMPLES = 64


def read_record(
    given: Path | Log, rules: mapping.Mapping | None, named: Path, progress: Progress
) -> tuple[Record, list[str]]:
    """The record as it stands in the file or table, faults and all, and what to know of how it was read.

    ``named`` is what says which column is which: the mapping, or the recording itself.

    Raises
    ------
    InputError
        The file or the mapping cannot be used, or a column is missing.
    """
    path = path_of(given)
    mapped = mapping.apply(rules, given, progress=progress)
    columns = mapped.columns
    for name in (*ACCELERATION, *RATE):
        if name not in columns:
            raise missing_column(name, list(columns), named, None, "an inertial log needs this column")
    if len(mapped) < FEWEST_SAMPLES:
        text = f"has {len(mapped)} samples; at least {FEWEST_SAMPLES} are needed"
        raise InputError(text, file=path)

    def together(names: tuple[str, ...]) -> Any:
        return np.column_stack([columns[name] for name in names]) if set(names) <= set(columns) else None

    record = Record(
        columns[log.TIME],
        together(ACCELERATION),
        together(RATE),
        together(QUATERNION),
        together(MAGNETIC),
        metadata=mapped.metadata,
        name=path.name,
    )
    return record, mapped.notes


def read_poses(read: Log) -> Poses:
    """Positions and angles of another log; bridged samples count as missing.

    Where a log keeps what was measured beside what was smoothed (``x_raw_m``), the measured is taken.

    Raises
    ------
    InputError
        It holds neither positions nor angles.
    """
    bridged = np.zeros(len(read), dtype=bool)
    if "found" in read:
        bridged |= read["found"] == 0
    if "interpolated" in read:
        bridged |= read["interpolated"] == 1

    def channel(name: str, unit: str) -> Array:
        column = next((c for c in (f"{name}_raw_{unit}", f"{name}_{unit}") if c in read), None)
        return np.full(len(read), np.nan) if column is None else np.where(bridged, np.nan, read[column])

    position = np.column_stack([channel(axis, "m") for axis in "xyz"])
    turn = np.column_stack([channel(name, "rad") for name in ("roll", "pitch", "yaw")])
    if all(name in read for name in QUATERNION):
        q = np.column_stack([read[name] for name in QUATERNION])
        there = np.isfinite(q).all(axis=1) & (np.linalg.norm(q, axis=1) > 0.5) & ~bridged
        turn[:] = np.nan
        if there.any():
            turn[there] = np.column_stack(angles(rotations(q[there])))
    if not np.isfinite(position).any() and not np.isfinite(turn).any():
        text = "holds neither a position (x_m, y_m, z_m) nor an angle (roll_rad, pitch_rad, yaw_rad)"
        raise InputError(text, file=read.path, hint="tracks in pixels need a scale in their setup")
    _take_out(read, position, turn)
    measured = np.isfinite(turn)
    turn[measured[:, 2], 2] = np.unwrap(turn[measured[:, 2], 2])
    if not measured.any(axis=0).all():
        alone = 2 if measured[:, 2].any() else 1
        turn[:, np.arange(3) != alone] = np.nan
    return Poses(read.time_s, position, turn)


def _take_out(read: Log, position: Array, turn: Array) -> None:
    """Empty the samples of a dense track that repeat a picture or jump away from it."""
    # No tank is larger, m: a mark for "no sample".
    far = (np.abs(position) > 1e4).any(axis=1)
    position[far] = np.nan
    repeated, jumped = np.zeros_like(far), far
    seen = np.flatnonzero(np.isfinite(position).any(axis=0))
    # A track of fewer samples, or of samples farther apart, s, is too sparse to tell jumps from motion.
    if len(read) >= 40 and usual_step(read.time_s) <= 0.25 and len(seen) > 1:
        cleaning = tracks.clean(read.time_s, [position[:, k] for k in seen], list(turn.T))
        repeated, jumped = cleaning.repeated, far | cleaning.jumped
    out = repeated | jumped
    if out.any():
        position[out] = turn[out] = np.nan
        text = f"{int(repeated.sum())} repeated and {int(jumped.sum())} stray samples left out of the track"
        warn("SWM058", f"{read.path.name}: {text}")


# ---------------------------------------------------------------- dead reckoning


@njit(cache=True)
def _integrate(vectors, start):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Quaternions (x, y, z, w) after each turn of ``vectors`` about body axes."""
    n = len(vectors)
    q = np.empty((n + 1, 4))
    q[0] = start
    for k in range(n):
        x, y, z = vectors[k, 0], vectors[k, 1], vectors[k, 2]
        angle = np.sqrt(x * x + y * y + z * z)
        s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else np.sin(0.5 * angle) / angle
        c = np.cos(0.5 * angle)
        x, y, z = s * x, s * y, s * z
        a, b, g, w = q[k, 0], q[k, 1], q[k, 2], q[k, 3]
        q[k + 1, 0] = w * x + a * c + b * z - g * y
        q[k + 1, 1] = w * y - a * z + b * c + g * x
        q[k + 1, 2] = w * z + a * y - b * x + g * c
        q[k + 1, 3] = w * c - a * x - b * y - g * z
        q[k + 1] /= np.sqrt(np.sum(q[k + 1] ** 2))
    return q


def integrated_attitude(time_s: Array, rate: Array, start: Rotation) -> Rotation:
    """Attitude at every sample, from turn rates.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    rate : ndarray, shape (n, 3)
        In the sensor's axes, rad/s, free of bias.
    start : Rotation
        Sensor to world at the first sample.

    Notes
    -----
    Each step turns by the trapezoid of the rates plus the coning term ``(w0 x w1) dt^2 / 12`` (Bortz
    1971, doi:10.1109/TAES.1971.310252, for rates that change linearly).
    """
    dt = np.diff(time_s)[:, None]
    turn = 0.5 * (rate[1:] + rate[:-1]) * dt + np.cross(rate[:-1], rate[1:]) * dt**2 / 12
    return Rotation.from_quat(_integrate(turn, start.as_quat()))


def integral(time_s: Array, values: Array, start: Any = 0.0) -> Array:
    """Trapezoidal integral of every column from the first sample on, shape (n, d).

    Shang et al. (2012), Eqs 12 and 13, with the samples' own steps.
    """
    return np.asarray(cumulative_trapezoid(values, time_s, axis=0, initial=0)) + start
