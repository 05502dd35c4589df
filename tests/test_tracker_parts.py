"""What a tracker learns of a marker, and which detections it takes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swimid.tracking import frames
from swimid.tracking.frames import Blob
from swimid.tracking.tracker import Target, drop_false_detections


def blob(x: float, y: float = 50.0, area: float = 100.0, hue: float = 178.0, **more: object) -> Blob:
    """Return a red disc of 12 px, whose hue on OpenCV's scale of 180 is close to the wrap."""
    hsv = np.array([hue, 200.0, 200.0])
    box = (int(x) - 6, int(y) - 6, int(x) + 6, int(y) + 6)
    made = Blob(x, y, area, box, contrast=80.0, confidence=0.9, hsv=hsv, at_edge=False)
    return replace(made, **more)  # type: ignore[arg-type]


def test_the_usual_size_is_the_mean_and_the_latest_size_follows_faster() -> None:
    target, areas = Target("red"), [100.0, 140.0, 90.0, 110.0, 160.0]
    latest = areas[0]
    for k, area in enumerate(areas):
        target.see(blob(100.0 + k, area=area), 0.1 * k, k)
        latest += 0.15 * (area - latest)
        assert target.usual_area == pytest.approx(np.mean(areas[: k + 1]))
        assert target.area == pytest.approx(latest)
    # a marker that the edge of the picture cuts teaches no size
    target.see(blob(300.0, area=20.0, at_edge=True), 0.6, 6)
    assert target.usual_area == pytest.approx(120.0)
    assert (target.whole, target.sights) == (5, 6)


def test_the_mean_hue_crosses_the_wrap() -> None:
    target = Target("red")
    for k, hue in enumerate((176.0, 4.0, 178.0, 2.0)):
        target.see(blob(100.0, hue=hue), 0.1 * k, k)
    assert target.colour is not None
    assert abs(frames.hue_difference(target.colour[0], 0.0)) < 0.1


def test_a_position_is_predicted_with_the_velocity() -> None:
    """30 px/s to the right and 15 px/s down, and twice the range of search for a marker that was missed."""
    target = Target("red")
    for k in range(20):
        target.see(blob(100.0 + 3.0 * k, 50.0 + 1.5 * k), 2.0 + 0.1 * k, k)
    assert target.predict(4.4) == pytest.approx((100.0 + 3.0 * 24, 50.0 + 1.5 * 24), abs=0.1)
    assert target.moved
    # 6 px and 0.3 of the way in the time, and three errors of prediction, which are almost 0 here
    assert target.search_range(0.1) == pytest.approx(6.0 + 0.3 * 3.354, abs=0.1)
    target.missed = 2
    assert target.search_range(0.1) == pytest.approx(6.0 + 0.3 * 3.354 + 6.0, abs=0.1)
    assert target.pace == pytest.approx(33.54 * (1 - 0.95**19), rel=0.1)


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
