"""Coverage of drag and added mass of a towed body, and false alarms of the checks.

Three tows follow a smooth rise of the force. The equation of motion is integrated by LSODA.
"""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import swimid
from validation.coverage.rows import alarms, inside

REPEATS = 400
MASS_KG = 30.0


def one(seed: int) -> dict[str, float]:
    """Return whether the intervals hold the true values of one experiment, and the alarms of checks."""
    rng = np.random.default_rng([seed, 6])
    true = {"added_mass": rng.uniform(5.0, 15.0), "quadratic_drag": rng.uniform(8.0, 20.0)}
    noise, time = rng.uniform(0.002, 0.01), np.arange(0.0, 16.0, 0.05)
    lines = ["format: swimid-trials/1", "experiment: towed", "robot: robot.yaml", "trials:"]
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        (folder / "robot.yaml").write_text(
            f"format: swimid-robot/1\nname: hull\nbody: {{inertial_mass_kg: {MASS_KG:g}}}\n"
        )
        for k, largest in enumerate((2.0, 6.0, 12.0)):
            force = largest * (1.0 + 0.5 * np.sin(0.6 * time + k)) * np.clip(time / 2.0, 0.0, 1.0)

            def rates(t: float, state: np.ndarray, force: np.ndarray = force) -> list[float]:
                drag = true["quadratic_drag"] * state[1] * abs(state[1])
                return [state[1], (np.interp(t, time, force) - drag) / (MASS_KG + true["added_mass"])]

            run = solve_ivp(
                rates, (0.0, time[-1]), [0.0, 0.0], "LSODA", time, rtol=1e-8, atol=1e-9, max_step=0.05
            )
            table = np.c_[time, force, run.y[0] + noise * rng.normal(size=len(time))]
            np.savetxt(folder / f"{k}.csv", table, "%.9f", ",", header="t_s,force_N,x_m", comments="")
            lines.append(f"  - {{id: tow{k}, log: {k}.csv}}")
        (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
        fit = swimid.fit_drag(folder / "trials.yaml")
    return {n: inside(fit.data["parameters"][n], value) for n, value in true.items()} | alarms(fit)
