"""Speed of the rig fit, beside the same fit with SciPy's adaptive integrator and optimiser.

    python benchmarks/bench_rig.py

Ten falling-weight drops of 1001 samples each, three parameters (drag coefficient, added mass,
pulley friction). Wall and CPU seconds in one process, medians; the estimates are compared.
``swimid, integrated`` switches the closed form off, so that both sides integrate.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from swimid.fitting import output_error
from swimid.fitting.model import RigInput, Trial
from swimid.rig import model as rig

AREA_FACTOR = 0.5 * 997 * 0.00698
TRUTH = (0.705, 0.685, 0.0308)
TIME = np.linspace(0.0, 10.0, 1001)


def drops() -> list[Trial]:
    rng = np.random.default_rng(3)
    made = []
    for mass in np.linspace(0.010, 0.040, 10):
        x = solve(TRUTH, mass, 1e-10) + rng.normal(0.0, 1e-3, len(TIME))
        known = RigInput(1.196 + 0.02 + mass, mass * 9.8, pulley=True, area_factor=AREA_FACTOR, release_s=0.0)
        made.append(Trial(f"{1000 * mass:.1f} g", "fit", TIME, {"x_m": x}, rig=known))
    return made


def solve(values: tuple[float, float, float] | np.ndarray, mass: float, tolerance: float) -> np.ndarray:
    drag, added, friction = values
    inertia, force = 1.196 + 0.02 + mass + added, mass * 9.8 - friction

    def rate(_: float, s: np.ndarray) -> list[float]:
        return [s[1], (force - AREA_FACTOR * drag * s[1] * abs(s[1])) / inertia]

    return solve_ivp(rate, (0.0, 10.0), [0.0, 0.0], rtol=tolerance, atol=tolerance, t_eval=TIME).y[0]


def scipy_fit(trials: list[Trial]) -> np.ndarray:
    def residuals(p: np.ndarray) -> np.ndarray:
        return np.concatenate([t.measured["x_m"] - solve(p, t.rig.pull / 9.8, 1e-8) for t in trials])

    start = [1.0, 0.6, 0.02]
    return least_squares(
        residuals, start, bounds=([0, 0, 0], [5, np.inf, np.inf]), x_scale=[0.5, 0.6, 0.05]
    ).x


def swimid_fit(trials: list[Trial], *, integrated: bool = False) -> np.ndarray:
    model = rig.falling_weight(mass_kg=1.2, force_N=0.25, area_known=True, pulley=True)
    parameters = model.parameters
    if integrated:
        # a linear drag too small to matter takes the closed form away
        parameters = tuple(replace(p, start=1e-12) if p.name == "linear_drag" else p for p in parameters)
    return output_error.fit_output_error(model, trials, parameters=parameters).estimate


def measured(function: Callable[[], np.ndarray], repeats: int) -> tuple[float, float, np.ndarray]:
    wall, cpu = [], []
    for _ in range(repeats):
        a, b = time.perf_counter(), time.process_time()
        result = function()
        wall.append(time.perf_counter() - a)
        cpu.append(time.process_time() - b)
    return float(np.median(wall)), float(np.median(cpu)), result


def main() -> None:
    trials = drops()
    swimid_fit(trials)  # compile, or load from the cache
    swimid_fit(trials, integrated=True)
    rows = [
        ("swimid", *measured(lambda: swimid_fit(trials), 15)),
        ("swimid, integrated", *measured(lambda: swimid_fit(trials, integrated=True), 15)),
        ("solve_ivp + scipy least_squares", *measured(lambda: scipy_fit(trials), 3)),
    ]
    reference = rows[-1]
    print(
        f"{'fit of 10 drops x 1001 samples':<34}{'wall s':>9}{'CPU s':>9}{'wall ratio':>12}   C_d, m_a, f_c"
    )
    for name, wall, cpu, found in rows:
        values = "  ".join(f"{v:.5f}" for v in found)
        print(f"{name:<34}{wall:9.4f}{cpu:9.4f}{reference[1] / wall:11.1f}x   {values}")


if __name__ == "__main__":
    main()
