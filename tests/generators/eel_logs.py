"""The logs of docs/examples/eel, which `docs/learn/own-robot.md` walks through.

    python -m tests.generators.eel_logs

An eel of the independent simulator (`swimmer`) with a wave that grows towards the tail and a springy
tail tip, its head followed by a camera.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.generators import swimmer

FOLDER = Path(__file__).parents[2] / "docs" / "examples" / "eel"
#: What the fit is to find; the last is the stiffness of the tail tip, N m/rad.
TRUTH = {"c_ma": 0.8, "c_Ia": 0.6, "c_d": 1.8, "c_f": 0.03, "k_tail": 0.12}
GAIN = np.array([0.4, 0.55, 0.7, 0.85, 1.0, 0.0])
NOISE = {"x_m": 0.002, "y_m": 0.002, "yaw_rad": np.radians(0.5), "joint6_rad": np.radians(0.5)}
RATE_HZ, DURATION_S, SEED = 25.0, 12.0, 100
#: Trial: drive and role.
DRIVES = {
    "slow": ({"frequency_hz": 0.7, "amplitude_deg": 30.0}, "fit"),
    "fast": ({"frequency_hz": 1.3, "amplitude_deg": 25.0}, "fit"),
    "turn": ({"frequency_hz": 1.0, "amplitude_deg": 25.0, "bias_deg": 10.0}, "fit"),
    "middle": ({"frequency_hz": 1.0, "amplitude_deg": 30.0}, "validate"),
}


def eel() -> swimmer.Swimmer:
    coefficients = {name: value for name, value in TRUTH.items() if name != "k_tail"}
    return replace(swimmer.eel(coefficients), gain=GAIN, passive={5: lambda angle: -TRUTH["k_tail"] * angle})


def write(folder: Path, seed: int = SEED) -> Path:
    """Logs and trials file, whose robot is ``../eel.yaml``."""
    animal = eel()
    runs = [
        swimmer.Run(name, drive, swimmer.swim(animal, drive, DURATION_S, rate_hz=RATE_HZ), role)
        for name, (drive, role) in DRIVES.items()
    ]
    return swimmer.write_trials(folder, "eel", runs, NOISE, seed, columns=list(NOISE), robot="../eel.yaml")


if __name__ == "__main__":
    print(write(FOLDER))
