"""Print the tables of docs/learn/rig.md: speeds of a falling weight, and errors caused by faults of the rig.

Run ``python -m docs.learn.rig`` in the root of the repository. The first table is simulated by swimid with
the drag of the sample logs. The falls of the second are simulated by ``tests/generators/rig.py``, which
shares no code with swimid.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

import swimid
from tests.generators import rig

#: Pulling masses, g, and the one of the held-out trial.
WEIGHTS_G, HELD_OUT_G = (10, 15, 20, 25, 30, 35, 40), 25
#: Standard deviation of the camera, m, and its rate, Hz.
CAMERA_SD_M, RATE_HZ = 0.0005, 50.0

Fall = Callable[[float, np.random.Generator], dict[str, Any]]


def speeds() -> None:
    """Print terminal speed, and time and distance up to 95 % of it, for each pulling mass."""
    drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    print("| weight | terminal speed | 95 % of it after | way until then |")
    print("|---|---|---|---|")
    for weight in (10, 20, 40):
        run = swimid.simulate(params=drag, pulling_mass_kg=weight / 1000, duration_s=30)
        end = run.quantities["terminal_speed_m_s"].value
        reached = run.frame[run.frame["u_m_s"] >= 0.95 * end].iloc[0]
        print(f"| {weight} g | {end:.3f} m/s | {reached['t_s']:.1f} s | {reached['x_m']:.2f} m |")


def filmed(
    weight_g: float,
    rng: np.random.Generator,
    *,
    length_m: float = 1.15,
    scale: float = 1.0,
    angle_deg: float = 0.0,
    stated_g: float | None = None,
) -> dict[str, Any]:
    """Return a fall under a camera as a trial for ``swimid.load``.

    ``scale`` is the error of the calibration, ``angle_deg`` the slope of the string.
    """
    time_s = np.arange(0.0, 40.0, 1 / RATE_HZ)
    pull = weight_g * np.cos(np.radians(angle_deg))
    x_m = rig.fall(time_s, pull)
    keep = x_m <= length_m
    x_m = scale * x_m[keep] + rng.normal(0.0, CAMERA_SD_M, keep.sum())
    return {
        "log": pd.DataFrame({"t_s": time_s[keep], "x_m": x_m}),
        "pulling_mass_kg": (weight_g if stated_g is None else stated_g) / 1000,
    }


def clicked(weight_g: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return a fall with one row for each click of an encoder."""
    time_s, x_m = rig.click_log(weight_g, rng)
    return {"log": pd.DataFrame({"t_s": time_s, "x_m": x_m}), "pulling_mass_kg": weight_g / 1000}


def fitted(fall: Fall, *, weights_g: Sequence[float] = WEIGHTS_G, fixed: Mapping[str, float]) -> str:
    """Return the cells of a row: errors of the estimates, their 95 % intervals, and the verdict."""
    rng = np.random.default_rng(11)
    trials = [
        {"id": f"w{weight}", "role": "validate" if weight == HELD_OUT_G else "fit", **fall(weight, rng)}
        for weight in weights_g
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", swimid.SwimidWarning)
        found = swimid.fit_drag(
            swimid.load(trials, experiment="falling-weight", robot="boxfish"), fixed=fixed
        )
    truth = {
        "drag_coefficient": rig.BOXFISH["drag_coefficient"],
        "added_mass": rig.BOXFISH["added_mass_g"] / 1000,
    }
    cells = []
    for name, true in truth.items():
        one = found[name]
        cells.append(f"{100 * (one.value / true - 1):+.2f} ± {196 * one.stderr / true:.2f} %")
    return f"{' | '.join(cells)} | {found.verdict}"


def faults() -> None:
    """Print the errors of drag coefficient and added mass, by fault of the rig."""
    rows: dict[str, tuple[Fall, Mapping[str, float]]] = {
        "camera, no fault": (filmed, {}),
        "encoder, no fault": (clicked, {}),
        "tank of 0.4 m": (lambda w, rng: filmed(w, rng, length_m=0.4), {}),
        "scale 2 % too large": (lambda w, rng: filmed(w, rng, scale=1.02), {}),
        "string 10° off the line of motion": (lambda w, rng: filmed(w, rng, angle_deg=10), {}),
        "weights without their hook of 1 g": (lambda w, rng: filmed(w, rng, stated_g=w - 1), {}),
        "friction taken as zero": (filmed, {"pulley_friction": 0.0}),
    }
    print("| rig | error of C_d | error of the added mass | verdict |")
    print("|---|---|---|---|")
    for name, (fall, fixed) in rows.items():
        print(f"| {name} | {fitted(fall, fixed=fixed)} |")


if __name__ == "__main__":
    speeds()
    print()
    faults()
