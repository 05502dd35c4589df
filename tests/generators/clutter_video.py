"""Small films of a pool with things in it that are no markers: a rule, a ball of two colours, a grey fish.

A camera looks straight down; the surface ripples, so that what lies on the floor wobbles, and an uneven
light flickers over everything. Everything is drawn here with numpy; nothing of the tracker is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tests.generators import film_writer

RED, YELLOW, GREEN, WHITE, BLACK, GREY = (
    (38, 38, 205),
    (45, 200, 225),
    (60, 190, 50),
    (238, 240, 240),
    (16, 16, 18),
    (92, 94, 96),
)
DARK = (70, 60, 44)
#: Pixels are drawn this many times finer, and averaged.
_FINE = 3
#: Where a thing is at a time, px, and how it is turned, rad.
Motion = Callable[[float], tuple[float, float, float]]


@dataclass(frozen=True)
class Thing:
    """Something in the pool.

    Attributes
    ----------
    motion : callable
        Time (s) to x, y (px) and turn (rad).
    paint : callable
        Coordinates of the body (ahead, to the right, px, each shape (r, c)) and the time to the shape
        (bool, (r, c)) and the colours (BGR, (r, c, 3)).
    reach : float
        It is drawn within this distance of its place, px.
    """

    motion: Motion
    paint: Callable[[np.ndarray, np.ndarray, float], tuple[np.ndarray, np.ndarray]]
    reach: float


@dataclass(frozen=True)
class Pool:
    """A film. Lengths in px, times in s."""

    things: tuple[Thing, ...]
    width: int = 320
    height: int = 240
    duration_s: float = 3.0
    rate_hz: float = 20.0
    #: Largest shift of what is seen by the ripples, px.
    ripple_px: float = 0.0
    #: Swing of the light over places and times, as a share.
    flicker: float = 0.08
    noise: float = 2.0
    water: tuple[int, int, int] = (150, 122, 70)
    seed: int = 3
    crf: int = 14
    #: Swing of the whole picture, px: a camera on a pole.
    sway_px: float = 0.0
    #: Size at the upper edge over that at the lower one, and height of the picture over that of the pool: a
    #: camera that looks down askew.
    far: float = 1.0
    flat: float = 1.0
    waves: int = 4

    def times(self) -> np.ndarray:
        """Time of each frame, s."""
        return np.arange(round(self.duration_s * self.rate_hz)) / self.rate_hz


def still(x: float, y: float, turn: float = 0.0) -> Motion:
    """It stays."""
    return lambda t: (x, y, turn)


def straight(x: float, y: float, vx: float, vy: float, *, sway: float = 0.0, beat_hz: float = 1.5) -> Motion:
    """Constant speed, with a swing of ``sway`` px across the path."""
    speed = math.hypot(vx, vy)

    def at(t: float) -> tuple[float, float, float]:
        across = sway * math.sin(2 * math.pi * beat_hz * t) / speed
        return x + vx * t - vy * across, y + vy * t + vx * across, math.atan2(vy, vx)

    return at


def circle(x: float, y: float, radius: float, period_s: float) -> Motion:
    """Round a point, turned along the path."""

    def at(t: float) -> tuple[float, float, float]:
        angle = 2 * math.pi * t / period_s
        return x + radius * math.cos(angle), y + radius * math.sin(angle), angle + math.pi / 2

    return at


def _solid(inside: np.ndarray, colour: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    return inside, np.broadcast_to(np.array(colour, np.float32), (*inside.shape, 3))


def disc(motion: Motion, radius: float, colour: tuple[int, int, int], ahead: float = 0.0) -> Thing:
    """A disc, ``ahead`` px in front of the place of what it sits on."""
    return Thing(
        motion, lambda u, v, t: _solid((u - ahead) ** 2 + v**2 < radius**2, colour), radius + abs(ahead) + 3
    )


def rule(motion: Motion, length: float, breadth: float, colour: tuple[int, int, int]) -> Thing:
    """A rule with dark marks every twelve pixels."""

    def paint(u: np.ndarray, v: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        inside, colours = _solid((np.abs(u) < length / 2) & (np.abs(v) < breadth / 2), colour)
        marks = (np.mod(u, 12) < 1.5) & (v > 0)
        return inside, np.where(marks[..., None], np.float32(30), colours)

    return Thing(motion, paint, length / 2 + 3)


def fish(motion: Motion, length: float = 70.0, breadth: float = 24.0) -> Thing:
    """A grey body without a marker."""
    return Thing(
        motion,
        lambda u, v, t: _solid((2 * u / length) ** 2 + (2 * v / breadth) ** 2 < 1, GREY),
        length / 2 + 3,
    )


def ball(
    motion: Motion,
    radius: float,
    colours: tuple[tuple[int, int, int], tuple[int, int, int]],
    *,
    nod_rad: float,
    nod_hz: float = 0.7,
) -> Thing:
    """A ball of two halves; the line between their poles nods out of the picture's plane and back."""

    def paint(u: np.ndarray, v: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        up = np.sqrt(np.maximum(radius**2 - u**2 - v**2, 0))
        nod = nod_rad * math.sin(2 * math.pi * nod_hz * t)
        front = u * math.cos(nod) + up * math.sin(nod) > 0
        a, b = (np.array(c, np.float32) for c in colours)
        return u**2 + v**2 < radius**2, np.where(front[..., None], a, b)

    return Thing(motion, paint, radius + 3)


def frames(pool: Pool) -> list[np.ndarray]:
    """The pictures, uint8 BGR."""
    rng = np.random.default_rng(pool.seed)
    w, h = pool.width, pool.height
    column, row = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    floor = cv2.GaussianBlur(rng.normal(0, 30, (h, w)).astype(np.float32), (0, 0), 3)
    base = np.float32(pool.water) + floor[..., None]
    # Plane waves: number a pixel, direction, rate and phase.
    waves = [
        (rng.uniform(0.08, 0.2), rng.uniform(0, 2 * np.pi), rng.uniform(4, 9), rng.uniform(0, 2 * np.pi))
        for _ in range(pool.waves)
    ]
    out = []
    for t in pool.times():
        image = base.copy()
        for thing in pool.things:
            _draw(image, thing, float(t))
        slope = [np.zeros((h, w), np.float32), np.zeros((h, w), np.float32)]
        light = np.zeros((h, w), np.float32)
        for number, way, rate, phase in waves:
            along = np.float32(number) * (column * math.cos(way) + row * math.sin(way))
            angle = along + np.float32(rate * t + phase)
            light += np.sin(angle)
            steep = np.cos(angle)
            for axis, part in enumerate((math.cos(way), math.sin(way))):
                slope[axis] += part * steep
        light *= pool.flicker / math.sqrt(pool.waves)
        swing = pool.sway_px * math.sin(2 * math.pi * 0.45 * t)
        if pool.ripple_px or swing:
            dx, dy = (pool.ripple_px * s / math.sqrt(pool.waves) for s in slope)
            image = cv2.remap(
                image, column + dx + swing, row + dy, cv2.INTER_LINEAR, None, cv2.BORDER_REFLECT
            )
        if pool.far != 1.0 or pool.flat != 1.0:
            image = cv2.warpPerspective(image, _askew(pool), (w, h), borderMode=cv2.BORDER_REPLICATE)
        image *= 1 + light[..., None]
        image += np.float32(pool.noise) * rng.standard_normal(image.shape, dtype=np.float32)
        out.append(np.clip(image + 0.5, 0, 255).astype(np.uint8))
    return out


def _askew(pool: Pool) -> np.ndarray:
    """Homography from the view straight down to that askew, shape (3, 3)."""
    w, h, inset = pool.width, pool.height, 0.5 * pool.width * (1 - pool.far)
    top = 0.5 * h * (1 - pool.flat)
    whole = np.float32([[0, 0], [w, 0], [w, h], [0, h]])
    seen = np.float32([[inset, top], [w - inset, top], [w, h - top], [0, h - top]])
    return cv2.getPerspectiveTransform(whole, seen)


def _draw(image: np.ndarray, thing: Thing, t: float) -> None:
    x, y, turn = thing.motion(t)
    h, w = image.shape[:2]
    x0, y0 = max(int(x - thing.reach), 0), max(int(y - thing.reach), 0)
    x1, y1 = min(int(x + thing.reach) + 2, w), min(int(y + thing.reach) + 2, h)
    if x1 <= x0 or y1 <= y0:
        return
    offset = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    columns = (np.arange(x0, x1)[:, None] + offset).ravel() - x
    rows = (np.arange(y0, y1)[:, None] + offset).ravel() - y
    dx, dy = np.meshgrid(columns, rows)
    u, v = dx * math.cos(turn) + dy * math.sin(turn), dy * math.cos(turn) - dx * math.sin(turn)
    inside, colours = thing.paint(u, v, t)
    shape = (y1 - y0, _FINE, x1 - x0, _FINE)
    alpha = inside.reshape(shape).mean((1, 3), dtype=np.float32)[..., None]
    painted = (colours * inside[..., None]).reshape(*shape, 3).mean((1, 3))
    image[y0:y1, x0:x1] = (1 - alpha) * image[y0:y1, x0:x1] + painted


def write(path: Path, pool: Pool) -> Path:
    """Render a film as H.264; returns its path."""
    size = (pool.width, pool.height)
    return film_writer.write(
        path, frames(pool), size=size, times=pool.times(), rate_hz=pool.rate_hz, crf=pool.crf
    )
