"""Films of a planar fish whose points a tracker follows, with known faults. Nothing of swimid is used.

The body is a chain of rods in the picture's own axes: column to the right, row downwards. Each rod begins at
a hinge. Its direction in the picture is turned clockwise against the rod ahead, because rows point down, by
the joint angle that the log counts counter-clockwise. Matrices turn the rods; no complex numbers are used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

Array = np.ndarray
#: Lengths of the rods of the tendon fish, m, and the names of its links.
TFISH = {"head": 0.270, "tail1": 0.032, "tail2": 0.032, "tail3": 0.032, "fin": 0.100}
#: Ten points on the tendon fish: link, forward of its hinge and to port, m.
PLACES = {
    "snout": ("head", 0.0, 0.0),
    "eye": ("head", -0.05, 0.03),
    "gill": ("head", -0.12, -0.04),
    "back": ("head", -0.22, 0.01),
    "hip": ("tail1", -0.015, 0.012),
    "knee": ("tail2", -0.02, -0.012),
    "heel": ("tail3", -0.012, 0.01),
    "ankle": ("tail3", -0.028, -0.01),
    "web": ("fin", -0.03, 0.004),
    "tip": ("fin", -0.095, 0.0),
}
Places = Mapping[str, tuple[str, float, float]]


@dataclass
class Film:
    """A film: true motion, and tracked points in pixels, rows downwards.

    ``x``, ``y`` (m), ``yaw`` and ``joints`` (rad) are the truth in the world of the log: x to the right, y up
    from the upper edge of the picture. ``faults`` maps a kind to its (frame, names).
    """

    time: Array
    x: Array
    y: Array
    yaw: Array
    joints: Array
    names: list[str]
    column: Array
    row: Array
    likelihood: Array
    faults: dict[str, list[tuple[int, tuple[str, ...]]]] = field(default_factory=dict)


def film(
    *,
    seed: int = 0,
    frames: int = 600,
    rate_hz: float = 60.0,
    beat_hz: float = 1.2,
    pixels_per_m: float = 1500.0,
    noise_px: float | Sequence[float] = 0.5,
    missing: float = 0.0,
    strays: float = 0.0,
    swaps: float = 0.0,
    merges: float = 0.0,
    likelihood_slope: float = 0.0,
    lengths: Mapping[str, float] = TFISH,
    places: Places = PLACES,
    amplitudes_deg: Sequence[float] = (9.0, 11.0, 13.0, 18.0),
    turn_rad_s: float = 0.12,
    motion: tuple[Array, ...] | None = None,
) -> Film:
    """Make a film of a fish on a gentle curve, or of the ``motion`` (time, x, y, yaw, joints).

    ``missing`` and ``strays`` are fractions of all tracked points. ``swaps`` and ``merges`` are fractions of
    the frames. The noise is proportional to the likelihood to the power of minus ``likelihood_slope``.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(frames) / rate_hz
    phase = 2 * np.pi * beat_hz * time
    yaw = 0.4 + turn_rad_s * time + np.radians(5) * np.sin(phase + 0.8)
    course = 0.4 + turn_rad_s * time
    x = 0.35 + np.cumsum(0.06 * np.cos(course)) / rate_hz
    y = -0.55 + np.cumsum(0.06 * np.sin(course)) / rate_hz + 0.006 * np.sin(phase + 0.2)
    joints = np.column_stack(
        [np.radians(a) * np.sin(phase - 0.7 * (k + 1)) for k, a in enumerate(amplitudes_deg)]
    )
    joints = joints[:, : len(lengths) - 1]
    if motion is not None:
        time, x, y, yaw, joints = motion
        frames = len(time)
    names, links = list(places), list(lengths)
    column, row = np.empty((2, frames, len(names)))
    for f in range(frames):
        at, heading = np.array([x[f], -y[f]]), yaw[f]
        for k, link in enumerate(links):
            if k:
                heading += joints[f, k - 1]
            ahead = np.array([np.cos(heading), -np.sin(heading)])
            port = np.array([-np.sin(heading), -np.cos(heading)])
            for p, name in enumerate(names):
                if places[name][0] == link:
                    point = at + places[name][1] * ahead + places[name][2] * port
                    column[f, p], row[f, p] = pixels_per_m * point
            at = at - lengths[link] * ahead
    shape = column.shape
    likelihood = np.clip(1.0 - 0.3 * rng.beta(1.2, 3.0, shape), 0.62, 1.0)
    sd = np.broadcast_to(np.asarray(noise_px, dtype=float), shape) * likelihood**-likelihood_slope
    column, row = column + sd * rng.normal(size=shape), row + sd * rng.normal(size=shape)
    made = Film(time, x, y, yaw, joints, names, column, row, likelihood)
    _spoil(made, rng, missing, strays, swaps, merges)
    return made


def _spoil(
    made: Film, rng: np.random.Generator, missing: float, strays: float, swaps: float, merges: float
) -> None:
    """Add faults, at most one exchange or merger in a frame; a fault takes points that have none yet."""
    frames, count = made.column.shape
    free = np.ones((frames, count), dtype=bool)
    faults: dict[str, list[tuple[int, tuple[str, ...]]]] = {"exchanged": [], "merged": [], "stray": []}
    for f in np.flatnonzero(rng.random(frames) < swaps):
        i, j = sorted(rng.choice(count, 2, replace=False))
        for side in (made.column, made.row):
            side[f, [i, j]] = side[f, [j, i]]
        free[f, [i, j]] = False
        faults["exchanged"].append((int(f), (made.names[i], made.names[j])))
    for f in np.flatnonzero(rng.random(frames) < merges):
        i, j = rng.choice(count, 2, replace=False)
        if free[f, [i, j]].all():
            made.column[f, i], made.row[f, i] = made.column[f, j] + 0.3, made.row[f, j] - 0.2
            free[f, [i, j]] = False
            faults["merged"].append((int(f), (made.names[i], made.names[j])))
    for f, p in np.argwhere((rng.random((frames, count)) < strays) & free):
        size, way = rng.uniform(15, 250), rng.uniform(0, 2 * np.pi)
        made.column[f, p] += size * np.cos(way)
        made.row[f, p] += size * np.sin(way)
        free[f, p] = False
        faults["stray"].append((int(f), (made.names[p],)))
    gone = (rng.random((frames, count)) < missing) & free
    made.column[gone] = made.row[gone] = np.nan
    made.likelihood[gone] = 0.0
    made.faults = faults


# ---------------------------------------------------------------- files


def write_deeplabcut(made: Film, path: Path) -> Path:
    """Write the points as a CSV table of DeepLabCut."""
    parts = {}
    for p, name in enumerate(made.names):
        parts[name, "x"], parts[name, "y"] = made.column[:, p], made.row[:, p]
        parts[name, "likelihood"] = made.likelihood[:, p]
    keys = pd.MultiIndex.from_tuples(
        [("DLC_resnet50", *key) for key in parts], names=["scorer", "bodyparts", "coords"]
    )
    pd.DataFrame(np.column_stack(list(parts.values())), columns=keys).to_csv(path)
    return path


def write_sleap(made: Film, path: Path) -> Path:
    """Write the points as a CSV table of SLEAP."""
    parts = {"track": "fish", "frame_idx": np.arange(len(made.time)), "instance.score": 0.9}
    for p, name in enumerate(made.names):
        parts[f"{name}.x"], parts[f"{name}.y"] = made.column[:, p], made.row[:, p]
        parts[f"{name}.score"] = made.likelihood[:, p]
    pd.DataFrame(parts).to_csv(path, index=False)
    return path


def write_points(path: Path, places: Places = PLACES, extra: str = "") -> Path:
    """Write a points file that places the points as they are, or as ``places`` says."""
    rows = [f"  {name}: {{link: {link}, at_m: [{x:.6f}, {y:.6f}]}}" for name, (link, x, y) in places.items()]
    path.write_text("\n".join(["format: swimid-points/1", "points:", *rows, extra, ""]))
    return path
