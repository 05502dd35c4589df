"""Does the camera stand still? Whether most of what can be recognised in the scene shifts together."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.notices import warn
from swimid.tracking.reader import Frame, reduced

Array = NDArray[np.float64]
#: Width frames are reduced to before they are compared.
SCENE_WIDTH = 480
#: Corners sought, and the fewest that tell of a scene.
CORNERS, LEAST_CORNERS = 300, 12
#: A corner found in the other frame is found back from there within so many px of the reduced picture.
BACK_PX = 0.5
#: Corners whose shift is this near to the median (px of the reduced picture) go together.
TOGETHER_PX = 1.0
#: Share of the corners sought that must do so: most of the scene, whatever swims in it ...
SCENE_SHARE = 0.5
#: ... and cells of a grid over the picture they must be in, of how many a side: a robot near the camera may
#: wear most of the corners.
CELLS, SIDE = 8, 4
#: A scene that shifts farther than this (px of the reduced picture) has a camera that moves.
STILL_PX = 2.0


def shifts(frames: Sequence[Frame]) -> Array:
    """How far the scene is shifted in each frame against the first one.

    Parameters
    ----------
    frames : sequence of n frames
        Of one size.

    Returns
    -------
    ndarray, shape (n, 2)
        px, x to the right and y down; NaN where no common shift of most corners is found (ripples, plain
        water, another scene).

    Notes
    -----
    Corners of the first frame followed there and back by Lucas and Kanade's optical flow in pyramids
    (Bouguet 2001); the median of those that come back, where most of all corners agree with it.
    """
    out = np.full((len(frames), 2), np.nan)
    if not frames:
        return out
    factor = max(frames[0].shape[1] / SCENE_WIDTH, 1.0)
    greys = (np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), np.uint8) for frame in frames)
    small = [reduced(grey, SCENE_WIDTH) for grey in greys]
    corners = cv2.goodFeaturesToTrack(small[0], CORNERS, 0.02, 7)
    if corners is None or len(corners) < LEAST_CORNERS:
        return out
    for k, picture in enumerate(small):
        there, found, _ = cv2.calcOpticalFlowPyrLK(small[0], picture, corners, None)
        back, again, _ = cv2.calcOpticalFlowPyrLK(picture, small[0], there, None)
        sound = (found[:, 0] > 0) & (again[:, 0] > 0)
        sound &= np.linalg.norm((back - corners)[:, 0], axis=1) < BACK_PX
        if not sound.any():
            continue
        flow = (there - corners)[sound, 0]
        middle = np.median(flow, axis=0)
        alike = np.linalg.norm(flow - middle, axis=1) < TOGETHER_PX
        cells = (corners[sound, 0][alike] * SIDE / np.array(picture.shape[::-1])).astype(int)
        if alike.sum() >= SCENE_SHARE * len(corners) and len(np.unique(cells, axis=0)) >= CELLS:
            out[k] = factor * middle
    return out


def between(shift: Array, indices: NDArray[np.int64], count: int) -> Array | None:
    """The shift in each of ``count`` frames from that in some, shape (2, count); None where unknown."""
    known = np.isfinite(shift[:, 0])
    if known.sum() < 2:
        return None
    frames = np.arange(count)
    return np.array([np.interp(frames, indices[known], row[known]) for row in shift.T])


def farthest(shift: Array, width: int, consequence: str) -> tuple[float, float]:
    """How far the scene is shifted at most, and may be in a picture of ``width`` px; warns beyond that."""
    largest, limit = (
        float(np.nanmax(np.hypot(*shift.T), initial=0.0)),
        STILL_PX * max(width / SCENE_WIDTH, 1.0),
    )
    if largest > limit:
        moves = f"the whole scene shifts by {largest:.1f} px in the film: the camera moves"
        warn("SWM068", f"{moves}{consequence}")
    return largest, limit
