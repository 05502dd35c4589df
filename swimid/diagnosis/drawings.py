"""What only the figures of a diagnosis need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from swimid.fitting.model import Array


@dataclass(frozen=True)
class Sketch:
    """A residual force (or sensor term) against something that may drive it.

    Attributes
    ----------
    name, unit : str
        ``surge force``, N.
    against, against_unit : str
        ``speed``, ``phase``, ``time``, ...
    x, y : ndarray, shape (bins,)
    """

    name: str
    unit: str
    against: str
    against_unit: str
    x: Array
    y: Array
    gain: float = 0.0


@dataclass(frozen=True)
class Overlay:
    """One channel of a held-out trial: measured, simulated before and after."""

    trial: str
    channel: str
    unit: str
    time_s: Array
    measured: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class Drawings:
    """What a gap file has no room for.

    Attributes
    ----------
    maps : mapping of title to (row labels, column labels, ratios)
        Heat maps of root-mean-square residual over floor: trial by channel, phase by trial ...
    """

    maps: Mapping[str, tuple[list[str], list[str], Array]] = field(default_factory=dict)
    overlays: Sequence[Overlay] = ()
    sketches: Sequence[Sketch] = ()
