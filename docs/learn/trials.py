"""Print the table of docs/learn/trials.md: interval of the drag coefficient by number and choice of weights.

Run ``python -m docs.learn.trials`` in the root of the repository. The falls are simulated by
``tests/generators/rig.py``, which shares no code with swimid. In each fall the friction of the pulley has a
value of its own.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

import swimid
from tests.generators import rig

#: Standard deviation of the camera, m, and number of repeats of each row.
CAMERA_SD_M, REPEATS = 0.0005, 12
#: Pulling masses of one experiment, g.
SIX = (10, 15, 20, 25, 30, 40)
#: Standard deviation of the pulley friction between falls, mN, and pulling masses of each row.
ROWS = [
    (0.0, (25,) * 6),
    (0.0, (20, 30)),
    (0.0, (10, 40)),
    (0.0, SIX),
    (0.0, SIX * 2),
    (1.5, (20, 30)),
    (1.5, (10, 40)),
    (1.5, SIX),
    (1.5, SIX * 2),
]


def fall(weight_g: float, friction_sd_mN: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return a simulated fall over 1.15 m as a trial for ``swimid.load``."""
    friction = rng.normal(rig.BOXFISH["friction_mN"], friction_sd_mN)
    time_s = np.arange(0.0, 30.0, 0.02)
    x_m = rig.fall(time_s, weight_g, friction_mN=friction)
    keep = x_m <= 1.15
    noisy = x_m[keep] + rng.normal(0.0, CAMERA_SD_M, keep.sum())
    return {"log": pd.DataFrame({"t_s": time_s[keep], "x_m": noisy}), "pulling_mass_kg": weight_g / 1000}


def fitted(
    weights_g: Sequence[float], friction_sd_mN: float, rng: np.random.Generator
) -> tuple[float, float] | None:
    """Return drag coefficient and standard error from one simulated experiment; None if not identifiable."""
    trials = [{"id": f"t{k}", **fall(weight, friction_sd_mN, rng)} for k, weight in enumerate(weights_g)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", swimid.SwimidWarning)
        try:
            drag = swimid.fit_drag(swimid.load(trials, experiment="falling-weight", robot="boxfish"))
        except swimid.NoTrustworthyResult:
            return None
    found = drag["drag_coefficient"]
    return (found.value, found.stderr) if found.status == "estimated" else None


def row(friction_sd_mN: float, weights_g: Sequence[float]) -> str:
    """Return a row of the table, from repeated experiments with these weights."""
    rng = np.random.default_rng(7)
    results = [fitted(weights_g, friction_sd_mN, rng) for _ in range(REPEATS)]
    known = np.array([one for one in results if one is not None]) / rig.BOXFISH["drag_coefficient"]
    weights = ", ".join(f"{weight}" for weight in sorted(set(weights_g)))
    cells = [f"{weights}", f"{len(weights_g)}", f"{friction_sd_mN:g} mN", "not identifiable", "–"]
    if len(known):
        cells[3] = f"± {100 * 1.96 * np.median(known[:, 1]):#.2g} %"
        cells[4] = f"{100 * np.sqrt(np.mean((known[:, 0] - 1) ** 2)):#.2g} %"
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    print("| weights, g | falls | friction differs by | 95 % interval of C_d | error, root mean square |")
    print("|---|---|---|---|---|")
    for friction_sd_mN, weights_g in ROWS:
        print(row(friction_sd_mN, weights_g))


if __name__ == "__main__":
    main()
