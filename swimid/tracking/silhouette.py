"""Tracking of a body without markers: centre and main axis of its silhouette in front of the empty scene."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.tracking.detect import NOT_SEEN, WINDOW, RawTrack, Row
from swimid.tracking.quality import head_first
from swimid.tracking.reader import Frame, FrameKeeper, Video, largest_channel, reduced
from swimid.tracking.setup import Setup

#: Number of frames whose median is the empty scene, and width to which all frames are reduced, px.
SCENE_FRAMES, WIDTH = 41, 960
#: Minimum difference of the body from the empty scene: in grey levels, and relative to the median difference
#: in the frame.
MIN_DIFFERENCE, MIN_DIFFERENCE_RATIO = 16.0, 4.0
#: Default minimum and maximum area of the body, as fractions of the picture.
AREA_SHARES = (5e-4, 0.5)
_KERNEL = np.ones((5, 5), np.uint8)


def empty_scene(path: Path) -> Frame:
    """Return the median of frames spread over a film, in which moving objects are absent."""
    video = Video(path)
    keeper = FrameKeeper(SCENE_FRAMES, max(video.claimed // SCENE_FRAMES, 1), WIDTH)
    for index, (_, frame) in enumerate(video.frames()):
        keeper.take(index, frame)
    frames = np.stack(list(keeper.kept.values()))
    return np.asarray(np.partition(frames, len(frames) // 2, axis=0)[len(frames) // 2])


class Silhouette:
    """Follow the largest object that differs from the empty scene, frame by frame.

    Two points represent the object: the centre of the silhouette, and a rear point on the main axis. The
    distance of the rear point is the half-axis of the ellipse with the same second moments.

    Parameters
    ----------
    setup : Setup
        Setup with a single marker of ``method: background``.
    scene : frame
        Empty scene, from :func:`empty_scene`.
    width, height : int
        Size of the picture, px.
    """

    def __init__(self, setup: Setup, scene: Frame, width: int, height: int) -> None:
        self.setup, self._scene = setup, cv2.blur(scene, (3, 3))
        self._factor = width / scene.shape[1]
        low, high = setup.markers[0].area_px or (share * width * height for share in AREA_SHARES)
        self._area = (low / self._factor**2, high / self._factor**2)
        self._axis = np.array([1.0, 0.0])
        self._rows: list[list[Row]] = []
        self._changes: list[float] = []
        self._times: list[float] = []
        self._last: tuple[tuple[slice, slice], Frame] | None = None
        self._allowed = np.full(scene.shape[:2], 255, np.uint8)
        for box in setup.ignore_px:
            left, top, right, bottom = (max(round(side / self._factor), 0) for side in box)
            self._allowed[top:bottom, left:right] = 0

    def step(self, time: float, frame: Frame) -> None:
        """Find the body in the next frame."""
        small = cv2.blur(reduced(frame, WIDTH), (3, 3))
        change = math.nan
        if self._last is not None:
            change = float(cv2.absdiff(small[self._last[0]], self._last[1]).mean())
        self._times.append(time)
        self._changes.append(change)
        self._rows.append(self._measure(small))

    def _measure(self, small: Frame) -> list[Row]:
        """Return the detections of the centre and of the rear point in a reduced frame."""
        self._last = None
        difference = largest_channel(cv2.absdiff(small, self._scene))
        noise = float(np.median(difference))
        limit = max(MIN_DIFFERENCE, MIN_DIFFERENCE_RATIO * noise)
        mask = np.where(difference > limit, self._allowed, 0).astype(np.uint8)
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        sizes = np.where((stats[:, 4] >= self._area[0]) & (stats[:, 4] <= self._area[1]), stats[:, 4], 0)
        sizes[0] = 0
        label = int(np.argmax(sizes))
        if not sizes[label]:
            return [NOT_SEEN, NOT_SEEN]
        left, top, width, height = (int(v) for v in stats[label, :4])
        rows, columns = mask.shape
        edge = left == 0 or top == 0 or left + width == columns or top + height == rows
        here = (slice(max(top - 3, 0), top + height + 3), slice(max(left - 3, 0), left + width + 3))
        body = np.where(labels[here] == label, 255, 0).astype(np.uint8)
        core = cv2.erode(body, _KERNEL)
        inside = core if core.any() else body
        contrast = float(np.median(difference[here][inside > 0]))
        # pixels of the rim are weighted by their difference from the scene, and the inside has weight 1
        near, filled = cv2.dilate(body, _KERNEL), _filled(core)
        weight = np.clip(2 * difference[here].astype(float) / contrast - 0.5, 0, 1) * (near > 0)
        m = cv2.moments(np.where(filled > 0, 1.0, weight))
        x, y = m["m10"] / m["m00"] + here[1].start, m["m01"] / m["m00"] + here[0].start
        spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / m["m00"]
        shares, axes = np.linalg.eigh(spread)
        axis = axes[:, 1]
        if axis @ self._axis < 0:
            axis = -axis
        self._axis = axis
        self._last = (here, small[here].copy())
        centre = self._factor * (np.array([x, y]) + 0.5) - 0.5
        rear = centre - self._factor * 2 * math.sqrt(shares[1]) * axis
        confidence = contrast / (contrast + 2 * noise + 6.0)
        rest = (self._factor**2 * m["m00"], confidence, WINDOW, edge)
        return [(*centre, *rest), (*rear, *rest)]

    def track(self) -> RawTrack:
        """Return the track so far.

        The direction of the main axis is chosen so that most steps agree with ``swims`` in the setup.
        """
        track = RawTrack.of_rows(
            self._times,
            self.setup.marker_names,
            self._rows,
            change=np.array(self._changes),
        )
        ahead = head_first(track, *track.names)
        if ahead is not None and (ahead < 0.5) == (self.setup.swims == "head-first"):
            for values in (track.x, track.y):
                values[1] = 2 * values[0] - values[1]
        return track


def _filled(core: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a mask without the holes that reflections leave."""
    outlines, _ = cv2.findContours(core, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(np.zeros_like(core), outlines, -1, 255, cv2.FILLED), np.uint8)
