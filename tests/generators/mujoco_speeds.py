"""Final speeds of an exported robot in MuJoCo, beside those of swimid, with the time that both take.

``python -m tests.generators.mujoco_speeds trials.yaml fish.yaml`` runs the drive of each trial from rest for
30 s. Both compute the displacement over the last four beats. The servo of 20 Hz and the step are the
defaults of ``swimid export --to mjcf``.
"""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path

import mujoco
import numpy as np
import yaml

import swimid
from swimid.exporters import mjcf

#: Duration of each run, s, and number of beats at its end whose displacement gives the speed.
DURATION_S, BEATS = 30.0, 4


def run(model: mujoco.MjModel, frequency_hz: float, amplitude_rad: float) -> float:
    """Return the final speed of a model whose only actuator beats as a sine, m/s."""
    data = mujoco.MjData(model)
    places = []
    for _ in range(round(DURATION_S / model.opt.timestep)):
        data.ctrl[0] = amplitude_rad * np.sin(2 * np.pi * frequency_hz * data.time)
        mujoco.mj_step(model, data)
        places.append(data.qpos[:2].copy())
    rows = round(BEATS / frequency_hz / model.opt.timestep)
    moved = places[-1] - places[-1 - rows]
    return float(np.hypot(*moved) / (rows * model.opt.timestep))


def simulated(params: Path, frequency_hz: float, amplitude_deg: float) -> float:
    """Return the final speed by swimid, m/s."""
    drive = {"frequency_hz": frequency_hz, "amplitude_deg": amplitude_deg, "ramp_s": 0.0}
    log = swimid.simulate(params=params, duration_s=DURATION_S, **drive).frame
    rows = log["t_s"].to_numpy() <= DURATION_S - BEATS / frequency_hz
    place = log[["x_m", "y_m"]].to_numpy()
    return float(np.hypot(*(place[-1] - place[rows][-1])) * frequency_hz / BEATS)


def main(trials: Path, params: Path) -> None:
    """Print speeds and times of all drives of a trials file."""
    warnings.simplefilter("ignore")
    drives = {entry["id"]: entry["drive"] for entry in yaml.safe_load(trials.read_text())["trials"]}
    text = swimid.export(params, to="mjcf", added_mass="fold").text
    mujoco.set_mjcb_passive(None)
    model = mujoco.MjModel.from_xml_string(text)
    mujoco.set_mjcb_passive(mjcf.water(model))
    print("trial   swimid m/s   MuJoCo m/s   swimid s   MuJoCo s")
    for name, drive in drives.items():
        hertz, degrees = drive["frequency_hz"], drive["amplitude_deg"]
        begin = time.perf_counter()
        own = simulated(params, hertz, degrees)
        middle = time.perf_counter()
        theirs = run(model, hertz, np.radians(degrees))
        end = time.perf_counter()
        print(f"{name:7s} {own:10.4f} {theirs:12.4f} {middle - begin:10.2f} {end - middle:10.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
