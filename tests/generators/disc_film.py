"""Small films of coloured discs on water, each where a function of time puts it, pixel by pixel known.

For what a film does at its edges: discs may be cut by the picture, hide, stand still or be of another
size. Everything is drawn here with numpy; nothing of the tracker is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.generators import film_writer

RED, YELLOW, WATER = (38, 38, 205), (45, 200, 225), (158, 128, 62)  # BGR
_SHIFT = 64
#: A setup with one red marker; lines may be added.
ONE_RED = """\
format: swimid-setup/1
markers:
  - name: red
    hsv: {hue_deg: [345, 15], saturation: [0.45, 1], value: [0.3, 1]}
"""
#: The same with a yellow one behind it.
RED_AND_YELLOW = (
    ONE_RED
    + """\
  - name: yellow
    hsv: {hue_deg: [40, 75], saturation: [0.4, 1], value: [0.35, 1]}
head: red
tail: yellow
"""
)


@dataclass(frozen=True)
class Disc:
    """A disc.

    Attributes
    ----------
    place : function
        Centre in picture pixels at a time in s, or None where it is not there.
    radius : float
        px.
    colour : (int, int, int)
        BGR.
    """

    place: Callable[[float], tuple[float, float] | None]
    radius: float = 9.0
    colour: tuple[int, int, int] = RED


@dataclass(frozen=True)
class Film:
    """Discs on noisy water; later discs are drawn over earlier ones."""

    discs: tuple[Disc, ...]
    duration_s: float = 4.0
    width: int = 320
    height: int = 240
    rate_hz: float = 30.0
    noise: float = 3.0
    #: Width of a disc's rim, px.
    softness_px: float = 2.4
    seed: int = 1

    def times(self) -> np.ndarray:
        """Time of each frame, s."""
        return np.arange(round(self.duration_s * self.rate_hz)) / self.rate_hz

    def places(self, disc: int = 0) -> np.ndarray:
        """Centre of a disc in every frame, shape (n, 2), px; NaN where it is not there."""
        nowhere = (np.nan, np.nan)
        return np.array([self.discs[disc].place(t) or nowhere for t in self.times()])

    def cut(self, disc: int = 0) -> np.ndarray:
        """Where a disc's outline crosses the edge of the picture, shape (n,)."""
        x, y = self.places(disc).T
        # Not there: not cut.
        x, y = np.where(np.isnan(x), self.width / 2, x), np.where(np.isnan(y), self.height / 2, y)
        right, bottom = self.width - 0.5 - x, self.height - 0.5 - y
        return np.min([x + 0.5, y + 0.5, right, bottom], axis=0) < self.discs[disc].radius

    def frames(self) -> Iterator[np.ndarray]:
        """The pictures, uint8 BGR."""
        rng = np.random.default_rng(self.seed)
        x, y = np.meshgrid(np.arange(self.width, dtype=float), np.arange(self.height, dtype=float))
        water = np.array(WATER) * (0.9 + 0.15 * np.sin(x / 47) * np.cos(y / 31))[..., None]
        noise = rng.normal(0, self.noise, (self.height + _SHIFT, self.width + _SHIFT, 3))
        for time in self.times():
            image = water.copy()
            for disc in self.discs:
                place = disc.place(time)
                if place is None:
                    continue
                reach = disc.radius + self.softness_px + 1
                x0, y0 = (max(math.floor(c - reach), 0) for c in place)
                x1, y1 = (max(math.ceil(c + reach) + 1, 0) for c in place)
                here = (slice(y0, y1), slice(x0, x1))
                away = np.hypot(x[here] - place[0], y[here] - place[1]) - disc.radius
                alpha = np.clip(0.5 - away / self.softness_px, 0, 1)[..., None]
                image[here] += alpha * (np.array(disc.colour) - image[here])
            # One tile of noise, shifted at random for every frame.
            dx, dy = rng.integers(0, _SHIFT, 2)
            image += noise[dy : dy + self.height, dx : dx + self.width]
            yield np.clip(image + 0.5, 0, 255).astype(np.uint8)

    def write(self, path: Path) -> Path:
        """The film as H.264, every frame with its own stamp; returns ``path``."""
        size = (self.width, self.height)
        return film_writer.write(
            path, self.frames(), size=size, times=self.times(), rate_hz=self.rate_hz, crf=12
        )


def still(x: float, y: float) -> Callable[[float], tuple[float, float]]:
    """A place that stays."""
    return lambda _: (x, y)


def straight(x: float, y: float, vx: float, vy: float = 0.0) -> Callable[[float], tuple[float, float]]:
    """A place that moves evenly, px and px/s."""
    return lambda t: (x + vx * t, y + vy * t)
