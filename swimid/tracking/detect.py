"""Detections: one marker in one small window, to a hundredth of a pixel; and those of all frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from swimid.tracking.colour import ColourModel, mean_hsv

#: Words of the status column, by code.
STATUS = ("lost", "window", "grown", "full")
LOST, WINDOW, GROWN, FULL = range(4)
#: Status of a pose in whose frame the edge of the picture cuts a marker.
CUT = "cut"
#: Pixels about a blob that are looked at for its rim and its background.
MARGIN = 8
#: Least contrast of marker over background: over the scatter of the background, and in grey levels.
MIN_CONTRAST_SIGMA = 1.2
MIN_CONTRAST_LEVELS = 12.0
_KERNEL3 = np.ones((3, 3), np.uint8)
_KERNEL5 = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


@dataclass(eq=False, slots=True)
class Blob:
    """One connected patch of marker colour, in image pixels."""

    #: Centre, sub-pixel.
    x: float
    y: float
    #: Pixels of marker colour.
    area: float
    #: Left, top, right, bottom; right and bottom exclusive.
    box: tuple[int, int, int, int]
    #: Distance of the marker's mean colour from its surroundings', grey levels.
    contrast: float
    #: 0 to 1.
    confidence: float
    #: Mean colour, OpenCV scale, shape (3,).
    hsv: NDArray[np.float64]
    #: It touches the edge of the picture, so its centre is biased inwards.
    at_edge: bool
    #: How it was found, as in :class:`RawTrack`.
    status: int = FULL

    def away(self, x: float, y: float) -> float:
        """Distance of its centre from a place, px."""
        return math.hypot(self.x - x, self.y - y)

    @property
    def radius(self) -> float:
        """Half of the longer side of the box, px."""
        return 0.5 * max(self.box[2] - self.box[0], self.box[3] - self.box[1])


@dataclass(eq=False, slots=True)
class Patch:
    """A connected patch of marker colour before it is measured."""

    #: Its outline in mask pixels, shape (n, 1, 2).
    contour: NDArray[np.int32]
    #: Picture pixels.
    area: float
    #: Box in mask pixels; right and bottom exclusive.
    left: int
    top: int
    right: int
    bottom: int
    #: It goes on beyond the window.
    clipped: bool

    def box(self, origin: tuple[int, int], step: int) -> tuple[int, int, int, int]:
        """Its box in picture pixels, for the place of the mask's corner and the step of its pixels."""
        x, y = origin
        return x + step * self.left, y + step * self.top, x + step * self.right, y + step * self.bottom


@njit(cache=True)
def _weighted_centre(bgr, inner, near, far, step):  # type: ignore[no-untyped-def]  # noqa: C901 # pragma: no cover
    """Centre of a marker by soft membership.

    ``inner`` marks the filled core (weight 1), ``near`` the dilated blob, outside ``far`` is
    certainly background; one mask pixel covers ``step`` x ``step`` picture pixels. Each
    picture pixel is projected on the axis from mean background to mean core colour; that
    opacity a gives the weight clip((a - 1/4) / (1/2), 0, 1).
    """
    core, back, square = np.zeros(3), np.zeros(3), np.zeros(3)
    n_core = n_back = 0
    for mi in range(inner.shape[0]):
        for mj in range(inner.shape[1]):
            if inner[mi, mj]:
                for i in range(mi * step, (mi + 1) * step):
                    for j in range(mj * step, (mj + 1) * step):
                        for c in range(3):
                            core[c] += bgr[i, j, c]
                n_core += step * step
            elif far[mi, mj] == 0:
                for i in range(mi * step, (mi + 1) * step):
                    for j in range(mj * step, (mj + 1) * step):
                        for c in range(3):
                            value = float(bgr[i, j, c])
                            back[c] += value
                            square[c] += value * value
                n_back += step * step
    if n_core == 0 or n_back == 0:
        return np.nan, np.nan, 0.0, 0.0, core
    core /= n_core
    back /= n_back
    axis = core - back
    length2 = np.sum(axis * axis)
    if length2 <= 0.0:
        return np.nan, np.nan, 0.0, 0.0, core
    # Scatter of the background along the axis, channels taken as independent.
    spread = np.sum(np.maximum(square / n_back - back * back, 0.0) * axis * axis) / length2
    offset = np.sum(back * axis)
    total = 0.0
    sum_x = 0.0
    sum_y = 0.0
    for mi in range(inner.shape[0]):
        for mj in range(inner.shape[1]):
            if near[mi, mj] == 0:
                continue
            solid = inner[mi, mj] != 0
            for i in range(mi * step, (mi + 1) * step):
                for j in range(mj * step, (mj + 1) * step):
                    weight = 1.0
                    if not solid:
                        along = bgr[i, j, 0] * axis[0] + bgr[i, j, 1] * axis[1] + bgr[i, j, 2] * axis[2]
                        weight = min(max(2.0 * (along - offset) / length2 - 0.5, 0.0), 1.0)
                    total += weight
                    sum_x += weight * j
                    sum_y += weight * i
    return sum_x / total, sum_y / total, np.sqrt(length2), np.sqrt(spread), core


def marker_mask(window: NDArray[np.uint8], model: ColourModel) -> NDArray[np.uint8]:
    """255 on pixels of marker colour. Light smoothing first keeps chroma noise from fraying it."""
    return model.mask(cv2.cvtColor(cv2.blur(window, (3, 3)), cv2.COLOR_BGR2HSV))


def thinned(window: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """The middle pixel of every ``step`` x ``step`` block of a window, whole blocks only."""
    if step == 1:
        return window
    half = step // 2
    rows, columns = (window.shape[0] - half) // step, (window.shape[1] - half) // step
    blocks = window[half : half + step * rows, half : half + step * columns]
    return cv2.resize(blocks, (columns, rows), interpolation=cv2.INTER_NEAREST)


def patches(
    mask: NDArray[np.uint8],
    area_px: tuple[float, float],
    *,
    step: int = 1,
    inside: tuple[bool, bool, bool, bool] = (False, False, False, False),
) -> list[Patch]:
    """Connected patches of a mask with an area in range.

    Parameters
    ----------
    mask : ndarray of uint8, shape (rows, columns)
        Marker pixels are not 0.
    area_px : (float, float)
        Smallest and largest area, picture pixels.
    step : int
        Picture pixels to a mask pixel.
    inside : (bool, bool, bool, bool)
        Whether the left, top, right, bottom side of the window is inside the picture: a
        patch touching such a side is ``clipped``.
    """
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    rows, columns = mask.shape
    square = step * step
    found = []
    for contour in contours:
        outline = len(contour)
        # A patch with an outline of n pixels holds less than n^2 / 8 + n of them.
        if square * (0.125 * outline * outline + outline) < 0.5 * area_px[0]:
            continue
        # Pick's theorem: pixels inside and on the outline, holes included.
        area = square * (cv2.contourArea(contour) + 0.5 * outline + (1 if outline > 1 else 0.5))
        if area < 0.5 * area_px[0]:
            continue
        left, top, width, height = cv2.boundingRect(contour)
        right, bottom = left + width, top + height
        clipped = (
            (inside[0] and left == 0)
            or (inside[1] and top == 0)
            or (inside[2] and right == columns)
            or (inside[3] and bottom == rows)
        )
        if clipped or area_px[0] <= area <= area_px[1]:
            found.append(Patch(contour, area, left, top, right, bottom, clipped))
    return found


def measure(
    window: NDArray[np.uint8],
    patch: Patch,
    *,
    step: int,
    origin: tuple[int, int],
    picture: tuple[int, int],
) -> Blob | None:
    """A patch of a window as a :class:`Blob`, or None where it has no contrast to its surroundings.

    The window, shape (rows, columns, 3), is at full resolution, its upper left corner at ``origin`` in a
    ``picture`` of (width, height) px; a pixel of its mask stands for ``step`` x ``step`` of them.
    """
    rows, columns = window.shape[0], window.shape[1]
    margin = -(-MARGIN // step) if step < 3 else 4
    x0, y0 = max(patch.left - margin, 0), max(patch.top - margin, 0)
    x1 = min(patch.right + margin, (columns - step // 2) // step)
    y1 = min(patch.bottom + margin, (rows - step // 2) // step)
    hull = np.zeros((y1 - y0, x1 - x0), np.uint8)
    cv2.fillConvexPoly(hull, cv2.convexHull(patch.contour) - np.array([x0, y0], np.int32), 255)
    # The core of the hull has weight 1, so that glints leave no hole; the rim is left soft.
    large = min(patch.right - patch.left, patch.bottom - patch.top) >= 10
    core = cv2.erode(hull, _KERNEL5 if large else _KERNEL3, borderType=cv2.BORDER_CONSTANT, borderValue=255)
    if not core.any():
        core = hull
    near = cv2.dilate(hull, _KERNEL5 if step < 3 else _KERNEL3)
    far = cv2.dilate(near, _KERNEL5 if step < 3 else _KERNEL3)
    part = window[step * y0 : step * y1, step * x0 : step * x1]
    column, row, contrast, scatter, colour = _weighted_centre(part, core, near, far, step)
    if not math.isfinite(column) or contrast < max(
        MIN_CONTRAST_LEVELS, MIN_CONTRAST_SIGMA * min(scatter, 15.0)
    ):
        return None
    left, top, right, bottom = patch.box(origin, step)
    # Blocks that do not fill up at the right and lower side are not looked at.
    at_edge = left <= 0 or top <= 0 or right > picture[0] - 1.5 * step or bottom > picture[1] - 1.5 * step
    confidence = min(contrast / (contrast + 2 * scatter + 6.0), 1.0)
    return Blob(
        x=origin[0] + step * x0 + column,
        y=origin[1] + step * y0 + row,
        area=patch.area,
        box=(left, top, right, bottom),
        contrast=contrast,
        confidence=confidence * (0.6 if at_edge else 1.0),
        hsv=mean_hsv(colour),
        at_edge=at_edge,
    )


def warm_up() -> None:
    """Compile the kernels of this module."""
    mask = np.full((4, 4), 255, np.uint8)
    _weighted_centre(np.zeros((4, 4, 3), np.uint8), mask, mask, mask, 1)


@dataclass(frozen=True)
class RawTrack:
    """Every marker in every frame, in image pixels.

    Attributes
    ----------
    times : ndarray, shape (n,)
        s.
    names : list of str
        The m markers.
    x, y, area, confidence : ndarray, shape (m, n)
        NaN where not seen (confidence 0). The centre is sub-pixel, y down; of a marker cut by the edge of
        the picture it is that of its visible part.
    status : ndarray of int, shape (m, n)
        Index into :data:`STATUS`.
    at_edge : ndarray of bool, shape (m, n)
        The marker is cut by the edge of the picture.
    drift : dict of str to ndarray, shape (3,)
        Largest drift of each marker kind's colour: hue (2 deg), saturation, value (of 255).
    rivals : dict of str to int
        Other things of the colour that were about.
    mistaken : dict of str to (int, float)
        Markers that were first mistaken for something else: how many sights of it were taken back, and its
        area, px.
    change : ndarray, shape (n,), optional
        Mean difference of the picture about the markers from the picture before, grey levels; the largest of
        all markers, NaN where none was seen in the frame before.
    """

    times: NDArray[np.float64]
    names: list[str]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    area: NDArray[np.float64]
    confidence: NDArray[np.float64]
    status: NDArray[np.int64]
    at_edge: NDArray[np.bool_]
    drift: dict[str, NDArray[np.float64]]
    rivals: dict[str, int]
    mistaken: dict[str, tuple[int, float]] = field(default_factory=dict)
    change: NDArray[np.float64] | None = None

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Where each marker was seen, whole or cut by the edge of the picture, shape (m, n)."""
        return self.status > LOST

    @property
    def found(self) -> NDArray[np.bool_]:
        """Where each marker was measured: seen whole, shape (m, n).

        Where the edge cuts it, neither its centre nor how far that is off can be told.
        """
        return self.seen & ~self.at_edge

    def row(self, name: str) -> int:
        """The row of a marker."""
        return self.names.index(name)

    def centre(self, marker: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centre of a marker where it was measured, else NaN, two arrays of shape (n,), px."""
        cut = self.at_edge[marker]
        return np.where(cut, np.nan, self.x[marker]), np.where(cut, np.nan, self.y[marker])
