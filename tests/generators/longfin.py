"""Marching runs of a vehicle with two undulating long fins, from first principles.

Not a model of swimid: a nonlinear simulation to make logs with. Ten rays on each side carry a
travelling wave. Each strip of membrane pushes water along its normal (resistive force); the hull
shields a fin on its upward stroke, which lets a part of the thrust follow the stroke itself and
not only its square. The vehicle surges with added mass and quadratic drag; a small difference
between the fins turns it. An IMU at rest-calibrated accuracy records accelerations and rates;
speed is the trapezoidal integral of the forward acceleration, as in Shang et al. (2012), Eq 12.

The drive sweeps its frequency up and down at constant tip speed, so that it excites more than one
frequency; a single sine would determine two coefficients of a model only.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid, solve_ivp

SAMPLE_TIME_S = 0.02375
RAYS = 10
RAY_LENGTH_M = 0.16
FIN_LENGTH_M = 0.72
WAVES_ON_FIN = 1.2
MASS_KG = 14.0
ADDED_MASS_KG = 5.0
YAW_INERTIA_KG_M2 = 1.9
DRAG_AREA_M2 = 0.022  # drag coefficient times frontal area
YAW_DRAG_N_M_S2 = 1.6
FIN_ARM_M = 0.21
NORMAL_COEFFICIENT = 2.2
SHIELDING = 0.9
TAPER = 1.3
STARBOARD_WEAKNESS = 0.03
WATER_KG_M3 = 997.0
GRAVITY_M_S2 = 9.81
ACCELEROMETER_SD_M_S2 = 0.002
ACCELEROMETER_BIAS_M_S2 = 1e-4
GYRO_SD_RAD_S = 0.003


def drive(
    time_s: np.ndarray, *, slow_hz: float, fast_hz: float, sweep_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Phase (rad) and amplitude (rad) of the wave: frequency sweeps up and down, tip speed constant."""
    middle, half = (slow_hz + fast_hz) / 2, (fast_hz - slow_hz) / 2
    frequency = middle - half * np.cos(2 * np.pi * time_s / sweep_s)
    phase = (
        2 * np.pi * (middle * time_s - half * sweep_s / (2 * np.pi) * np.sin(2 * np.pi * time_s / sweep_s))
    )
    return phase, np.radians(30.0) * (slow_hz / frequency) ** TAPER


def _thrust(phase: float, amplitude: float, speed: float, rate: float) -> float:
    """Forward force of one fin, N; ``rate`` is the phase's rate of change, rad/s."""
    x = (np.arange(RAYS) + 0.5) / RAYS * FIN_LENGTH_M
    number = 2 * np.pi * WAVES_ON_FIN / FIN_LENGTH_M
    angle = amplitude * np.sin(phase - number * x)
    turning = amplitude * np.cos(phase - number * x)
    # Height of the membrane at two thirds of the ray, its velocity and its slope along the hull.
    reach = 2 / 3 * RAY_LENGTH_M
    slope = -reach * number * turning
    normal_velocity = reach * rate * turning + speed * slope
    pressure = 0.5 * WATER_KG_M3 * NORMAL_COEFFICIENT * np.abs(normal_velocity) * normal_velocity
    shield = 1.0 - SHIELDING * np.sin(phase) * (1.0 + 0.2 * np.mean(angle))
    return float(-np.sum(pressure * slope) * RAY_LENGTH_M * FIN_LENGTH_M / RAYS * shield)


def marching(
    *, duration_s: float, seed: int, slow_hz: float = 1.0, fast_hz: float = 1.5, sweep_s: float = 5.0
) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    """One run, already under way when the log starts.

    Parameters
    ----------
    duration_s : float
        Length of the log.
    seed : int
        Of the sensor noise.
    slow_hz, fast_hz, sweep_s : float
        Band and period of the sweep.

    Returns
    -------
    columns, metadata : dict
        As a log file holds them.
    """
    rng = np.random.default_rng(seed)
    lead_in_s = 12.0
    grid = np.arange(0.0, lead_in_s + duration_s, SAMPLE_TIME_S)

    def motion(t: float, state: np.ndarray) -> list[float]:
        u, r = state
        phase, amplitude = drive(np.array(t), slow_hz=slow_hz, fast_hz=fast_hz, sweep_s=sweep_s)
        ahead, _ = drive(np.array(t + 1e-4), slow_hz=slow_hz, fast_hz=fast_hz, sweep_s=sweep_s)
        rate = float(ahead - phase) / 1e-4
        port = _thrust(float(phase), float(amplitude), u - FIN_ARM_M * r, rate)
        starboard = _thrust(float(phase), float(amplitude), u + FIN_ARM_M * r, rate) * (
            1 - STARBOARD_WEAKNESS
        )
        surge = (port + starboard - 0.5 * WATER_KG_M3 * DRAG_AREA_M2 * abs(u) * u) / (MASS_KG + ADDED_MASS_KG)
        turn = (FIN_ARM_M * (starboard - port) - YAW_DRAG_N_M_S2 * (abs(r) + 0.2) * r) / YAW_INERTIA_KG_M2
        return [surge, turn]

    solution = solve_ivp(
        motion, (0.0, grid[-1]), [0.2, 0.0], t_eval=grid, rtol=1e-8, atol=1e-10, max_step=SAMPLE_TIME_S
    )
    u, r = solution.y
    keep = grid >= lead_in_s
    time = np.arange(np.count_nonzero(keep)) * SAMPLE_TIME_S
    forward = np.gradient(u, SAMPLE_TIME_S)
    n = len(time)

    def accelerometer(true: np.ndarray) -> np.ndarray:
        return true[keep] + ACCELEROMETER_BIAS_M_S2 + ACCELEROMETER_SD_M_S2 * rng.normal(size=n)

    zero = np.zeros(len(grid))
    ax = accelerometer(forward)
    phase, amplitude = drive(grid[keep], slow_hz=slow_hz, fast_hz=fast_hz, sweep_s=sweep_s)
    gyro = r[keep] + GYRO_SD_RAD_S * rng.normal(size=n)
    columns = {
        "t_s": np.round(time, 5),
        "cmd1_rad": np.round(amplitude * np.sin(phase), 5),
        "u_m_s": np.round(u[keep][0] + cumulative_trapezoid(ax, dx=SAMPLE_TIME_S, initial=0.0), 6),
        "yaw_rate_rad_s": np.round(gyro, 6),
        "ax_m_s2": np.round(ax, 5),
        "ay_m_s2": np.round(accelerometer(u * r), 5),
        "az_m_s2": np.round(accelerometer(zero + GRAVITY_M_S2), 5),
        "wx_rad_s": np.round(GYRO_SD_RAD_S * rng.normal(size=n), 6),
        "wy_rad_s": np.round(GYRO_SD_RAD_S * rng.normal(size=n), 6),
        "wz_rad_s": np.round(gyro, 6),
    }
    metadata: dict[str, object] = {
        "robot": "long-fin",
        "experiment": "arma",
        "mode": "marching",
        "source": "simulated (tests/generators/longfin.py)",
        "seed": seed,
        "sample_time_s": SAMPLE_TIME_S,
    }
    return columns, metadata


def write_csv(path: Path, columns: dict[str, np.ndarray], metadata: dict[str, object]) -> None:
    """Write a log as the format asks for, without swimid."""
    lines = [f"# {key}: {value}" for key, value in metadata.items()]
    lines.append(",".join(columns))
    for row in zip(*columns.values(), strict=True):
        lines.append(",".join("" if np.isnan(value) else repr(float(value)) for value in row))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_sample(folder: str | Path) -> list[Path]:
    """Write ``longfin_marching.csv`` (18 s) and ``longfin_validation.csv`` (19 s, another sweep)."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    runs = {
        "longfin_marching.csv": marching(duration_s=18.0, seed=20121),
        "longfin_validation.csv": marching(
            duration_s=19.0, seed=20122, slow_hz=1.05, fast_hz=1.4, sweep_s=4.5
        ),
    }
    for name, (columns, metadata) in runs.items():
        write_csv(folder / name, columns, metadata)
    return [folder / name for name in runs]


if __name__ == "__main__":
    import sys

    for written in write_sample(sys.argv[1] if len(sys.argv) > 1 else "."):
        print(written)
