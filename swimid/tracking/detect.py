"""One marker in one small window: which pixels, where to a hundredth of a pixel, how sure."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from swimid.tracking.colour import ColourModel, mean_hsv

#: Pixels about a blob that are looked at for its rim and its background.
MARGIN = 8
#: Least contrast of marker over background: over the scatter of the background, and in grey levels.
MIN_CONTRAST_SIGMA = 1.2
MIN_CONTRAST_LEVELS = 12.0
_KERNEL3 = np.ones((3, 3), np.uint8)
_KERNEL5 = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


@dataclass(frozen=True)
class Blob:
    """One connected patch of marker colour, in image pixels.

    Attributes
    ----------
    x, y : float
        Centre, sub-pixel.
    area : float
        Pixels of marker colour.
    box : tuple of int
        Left, top, right, bottom; right and bottom exclusive.
    contrast : float
        Distance of the marker's mean colour from its surroundings', grey levels.
    confidence : float
        0 to 1.
    hsv : ndarray, shape (3,)
        Mean colour, OpenCV scale.
    at_edge : bool
        It touches the edge of the picture, so its centre is biased inwards.
    """

    x: float
    y: float
    area: float
    box: tuple[int, int, int, int]
    contrast: float
    confidence: float
    hsv: NDArray[np.float64]
    at_edge: bool

    @property
    def radius(self) -> float:
        """Half of the longer side of the box, px."""
        return 0.5 * max(self.box[2] - self.box[0], self.box[3] - self.box[1])


@dataclass(frozen=True)
class Patch:
    """A connected patch of marker colour before it is measured, in window pixels."""

    label: int
    area: float
    left: int
    top: int
    width: int
    height: int
    clipped: bool


@njit(cache=True)
def _weighted_centre(bgr, inner, near, far):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Centre of a marker by soft membership.

    ``inner`` marks the filled core (weight 1), ``near`` the dilated blob, ``far`` what is
    certainly background. Each pixel is projected on the axis from mean background to mean
    core colour; that opacity a gives the weight clip((a - 1/4) / (1/2), 0, 1).
    """
    rows, columns = inner.shape
    core = np.zeros(3)
    back = np.zeros(3)
    square = np.zeros(3)
    n_core = 0
    n_back = 0
    for i in range(rows):
        for j in range(columns):
            if inner[i, j]:
                n_core += 1
                for c in range(3):
                    core[c] += bgr[i, j, c]
            elif far[i, j] == 0:
                n_back += 1
                for c in range(3):
                    value = float(bgr[i, j, c])
                    back[c] += value
                    square[c] += value * value
    if n_core == 0 or n_back == 0:
        return np.nan, np.nan, 0.0, 0.0, core
    axis = np.zeros(3)
    length2 = 0.0
    for c in range(3):
        core[c] /= n_core
        back[c] /= n_back
        axis[c] = core[c] - back[c]
        length2 += axis[c] * axis[c]
    if length2 <= 0.0:
        return np.nan, np.nan, 0.0, 0.0, core
    # Scatter of the background along the axis, channels taken as independent.
    spread = 0.0
    for c in range(3):
        variance = max(square[c] / n_back - back[c] * back[c], 0.0)
        spread += variance * axis[c] * axis[c] / length2
    total = 0.0
    sum_x = 0.0
    sum_y = 0.0
    for i in range(rows):
        for j in range(columns):
            weight = 0.0
            if inner[i, j]:
                weight = 1.0
            elif near[i, j]:
                alpha = 0.0
                for c in range(3):
                    alpha += (bgr[i, j, c] - back[c]) * axis[c]
                alpha /= length2
                weight = min(max(2.0 * alpha - 0.5, 0.0), 1.0)
            total += weight
            sum_x += weight * j
            sum_y += weight * i
    return sum_x / total, sum_y / total, np.sqrt(length2), np.sqrt(spread), core


def marker_mask(window: NDArray[np.uint8], model: ColourModel, *, smooth: bool = True) -> NDArray[np.uint8]:
    """255 on pixels of marker colour. Light smoothing first keeps chroma noise from fraying it."""
    source = cv2.blur(window, (3, 3)) if smooth else window
    return model.mask(cv2.cvtColor(source, cv2.COLOR_BGR2HSV))


def patches(
    mask: NDArray[np.uint8], area_px: tuple[float, float], *, inside: tuple[bool, bool, bool, bool]
) -> tuple[list[Patch], NDArray[np.int32]]:
    """Connected patches of a mask with an area in range.

    Parameters
    ----------
    mask : ndarray of uint8, shape (rows, columns)
    area_px : (float, float)
        Smallest and largest area, px.
    inside : (bool, bool, bool, bool)
        Whether the left, top, right, bottom side of the window is inside the picture: a
        patch touching such a side is ``clipped``, it goes on beyond the window.

    Returns
    -------
    list of Patch, and the label image
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8, ltype=cv2.CV_32S)
    rows, columns = mask.shape
    found = []
    if count > 1:
        areas = stats[1:, cv2.CC_STAT_AREA]
        for label in 1 + np.flatnonzero(areas >= 0.5 * area_px[0]):
            left, top, width, height, area = (int(v) for v in stats[label])
            clipped = (
                (inside[0] and left == 0)
                or (inside[1] and top == 0)
                or (inside[2] and left + width == columns)
                or (inside[3] and top + height == rows)
            )
            if clipped or area_px[0] <= area <= area_px[1]:
                found.append(Patch(int(label), area, left, top, width, height, clipped))
    return found, labels


def measure(
    window: NDArray[np.uint8],
    labels: NDArray[np.int32],
    patch: Patch,
    *,
    origin: tuple[int, int],
    picture: tuple[int, int],
) -> Blob | None:
    """The patch as a :class:`Blob`, or None where it has no contrast to its surroundings.

    Parameters
    ----------
    window : ndarray of uint8, shape (rows, columns, 3)
    origin : (int, int)
        Left and top of the window in the picture.
    picture : (int, int)
        Width and height of the picture.
    """
    rows, columns = labels.shape
    x0, y0 = max(patch.left - MARGIN, 0), max(patch.top - MARGIN, 0)
    x1 = min(patch.left + patch.width + MARGIN, columns)
    y1 = min(patch.top + patch.height + MARGIN, rows)
    own = cv2.compare(labels[y0:y1, x0:x1], patch.label, cv2.CMP_EQ)
    hull_core = _filled(own)
    near = cv2.dilate(own, _KERNEL5)
    far = cv2.dilate(near, _KERNEL5)
    column, row, contrast, scatter, colour = _weighted_centre(window[y0:y1, x0:x1], hull_core, near, far)
    if not np.isfinite(column):
        return None
    if contrast < max(MIN_CONTRAST_LEVELS, MIN_CONTRAST_SIGMA * min(scatter, 15.0)):
        return None
    left, top = origin[0] + patch.left, origin[1] + patch.top
    right, bottom = left + patch.width, top + patch.height
    at_edge = left <= 0 or top <= 0 or right >= picture[0] or bottom >= picture[1]
    confidence = min(contrast / (contrast + 2 * scatter + 6.0), 1.0)
    return Blob(
        x=origin[0] + x0 + column,
        y=origin[1] + y0 + row,
        area=patch.area,
        box=(left, top, right, bottom),
        contrast=contrast,
        confidence=confidence * (0.6 if at_edge else 1.0),
        hsv=mean_hsv(colour),
        at_edge=at_edge,
    )


def _filled(own: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The core of the patch's convex hull: holes of glints are filled, the rim is left soft."""
    contours, _ = cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = contours[0] if len(contours) == 1 else np.concatenate(contours)
    hull = np.zeros_like(own)
    cv2.fillConvexPoly(hull, cv2.convexHull(points), 255)
    core = cv2.erode(hull, _KERNEL3, borderType=cv2.BORDER_CONSTANT, borderValue=255)
    if not core.any():
        return own
    return core
