"""Every marker from frame to frame: windows about predictions, the whole picture when lost.

:class:`Search` finds patches of a colour in a window or in the whole picture, a :class:`Target` is what is
known of one marker, and :class:`Follower` assigns the patches to the targets. :func:`follow` does so from the
first frame of a video to the last, a second time where the first was fooled.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from swimid.errors import InputError
from swimid.logs.log import runs
from swimid.notices import warn
from swimid.progress import Step
from swimid.tracking import detect, pose, quality
from swimid.tracking.detect import GROWN, LOST, WINDOW, Blob, ColourModel, Patch, RawTrack
from swimid.tracking.reader import Frame, FrameKeeper, Video
from swimid.tracking.setup import Box, Marker, Setup

if TYPE_CHECKING:
    from swimid.tracking.silhouette import Silhouette

#: Frames kept for the report.
REPORT_FRAMES = 6
#: A sighting this short, alone between losses, is not believed.
SHORTEST_RUN = 3
#: A lost marker that comes back has its usual colour: hue (steps of 2 deg) and relative saturation.
RETURN_HUE, RETURN_SATURATION = 12.0, 0.5
#: Only a run shorter than this share of all sightings is doubted for its look.
FALSE_SHARE = 0.2
#: In a window the mask is made of every n-th pixel at most.
MASK_STEP = 4
#: Share of the smallest area a patch seen on every n-th pixel only must have.
_ROUGH = 0.4
#: Black bars: grey levels below which a pixel is black (video black is 16 where its range is misread),
#: the share of a row or column that is, and the least width, px.
_BLACK, _BLACK_SHARE, _LEAST_BAR = 24, 0.98, 4
#: Earlier frames kept, and how often, to see whether a thing was there before the marker was lost.
MEMORIES, MEMORY_FRAMES = 2, 120
#: Of equal markers, one this far (as a share) from its partner's distance is another's.
RIGID_LIMIT = 0.3
_NO = 1e6
_NOT_SEEN = (math.nan, math.nan, math.nan, 0.0, LOST, False, math.nan, math.nan, math.nan)


@dataclass
class Target:
    """A marker. Lengths in px, times in s."""

    name: str
    x: float = math.nan
    y: float = math.nan
    vx: float = 0.0
    vy: float = 0.0
    time: float = -math.inf
    sights: int = 0
    missed: int = 0
    innovation_px: float = 0.0
    radius: float = 0.0
    #: Sights of it whole. Only from these its looks are known: cut by the picture's edge it is of any size.
    whole: int = 0
    area: float = 0.0
    contrast: float = 0.0
    #: Slow averages: what it usually is, not what it was last.
    pace: float = 0.0
    usual_area: float = 0.0
    colour: NDArray[np.float64] | None = None
    challenger: Challenger | None = None

    def predicted(self, time: float) -> tuple[float, float]:
        """Where it should be, with its last speed."""
        dt = time - self.time
        return self.x + self.vx * dt, self.y + self.vy * dt

    def reach(self, dt: float) -> float:
        """How far beyond the marker's own size it may be from the prediction after ``dt``."""
        steps = 1 + self.missed
        moved = math.hypot(self.vx, self.vy) * dt
        start = 12.0 + self.radius if self.sights < 3 else 6.0
        return start + (0.3 * moved + 3.0 * self.innovation_px) + (steps - 1) * 0.5 * self.radius

    def see(self, blob: Blob, time: float) -> None:
        """Take a sighting: move there; of one that is whole learn size, colour and contrast."""
        if self.sights and time > self.time:
            self._move(blob, time)
        if not blob.at_edge:
            self._learn(blob)
        elif not self.whole:
            self.radius = max(self.radius, blob.radius)
        self.x, self.y, self.time = blob.x, blob.y, time
        self.sights += 1
        self.missed = 0

    def _move(self, blob: Blob, time: float) -> None:
        x, y = self.predicted(time)
        error = math.hypot(blob.x - x, blob.y - y)
        if self.sights > 1 and error > 8 * self.radius + 40:
            self.vx = self.vy = 0.0  # found again elsewhere: its speed is not known
        else:
            # the second sighting tells the speed, later ones half of its change
            gain, dt = 1.0 if self.sights == 1 else 0.5, time - self.time
            self.vx += gain * (blob.x - x) / dt
            self.vy += gain * (blob.y - y) / dt
        self.innovation_px += 0.3 * (min(error, 4 * self.radius + 20) - self.innovation_px)
        self.pace = max(self.pace + 0.05 * (math.hypot(self.vx, self.vy) - self.pace), 0.0)

    def _learn(self, blob: Blob) -> None:
        blend = 0.15 if self.whole else 1.0
        self.contrast += blend * (blob.contrast - self.contrast)
        self.area += blend * (blob.area - self.area)
        self.radius += blend * (blob.radius - self.radius)
        slow = max(0.01, 1 / (self.whole + 1))
        self.usual_area += slow * (blob.area - self.usual_area)
        old = blob.hsv if self.colour is None else self.colour
        self.colour = old + slow * detect.colour_difference(blob.hsv, old)
        self.whole += 1


@dataclass
class Challenger(Target):
    """A thing unlike a missed target, followed because it may be the marker and the target a mistake."""

    #: Where it was first seen, px.
    start: tuple[float, float] = (math.nan, math.nan)
    #: It has been farther from there than its own size.
    moved: bool = False
    #: What was measured of it, by frame.
    rows: dict[int, tuple[float, ...]] = field(default_factory=dict)

    def see(self, blob: Blob, time: float) -> None:
        """Take a sighting."""
        if not self.sights:
            self.start = (blob.x, blob.y)
        super().see(blob, time)
        self.moved = self.moved or blob.away(*self.start) > 2 * self.radius

    def prevails(self, target: Target) -> bool:
        """Whether it, not the target, is the marker.

        It does by the rule that takes back short stretches of a finished track: the target's sights are
        less than ``FALSE_SHARE`` of all. A thing that stays where it is contests only what was
        never seen whole: a ladder put into the pool is not the swimmer that has just left it.
        """
        if not target.whole:
            return self.whole >= SHORTEST_RUN
        return self.moved and target.whole < FALSE_SHARE * (target.whole + self.whole)


@dataclass
class PairDistance:
    """Distance between two markers, to find out whether they sit on one rigid part."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0

    def add(self, distance: float) -> None:
        """Take the distance in one frame, px."""
        self.count += 1
        delta = distance - self.mean
        self.mean += delta / self.count
        self.squares += delta * (distance - self.mean)

    @property
    def rigid(self) -> bool:
        """Whether it hardly varied over many frames."""
        spread = math.sqrt(self.squares / max(self.count - 1, 1))
        return self.count >= 20 and spread < 0.06 * self.mean


_KNOWN = {field.name for field in fields(Target)}


@dataclass
class Group:
    """Markers of one colour."""

    marker: Marker
    model: ColourModel
    #: Smallest and largest.
    area_px: tuple[float, float]
    targets: list[Target]
    #: Things of the colour that are known to be something else.
    scenery: list[Blob] = field(default_factory=list)
    #: Other things of the colour at the last look around, and where the markers were then.
    rivals: list[Blob] = field(default_factory=list)
    seen_from: list[tuple[float, float]] = field(default_factory=list)
    most_rivals: int = 0
    next_look: int = 0
    #: Frames between looks around.
    pause: int = 12

    def alike(self, target: Target, blob: Blob, gone: float = 0.0) -> bool:
        """Whether a blob may be the target by its size and contrast, as far as these are known."""
        if not target.whole:
            # Equal markers are of one size; else a blob of any the setup allows may be it.
            like = [t.usual_area for t in self.targets if t.whole]
            return not like or blob.at_edge or 0.5 < blob.area / max(like) < 2.0
        alone = len(self.targets) == 1
        # Equal markers that touch look like one of twice the size, half hidden ones are off centre.
        low, high = (0.3, 3.0) if alone else (0.7, 1.4)
        ratio = blob.area / (target.usual_area if gone or not alone else target.area)
        if not (0.0 if blob.at_edge else low) <= ratio <= high or blob.contrast < 0.4 * target.contrast:
            return False
        if not gone or target.colour is None:
            return True
        return bool(detect.same_hue_and_saturation(blob.hsv, target.colour, RETURN_HUE, RETURN_SATURATION))

    def merit(self, blob: Blob) -> float:
        """How much of a marker a blob looks, of which nothing but its colour is known."""
        fit = 1.5 - min(self.model.distance(blob.hsv), 1.0)
        return math.sqrt(blob.contrast * blob.area) * fit * (0.3 if blob.at_edge else 1.0)

    def first_choice(self, fresh: list[Target], blobs: list[Blob]) -> list[tuple[Target, Blob]]:
        """Which blobs are targets never seen before; named when all are there, from left to right."""
        if not fresh or (len(blobs) < len(fresh) and len(fresh) > 1):
            return []
        if self.marker.start_px is not None:
            starts = dict(zip(self.marker.names, self.marker.start_px, strict=True))
            away = np.array([[b.away(*starts[t.name]) for b in blobs] for t in fresh])
            return [(fresh[i], blobs[j]) for i, j in zip(*linear_sum_assignment(away), strict=True)]
        best = sorted(blobs, key=self.merit, reverse=True)[: len(fresh)]
        return list(zip(fresh, sorted(best, key=lambda blob: blob.x), strict=False))

    def note_rivals(self, rivals: list[Blob], frame: int) -> None:
        """Remember what else has this colour, so that it is not taken for a lost marker."""
        here = [(t.x, t.y) for t in self.targets]
        moved = any(
            math.dist(place, before) > t.radius + 2
            for t, place, before in zip(self.targets, here, self.seen_from, strict=False)
        )
        if moved:
            still = [b for b in rivals if any(same_place(b, old) for old in self.rivals)]
            self.scenery += [b for b in still if not any(same_place(b, old) for old in self.scenery)]
        if moved or not self.seen_from or math.isnan(self.seen_from[0][0]):
            self.rivals, self.seen_from = rivals, here
        self.most_rivals = max(self.most_rivals, len(rivals))
        self.next_look = frame + self.pause
        self.pause = min(2 * self.pause, 180)


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
            text = f"region_px {list(self._region)} lies outside the picture of {width} x {height} pixels"
            raise InputError(text, hint="it is [left, top, right, bottom] in pixels of the picture")

    def window(
        self, kind: Group, frame: Frame, cx: float, cy: float, half: float, step: int = 1
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

    def picture(self, kind: Group, frame: Frame, area: float) -> list[Blob]:
        """Blobs of the whole picture, found on every n-th pixel and measured on all.

        ``area`` is the one expected, px; 0 where none is known yet.
        """
        # On every 4th pixel only, as far as the marker's size allows.
        step = max(min(int(math.sqrt(area or 4 * kind.area_px[0]) / 3.5), 4), 1)
        blobs = self._picture_at(kind, frame, area, step)
        if not blobs and not area and step > 1:
            blobs = self._picture_at(kind, frame, area, 1)
        return blobs

    def _picture_at(self, kind: Group, frame: Frame, area: float, step: int) -> list[Blob]:
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
        # No more than 24: a bound on the cost of a frame full of the colour.
        for box in [box for box in boxes if not self._hidden(box)][:24]:
            blobs += [b for b in self._measured(kind, frame, box, step) if is_new(b, blobs)]
        return blobs

    def _measured(self, kind: Group, frame: Frame, box: Box, step: int) -> list[Blob]:
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
        # Codecs smear a marker's colour over a bar: half a block of halved colour resolution, blurred.
        return any(
            bar != end and abs(side - bar) <= 3
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


class Follower:
    """Follows all markers of a setup through a video, frame by frame.

    Parameters
    ----------
    setup : Setup
    width, height : int
        Size of the picture.
    """

    def __init__(self, setup: Setup, width: int, height: int) -> None:
        self.setup = setup
        self._search = Search(setup, width, height)
        # Area without one in the setup: px, and share of the picture.
        self.groups = [
            Group(
                marker=marker,
                model=ColourModel(marker.colour_range()),
                area_px=marker.area_px or (12.0, 0.05 * width * height),
                targets=[Target(name) for name in marker.names],
            )
            for marker in setup.markers
        ]
        self._targets = {t.name: t for g in self.groups for t in g.targets}
        #: Between markers of different colours, where some colour is worn by several.
        self._pairs: dict[tuple[str, str], PairDistance] = {}
        if any(len(g.targets) > 1 for g in self.groups):
            for one, other in combinations(self.groups, 2):
                self._pairs |= {(a.name, b.name): PairDistance() for a in one.targets for b in other.targets}
        #: Earlier frames, and where the markers were in them.
        self._memory: deque[tuple[Frame, dict[str, tuple[float, float]]]] = deque(maxlen=MEMORIES)
        self._rows: list[list[tuple[float, ...]]] = []
        #: Where each marker was in the last frame, and the picture there.
        self._last: dict[str, tuple[tuple[slice, slice], Frame]] = {}
        self._changes: list[float] = []
        #: Whole sights that were taken back as another thing's, and its area.
        self._mistaken: dict[str, tuple[int, float]] = {}
        self._times: list[float] = []
        self._frame = 0

    def step(self, time: float, frame: Frame) -> None:
        """Find every marker in the next frame."""
        row: list[tuple[float, ...]] = []
        changes = [cv2.absdiff(frame[here], before).mean() for here, before in self._last.values()]
        self._changes.append(float(max(changes, default=math.nan)))
        self._last = {}
        for group in self.groups:
            sights = self._follow(group, time, frame)
            for target in group.targets:
                blob = sights.get(target.name)
                if blob is None:
                    target.missed += 1
                    row.append(_NOT_SEEN)
                    continue
                row.append(_row(target, blob))
                left, top, right, bottom = blob.box
                here = (slice(max(top - 2, 0), bottom + 2), slice(max(left - 2, 0), right + 2))
                self._last[target.name] = (here, frame[here].copy())
                target.see(blob, time)
                if self._frame % 5 == 0 and blob.confidence > 0.3 and not blob.at_edge:
                    group.model.adapt(blob.hsv)
            if not sights:
                group.model.forget()
        for pair, pair_distance in self._pairs.items():
            a, b = (self._targets[name] for name in pair)
            if a.time == time == b.time:
                pair_distance.add(math.hypot(a.x - b.x, a.y - b.y))
        if self._frame % MEMORY_FRAMES == MEMORY_FRAMES // 6:
            places = {t.name: (t.x, t.y) for t in self._targets.values() if t.sights and not t.missed}
            if places:
                # The oldest frame's memory is used again: fresh pages cost more than the copy.
                old = self._memory.popleft()[0] if len(self._memory) == MEMORIES else np.empty_like(frame)
                np.copyto(old, frame)
                self._memory.append((old, places))
        self._rows.append(row)
        self._times.append(time)
        self._frame += 1

    def track(self, times: NDArray[np.float64] | None = None) -> RawTrack:
        """What was found so far; ``times`` replaces the times given with the frames."""
        names = list(self._targets)
        table = np.array(self._rows, dtype=float).reshape(-1, len(names), len(_NOT_SEEN))
        x, y, area, confidence, status, at_edge = (table[:, :, k].T.copy() for k in range(6))
        track = RawTrack(
            times=np.array(self._times) if times is None else times,
            names=names,
            x=x,
            y=y,
            area=area,
            confidence=confidence,
            status=status.astype(int),
            at_edge=at_edge.astype(bool),
            drift={g.marker.name: g.model.largest_drift for g in self.groups if g.model.drifted},
            rivals={g.marker.name: g.most_rivals for g in self.groups if g.most_rivals},
            mistaken=self._mistaken,
            change=np.array(self._changes),
        )
        for i in range(len(names)):
            drop_false_detections(track, i, table[:, i, 6:])
        return track

    # ------------------------------------------------------------ one colour, one frame

    def _follow(self, group: Group, time: float, frame: Frame) -> dict[str, Blob]:
        """The targets of one colour that are seen, by their name."""
        known = [t for t in group.targets if t.sights]
        sights = self._in_windows(group, known, time, frame)
        lost = [t for t in group.targets if t.name not in sights and not self._hidden(t, known, sights, time)]
        unsure = [t for t in known if t.name in sights and not t.whole]
        if lost or unsure:
            area = max((t.area for t in lost), default=0.0)
            taken = list(sights.values())
            blobs = [b for b in self._search.picture(group, frame, area) if is_new(b, taken)]
            for target, blob in self._in_picture(group, lost, blobs, time):
                sights[target.name] = blob
                blobs = [b for b in blobs if b is not blob]
            for target in (t for t in known if t.name not in sights or t in unsure):
                winner = self._contest(group, target, blobs, time)
                if winner is not None:
                    sights[target.name] = winner
                    blobs = [b for b in blobs if b is not winner]
        for target in known:
            again = sights.get(target.name) if target.missed else None
            if again is not None and self._was_there(group, target, again):
                group.scenery.append(sights.pop(target.name))
        if not lost and not unsure and self._frame >= group.next_look:
            area, taken = max((t.area for t in group.targets), default=0.0), list(sights.values())
            seen = self._search.picture(group, frame, area)
            group.note_rivals([b for b in seen if is_new(b, taken)], self._frame)
        return sights

    def _in_windows(self, group: Group, known: list[Target], time: float, frame: Frame) -> dict[str, Blob]:
        """Each known target in a window about its prediction."""
        candidates: list[Blob] = []
        for target in known:
            if target.missed and time - target.time > self.setup.max_gap_s:
                continue
            for blob in self._window(group, target, time, frame):
                if not any(b.away(blob.x, blob.y) < 2 for b in candidates):
                    candidates.append(blob)
        if not candidates:
            return {}
        cost = [[self._cost(group, target, blob, time) for blob in candidates] for target in known]
        sights = {known[i].name: candidates[j] for i, j in _assigned(cost)}
        # Where equal markers meet and fewer blobs than markers are seen, none of them is known.
        for first, second in combinations(known, 2):
            if (first.name in sights) != (second.name in sights) and _meet(first, second, sights, time):
                sights.pop(first.name, None)
                sights.pop(second.name, None)
        return sights

    def _window(self, group: Group, target: Target, time: float, frame: Frame) -> list[Blob]:
        """Blobs in the target's window, grown until nothing that matters is cut by its border."""
        cx, cy = target.predicted(time)
        half = 1.3 * target.radius + target.reach(time - target.time) + 4
        step = max(min(int(target.radius / 6), MASK_STEP), 1)
        for status in (WINDOW, GROWN, GROWN):
            blobs, cut = self._search.window(group, frame, cx, cy, half, step)
            if any(group.alike(target, blob) for blob in blobs):
                for blob in blobs:
                    blob.status = status
                return blobs
            if cut is not None:
                cx, cy = 0.5 * (cut[0] + cut[2]), 0.5 * (cut[1] + cut[3])
            half *= 2
        return []

    def _cost(self, group: Group, target: Target, blob: Blob, time: float) -> float:
        """How unlikely a blob near the prediction is the target, ``_NO`` for impossible."""
        allowed = target.radius + 2 * target.reach(time - target.time)
        away = blob.away(*target.predicted(time))
        if away > allowed + target.radius or not group.alike(target, blob):
            return _NO
        cost = (away / allowed) ** 2
        if target.whole and not blob.at_edge:
            cost += 0.3 * abs(math.log(blob.area / target.area))
        return min(cost + self._misfit(target, blob, time), _NO)

    def _misfit(self, target: Target, blob: Blob, time: float) -> float:
        """How badly a blob fits the target's rigid partners: 0 well, ``_NO`` not at all."""
        worst = 0.0
        for pair, pair_distance in self._pairs.items():
            if target.name not in pair or not pair_distance.rigid:
                continue
            partner = self._targets[pair[1] if pair[0] == target.name else pair[0]]
            if partner.missed:
                continue
            error = abs(blob.away(*partner.predicted(time)) / pair_distance.mean - 1)
            if error > RIGID_LIMIT:
                return _NO
            worst = max(worst, (error / RIGID_LIMIT) ** 2)
        return worst

    def _hidden(self, target: Target, known: list[Target], sights: dict[str, Blob], time: float) -> bool:
        """Whether the target is known to be behind or at its like: no use searching for it."""
        if not target.sights or time - target.time > self.setup.max_gap_s:
            return False
        others = [t for t in known if t is not target and t.name not in sights]
        return any(_meet(target, other, sights, time) for other in others)

    def _was_there(self, group: Group, target: Target, blob: Blob) -> bool:
        """Whether the blob was there already while the target was seen elsewhere."""
        for frame, places in self._memory:
            if target.name not in places:
                continue
            if blob.away(*places[target.name]) < 2 * max(target.radius, blob.radius) + 4:
                continue
            old, _ = self._search.window(group, frame, blob.x, blob.y, 1.3 * blob.radius + detect.MARGIN)
            taken = [place for name, place in places.items() if name != target.name]
            if any(same_place(blob, b) and all(b.away(*at) > b.radius for at in taken) for b in old):
                return True
        return False

    # ------------------------------------------------------------ the whole picture

    def _in_picture(
        self, group: Group, lost: list[Target], blobs: list[Blob], time: float
    ) -> list[tuple[Target, Blob]]:
        """Which of the blobs of the whole picture are lost targets."""
        pairs = group.first_choice([t for t in lost if not t.sights], blobs)
        blobs = [b for b in blobs if all(b is not chosen for _, chosen in pairs)]
        if pairs and len(pairs) == len(group.targets):
            group.note_rivals(blobs, self._frame)
        missing = [t for t in lost if t.sights]
        if missing and blobs:
            cost = [[self._return_cost(group, t, blob, time) for blob in blobs] for t in missing]
            pairs += [(missing[i], blobs[j]) for i, j in _assigned(cost)]
        return pairs

    def _return_cost(self, group: Group, target: Target, blob: Blob, time: float) -> float:
        gone = time - target.time
        if not group.alike(target, blob, gone):
            return _NO
        recent = gone <= self.setup.max_gap_s
        away = blob.away(*(target.predicted(time) if recent else (target.x, target.y)))
        if recent and target.sights >= 3:
            near = 4 * target.radius + 10 + 0.2 * target.missed * target.radius
            near += 2 * max(math.hypot(target.vx, target.vy), target.pace) * gone
            misfit = self._misfit(target, blob, time)
            return min(away * (1 + misfit), _NO) if away <= near and misfit < _NO else _NO
        if any(blob.away(r.x, r.y) < 0.7 * r.radius for r in group.rivals):
            return _NO
        return 1e3 + away / (1e-3 + blob.confidence)

    def _contest(self, group: Group, target: Target, blobs: list[Blob], time: float) -> Blob | None:
        """Follow what may be the marker in the place of a target that is missed, or cut by the edge.

        What was learned of the target may be wrong: of a reflection, or of the marker half hidden. A
        thing unlike it that stays in the picture longer is then the marker, from its first sight on,
        and what was taken for it before is taken back.

        Returns
        -------
        Blob or None
            The target in this frame, when it is another from now on.
        """
        gone = time - target.time
        blobs = [
            b
            for b in blobs
            if not b.at_edge
            and not any(same_place(b, r) for r in group.rivals)
            and not (target.whole and group.alike(target, b, gone))
        ]
        rival = target.challenger
        if rival is not None and time - rival.time > self.setup.max_gap_s:
            rival = target.challenger = None
        if rival is None:
            if not blobs:
                return None
            rival = target.challenger = Challenger(target.name)
            best = max(blobs, key=group.merit)
        else:
            costs = [self._cost(group, rival, blob, time) for blob in blobs]
            if min(costs, default=_NO) >= _NO:
                rival.missed += 1
                return None
            best = blobs[int(np.argmin(costs))]
        rival.rows[self._frame] = _row(rival, best)
        rival.see(best, time)
        if not rival.prevails(target):
            return None
        if target.whole:
            count = self._mistaken.get(target.name, (0, 0.0))[0] + target.whole
            self._mistaken[target.name] = (count, target.usual_area)
        column = list(self._targets).index(target.name)
        for frame, row in enumerate(self._rows):
            row[column] = rival.rows.get(frame, _NOT_SEEN)
        vars(target).update({k: v for k, v in vars(rival).items() if k in _KNOWN}, challenger=None)
        group.model.restart()
        return best


def _row(target: Target, blob: Blob) -> tuple[float, ...]:
    """What is kept of a sight: place, area, confidence, status, whether cut, and the mean colour."""
    usual = blob.area if blob.at_edge or not target.whole else target.usual_area
    likeness = min(blob.area / usual, usual / blob.area)
    confidence = blob.confidence * likeness**0.5
    return (blob.x, blob.y, blob.area, confidence, blob.status, blob.at_edge, *blob.hsv)


def _assigned(cost: list[list[float]]) -> list[tuple[int, int]]:
    """Pairs (row, column) of least total cost; pairs that cost ``_NO`` are left out."""
    if len(cost) == 1:
        best = min(range(len(cost[0])), key=cost[0].__getitem__)
        return [(0, best)] if cost[0][best] < _NO else []
    rows, columns = linear_sum_assignment(np.array(cost))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i][j] < _NO]


def _meet(first: Target, second: Target, sights: dict[str, Blob], time: float) -> bool:
    """Whether two equal markers touch, where they are seen or else predicted."""
    places = [
        (sights[t.name].x, sights[t.name].y) if t.name in sights else t.predicted(time)
        for t in (first, second)
    ]
    return math.dist(*places) < first.radius + second.radius + 4


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
    alike = detect.same_hue_and_saturation(looks.T, usual, RETURN_HUE, RETURN_SATURATION)
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


# ---------------------------------------------------------------- a whole video


@dataclass(frozen=True)
class Run:
    """Markers of a video, before anything is smoothed."""

    track: RawTrack
    video: Video
    #: With the boxes that were left out in a second look.
    setup: Setup
    #: A few frames for the report.
    kept: dict[int, Frame]


def follow(path: Path, setup: Setup, *, step: Step, file: str | None = None) -> Run:
    """Follow the markers of ``setup`` through a video.

    A thing of the marker's colour that never moves, while something else of the colour is
    about, is not the marker: the video is then read again with that thing left out, and the
    second result is taken when it moves. ``file`` names the setup in messages.
    """
    first = _once(path, setup, step, file)
    still = _motionless(first)
    if not still:
        return first
    boxes = list(still.values())
    second = _once(path, setup.model_copy(update={"ignore_px": [*setup.ignore_px, *boxes]}), step, file)
    if any(quality.reach(second.track, name).radii < 3.0 for name in still):
        return first
    listed = "; ".join(f"[{', '.join(f'{v:.0f}' for v in box)}]" for box in boxes)
    text = f"a thing of the marker's colour never moves and was left out (box {listed})"
    warn("SWM049", f"{path.name}: {text}; write it into ignore_px to save the second reading")
    return second


def _once(path: Path, setup: Setup, step: Step, file: str | None) -> Run:
    video = Video(path, frame_rate_hz=setup.frame_rate_hz, apply_rotation=setup.apply_rotation)
    video.demand_clock()
    if setup.camera is not None:
        pose.camera_matrix(setup.camera, video.width, video.height, file)
    follower: Follower | Silhouette
    if setup.markers[0].method == "background":
        from swimid.tracking import silhouette

        scene = silhouette.empty_scene(path, setup)
        follower = silhouette.Silhouette(setup, scene, video.width, video.height)
    else:
        follower = Follower(setup, video.width, video.height)
    keeper = FrameKeeper(4 * REPORT_FRAMES - 1)
    for index, (time, frame) in enumerate(video.frames()):
        follower.step(time, frame)
        keeper.take(index, frame)
        step()
    keys = list(keeper.kept)
    keys = [keys[k] for k in np.unique(np.linspace(0, len(keys) - 1, REPORT_FRAMES).round().astype(int))]
    kept = {k: keeper.kept[k] for k in keys}
    return Run(follower.track(video.times()), video, setup, kept)


def _motionless(run: Run) -> dict[str, Box]:
    """Return boxes about markers that never move and have rivals of their colour, by name."""
    boxes: dict[str, Box] = {}
    for marker in run.setup.markers:
        name, track = marker.name, run.track
        if marker.number > 1 or name not in track.rivals or quality.reach(track, name).moves:
            continue
        x, y, area = (float(np.nanmedian(v[track.row(name)])) for v in (track.x, track.y, track.area))
        half = 0.7 * math.sqrt(area) + 3
        boxes[name] = (round(x - half), round(y - half), round(x + half), round(y + half))
    return boxes
