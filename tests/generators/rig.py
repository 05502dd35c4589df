"""Rig recordings computed without swimid: an adaptive integrator of other order, in cgs units.

The equation of motion is that of the boxfish paper (Eqs 7, 8) with the drag written as a
power of speed per displacement, integrated by an adaptive Dormand-Prince 8(5,3) scheme with
root finding for the encoder's clicks.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

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
        lines.append(f"  - {{log: w{weight}.csv, id: w{weight}, pulling_mass_kg: {weight / 1000:.3f}}}")
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
