"""What is true of a case, kept apart from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation.blind import runner


@dataclass(frozen=True)
class Label:
    """What scoring needs of a label.

    Attributes
    ----------
    case : str
    kind : str
        ``clean``, ``single``, ``pair``, ``outside`` (an effect that no catalogue has) or ``real``.
    robot : str
    effects : tuple of str
        The causes, both of a pair. Of a real case, names each of which is right; none where nothing of the
        catalogue is.
    gap : float or None
        Root-mean-square residual over the noise, in the worst channel, that a refit of the model without its
        causes, and of what differs between trials by chance, would leave: 1 is noise alone. None of real
        cases.
    floor : dict of channel to float
        Noise and chance differences between trials, root mean square in the channel's unit.
    """

    case: str
    kind: str
    robot: str
    effects: tuple[str, ...]
    gap: float | None
    floor: dict[str, float]


def read(folder: Path) -> dict[str, Label]:
    """The labels of a benchmark, by case."""
    found = {}
    for path in sorted((folder / "labels").glob("*.json")):
        raw = runner.label_of(path)
        floor = raw.get("floor") or raw.get("noise_sd") or {}
        effects = tuple(raw["effects"])
        found[path.stem] = Label(path.stem, raw["kind"], raw["robot"], effects, raw["gap"], floor)
    return found


def gap_of(raw: dict[str, Any]) -> float | None:
    """The gap over noise that a generator's label tells; what a cause changes adds to noise as errors do."""
    left = [size for name, size in raw.get("gap_refit", {}).items() if name != "overall"]
    sizes = [math.hypot(1.0, size) for size in left if math.isfinite(size)]
    return max(sizes, default=None)
