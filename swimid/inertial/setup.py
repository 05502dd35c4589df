"""What is known of a recording before its motion is reckoned: rests, noise, mounting and a first attitude."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from swimid.errors import InputError, extra_needed
from swimid.inertial import rest
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import Array, Finding, Record, level, resampled, rotations
from swimid.inertial.rest import Noise, Rest
from swimid.inertial.sensor import DEG, FILTER_SD, MILLI_G, QUATERNION_SD, Sensor
from swimid.logs.rotation import from_angles

#: An attitude that the log itself brings.
QUATERNIONS = "quaternion columns"
#: Noise where nothing tells it.
DATA_SHEET = Noise(0.4 * MILLI_G, 3.5 * DEG / 60.0, "data sheet")
#: Within this angle of the z axis gravity is where it should be; farther off the sensor lies on its side.
UPRIGHT = 45 * DEG
#: Where found rests lie that count as rests of the body and not only of its noise, by ``--rest``.
BELIEVED = {"ends": ("start", "end"), "all": ("start", "between", "end"), "none": ()}


@dataclass(frozen=True)
class Source:
    """An attitude at every sample."""

    #: Sensor to world, n of them.
    rotation: Rotation
    #: Whether its yaw is held by something (a compass, the sensor's own filter).
    heading: bool
    #: "quaternion columns", "gyroscope and accelerometer", "gyroscope, accelerometer and magnetometer".
    kind: str


@dataclass(frozen=True)
class Stillness:
    """Still stretches, which of them are rests, and the noise they tell."""

    stretches: list[Rest]
    rests: list[Rest]
    noise: Noise

    def without(self, rests: list[Rest]) -> Stillness:
        """The same less some rests, which tell nothing then."""
        stretches, left = ([r for r in some if r not in rests] for some in (self.stretches, self.rests))
        return replace(self, stretches=stretches, rests=left)


@dataclass(frozen=True)
class Mount:
    """Body to sensor, how it is known, and gravity in the sensor at rest (unit vector)."""

    rotation: Rotation
    by: str
    up: Array


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A record, and what is known of it."""

    record: Record
    options: TrackImuOptions
    #: As stated.
    sensor: Sensor
    still: Stillness
    mount: Mount
    #: Attitude before smoothing.
    source: Source
    #: Called after each smoothing.
    advance: Callable[[], Any] = lambda: None

    @property
    def attitude_sd(self) -> float:
        """Deviation of the attitude before smoothing, rad."""
        usual = QUATERNION_SD if self.source.kind == QUATERNIONS else FILTER_SD
        return self.sensor.attitude_sd or usual

    @property
    def still_rate(self) -> Array:
        """Turn rate of the sensor in its still stretches, rad/s, shape (3,)."""
        return _still_rate(self.record, self.still.stretches)

    @property
    def body(self) -> Record:
        """The record in the body's axes, as far as gravity or the user tells the mounting."""
        turn = self.mount.rotation.inv()
        return replace(
            self.record, acceleration=turn.apply(self.record.acceleration), rate=turn.apply(self.record.rate)
        )

    @property
    def attitude(self) -> Rotation:
        """Body to world before smoothing, n of them."""
        return self.source.rotation * self.mount.rotation

    def lever(self, mount: Rotation) -> Array:
        """From the sensor to the reference point, sensor axes, m, shape (3,); ``mount``: body to sensor."""
        place = self.options.lever_m
        return np.zeros(3) if place is None else np.asarray(mount.apply(-np.asarray(place)))

    def without(self, rests: list[Rest]) -> Self:
        """The same less some rests, with the attitude a filter makes then."""
        still, source = self.still.without(rests), self.source
        if source.kind != QUATERNIONS:
            source = _attitude(self.record, still.stretches)
        return replace(self, still=still, source=source)


def prepare(record: Record, options: TrackImuOptions) -> tuple[Setup, list[Finding]]:
    """Rests, mounting and attitude of a record, and what was found of its mounting."""
    sensor = Sensor.of(options)
    still = _stillness(record, sensor, options)
    mount, findings = settle_mount(
        record, still.stretches, options.mount_deg, level_at_rest=options.level_at_rest
    )
    source = _attitude(record, still.stretches)
    known = Setup(record=record, options=options, sensor=sensor, still=still, mount=mount, source=source)
    return known, findings


def settle_mount(
    record: Record,
    rests: list[Rest],
    mount_deg: tuple[float, float, float] | None,
    *,
    level_at_rest: bool,
) -> tuple[Mount, list[Finding]]:
    """Body to sensor before any other log is looked at.

    Quaternion columns turn the body to the world, so that with them the sensor's axes are the body's. A body
    that came to rest lying otherwise than it began tells nothing of its mounting there: then the first rest
    does.

    Raises
    ------
    InputError
        When gravity points down the z axis: an accelerometer with the wrong sign, or upside down.
    """
    seen = rest.mean_accelerations(record, rests)
    seen = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    up = seen[0] if np.min(seen @ seen[0]) < np.cos(UPRIGHT) else seen.mean(axis=0)
    up = up / np.linalg.norm(up)
    if mount_deg is not None:
        roll, pitch, yaw = (np.array([angle * DEG]) for angle in mount_deg)
        return Mount(from_angles(roll, pitch, yaw)[0].inv(), "given", up), []
    if record.quaternion is not None:
        return Mount(Rotation.identity(), "quaternions", up), []
    if float(np.arccos(np.clip(up[2], -1, 1))) <= UPRIGHT:
        if level_at_rest:
            return Mount(level(up).inv(), "level at rest", up), []
        return Mount(Rotation.identity(), "as the sensor's axes", up), []
    axis = int(np.argmax(np.abs(up)))
    nearest = np.sign(up[axis]) * np.eye(3)[axis]
    name = f"{'-' if up[axis] < 0 else '+'}{'xyz'[axis]}"
    if name == "-z":
        raise InputError(
            "gravity points the wrong way at rest: az is negative where a sensor with z up shows +9.81",
            file=record.name,
            column="az_m_s2",
            hint="for an accelerometer of the other sign give factor -1 for all three axes in a mapping "
            "(--map); for a sensor mounted upside down give --mount-deg 180 0 0",
        )
    text = (
        f"gravity lies along the sensor's {name} axis, not +z: the sensor is taken as turned by the smallest "
        "turn that puts this axis up; give --mount-deg if the body's forward axis comes out wrong"
    )
    rotation = level(up if level_at_rest else nearest).inv()
    return Mount(rotation, f"{name} axis up", up), [Finding("gravity axis", "handled", text)]


def _stillness(record: Record, sensor: Sensor, options: TrackImuOptions) -> Stillness:
    """Find still stretches and decide which are rests."""
    named = rest.declared(record, options.still)
    free = [r for r in rest.find(record) if not any(r.first < d.last and d.first < r.last for d in named)]
    used = sorted([*named, *(r for r in free if r.at in BELIEVED[options.rests])], key=lambda r: r.first)
    still = sorted([*named, *free], key=lambda r: r.first)
    base = rest.noise(record, still) or DATA_SHEET
    given = sensor.acceleration_noise is not None or sensor.rate_noise is not None
    noise = Noise(
        base.acceleration if sensor.acceleration_noise is None else sensor.acceleration_noise,
        base.rate if sensor.rate_noise is None else sensor.rate_noise,
        "given" if given else base.source,
    )
    return Stillness(still, used, noise)


def _attitude(record: Record, rests: list[Rest]) -> Source:
    """The attitude to start from.

    Quaternion columns are taken as they are. Without them the offline form of VQF (Laidig and Seel
    2023, doi:10.1016/j.inffus.2022.10.014), which runs forwards and backwards, makes it from turn rates,
    accelerations and, where there is one, the magnetic field; the yaw of the first sample is then 0,
    or magnetic where there is a field.
    """
    if record.quaternion is not None:
        return Source(rotations(record.quaternion), True, QUATERNIONS)
    with extra_needed("an attitude from turn rates and accelerations", "imu"):
        import vqf

    t, step = record.time_s, record.step_s
    even = bool(np.ptp(np.diff(t)) < 1e-3 * step)
    grid = t if even else np.arange(t[0], t[-1] + step, step)
    readings = [record.rate - _still_rate(record, rests), record.acceleration, record.magnetic]
    if not even:
        readings = [None if values is None else resampled(grid, t, values) for values in readings]
    told = vqf.offlineVQF(*(None if v is None else np.ascontiguousarray(v) for v in readings), step)
    rotation = rotations(np.asarray(told["quat6D" if record.magnetic is None else "quat9D"]))
    if not even:
        rotation = Slerp(grid, rotation)(np.clip(t, grid[0], grid[-1]))
    if record.magnetic is None:
        yaw = rotation[0].as_euler("ZYX")[0]
        return Source(Rotation.from_rotvec([0.0, 0.0, -yaw]) * rotation, False, "gyroscope and accelerometer")
    # VQF's world is east-north-up; yaw is counted from x, which is east
    return Source(rotation, True, "gyroscope, accelerometer and magnetometer")


def _still_rate(record: Record, rests: list[Rest]) -> Array:
    """Turn rate of the still stretches, the median of their means, shape (3,); 0 where there are none."""
    if not rests:
        return np.zeros(3)
    return np.asarray(np.median([record.rate[r.rows].mean(axis=0) for r in rests], axis=0))
