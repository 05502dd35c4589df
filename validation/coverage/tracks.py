"""Coverage of the 95 % bands of position and heading on rendered films.

Each seed renders a film of a robot with a red and a yellow disc three times: under a camera that looks
straight down, under a tilted camera whose calibration points are known to a fraction of a pixel, and by a
slow camera whose pictures a recorder repeats. Everything is drawn here; nothing of the tracker is used.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

import swimid
from tests.generators import film_writer

Array = np.ndarray
REPEATS = 60
KINDS = ("straight", "tilted", "repeated")
WIDTH, HEIGHT, RATE_HZ, DURATION_S = 320, 240, 30.0, 3.5
METRES_PER_PIXEL = 0.002
#: Blue, green, red.
RED, YELLOW, HULL, WATER = (40, 40, 205), (45, 200, 225), (75, 80, 82), (150, 130, 85)


@dataclass(frozen=True)
class Swim:
    """A swim on a gentle curve; lengths in m, the head marker is the reference point."""

    start: Array
    heading: float
    speed: float
    turn: float
    beat_hz: float
    yaw_amplitude: float
    sway_amplitude: float
    phase: float
    separation: float
    radius: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Swim:
        """Draw a swim through the middle of the tank."""
        heading, speed = rng.uniform(-np.pi, np.pi), rng.uniform(0.03, 0.09)
        turn, duration = rng.uniform(-0.3, 0.3), DURATION_S
        way = 0.5 * speed * duration * np.array([np.cos(heading), np.sin(heading)])
        middle = METRES_PER_PIXEL * np.array([WIDTH, HEIGHT]) / 2
        separation = rng.uniform(0.07, 0.11)
        back = 0.5 * separation * np.array([np.cos(heading), np.sin(heading)])
        start = middle + rng.uniform(-0.03, 0.03, 2) - way + back
        return cls(
            start, heading, speed, turn, rng.uniform(0.8, 2.0), rng.uniform(0.03, 0.15),
            rng.uniform(0.002, 0.012), rng.uniform(0, 2 * np.pi), separation, rng.uniform(0.010, 0.017),
        )  # fmt: skip

    def pose(self, time: Array) -> tuple[Array, Array]:
        """Return the head marker, shape (2, n), and the heading, shape (n,)."""
        course = self.heading + self.turn * (time - DURATION_S / 2)
        mean = self.heading + self.turn * (np.array([0.0]) - DURATION_S / 2)
        x, y = np.sin(course) - np.sin(mean), np.cos(mean) - np.cos(course)
        beat = 2 * np.pi * self.beat_hz * time + self.phase
        sway = self.sway_amplitude * np.sin(beat)
        place = self.start[:, None] + self.speed / self.turn * np.stack([x, y])
        place = place + sway * np.stack([-np.sin(course), np.cos(course)])
        return place, course + self.yaw_amplitude * np.cos(beat + 0.4)


@dataclass(frozen=True)
class Camera:
    """A picture of the plane: world to pixels by a homography, noise and light."""

    matrix: Array
    noise: float
    blur: float
    light: Array
    #: Change of the light from one side of a disc to the other, as a share, in columns and rows.
    shading: Array
    texture: Array
    crf: float

    @classmethod
    def draw(cls, rng: np.random.Generator, *, tilted: bool) -> Camera:
        """Draw a camera; the tilted one sees the tank's rectangle as a quadrangle."""
        world = METRES_PER_PIXEL * np.array(
            [[0, 0], [WIDTH - 1, 0], [WIDTH - 1, HEIGHT - 1], [0, HEIGHT - 1]]
        )
        seen = np.array([[0, HEIGHT - 1], [WIDTH - 1, HEIGHT - 1], [WIDTH - 1, 0], [0, 0]], float)
        if tilted:
            far = rng.uniform(0.05, 0.15)
            seen[2:] += far * WIDTH * np.array([[-1, 0.3], [1, 0.3]])
            seen += rng.uniform(-6, 6, (4, 2))
        matrix = cv2.getPerspectiveTransform(world.astype(np.float32), seen.astype(np.float32))
        grain = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), rng.uniform(2, 5))
        slope = rng.uniform(-0.15, 0.15, 2)
        x, y = np.meshgrid(np.linspace(-1, 1, WIDTH), np.linspace(-1, 1, HEIGHT))
        return cls(
            matrix, rng.uniform(1, 6), rng.uniform(0.5, 1.2), 1 + slope[0] * x + slope[1] * y,
            rng.uniform(-0.25, 0.25, 2),
            grain / grain.std() * rng.uniform(1, 6), rng.uniform(12, 22),
        )  # fmt: skip

    def to_image(self, points: Array) -> Array:
        """Return the pixels of points of the plane, shape (n, 2)."""
        return cv2.perspectiveTransform(np.asarray(points, float).reshape(-1, 1, 2), self.matrix).reshape(
            -1, 2
        )

    def pictures(self, swim: Swim, times: Array, rng: np.random.Generator) -> Iterator[Array]:
        """Yield the picture of each time, uint8 BGR; equal times give one picture, with its noise, again."""
        water = (np.array(WATER, float) + self.texture[..., None]) * self.light[..., None]
        noise = rng.normal(0, self.noise, (HEIGHT + 64, WIDTH + 64, 3))
        round_ = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        circle = np.stack([np.cos(round_), np.sin(round_)], axis=1)
        fine, last, picture = 4, None, water
        places, headings = swim.pose(times)
        for time, place, heading in zip(times, places.T, headings, strict=True):
            if time != last:
                forward = np.array([np.cos(heading), np.sin(heading)])
                axes = np.stack([forward, [-forward[1], forward[0]]])
                tail = place - swim.separation * forward
                middle = (place + tail) / 2
                half = np.array([0.5 * swim.separation + 3 * swim.radius, 2.4 * swim.radius])
                discs = (
                    (middle + (circle * half) @ axes, HULL),
                    (place + swim.radius * circle, RED),
                    (tail + swim.radius * circle, YELLOW),
                )
                corners = np.concatenate([self.to_image(outline) for outline, _ in discs])
                x0, y0 = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 6, 0)
                x1, y1 = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 7, (WIDTH, HEIGHT))
                part = cv2.resize(
                    water[y0:y1, x0:x1], None, fx=fine, fy=fine, interpolation=cv2.INTER_NEAREST
                )
                for outline, shade in discs:
                    drawn = (self.to_image(outline) - (x0, y0) + 0.5) * fine - 0.5
                    cover = np.zeros(part.shape[:2], np.uint8)
                    cv2.fillPoly(cover, [np.round(drawn * 256).astype(np.int32)], 1, shift=8)
                    row, column = np.nonzero(cover)
                    inside = np.stack([column, row], axis=1) - drawn.mean(axis=0)
                    part[row, column] = (1 + inside @ self.shading / np.ptp(drawn))[:, None] * shade
                picture = water.copy()
                picture[y0:y1, x0:x1] = cv2.resize(part, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
                picture = cv2.GaussianBlur(picture, (0, 0), self.blur)
                dx, dy = rng.integers(0, 64, 2)
                picture = picture + noise[dy : dy + HEIGHT, dx : dx + WIDTH]
                picture, last = np.clip(picture + 0.5, 0, 255).astype(np.uint8), time
            yield picture


def shares_inside(log: pd.DataFrame, swim: Swim) -> dict[str, float]:
    """Return the share of samples of x, y and yaw whose error is within 1.96 stated standard deviations."""
    place, heading = swim.pose(log.t_s.to_numpy())
    out = {}
    for name, unit, true in (("x", "m", place[0]), ("y", "m", place[1]), ("yaw", "rad", heading)):
        error = log[f"{name}_{unit}"] - true
        if name == "yaw":
            error = (error + np.pi) % (2 * np.pi) - np.pi
        known = np.isfinite(error)
        out[name] = float(np.mean(np.abs(error[known]) <= 1.96 * log[f"{name}_sd_{unit}"][known]))
    return out


def track(swim: Swim, camera: Camera, times: Array, scale: dict, rng: np.random.Generator) -> pd.DataFrame:
    """Render the pictures taken at ``times`` into a film at the frame rate, and return the log of it."""
    setup = {
        "markers": [
            {"name": "red", "hsv": {"hue_deg": [345, 15], "saturation": [0.45, 1], "value": [0.3, 1]}},
            {"name": "yellow", "hsv": {"hue_deg": [40, 75], "saturation": [0.4, 1], "value": [0.35, 1]}},
        ],
        "head": "red", "tail": "yellow", "scale": scale,
    }  # fmt: skip
    stamps = np.arange(len(times)) / RATE_HZ
    with tempfile.TemporaryDirectory() as folder:
        film = film_writer.write(
            Path(folder) / "film.mp4", camera.pictures(swim, times, rng), size=(WIDTH, HEIGHT),
            times=stamps, rate_hz=RATE_HZ, crf=camera.crf,
        )  # fmt: skip
        return swimid.track_video(film, setup=setup).frame


def one(seed: int) -> dict[str, float]:
    """Return the share of true values inside the stated band, by camera and quantity."""
    rng = np.random.default_rng([seed, 17])
    stamps = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
    straight, out = {"metres_per_pixel": METRES_PER_PIXEL}, {}
    for kind in KINDS:
        swim, camera, times, scale = (
            Swim.draw(rng),
            Camera.draw(rng, tilted=kind == "tilted"),
            stamps,
            straight,
        )
        if kind == "tilted":
            count = int(rng.integers(6, 10))
            marks = METRES_PER_PIXEL * rng.uniform(0.02, 0.98, (count - 4, 2)) * (WIDTH, HEIGHT)
            corners = np.array([[0.05, 0.05], [0.95, 0.05], [0.95, 0.95], [0.05, 0.95]])
            marks = np.concatenate([METRES_PER_PIXEL * corners * (WIDTH, HEIGHT), marks])
            clicked = camera.to_image(marks) + rng.normal(0, rng.uniform(0.1, 0.5), marks.shape)
            scale = {"points_px": clicked.tolist(), "points_m": marks.tolist()}
        elif kind == "repeated":
            rate, first = rng.uniform(11, 26), rng.uniform(0, 1)
            times = (np.floor(stamps * rate + first) - first) / rate
        log = track(swim, camera, times, scale, rng)
        out |= {f"{kind} {name}": share for name, share in shares_inside(log, swim).items()}
    return out
