"""Write ``sample_logs``: ``python -m tests.generators.make_samples [FOLDER]``."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.generators import (
    cruise,
    gap_trials,
    longfin,
    mujoco_robots,
    polled_camera,
    pool_video,
    rig,
    sealion,
    swimmer,
    tutorial_films,
)  # fmt: skip


def main(folder: Path) -> None:
    """Every sample, each in a folder of its own."""
    rig.write_sample(folder / "rig")
    cruise.write_sample(folder / "cruise")
    longfin.write_sample(folder / "longfin")
    pool_video.write_sample(folder / "pool")
    swimmer.write_sample(folder / "tfish")
    gap_trials.write_sample(folder / "gap")
    polled_camera.write_sample(folder / "camera")
    sealion.write_sample(folder / "sealion")
    tutorial_films.write_sample(folder / "tutorial")
    mujoco_robots.write_sample(folder / "simulator")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "sample_logs")
