"""Rig recordings computed without swimid: an adaptive integrator of other order, in cgs units.

The equation of motion is that of the boxfish paper (Eqs 7, 8) with the drag written as a
power of speed per displacement, integrated by an adaptive Dormand-Prince 8(5,3) scheme with
root finding for the encoder's clicks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from tests.generators.marks import mark

#: The boxfish paper's identified values, in its own units (cm, g, s, mN = 100 dyn).
BOXFISH = {
    "drag_coefficient": 0.705,
    "added_mass_g": 685.0,
    "friction_mN": 30.8,
    "mass_g": 1196.0,
    "pulley_g": 20.0,
    "area_cm2": 69.8,
    "density": 0.997,
    "gravity": 980.0,
    "click_cm": 0.785,
}


def click_times(
    weight_g: float,
    *,
    length_cm: float = 115.0,
    drag_exponent: float = 2.0,
    robot: dict | None = None,
    **changes: float,
) -> np.ndarray:
    """Instants at which a falling weight has pulled the robot over 0, 1, 2, ... clicks, s."""
    p = {**(robot or BOXFISH), **changes}
    mass = p["mass_g"] + p["added_mass_g"] + weight_g + p["pulley_g"]
    push = weight_g * p["gravity"] - 100.0 * p["friction_mN"]
    drag = 0.5 * p["density"] * p["drag_coefficient"] * p["area_cm2"]

    # drag exponents other than two keep the drag at 20 cm/s
    def rate(_: float, state: np.ndarray) -> list[float]:
        speed = max(state[1], 0.0)
        return [state[1], (push - drag * 400.0 * (speed / 20.0) ** drag_exponent) / mass]

    end = 3.0 * np.sqrt(2 * length_cm * mass / push) + 30.0

    def arrived(_: float, state: np.ndarray) -> float:
        return state[0] - length_cm

    arrived.terminal = True
    run = solve_ivp(
        rate,
        (0.0, end),
        [0.0, 0.0],
        method="DOP853",
        rtol=1e-10,
        atol=1e-10,
        events=arrived,
        dense_output=True,
    )
    clicks = np.arange(0.0, min(run.y[0, -1], length_cm), p["click_cm"])
    times = np.zeros(len(clicks))
    for k, click in enumerate(clicks[1:], start=1):
        low, high = times[k - 1], run.t[-1]
        for _ in range(60):
            middle = 0.5 * (low + high)
            if run.sol(middle)[0] < click:
                low = middle
            else:
                high = middle
        times[k] = 0.5 * (low + high)
    return times


def click_log(
    weight_g: float,
    rng: np.random.Generator,
    *,
    jitter_s: float = 0.004,
    pitch_sd_cm: float = 0.02,
    **changes: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and displacements (m) as the encoder logs them: late or early stamps, uneven clicks."""
    times = click_times(weight_g, **changes)
    step = changes.get("click_cm", BOXFISH["click_cm"])
    speeds = np.gradient(np.arange(len(times)) * step, times)
    late = rng.normal(0.0, jitter_s, len(times)) + rng.normal(0.0, pitch_sd_cm, len(times)) / np.maximum(
        speeds, 1e-3
    )
    late[0] = 0.0
    stamped = np.round(np.sort(times + late), 6)
    return stamped, np.arange(len(times)) * step / 100.0


def write_sample(folder: Path, *, seed: int = 20) -> None:
    """Seven falling-weight logs of the boxfish and their trials file."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    lines = [
        "# Seven pulling weights on the boxfish's falling-weight rig (synthetic, seeded).",
        "format: swimid-trials/1",
        "experiment: falling-weight",
        "robot: boxfish",
        "trials:",
    ]
    for weight in range(10, 41, 5):
        times, displacement = click_log(float(weight), rng)
        rows = "\n".join(f"{t:.6f},{x:.5f}" for t, x in zip(times, displacement, strict=True))
        header = (
            f"# experiment: falling-weight\n# pulling_mass_kg: {weight / 1000:.3f}\n"
            "# encoder_resolution_m: 0.00785\n"
        )
        (folder / f"w{weight}.csv").write_text(f"{header}t_s,x_m\n{rows}\n")
        role = ", role: validate" * (weight == 25)
        lines.append(f"  - {{log: w{weight}.csv, id: w{weight}, pulling_mass_kg: {weight / 1000:.3f}{role}}}")
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
    mark(folder)


def fall(
    times_s: np.ndarray,
    weight_g: float,
    *,
    linear_N_s_m: float = 0.0,
    robot: dict | None = None,
    **changes: float,
) -> np.ndarray:
    """Displacement (m) at given times of a robot pulled from rest by a falling weight.

    Quadratic and linear drag, a pulley of constant friction; a Dormand-Prince scheme in cm, g and s.
    """
    p = {**(robot or BOXFISH), **changes}
    mass = p["mass_g"] + p["added_mass_g"] + weight_g + p["pulley_g"]
    push = weight_g * p["gravity"] - 100.0 * p["friction_mN"]
    square = 0.5 * p["density"] * p["drag_coefficient"] * p["area_cm2"]
    line = 1000.0 * linear_N_s_m

    def rate(_: float, state: np.ndarray) -> list[float]:
        return [state[1], (push - line * state[1] - square * state[1] * abs(state[1])) / mass]

    run = solve_ivp(
        rate, (0.0, float(times_s[-1])), [0.0, 0.0], method="DOP853", rtol=1e-10, atol=1e-10, t_eval=times_s
    )
    return np.asarray(run.y[0] / 100.0)


def write_falls(
    folder: Path,
    rng: np.random.Generator,
    weights_g: Sequence[float] = tuple(range(10, 41, 5)),
    *,
    robot: str = "boxfish",
    noise_m: float = 5e-4,
    length_m: float = 1.15,
    odd: Mapping[float, Mapping[str, float]] | None = None,
    stated_g: Mapping[float, float] | None = None,
    held_out: Sequence[float] = (),
    name: str = "trials.yaml",
    **changes: float,
) -> Path:
    """Camera logs at 50 Hz of falling-weight trials, and their trials file.

    Parameters
    ----------
    odd : mapping of weight to changes
        What is different in single trials.
    stated_g : mapping of weight to weight
        Wrong pulling masses in the trials file.
    held_out : sequence of weights
        Trials of role ``validate``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["format: swimid-trials/1", "experiment: falling-weight", f"robot: {robot}", "trials:"]
    for weight in weights_g:
        here = {**changes, **(odd or {}).get(weight, {})}
        time = np.arange(0.0, 30.0, 0.02)
        x = fall(time, weight, **here)
        keep = x <= length_m
        rows = np.column_stack((time[keep], x[keep] + rng.normal(0.0, noise_m, int(keep.sum()))))
        np.savetxt(
            folder / f"w{weight:g}.csv", rows, delimiter=",", header="t_s,x_m", comments="", fmt="%.7f"
        )
        mass = (stated_g or {}).get(weight, weight) / 1000
        role = ", role: validate" if weight in held_out else ""
        lines.append(f"  - {{log: w{weight:g}.csv, id: w{weight:g}, pulling_mass_kg: {mass:g}{role}}}")
    (folder / name).write_text("\n".join(lines) + "\n")
    return folder / name


def slide(
    times_s: np.ndarray,
    force_N: Callable[[float], float],
    *,
    mass_kg: float,
    viscous_N_s_m: float,
    dry_N: float,
) -> np.ndarray:
    """Position (m) of a carriage from rest under a force, viscous and dry friction.

    It sticks and slips: each slip is integrated by an adaptive scheme up to the instant at which it ends,
    each rest scanned for the instant at which the force exceeds the friction.
    """
    x = np.zeros(len(times_s))
    now, place, end = float(times_s[0]), 0.0, float(times_s[-1])
    while now < end:
        scan = np.arange(now, end + 1e-3, 1e-3)
        loose = np.flatnonzero([abs(force_N(t)) > dry_N for t in scan])
        if not len(loose):
            x[times_s >= now] = place
            break
        start = float(scan[loose[0]])
        if loose[0] > 0:
            low, high = float(scan[loose[0] - 1]), start
            for _ in range(50):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if abs(force_N(middle)) > dry_N else (middle, high)
            start = high
        x[(times_s >= now) & (times_s < start)] = place
        if start >= end:
            break
        side = np.sign(force_N(start + 1e-9))

        def rate(t: float, s: np.ndarray, side: float = side) -> list[float]:
            return [s[1], (force_N(t) - side * dry_N - viscous_N_s_m * s[1]) / mass_kg]

        def stopped(_: float, s: np.ndarray, side: float = side) -> float:
            return float(s[1] * side)

        stopped.terminal = True  # type: ignore[attr-defined]
        stopped.direction = -1  # type: ignore[attr-defined]
        run = solve_ivp(
            rate, (start, end), [place, side * 1e-12], method="DOP853",
            rtol=1e-10, atol=1e-13, events=stopped, dense_output=True, max_step=0.05,
        )  # fmt: skip
        slipping = (times_s >= start) & (times_s <= run.t[-1])
        x[slipping] = run.sol(times_s[slipping])[0]
        now, place = float(run.t[-1]) + 1e-9, float(run.y[0, -1])
    x[times_s >= end] = place
    return x


def write_slide(
    folder: Path, rng: np.random.Generator, *, noise_m: float = 1e-4, rate_hz: float = 100.0
) -> Path:
    """A carriage pushed to and fro with rests between, its log and trials file.

    60 kg, 200 N s/m, 20 N of dry friction and 3 N of offset of the force. The force is what a smooth motion
    at 0.05 to 0.2 m/s asks for, as a position controller gives it; where the carriage rests there is none.
    """
    folder.mkdir(parents=True, exist_ok=True)
    time = np.arange(0.0, 24.0 + 0.5 / rate_hz, 1.0 / rate_hz)
    speed = np.zeros(len(time))
    for k, top in enumerate((0.05, -0.1, 0.2, -0.2, 0.1, -0.05)):
        part = (time - 4.0 * k - 0.5) / 3.0
        inside = (part > 0) & (part < 1)
        speed[inside] = top * np.sin(np.pi * part[inside]) ** 2 * 1.4
    force = 60.0 * np.gradient(speed, time) + 200.0 * speed + 20.0 * np.tanh(speed / 0.002)
    force = np.round(force, 6)
    x = slide(time, lambda t: float(np.interp(t, time, force)), mass_kg=60.0, viscous_N_s_m=200.0, dry_N=20.0)
    rows = np.column_stack((time, force - 3.0, x + rng.normal(0.0, noise_m, len(x))))
    np.savetxt(folder / "slide.csv", rows, delimiter=",", header="t_s,force_N,x_m", comments="", fmt="%.8f")
    (folder / "carriage.yaml").write_text(
        "format: swimid-robot/1\nname: carriage\nbody: {inertial_mass_kg: 50}\n"
    )
    (folder / "slide.yaml").write_text(
        "format: swimid-trials/1\nexperiment: towed\nrobot: carriage.yaml\ntrials: [{log: slide.csv}]\n"
    )
    return folder / "slide.yaml"
