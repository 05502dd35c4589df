"""Coverage of the recoil law of a cruise table, and false alarms of its checks.

The speeds follow from integrating the approach to terminal speed. The drag file has errors of its own, as its
standard errors state.
"""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

import numpy as np

import swimid
from tests.generators import cruise
from validation.coverage.rows import alarms, inside

REPEATS = 400
#: Values of the boxfish in the generator, with the standard errors of the drag file.
DRAG = {"drag_coefficient": (0.705, 0.0165, "1"), "added_mass": (0.685, 0.0185, "kg")}


def one(seed: int) -> dict[str, float]:
    """Return whether the intervals hold the true values of one table, and which checks raise an alarm."""
    rng = np.random.default_rng([seed, 7])
    true = {"recoil_efficiency": rng.uniform(0.25, 0.45), "amplitude_offset_deg": rng.uniform(3.0, 7.0)}
    rows = cruise.table(
        rng,
        time_sd_s=rng.uniform(0.03, 0.1),
        flex_loss=0.0,
        efficiency=true["recoil_efficiency"],
        offset_deg=true["amplitude_offset_deg"],
    )
    drag = "format: swimid-parameters/1\nmodel: falling-weight\nrobot: boxfish\nparameters:\n"
    for name, (value, sd, unit) in DRAG.items():
        drawn = value + sd * rng.normal()
        drag += f"  {name}: {{value: {drawn:.6f}, stderr: {sd}, unit: '{unit}', status: estimated}}\n"
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        cruise.write_table(folder / "speeds.csv", rows)
        (folder / "drag.yaml").write_text(drag)
        (folder / "trials.yaml").write_text(
            "format: swimid-trials/1\nexperiment: cruise\nrobot: boxfish\ntable: speeds.csv\n"
        )
        fit = swimid.fit_propulsion(folder / "trials.yaml", drag=folder / "drag.yaml")
    return {n: inside(fit.data["parameters"][n], value) for n, value in true.items()} | alarms(fit)
