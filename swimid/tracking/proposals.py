"""Proposals of markers in a film: colours that move, and the colours of picked pixels.

:func:`find_candidates` searches for colours whose patches are compact and move. :func:`pick_markers` finds
the patch about a pixel, and the range of colours that separates the patch from its surroundings.
:func:`marker_fault` says why a marker cannot be followed, after its setup was tried on the film.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from swimid.errors import InputError, NoTrustworthyResult
from swimid.notices import Step, warn
from swimid.tracking import frames
from swimid.tracking import setup as setup_format
from swimid.tracking.frames import SLACK, Array, ColourModel, Frame, RawTrack, Video, marker_mask
from swimid.tracking.options import Pick
from swimid.tracking.setup import HsvRange, Marker, Setup
from swimid.tracking.tracker import FilmTrack

#: Number of frames of a film that are searched for colours, and width to which they are reduced, px.
N_SAMPLES, SAMPLE_WIDTH = 48, 960
#: Minimum fraction of the pixels of a moving patch that differ from the empty scene. In at least this
#: fraction of the pixels, the empty scene must also have another colour than the patch.
MIN_DIFFERENT_SHARE = 0.3
#: Minimum score of a colour that is proposed as a marker, and maximum number of hues that are examined.
MIN_SCORE, MAX_HUES = 0.02, 8
#: Maximum colour differences between a picked pixel and the other pixels of its patch, grey levels. All
#: differences are tried. The one with the most stable patch is used: the patch grows least from the next
#: smaller difference to this one. Matas, J. et al. (2002), Robust wide baseline stereo from maximally stable
#: extremal regions, BMVC. doi:10.5244/C.16.36
TOLERANCES = (8, 12, 18, 27, 40)
#: MIN_PATCH_PX is the minimum area of a patch, px. LARGE is the area of a patch above which a warning is
#: given, and LARGEST the maximum area of a marker, both as fractions of the picture.
MIN_PATCH_PX, LARGE, LARGEST = 5, 0.05, 0.5
#: Maximum fraction of the pixels around a marker that have a colour in the marker's range.
MAX_SHARE_AROUND = 0.1
#: Maximum difference between the hue of a marker and that of one of its pixels, on OpenCV's scale (steps of 2
#: deg).
NEAR_HUE = 12
BACKGROUND = "put the whole marker on a background of another colour or brightness"
#: Flags of OpenCV's flood fill: compare each pixel with the start pixel, and write 255 into the mask.
FILL = 8 | cv2.FLOODFILL_FIXED_RANGE | cv2.FLOODFILL_MASK_ONLY | 255 << 8
_SQUARE = np.ones((3, 3), np.uint8)

# ---------------------------------------------------------------- proposals


@dataclass(frozen=True)
class Samples:
    """Some frames of a film, spread evenly over it and reduced in size."""

    video: Video
    indices: NDArray[np.int64]
    frames: list[Frame]
    #: Width of a pixel of a reduced frame, in pixels of the original picture.
    factor: float
    #: Background: median of the frames, in which moving objects are absent.
    background: Frame
    #: Masks of the frames, with 255 for pixels that differ from the background.
    moving: list[NDArray[np.uint8]]


@dataclass(frozen=True, eq=False)
class MarkerCandidate:
    """Colour that is examined as the colour of a marker. Lengths are in px of the picture."""

    #: Common name of the hue, hue in the middle of the colour range (degrees), and colour range.
    name: str
    hue_deg: float
    colours: HsvRange
    #: Score of the colour as the colour of a marker, from 0 to 1 (most likely).
    score: float = 0.0
    #: Fraction of the sampled frames of the film in which a patch of the colour is seen.
    presence: float = 0.0
    #: Minimum and maximum area of the patch of this colour, px.
    area_px: tuple[float, float] = (0.0, 0.0)
    #: Reason why the colour is rejected as that of a marker; empty for a candidate that may be a marker.
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.name} (hue {self.hue_deg:g} deg): {self.reason}"


def sample_frames(path: Path, *, step: Step) -> Samples:
    """Return about :data:`N_SAMPLES` frames, spread evenly over a film."""
    video = Video(path)
    keeper = frames.FrameKeeper(2 * N_SAMPLES, max(video.claimed // N_SAMPLES, 1), SAMPLE_WIDTH)
    for index, (_, frame) in enumerate(video.frames()):
        step()
        keeper.take(index, frame)
    kept = list(keeper.kept.values())
    if len(kept) < 4:
        text = f"{path.name} has only {len(kept)} frames: too few to detect motion"
        raise NoTrustworthyResult(text, hint="pick the markers by hand: --marker name@x,y")
    background = np.median(np.stack(kept[:: max(len(kept) // 25, 1)]), axis=0).astype(np.uint8)
    still = cv2.blur(background, (3, 3))
    differing = [frames.find_difference(frame, still)[2] for frame in kept]
    moving = [np.where(differs, 255, 0).astype(np.uint8) for differs in differing]
    factor = max(video.width / SAMPLE_WIDTH, 1.0)
    return Samples(video, np.array(list(keeper.kept)), kept, factor, background, moving)


def find_candidates(samples: Samples) -> tuple[list[MarkerCandidate], list[MarkerCandidate]]:
    """Return the colours in a film that may belong to markers, best first; and the rejected colours.

    Raises
    ------
    NoTrustworthyResult
        The film has no colour, nothing coloured moves, or nothing looks like a marker.
    """
    moving = []
    for frame, mask in zip(samples.frames, samples.moving, strict=True):
        chosen = (mask > 0) & (frames.chroma(frame) >= frames.MIN_CHROMA)
        moving.append(cv2.cvtColor(cv2.blur(frame, (3, 3)), cv2.COLOR_BGR2HSV)[chosen])
    hsv = np.concatenate(moving)
    if len(hsv) < 4 * len(samples.frames):
        raise NoTrustworthyResult(
            f"no coloured marker moves in {samples.video.path.name}. "
            f"{frames.describe_colours(samples.frames[::6])}",
            hint="put a saturated sticker on the robot and keep the film in colour; pick a marker that "
            "hardly moves, or is white, grey or black, by hand (--marker name@x,y); follow a whole body with "
            "--background",
        )
    judged = [_judge(samples, hsv, peak) for peak in _peaks(hsv, len(samples.frames))]
    passed = [c for c in judged if c.reason]
    good = sorted((c for c in judged if not c.reason), key=lambda c: -c.score)
    if not good:
        raise NoTrustworthyResult(
            f"nothing in {samples.video.path.name} looks like a marker: a compact patch of one colour that "
            f"moves. {describe_rejected(passed)}{frames.describe_colours(samples.frames[::6])}",
            hint="pick it by hand: --marker name@x,y with --frame",
        )
    return good, passed


def describe_rejected(passed: list[MarkerCandidate]) -> str:
    """Return a sentence on the rejected colours and the reasons; empty if no colour was rejected."""
    return f"Passed over: {'; '.join(map(str, passed))}. " if passed else ""


def _peaks(hsv: NDArray[np.uint8], frames: int) -> list[int]:
    """Return the hues (0 .. 179) that are most frequent among moving coloured pixels, most frequent first."""
    histogram = np.bincount(hsv[:, 0], minlength=180)[:180].astype(float)
    kernel = np.exp(-0.5 * (np.arange(-9, 10) / 3.0) ** 2)
    smooth = np.convolve(np.pad(histogram, 9, mode="wrap"), kernel / kernel.sum(), "valid")
    top = (smooth >= np.roll(smooth, 1)) & (smooth > np.roll(smooth, -1)) & (10 * smooth > 4 * frames)
    return sorted(map(int, np.flatnonzero(top)), key=lambda h: -smooth[h])[:MAX_HUES]


def colour_range(hsv: NDArray[np.uint8], peak: int) -> HsvRange:
    """Return the colour range of a marker, from the pixels of a film and the hue of the marker."""
    offset = frames.hue_difference(hsv[:, 0].astype(float), peak)
    near = np.abs(offset) <= NEAR_HUE
    cluster = hsv[near].astype(float)
    # Use the pixels of strongest colour (saturation times value), which are inside the marker. The other
    # pixels are the blurred rim of the marker.
    purity = cluster[:, 1] * cluster[:, 2]
    core = purity >= np.percentile(purity, 35)
    low, high = np.percentile(offset[near][core], [3, 97])
    s_low = np.percentile(cluster[core, 1], 4) / 255
    v_low, v_high = np.percentile(cluster[core, 2], [3, 98]) / 255
    return HsvRange(
        hue_deg=(_degrees(peak + low - 5), _degrees(peak + high + 5)),
        saturation=(two_digits(max(0.75 * s_low, 0.1)), 1.0),
        value=(two_digits(max(0.65 * v_low, 0.04)), two_digits(min(1.35 * v_high, 1.0))),
    )


def _degrees(hue: float) -> float:
    return float(round(2 * hue) % 360)


def two_digits(value: float) -> float:
    """Return a fraction rounded to two digits, as it is written in a setup file."""
    return float(round(value, 2))


def _judge(samples: Samples, hsv: NDArray[np.uint8], peak: int) -> MarkerCandidate:
    """Return a candidate for one hue, with a score computed from the patches of the hue in all frames."""
    colours, hue, count = colour_range(hsv, peak), _degrees(peak), len(samples.frames)
    name, model = frames.hue_name(hue), ColourModel(colours)
    least = max(5.0, 2e-5 * samples.background[..., 0].size)
    found = []
    in_range = moving_in_range = 0.0
    scenery = marker_mask(samples.background, model)
    for frame, moving in zip(samples.frames, samples.moving, strict=True):
        mask = marker_mask(frame, model)
        in_range += float(np.count_nonzero(mask))
        moving_in_range += float(np.count_nonzero(mask & moving))
        for area, x, y, fill in _patches(mask, moving, scenery, least)[:1]:
            middle = frames.chroma(frame)[int(y) - 1 : int(y) + 2, int(x) - 1 : int(x) + 2]
            found.append((area, x, y, fill, np.mean(middle)))
    if len(found) < max(3, 0.05 * count):
        reason = f"moves in only {len(found)} of {count} samples"
        return MarkerCandidate(name, hue, colours, reason=reason)
    areas, *place, compact, purity = np.array(found).T
    spread = 1.4826 * float(np.median(np.abs(np.log(areas / np.median(areas)))))
    way = float(np.max(np.ptp(np.percentile(place, [5, 95], axis=1), axis=0)))
    score = (
        len(found)
        / count
        * float(np.median(compact))
        * math.exp(-spread)
        * math.sqrt(min(float(np.median(purity)) / 100, 1.0))
        * math.sqrt(moving_in_range / max(in_range, 1))
        * min(way / (2.0 * math.sqrt(float(np.median(areas)))), 1.0)
    )
    if score < MIN_SCORE:
        reason = f"is scattered, uneven or hardly moves (score {score:.3f})"
        return MarkerCandidate(name, hue, colours, reason=reason)
    low, high = samples.factor**2 * np.percentile(areas, [5, 95])
    sized = (float(math.floor(0.3 * low)), float(math.ceil(3 * high)))
    return MarkerCandidate(name, hue, colours, score, len(found) / count, sized)


def _patches(
    mask: NDArray[np.uint8], moving: NDArray[np.uint8], scenery: NDArray[np.uint8], least: float
) -> list[tuple[float, float, float, float]]:
    """Return the moving patches of a mask as (area, x, y, fraction of a disc), largest first.

    Patches at the edge of the picture are left out. A patch does not count as moving if the empty scene
    (``scenery``) has the colour of the patch at the same position. In this case the light has changed, or an
    object passes over the patch.
    """
    count, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
    if count < 2:
        return []
    moved = np.bincount(labels[moving > 0], minlength=count)
    stays = np.bincount(labels[scenery > 0], minlength=count)
    rows, columns = mask.shape
    found = []
    for label in range(1, count):
        left, top, width, height, area = stats[label]
        inside = left > 0 and top > 0 and left + width < columns and top + height < rows
        if (
            area >= least
            and inside
            and moved[label] > MIN_DIFFERENT_SHARE * area
            and stays[label] < (1 - MIN_DIFFERENT_SHARE) * area
        ):
            fill = min(area / (0.785 * max(width, height) ** 2), 1.0)
            found.append((float(area), float(centres[label][0]), float(centres[label][1]), float(fill)))
    return sorted(found, reverse=True)


def kinds_of(picks: Iterable[Pick]) -> dict[str, list[tuple[float, float]]]:
    """Return the picked pixels (x, y) of each kind of marker, by name."""
    kinds: dict[str, list[tuple[float, float]]] = {}
    for pick in picks:
        kinds.setdefault(pick.name, []).append((pick.x, pick.y))
    return kinds


def setup_of(markers: list[Marker], common: Mapping[str, Any]) -> Setup:
    """Return a setup in which the first marker is the head, and the second marker, if any, is the tail.

    ``common`` has the other keys of the setup.

    Raises
    ------
    InputError
        See :func:`swimid.tracking.setup.read`.
    """
    head, *rest = [name for marker in markers for name in marker.names]
    entries = [marker.model_dump(mode="json", exclude_none=True) for marker in markers]
    stated = {key: value for key, value in common.items() if value is not None}
    return setup_format.read_setup(
        {"markers": entries, "head": head, "tail": next(iter(rest), None), **stated}
    )


def pick_markers(
    frame: Frame, kinds: dict[str, list[tuple[float, float]]], *, path: Path, index: int
) -> list[Marker]:
    """Return setup entries of markers, from one pixel of each marker that the user picked.

    Parameters
    ----------
    frame : frame
        Picture at full resolution.
    kinds : dict of str to list of (x, y)
        Name of each kind of marker, and one pixel of every marker of that kind.
    path, index
        Film and index of the frame, for messages.

    Raises
    ------
    InputError
        A pixel is outside the picture, or its patch does not differ from its surroundings; two pixels are on
        one patch, or two kinds have one colour.
    """
    place: dict[str, Any] = {"file": path, "frame": index}
    hsv = cv2.cvtColor(cv2.blur(frame, (3, 3)), cv2.COLOR_BGR2HSV)
    patches: list[tuple[str, Frame]] = []
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
        mine = ColourModel(marker.hsv or HsvRange()).mask(hsv)
        for other, mask in patches:
            if other != marker.name and np.mean(mine[mask > 0] > 0) > 0.5:
                raise InputError(
                    f"markers '{marker.name}' and '{other}' have one colour, and would be exchanged",
                    hint=f"name them alike (--marker {marker.name}@x,y for both); they become "
                    f"{marker.name}1, {marker.name}2 and are distinguished by their places",
                    **place,
                )
    return found


def _patch(frame: Frame, hsv: Frame, option: str, pixel: tuple[float, float], place: dict[str, Any]) -> Frame:
    """Return the mask of the patch about a picked pixel: 255 inside, shape (rows, columns)."""
    rows, columns = hsv.shape[:2]
    x, y = pixel
    if not (0 <= x < columns and 0 <= y < rows):
        raise InputError(f"{option} is outside the picture of {columns} x {rows} pixels", **place)
    i, j = int(y), int(x)
    smooth = cv2.blur(frame, (3, 3))
    patches: list[Frame] = []
    for tolerance in TOLERANCES:
        mask, limit = np.zeros((rows + 2, columns + 2), np.uint8), (tolerance,) * 3
        cv2.floodFill(smooth, mask, (j, i), 0, limit, limit, FILL)
        patch = mask[1:-1, 1:-1]
        if MIN_PATCH_PX <= np.count_nonzero(patch) <= LARGEST * patch.size:
            patches.append(patch)
    standing = [patch for patch in patches if _range_of(hsv, patch) is not None]
    if not standing:
        blue, green, red = (int(v) for v in frame[i, j])
        raise InputError(
            f"no patch about {x:g},{y:g} (#{red:02x}{green:02x}{blue:02x}) stands out from its surroundings",
            hint=f"pick a pixel inside the marker, away from reflections; {BACKGROUND}",
            **place,
        )
    if len(standing) == 1:
        return standing[0]
    growth = [np.count_nonzero(after) / np.count_nonzero(before) for before, after in pairwise(standing)]
    return standing[growth.index(min(growth)) + 1]


def _marker(hsv: Frame, name: str, masks: list[Frame], place: dict[str, Any]) -> Marker:
    """Return the setup entry of one kind of marker from the masks of its patches."""
    colours = _range_of(hsv, np.bitwise_or.reduce(masks))
    if colours is None:
        text = f"marker '{name}' has the colour of its surroundings"
        raise InputError(text, hint=BACKGROUND, **place)
    areas = [np.count_nonzero(mask) for mask in masks]
    if max(areas) > LARGE * masks[0].size:
        share = f"{100 * max(areas) / masks[0].size:.0f} % of the picture"
        text = f"the patch of '{name}' has {max(areas)} pixels, {share}: it is followed as a whole"
        warn("SWM101", f"{text}, with area_px up to {math.ceil(3 * max(areas))}")
    area = (max(math.floor(0.3 * min(areas)), 1.0), math.ceil(3 * max(areas)))
    middles = [np.argwhere(mask).mean(axis=0).round(1) for mask in masks]
    starts = tuple((float(x), float(y)) for y, x in middles)
    named = place["frame"] == 0 and len(masks) > 1
    return Marker(name=name, hsv=colours, number=len(masks), area_px=area, start_px=starts if named else None)


def _range_of(hsv: Frame, patch: Frame) -> HsvRange | None:
    """Return the colour range that separates a patch from its surroundings; None if there is none."""
    core = cv2.erode(patch, _SQUARE)
    # Take for the surroundings a ring of 10 px, outside the blurred rim of the patch (3 px).
    near = cv2.dilate(patch, _SQUARE, iterations=3)
    ring = cv2.subtract(cv2.dilate(near, _SQUARE, iterations=10), near)
    inside, around = hsv[(core if core.any() else patch) > 0], hsv[ring > 0]
    return _narrow_range(_colours(inside), inside.astype(float), around.astype(float))


def _colours(inside: Frame) -> HsvRange:
    """Return the colour range of a patch, widened so that it holds when the light changes.

    For a grey patch the range includes all hues.
    """
    saturation, value = inside[:, 1].astype(float), inside[:, 2].astype(float)
    chroma = float(np.median(saturation * value)) / 255
    if chroma >= frames.MIN_CHROMA:
        turn = np.exp(1j * np.pi * inside[:, 0] / 90)
        middle = round(float(np.angle(turn.mean()) * 90 / np.pi)) % 180
        if np.sum(np.abs(frames.hue_difference(inside[:, 0].astype(float), middle)) <= NEAR_HUE) >= 10:
            return colour_range(inside, middle)
    low, high = np.percentile(value, [3, 97]) / 255
    most = max(1.35 * np.percentile(saturation, 97) / 255, frames.MIN_CHROMA / (255 * max(low, 0.02)))
    return HsvRange(
        saturation=(0.0, two_digits(min(most, 1.0))),
        value=(two_digits(0.65 * low), two_digits(min(1.35 * high, 1.0))),
    )


def _narrow_range(colours: HsvRange, inside: Array, around: Array) -> HsvRange | None:
    """Return the colour range of a patch, narrowed to exclude the surroundings; None if impossible.

    The bound is moved at which patch and surroundings differ most in saturation or value. The new bound is
    midway between patch and surroundings, or at the distance ``SLACK`` from the surroundings if that is
    further away.
    """
    for _ in range(3):
        held = ColourModel(colours).holds(around)
        if np.mean(held) <= MAX_SHARE_AROUND:
            return colours
        gaps = []
        for channel, key in ((1, "saturation"), (2, "value")):
            low, high = np.percentile(inside[:, channel], [5, 95])
            below, above = np.percentile(around[held, channel], [5, 95])
            gaps += [
                (low - above, key, 0, min(low, max((low + above) / 2, above + SLACK))),
                (below - high, key, 1, max(high, min((below + high) / 2, below - SLACK))),
            ]
        gap, key, side, at = max(gaps)
        span = list(getattr(colours, key))
        span[side] = two_digits(at / 255)
        if gap <= 0 or span[0] >= span[1]:
            return None
        colours = colours.model_copy(update={key: (span[0], span[1])})
    return None


# ---------------------------------------------------------------- motion of markers in a trial


def marker_fault(
    track: RawTrack, name: str, min_share: float = frames.MIN_FOUND_SHARE, scene: Array | None = None
) -> tuple[str, str]:
    """Return the code and the text of a warning on a marker that is hardly found or does not move.

    Code and text are empty if the marker is often found and moves. ``scene`` is that of
    :func:`measure_range`.
    """
    share, (_, radii) = float(track.is_whole[track.row(name)].mean()), track.measure_range(name, scene)
    if share < min_share:
        return "SWM040", f"cannot be followed (found in {100 * share:.1f} % of the frames)"
    if radii < frames.MIN_RADII:
        return "SWM067", f"does not move (stays within {radii:.2g} of its radius of one place)"
    return "", ""


def distance_change(run: FilmTrack, one: str, other: str) -> float | None:
    """Return the relative change of the distance between two markers, without the effect of perspective.

    The result is the larger of two values: the robust standard deviation of the distance after rectification,
    and the change due to the rectification that the areas of the markers do not confirm. It is None if the
    markers are hardly ever found together.

    Notes
    -----
    A camera inclined to the plane of motion shows a length smaller where it is further away, and shorter
    along the view than across it. Therefore the picture is first rectified by the homography ``M p / (1 + l
    p)``, with M symmetric of trace 2, for which the distance varies least. Equal lengths determine the
    homography up to a similarity (Liebowitz and Zisserman 1998, Metric rectification for perspective images
    of planes, CVPR, doi:10.1109/CVPR.1998.698649). M is the identity if the heading changes by no more than
    the body may bend. The same homography changes the areas of the markers. A change of the distance without
    the corresponding change of the areas is not due to perspective.
    """
    track = run.track
    i, j = track.row(one), track.row(other)
    both = track.is_whole[i] & track.is_whole[j]
    if both.sum() < frames.MIN_DETECTIONS:
        return None
    # The axes of the array are: x and y, marker, frame.
    points = np.stack([run.video.pixel_aspect * track.x[[i, j]][:, both], track.y[[i, j]][:, both]])
    middle = points.mean(axis=(1, 2), keepdims=True)
    points = (points - middle) / max(float(np.abs(points - middle).max()), 1.0)
    heading = np.unwrap(np.arctan2(*(points[:, 0] - points[:, 1])[::-1]))
    # If the line between the markers turns by less than 60 degrees, a bend of the body may explain a change
    # of their distance.
    turns = float(np.ptp(heading)) > math.radians(60.0)

    def scatter_of(view: Array) -> Array:
        apart = np.log(np.maximum(np.hypot(*np.diff(_rectify(points, view), axis=1)[:, 0]), 1e-9))
        return np.asarray(apart - np.median(apart))

    bound, limit = np.array([0.7, 0.7, 0.6, 0.6])[: 4 if turns else 2], frames.MAX_DISTANCE_SD[1]
    # Use a robust loss, because another object may be taken for a marker in some frames.
    robust: dict[str, Any] = {"bounds": (-bound, bound), "loss": "cauchy", "f_scale": limit}
    view = least_squares(scatter_of, np.zeros(len(bound)), **robust).x
    left = scatter_of(view)
    alike = np.abs(left) <= 3.0 * limit
    place = points.mean(axis=1)[:, alike]
    shrunk = -1.5 * np.log1p(view[:2] @ place)
    size = 0.5 * np.log(track.area[[i, j]][:, both].sum(axis=0))[alike]
    design = np.column_stack([np.ones(alike.sum()), *place])
    smooth, unshared = (design @ np.linalg.lstsq(design, v, rcond=None)[0] for v in (size, size + shrunk))
    # The outline of a patch is known to one pixel. Therefore the area of a small marker is uncertain, and the
    # change of area that this uncertainty can cause is not counted.
    blurred = float(np.ptp(math.sqrt(2 * math.pi) / np.exp(smooth)))
    drift = min(float(np.ptp(shrunk)), max(float(np.ptp(unshared)) - blurred, 0.0))
    return max(1.4826 * float(np.median(np.abs(left))), drift)


def _rectify(points: Array, view: Array) -> Array:
    """Return image points, shape (2, m, n), after rectification by a homography.

    ``view`` contains the vector l, and optionally the two parameters of the matrix M (see
    :func:`distance_change`).
    """
    a, b = (*view[2:], 0.0, 0.0)[:2]
    x, y = points
    return np.stack([(1 + a) * x + b * y, b * x + (1 - a) * y]) / (1 + view[0] * x + view[1] * y)


def interpolate_shifts(shift: Array, indices: NDArray[np.int64], count: int) -> Array | None:
    """Return the shift of the scene in all ``count`` frames, interpolated from the shift in some frames.

    The result has the shape (2, count). It is None if the shift is known in fewer than two frames.
    """
    known = np.isfinite(shift[:, 0])
    if known.sum() < 2:
        return None
    frames = np.arange(count)
    return np.array([np.interp(frames, indices[known], row[known]) for row in shift.T])
