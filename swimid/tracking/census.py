"""Which colours are in a video: for messages, and as a start for a setup."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.tracking.reader import Frame

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


def chroma(frame: Frame) -> NDArray[np.uint8]:
    """Largest minus smallest channel of every pixel, lightly smoothed, shape (rows, columns)."""
    blue, green, red = cv2.split(cv2.blur(frame, (3, 3)))
    return cv2.subtract(cv2.max(cv2.max(blue, green), red), cv2.min(cv2.min(blue, green), red))


def hue_name(hue_deg: float) -> str:
    """Everyday name of a hue."""
    return next(name for limit, name in _NAMES if hue_deg % 360 < limit)


def colour_shares(frames: list[Frame]) -> dict[str, float]:
    """Share of the picture each everyday colour has, colourless pixels left out, largest first."""
    shares: dict[str, float] = {}
    for frame in frames:
        small = frame[::2, ::2]
        colourful = chroma(np.ascontiguousarray(small)) >= LEAST_CHROMA
        hue = cv2.cvtColor(small, cv2.COLOR_BGR2HSV)[..., 0][colourful].astype(float) * 2
        low = 0.0
        for limit, name in _NAMES:
            count = int(np.sum((hue >= low) & (hue < limit)))
            shares[name] = shares.get(name, 0.0) + count / colourful.size / len(frames)
            low = limit
    return dict(sorted(((n, s) for n, s in shares.items() if s > 0), key=lambda item: -item[1]))


def describe_colours(frames: list[Frame]) -> str:
    """One sentence on the colours of some frames, for error messages."""
    shares = {name: share for name, share in colour_shares(frames).items() if share >= 1e-4}
    if not shares:
        return "The video is grey: no pixel of it has a colour, so no colour marker can be seen"
    listed = ", ".join(f"{name} {100 * share:.2g} %" for name, share in shares.items())
    return f"Colours in the picture: {listed}"
