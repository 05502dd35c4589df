"""A setup drafted from the video itself: compact patches of a rare colour that move."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import NoTrustworthyResult
from swimid.progress import Step
from swimid.tracking import colour
from swimid.tracking.colour import ColourModel
from swimid.tracking.detect import marker_mask
from swimid.tracking.reader import Frame, FrameKeeper, Video, largest_channel
from swimid.tracking.setup import Box, HsvRange

Array = NDArray[np.float64]

#: Frames looked at, and the width they are reduced to.
SAMPLES, SAMPLE_WIDTH = 48, 960
#: A pixel this far (grey levels) from the still background moves.
LEAST_CHANGE = 16
#: Hue clusters looked at.
MOST_CLUSTERS = 8
#: Below this score nothing is proposed.
LEAST_SCORE = 0.02
#: A patch moves where this share of its pixels differs from the empty scene, in colour too.
MOVING = 0.3
#: A second marker scores at least this share of the first, and is about as far from it in all samples (a
#: camera askew changes distances by much; the trial run tells whether the pair is rigid).
SECOND_SHARE, SECOND_SPREAD = 0.25, 0.3


@dataclass(frozen=True)
class Samples:
    """Frames spread over a video, reduced in size."""

    video: Video
    indices: NDArray[np.int64]
    frames: list[Frame]
    #: Size of a sample pixel in picture pixels.
    factor: float
    #: Median of the samples: the scene without what moves.
    background: Frame
    #: 255 where a sample differs from the background.
    moving: list[NDArray[np.uint8]]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A colour that may be a marker's."""

    #: Everyday name, and middle.
    name: str
    hue_deg: float
    colours: HsvRange
    #: 0 to 1.
    score: float = 0.0
    #: Centre of its best patch in each sample, shape (n, 2), picture pixels; NaN where there is none.
    place: Array = field(default_factory=lambda: np.zeros((0, 2)))
    #: Smallest and largest area worth accepting, picture pixels.
    area_px: tuple[float, float] = (0.0, 0.0)
    #: Usual number of moving patches of the colour and a comparable size.
    like: int = 0
    #: Motionless patches of the colour, picture pixels.
    still: list[Box] = field(default_factory=list)
    #: Why it is no marker; empty where it may be one.
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.name} (hue {self.hue_deg:g} deg): {self.reason}"

    @property
    def presence(self) -> float:
        """Share of the samples it is seen in."""
        return float(np.mean(np.isfinite(self.place[:, 0])))

    @property
    def remark(self) -> str:
        """What a reader of the setup wants to know of it."""
        text = f"score {self.score:.2f}, seen in {100 * self.presence:.0f} % of the samples"
        if self.like > 1:
            text += f"; {self.like} patches of this colour move together: the largest is followed"
        return text

    def crosses(self, box: Box) -> bool:
        """Whether it was seen inside a box."""
        left, top, right, bottom = box
        reach = np.sqrt(self.area_px[1] / 3)
        x, y = self.place.T
        inside = (x > left - reach) & (x < right + reach) & (y > top - reach) & (y < bottom + reach)
        return bool(np.any(inside))


def sample(path: Path, *, apply_rotation: bool = True, step: Step) -> Samples:
    """Read a video once and keep :data:`SAMPLES` frames of it, evenly spread."""
    video = Video(path, apply_rotation=apply_rotation)
    keeper = FrameKeeper(2 * SAMPLES, max(video.claimed // SAMPLES, 1), SAMPLE_WIDTH)
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
        moving.append(
            np.where(change > max(LEAST_CHANGE, 4 * float(np.median(change))), 255, 0).astype(np.uint8)
        )
    factor = max(video.width / SAMPLE_WIDTH, 1.0)
    return Samples(video, np.array(list(keeper.kept)), frames, factor, background, moving)


def candidates(samples: Samples) -> tuple[list[Candidate], list[Candidate]]:
    """Colours that may be markers, best first, and those that are none.

    Raises
    ------
    NoTrustworthyResult
        When the video has no colour, or nothing coloured moves.
    """
    moving = []
    for frame, mask in zip(samples.frames, samples.moving, strict=True):
        chosen = (mask > 0) & (colour.chroma(frame) >= colour.LEAST_CHROMA)
        moving.append(cv2.cvtColor(cv2.blur(frame, (3, 3)), cv2.COLOR_BGR2HSV)[chosen])
    hsv = np.concatenate(moving)
    if len(hsv) < 4 * len(samples.frames):
        raise NoTrustworthyResult(
            f"no coloured marker moves in {samples.video.path.name}. "
            f"{colour.describe_colours(samples.frames[::6])}",
            hint="put a saturated sticker (red, yellow, green) on the robot and keep the film in colour; a "
            "marker that hardly moves, or is white, grey or black, is picked by hand: --marker name@x,y; "
            "a whole body "
            "in front of its empty scene is followed with --background",
        )
    judged = [_judge(samples, hsv, peak) for peak in _peaks(hsv, len(samples.frames))]
    passed = [c for c in judged if c is not None and c.reason]
    good = sorted((c for c in judged if c is not None and not c.reason), key=lambda c: -c.score)
    if not good:
        raise NoTrustworthyResult(
            f"nothing in {samples.video.path.name} looks like a marker: a compact patch of one colour that "
            f"moves. {listed(passed)}{colour.describe_colours(samples.frames[::6])}",
            hint="pick it by hand: --marker name@x,y with --frame",
        )
    return good, passed


def listed(passed: list[Candidate]) -> str:
    """Colours passed over and why, as a sentence; empty without any."""
    return f"Passed over: {'; '.join(map(str, passed))}. " if passed else ""


def _peaks(hsv: NDArray[np.uint8], frames: int) -> list[int]:
    """Hues (0 .. 179) about which moving coloured pixels gather, most pixels first."""
    histogram = np.bincount(hsv[:, 0], minlength=180)[:180].astype(float)
    kernel = np.exp(-0.5 * (np.arange(-9, 10) / 3.0) ** 2)
    smooth = np.convolve(np.pad(histogram, 9, mode="wrap"), kernel / kernel.sum(), "valid")
    top = [
        h
        for h in range(180)
        if smooth[h] >= smooth[h - 1] and smooth[h] > smooth[(h + 1) % 180] and 10 * smooth[h] > 4 * frames
    ]
    return sorted(top, key=lambda h: -smooth[h])[:MOST_CLUSTERS]


def colour_range(hsv: NDArray[np.uint8], peak: int) -> HsvRange | None:
    """The range about a hue that holds nearly all pixels near it, with room for changing light."""
    offset = (hsv[:, 0].astype(float) - peak + 90) % 180 - 90
    near = np.abs(offset) <= 12
    if near.sum() < 10:
        return None
    cluster = hsv[near].astype(float)
    # The purer half of the cluster is the marker, the rest its blurred rim.
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
    """A share as a setup holds it."""
    return float(round(value, 2))


def _judge(samples: Samples, hsv: NDArray[np.uint8], peak: int) -> Candidate | None:
    """Look for patches of one colour in all samples and score them as a marker; None for hardly a pixel."""
    colours = colour_range(hsv, peak)
    if colours is None:
        return None
    model = ColourModel(colours)
    least = max(5.0, 2e-5 * samples.frames[0].shape[0] * samples.frames[0].shape[1])
    places = np.full((len(samples.frames), 2), np.nan)
    areas, compact, like, purity = [], [], [], []
    in_range = moving_in_range = 0.0
    scenery = marker_mask(samples.background, model)
    still = _still(scenery, samples.factor, least)
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
        like.append(sum(1 for other in patches if other[0] > 0.4 * area))
        chroma = colour.chroma(frame)
        purity.append(float(np.mean(chroma[int(y) - 1 : int(y) + 2, int(x) - 1 : int(x) + 2])))
    name, hue = colour.hue_name(_degrees(peak)), _degrees(peak)
    if len(areas) < max(3, 0.05 * len(samples.frames)):
        where = "; ".join("[" + ", ".join(f"{v:g}" for v in box) + "]" for box in still[:3])
        reason = f"a compact patch of it moves in {len(areas)} of {len(samples.frames)} samples only"
        if np.mean(scenery > 0) > 0.5:
            reason = "the background's colour"
        elif still:
            reason = f"does not move (it lies at {where})"
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
    if score < LEAST_SCORE:
        reason = f"hardly like a marker (score {score:.3f}: scattered, uneven or hardly moving)"
        return Candidate(name, hue, colours, reason=reason)
    low, high = np.percentile(sizes, [5, 95])
    sized = (float(math.floor(0.3 * low)), float(math.ceil(3 * high)))
    return Candidate(name, hue, colours, float(score), places, sized, int(np.median(like)), still)


def _patches(
    mask: NDArray[np.uint8], moving: NDArray[np.uint8], scenery: NDArray[np.uint8], least: float
) -> list[tuple[float, float, float, float]]:
    """Moving patches clear of the picture's edge: (area, x, y, how much of a disc), largest first.

    Where the empty scene has the colour anyway (``scenery``), a change of light or something that passes
    over it is no motion of it.
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


def _still(scenery: NDArray[np.uint8], factor: float, least: float) -> list[Box]:
    """Boxes about the largest patches of the colour in the empty scene."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(scenery, connectivity=8)
    largest = sorted(stats[1:].tolist(), key=lambda s: -s[4])[:8]
    return [
        (
            float(round(factor * left)),
            float(round(factor * top)),
            float(round(factor * (left + width))),
            float(round(factor * (top + height))),
        )
        for left, top, width, height, area in largest
        if area >= least
    ]


def partners(first: Candidate, others: list[Candidate]) -> list[Candidate]:
    """The colours that may be the second marker of a rigid part, those at the steadiest distance first."""
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
