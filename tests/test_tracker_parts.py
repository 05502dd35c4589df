"""Which detections of a marker a tracker takes back."""

from __future__ import annotations

import numpy as np
import pytest

from swimid.tracking import frames
from swimid.tracking.tracker import drop_false_detections


def rows(count: int, hue: float = 178.0) -> np.ndarray:
    """Return detections of a whole marker in every frame."""
    found = np.zeros((count, 9))
    found[:] = (100.0, 50.0, 120.0, 0.9, frames.FULL, 0.0, hue, 200.0, 200.0)
    found[::2, 6] = (hue + 4.0) % 180.0
    return found


def lose(track: np.ndarray, *parts: slice) -> np.ndarray:
    for part in parts:
        track[part, :4], track[part, 4] = np.nan, frames.LOST
    return track


def seen(track: np.ndarray) -> np.ndarray:
    return track[:, 4] > frames.LOST


def test_a_part_of_the_usual_colour_stays_and_one_of_another_colour_goes() -> None:
    """The marker is red, on both sides of the wrap of the hue."""
    track = lose(rows(100), slice(60, 70), slice(80, 90))
    drop_false_detections(track)
    assert seen(track).sum() == 80
    track[70:80, 6] = 100.0
    drop_false_detections(track)
    assert seen(track).tolist() == [True] * 60 + [False] * 30 + [True] * 10


@pytest.mark.parametrize(
    ("size", "stays"), [(1.0, True), (3.9, True), (4.2, False), (0.26, True), (0.24, False)]
)
def test_a_short_part_of_another_size_goes(size: float, stays: bool) -> None:
    track = lose(rows(100), slice(60, 70), slice(80, 90))
    track[70:80, 2] *= size
    drop_false_detections(track)
    assert seen(track)[70:80].all() == stays
    assert seen(track)[:60].all()


@pytest.mark.parametrize(("length", "stays"), [(1, False), (2, False), (3, True)])
def test_a_lone_detection_goes(length: int, stays: bool) -> None:
    track = lose(rows(100), slice(50, 70), slice(70 + length, 90))
    drop_false_detections(track)
    assert seen(track)[70 : 70 + length].all() == stays
    assert seen(track)[90:].all()


def test_a_marker_that_was_never_seen_stays_so() -> None:
    track = lose(rows(10), slice(0, 10))
    drop_false_detections(track)
    assert not seen(track).any()
