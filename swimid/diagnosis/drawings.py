"""What only the figures of a diagnosis need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from swimid.fitting.model import Array


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
    forces : mapping of place to (mapping of term to float)
        Smooth forces (N) and moments (N m) that the model lacks, as :class:`swimid.diagnosis.remainder.Left`
        has them.
    """

    maps: Mapping[str, tuple[list[str], list[str], Array]] = field(default_factory=dict)
    overlays: Sequence[Overlay] = ()
    forces: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
