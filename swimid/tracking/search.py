"""Where in a picture a marker may be: patches of its colour in a window, or in the whole picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.tracking import detect
from swimid.tracking.colour import ColourModel
from swimid.tracking.detect import Blob, Patch
from swimid.tracking.reader import Frame
from swimid.tracking.setup import Box, Setup

#: The whole picture is searched on every n-th pixel only, as far as the marker's size allows.
DECIMATION = 4
#: In a window the mask is made of every n-th pixel at most.
MASK_STEP = 4
#: Patches of the whole picture that are measured: a bound on the cost of a frame full of the colour.
MOST_PATCHES = 24
#: Share of the smallest area a patch seen on every n-th pixel only must have.
_ROUGH = 0.4
#: Black bars: grey levels below which a pixel is black (video black is 16 where its range is misread),
#: the share of a row or column that is, and the least width, px.
_BLACK, _BLACK_SHARE, _LEAST_BAR = 24, 0.98, 4
#: How far codecs smear a marker's colour over a bar, px: half a block of halved colour resolution, blurred.
_SMEAR = 3


@dataclass
class Kind:
    """What is searched for."""

    model: ColourModel
    #: Smallest and largest.
    area_px: tuple[float, float]
    #: Things of the colour that are known to be something else.
    scenery: list[Blob] = field(default_factory=list)


class Search:
    """Searches pictures of one size where the setup allows it.

    Parameters
    ----------
    setup : Setup
        Its ``region_px`` and ``ignore_px``: a marker's centre is in the one and in none of the others.
    width, height : int
        Size of the picture.

    Raises
    ------
    InputError
        When the region lies outside the picture.
    """

    def __init__(self, setup: Setup, width: int, height: int) -> None:
        self.size = (width, height)
        self._ignored = setup.ignore_px
        #: What black bars leave of the picture, looked at when a first marker is seen: it may fade in.
        self._bars: tuple[int, int, int, int] | None = None
        self._region = left, top, right, bottom = setup.region_px or (0, 0, width, height)
        #: Pixels that may hold a centre: left, top, right, bottom; right and bottom exclusive.
        self._view = (
            max(math.floor(left), 0),
            max(math.floor(top), 0),
            min(math.ceil(right) + 1, width),
            min(math.ceil(bottom) + 1, height),
        )
        if self._view[0] >= self._view[2] or self._view[1] >= self._view[3]:
            raise InputError(
                f"region_px {list(self._region)} of the setup lies outside the picture of "
                f"{width} x {height} pixels",
                hint="it is [left, top, right, bottom] in pixels of the picture",
            )

    def window(
        self, kind: Kind, frame: Frame, cx: float, cy: float, half: float, step: int = 1
    ) -> tuple[list[Blob], Box | None]:
        """Whole blobs in a square window, and the box of the largest one the window cuts.

        The window has its centre at ``cx``, ``cy`` and the half width ``half``, px. The colour of every
        ``step``-th pixel says what is marker; its centre is taken from all.
        """
        width, height = self.size
        x0, x1 = max(int(cx - half), 0), min(int(cx + half) + 2, width)
        y0, y1 = max(int(cy - half), 0), min(int(cy + half) + 2, height)
        if x1 - x0 < 3 * step or y1 - y0 < 3 * step:
            return [], None
        window = frame[y0:y1, x0:x1]
        mask = detect.marker_mask(detect.thinned(window, step), kind.model)
        inside = (x0 > 0, y0 > 0, x1 < width, y1 < height)
        found = detect.patches(mask, kind.area_px, step=step, inside=inside)
        blobs = []
        for patch in found:
            if patch.clipped:
                continue
            blob = detect.measure(window, patch, step=step, origin=(x0, y0), picture=self.size)
            if blob is None or not self._allowed(blob) or any(same_place(blob, s) for s in kind.scenery):
                continue
            blob.at_edge = self._at_bar(blob, frame) or blob.at_edge
            blobs.append(blob)
        if step > 1 and any(blob.at_edge for blob in blobs):
            # On every step-th pixel it cannot be told whether a marker ends before the edge does.
            return self.window(kind, frame, cx, cy, half)
        cut = max((patch for patch in found if patch.clipped), key=lambda patch: patch.area, default=None)
        return blobs, None if cut is None else cut.box((x0, y0), step)

    def picture(self, kind: Kind, frame: Frame, area: float) -> list[Blob]:
        """Blobs of the whole picture, found on every n-th pixel and measured on all.

        ``area`` is the one expected, px; 0 where none is known yet.
        """
        step = max(min(int(math.sqrt(area or 4 * kind.area_px[0]) / 3.5), DECIMATION), 1)
        blobs = self._picture_at(kind, frame, area, step)
        if not blobs and not area and step > 1:
            blobs = self._picture_at(kind, frame, area, 1)
        return blobs

    def _picture_at(self, kind: Kind, frame: Frame, area: float, step: int) -> list[Blob]:
        x0, y0, x1, y1 = self._view
        if x1 - x0 < 2 * step or y1 - y0 < 2 * step:
            step = 1
        mask = detect.marker_mask(detect.thinned(frame[y0:y1, x0:x1], step), kind.model)
        rough = detect.patches(mask, (_ROUGH * kind.area_px[0], math.inf), step=step)

        def order(patch: Patch) -> float:
            """Of the expected area first; where none is known the largest of a possible one."""
            if area:
                return abs(math.log(patch.area / area))
            return -patch.area if patch.area <= kind.area_px[1] / _ROUGH else patch.area

        boxes = [patch.box((x0, y0), step) for patch in sorted(rough, key=order)]
        blobs: list[Blob] = []
        for box in [box for box in boxes if not self._hidden(box)][:MOST_PATCHES]:
            blobs += [b for b in self._measured(kind, frame, box, step) if is_new(b, blobs)]
        return blobs

    def _measured(self, kind: Kind, frame: Frame, box: Box, step: int) -> list[Blob]:
        """The blobs in a box, at full resolution, those whole that go on beyond the region."""
        cx, cy = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
        size = max(box[2] - box[0], box[3] - box[1])
        half = 0.5 * size + 2 * step + detect.MARGIN
        fine = max(min(int(size / 12), MASK_STEP), 1)
        found, cut = self.window(kind, frame, cx, cy, half, fine)
        x0, y0, x1, y1 = self._view
        if not found and cut and (box[0] <= x0 or box[1] <= y0 or box[2] >= x1 - step or box[3] >= y1 - step):
            # With its centre in the region, at least half of it is: twice the size holds it all.
            found, _ = self.window(kind, frame, cx, cy, half + size, fine)
        return found

    def _hidden(self, box: Box) -> bool:
        """Whether a box lies wholly where nothing is searched."""
        return any(
            b[0] <= box[0] and b[1] <= box[1] and box[2] - 1 <= b[2] and box[3] - 1 <= b[3]
            for b in self._ignored
        )

    def _at_bar(self, blob: Blob, frame: Frame) -> bool:
        """Whether a black bar beside the picture cuts the blob as the edge of the picture would."""
        if self._bars is None:
            self._bars = bars(frame)
        ends = (0, 0, *self.size)
        return any(
            bar != end and abs(side - bar) <= _SMEAR
            for side, bar, end in zip(blob.box, self._bars, ends, strict=True)
        )

    def _allowed(self, blob: Blob) -> bool:
        return _within(blob, self._region) and not any(_within(blob, box) for box in self._ignored)


def bars(frame: Frame) -> tuple[int, int, int, int]:
    """What black bars leave of a picture: left, top, right, bottom; right and bottom exclusive.

    A dark scene is no bar: where more than half of the width or height would go, nothing does.
    """
    black = frame.max(axis=2) < _BLACK

    def ends(dark: NDArray[np.bool_]) -> tuple[int, int]:
        lit = np.flatnonzero(~dark)
        if not len(lit) or lit[-1] + 1 - lit[0] < len(dark) / 2:
            return 0, len(dark)
        first, last = int(lit[0]), int(lit[-1]) + 1
        return (first if first >= _LEAST_BAR else 0), (last if len(dark) - last >= _LEAST_BAR else len(dark))

    left, right = ends(black.mean(axis=0) >= _BLACK_SHARE)
    top, bottom = ends(black.mean(axis=1) >= _BLACK_SHARE)
    return left, top, right, bottom


def _within(blob: Blob, box: Box) -> bool:
    return box[0] <= blob.x <= box[2] and box[1] <= blob.y <= box[3]


def same_place(blob: Blob, other: Blob) -> bool:
    """Whether two blobs, seen at different times, are the same motionless thing."""
    near = blob.away(other.x, other.y) < 0.25 * other.radius + 1.5
    return near and 0.4 < blob.area / other.area < 2.5


def is_new(blob: Blob, others: Sequence[Blob]) -> bool:
    """Whether a blob is none of those found already in the same frame."""
    return all(blob.away(o.x, o.y) > 2 for o in others)
