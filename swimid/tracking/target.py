"""What is known of one marker while it is followed, and what contests it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from filterpy.gh import GHFilter
from numpy.typing import NDArray

from swimid.tracking.colour import colour_difference
from swimid.tracking.detect import Blob
from swimid.tracking.rawtrack import FALSE_SHARE, SHORTEST_RUN

#: Two markers whose distance spreads by less than this share over so many frames are rigid.
RIGID_FRAMES, RIGID_SPREAD = 20, 0.06


@dataclass
class Target:
    """A marker. Lengths in px, times in s."""

    name: str
    x: float = math.nan
    y: float = math.nan
    vx: float = 0.0
    vy: float = 0.0
    time: float = -math.inf
    sights: int = 0
    missed: int = 0
    innovation_px: float = 0.0
    radius: float = 0.0
    #: Sights of it whole. Only from these its looks are known: cut by the picture's edge it is of any size.
    whole: int = 0
    area: float = 0.0
    contrast: float = 0.0
    #: Slow averages: what it usually is, not what it was last.
    pace: float = 0.0
    usual_area: float = 0.0
    colour: NDArray[np.float64] | None = None
    challenger: Challenger | None = None

    def predicted(self, time: float) -> tuple[float, float]:
        """Where it should be, with its last speed."""
        dt = time - self.time
        return self.x + self.vx * dt, self.y + self.vy * dt

    def reach(self, dt: float) -> float:
        """How far beyond the marker's own size it may be from the prediction after ``dt``."""
        steps = 1 + self.missed
        moved = math.hypot(self.vx, self.vy) * dt
        start = 12.0 + self.radius if self.sights < 3 else 6.0
        return start + (0.3 * moved + 3.0 * self.innovation_px) + (steps - 1) * 0.5 * self.radius

    def see(self, blob: Blob, time: float) -> None:
        """Take a sighting: move there; of one that is whole learn size, colour and contrast."""
        if self.sights and time > self.time:
            self._move(blob, time)
        if not blob.at_edge:
            self._learn(blob)
        elif not self.whole:
            self.radius = max(self.radius, blob.radius)
        self.x, self.y, self.time = blob.x, blob.y, time
        self.sights += 1
        self.missed = 0

    def _move(self, blob: Blob, time: float) -> None:
        place, speed = np.array([self.x, self.y]), np.array([self.vx, self.vy])
        # the sighting is the place; the second tells the speed, later ones half of its change
        motion = GHFilter(place, speed, dt=time - self.time, g=1.0, h=1.0 if self.sights == 1 else 0.5)
        motion.update(np.array([blob.x, blob.y]))
        error = math.hypot(*motion.y)
        if self.sights > 1 and error > 8 * self.radius + 40:
            self.vx = self.vy = 0.0  # found again elsewhere: its speed is not known
        else:
            self.vx, self.vy = (float(v) for v in motion.dx)
        self.innovation_px += 0.3 * (min(error, 4 * self.radius + 20) - self.innovation_px)
        self.pace = max(self.pace + 0.05 * (math.hypot(self.vx, self.vy) - self.pace), 0.0)

    def _learn(self, blob: Blob) -> None:
        blend = 0.15 if self.whole else 1.0
        self.contrast += blend * (blob.contrast - self.contrast)
        self.area += blend * (blob.area - self.area)
        self.radius += blend * (blob.radius - self.radius)
        slow = max(0.01, 1 / (self.whole + 1))
        self.usual_area += slow * (blob.area - self.usual_area)
        old = blob.hsv if self.colour is None else self.colour
        self.colour = old + slow * colour_difference(blob.hsv, old)
        self.whole += 1


@dataclass
class Challenger(Target):
    """A thing unlike a missed target, followed because it may be the marker and the target a mistake."""

    #: Where it was first seen, px.
    start: tuple[float, float] = (math.nan, math.nan)
    #: It has been farther from there than its own size.
    moved: bool = False
    #: What was measured of it, by frame.
    rows: dict[int, tuple[float, ...]] = field(default_factory=dict)

    def see(self, blob: Blob, time: float) -> None:
        """Take a sighting."""
        if not self.sights:
            self.start = (blob.x, blob.y)
        super().see(blob, time)
        self.moved = self.moved or blob.away(*self.start) > 2 * self.radius

    def prevails(self, target: Target) -> bool:
        """Whether it, not the target, is the marker.

        It does by the rule that takes back short stretches of a finished track: the target's sights are
        less than ``FALSE_SHARE`` of all. A thing that stays where it is contests only what was
        never seen whole: a ladder put into the pool is not the swimmer that has just left it.
        """
        if not target.whole:
            return self.whole >= SHORTEST_RUN
        return self.moved and target.whole < FALSE_SHARE * (target.whole + self.whole)


@dataclass
class PairDistance:
    """Distance between two markers, to find out whether they sit on one rigid part."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0

    def add(self, distance: float) -> None:
        """Take the distance in one frame, px."""
        self.count += 1
        delta = distance - self.mean
        self.mean += delta / self.count
        self.squares += delta * (distance - self.mean)

    @property
    def rigid(self) -> bool:
        """Whether it hardly varied over many frames."""
        spread = math.sqrt(self.squares / max(self.count - 1, 1))
        return self.count >= RIGID_FRAMES and spread < RIGID_SPREAD * self.mean
