"""Where every marker was seen, in image pixels, before anything is smoothed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from swimid.logs.log import runs
from swimid.tracking.colour import same_hue_and_saturation

#: Words of the status column, by code.
STATUS = ("lost", "window", "grown", "full")
LOST, WINDOW, GROWN, FULL = range(4)
#: What a pose's status says where the edge of the picture cuts a marker.
CUT = "cut"
#: A sighting this short, alone between losses, is not believed.
SHORTEST_RUN = 3
#: A lost marker that comes back has its usual colour: hue (steps of 2 deg) and relative saturation.
RETURN_HUE, RETURN_SATURATION = 12.0, 0.5
#: Only a run shorter than this share of all sightings is doubted for its look.
FALSE_SHARE = 0.2


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


def drop_false_detections(track: RawTrack, marker: int, looks: NDArray[np.float64]) -> None:
    """Take back sightings of a marker, in place, that seen from the end were something else.

    A run of frames is dropped when it is a flash (shorter than ``SHORTEST_RUN``, alone between longer
    losses), or short and unlike the marker's usual look in colour (``looks``, shape (n, 3): mean HSV of each
    sighting), size or confidence.
    """
    seen = track.status[marker] > LOST
    if not seen.any():
        return
    # Cut by the edge of the picture, a marker has neither its size nor, being narrow, its colour.
    whole = track.found[marker] if track.found[marker].any() else seen
    usual = np.median(looks[whole], axis=0)
    turn = 2 * np.pi * looks[whole, 0] / 180
    usual[0] = 90 / np.pi * np.arctan2(np.sin(turn).mean(), np.cos(turn).mean())
    alike = same_hue_and_saturation(looks.T, usual, RETURN_HUE, RETURN_SATURATION)
    area, confidence = track.area[marker], track.confidence[marker]
    usual_area = float(np.median(area[whole]))
    usual_confidence = float(np.median(confidence[whole]))
    starts, ends = runs(seen).T
    for k, (start, end) in enumerate(zip(starts, ends, strict=True)):
        before = start - (ends[k - 1] if k else 0)
        after = (starts[k + 1] if k + 1 < len(starts) else len(seen)) - end
        alone = (before > SHORTEST_RUN or start == 0) and (after > SHORTEST_RUN or end == len(seen))
        about = seen[max(start - 15, 0) : end + 15]
        flash = end - start < SHORTEST_RUN and (alone or about.mean() < 0.35)
        part = slice(start, end)
        look = whole[part]
        unlike = False
        if look.any() and end - start < FALSE_SHARE * seen.sum():
            ratio = float(np.median(area[part][look])) / usual_area
            faint = float(np.median(confidence[part][look])) < 0.6 * usual_confidence
            unlike = float(np.mean(alike[part][look])) < 0.5 or not 0.25 < ratio < 4
            unlike = unlike or (faint and not 0.5 < ratio < 2)
        if (flash and end - start < seen.sum()) or unlike:
            for values in (track.x, track.y, track.area):
                values[marker, part] = np.nan
            track.confidence[marker, part] = 0.0
            track.status[marker, part] = LOST
            track.at_edge[marker, part] = False
