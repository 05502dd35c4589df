"""What colour a marker has, one marker in a window to a hundredth of a pixel, and those of all frames.

:class:`ColourModel` is a range on the hue circle that follows slow changes of light; :func:`measure` gives a
:class:`Blob`, and a :class:`RawTrack` holds every marker in every frame.
"""

from __future__ import annotations

import colorsys
import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from swimid.tracking.setup import HsvRange

#: Share of the way a confident sight moves the model.
ADAPTATION = 0.12
#: Farthest the model may drift from the setup: hue (OpenCV steps of 2 deg), saturation, value (of 255).
MAX_DRIFT = np.array([6.0, 40.0, 70.0])
#: So far outside the range in saturation and value (of 255) pixels count where they touch pixels inside it.
SLACK = 20.0
#: Half a turn of hue in OpenCV's 8-bit scale.
_HALF, _TURN = 90.0, 180.0
#: A pixel with less chroma (largest minus smallest channel, grey levels) has no colour to go by.
LEAST_CHROMA = 24
#: Names of hues, and the degrees that they reach up to.
_NAMES = ("red", "orange", "yellow", "green", "cyan", "blue", "violet", "magenta", "red")
_LIMITS = (15, 45, 70, 165, 200, 260, 290, 345, 361)
_TOUCH = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))

_Bounds = list[tuple[NDArray[np.uint8], NDArray[np.uint8]]]


class ColourModel:
    """A hue arc with saturation and value bounds, moved along with exposure and white balance.

    Parameters
    ----------
    colours : HsvRange
        From the setup file.

    Notes
    -----
    Hue is kept as centre and half-width: a (low, high) pair loses red, which lies at both
    ends of the scale.
    """

    def __init__(self, colours: HsvRange) -> None:
        low, high = (h / 2 for h in colours.hue_deg)
        width = high - low if high >= low else high - low + _TURN
        if colours.hue_deg == (0.0, 360.0):
            width = _TURN
        self._half_width = width / 2
        middle = (127.5 * sum(colours.saturation), 127.5 * sum(colours.value))
        self._centre = np.array([(low + width / 2) % _TURN, *middle])
        self._lower, self._upper = 255 * np.array([colours.saturation, colours.value]).T
        self._any = np.array([width >= _TURN, *((self._lower <= 0) & (self._upper >= 255))])
        self._first: NDArray[np.float64] | None = None
        self.drift = np.zeros(3)
        self.largest_drift = np.zeros(3)
        self._refresh()

    def mask(self, hsv: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """255 where a pixel of an OpenCV HSV picture belongs, shape (rows, columns).

        Pixels a little outside the range count where they touch pixels inside it (within
        ``_TOUCH``): a range set a little too tight does not tear the marker apart, and the
        growth stays bounded where the background is of a like colour.
        """
        strong = _within(hsv, self._strong)
        near = cv2.dilate(strong, _TOUCH)
        return cv2.bitwise_or(strong, cv2.bitwise_and(near, _within(hsv, self._weak)))

    def holds(self, hsv: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether single colours, shape (n, 3) on OpenCV's scale, count where they touch the range's."""
        pixels = np.clip(np.round(hsv), 0, 255).astype(np.uint8).reshape(1, -1, 3)
        return np.asarray(_within(pixels, self._weak)[0] > 0)

    def distance(self, hsv: NDArray[np.float64]) -> float:
        """How far a mean colour is from the middle of the range: 0 centre, 1 rim."""
        centre = self._centre + self.drift
        hue = abs(hue_difference(hsv[0], centre[0])) / max(self._half_width, 1.0)
        half = np.maximum((self._upper - self._lower) / 2, 1.0)
        return float(np.max([hue, *(np.abs(hsv[1:] - centre[1:]) / half)]))

    def adapt(self, hsv: NDArray[np.float64]) -> None:
        """Move the model a little towards the mean colour of a marker just seen."""
        if self._first is None:
            self._first = hsv.copy()
        offset = colour_difference(hsv, self._first)
        # Of a channel that may be anything nothing needs to be followed: of grey the hue is noise.
        offset[self._any] = 0.0
        moved = self.drift + ADAPTATION * (offset - self.drift)
        self._move(np.clip(moved, -MAX_DRIFT, MAX_DRIFT))

    def forget(self) -> None:
        """Move a little back to the setup's colours, while the marker is lost."""
        if self.drift.any():
            self._move(self.drift * (1 - 0.2 * ADAPTATION))

    def restart(self) -> None:
        """Go back to the setup's colours: what was followed was another thing."""
        self._first = None
        self.largest_drift = np.zeros(3)
        self._move(np.zeros(3))

    def _move(self, drift: NDArray[np.float64]) -> None:
        changed = np.any(np.round(drift) != np.round(self.drift))
        self.drift = drift
        self.largest_drift = np.where(np.abs(drift) > np.abs(self.largest_drift), drift, self.largest_drift)
        if changed:
            self._refresh()

    def _refresh(self) -> None:
        self._strong = self._arcs(0.0, 0.0)
        self._weak = self._arcs(0.25 * self._half_width + 3.0, SLACK)

    def _arcs(self, hue_slack: float, slack: float) -> _Bounds:
        """Bounds for ``cv2.inRange``: one box of colours, or two where the hue arc crosses 0."""
        shift = np.round(self.drift)
        # A bound at the end of the scale stays there: it means "any".
        low = np.clip(np.where(self._lower <= 0, 0, self._lower + shift[1:] - slack), 0, 255)
        high = np.clip(np.where(self._upper >= 255, 255, self._upper + shift[1:] + slack), 0, 255)
        # Hue means nothing on grey: the widened range still asks for some saturation.
        # Saturation (of 255) below which a pixel is grey.
        low[0] = max(low[0], min(self._lower[0], 30.0))
        centre, half = self._centre[0] + shift[0], self._half_width + hue_slack
        if half >= _HALF:
            arcs = [(0.0, 179.0)]
        else:
            first, last = (centre - half) % _TURN, (centre + half) % _TURN
            arcs = [(first, last)] if first <= last else [(first, 179.0), (0.0, last)]
        ends = [([np.ceil(a), *np.floor(low)], [np.floor(b), *np.ceil(high)]) for a, b in arcs]
        return [(np.array(first, np.uint8), np.array(last, np.uint8)) for first, last in ends]

    @property
    def drifted(self) -> bool:
        """Whether the light changed enough to say so."""
        # Drift worth a warning, same units.
        return bool(np.any(np.abs(self.largest_drift) > np.array([3.0, 20.0, 30.0])))


def _within(hsv: NDArray[np.uint8], bounds: _Bounds) -> NDArray[np.uint8]:
    found = cv2.inRange(hsv, *bounds[0])
    for low, high in bounds[1:]:
        cv2.bitwise_or(found, cv2.inRange(hsv, low, high), found)
    return found


def hue_difference(a: Any, b: Any) -> Any:
    """A - b on the circle of 180 steps, in [-90, 90)."""
    return (a - b + _HALF) % _TURN - _HALF


def colour_difference(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """A - b of two HSV colours, the hue the short way round."""
    out = a - b
    out[0] = hue_difference(a[0], b[0])
    return out


def same_hue_and_saturation(hsv: Any, usual: Any, hue: float, saturation: float) -> Any:
    """Whether colours, shape (3,) or (3, n), differ from a usual one by no more than a hue and a saturation.

    HSV on OpenCV's scale, ``saturation`` a share of the usual one's. Where that is nearly grey its hue is
    noise and not compared, and saturations are as they come with so little chroma.
    """
    least = 255 * LEAST_CHROMA / max(float(usual[2]), 1.0)
    saturated = np.abs(hsv[1] - usual[1]) <= max(saturation * usual[1], least)
    if usual[1] < least:
        return saturated
    return saturated & (np.abs(hue_difference(hsv[0], usual[0])) <= hue)


def mean_hsv(bgr: NDArray[np.float64]) -> NDArray[np.float64]:
    """HSV, on OpenCV's 8-bit scale but not rounded, of one BGR colour (0 .. 255)."""
    hue, saturation, value = colorsys.rgb_to_hsv(*(float(c) for c in bgr[::-1]))
    return np.array([_TURN * hue, 255 * saturation, value])


def chroma(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Largest minus smallest channel of every pixel, lightly smoothed, shape (rows, columns)."""
    blue, green, red = cv2.split(cv2.blur(frame, (3, 3)))
    return cv2.subtract(cv2.max(cv2.max(blue, green), red), cv2.min(cv2.min(blue, green), red))


def hue_name(hue_deg: float) -> str:
    """Everyday name of a hue."""
    return next(name for name, limit in zip(_NAMES, _LIMITS, strict=True) if hue_deg % 360 < limit)


def describe_colours(frames: list[NDArray[np.uint8]]) -> str:
    """One sentence on the colours of some frames, for error messages."""
    shares: Counter[str] = Counter()
    for frame in frames:
        small = np.ascontiguousarray(frame[::2, ::2])
        colourful = chroma(small) >= LEAST_CHROMA
        hue = cv2.cvtColor(small, cv2.COLOR_BGR2HSV)[..., 0][colourful].astype(float) * 2
        counts, _ = np.histogram(hue, [0, *_LIMITS])
        for name, count in zip(_NAMES, counts, strict=True):
            shares[name] += count / colourful.size / len(frames)
    listed = ", ".join(f"{name} {100 * share:.2g} %" for name, share in shares.most_common() if share >= 1e-4)
    if not listed:
        return "The video is grey: no pixel of it has a colour, so no colour marker can be seen"
    return f"Colours in the picture: {listed}"


#: Words of the status column, by code.
STATUS = ("lost", "window", "grown", "full")
LOST, WINDOW, GROWN, FULL = range(4)
#: Status of a pose in whose frame the edge of the picture cuts a marker.
CUT = "cut"
#: Pixels about a blob that are looked at for its rim and its background.
MARGIN = 8
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
    window: NDArray[np.uint8], patch: Patch, *, step: int, origin: tuple[int, int], picture: tuple[int, int]
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
    # Least contrast of marker over background: over the scatter of the background, and in grey levels.
    if not math.isfinite(column) or contrast < max(12.0, 1.2 * min(scatter, 15.0)):
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
