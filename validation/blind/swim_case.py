"""What one hidden cause may do to a trial, and what it knows of the trial."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from validation.blind.swim_body import Body

Channels = dict[str, np.ndarray]


@dataclass
class Trial:
    """One trial before it is swum.

    ``start`` is the pose at rest (m, m, rad). The rest scatters between trials: the share by which
    amplitude and the fin's force are larger, the trim of the whole tail (rad) and by how much the log's
    clock is late (s). An odd trial has something that the others have not.
    """

    id: str
    index: int
    robot: str
    drive: dict[str, float]
    duration_s: float
    rate_hz: float
    start: tuple[float, float, float]
    seed: int
    role: str = "fit"
    amplitude: float = 0.0
    thrust: float = 0.0
    trim: float = 0.0
    late: float = 0.0
    is_odd: bool = False

    def rng(self, name: str) -> np.random.Generator:
        """Random numbers of one cause in this trial, the same at every call."""
        return np.random.default_rng([self.seed, self.index, zlib.crc32(name.encode())])

    @property
    def heading(self) -> complex:
        return complex(np.exp(1j * self.start[2]))


def held_out(trials: Sequence[Trial]) -> list[Trial]:
    """The trials of which held-out errors are: those that take part in no fit, else all in turn."""
    return [t for t in trials if t.role == "validate"] or list(trials)


@dataclass
class Act:
    """A hidden cause: what it changes, and nothing where it has no function.

    Attributes
    ----------
    joints : (trial, time, (3, joints, n)) -> the same
        Angle, rate and acceleration of the driven joints.
    body : (trial, body), in place
    water : trial -> fields of `swim_tables.Water`
    flow : (trial, time) -> complex velocity of the water
    clock : (trial, time of the log) -> true time, of the camera only
    seen : (trial, channels, time) -> channels, before the noise
    broken : (trial, channels, time) -> channels, after it
    start : (trial, rng), in place: where the trials must be for it to matter
    gyro : whether it needs one in the log
    factors : factor of each coefficient that has changed
    """

    joints: Callable[[Trial, np.ndarray, np.ndarray], np.ndarray] | None = None
    body: Callable[[Trial, Body], None] | None = None
    water: Callable[[Trial], dict[str, float]] | None = None
    flow: Callable[[Trial, np.ndarray], np.ndarray] | None = None
    clock: Callable[[Trial, np.ndarray], np.ndarray] | None = None
    seen: Callable[[Trial, Channels, np.ndarray], Channels] | None = None
    broken: Callable[[Trial, Channels, np.ndarray], Channels] | None = None
    start: Callable[[Trial, np.random.Generator], None] | None = None
    gyro: bool = False
    factors: dict[str, float] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)


#: (rng, size, robot) -> what acts; a size of 1 is clearly visible.
Maker = Callable[[np.random.Generator, float, str], Act]


class Entry(NamedTuple):
    """A cause in a catalogue: its maker, sizes from barely visible to dominant, and its stage."""

    make: Maker
    sizes: tuple[float, ...]
    stage: str
