"""Coverage of a roll decay: added inertia, damping and natural period, integrated by LSODA.

Noise, amplitude, sampling, damping and rest position are drawn for every recording. Half of the recordings
are held before the release. A third have dry friction, which is then fitted.
"""

from __future__ import annotations

import math
import tempfile
import warnings
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import swimid
from tests.generators.files import write_log, write_trials
from validation.coverage.rows import alarms

REPEATS = 400
INERTIA, STIFFNESS = 0.002, 0.3
ROBOT = (
    "format: swimid-robot/1\nname: float\n"
    f"body: {{roll_inertia_kg_m2: {INERTIA}}}\nrig: {{roll_stiffness_N_m_rad: {STIFFNESS}}}\n"
)


def one(seed: int) -> dict[str, float]:
    """Return whether the stated intervals hold the true values of one experiment of two decays."""
    rng = np.random.default_rng(seed)
    added = rng.uniform(0.0008, 0.002)
    rate = math.sqrt(STIFFNESS / (INERTIA + added))
    linear = 2.0 * rng.uniform(0.01, 0.04) * (INERTIA + added) * rate
    amplitude = rng.uniform(0.2, 0.5)
    quadratic = rng.uniform(0.5, 2.0) * linear / (rate * amplitude)
    dry = rng.uniform(0.01, 0.03) * STIFFNESS * amplitude if seed % 3 == 0 else 0.0
    truth = {
        "added_inertia": added,
        "linear_damping": linear,
        "quadratic_damping": quadratic,
        "natural_period_s": 2.0 * math.pi / rate,
    }
    if dry:
        truth["dry_friction"] = dry
    samples_per_s, noise = rng.choice([25.0, 50.0, 100.0]), rng.uniform(0.002, 0.01) * amplitude
    lines = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "robot.yaml").write_text(ROBOT)
        for trial, share in (("a", 1.0), ("b", rng.uniform(0.4, 0.8))):
            hold = rng.uniform(0.5, 2.0) if seed % 2 else 0.0
            rest = rng.normal(0.0, 0.05)
            time = np.arange(0.0, hold + rng.uniform(8.0, 16.0) * 2.0 * math.pi / rate, 1.0 / samples_per_s)
            roll = _decay(time - hold, share * amplitude, (INERTIA + added, linear, quadratic, dry))
            measured = rest + roll + noise * rng.normal(size=len(time))
            write_log(folder / f"{trial}.csv", {"t_s": time, "roll_rad": measured}, "%.9f")
            lines.append(f"id: {trial}, log: {trial}.csv")
        write_trials(folder / "trials.yaml", "free-decay", "robot.yaml", lines)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = swimid.fit_drag(folder / "trials.yaml", freed=("dry_friction",) if dry else ())
    estimates = {**found.data["parameters"], **found.data["derived"]}
    shares = {}
    for quantity, true in truth.items():
        e = estimates[quantity]
        # a quantity that is said not to be known, or to lie at its bound, states no interval
        if e["status"] == "estimated":
            shares[quantity] = float(abs(e["value"] - true) <= 1.96 * e["stderr"])
    return shares | alarms(found)


def _decay(time: np.ndarray, amplitude: float, coefficients: tuple[float, ...]) -> np.ndarray:
    """Return the angle at given times of a body released at time zero, held there before."""
    inertia, linear, quadratic, dry = coefficients
    roll = np.full(len(time), amplitude)
    moving = time >= 0.0
    now, state, stuck = 0.0, [amplitude, 0.0], False
    while not stuck and now < time[-1]:
        side = -math.copysign(1.0, state[0])

        def rates(_: float, s: np.ndarray, side: float = side) -> list[float]:
            force = -STIFFNESS * s[0] - linear * s[1] - quadratic * s[1] * abs(s[1]) - dry * side
            return [s[1], force / inertia]

        def stops(_: float, s: np.ndarray) -> float:
            return float(s[1])

        stops.terminal, stops.direction = True, -side  # type: ignore[attr-defined]
        run = solve_ivp(
            rates,
            (now, time[-1]),
            state,
            method="LSODA",
            dense_output=True,
            events=stops,
            rtol=1e-9,
            atol=1e-11,
        )
        here = moving & (time >= now) & (time <= run.t[-1])
        roll[here] = run.sol(time[here])[0]
        now, state = run.t[-1], [run.y[0, -1], 0.0]
        stuck = abs(STIFFNESS * state[0]) <= dry
    roll[moving & (time > now)] = state[0]
    return roll
