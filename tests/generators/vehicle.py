"""Logs of vehicles with thrusters, from Fossen's equations in axes with z down.

The equations are ``M v' + C(v) v + D(v) v + g(euler) = tau`` with Euler angles, integrated by SciPy's DOP853.
Nothing of swimid is used. The log has x forward, y to port and z up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.generators import files

Array = NDArray[np.float64]
S = np.sqrt(0.5)
#: Position (m) and direction of each thruster, with z down.
PLACES = np.array(
    [
        (0.156, 0.111, 0.085), (0.156, -0.111, 0.085), (-0.156, 0.111, 0.085), (-0.156, -0.111, 0.085),
        (0.12, 0.218, 0.0), (0.12, -0.218, 0.0), (-0.12, 0.218, 0.0), (-0.12, -0.218, 0.0),
    ]
)  # fmt: skip
DIRECTIONS = np.array(
    [(S, -S, 0), (S, S, 0), (-S, -S, 0), (-S, S, 0), (0, 0, -1), (0, 0, 1), (0, 0, 1), (0, 0, -1)]
)
#: Forces and moments of the thrusters along the axes of the body, with z down, shape (6, thrusters).
MIXING = np.vstack([DIRECTIONS.T, np.cross(PLACES, DIRECTIONS).T])


@dataclass(frozen=True)
class Vehicle:
    """Constants of a vehicle. All vectors are along the axes of the body, with z down."""

    robot: str = "bluerov2"
    gravity: float = 9.82
    density: float = 1000.0
    mass_kg: float = 13.5
    volume_m3: float = 0.0134
    inertia: tuple[float, float, float] = (0.26, 0.23, 0.37)
    added: tuple[float, ...] = (6.36, 7.12, 18.68, 0.189, 0.135, 0.222)
    linear: tuple[float, ...] = (13.7, 0.0, 33.0, 0.0, 0.8, 0.0)
    quadratic: tuple[float, ...] = (141.0, 217.0, 190.0, 1.19, 0.47, 1.5)
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    buoyancy_m: tuple[float, float, float] = (0.0, 0.0, -0.01)
    mixing: Array = field(default_factory=lambda: MIXING)
    #: Columns of the log with the thrusts.
    inputs: tuple[str, ...] = tuple(f"thrust{k + 1}_N" for k in range(8))
    #: Factor on the thrust of each thruster.
    thrust: tuple[float, ...] = field(default=(1.0,) * 8)
    #: Velocity of the water in the world, with y to starboard and z down.
    current_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: Time constant of the thrusters.
    lag_s: float = 0.0
    #: Slope k_1 of the thrust coefficient ``K_T = K_0 - k_1 J`` with the advance ratio J of the propellers.
    slope: float = 0.0
    #: Largest forces (N) and moments (N m) of a manoeuvre along the axes of the body.
    effort: tuple[float, ...] = (25.0, 25.0, 25.0, 1.5, 1.5, 4.0)


#: An indoor blimp: the origin is at its centre of buoyancy, the propellers are in a gondola 0.295 m below it.
BLIMP = Vehicle(
    robot="blimp",
    gravity=9.8,
    density=1.161,
    mass_kg=0.1249,
    volume_m3=0.10758,
    inertia=(0.005821,) * 3,
    added=(0.0466, 0.0466, 0.0545, 0.0, 0.0, 0.0),
    linear=(0.0125, 0.0125, 0.048, 0.000862, 0.000862, 0.000862),
    quadratic=(0.0,) * 6,
    com_m=(0.0, 0.0, 0.09705),
    buoyancy_m=(0.0, 0.0, 0.0),
    # the log has y to port and z up
    mixing=np.array(
        [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0.295, 0, 0], [0.295, 0, 0, 0], [0, 0, 0, -1]]
    ),
    inputs=("force_x_N", "force_y_N", "force_z_N", "moment_z_N_m"),
    thrust=(1.0,) * 4,
    effort=(0.01, 0.01, 0.01, 0.0, 0.0, 0.002),
)


def _cross(v: Array) -> Array:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _turn(euler: Array) -> Array:
    (f, t, p) = euler
    cf, sf, ct, st, cp, sp = np.cos(f), np.sin(f), np.cos(t), np.sin(t), np.cos(p), np.sin(p)
    return np.array(
        [
            [cp * ct, cp * st * sf - sp * cf, sp * sf + cp * cf * st],
            [sp * ct, cp * cf + sf * st * sp, st * sp * cf - cp * sf],
            [-st, ct * sf, ct * cf],
        ]
    )


#: Diameter of the propellers, m, and their thrust coefficient at rest.
DIAMETER_M, K_0 = 0.076, 0.45


def advancing(bollard: Array, advance: Array, density: float, slope: float) -> Array:
    """Return the thrusts of propellers at a speed of advance (m/s) from their thrusts at rest (N).

    The rate of each propeller follows from its thrust at rest, and the thrust from ``K_T = K_0 - slope J``.
    """
    found = np.zeros(len(bollard))
    for k, (rest, speed) in enumerate(zip(bollard, advance, strict=True)):
        if rest == 0.0:
            continue
        rate = np.sign(rest) * np.sqrt(abs(rest) / (density * DIAMETER_M**4 * K_0))
        ratio = speed / (rate * DIAMETER_M)
        found[k] = density * rate * abs(rate) * DIAMETER_M**4 * (K_0 - slope * ratio)
    return found


def simulate(
    vehicle: Vehicle, time_s: Array, thrusts: Callable[[float], Array], start: Array | None = None
) -> Array:
    """Return pose (x, y, z, roll, pitch, yaw) and velocity over the ground, shape (n, 12), with z down."""
    com = np.array(vehicle.com_m)
    rigid = np.zeros((6, 6))
    rigid[:3, :3] = vehicle.mass_kg * np.eye(3)
    rigid[:3, 3:] = -vehicle.mass_kg * _cross(com)
    rigid[3:, :3] = vehicle.mass_kg * _cross(com)
    rigid[3:, 3:] = np.diag(vehicle.inertia) - vehicle.mass_kg * _cross(com) @ _cross(com)
    mass = rigid + np.diag(vehicle.added)
    inverse = np.linalg.inv(mass)
    weight = vehicle.mass_kg * vehicle.gravity
    lift = vehicle.density * vehicle.gravity * vehicle.volume_m3
    mixing = vehicle.mixing * np.array(vehicle.thrust)
    current = np.array(vehicle.current_m_s)
    # velocity of each thruster along its force, for the velocities of the body
    advances = vehicle.mixing.T

    def slope(now: float, state: Array) -> Array:
        euler, v, lagged = state[3:6], state[6:12], state[12:]
        turn = _turn(euler)
        down = turn[2]
        momentum = mass @ v
        coriolis = np.concatenate(
            [np.cross(v[3:], momentum[:3]), np.cross(v[3:], momentum[3:]) + np.cross(v[:3], momentum[:3])]
        )
        drag = (np.array(vehicle.linear) + np.array(vehicle.quadratic) * np.abs(v)) * v
        weights = np.concatenate([weight * down, np.cross(com, weight * down)])
        lifts = np.concatenate([-lift * down, np.cross(vehicle.buoyancy_m, -lift * down)])
        thrust, change = lagged, np.zeros(len(lagged))
        if vehicle.lag_s > 0:
            change = (thrusts(now) - lagged) / vehicle.lag_s
        else:
            thrust = thrusts(now)
        if vehicle.slope:
            thrust = advancing(thrust, advances @ v, vehicle.density, vehicle.slope)
        rate = inverse @ (mixing @ thrust - coriolis - drag + weights + lifts)
        f, t, _ = euler
        p, q, r = v[3:]
        angles = [
            p + (q * np.sin(f) + r * np.cos(f)) * np.tan(t),
            q * np.cos(f) - r * np.sin(f),
            (q * np.sin(f) + r * np.cos(f)) / np.cos(t),
        ]
        return np.concatenate([turn @ v[:3] + current, angles, rate, change])

    begin = np.zeros(12 + len(vehicle.inputs))
    if start is not None:
        begin[:12] = start
    begin[6:9] -= _turn(begin[3:6]).T @ current
    begin[12:] = thrusts(float(time_s[0]))
    found = solve_ivp(
        slope, (time_s[0], time_s[-1]), begin, "DOP853", time_s, rtol=1e-9, atol=1e-10, max_step=0.05
    ).y.T[:, :12]
    # report the velocity over the ground
    for row in found:
        row[6:9] += _turn(row[3:6]).T @ current
    return np.asarray(found)


def columns(
    time_s: Array, motion: Array, thrusts: Callable[[float], Array], inputs: tuple[str, ...] = Vehicle.inputs
) -> dict[str, Array]:
    """Return the columns of a log, with y to port and z up, without noise."""
    signs = np.array([1, -1, -1, 1, 1, -1, 1, -1, -1, 1, 1, -1.0])
    names = ["x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad", "u_m_s", "v_m_s", "w_m_s"]
    names += ["roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s"]
    found = {"t_s": time_s, **dict(zip(names, (motion * signs).T, strict=True))}
    forces = np.array([thrusts(float(t)) for t in time_s])
    return found | dict(zip(inputs, forces.T, strict=True))


def manoeuvre(rng: np.random.Generator, vehicle: Vehicle | None = None) -> Callable[[float], Array]:
    """Return smooth thrusts of all thrusters, N, which move the vehicle along and about every axis."""
    frequency = rng.uniform(0.05, 0.4, (6, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    share = rng.uniform(0.2, 0.5, (6, 3))
    vehicle = vehicle or Vehicle()
    mixing, largest = np.linalg.pinv(vehicle.mixing), np.array(vehicle.effort)

    def thrusts(time: float) -> Array:
        effort = largest * (share * np.sin(2.0 * np.pi * frequency * time + phase)).sum(axis=1)
        return np.asarray(mixing @ effort)

    return thrusts


#: Standard deviations of the noise: positions, angles.
NOISE = {"x_m": 0.003, "y_m": 0.003, "z_m": 0.003, "roll_rad": 0.003, "pitch_rad": 0.003, "yaw_rad": 0.003}


def write_trials(
    folder: Path, vehicle: Vehicle, *, seed: int, trials: int = 4, held_out: int = 1, duration_s: float = 30.0
) -> Path:
    """Write logs with noise and a trials file, and return its path."""
    rng = np.random.default_rng(seed)
    lines = []
    for k in range(trials):
        time_s = np.arange(0.0, duration_s + 1e-9, 0.05)
        thrusts = manoeuvre(rng, vehicle)
        found = columns(time_s, simulate(vehicle, time_s, thrusts), thrusts, vehicle.inputs)
        for name, sd in NOISE.items():
            found[name] = found[name] + rng.normal(0.0, sd, len(time_s))
        kept = {name: v for name, v in found.items() if not name.endswith("_s") or name == "t_s"}
        path = folder / f"run{k + 1}.csv"
        files.write_log(path, kept, "%.6f")
        role = ", role: validate" if k >= trials - held_out else ""
        lines.append(f"log: {path.name}{role}")
    return files.write_trials(folder / "trials.yaml", "multibody", vehicle.robot, lines)
