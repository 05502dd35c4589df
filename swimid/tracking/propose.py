"""Markers for the draft of a setup, proposed from the film or picked by hand.

:func:`find_candidates` searches for colours whose patches are compact and move. :func:`pick_markers` finds
the patch about a pixel, and the range of colours that separates the patch from its surroundings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult
from swimid.notices import warn
from swimid.progress import Step
from swimid.tracking import detect
from swimid.tracking.detect import SLACK, ColourModel, marker_mask
from swimid.tracking.reader import Frame, FrameKeeper, Video, largest_channel
from swimid.tracking.setup import HsvRange, Marker

Array = NDArray[np.float64]

#: Number of frames that are evaluated, and width to which they are reduced, px.
N_SAMPLES, SAMPLE_WIDTH = 48, 960
#: Minimum difference of a moving pixel from the background: in grey levels, and relative to the median
#: difference in the frame.
MIN_DIFFERENCE, MIN_DIFFERENCE_RATIO = 16, 4
#: Minimum fraction of the pixels of a moving patch that differ from the empty scene. The empty scene must
#: also have another colour in at least this fraction of the pixels.
MOVING = 0.3
#: Minimum score of a proposed marker, and maximum number of hues that are examined.
MIN_SCORE, MAX_HUES = 0.02, 8
#: Minimum score of a second marker relative to the first, and maximum relative deviation of the distance
#: between the two. The latter is large because an inclined camera changes distances. The trial run shows
#: whether the pair is rigid.
SECOND_SHARE, SECOND_SPREAD = 0.25, 0.3
#: Ranges of colours that are tried about a pixel, as fractions of the widest range. The range at which the
#: patch grows least is used. Matas, J. et al. (2002), Robust wide baseline stereo from maximally stable
#: extremal regions, BMVC. doi:10.5244/C.16.36
SHARES = (0.25, 0.35, 0.5, 0.7, 1.0)
#: Half-widths of the widest range of colours: hue (deg), saturation, value.
WIDEST = (20.0, 0.3, 0.3)
#: Minimum area of a patch, px; maximum area without a warning, and maximum area of a marker, both as
#: fractions of the picture.
MIN_PATCH_PX, LARGE, LARGEST = 5, 0.05, 0.5
#: Maximum fraction of the surroundings of a marker that may have colours in its range.
MAX_SHARE_AROUND = 0.1
BACKGROUND = "put the whole marker on a background of another colour or brightness"
Mask = NDArray[np.uint8]
_SQUARE = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class Samples:
    """Frames spread evenly over a film, reduced in size."""

    video: Video
    indices: NDArray[np.int64]
    frames: list[Frame]
    #: Width of a pixel of a reduced frame in pixels of the picture.
    factor: float
    #: Median of the frames, in which moving objects are absent.
    background: Frame
    #: Masks of the frames, 255 for pixels that differ from the background.
    moving: list[NDArray[np.uint8]]


@dataclass(frozen=True, eq=False)
class Candidate:
    """Colour that may be the colour of a marker. Lengths are in px of the picture."""

    #: Common name of the hue, and middle of the hue range.
    name: str
    hue_deg: float
    colours: HsvRange
    #: Score as a marker, from 0 to 1.
    score: float = 0.0
    #: Centre of the largest patch in each evaluated frame, shape (n, 2); NaN without a patch.
    place: Array = field(default_factory=lambda: np.zeros((0, 2)))
    #: Minimum and maximum area of the patch, px.
    area_px: tuple[float, float] = (0.0, 0.0)
    #: Reason why the candidate is not a marker; empty if it may be a marker.
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.name} (hue {self.hue_deg:g} deg): {self.reason}"

    @property
    def presence(self) -> float:
        """Fraction of the evaluated frames in which the candidate is seen."""
        return float(np.mean(np.isfinite(self.place[:, 0])))


def sample(path: Path, *, step: Step) -> Samples:
    """Return about :data:`N_SAMPLES` frames, spread evenly over a film."""
    video = Video(path)
    keeper = FrameKeeper(2 * N_SAMPLES, max(video.claimed // N_SAMPLES, 1), SAMPLE_WIDTH)
    for index, (_, frame) in enumerate(video.frames()):
        step()
        keeper.take(index, frame)
    frames = list(keeper.kept.values())
    if len(frames) < 4:
        raise NoTrustworthyResult(f"{path.name} has only {len(frames)} frames: too few to see what moves")
    background = np.median(np.stack(frames[:: max(len(frames) // 25, 1)]), axis=0).astype(np.uint8)
    still = cv2.blur(background, (3, 3))
    moving = []
    for frame in frames:
        change = largest_channel(cv2.absdiff(cv2.blur(frame, (3, 3)), still))
        limit = max(MIN_DIFFERENCE, MIN_DIFFERENCE_RATIO * float(np.median(change)))
        moving.append(np.where(change > limit, 255, 0).astype(np.uint8))
    factor = max(video.width / SAMPLE_WIDTH, 1.0)
    return Samples(video, np.array(list(keeper.kept)), frames, factor, background, moving)


def find_candidates(samples: Samples) -> tuple[list[Candidate], list[Candidate]]:
    """Return the colours that may be those of markers, best first, and the rejected colours.

    Raises
    ------
    NoTrustworthyResult
        The film has no colour, nothing coloured moves, or nothing looks like a marker.
    """
    moving = []
    for frame, mask in zip(samples.frames, samples.moving, strict=True):
        chosen = (mask > 0) & (detect.chroma(frame) >= detect.MIN_CHROMA)
        moving.append(cv2.cvtColor(cv2.blur(frame, (3, 3)), cv2.COLOR_BGR2HSV)[chosen])
    hsv = np.concatenate(moving)
    if len(hsv) < 4 * len(samples.frames):
        raise NoTrustworthyResult(
            f"no coloured marker moves in {samples.video.path.name}. "
            f"{detect.describe_colours(samples.frames[::6])}",
            hint="put a saturated sticker on the robot and keep the film in colour; pick a marker that "
            "hardly moves, or is white, grey or black, by hand (--marker name@x,y)",
        )
    judged = [_judge(samples, hsv, peak) for peak in _peaks(hsv, len(samples.frames))]
    passed = [c for c in judged if c is not None and c.reason]
    good = sorted((c for c in judged if c is not None and not c.reason), key=lambda c: -c.score)
    if not good:
        raise NoTrustworthyResult(
            f"nothing in {samples.video.path.name} looks like a marker: a compact patch of one colour that "
            f"moves. {listed(passed)}{detect.describe_colours(samples.frames[::6])}",
            hint="pick it by hand: --marker name@x,y with --frame",
        )
    return good, passed


def listed(passed: list[Candidate]) -> str:
    """Return a sentence on the rejected colours and the reasons; an empty text without any."""
    return f"Passed over: {'; '.join(map(str, passed))}. " if passed else ""


def _peaks(hsv: NDArray[np.uint8], frames: int) -> list[int]:
    """Return the hues (0 .. 179) of maxima in the histogram of moving coloured pixels, largest first."""
    histogram = np.bincount(hsv[:, 0], minlength=180)[:180].astype(float)
    kernel = np.exp(-0.5 * (np.arange(-9, 10) / 3.0) ** 2)
    smooth = np.convolve(np.pad(histogram, 9, mode="wrap"), kernel / kernel.sum(), "valid")
    top = [
        h
        for h in range(180)
        if smooth[h] >= smooth[h - 1] and smooth[h] > smooth[(h + 1) % 180] and 10 * smooth[h] > 4 * frames
    ]
    return sorted(top, key=lambda h: -smooth[h])[:MAX_HUES]


def colour_range(hsv: NDArray[np.uint8], peak: int) -> HsvRange | None:
    """Return the range about a hue with nearly all pixels of similar hue, widened for changing light."""
    offset = (hsv[:, 0].astype(float) - peak + 90) % 180 - 90
    near = np.abs(offset) <= 12
    if near.sum() < 10:
        return None
    cluster = hsv[near].astype(float)
    # the pixels of pure colour are the marker, and the other pixels are its blurred rim
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
    """Return a fraction rounded to two digits, as in a setup file."""
    return float(round(value, 2))


def _judge(samples: Samples, hsv: NDArray[np.uint8], peak: int) -> Candidate | None:
    """Score the patches of one colour in all frames as a marker; return None for very few pixels."""
    colours = colour_range(hsv, peak)
    if colours is None:
        return None
    model = ColourModel(colours)
    least = max(5.0, 2e-5 * samples.frames[0].shape[0] * samples.frames[0].shape[1])
    places = np.full((len(samples.frames), 2), np.nan)
    areas, compact, purity = [], [], []
    in_range = moving_in_range = 0.0
    scenery = marker_mask(samples.background, model)
    for k, (frame, moving) in enumerate(zip(samples.frames, samples.moving, strict=True)):
        mask = marker_mask(frame, model)
        in_range += float(np.count_nonzero(mask))
        moving_in_range += float(np.count_nonzero(mask & moving))
        patches = _patches(mask, moving, scenery, least)
        if not patches:
            continue
        area, x, y, fill = patches[0]
        places[k] = samples.factor * (np.array([x, y]) + 0.5) - 0.5
        areas.append(area)
        compact.append(fill)
        chroma = detect.chroma(frame)
        purity.append(float(np.mean(chroma[int(y) - 1 : int(y) + 2, int(x) - 1 : int(x) + 2])))
    hue = _degrees(peak)
    name = detect.hue_name(hue)
    if len(areas) < max(3, 0.05 * len(samples.frames)):
        reason = f"does not move (but for {len(areas)} of {len(samples.frames)} samples)"
        return Candidate(name, hue, colours, reason=reason)
    sizes = samples.factor**2 * np.array(areas)
    spread = 1.4826 * float(np.median(np.abs(np.log(sizes / np.median(sizes)))))
    presence = len(areas) / len(samples.frames)
    alone = moving_in_range / max(in_range, 1.0)
    way = float(np.max(np.nanpercentile(places, 95, axis=0) - np.nanpercentile(places, 5, axis=0)))
    moved = min(way / (2.0 * math.sqrt(float(np.median(sizes)))), 1.0)
    score = (
        presence
        * float(np.median(compact))
        * math.exp(-spread)
        * math.sqrt(min(float(np.median(purity)) / 100, 1.0))
        * math.sqrt(alone)
        * moved
    )
    if score < MIN_SCORE:
        reason = f"hardly like a marker (score {score:.3f}: scattered, uneven or hardly moving)"
        return Candidate(name, hue, colours, reason=reason)
    low, high = np.percentile(sizes, [5, 95])
    sized = (float(math.floor(0.3 * low)), float(math.ceil(3 * high)))
    return Candidate(name, hue, colours, float(score), places, sized)


def _patches(
    mask: NDArray[np.uint8], moving: NDArray[np.uint8], scenery: NDArray[np.uint8], least: float
) -> list[tuple[float, float, float, float]]:
    """Return the moving patches inside the picture as (area, x, y, fraction of a disc), largest first.

    A patch does not move if the empty scene (``scenery``) has the colour at the same position, too. In this
    case the light has changed, or an object passes over the patch.
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
        if area >= least and inside and moved[label] > MOVING * area and stays[label] < (1 - MOVING) * area:
            fill = min(area / (0.785 * max(width, height) ** 2), 1.0)
            found.append((float(area), float(centres[label][0]), float(centres[label][1]), float(fill)))
    return sorted(found, reverse=True)


def partners(first: Candidate, others: list[Candidate]) -> list[Candidate]:
    """Return possible second markers on the same rigid part, the most constant distance first."""
    found: list[tuple[float, Candidate]] = []
    for other in others:
        if other is first or other.score < SECOND_SHARE * first.score:
            continue
        both = np.isfinite(first.place[:, 0]) & np.isfinite(other.place[:, 0])
        if both.sum() < max(4, 0.5 * np.isfinite(first.place[:, 0]).sum()):
            continue
        distance = np.hypot(*(first.place[both] - other.place[both]).T)
        middle = float(np.median(distance))
        spread = 1.4826 * float(np.median(np.abs(distance - middle)))
        sizes = first.area_px[1] / other.area_px[1]
        if middle > 3 and spread < SECOND_SPREAD * middle and 0.1 < sizes < 10:
            found.append((spread / middle, other))
    return [other for _, other in sorted(found, key=lambda item: item[0])]


def pick_markers(
    frame: Frame, kinds: dict[str, list[tuple[float, float]]], *, path: Path, index: int
) -> list[Marker]:
    """Return markers from one pixel of each.

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
        mine = ColourModel(marker.hsv).mask(hsv)
        for other, mask in patches:
            if other != marker.name and np.mean(mine[mask > 0] > 0) > 0.5:
                raise InputError(
                    f"markers '{marker.name}' and '{other}' have one colour, and would be exchanged",
                    hint=f"name them alike (--marker {marker.name}@x,y for both); they become "
                    f"{marker.name}1, {marker.name}2 and are distinguished by their places",
                    **place,
                )
    return found


def _patch(frame: Frame, hsv: Mask, option: str, pixel: tuple[float, float], place: dict[str, Any]) -> Mask:
    """Return the mask of the patch about a pixel: 255 inside, shape (rows, columns)."""
    rows, columns = hsv.shape[:2]
    x, y = pixel
    if not (0 <= x < columns and 0 <= y < rows):
        raise InputError(f"{option} is outside the picture of {columns} x {rows} pixels", **place)
    i, j = int(y), int(x)
    grey = int(detect.chroma(frame)[i, j]) < detect.MIN_CHROMA
    patches: list[Mask] = []
    for share in SHARES:
        mask = ColourModel(_about(hsv[i, j], share, grey)).mask(hsv)
        _, labels = cv2.connectedComponents(mask, connectivity=8)
        patch = np.where((labels == labels[i, j]) & (mask > 0), 255, 0).astype(np.uint8)
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


def _about(pixel: Mask, share: float, grey: bool) -> HsvRange:
    """Return the range of colours about the colour of a pixel; for a grey pixel it includes all hues."""
    hue, saturation, value = 2.0 * pixel[0], pixel[1] / 255, pixel[2] / 255
    wide_hue, wide_saturation, wide_value = (share * width for width in WIDEST)
    value_span = (max(value - wide_value, 0.0), min(value + wide_value, 1.0))
    if grey:
        # saturation is chroma divided by value: noise alone makes it large on dark pixels
        most = max(saturation + wide_saturation, detect.MIN_CHROMA / (255 * max(value, 0.02)))
        return HsvRange(saturation=(0.0, min(most, 1.0)), value=value_span)
    return HsvRange(
        hue_deg=((hue - wide_hue) % 360, (hue + wide_hue) % 360),
        saturation=(max(saturation - wide_saturation, 0.08), min(saturation + 2 * wide_saturation, 1.0)),
        value=value_span,
    )


def _marker(hsv: Mask, name: str, masks: list[Mask], place: dict[str, Any]) -> Marker:
    """Return one kind of marker from the masks of its patches."""
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


def _range_of(hsv: Mask, patch: Mask) -> HsvRange | None:
    """Return the colours that separate a patch from its surroundings; None if there are none."""
    core = cv2.erode(patch, _SQUARE)
    # the surroundings are a ring of 10 px outside the blurred rim of 3 px
    near = cv2.dilate(patch, _SQUARE, iterations=3)
    ring = cv2.subtract(cv2.dilate(near, _SQUARE, iterations=10), near)
    inside, around = hsv[(core if core.any() else patch) > 0], hsv[ring > 0]
    return _separated(_colours(inside), inside.astype(float), around.astype(float))


def _colours(inside: Mask) -> HsvRange:
    """Return the colours of a patch, widened for changing light; for a grey patch they include all hues."""
    saturation, value = inside[:, 1].astype(float), inside[:, 2].astype(float)
    chroma = float(np.median(saturation * value)) / 255
    if chroma >= detect.MIN_CHROMA:
        turn = np.exp(1j * np.pi * inside[:, 0] / 90)
        middle = round(float(np.angle(turn.mean()) * 90 / np.pi)) % 180
        found = colour_range(inside, middle)
        if found is not None:
            return found
    low, high = np.percentile(value, [3, 97]) / 255
    most = max(1.35 * np.percentile(saturation, 97) / 255, detect.MIN_CHROMA / (255 * max(low, 0.02)))
    return HsvRange(
        saturation=(0.0, two_digits(min(most, 1.0))),
        value=(two_digits(0.65 * low), two_digits(min(1.35 * high, 1.0))),
    )


def _separated(colours: HsvRange, inside: Array, around: Array) -> HsvRange | None:
    """Return the range of colours, narrowed to exclude the surroundings; None if that is impossible.

    A bound is moved where patch and surroundings differ most in saturation or value. The new bound is in the
    middle between them, or at the distance ``SLACK`` from the surroundings if that is further away.
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
