"""What is known of a recording before its motion is reckoned: sensor, rests, noise, mounting, attitude."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation, Slerp

from swimid.errors import InputError, extra_needed
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import GRAVITY_M_S2, Array, Finding, Record, level, resampled, rotations
from swimid.logs.log import runs
from swimid.logs.rotation import from_angles

MILLI_G = 1e-3 * GRAVITY_M_S2
DEG = np.pi / 180
#: Standard deviations in half a 95 % band.
BAND = 1.96


@dataclass(frozen=True)
class Sensor:
    """Error figures of an inertial unit; the defaults are those of the 3DM-GX1's class."""

    #: White noise densities, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz); None: from still periods, or where there are
    #: none 0.4 mg/sqrt(Hz) and 3.5 deg/sqrt(h) (MicroStrain 3DM-GX1 data sheet; Shang et al. 2012, Table I).
    acceleration_noise: float | None = None
    rate_noise: float | None = None
    #: Of a bias nobody has measured, m/s^2 and rad/s: 10 mg and 1 deg/s.
    acceleration_bias_sd: float = 10 * MILLI_G
    rate_bias_sd: float = 1.0 * DEG
    #: What a bias changes by in 100 s, m/s^2 and rad/s: 0.2 mg ("short-term stability", Table I of Shang et
    #: al.) and 0.02 deg/s.
    acceleration_drift: float = 0.2 * MILLI_G
    rate_drift: float = 0.02 * DEG
    #: Error of scale and alignment of both sensors, 0.5 %.
    scale_sd: float = 0.005
    #: What a scale changes by with the reading itself (nonlinearity), both sensors, 0.2 %.
    bending_sd: float = 0.002
    #: Of attitudes in the log, or of the filter's, rad; None: 2 deg (Table I) and 1 deg.
    attitude_sd: float | None = None

    @classmethod
    def of(cls, options: TrackImuOptions) -> Sensor:
        """The error figures as the options state them."""
        attitude_deg = options.attitude_sd_deg
        return cls(
            options.accel_noise,
            options.gyro_noise,
            options.accel_bias_mg * MILLI_G,
            options.gyro_bias_deg_s * DEG,
            attitude_sd=None if attitude_deg is None else attitude_deg * DEG,
        )

    def classes(self) -> dict[str, Sensor]:
        """The same with the errors of other classes of sensor where nothing is stated, by name."""
        usual = Sensor()

        def of(errors: dict[str, float]) -> Sensor:
            return replace(self, **{k: v for k, v in errors.items() if getattr(self, k) == getattr(usual, k)})

        warming = "biases of 30 mg that change by 1.7 mg and 0.5 deg/s in 100 s"
        return {
            "a consumer's chip (biases of 30 mg, scales off by 1.5 %)": of(CHIP),
            f"a consumer's chip that warms up ({warming})": of(CHIP | WARMING),
        }


#: Errors of chips as they are soldered: limits of their data sheets over sqrt(3), as of what is even within.
#: InvenSense MPU-6050 (PS-MPU-6000A rev. 3.4, sec. 6.1 and 6.2: +-50 mg, +-20 deg/s, scale +-3 %, cross-axis
#: +-2 %), ICM-20948 (DS-000189: +-50 mg on a board, +-5 deg/s, +-1.5 %), Bosch BMI160 (+-40 mg, +-3 deg/s),
#: ST LSM6DSO (+-20 mg, +-1 deg/s, +-1 %). Once warm, their biases are as steady as those of better units.
CHIP: dict[str, float] = {"acceleration_bias_sd": 30 * MILLI_G, "rate_bias_sd": 5.0 * DEG, "scale_sd": 0.015}
#: What their biases change by in 100 s while they warm: ten degrees in five minutes, at 0.5 mg and 0.16 deg/s
#: for each (MPU-6050: +-35 mg over 70 degrees, +-20 deg/s over 125).
WARMING: dict[str, float] = {"acceleration_drift": 1.7 * MILLI_G, "rate_drift": 0.5 * DEG}
#: Deviation of an attitude: the sensor's own, the filter's (rad).
QUATERNION_SD, FILTER_SD = 2.0 * DEG, 1.0 * DEG
#: How long an error of such an attitude lasts at least, s: so many seconds count as one measurement.
QUATERNION_MEMORY_S, FILTER_MEMORY_S = 10.0, 20.0
#: Time after which the drift of a bias is given, s.
DRIFT_TIME_S = 100.0


# ---------------------------------------------------------------- still stretches


#: Length over which motion is judged, s, and the shortest rest, s.
WINDOW_S, SHORTEST_S = 0.5, 1.0
#: A window is still when its deviations are at most this many times those.
NOISE_RATIO = 2.0
#: No sensor at rest deviates by more: m/s^2 and rad/s.
MOST_ACCELERATION, MOST_RATE = 0.25, 0.05


@dataclass(frozen=True)
class Rest:
    """One still stretch, rows ``first`` to ``last`` (not included); ``at`` is "start", "end" or "between"."""

    first: int
    last: int
    at: str

    @property
    def rows(self) -> slice:
        """Its rows."""
        return slice(self.first, self.last)


def find_rests(record: Record) -> list[Rest]:
    """Still stretches of a record.

    A window is still when the deviation of accelerations and rates, and the mean rate against that of such
    windows, are within those of the least moving 5 % of the record, and these are no motion.

    Notes
    -----
    The detector of Skog et al. (2010, doi:10.1109/TBME.2010.2060723, SHOE) with its threshold taken
    from the record. A body that glides without turning looks still to any inertial sensor.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    if len(record) < 3 * size:
        return []
    deviation_a, deviation_w = _deviation(record.acceleration, size), _deviation(record.rate, size)
    # The share of a record with the least deviations, which serves as its noise.
    floor_a, floor_w = (max(float(np.quantile(d, 0.05)), 1e-9) for d in (deviation_a, deviation_w))
    if floor_a > MOST_ACCELERATION or floor_w > MOST_RATE:
        return []
    # Least motion that is motion, however small the sensor's noise: m/s^2 and rad/s.
    limit_a, limit_w = max(NOISE_RATIO * floor_a, 0.03), max(NOISE_RATIO * floor_w, 0.01)
    steady = (deviation_a <= limit_a) & (deviation_w <= limit_w)
    if not steady.any():
        return []
    mean_w = _moving_mean(record.rate, size)
    off = np.linalg.norm(mean_w - np.median(mean_w[steady], axis=0), axis=1)
    rests = []
    for first, last in runs(steady & (off <= limit_w)).tolist():
        # a window reaches beyond its middle: its outer halves may already move
        begin = first if first == 0 else first + size // 2
        end = last if last == len(record) else last - size // 2
        if end - begin >= 4 and record.time_s[end - 1] - record.time_s[begin] >= SHORTEST_S:
            rests.append(_rest(record, begin, end))
    return rests


def mean_accelerations(record: Record, rests: list[Rest]) -> Array:
    """Of every still stretch, shape (stretches, 3); of everything where there are none."""
    parts = [record.acceleration[r.rows] for r in rests] or [record.acceleration]
    return np.array([part.mean(axis=0) for part in parts])


def _declared(record: Record, windows: Sequence[tuple[float, float]]) -> list[Rest]:
    """The stretches a user named by their times, s.

    Raises
    ------
    InputError
        The sensor turns in one of them as no gyroscope at rest shows it.
    """
    rests = []
    for start, end in windows:
        first, last = (int(row) for row in np.searchsorted(record.time_s, [start, end]))
        if last - first < 4:
            continue
        turning = float(np.mean(np.linalg.norm(record.rate[first:last], axis=1)))
        # No gyroscope at rest shows more than this on average: 20 deg/s on each axis (InvenSense MPU-6050),
        # rad/s.
        if turning > (20 * np.sqrt(3) * np.pi / 180):
            text = f"turns at {turning:.1f} rad/s from {start:g} to {end:g} s, which is named as a rest"
            hint = "name a stretch in which the robot rests, or leave --still out"
            raise InputError(text, file=record.name, hint=hint)
        rests.append(_rest(record, first, last))
    return rests


def _rest(record: Record, first: int, last: int) -> Rest:
    edge = 0.02 * len(record)
    return Rest(first, last, "start" if first <= edge else "end" if last >= len(record) - edge else "between")


@dataclass(frozen=True)
class Noise:
    """White noise of the sensor."""

    #: Density, m/s^2/sqrt(Hz).
    acceleration: float
    #: Density, rad/s/sqrt(Hz).
    rate: float
    #: "still periods", "given" or "data sheet".
    source: str


def noise_of(record: Record, rests: list[Rest]) -> Noise | None:
    """White noise densities from still stretches, all axes together."""
    if not rests:
        return None
    parts_a = np.vstack([np.diff(record.acceleration[r.rows], axis=0) for r in rests])
    parts_w = np.vstack([np.diff(record.rate[r.rows], axis=0) for r in rests])
    scale = np.sqrt(record.step_s / 2)
    return Noise(
        scale * float(np.sqrt(np.mean(parts_a**2))),
        scale * float(np.sqrt(np.mean(parts_w**2))),
        "still periods",
    )


def _moving_mean(values: Array, size: int) -> Array:
    return np.asarray(uniform_filter1d(values, size, axis=0, mode="nearest"))


def _deviation(values: Array, size: int) -> Array:
    """Deviation within a window about each sample, all axes together, shape (n,)."""
    centred = values - values.mean(axis=0)
    spread = _moving_mean(centred**2, size) - _moving_mean(centred, size) ** 2
    return np.sqrt(np.maximum(spread.sum(axis=1), 0.0))


# ---------------------------------------------------------------- mounting and attitude


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
    record: Record, rests: list[Rest], mount_deg: tuple[float, float, float] | None, *, level_at_rest: bool
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
    seen = mean_accelerations(record, rests)
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
    named = _declared(record, options.still)
    free = [r for r in find_rests(record) if not any(r.first < d.last and d.first < r.last for d in named)]
    used = sorted([*named, *(r for r in free if r.at in BELIEVED[options.rests])], key=lambda r: r.first)
    still = sorted([*named, *free], key=lambda r: r.first)
    base = noise_of(record, still) or DATA_SHEET
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
