"""Attack on ``init``: folders with damaged recordings of all kinds under hostile names."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np

from tests.conftest import SAMPLES
from validation.faults.readers import FOREIGN, PIECES, _made
from validation.faults.runner import Attack, command, mutated

NAMES = ("a", "film", "run 1", "ü ñ", "-x", "x'y", "$(id)", "a\nb", "*star", "[b]", "{c}", "ASK", "#")
ENDINGS = (
    ".csv",
    ".txt",
    ".mp4",
    ".h5",
    ".mat",
    ".parquet",
    ".json",
    ".mcap",
    ".xlsx",
    ".yaml",
    ".png",
    "",
    ".nc",
)


def _folder(rng: np.random.Generator, folder: Path) -> bool:
    samples = [path for path in sorted(SAMPLES.rglob("*")) if path.is_file()]
    lab = folder / "lab"
    for old in (lab, folder / "project"):
        shutil.rmtree(old, ignore_errors=True)
    lab.mkdir()
    for number in range(12):
        if rng.random() < 0.5:
            name, make, _ = FOREIGN[int(rng.integers(len(FOREIGN)))]
            ending, valid = Path(name).suffix, _made(name, make)
        else:
            source = samples[int(rng.integers(len(samples)))]
            ending, valid = source.suffix, source.read_bytes()
        if rng.random() < 0.3:
            ending = ENDINGS[int(rng.integers(len(ENDINGS)))]
        data = mutated(valid, rng, PIECES) if rng.random() < 0.7 else valid
        (lab / f"{NAMES[int(rng.integers(len(NAMES)))]}{number}{ending}").write_bytes(data)
    os.symlink(lab.resolve(), lab / "loop")
    os.symlink(folder / "nowhere", lab / "dangling.csv")
    os.mkfifo(lab / "pipe.csv")
    return command("init", lab, "-o", "project")[0] == 0


ATTACKS = [Attack("folder: init", _folder, count=60, time_s=120.0)]
