"""Markers shown by hand, by one of their pixels: which patch that is, and the colours that are its own."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.notices import warn
from swimid.tracking import colour
from swimid.tracking.colour import SLACK, ColourModel
from swimid.tracking.propose import colour_range, two_digits
from swimid.tracking.reader import Frame
from swimid.tracking.setup import HsvRange, Marker

#: The patch about a pixel is sought with colours this far from the pixel's: hue (deg), saturation, value;
WIDEST = (20.0, 0.3, 0.3)
#: ... or these shares of it: that at which the patch grows least with it. Matas, J. et al. (2002), Robust
#: wide baseline stereo from maximally stable extremal regions, BMVC. doi:10.5244/C.16.36
SHARES = (0.25, 0.35, 0.5, 0.7, 1.0)
#: A patch of fewer pixels is none.
SMALLEST = 5
#: Share of the picture above which a patch is no usual marker, which is said, and above which it is none.
LARGE, LARGEST = 0.05, 0.5
#: Width of the ring about a patch that shows its surroundings, px, beyond the blurred rim.
RING, RIM = 10, 3
#: Share of the surroundings that must not have the marker's colours.
DISTINCT = 0.9
BACKGROUND = "a marker wants a background of another colour or brightness all round"
Mask = NDArray[np.uint8]
_CROSS = np.ones((3, 3), np.uint8)


def markers(
    frame: Frame, kinds: dict[str, list[tuple[float, float]]], *, path: Path, index: int
) -> list[Marker]:
    """Markers from their pixels.

    Parameters
    ----------
    frame : frame
        The full picture.
    kinds : dict of str to list of (x, y)
        Name of each kind of marker, and a pixel of every marker of it.
    path, index
        Video and frame number, for messages.

    Raises
    ------
    InputError
        A place is outside the picture; no patch about it stands out from its surroundings; two
        places are on one patch, or two kinds have one colour.
    """
    place: dict[str, Any] = {"file": path, "frame": index}
    hsv = cv2.cvtColor(cv2.blur(frame, (3, 3)), cv2.COLOR_BGR2HSV)
    patches: list[tuple[str, Mask]] = []
    for name, pixels in kinds.items():
        for x, y in pixels:
            option = f"--marker {name}@{x:g},{y:g}"
            patch = _patch(frame, hsv, option, (x, y), place)
            for other, taken in patches:
                if taken[int(y), int(x)]:
                    message = f"{option} is on the same patch as another pixel of '{other}'"
                    raise InputError(message, **place)
            patches.append((name, patch))
    found = [_marker(hsv, name, [mask for kind, mask in patches if kind == name], place) for name in kinds]
    for marker in found:
        mine = ColourModel(marker.colour_range()).mask(hsv)
        for other, mask in patches:
            if other != marker.name and np.mean(mine[mask > 0] > 0) > 0.5:
                raise InputError(
                    f"markers '{marker.name}' and '{other}' have one colour, and would be exchanged",
                    hint=f"name them alike (--marker {marker.name}@x,y for both); they become "
                    f"{marker.name}1, {marker.name}2 and are told apart by their places",
                    **place,
                )
    return found


def _patch(frame: Frame, hsv: Mask, option: str, pixel: tuple[float, float], place: dict[str, Any]) -> Mask:
    """The patch of one colour about a pixel: 255 inside, shape (rows, columns)."""
    rows, columns = hsv.shape[:2]
    x, y = pixel
    if not (0 <= x < columns and 0 <= y < rows):
        raise InputError(f"{option} is outside the picture of {columns} x {rows} pixels", **place)
    i, j = int(y), int(x)
    grey = int(colour.chroma(frame)[i, j]) < colour.LEAST_CHROMA
    patches: list[Mask] = []
    for share in SHARES:
        mask = ColourModel(_about(hsv[i, j], share, grey)).mask(hsv)
        _, labels = cv2.connectedComponents(mask, connectivity=8)
        patch = np.where((labels == labels[i, j]) & (mask > 0), 255, 0).astype(np.uint8)
        if SMALLEST <= np.count_nonzero(patch) <= LARGEST * patch.size:
            patches.append(patch)
    standing = [patch for patch in patches if _range_of(hsv, patch) is not None]
    if not standing:
        blue, green, red = (int(v) for v in frame[i, j])
        raise InputError(
            f"no patch about {x:g},{y:g} (#{red:02x}{green:02x}{blue:02x}) stands out from its surroundings",
            hint=f"pick a pixel inside the marker, away from glints; {BACKGROUND}",
            **place,
        )
    if len(standing) == 1:
        return standing[0]
    growth = [np.count_nonzero(after) / np.count_nonzero(before) for before, after in pairwise(standing)]
    return standing[growth.index(min(growth)) + 1]


def _about(pixel: Mask, share: float, grey: bool) -> HsvRange:
    """The colours about a pixel's; of a grey one every hue."""
    hue, saturation, value = 2.0 * pixel[0], pixel[1] / 255, pixel[2] / 255
    wide_hue, wide_saturation, wide_value = (share * width for width in WIDEST)
    value_span = (max(value - wide_value, 0.0), min(value + wide_value, 1.0))
    if grey:
        # Saturation is chroma over value: on dark pixels noise alone makes it large.
        most = max(saturation + wide_saturation, colour.LEAST_CHROMA / (255 * max(value, 0.02)))
        return HsvRange(saturation=(0.0, min(most, 1.0)), value=value_span)
    return HsvRange(
        hue_deg=((hue - wide_hue) % 360, (hue + wide_hue) % 360),
        saturation=(max(saturation - wide_saturation, 0.08), min(saturation + 2 * wide_saturation, 1.0)),
        value=value_span,
    )


def _marker(hsv: Mask, name: str, masks: list[Mask], place: dict[str, Any]) -> Marker:
    """One kind of marker from its patches."""
    colours = _range_of(hsv, np.bitwise_or.reduce(masks))
    if colours is None:
        raise InputError(
            f"marker '{name}' has the colour of its surroundings; nothing tells it from them",
            hint=BACKGROUND,
            **place,
        )
    areas = [np.count_nonzero(mask) for mask in masks]
    if max(areas) > LARGE * masks[0].size:
        warn(
            "SWM101",
            f"the patch of '{name}' has {max(areas)} pixels, {100 * max(areas) / masks[0].size:.0f} % of "
            f"the picture, more "
            f"than the {100 * LARGE:g} % of a usual marker: it is followed as a whole, with area_px up to "
            f"{math.ceil(3 * max(areas))}; its centre moves with its outline",
        )
    area = (max(math.floor(0.3 * min(areas)), 1.0), math.ceil(3 * max(areas)))
    middles = [np.argwhere(mask).mean(axis=0).round(1) for mask in masks]
    starts = tuple((float(x), float(y)) for y, x in middles)
    named = place["frame"] == 0 and len(masks) > 1
    return Marker(name=name, hsv=colours, number=len(masks), area_px=area, start_px=starts if named else None)


def _range_of(hsv: Mask, patch: Mask) -> HsvRange | None:
    """The colours of a patch that are not its surroundings'; None where nothing tells them apart."""
    core = cv2.erode(patch, _CROSS)
    near = cv2.dilate(patch, _CROSS, iterations=RIM)
    ring = cv2.subtract(cv2.dilate(near, _CROSS, iterations=RING), near)
    inside, around = hsv[(core if core.any() else patch) > 0], hsv[ring > 0]
    return _standing_out(_colours(inside), inside.astype(float), around.astype(float))


def _colours(inside: Mask) -> HsvRange:
    """The range of a patch's colours, with room for changing light; every hue of a grey one."""
    saturation, value = inside[:, 1].astype(float), inside[:, 2].astype(float)
    chroma = float(np.median(saturation * value)) / 255
    if chroma >= colour.LEAST_CHROMA:
        turn = np.exp(1j * np.pi * inside[:, 0] / 90)
        middle = round(float(np.angle(turn.mean()) * 90 / np.pi)) % 180
        found = colour_range(inside, middle)
        if found is not None:
            return found
    low, high = np.percentile(value, [3, 97]) / 255
    most = max(1.35 * np.percentile(saturation, 97) / 255, colour.LEAST_CHROMA / (255 * max(low, 0.02)))
    return HsvRange(
        saturation=(0.0, two_digits(min(most, 1.0))),
        value=(two_digits(0.65 * low), two_digits(min(1.35 * high, 1.0))),
    )


def _standing_out(
    colours: HsvRange, inside: NDArray[np.float64], around: NDArray[np.float64]
) -> HsvRange | None:
    """The range drawn in where it holds the surroundings; None where nothing tells them apart.

    A bound goes half way between the patch and its surroundings (as far as pixels may be outside of it, if
    that is more), in saturation or in value, where they are farthest apart.
    """
    for _ in range(3):
        held = ColourModel(colours).holds(around)
        if np.mean(held) <= 1 - DISTINCT:
            return colours
        rest, bounds = around[held], {"saturation": colours.saturation, "value": colours.value}
        gaps = []
        for channel, key in ((1, "saturation"), (2, "value")):
            low, high = np.percentile(inside[:, channel], [5, 95])
            below, above = np.percentile(rest[:, channel], [5, 95])
            gaps += [
                (low - above, key, 0, min(low, max((low + above) / 2, above + SLACK))),
                (below - high, key, 1, max(high, min((below + high) / 2, below - SLACK))),
            ]
        gap, key, side, at = max(gaps)
        if gap <= 0:
            return None
        span = list(bounds[key])
        span[side] = two_digits(at / 255)
        if span[0] >= span[1]:
            return None
        colours = colours.model_copy(update={key: (span[0], span[1])})
    return None
