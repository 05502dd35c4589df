"""What the followed markers say of themselves: whether one moves, and whether two sit on one rigid part."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from swimid.tracking.rawtrack import RawTrack

Array = NDArray[np.float64]

#: Sights whose area is this far from the usual one, as a share, show a part of the marker only: the
#: centre of what is left moves though nothing does. Of a bar twenty times as long as broad that a passer-by
#: covers, what remains whole by this measure moves by 0.6 of the radius of a disc of its area.
WHOLE_AREA = 0.15
#: Fewer whole sights than this tell nothing; all are taken.
LEAST_SIGHTS = 10
#: What stays within its own radius looks like a still thing that ripples or is half covered at times.
LEAST_RADII = 1.0
#: Seen in a smaller share of the frames a marker has no usual place.
LEAST_SHARE = 0.05
#: A still point's noise exceeds this many standard deviations per axis in 0.3 % of the frames
#: (Rayleigh's distribution).
NOISE_SIGMA = math.sqrt(-2 * math.log(0.003))
#: Spread of the distance of two markers of a rigid part, as a share: good up to here, bearable up to here.
DISTANCE_SPREAD = (0.02, 0.06)
#: Number of steps of a film over which the direction of motion is compared with that of the markers ...
VOTES = 100
#: ... and how far the distance of the markers may be from its median there, as a share: otherwise another
#: thing stood in for one of them. A camera askew changes it by less.
PAIR_SPREAD = 0.3
#: A robot that turns by less may owe a change of the distance to a bend of its body, rad.
BEND_RAD = math.radians(60.0)


@dataclass(frozen=True)
class Range:
    """How far a marker gets."""

    #: 95th percentile of its distance from its usual place, over sights of the whole marker.
    away_px: float
    #: Of a disc of its usual area.
    radius_px: float
    #: Standard deviation of its centre from frame to frame, one axis.
    noise_px: float

    @property
    def radii(self) -> float:
        """The way in radii of the marker."""
        return self.away_px / self.radius_px

    @property
    def moves(self) -> bool:
        """Whether it leaves its own disc."""
        return self.radii >= LEAST_RADII


def reach(track: RawTrack, name: str, scene: Array | None = None) -> Range:
    """How far a marker gets from its usual place; 0 px where it is hardly seen.

    ``scene``, shape (2, n), px, is how far the scene itself is shifted in each frame.
    """
    i = track.row(name)
    seen = track.found[i]
    if seen.mean() < LEAST_SHARE:
        return Range(0.0, 1.0, math.nan)
    area = track.area[i]
    usual = float(np.median(area[seen]))
    whole = seen & (np.abs(area - usual) <= WHOLE_AREA * usual)
    part = whole if whole.sum() >= LEAST_SIGHTS else seen
    x, y = np.stack([track.x[i], track.y[i]]) - (0.0 if scene is None else scene)
    away = np.hypot(x - np.median(x[part]), y - np.median(y[part]))[part]
    noise = math.sqrt(0.5 * sum(scatter(row[seen]) ** 2 for row in (x, y)))
    radius = max(math.sqrt(usual / math.pi), 1.0)
    return Range(float(np.percentile(away, 95)), radius, noise)


def scatter(values: Array) -> float:
    """Standard deviation of what changes from sample to sample; NaN for fewer than five.

    That of second differences (over sqrt 6), which slow changes leave alone.
    """
    if len(values) < 5:
        return math.nan
    second = values[2:] - 2 * values[1:-1] + values[:-2]
    return 1.4826 * float(np.median(np.abs(second - np.median(second)))) / math.sqrt(6)


def head_first(track: RawTrack, head: str, tail: str) -> float | None:
    """Return the share of steps in which two markers move towards the head; None below four steps."""
    i, j = track.row(head), track.row(tail)
    every = slice(None, None, max(len(track.times) // VOTES, 1))
    front, rear = (np.stack(track.centre(row))[:, every] for row in (i, j))
    line = front - rear
    length = np.hypot(*line)
    sound = np.abs(length / np.nanmedian(length) - 1) <= PAIR_SPREAD
    ahead = np.sum(np.diff(front + rear, axis=1) * line[:, :-1], axis=0)[sound[1:] & sound[:-1]]
    return float(np.mean(ahead > 0)) if len(ahead) >= 4 else None


@dataclass(frozen=True)
class Distance:
    """How well two markers keep their distance in the picture."""

    #: Its robust standard deviation, as a share, as far as no view of a plane explains it.
    spread: float
    #: Its change by that view which the size of the markers does not share, as a share.
    drift: float

    @property
    def change(self) -> float:
        """The larger of both."""
        return max(self.spread, self.drift)


def distance(track: RawTrack, one: str, other: str) -> Distance | None:
    """How well two markers keep their distance; None where they are hardly seen together.

    Notes
    -----
    A camera askew shows the same length smaller where it is farther away, and shorter along the view than
    across it. The picture is therefore first laid back on the plane, by the homography
    ``M p / (1 + l p)``, M symmetric with trace 2, under which the distance varies least (Liebowitz and
    Zisserman 1998, Metric rectification for perspective images of planes, CVPR,
    doi:10.1109/CVPR.1998.698649: equal lengths fix it up to a similarity). M is left out where the robot
    turns by no more than a body bends. The same homography changes the markers' areas; what of it they do
    not show is no view of a plane.
    """
    i, j = track.row(one), track.row(other)
    both = track.found[i] & track.found[j]
    if both.sum() < LEAST_SIGHTS:
        return None
    points = np.stack([track.x[[i, j]][:, both], track.y[[i, j]][:, both]])  # (xy, marker, frame)
    middle = points.mean(axis=(1, 2), keepdims=True)
    points = (points - middle) / max(float(np.abs(points - middle).max()), 1.0)
    heading = np.unwrap(np.arctan2(*(points[:, 0] - points[:, 1])[::-1]))
    turns = float(np.ptp(heading)) > BEND_RAD

    def scatter_of(view: Array) -> Array:
        apart = np.log(np.maximum(np.hypot(*np.diff(_laid_back(points, view), axis=1)[:, 0]), 1e-9))
        return np.asarray(apart - np.median(apart))

    bound = np.array([0.7, 0.7, 0.6, 0.6] if turns else [0.7, 0.7])
    view = least_squares(scatter_of, np.zeros(len(bound)), bounds=(-bound, bound), loss="soft_l1").x
    left = scatter_of(view)
    place = points.mean(axis=1)
    shrunk = -1.5 * np.log1p(view[:2] @ place)
    size = 0.5 * np.log(track.area[[i, j]][:, both].sum(axis=0))
    design = np.column_stack([np.ones(both.sum()), *place])
    smooth, unshared = (design @ np.linalg.lstsq(design, v, rcond=None)[0] for v in (size, size + shrunk))
    # The outline of a patch is known to a pixel: of small markers the size says less.
    blurred = float(np.ptp(math.sqrt(2 * math.pi) / np.exp(smooth)))
    drift = min(float(np.ptp(shrunk)), max(float(np.ptp(unshared)) - blurred, 0.0))
    return Distance(1.4826 * float(np.median(np.abs(left))), drift)


def _laid_back(points: Array, view: Array) -> Array:
    """Image points, shape (2, m, n), on the plane, for ``view`` = l and the two freedoms of M."""
    a, b = view[2:] if len(view) > 2 else (0.0, 0.0)
    x, y = points
    return np.stack([(1 + a) * x + b * y, b * x + (1 - a) * y]) / (1 + view[0] * x + view[1] * y)
