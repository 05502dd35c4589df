"""Coverage of drag and added mass of a falling-weight rig, and false alarms of its checks.

A camera logs five drops. The motion is integrated in cgs units by the generator of the rig.
"""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

import numpy as np

import swimid
from tests.generators import rig
from validation.coverage.rows import alarms, inside

REPEATS = 400


def one(seed: int) -> dict[str, float]:
    """Return whether the intervals hold the true values of one experiment, and the alarms of checks."""
    rng = np.random.default_rng([seed, 5])
    true = {
        "drag_coefficient": rng.uniform(0.5, 1.0),
        "added_mass": rng.uniform(0.4, 0.9),
        "pulley_friction": rng.uniform(0.015, 0.045),
    }
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        trials = rig.write_falls(
            Path(folder),
            rng,
            (10, 15, 20, 30, 40),
            noise_m=rng.uniform(2e-4, 1e-3),
            drag_coefficient=true["drag_coefficient"],
            added_mass_g=1000 * true["added_mass"],
            friction_mN=1000 * true["pulley_friction"],
        )
        fit = swimid.fit_drag(trials)
    found = {name: inside(fit.data["parameters"][name], value) for name, value in true.items()}
    return found | alarms(fit)
