"""A track along one line: what a rig that moves along it is fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Projection:
    """A track along a line.

    Attributes
    ----------
    along : ndarray, shape (n,)
        Distance travelled along it from the first sample, NaN where the track has none.
    direction : ndarray, shape (d,)
        Unit vector.
    across : float
        Root mean square distance from the line through the mean place.
    extent : float
        Range of ``along``.
    """

    along: Array
    direction: Array
    across: float
    extent: float


def direction(text: str) -> Array | None:
    """A direction in words: ``x``, ``-y``, ``0.6,-0.8``; None for ``line``.

    Raises
    ------
    ValueError
        It is none.
    """
    if text == "line":
        return None
    if text[-1:] in AXES and text[:-1] in ("", "-", "+"):
        return (-1.0 if text[0] == "-" else 1.0) * np.array(AXES[text[-1]])
    try:
        parts = np.array([float(part) for part in text.split(",")])
    except ValueError:
        parts = np.empty(0)
    if len(parts) not in (2, 3) or not np.isfinite(parts).all() or not parts.any():
        raise ValueError(f"'{text}' is no direction: give line, x, -y, z or components as in 0.6,-0.8")
    return np.pad(parts, (0, 3 - len(parts))) / np.linalg.norm(parts)


def project(positions: Sequence[Array], towards: Array | None) -> Projection:
    """Project a track on a line.

    Parameters
    ----------
    positions : sequence of ndarray, each shape (n,)
        One to three coordinates, in any unit.
    towards : ndarray, shape (d,), or None
        Direction of the line; None for the one the track keeps closest to, in the sense of its travel.

    Raises
    ------
    ValueError
        Fewer than two samples have a place, or none of them differ.
    """
    place = np.column_stack(positions)
    there = np.isfinite(place).all(axis=1)
    if there.sum() < 2 or not np.ptp(place[there], axis=0).any():
        raise ValueError("the track does not move")
    centred = place - place[there].mean(axis=0)
    if towards is None:
        towards = np.linalg.svd(centred[there], full_matrices=False)[2][0]
        travel = place[there][-1] - place[there][0]
        forward = float(travel @ towards)
        if forward < 0 or (forward == 0 and towards[np.argmax(np.abs(towards))] < 0):
            towards = -towards
    along = centred @ towards
    across = centred[there] - np.outer(along[there], towards)
    rms = float(np.sqrt(np.mean(np.sum(across**2, axis=1))))
    return Projection(along - along[there][0], towards, rms, float(np.ptp(along[there])))
