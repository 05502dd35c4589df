"""Attack on the reader of films: a film cut off, or with bits flipped."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from tests.conftest import SAMPLES
from validation.faults.runner import Attack, command

FILM, SETUP = SAMPLES / "pool" / "pool.mp4", SAMPLES / "pool" / "pool_setup.yaml"


def _film(rng: np.random.Generator, folder: Path, *, cut: bool) -> bool:
    data = bytearray(FILM.read_bytes())
    if cut:
        del data[int(rng.integers(0, len(data))) :]
    else:
        for at in rng.integers(0, len(data), int(rng.integers(1, 50))):
            data[at] ^= 1 << int(rng.integers(0, 8))
    (folder / "film.mp4").write_bytes(data)
    return command("track", "video", "film.mp4", "--setup", SETUP, "-o", "track.csv", "--force")[0] == 0


ATTACKS = [
    Attack("film: cut off", partial(_film, cut=True), count=20, time_s=60.0),
    Attack("film: bits flipped", partial(_film, cut=False), count=20, time_s=60.0),
]
