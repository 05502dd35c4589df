"""What colour a marker has: a range on the hue circle that follows slow changes of light."""

from __future__ import annotations

import colorsys
from collections import Counter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.tracking.setup import HsvRange

#: Share of the way a confident sight moves the model.
ADAPTATION = 0.12
#: Farthest the model may drift from the setup: hue (OpenCV steps of 2 deg), saturation, value (of 255).
MAX_DRIFT = np.array([6.0, 40.0, 70.0])
#: Drift worth a warning, same units.
NOTABLE_DRIFT = np.array([3.0, 20.0, 30.0])
#: So far outside the range in saturation and value (of 255) pixels count where they touch pixels inside it.
SLACK = 20.0
#: Half a turn of hue in OpenCV's 8-bit scale.
_HALF, _TURN = 90.0, 180.0
#: A pixel with less chroma (largest minus smallest channel, grey levels) has no colour to go by.
LEAST_CHROMA = 24
_NAMES = (
    (15, "red"),
    (45, "orange"),
    (70, "yellow"),
    (165, "green"),
    (200, "cyan"),
    (260, "blue"),
    (290, "violet"),
    (345, "magenta"),
    (361, "red"),
)
#: Saturation (of 255) below which a pixel is grey.
_GREY = 30.0
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
        low[0] = max(low[0], min(self._lower[0], _GREY))
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
        return bool(np.any(np.abs(self.largest_drift) > NOTABLE_DRIFT))


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
    return next(name for limit, name in _NAMES if hue_deg % 360 < limit)


def describe_colours(frames: list[NDArray[np.uint8]]) -> str:
    """One sentence on the colours of some frames, for error messages."""
    shares: Counter[str] = Counter()
    for frame in frames:
        small = np.ascontiguousarray(frame[::2, ::2])
        colourful = chroma(small) >= LEAST_CHROMA
        hue = cv2.cvtColor(small, cv2.COLOR_BGR2HSV)[..., 0][colourful].astype(float) * 2
        counts, _ = np.histogram(hue, [0, *(limit for limit, _ in _NAMES)])
        for (_, name), count in zip(_NAMES, counts, strict=True):
            shares[name] += count / colourful.size / len(frames)
    listed = ", ".join(f"{name} {100 * share:.2g} %" for name, share in shares.most_common() if share >= 1e-4)
    if not listed:
        return "The video is grey: no pixel of it has a colour, so no colour marker can be seen"
    return f"Colours in the picture: {listed}"
