"""A rigid body that moves and rests, its inertial unit and a camera, sampled analytically.

Nothing here is swimid's. Position and angles are closed functions of an inner time, and the inner time is
a closed function of the clock that stops for every rest; sensor readings follow by the chain rule, so that
nothing is differentiated or integrated numerically. World z up, body forward, port, up; the attitude is
``Rz(yaw) Ry(dip) Rx(roll)`` with right-handed turns (a positive dip points the nose down).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from tests.generators import imu

G = 9.80665
MG = 1e-3 * G
DEG = np.pi / 180
#: Harmonics: columns amplitude, angular frequency, phase.
Waves = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Unit:
    """What is wrong with an inertial unit; deviations of each axis.

    The defaults are those of a unit calibrated by its maker; :data:`CHEAP` is a chip as it leaves the reel.
    """

    acceleration_noise: float = 0.2 * MG  # per square root of Hz
    rate_noise: float = 0.01 * DEG
    acceleration_bias: float = 5 * MG
    rate_bias: float = 0.3 * DEG
    acceleration_scale: float = 0.003
    rate_scale: float = 0.003
    cross: float = 0.002  # of one axis into another, both sensors
    rate_drift: float = 0.01 * DEG  # over 100 s
    acceleration_drift: float = 0.1 * MG


#: After the data sheets of common chips (InvenSense MPU-6050 and ICM-20948, Bosch BMI160, ST LSM6DSO): limits
#: of 20 to 80 mg and 1 to 20 deg/s, 0.5 to 3 % of scale and 1 to 2 % across axes, taken as two deviations of
#: the middle of each range; the gyroscope's bias as what is left after it was zeroed at power-up.
CHEAP = Unit(0.3 * MG, 0.01 * DEG, 20 * MG, 0.5 * DEG, 0.007, 0.008, 0.006, 0.03 * DEG, 0.5 * MG)
#: A chip at the limits of the poorest of these sheets.
POOR = replace(CHEAP, rate_scale=0.02, cross=0.01, acceleration_bias=40 * MG, acceleration_scale=0.015)
PERFECT = Unit(0.02 * MG, 0.001 * DEG, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Motion:
    """Speeds and waves in the inner time; angles, rad, and places, m.

    ``turning``: mean yaw rate, rad/s. ``circle_m``: radius of the circle that is swum as the body turns.
    """

    speed_m_s: float = 0.0
    turning: float = 0.0
    circle_m: float = 0.0
    along: Waves = ()
    across: Waves = ()
    up: Waves = ()
    roll: Waves = ()
    dip: Waves = ()
    yaw: Waves = ()


@dataclass(frozen=True)
class Run:
    """Truth and readings; ``attitude`` holds matrices, body to world; ``resting`` the rows at rest."""

    time_s: np.ndarray
    acceleration: np.ndarray
    rate: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray
    resting: np.ndarray
    pose: object = field(repr=False)

    def columns(self) -> dict[str, np.ndarray]:
        """The columns of its log."""
        names = ("ax_m_s2", "ay_m_s2", "az_m_s2", "wx_rad_s", "wy_rad_s", "wz_rad_s")
        values = np.hstack([self.acceleration, self.rate]).T
        return {"t_s": self.time_s, **dict(zip(names, values, strict=True))}


def run(
    rng: np.random.Generator,
    motion: Motion,
    goes: list[tuple[float, float]],
    end_s: float,
    *,
    unit: Unit | None = None,
    rate_hz: float = 100.0,
    ease_s: float = 1.0,
    glides: tuple[tuple[float, float], ...] = (),
) -> Run:
    """Move from each first to each second time of ``goes``, s, and rest otherwise.

    Of ``glides``, time and speed, each adds from then on that speed along the world's x.
    """
    unit = unit or Unit()

    def pose(t: np.ndarray) -> tuple[np.ndarray, ...]:
        tau, pace, gain = _inner(t, goes, ease_s)
        p0, p1, p2 = _place(motion, tau)
        position = p0
        velocity = p1 * pace[:, None]
        acceleration = p2 * pace[:, None] ** 2 + p1 * gain[:, None]
        for begin, speed in glides:
            x = np.clip((t - begin) / ease_s, 0, 1)
            way = x**6 - 3 * x**5 + 2.5 * x**4 + np.maximum((t - begin) / ease_s - 1, 0)
            position[:, 0] += speed * ease_s * way
            velocity[:, 0] += speed * (6 * x**5 - 15 * x**4 + 10 * x**3)
            acceleration[:, 0] += speed / ease_s * (30 * x**4 - 60 * x**3 + 30 * x**2)
        angles = [_waves(w, tau) for w in (motion.roll, motion.dip, motion.yaw)]
        roll, dip = angles[0][0], angles[1][0]
        yaw = motion.turning * tau + angles[2][0]
        d_roll, d_dip = angles[0][1] * pace, angles[1][1] * pace
        d_yaw = (motion.turning + angles[2][1]) * pace
        turn = imu.cosines(roll, dip, yaw)
        # Euler's kinematics of Rz Ry Rx
        rate = np.column_stack(
            [
                d_roll - d_yaw * np.sin(dip),
                d_dip * np.cos(roll) + d_yaw * np.sin(roll) * np.cos(dip),
                -d_dip * np.sin(roll) + d_yaw * np.cos(roll) * np.cos(dip),
            ]
        )
        force = np.einsum("nji,nj->ni", turn, acceleration + np.array([0.0, 0.0, G]))
        return position, velocity, turn, rate, force, pace, yaw

    time = np.arange(0.0, end_s, 1 / rate_hz)
    position, velocity, turn, rate, force, pace, _ = pose(time)
    step = 1 / rate_hz

    def seen(true: np.ndarray, scale: float, bias: float, drift: float, noise: float) -> np.ndarray:
        wrong = np.eye(3) + np.diag(rng.normal(0, scale, 3))
        wrong += rng.normal(0, unit.cross, (3, 3)) * (1 - np.eye(3))
        walk = np.cumsum(rng.normal(0, drift * np.sqrt(step / 100), true.shape), axis=0)
        white = rng.normal(0, noise / np.sqrt(step), true.shape)
        return true @ wrong.T + rng.normal(0, bias, 3) + walk + white

    readings_a = seen(
        force,
        unit.acceleration_scale,
        unit.acceleration_bias,
        unit.acceleration_drift,
        unit.acceleration_noise,
    )
    readings_w = seen(rate, unit.rate_scale, unit.rate_bias, unit.rate_drift, unit.rate_noise)
    return Run(time, readings_a, readings_w, position, velocity, turn, pace == 0, pose)


def camera(
    run: Run,
    rng: np.random.Generator,
    *,
    late_s: float = 0.0,
    rate_hz: float = 30.0,
    position_sd: float = 0.001,
    yaw_sd: float | None = None,
    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    depth: bool = False,
) -> dict[str, np.ndarray]:
    """A camera above; its clock shows ``late_s`` less than the unit's.

    It follows the point at ``lever_m`` in body axes from the unit; ``yaw_sd`` gives it a heading.
    """
    true = np.arange(run.time_s[0] + 0.02, run.time_s[-1] - 0.02, 1 / rate_hz)
    position, _, turn, _, _, _, yaw = run.pose(true)  # type: ignore[operator]
    place = position + turn @ np.array(lever_m)
    out = {"t_s": true - late_s}
    for k, name in enumerate(("x_m", "y_m", "z_m")[: 3 if depth else 2]):
        out[name] = place[:, k] + rng.normal(0, position_sd, len(true))
    if yaw_sd is not None:
        out["yaw_rad"] = yaw + rng.normal(0, yaw_sd, len(true))
    return out


def fast_turning(
    rng: np.random.Generator,
    *,
    unit: Unit = CHEAP,
    turning: float = 4.0,
    turn_s: float = 60.0,
    rest_s: float = 4.0,
    shake_m: float = 0.05,
    **more: float,
) -> Run:
    """A rest, fast turning about every axis, and a rest."""
    motion = Motion(
        turning=turning,
        along=((shake_m, 5.1, 0.3), (0.1, 0.7, 0.0)),
        across=((shake_m, 4.3, 1.0), (0.1, 0.5, 0.4)),
        up=((0.5 * shake_m, 6.0, 2.0),),
        roll=((0.6, 2.3, 0.0), (0.2, 5.9, 1.0)),
        dip=((0.5, 1.9, 0.5), (0.2, 5.2, 0.0)),
        yaw=((0.5, 2.9, 0.0),),
    )
    return run(rng, motion, [(rest_s, rest_s + turn_s)], turn_s + 2 * rest_s, unit=unit, **more)  # type: ignore[arg-type]


def tumbling(rng: np.random.Generator, *, unit: Unit = CHEAP, pace: float = 1.0, turn_s: float = 60.0) -> Run:
    """A rest, a tumble about every axis (13 rad/s at pace 1), and a rest lying on the side."""
    motion = Motion(
        turning=2 * pace,
        along=((0.06, 5.1, 0.3), (0.15, 2.7, 0.0)),
        across=((0.06, 4.3, 1.0), (0.15, 2.5, 0.4)),
        up=((0.05, 6.0, 2.0),),
        roll=((2.5, 2.3 * pace, 0.0), (0.4, 5.9 * pace, 1.0)),
        dip=((0.9, 1.9 * pace, 0.5), (0.3, 5.2 * pace, 0.0)),
        yaw=((1.5, 2.9 * pace, 0.0),),
    )
    return run(rng, motion, [(4.0, 4.0 + turn_s)], turn_s + 8.0, unit=unit)


def stop_and_go(
    rng: np.random.Generator,
    *,
    unit: Unit = CHEAP,
    legs: int = 4,
    leg_s: float = 8.0,
    rest_s: float = 4.0,
    **more: float,
) -> Run:
    """Legs of swimming on a circle, with rests before, between and after."""
    motion = Motion(
        turning=0.25,
        circle_m=1.2,
        along=((0.01, 15.0, 0.3),),
        across=((0.004, 7.5, 0.0),),
        roll=((0.06, 7.5, 0.5),),
        dip=((0.04, 15.0, 0.2),),
        yaw=((0.08, 7.5, 1.0),),
    )
    goes = [(rest_s + k * (leg_s + rest_s), rest_s + k * (leg_s + rest_s) + leg_s) for k in range(legs)]
    return run(rng, motion, goes, goes[-1][1] + rest_s, unit=unit, **more)  # type: ignore[arg-type]


def swim(
    rng: np.random.Generator,
    *,
    unit: Unit = CHEAP,
    swim_s: float = 33.0,
    rest_s: float = 4.0,
    frequency_hz: float = 1.2,
    **more: float,
) -> Run:
    """A rest, a swim on a wide circle with the beat of a tail, and a rest."""
    beat = 2 * np.pi * frequency_hz
    motion = Motion(
        turning=0.2,
        circle_m=1.5,
        along=((0.004, 2 * beat, 0.3),),
        across=((0.006, beat, 0.0),),
        up=((0.002, beat, 0.7),),
        roll=((0.05, beat, 0.5),),
        dip=((0.03, 2 * beat, 0.2),),
        yaw=((0.07, beat, 1.0),),
    )
    return run(rng, motion, [(rest_s, rest_s + swim_s)], swim_s + 2 * rest_s, unit=unit, **more)  # type: ignore[arg-type]


# ---------------------------------------------------------------- closed functions


def _inner(t: np.ndarray, goes: list[tuple[float, float]], ease: float) -> tuple[np.ndarray, ...]:
    """Inner time, its pace and its gain of pace: a quintic step from rest to pace 1 and back."""
    tau, pace, gain = (np.zeros_like(t) for _ in range(3))
    for first, last in goes:
        for start, sign in ((first, 1.0), (last - ease, -1.0)):
            x = (t - start) / ease
            c = np.clip(x, 0, 1)
            tau += sign * ease * (c**6 - 3 * c**5 + 2.5 * c**4 + np.maximum(x - 1, 0))
            pace += sign * (6 * c**5 - 15 * c**4 + 10 * c**3)
            gain += sign / ease * (30 * c**4 - 60 * c**3 + 30 * c**2)
    return tau, np.where(np.abs(pace) < 1e-12, 0.0, pace), gain


def _waves(waves: Waves, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    value, first, second = (np.zeros_like(tau) for _ in range(3))
    for size, omega, phase in waves:
        value += size * np.sin(omega * tau + phase)
        first += size * omega * np.cos(omega * tau + phase)
        second -= size * omega**2 * np.sin(omega * tau + phase)
    return value, first, second


def _place(m: Motion, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place and its two derivatives by the inner time, shape (n, 3) each."""
    parts = [list(p) for p in zip(*(_waves(w, tau) for w in (m.along, m.across, m.up)), strict=True)]
    parts[0][0] = parts[0][0] + m.speed_m_s * tau
    parts[1][0] = parts[1][0] + m.speed_m_s
    angle, w, r = m.turning * tau, m.turning, m.circle_m
    circle = (
        (r * np.sin(angle), -r * np.cos(angle)),
        (r * w * np.cos(angle), r * w * np.sin(angle)),
        (-r * w**2 * np.sin(angle), r * w**2 * np.cos(angle)),
    )
    for order in range(3):
        for axis in range(2):
            parts[order][axis] = parts[order][axis] + circle[order][axis]
    place, first, second = (np.column_stack(p) for p in parts)
    return place, first, second
