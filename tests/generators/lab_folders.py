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
