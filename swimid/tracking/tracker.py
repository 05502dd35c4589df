"""Tracking of all markers from the first frame of a film to the last.

A marker that was just seen is searched for in a window about its predicted position, and a lost marker in the
whole picture. A :class:`Target` is the state of one marker. A :class:`Follower` finds patches of a colour and
assigns them to targets. :func:`follow` reads a film. It reads the film again if a motionless object was taken
for a marker.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, islice, product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from swimid.errors import InputError
from swimid.logs.log import runs
from swimid.notices import Step, warn
from swimid.points.plane import camera_matrix
from swimid.tracking import frames
from swimid.tracking.frames import LOST, NOT_SEEN, Blob, ColourModel, Frame, RawTrack, Row, Video
from swimid.tracking.setup import Box, HsvRange, Marker, Setup

#: Number of frames of the film that are stored for the report.
REPORT_FRAMES = 6
#: Minimum length of an isolated sequence of detections, frames. Shorter sequences are removed as false.
MIN_RUN = 3
#: Maximum colour difference between a patch and a lost marker for which the patch may be the marker:
#: difference in hue (steps of 2 deg), and difference in saturation relative to the usual saturation of the
#: marker.
RETURN_HUE, RETURN_SATURATION = 12.0, 0.5
#: Maximum length of a sequence of detections that may be false, as a fraction of all detections of the
#: marker. Longer sequences are not tested for another colour or size.
FALSE_SHARE = 0.2
#: Maximum spacing of the picture pixels that are used for a coarse colour mask, px.
MAX_MASK_STEP = 4
#: Minimum area of a patch in a coarse colour mask, as a fraction of the minimum area of the marker.
COARSE_AREA_SHARE = 0.4
#: Maximum number of patches of a colour that are measured in one picture. It limits the computing time for a
#: frame that is full of the marker's colour.
MAX_PATCHES = 24
#: Criteria for two markers on one rigid body: minimum number of frames that show both, maximum standard
#: deviation of their distance, and maximum deviation of the distance in one frame. The deviations are
#: relative to the mean distance.
MIN_RIGID_FRAMES, MAX_RIGID_SD, MAX_RIGID_DEVIATION = 20, 0.06, 0.3
#: Cost that marks the assignment of a patch to a marker as impossible.
IMPOSSIBLE = 1e6


@dataclass(eq=False)
class Target:
    """State of one marker during the tracking. Lengths are in px, times in s."""

    name: str
    x: float = math.nan
    y: float = math.nan
    vx: float = 0.0
    vy: float = 0.0
    time: float = -math.inf
    #: Number of all detections of the marker, and number of detections that show the whole marker. Only
    #: detections of the whole marker define its appearance, because a marker cut by the edge of the picture
    #: may have any size.
    sights: int = 0
    whole: int = 0
    #: Number of frames since the last detection of the marker.
    missed: int = 0
    #: Moving averages of prediction error (px), radius (px), area (px) and contrast (grey levels) of the
    #: marker.
    innovation_px: float = 0.0
    radius: float = 0.0
    area: float = 0.0
    contrast: float = 0.0
    #: Slow moving averages of speed (px/s), area (px) and colour (HSV) of the marker.
    pace: float = 0.0
    usual_area: float = 0.0
    colour: NDArray[np.float64] | None = None
    #: Detections of the marker, one after the other: the frame number and the values of a :data:`Row` for
    #: each. An array of numbers takes a sixth of the memory of tuples, which matters in a film of several
    #: hours.
    detections: array[float] = field(default_factory=lambda: array("d"))
    #: Whether the marker has left the position of its first detection by more than its own size.
    moved: bool = False
    #: Second object that may be the marker. The object is followed while this target is not detected, because
    #: the earlier detections of this target may be false.
    challenger: Target | None = None

    def predict(self, time: float) -> tuple[float, float]:
        """Return the position of the marker at a time, predicted with constant velocity."""
        dt = time - self.time
        return self.x + self.vx * dt, self.y + self.vy * dt

    def search_range(self, dt: float) -> float:
        """Return the maximum expected error of a position predicted ``dt`` s after the last detection, px."""
        start, moved = 6.0, 0.3 * math.hypot(self.vx, self.vy) * dt + 3.0 * self.innovation_px
        if self.sights < 3:
            start = 12.0 + self.radius
        return start + moved + self.missed * 0.5 * self.radius

    def see(self, blob: Blob, time: float, frame: int) -> None:
        """Update the target with a detection in a frame.

        If the detection shows the whole marker, it also updates the appearance (size, colour and contrast) of
        the target.
        """
        self.detections.extend((frame, *self._row(blob)))
        if self.sights and time > self.time:
            self._move(blob, time)
        if not blob.at_edge:
            self._learn(blob)
        elif not self.whole:
            self.radius = max(self.radius, blob.radius)
        self.x, self.y, self.time = blob.x, blob.y, time
        self.sights += 1
        self.missed = 0
        self.moved = self.moved or blob.distance_to(*self.detections[1:3]) > 2 * self.radius

    def _row(self, blob: Blob) -> Row:
        """Return a detection as a row of values for the track. An unusual area reduces the confidence."""
        confidence = blob.confidence
        if self.whole and not blob.at_edge:
            confidence *= min(blob.area / self.usual_area, self.usual_area / blob.area) ** 0.5
        return (blob.x, blob.y, blob.area, confidence, blob.status, blob.at_edge, *blob.hsv)

    def prevails(self, target: Target) -> bool:
        """Return whether this object, and not the target that it challenges, is the marker.

        The challenger is the marker if the target has less than ``FALSE_SHARE`` of the detections of the two.
        A challenger that does not move replaces only a target that was never seen whole. Example: a ladder
        put into the pool is not the swimmer that has just left it.
        """
        if not target.whole:
            return self.whole >= MIN_RUN
        return self.moved and target.whole < FALSE_SHARE * (target.whole + self.whole)

    def _move(self, blob: Blob, time: float) -> None:
        x, y = self.predict(time)
        error = math.hypot(blob.x - x, blob.y - y)
        if self.sights > 1 and error > 8 * self.radius + 40:
            self.vx = self.vy = 0.0  # if the marker is found again elsewhere, its velocity is unknown
        else:
            # The second detection gives the velocity of the marker. Each later detection corrects it by half
            # of the difference between measured and predicted velocity.
            gain, dt = max(0.5, 1.0 / self.sights), time - self.time
            self.vx += gain * (blob.x - x) / dt
            self.vy += gain * (blob.y - y) / dt
        self.innovation_px += 0.3 * (min(error, 4 * self.radius + 20) - self.innovation_px)
        self.pace = max(self.pace + 0.05 * (math.hypot(self.vx, self.vy) - self.pace), 0.0)

    def _learn(self, blob: Blob) -> None:
        if self.colour is None:
            self.colour = blob.hsv
        slow = max(0.01, 1 / (self.whole + 1))
        fast = max(0.15, float(not self.whole))
        self.contrast += fast * (blob.contrast - self.contrast)
        self.area += fast * (blob.area - self.area)
        self.radius += fast * (blob.radius - self.radius)
        self.usual_area += slow * (blob.area - self.usual_area)
        self.colour = self.colour + slow * frames.colour_difference(blob.hsv, self.colour)
        self.whole += 1


@dataclass
class MarkerGroup:
    """Targets for all markers of one colour, with the objects of this colour that are not markers."""

    marker: Marker
    model: ColourModel
    #: Limits of the area of a marker, minimum and maximum, px.
    area_px: tuple[float, float]
    targets: list[Target]
    #: Objects of the same colour that are known not to be markers.
    scenery: list[Blob] = field(default_factory=list)
    #: Objects of the same colour, other than the markers, that the last search of the whole picture found;
    #: and positions of the markers at the time of this search, px.
    rivals: list[Blob] = field(default_factory=list)
    seen_from: list[tuple[float, float]] = field(default_factory=list)
    most_rivals: int = 0
    #: Each search of the whole picture: number of the frame, position of the first marker, and positions of
    #: other objects as large and as bright as a marker, px.
    looks: list[tuple[int, tuple[float, float], list[tuple[float, float]]]] = field(default_factory=list)
    #: Number of the next frame in which the whole picture is searched for other objects, and number of frames
    #: from that search to the following one.
    next_look: int = 0
    pause: int = 12

    def is_alike(self, target: Target, blob: Blob, gone_s: float = 0.0) -> bool:
        """Return whether size and contrast of a blob agree with those of a target.

        If the target was lost for ``gone_s`` seconds, its usual size is compared instead of the latest, and
        its colour is compared, too.
        """
        if not target.whole:
            # A target that was never seen whole has no size yet. Compare with the other markers of its
            # colour, which have the same size.
            like = [other.usual_area for other in self.targets if other.whole]
            return not like or blob.at_edge or 0.5 < blob.area / max(like) < 2.0
        alone = len(self.targets) == 1
        # Two markers of one colour that touch look like a single one of twice the size. A marker that is half
        # hidden has a wrong centre. Therefore the limits of the area are narrower than for a single marker.
        low, high, area = 0.7, 1.4, target.usual_area
        if alone:
            low, high = 0.3, 3.0
        if alone and not gone_s:
            area = target.area
        if blob.at_edge:
            low = 0.0
        if not low <= blob.area / area <= high or blob.contrast < 0.4 * target.contrast:
            return False
        if not gone_s or target.colour is None:
            return True
        return bool(frames.has_colour(blob.hsv, target.colour, RETURN_HUE, RETURN_SATURATION))

    def merit(self, blob: Blob) -> float:
        """Return a score of a blob as a marker, from contrast, area and colour; larger is more likely."""
        fit = 1.5 - min(self.model.distance(blob.hsv), 1.0)
        if blob.at_edge:
            fit *= 0.3
        return math.sqrt(blob.contrast * blob.area) * fit

    def choose_first(self, new: list[Target], blobs: list[Blob]) -> list[tuple[Target, Blob]]:
        """Return pairs of a target that was never seen and the blob assigned to it.

        The list is empty if there are fewer blobs than such targets. Without ``start_px`` in the setup, the
        targets are assigned to the best blobs from left to right.
        """
        if not new or (len(blobs) < len(new) and len(new) > 1):
            return []
        if self.marker.start_px is not None:
            starts = dict(zip(self.marker.names, self.marker.start_px, strict=True))
            distances = np.array(
                [[blob.distance_to(*starts[target.name]) for blob in blobs] for target in new]
            )
            return [(new[i], blobs[j]) for i, j in zip(*linear_sum_assignment(distances), strict=True)]
        best = sorted(blobs, key=self.merit, reverse=True)[: len(new)]
        return list(zip(new, sorted(best, key=lambda blob: blob.x), strict=False))

    def note_rivals(self, rivals: list[Blob], frame: int) -> None:
        """Store other objects of the colour of the markers, so that none is taken for a lost marker."""
        self._note_scenery(rivals)
        self.most_rivals = max(self.most_rivals, len(rivals))
        known = next((target for target in self.targets if target.whole), None)
        if known is not None:
            bright = [b for b in rivals if not b.at_edge and b.contrast > 0.5 * known.contrast]
            like = [(b.x, b.y) for b in bright if 0.5 < b.area / known.usual_area < 2.0]
            self.looks.append((frame, (self.targets[0].x, self.targets[0].y), like))
        self.next_look = frame + self.pause
        self.pause = min(2 * self.pause, 60)

    def _note_scenery(self, rivals: list[Blob]) -> None:
        """Store objects that stay in place while a marker moves as scenery."""
        here = [(target.x, target.y) for target in self.targets]
        moved = any(
            math.dist(place, before) > target.radius + 2
            for target, place, before in zip(self.targets, here, self.seen_from, strict=False)
        )
        if moved:
            still = [blob for blob in rivals if is_among(blob, self.rivals)]
            self.scenery += [blob for blob in still if not is_among(blob, self.scenery)]
        if moved or not self.seen_from or math.isnan(self.seen_from[0][0]):
            self.rivals, self.seen_from = rivals, here

    def describe_moving_others(self) -> str:
        """Return a sentence on other objects that look like the marker and move; empty if there are none.

        An object has moved if it is more than two radii away from all places of such objects in the other
        searches of the whole picture. The sentence is returned if moved objects are seen in at least two
        searches, and in half of the searches in which they or the marker have moved. Reflections do not move,
        and flashes of light are seen less often.
        """
        moving, count = [], 0
        for frame, here, places in self.looks:
            apart, elsewhere = 2.0 * self.targets[0].radius, [look for look in self.looks if look[0] != frame]
            known = [place for *_, found in elsewhere for place in found]
            new = [one for one in places if all(math.dist(one, place) > apart for place in known)]
            count += bool(new) or all(math.dist(here, place) > apart for _, place, _ in elsewhere)
            moving += [(frame, here, new)] * bool(new)
        if len(moving) < max(2, 0.5 * count):
            return ""
        (frame, (x, y), new), count = moving[-1], len(self.targets)
        name, total = self.marker.name, count + len(new)
        listed = " and ".join(f"{x:.0f}, {y:.0f}" for x, y in new)
        return (
            f"{total} objects of the colour of '{name}' move, and {count} of them is followed: in frame "
            f"{frame} that at {x:.0f}, {y:.0f} px, not that at {listed} px. To follow another "
            f"object, give start_px of '{name}' in the setup, or number: {total} and choose head and tail by "
            "number. To leave it out, give ignore_px: [[left, top, right, bottom]]"
        )


def mask_step(length: float) -> int:
    """Return the pixel spacing of a mask that resolves a length, px: the length, limited to a range."""
    return max(min(int(length), MAX_MASK_STEP), 1)


def is_among(blob: Blob, others: Sequence[Blob]) -> bool:
    """Return whether a blob has position and area of one of ``others``, which were seen in another frame."""
    near = [other for other in others if blob.distance_to(other.x, other.y) < 0.25 * other.radius + 1.5]
    return any(0.4 < blob.area / other.area < 2.5 for other in near)


def is_new(blob: Blob, others: Sequence[Blob]) -> bool:
    """Return whether a blob is more than 2 px away from each of the blobs found before in the same frame."""
    return all(blob.distance_to(other.x, other.y) > 2 for other in others)


class ColourSearch:
    """Search of a picture for the blobs of one colour.

    Parameters
    ----------
    setup : Setup
        Setup with the boxes of the picture that are ignored.
    width, height : int
        Size of the picture, px.
    """

    def __init__(self, setup: Setup, width: int, height: int) -> None:
        self._ignored, self._size = setup.ignore_px, (width, height)

    def search_window(
        self, group: MarkerGroup, frame: Frame, cx: float, cy: float, half: float, step: int = 1
    ) -> tuple[list[Blob], Box | None]:
        """Return the blobs inside a square window, and the box about the largest patch that the window cuts.

        The window has its centre at ``cx``, ``cy`` and the half width ``half``, px. The colour mask contains
        every ``step``-th pixel, and the centre of a blob is computed from all pixels.
        """
        width, height = self._size
        x0, y0 = max(int(cx - half), 0), max(int(cy - half), 0)
        x1, y1 = min(int(cx + half) + 2, width), min(int(cy + half) + 2, height)
        if min(x1 - x0, y1 - y0) < 3 * step:
            return [], None
        window = frame[y0:y1, x0:x1]
        mask = frames.marker_mask(frames.thin_window(window, step), group.model)
        inside = (x0 > 0, y0 > 0, x1 < width, y1 < height)
        patches = frames.find_patches(mask, group.area_px, step=step, inside=inside)
        blobs = []
        for patch in [patch for patch in patches if not patch.clipped]:
            blob = frames.measure_blob(window, patch, step, (x0, y0), self._size)
            if blob and not self._is_ignored(blob.x, blob.y) and not is_among(blob, group.scenery):
                blobs.append(blob)
        if step > 1 and any(blob.at_edge for blob in blobs):
            # On a coarse mask, a marker that ends just before the edge of the window looks cut. Search again
            # on all pixels.
            return self.search_window(group, frame, cx, cy, half)
        cut = max((patch for patch in patches if patch.clipped), key=lambda patch: patch.area, default=None)
        return blobs, None if cut is None else cut.box((x0, y0), step)

    def search_picture(self, group: MarkerGroup, frame: Frame, area: float) -> list[Blob]:
        """Return the blobs of the whole picture, found on a coarse mask and measured on all pixels.

        ``area`` is the expected area of a blob in px, or 0 if unknown.
        """
        step = mask_step(min(math.sqrt(area or 4 * group.area_px[0]) / 3.5, min(self._size) / 2))
        blobs = self._search_mask(group, frame, area, step)
        if not blobs and not area and step > 1:
            blobs = self._search_mask(group, frame, area, 1)
        return blobs

    def _search_mask(self, group: MarkerGroup, frame: Frame, area: float, step: int) -> list[Blob]:
        """Return the blobs of the whole picture, found on a mask of every ``step``-th pixel."""
        mask = frames.marker_mask(frames.thin_window(frame, step), group.model)
        coarse = frames.find_patches(mask, (COARSE_AREA_SHARE * group.area_px[0], math.inf), step=step)
        expected = area or group.area_px[1] / COARSE_AREA_SHARE
        coarse.sort(key=lambda patch: abs(math.log(patch.area / expected)))
        boxes = [patch.box((0, 0), step) for patch in coarse]
        places = [(0.5 * (b[0] + b[2]), 0.5 * (b[1] + b[3]), max(b[2] - b[0], b[3] - b[1])) for b in boxes]
        blobs: list[Blob] = []
        for x, y, size in [place for place in places if not self._is_ignored(*place[:2])][:MAX_PATCHES]:
            half = 0.5 * size + 2 * step + frames.MARGIN
            found, _ = self.search_window(group, frame, x, y, half, mask_step(size / 12))
            blobs += [blob for blob in found if is_new(blob, blobs)]
        return blobs

    def _is_ignored(self, x: float, y: float) -> bool:
        """Return whether a point of the picture is in a box that the setup ignores."""
        return any(b[0] <= x <= b[2] and b[1] <= y <= b[3] for b in self._ignored)


class Follower:
    """Tracker of all markers of a setup, frame by frame.

    Parameters
    ----------
    setup : Setup
    width, height : int
        Size of the picture, px.
    """

    def __init__(self, setup: Setup, width: int, height: int) -> None:
        self.setup = setup
        self._search = ColourSearch(setup, width, height)
        # The default area of a marker is from 12 px to 5 % of the picture.
        self.groups: list[MarkerGroup] = []
        for marker in setup.markers:
            model, targets = ColourModel(marker.hsv or HsvRange()), [Target(name) for name in marker.names]
            area_px = marker.area_px or (12.0, 0.05 * width * height)
            self.groups.append(MarkerGroup(marker, model, area_px, targets))
        #: Statistics of the distance (px) between each two markers of different colours: number of distances,
        #: their sum, and the sum of their squares. They are computed only if several markers have the same
        #: colour.
        self._pairs: dict[tuple[str, str], NDArray[np.float64]] = {}
        if any(len(group.targets) > 1 for group in self.groups):
            for one, other in combinations(setup.markers, 2):
                self._pairs |= {pair: np.zeros(3) for pair in product(one.names, other.names)}
        #: Number of removed detections that showed another object than the marker, and area of that object
        #: (px), by name of the marker.
        self._mistaken: dict[str, tuple[int, float]] = {}
        self._times = array("d")
        self._frame = 0

    @property
    def _targets(self) -> dict[str, Target]:
        return {target.name: target for group in self.groups for target in group.targets}

    def step(self, time: float, frame: Frame) -> None:
        """Find every marker in the next frame of the film, and store the detections."""
        for group in self.groups:
            sights = self._follow(group, time, frame)
            for target in group.targets:
                blob = sights.get(target.name)
                if blob is None:
                    target.missed += 1
                    continue
                target.see(blob, time, self._frame)
                if self._frame % 5 == 0 and blob.confidence > 0.3 and not blob.at_edge:
                    group.model.adapt(blob.hsv)
            if not sights:
                group.model.forget()
        targets = self._targets
        for pair, sums in self._pairs.items():
            a, b = (targets[name] for name in pair)
            if a.time == time == b.time:
                sums += math.hypot(a.x - b.x, a.y - b.y) ** np.arange(3)
        self._times.append(time)
        self._frame += 1

    def track(self) -> RawTrack:
        """Return the track of the frames that were processed so far."""
        table = np.tile(NOT_SEEN, (len(self._targets), len(self._times), 1))
        for rows, target in zip(table, self._targets.values(), strict=True):
            # A frame may have two detections, of which the later one counts.
            detections = np.frombuffer(target.detections).reshape(-1, 1 + len(NOT_SEEN))
            rows[detections[:, 0].astype(int)] = detections[:, 1:]
            drop_false_detections(rows)
        rivals = {g.marker.name: g.most_rivals for g in self.groups if g.most_rivals}
        moving = {group.marker.name: group.describe_moving_others() for group in self.groups}
        others = {name: text for name, text in moving.items() if text}
        names = self.setup.marker_names
        return RawTrack.of_table(self._times, names, table, rivals, self._mistaken, others)

    # ------------------------------------------------------------ one colour in one frame

    def _follow(self, group: MarkerGroup, time: float, frame: Frame) -> dict[str, Blob]:
        """Find the targets of one colour in a frame; return the blob of each target, by its name."""
        known = [t for t in group.targets if t.sights]
        sights = self._in_windows(group, known, time, frame)
        lost = [t for t in group.targets if t.name not in sights]
        lost = [t for t in lost if not self._is_hidden(t, known, sights, time)]
        unsure = [t for t in known if t.name in sights and not t.whole]
        if lost or unsure:
            self._search_lost(group, time, frame, lost, sights)
        elif self._frame >= group.next_look:
            group.note_rivals(self._others(group, frame, group.targets, sights), self._frame)
        return sights

    def _search_lost(
        self, group: MarkerGroup, time: float, frame: Frame, lost: list[Target], sights: dict[str, Blob]
    ) -> None:
        """Search the whole picture for lost targets and for objects that may replace targets.

        The blobs that are found are added to ``sights``, in place.
        """
        unsure = [t for t in group.targets if t.name in sights and not t.whole]
        blobs = self._others(group, frame, lost, sights)
        for target, blob in self._find_lost(group, lost, blobs, time):
            sights[target.name] = blob
            blobs = [b for b in blobs if b is not blob]
        for target in list(group.targets):
            if not target.sights or (target.name in sights and target not in unsure):
                continue
            winner = self._contest(group, target, blobs, time)
            if winner is not None:
                sights[target.name] = winner
                blobs = [b for b in blobs if b is not winner]

    def _others(
        self, group: MarkerGroup, frame: Frame, targets: list[Target], sights: dict[str, Blob]
    ) -> list[Blob]:
        """Return the blobs of a colour in the whole picture that are not assigned to a target.

        The search expects blobs as large as the markers of ``targets``.
        """
        area, taken = max((target.area for target in targets), default=0.0), list(sights.values())
        return [blob for blob in self._search.search_picture(group, frame, area) if is_new(blob, taken)]

    def _in_windows(
        self, group: MarkerGroup, known: list[Target], time: float, frame: Frame
    ) -> dict[str, Blob]:
        """Find the known targets in windows about predicted positions; return the blob of each, by name."""
        candidates: list[Blob] = []
        for target in known:
            if not target.missed or time - target.time <= self.setup.max_gap_s:
                blobs = self._in_window(group, target, time, frame)
                candidates += [blob for blob in blobs if is_new(blob, candidates)]
        if not candidates:
            return {}
        cost = [[self._cost(group, target, blob, time) for blob in candidates] for target in known]
        sights = {known[i].name: candidates[j] for i, j in assign(cost)}
        # If two markers of one colour touch and only one of them has a blob, it is unknown which of them the
        # blob shows. Then neither counts as found.
        for first, second in combinations(known, 2):
            if (first.name in sights) != (second.name in sights) and _meet(first, second, sights, time):
                sights.pop(first.name, None)
                sights.pop(second.name, None)
        return sights

    def _in_window(self, group: MarkerGroup, target: Target, time: float, frame: Frame) -> list[Blob]:
        """Return the blobs in a window about the predicted position of a target.

        The window grows until one of its blobs resembles the target.
        """
        cx, cy = target.predict(time)
        half = 1.3 * target.radius + target.search_range(time - target.time) + 4
        for status in (frames.WINDOW, frames.GROWN, frames.GROWN):
            blobs, cut = self._search.search_window(group, frame, cx, cy, half, mask_step(target.radius / 6))
            if any(group.is_alike(target, blob) for blob in blobs):
                for blob in blobs:
                    blob.status = status
                return blobs
            if cut is not None:
                cx, cy = 0.5 * (cut[0] + cut[2]), 0.5 * (cut[1] + cut[3])
            half *= 2
        return []

    def _cost(self, group: MarkerGroup, target: Target, blob: Blob, time: float) -> float:
        """Return the cost of assigning a blob to a target, from prediction error and area."""
        allowed = target.radius + 2 * target.search_range(time - target.time)
        away = blob.distance_to(*target.predict(time))
        if away > allowed + target.radius or not group.is_alike(target, blob):
            return IMPOSSIBLE
        cost = (away / allowed) ** 2
        if target.whole and not blob.at_edge:
            cost += 0.3 * abs(math.log(blob.area / target.area))
        return min(cost + self._misfit(target, blob, time), IMPOSSIBLE)

    def _misfit(self, target: Target, blob: Blob, time: float) -> float:
        """Return the cost of assigning a blob to a target, from the blob's distances to other markers.

        Only markers whose distance from the target is nearly constant are compared, because they are on the
        same rigid body.
        """
        worst, targets = 0.0, self._targets
        for pair, (count, total, squares) in self._pairs.items():
            partner = next(targets[name] for name in pair if name != target.name)
            if target.name not in pair or count < MIN_RIGID_FRAMES or partner.missed:
                continue
            mean = float(total / count)
            if (squares - total * mean) / (count - 1) >= (MAX_RIGID_SD * mean) ** 2:
                continue
            error = abs(blob.distance_to(*partner.predict(time)) / mean - 1)
            if error > MAX_RIGID_DEVIATION:
                return IMPOSSIBLE
            worst = max(worst, (error / MAX_RIGID_DEVIATION) ** 2)
        return worst

    def _is_hidden(self, target: Target, known: list[Target], sights: dict[str, Blob], time: float) -> bool:
        """Return whether a lost target touches another lost marker of the same colour.

        The two then look like one large blob, and the whole picture is not searched for the target.
        """
        if not target.sights or time - target.time > self.setup.max_gap_s:
            return False
        others = [t for t in known if t is not target and t.name not in sights]
        return any(_meet(target, other, sights, time) for other in others)

    def _find_lost(
        self, group: MarkerGroup, lost: list[Target], blobs: list[Blob], time: float
    ) -> list[tuple[Target, Blob]]:
        """Return the lost targets that are found in the whole picture, each with the blob assigned to it."""
        pairs = group.choose_first([target for target in lost if not target.sights], blobs)
        blobs = [blob for blob in blobs if all(blob is not chosen for _, chosen in pairs)]
        if pairs and len(pairs) == len(group.targets):
            group.note_rivals(blobs, self._frame)
        missing = [target for target in lost if target.sights]
        if missing and blobs:
            cost = [[self._return_cost(group, target, blob, time) for blob in blobs] for target in missing]
            pairs += [(missing[i], blobs[j]) for i, j in assign(cost)]
        return pairs

    def _return_cost(self, group: MarkerGroup, target: Target, blob: Blob, time: float) -> float:
        """Return the cost of assigning a blob anywhere in the picture to a lost target."""
        gone_s = time - target.time
        if not group.is_alike(target, blob, gone_s):
            return IMPOSSIBLE
        recent, place = gone_s <= self.setup.max_gap_s, (target.x, target.y)
        if recent:
            place = target.predict(time)
        away = blob.distance_to(*place)
        if recent and target.sights >= 3:
            near = 4 * target.radius + 10 + 0.2 * target.missed * target.radius
            near += 2 * max(math.hypot(target.vx, target.vy), target.pace) * gone_s
            misfit = self._misfit(target, blob, time)
            if away > near or misfit >= IMPOSSIBLE:
                return IMPOSSIBLE
            return min(away * (1 + misfit), IMPOSSIBLE)
        if any(blob.distance_to(rival.x, rival.y) < 0.7 * rival.radius for rival in group.rivals):
            return IMPOSSIBLE
        return 1e3 + away / (1e-3 + blob.confidence)

    def _contest(self, group: MarkerGroup, target: Target, blobs: list[Blob], time: float) -> Blob | None:
        """Follow another object that may be the marker, if the target is missed or was never seen whole.

        The known appearance of the target may be that of a reflection or of a half hidden marker. In this
        case another object that is in the picture for longer is the marker, and the detections of this object
        replace those of the target.

        Returns
        -------
        Blob or None
            Blob of the object, if the object replaces the target.
        """
        gone_s = time - target.time
        blobs = [blob for blob in blobs if not (blob.at_edge or is_among(blob, group.rivals))]
        if target.whole:
            blobs = [blob for blob in blobs if not group.is_alike(target, blob, gone_s)]
        rival = target.challenger
        if rival is not None and time - rival.time > self.setup.max_gap_s:
            rival = target.challenger = None
        if rival is None:
            if not blobs:
                return None
            best = max(blobs, key=group.merit)
            rival = target.challenger = Target(target.name)
        else:
            costs = [self._cost(group, rival, blob, time) for blob in blobs]
            if min(costs, default=IMPOSSIBLE) >= IMPOSSIBLE:
                rival.missed += 1
                return None
            best = blobs[int(np.argmin(costs))]
        rival.see(best, time, self._frame)
        if not rival.prevails(target):
            return None
        if target.whole:
            count, _ = self._mistaken.get(target.name, (0, 0.0))
            self._mistaken[target.name] = (count + target.whole, target.usual_area)
        group.targets[group.targets.index(target)] = rival
        group.model.restart()
        return best


def assign(cost: list[list[float]]) -> list[tuple[int, int]]:
    """Return the pairs (row, column) of a cost matrix with the minimum total cost.

    Pairs with the cost of an impossible assignment are left out.
    """
    rows, columns = linear_sum_assignment(np.array(cost))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i][j] < IMPOSSIBLE]


def _meet(first: Target, second: Target, sights: dict[str, Blob], time: float) -> bool:
    """Return whether two markers of one colour touch.

    A marker that is not detected is taken to be at its predicted position.
    """
    predictions = {target.name: target.predict(time) for target in (first, second)}
    seen = {name: (blob.x, blob.y) for name, blob in sights.items() if name in predictions}
    return math.dist(*(predictions | seen).values()) < first.radius + second.radius + 4


def drop_false_detections(rows: NDArray[np.float64]) -> None:
    """Remove false detections from the track of one marker, shape (n, 9), in place.

    A sequence of detections is removed if it is shorter than ``MIN_RUN`` and there are few other detections
    nearby. It is also removed if it has less than ``FALSE_SHARE`` of all detections and differs from the
    usual colour, size or confidence of the marker.
    """
    seen, hsv = rows[:, 4] > LOST, rows[:, 6:]
    if not seen.any():
        return
    # Compute the usual size and colour from detections of the whole marker. Size and colour differ in
    # detections in which the edge of the picture cuts the marker.
    whole = seen & (rows[:, 5] == 0)
    if not whole.any():
        whole = seen
    usual = np.median(hsv[whole], axis=0)
    turn = 2 * np.pi * hsv[whole, 0] / 180
    usual[0] = 90 / np.pi * np.arctan2(np.sin(turn).mean(), np.cos(turn).mean())
    alike = frames.has_colour(hsv.T.copy(), usual, RETURN_HUE, RETURN_SATURATION)
    area, confidence = (rows[:, 2:4] / np.median(rows[whole, 2:4], axis=0)).T
    parts = runs(seen)
    befores = parts[:, 0] - np.r_[0, parts[:-1, 1]]
    afters = np.r_[parts[1:, 0], len(seen)] - parts[:, 1]
    for (start, end), before, after in zip(parts, befores, afters, strict=True):
        isolated = (before > MIN_RUN or start == 0) and (after > MIN_RUN or end == len(seen))
        sparse = seen[max(start - 15, 0) : end + 15].mean() < 0.35
        part = slice(start, end)
        false = end - start < min(MIN_RUN, seen.sum()) and (isolated or sparse)
        shown = whole[part]
        if shown.any() and end - start < FALSE_SHARE * seen.sum():
            ratio = np.median(area[part][shown])
            faint = np.median(confidence[part][shown]) < 0.6
            false |= bool(np.mean(alike[part][shown]) < 0.5 or not 0.25 < ratio < 4)
            false |= bool(faint and not 0.5 < ratio < 2)
        if false:
            rows[part] = NOT_SEEN


# ---------------------------------------------------------------- a whole film


@dataclass(frozen=True)
class FilmTrack:
    """Result of tracking a film: the track in pixels before smoothing, the setup, and some frames."""

    track: RawTrack
    video: Video
    #: Setup of the film. Boxes around motionless objects were added to ``ignore_px``, so that no marker is
    #: searched for in these boxes.
    setup: Setup
    #: Some frames of the film for the report, by frame number.
    kept: dict[int, Frame]


def follow(
    path: Path, setup: Setup, *, step: Step, file: str | None = None, within: slice = slice(None)
) -> FilmTrack:
    """Follow the markers of a setup through a film, and return the track.

    A motionless object of the colour of a marker is not the marker if there are other objects of the same
    colour. In this case the film is read again without the motionless object. The second track is returned if
    its marker moves. ``file`` names the setup in messages, and ``within`` selects frames (start and stop).
    """
    first = _follow_once(path, setup, step, file, within)
    track, boxes = first.track, []
    alone = [marker.name for marker in setup.markers if marker.number == 1 and marker.name in track.rivals]
    still = [name for name in alone if track.measure_range(name)[1] < frames.MIN_RADII]
    if not still:
        return first
    for row in map(track.row, still):
        x, y, area = (float(np.nanmedian(values[row])) for values in (track.x, track.y, track.area))
        half = 0.7 * math.sqrt(area) + 3
        boxes.append((round(x - half), round(y - half), round(x + half), round(y + half)))
    setup = setup.model_copy(update={"ignore_px": [*setup.ignore_px, *boxes]})
    second = _follow_once(path, setup, step, file, within)
    if any(second.track.measure_range(name)[1] < 3.0 for name in still):
        return first
    listed = "; ".join(f"[{', '.join(f'{side:.0f}' for side in box)}]" for box in boxes)
    text = f"an object of the marker's colour never moves and was left out (box {listed})"
    warn("SWM049", f"{path.name}: {text}; write the box into ignore_px to avoid a second pass")
    return second


def _follow_once(path: Path, setup: Setup, step: Step, file: str | None, within: slice) -> FilmTrack:
    video = Video(path, frame_rate_hz=setup.frame_rate_hz)
    if setup.camera is not None:
        camera_matrix(setup.camera, video.width, video.height, file, video.pixel_aspect)
    follower: Follower | Silhouette
    if setup.markers[0].method == "background":
        from swimid.tracking.silhouette import Silhouette

        follower = Silhouette(setup, video)
    else:
        follower = Follower(setup, video.width, video.height)
    keeper, last = frames.FrameKeeper(4 * REPORT_FRAMES - 1), -math.inf
    for index, (time, frame) in enumerate(islice(video.frames(), within.start, within.stop)):
        if not time > last:
            text = "has no time stamp, or none later than that of the frame before"
            hint = "give the true frame rate with --fps, or frame_rate_hz in the setup"
            raise InputError(text, file=path, frame=index, hint=hint)
        last = time
        follower.step(time, frame)
        keeper.take(index, frame)
        step()
    kept = list(keeper.kept.items())
    chosen = np.unique(np.linspace(0, len(kept) - 1, REPORT_FRAMES).round().astype(int))
    return FilmTrack(follower.track(), video, setup, dict(kept[k] for k in chosen))
