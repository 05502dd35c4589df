"""Folders of recordings as laboratories leave them: films, tables of a tracker, rig logs, a mixture."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd

from tests.generators import archive, point_films

SAMPLES = Path(__file__).parents[2] / "sample_logs"
#: Pulling masses of the rig logs, kg, by the name of the log.
MASSES = {f"drop{k}": mass for k, mass in enumerate((0.01, 0.015, 0.02, 0.025, 0.03, 0.035, 0.04), 1)}


def films(folder: Path) -> None:
    """Write two films of one camera and a file that is no recording."""
    folder.mkdir(parents=True)
    for seed in (1, 2):
        archive.write_film(folder / f"swim {seed}.mp4", seed)
    (folder / "todo.docx").write_bytes(b"PK")


def tracked(folder: Path, *, films: bool = False) -> None:
    """Write two tables of DeepLabCut of a fish, with or without their films."""
    folder.mkdir(parents=True)
    for seed in (1, 2):
        made = point_films.film(seed=seed, frames=60 if films else 360)
        point_films.write_deeplabcut(made, folder / f"fish{seed}DLC_resnet50.csv")
        if films:
            archive.write_film(folder / f"fish{seed}.mp4", seed)


def rig(folder: Path, *, notes: bool = True) -> None:
    """Write the logs of the sample rig in ms and mm, in folders by day, with a table of their masses."""
    for (name, _), source in zip(MASSES.items(), sorted((SAMPLES / "rig").glob("*.csv")), strict=True):
        log = pd.read_csv(source, comment="#")
        table = pd.DataFrame({"Time (ms)": 1000 * log["t_s"], "x [mm]": 1000 * log["x_m"]})
        day = folder / ("monday", "tuesday")[name > "drop3"]
        day.mkdir(parents=True, exist_ok=True)
        table.to_csv(day / f"{name}.txt", sep=";", index=False)
    if notes:
        roles = ["validate" if name == "drop4" else "fit" for name in MASSES]
        table = pd.DataFrame({"file": list(MASSES), "pulling_mass_kg": MASSES.values(), "role": roles})
        table.to_csv(folder / "weights.csv", index=False)


def mixture(folder: Path) -> None:
    """Write films, rig logs, tables of DeepLabCut, logs of swimid, a cruise table and a damaged film."""
    films(folder / "films")
    rig(folder / "rig", notes=False)
    tracked(folder / "tracked")
    shutil.copytree(SAMPLES / "tfish", folder / "swims")
    (folder / "cruise").mkdir()
    shutil.copy(SAMPLES / "cruise/speeds.csv", folder / "cruise")
    (folder / "films/cut.mp4").write_bytes((folder / "films/swim 1.mp4").read_bytes()[:5000])
    rng = np.random.default_rng(4)
    (folder / "noise.bin").write_bytes(rng.bytes(400))


def one_robot(folder: Path) -> None:
    """Write logs of a camera, commands on another clock, inertial logs and a table of the swims.

    The heading follows the command of the first joint by 0.1 s.
    """
    folder.mkdir(parents=True)
    rng = np.random.default_rng(8)
    for number, frequency in enumerate((0.8, 1.2, 1.6, 1.2), 1):
        time = np.arange(0.0, 12.0, 1 / 30)

        def beat(time: np.ndarray, frequency: float = frequency) -> np.ndarray:
            swelling = np.clip(time - 1.5, 0, 1) * np.clip(10.5 - time, 0, 1)
            return swelling * np.sin(2 * np.pi * frequency * (time - 1.5))

        log = pd.DataFrame({"t_s": time, "x_m": 0.1 * np.clip(time - 1.5, 0, None), "y_m": 0.5})
        log["yaw_rad"] = 0.1 * beat(time - 0.1)
        log[["x_m", "y_m", "yaw_rad"]] += 1e-3 * rng.normal(size=(len(time), 3))
        log.to_csv(folder / f"swim{number}.csv", index=False, float_format="%.6f")
        late = 0.2 + 0.2 * number
        clock = np.arange(0.0, 13.0, 0.02)
        board = pd.DataFrame({"millis": np.round(1000 * clock + 45000 * number).astype(int)})
        for joint in (1, 2, 3):
            board[f"cmd{joint}_deg"] = np.round(25 * beat(clock - late - 0.02 * joint + 0.02), 2)
        board.to_csv(folder / f"swim{number}_arduino.txt", sep=";", index=False)
        inertial = pd.DataFrame({"time_ms": np.arange(0, 12000, 10)})
        for name in ("ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps"):
            inertial[name] = np.round((name == "az_g") + 0.01 * rng.normal(size=len(inertial)), 4)
        inertial.to_csv(folder / f"swim{number}_imu.csv", index=False)
    (folder / "swims.csv").write_text(
        "film;frequency Hz;amplitude deg;bias deg;arduino log;comment\n"
        + "".join(
            f"swim{k}.csv;{hz};25;0;swim{k}_arduino.txt;straight\n"
            for k, hz in enumerate((0.8, 1.2, 1.6, 1.2), 1)
        )
    )
