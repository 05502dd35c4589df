"""An archive of a laboratory with films, rig recordings, cruise tables and logs, and a plan for all of it.

Some items are damaged: a film that is cut, and a rig without one of its logs. One film is of a faster swim.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd

from tests.generators import cruise, files, film_writer, rig
from validation.coverage.tracks import HEIGHT, METRES_PER_PIXEL, RATE_HZ, WIDTH, Camera, Swim

SETUP = f"""format: swimid-setup/1
markers:
  - {{name: red, hsv: {{hue_deg: [345, 15], saturation: [0.45, 1], value: [0.3, 1]}}}}
  - {{name: yellow, hsv: {{hue_deg: [40, 75], saturation: [0.4, 1], value: [0.35, 1]}}}}
head: red
tail: yellow
scale: {{metres_per_pixel: {METRES_PER_PIXEL}}}
"""

PLAN = """format: swimid-plan/1
limits: {time_s: 300}
steps: [fit-drag, compare, report]
items:
  - {name: films, files: films/*.mp4, steps: [{track video: {setup: camera.yaml}}, plot]}
  - {name: rigs, files: rigs/*/trials.yaml}
  - {name: cruises, files: cruises/*/trials.yaml, steps: [{fit-propulsion: {drag: drag.yaml}}]}
  - {name: swims, files: swims/*/trials.yaml, steps: [{fit-graybox: {starts: 1}}, compare, report]}
  - {name: logs, files: logs/*.csv, steps: [{rwls: {input: cmd1_rad, output: u_m_s, na: 2, nb: 1}}]}
overrides:
  films/film00.mp4: {track video: {max-gap: 0.5}}
"""


def write_film(path: Path, seed: int, *, duration_s: float = 2.0) -> None:
    """Write a film of a robot with two discs that swims along a gentle curve."""
    rng = np.random.default_rng([seed, 3])
    swim, camera = Swim.draw(rng), Camera.draw(rng, tilted=False)
    stamps = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    film_writer.write(
        path, camera.pictures(swim, stamps, rng), size=(WIDTH, HEIGHT), times=stamps, rate_hz=RATE_HZ, crf=18
    )


def write_log(path: Path, seed: int) -> None:
    """Write a log of a second-order system that noise drives."""
    rng = np.random.default_rng([seed, 4])
    command, noise = rng.normal(size=400), 0.02 * rng.normal(size=400)
    speed = np.zeros(400)
    for k in range(2, 400):
        speed[k] = 1.5 * speed[k - 1] - 0.7 * speed[k - 2] + 0.2 * command[k - 1] + noise[k]
    files.write_log(path, {"t_s": 0.02 * np.arange(400), "cmd1_rad": command, "u_m_s": speed}, "%.9g")


def write_swims(folder: Path, seed: int) -> None:
    """Write the sample trials of the tendon fish with more noise."""
    rng = np.random.default_rng([seed, 5])
    folder.mkdir(parents=True)
    source = Path(__file__).parents[2] / "sample_logs/tfish"
    (folder / "trials.yaml").write_text((source / "trials.yaml").read_text())
    for path in source.glob("*.csv"):
        head = [line for line in path.read_text().splitlines() if line.startswith("#")]
        table = pd.read_csv(path, comment="#")
        noise = {"x_m": 0.0005, "y_m": 0.0005, "yaw_rad": 0.002}
        for name, sd in noise.items():
            table[name] += sd * rng.normal(size=len(table))
        (folder / path.name).write_text("\n".join([*head, table.to_csv(index=False, float_format="%.9g")]))


def write(folder: Path, items: int, drag: str) -> Path:
    """Write an archive with a number of items and its plan, and return the path of the plan.

    ``drag`` is the text of the drag file that the cruises need. Of twelve items, four are films, three rigs,
    two cruises, two logs and one swims. The second film is cut and the second rig lacks a log.
    """
    for name in ("films", "rigs", "cruises", "logs", "swims"):
        (folder / name).mkdir(parents=True)
    (folder / "plan.yaml").write_text(PLAN)
    (folder / "camera.yaml").write_text(SETUP)
    (folder / "drag.yaml").write_text(drag)
    order = ["film", "rig", "cruise", "log", "film", "rig", "film", "rig", "cruise", "log", "swim", "film"]
    kinds = itertools.cycle(order)
    counts = dict.fromkeys(order, 0)
    for kind in itertools.islice(kinds, items):
        number = counts[kind]
        counts[kind] += 1
        name = f"{kind}{number:02d}"
        if kind == "film":
            write_film(folder / "films" / f"{name}.mp4", number)
        elif kind == "swim":
            write_swims(folder / "swims" / name, number)
        elif kind == "log":
            write_log(folder / "logs" / f"{name}.csv", number)
        else:
            place = folder / f"{kind}s" / name
            place.mkdir()
            {"rig": rig, "cruise": cruise}[kind].write_sample(place, seed=number)
    if counts["film"] > 1:
        film = folder / "films" / "film01.mp4"
        film.write_bytes(film.read_bytes()[: film.stat().st_size // 2])
    if counts["rig"] > 1:
        (folder / "rigs" / "rig01" / "w20.csv").unlink()
    return folder / "plan.yaml"
