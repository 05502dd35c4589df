"""Choose the fin, frequency and amplitude that reach a speed at the least power, from a recoil law.

python docs/examples/fins.py

The boxfish's recoil law (Eqs 4, 5 and 27 of its paper) is 8 eta pi^2 I f^3 (theta - theta_off)^2 = k v^3
with k = rho C_d A / 2: the power of propulsion. The fin itself moves with its whole amplitude and takes 8
pi^2 I f^3 theta^2, so that the largest amplitude needs the least power; fins differ by what their servo
must do.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import swimid
from swimid.propulsion.model import plate_inertia

#: What is asked for, and what the servo can do.
SPEED_M_S, MAX_RATE_DEG_S = 0.1, 700.0
FREQUENCY_HZ, AMPLITUDE_DEG = (1.0, 4.0), (10.0, 30.0)
N_AMPLITUDES, N_DRAWS = 201, 400


def inertias(robot: swimid.Robot, propulsion: swimid.Fitted) -> dict[str, float]:
    """Return the hydrodynamic inertia of each fin, kg m2: estimated, given, or that of a plate (Eq 6)."""
    found = {}
    for name, fin in robot.fins.items():
        if f"inertia_{name}" in propulsion.parameters.index:
            found[name] = propulsion[f"inertia_{name}"].value
        elif fin.hydrodynamic_inertia_kg_m2 is not None:
            found[name] = fin.hydrodynamic_inertia_kg_m2
        elif fin.shape == "rectangle":
            found[name] = plate_inertia(fin.height_m, fin.length_m, fin.axle_gap_m, robot.fluid.density_kg_m3)
    return found


def frequency_hz(
    k: float, inertia: float, efficiency: float, offset_deg: float, amplitude_deg: float
) -> float:
    """Return the frequency at which a fin reaches the speed."""
    over = np.radians(amplitude_deg - offset_deg)
    return np.cbrt(k * SPEED_M_S**3 / (8 * efficiency * np.pi**2 * inertia * over**2))


def choose(drag: swimid.Fitted, propulsion: swimid.Fitted) -> pd.DataFrame:
    """Return the gait of least power of each fin that reaches the speed, the slowest servo first."""
    robot = swimid.read_robot("boxfish")
    k = 0.5 * robot.fluid.density_kg_m3 * robot.body.frontal_area_m2 * drag["drag_coefficient"].value
    law = ["recoil_efficiency", "amplitude_offset_deg"]
    mean, stderr = propulsion.parameters.loc[law, "value"], propulsion.parameters.loc[law, "stderr"]
    covariance = propulsion.correlation.loc[law, law] * np.outer(stderr, stderr)
    draws = np.random.default_rng(0).multivariate_normal(mean, covariance, N_DRAWS)
    rows = []
    for name, inertia in inertias(robot, propulsion).items():
        amplitude = np.linspace(*AMPLITUDE_DEG, N_AMPLITUDES)
        f = frequency_hz(k, inertia, *mean, amplitude)
        power = 8 * np.pi**2 * inertia * f**3 * np.radians(amplitude) ** 2
        rate = 2 * np.pi * f * amplitude
        allowed = (f >= FREQUENCY_HZ[0]) & (f <= FREQUENCY_HZ[1]) & (rate <= MAX_RATE_DEG_S)
        if not allowed.any():
            continue
        best = int(np.argmin(np.where(allowed, power, np.inf)))
        drawn = [frequency_hz(k, inertia, *draw, amplitude[best]) for draw in draws]
        low, high = np.quantile(drawn, [0.025, 0.975])
        rows.append([name, amplitude[best], f[best], low, high, 1e3 * power[best], rate[best]])
    columns = ["fin", "amplitude_deg", "frequency_hz", "low_hz", "high_hz", "power_mW", "rate_deg_s"]
    return pd.DataFrame(rows, columns=columns).set_index("fin").sort_values("rate_deg_s")


def main() -> None:
    """Fit drag and propulsion, choose, and check each gait by a simulation."""
    # a recoil law is simulated with the drag file that it names
    folder = Path(tempfile.mkdtemp())
    drag = swimid.fit_drag("sample_logs/rig/trials.yaml", output=folder / "drag.yaml")
    propulsion = swimid.fit_propulsion(
        "sample_logs/cruise/trials.yaml", drag=folder / "drag.yaml", output=folder / "propulsion.yaml"
    )
    table = choose(drag, propulsion)
    print(table.round(3).to_string())
    for name, gait in table.iterrows():
        swum = swimid.simulate(
            params=folder / "propulsion.yaml", fin=name,
            frequency_hz=gait["frequency_hz"], amplitude_deg=gait["amplitude_deg"],
        )  # fmt: skip
        print(f"{name}: simulated at {swum.quantities['terminal_speed_m_s'].value:.4f} m/s")


if __name__ == "__main__":
    main()
