"""Tracking of a body without markers, by its silhouette in front of the empty scene.

The centre and the main axis of the silhouette are tracked.
"""

from __future__ import annotations

import math
from array import array
from pathlib import Path

import cv2
import numpy as np

from swimid.tracking import frames
from swimid.tracking.frames import Frame, RawTrack, Row, Video
from swimid.tracking.setup import Setup

#: SCENE_FRAMES is the number of frames whose median is the picture of the empty scene. WIDTH is the width in
#: px to which each frame is reduced before the body is searched for.
SCENE_FRAMES, WIDTH = 41, 960
#: Default limits of the area of the body, minimum and maximum, as fractions of the picture.
AREA_SHARES = (5e-4, 0.5)
_KERNEL = np.ones((5, 5), np.uint8)


def empty_scene(path: Path) -> Frame:
    """Return the empty scene of a film: the median of frames spread over the film, without moving objects."""
    video = Video(path)
    keeper = frames.FrameKeeper(SCENE_FRAMES, max(video.claimed // SCENE_FRAMES, 1), WIDTH)
    for index, (_, frame) in enumerate(video.frames()):
        keeper.take(index, frame)
    middle = len(keeper.kept) // 2
    return np.asarray(np.partition(np.stack(list(keeper.kept.values())), middle, axis=0)[middle])


class Silhouette:
    """Tracker of the largest object that differs from the empty scene, frame by frame.

    Two points represent the object: the centre of the silhouette, and a rear point on the main axis. The
    distance between the two points is the major half-axis of the ellipse with the same second moments as the
    silhouette.

    Parameters
    ----------
    setup : Setup
        Setup with a single marker of ``method: background``.
    video : Video
        Film, from which the empty scene is computed.
    """

    def __init__(self, setup: Setup, video: Video) -> None:
        scene = empty_scene(video.path)
        self._setup, self._scene = setup, cv2.blur(scene, (3, 3))
        self._factor, self._shape = video.width / scene.shape[1], np.array([video.pixel_aspect, 1.0])
        area_px = setup.markers[0].area_px or video.width * video.height * np.array(AREA_SHARES)
        self._low, self._high = np.array(area_px) / self._factor**2
        self._axis = np.array([1.0, 0.0])
        self._times, self._rows, self._twice = array("d"), array("d"), 0
        self._allowed = np.full(scene.shape[:2], 255, np.uint8)
        for box in setup.ignore_px:
            left, top, right, bottom = (max(round(side / self._factor), 0) for side in box)
            self._allowed[top:bottom, left:right] = 0

    def step(self, time: float, frame: Frame) -> None:
        """Find the body in the next frame of the film, and store the detection."""
        self._times.append(time)
        for row in self._measure(frames.reduce_frame(frame, WIDTH)):
            self._rows.extend(row)

    def _measure(self, small: Frame) -> tuple[Row, Row]:
        """Return centre and rear point of the body as two detections, in px at full resolution."""
        difference, noise, differs = frames.find_difference(small, self._scene)
        mask = np.where(differs, self._allowed, 0).astype(np.uint8)
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        sizes = np.where((stats[:, 4] >= self._low) & (stats[:, 4] <= self._high), stats[:, 4], 0)
        sizes[0] = 0
        label = int(np.argmax(sizes))
        if not sizes[label]:
            return frames.NOT_SEEN[:6], frames.NOT_SEEN[:6]
        self._twice += int(np.sum(sizes > 0.5 * sizes[label]) > 1)
        left, top, width, height = stats[label, :4]
        right, bottom = left + width, top + height
        at_edge = min(left, top) == 0 or right == mask.shape[1] or bottom == mask.shape[0]
        x0, y0 = max(left - 3, 0), max(top - 3, 0)
        difference = difference[y0 : bottom + 3, x0 : right + 3]
        body = np.where(labels[y0 : bottom + 3, x0 : right + 3] == label, 255, 0).astype(np.uint8)
        core = cv2.erode(body, _KERNEL)
        contrast = float(np.median(difference[(core if core.any() else body) > 0]))
        # Weight the pixels at the rim of the body by their difference from the empty scene. Pixels inside the
        # body have weight 1, also where a reflection has the colour of the scene.
        weight = np.clip(difference / (contrast / 2) - 0.5, 0, 1) * (cv2.dilate(body, _KERNEL) > 0)
        outlines, _ = cv2.findContours(core, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        m = cv2.moments(cv2.drawContours(weight, outlines, -1, 1.0, cv2.FILLED))
        spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / m["m00"]
        # Find the main axis in a picture with square pixels.
        variances, axes = np.linalg.eigh(self._shape[:, None] * spread * self._shape)
        self._axis = axes[:, 1] * math.copysign(1, axes[:, 1] @ self._axis)
        middle = np.array([x0 + m["m10"] / m["m00"], y0 + m["m01"] / m["m00"]])
        centre = self._factor * (middle + 0.5) - 0.5
        rear = centre - self._factor * 2 * math.sqrt(variances[1]) * self._axis / self._shape
        confidence = contrast / (contrast + 2 * noise + 6.0)
        rest = (self._factor**2 * m["m00"], confidence, frames.WINDOW, at_edge)
        return (*centre, *rest), (*rear, *rest)

    def track(self) -> RawTrack:
        """Return the track of the frames that were processed so far.

        The direction of the main axis is chosen so that most steps agree with ``swims`` in the setup.
        """
        table = np.array(self._rows).reshape(len(self._times), 2, -1).transpose(1, 0, 2)
        others, name = {}, self._setup.markers[0].name
        if self._twice > max(2, 0.5 * len(table[0])):
            text = f"a second body moves in {self._twice} frames, and the larger one is followed: leave the "
            text += f"other out by ignore_px: [[left, top, right, bottom]], or by area_px of '{name}'"
            others[name] = text
        track = RawTrack.of_table(self._times, self._setup.marker_names, table, {}, {}, others)
        if not track.is_whole.any():
            return track
        ahead = track.head_first(*track.names)
        if ahead is not None and (ahead < 0.5) == (self._setup.swims == "head-first"):
            for values in (track.x, track.y):
                values[1] = 2 * values[0] - values[1]
        return track
