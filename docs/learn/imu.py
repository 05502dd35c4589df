"""Print the tables of docs/imu.md: errors of a path from an inertial log, by rests, camera and lever.

Run ``python -m docs.learn.imu`` in the root of the repository. The runs are simulated by
``tests/generators/imu.py``, which shares no code with swimid, with the noise of a 3DM-GX1: 18 s at 0.3 m/s.
"""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd

import swimid
from tests.generators import imu

#: Number of runs of each row. A row has their medians.
RUNS = 5


def errors(rest_s: float, *, with_camera: bool = False) -> str:
    """Return the cells of a row: errors of speed and of the last position, and the stated 95 % band."""
    found = []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        run = imu.marching(rng, rest_s=rest_s)
        other = pd.DataFrame(imu.camera(run, rng)) if with_camera else None
        log = swimid.track_imu(pd.DataFrame(run.columns()), other=other).frame
        swims = (run.time_s > rest_s + 3) & (run.time_s < run.time_s[-1] - rest_s - 3)
        speed = (log["u_m_s"].to_numpy() - run.body_velocity[:, 0])[swims]
        path = log[["x_m", "y_m"]].to_numpy() - run.position[:, :2]
        if with_camera:  # The camera states its own origin.
            path -= path[0]
        band = 1.96 * np.hypot(log["x_sd_m"], log["y_sd_m"]).max()
        found.append((np.sqrt(np.mean(speed**2)), np.hypot(*path.T).max(), band))
    speed, place, band = np.median(found, axis=0)
    return f"{speed:.3f} m/s | {place:.2g} m | {band:.2g} m"


def rests() -> None:
    """Print the errors with rests of several lengths before and after the run, and with a camera."""
    print("| robot rests before and after | speed | position | stated 95 % band |")
    print("|---|---|---|---|")
    for rest_s in (0.0, 2.0, 5.0, 10.0):
        print(f"| {rest_s:g} s | {errors(rest_s)} |")
    print(f"| 5 s, and a camera | {errors(5.0, with_camera=True)} |")


def levers() -> None:
    """Print the false sway that a sensor ahead of the reference point shows."""
    run = imu.marching(np.random.default_rng(0), errors=imu.QUIET, rest_s=5.0)
    log = pd.DataFrame(run.columns())
    here = swimid.track_imu(log).frame["v_m_s"]
    print("| sensor ahead of the reference point | false sway, root mean square |")
    print("|---|---|")
    for lever_m in (0.02, 0.05, 0.2):
        other = swimid.track_imu(log, lever_m=(lever_m, 0.0, 0.0)).frame["v_m_s"]
        print(f"| {100 * lever_m:g} cm | {np.sqrt(np.mean((other - here) ** 2)):.3f} m/s |")


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", swimid.SwimidWarning)
        rests()
        print()
        levers()
