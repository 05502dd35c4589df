"""Rig experiments with a fault or an effect that the default model lacks, integrated by SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from tests.generators.files import write_log, write_trials

Array = np.ndarray
Torque = Callable[[float, float], float]


def _trials(folder: Path, experiment: str, robot: str, names: list[str]) -> Path:
    (folder / "robot.yaml").write_text(f"format: swimid-robot/1\nname: made\n{robot}")
    trials = [f"id: {name}, log: {name}.csv" for name in names]
    return write_trials(folder / "trials.yaml", experiment, "robot.yaml", trials)


def _swing(time: Array, inertia: float, torque: Torque, start: tuple[float, float]) -> Array:
    run = solve_ivp(
        lambda _, s: [s[1], torque(s[0], s[1]) / inertia],
        (0.0, float(time[-1])),
        start,
        t_eval=time,
        rtol=1e-9,
        atol=1e-11,
        max_step=0.01,
    )
    return np.asarray(run.y[0])


def pitch_pendulum(folder: Path) -> Path:
    """Write two decays of a pitching pendulum from 52 and 34 degrees: m g l 2.4 N m, inertia 0.31 kg m2."""
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 25.0, 0.04)
    for name, angle in (("a", 0.9), ("b", 0.6)):
        pitch = _swing(time, 0.31, lambda x, v: -2.4 * math.sin(x) - 0.012 * v, (angle, 0.0))
        write_log(
            folder / f"{name}.csv",
            {"t_s": time, "pitch_rad": pitch + 0.004 * rng.normal(size=len(time))},
            "%.7f",
        )
    return _trials(folder, "free-decay", "body: {pitch_inertia_kg_m2: 0.31}\n", ["a", "b"])


def hard_heave(folder: Path) -> Path:
    """Write a heave decay on a hardening mooring: 90 N/m and 4000 N/m3, 6.5 kg in all."""
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 20.0, 0.05)
    rise = _swing(time, 6.5, lambda x, v: -90.0 * x - 4000.0 * x**3 - 1.1 * v, (-0.08, 0.0))
    write_log(folder / "a.csv", {"t_s": time, "z_m": rise + 0.0006 * rng.normal(size=len(time))}, "%.7f")
    robot = "body: {inertial_mass_kg: 5.0}\nrig: {stiffness_N_m: 90}\n"
    return _trials(folder, "free-decay", robot, ["a"])


def rubbing_yaw(folder: Path) -> Path:
    """Write a yaw decay on a torsion wire that rubs: 1.5 N m/rad, 0.04 kg m2, friction 0.02 N m."""
    rng = np.random.default_rng(2)
    time = np.arange(0.0, 6.0, 1.0 / 30.0)
    yaw = _swing(time, 0.04, lambda x, v: -1.5 * x - 0.002 * v - 0.02 * math.tanh(v / 0.002), (0.4, 0.0))
    write_log(folder / "a.csv", {"t_s": time, "yaw_rad": yaw + 0.01 * rng.normal(size=len(time))}, "%.7f")
    robot = "body: {yaw_inertia_kg_m2: 0.03}\nrig: {yaw_stiffness_N_m_rad: 1.5}\n"
    return _trials(folder, "free-decay", robot, ["a"])


def pushed_roll(folder: Path) -> Path:
    """Write a roll decay that a blow starts from its rest: 1.1 rad/s, 2.3 periods of 1.4 s."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 3.2, 0.01)
    roll = _swing(time, 0.05, lambda x, v: -1.0 * x - 0.02 * v, (0.0, 1.1))
    write_log(
        folder / "a.csv", {"t_s": time, "roll_rad": 0.1 + roll + 0.001 * rng.normal(size=len(time))}, "%.7f"
    )
    robot = "body: {roll_inertia_kg_m2: 0.03}\nrig: {roll_stiffness_N_m_rad: 1.0}\n"
    return _trials(folder, "free-decay", robot, ["a"])


def towed(folder: Path, *, tare: float = 0.0, drift: float = 0.0, turned: tuple[str, ...] = ()) -> Path:
    """Write three tows with speeds: 30 kg and 9 kg added, 12 N s2/m2, tared wrongly or turned round."""
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 16.0, 0.05)
    names = []
    for number, top in enumerate((0.4, 0.7, 1.0)):
        name = f"tow{number}"
        phase = np.clip((time - 3.0) / 2.0, 0.0, 1.0)
        speed = top * phase**2 * (3.0 - 2.0 * phase)
        rate = top * 6.0 * phase * (1.0 - phase) / 2.0
        force = 39.0 * rate + 12.0 * speed * np.abs(speed)
        force = force + tare + drift * time + 0.05 * rng.normal(size=len(time))
        sign = -1.0 if name in turned else 1.0
        measured = speed + 0.003 * rng.normal(size=len(time))
        write_log(folder / f"{name}.csv", {"t_s": time, "u_m_s": measured, "force_N": sign * force}, "%.7f")
        names.append(name)
    return _trials(folder, "towed", "body: {inertial_mass_kg: 30}\n", names)
