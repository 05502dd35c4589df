"""Films of the tutorial: a tendon fish with play in its servos swims below a camera.

The swims are those of ``gap_trials``, turned so that the fish crosses the picture from left to right. Two
colour markers are on its head. Nothing of swimid is used.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from tests.generators import film_writer, gap_trials
from tests.generators.point_films import TFISH
from validation.blind import swim_actuation, swim_files, swimmers

Array = np.ndarray
WIDTH, HEIGHT, RATE_HZ = 640, 360, 30.0
METRES_PER_PIXEL = 0.003
#: Frequency (Hz), amplitude (deg) and bias (deg) of the trials; the last is held out.
SETTINGS = (
    (1.0, 12, 0), (1.0, 25, 0), (1.0, 42, 0), (1.0, 32, 10), (1.4, 20, -12), (1.4, 30, 0), (1.8, 25, 8),
    (1.4, 25, 0),
)  # fmt: skip
#: Blue, green, red.
RED, YELLOW, HULL, FIN, WATER = (40, 40, 205), (45, 200, 225), (95, 98, 100), (130, 133, 135), (150, 130, 85)
#: Stations of the markers behind the nose, and their radius, m.
STATIONS, RADIUS = (0.02, 0.20), 0.016
#: Half widths of the links at their front ends, m; the last at the rear end of the fin.
HALF_WIDTHS = (0.02, 0.032, 0.026, 0.02, 0.006, 0.003)
#: Number of subpixels in a row of a pixel.
FINE = 4


def _outlines(x: float, y: float, yaw: float, joints: Array) -> list[tuple[Array, tuple[int, ...]]]:
    """Return the outline of each link, shape (4, 2) in m, with its colour, from the fin to the head."""
    parts, at, heading = [], np.array([x, y]), yaw
    for k, length in enumerate(TFISH.values()):
        if k:
            heading += joints[k - 1]
        ahead = np.array([np.cos(heading), np.sin(heading)])
        port = np.array([-ahead[1], ahead[0]])
        rear = at - length * ahead
        front, back = HALF_WIDTHS[k], HALF_WIDTHS[k + 1]
        outline = np.array([at + front * port, rear + back * port, rear - back * port, at - front * port])
        parts.append((outline, HULL if k < len(TFISH) - 1 else FIN))
        at = rear
    return parts[::-1]


def pictures(swim: dict[str, Array], rng: np.random.Generator) -> Iterator[Array]:
    """Yield a picture, uint8 BGR, for each row of a swim: pose in the picture and joint angles."""
    grain = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 6.0)
    light = 1 + 0.08 * np.linspace(-1, 1, WIDTH)[None, :, None]
    water = np.clip((np.array(WATER) + 6 * grain[..., None] / grain.std()) * light, 0, 255).astype(np.uint8)
    round_ = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    disc = RADIUS * np.stack([np.cos(round_), np.sin(round_)], axis=1)
    for k in range(len(swim["t_s"])):
        x, y, yaw = (float(swim[name][k]) for name in ("x_m", "y_m", "yaw_rad"))
        joints = np.array([swim[f"joint{j}_rad"][k] for j in range(1, 5)])
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        shapes = _outlines(x, y, yaw, joints)
        for station, colour in zip(STATIONS, (RED, YELLOW), strict=True):
            shapes.append((np.array([x, y]) - station * ahead + disc, colour))
        pixels = [
            (
                np.stack(
                    [points[:, 0] / METRES_PER_PIXEL, HEIGHT - 1 - points[:, 1] / METRES_PER_PIXEL], axis=1
                ),
                c,
            )
            for points, c in shapes
        ]
        whole = np.concatenate([points for points, _ in pixels])
        x0, y0 = np.maximum(np.floor(whole.min(axis=0)).astype(int) - 3, 0)
        x1, y1 = np.minimum(np.ceil(whole.max(axis=0)).astype(int) + 4, (WIDTH, HEIGHT))
        part = cv2.resize(water[y0:y1, x0:x1], None, fx=FINE, fy=FINE, interpolation=cv2.INTER_NEAREST)
        for points, colour in pixels:
            drawn = (points - (x0, y0) + 0.5) * FINE - 0.5
            cv2.fillPoly(part, [np.round(drawn * 256).astype(np.int32)], colour, shift=8)
        picture = water.copy()
        picture[y0:y1, x0:x1] = cv2.resize(part, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        picture = cv2.GaussianBlur(picture, (0, 0), 0.7).astype(float)
        yield np.clip(picture + rng.normal(0, 1.5, picture.shape), 0, 255).astype(np.uint8)


def _in_picture(swim: dict[str, Array]) -> dict[str, Array]:
    """Return a swim turned and moved so that the fish crosses the middle of the picture to the right."""
    turn = -float(np.mean(swim["yaw_rad"]))
    x = np.cos(turn) * swim["x_m"] - np.sin(turn) * swim["y_m"]
    y = np.sin(turn) * swim["x_m"] + np.cos(turn) * swim["y_m"]
    body = sum(TFISH.values())
    x += METRES_PER_PIXEL * WIDTH / 2 - (x.max() + x.min() - body) / 2
    y += METRES_PER_PIXEL * HEIGHT / 2 - (y.max() + y.min()) / 2
    return {**swim, "x_m": x, "y_m": y, "yaw_rad": swim["yaw_rad"] + turn}


def write_sample(folder: Path) -> None:
    """Write the films, the table of the trials, and coefficients that were identified on another day."""
    folder.mkdir(parents=True, exist_ok=True)
    seed = gap_trials.SEED
    rng = np.random.default_rng([seed, 1])
    trials = gap_trials.plan("tfish", SETTINGS, 10.0, RATE_HZ, seed)
    coefficients = swimmers.truth("tfish", rng)
    backlash = swim_actuation.servo_backlash(np.random.default_rng(seed), gap_trials.SIZE, "tfish")
    noise, rows = gap_trials.tracking("tfish"), []
    for number, trial in enumerate(trials):
        if backlash.start is not None:
            backlash.start(trial, rng)
        swim = _in_picture(swimmers.swim(trial, coefficients, [backlash]))
        # Ripples of the surface move the picture of the fish.
        ripples = trial.rng("noise")
        for name in ("x_m", "y_m", "yaw_rad"):
            swim[name] = swim[name] + 0.5 * noise.draw(name, len(swim["t_s"]), ripples)
        film_writer.write(
            folder / f"{trial.id}.mp4", pictures(swim, np.random.default_rng([seed, 7, number])),
            size=(WIDTH, HEIGHT), times=swim["t_s"], rate_hz=RATE_HZ, crf=24, preset="slow",
        )  # fmt: skip
        role = "fit" if number < len(SETTINGS) - 1 else "validate"
        rows.append((trial.id, *SETTINGS[number], role, "rest"))
    names = ["film", "frequency_hz", "amplitude_deg", "bias_deg", "role", "start_state"]
    pd.DataFrame(rows, columns=names).to_csv(folder / "trials.csv", index=False)
    swim_files.write_prior(folder / "march.yaml", "tfish", coefficients, swimmers.FITTED["tfish"], rng)
