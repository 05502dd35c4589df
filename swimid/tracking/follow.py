"""Every marker from frame to frame: windows about predictions, the whole picture when lost."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from swimid.tracking import detect, search
from swimid.tracking.colour import ColourModel, same_hue_and_saturation
from swimid.tracking.detect import Blob
from swimid.tracking.rawtrack import (
    GROWN,
    LOST,
    RETURN_HUE,
    RETURN_SATURATION,
    WINDOW,
    RawTrack,
    drop_false_detections,
)
from swimid.tracking.reader import Frame
from swimid.tracking.search import Kind, Search, is_new, same_place
from swimid.tracking.setup import Marker, Setup
from swimid.tracking.target import Challenger, PairDistance, Target

#: Area without one in the setup: px, and share of the picture.
SMALLEST_AREA_PX, LARGEST_AREA_SHARE = 12.0, 0.05
#: Frames between steps of the colour model.
ADAPT_EVERY = 5
#: Frames between looks for other things of the marker's colour.
LOOK_AROUND_FRAMES = 180
#: Earlier frames kept, and how often, to see whether a thing was there before the marker was lost.
MEMORIES, MEMORY_FRAMES = 2, 120
#: Of equal markers, one this far (as a share) from its partner's distance is another's.
RIGID_LIMIT = 0.3
_NO = 1e6
_NOT_SEEN = (math.nan, math.nan, math.nan, 0.0, LOST, False, math.nan, math.nan, math.nan)
_KNOWN = {field.name for field in fields(Target)}


@dataclass(kw_only=True)
class _Group(Kind):
    """Markers of one colour."""

    marker: Marker
    targets: list[Target]
    #: Other things of the colour at the last look around, and where the markers were then.
    rivals: list[Blob] = field(default_factory=list)
    seen_from: list[tuple[float, float]] = field(default_factory=list)
    most_rivals: int = 0
    next_look: int = 0
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
        return bool(same_hue_and_saturation(blob.hsv, target.colour, RETURN_HUE, RETURN_SATURATION))

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
        self.pause = min(2 * self.pause, LOOK_AROUND_FRAMES)


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
        self.groups = [
            _Group(
                marker=marker,
                model=ColourModel(marker.colour_range()),
                area_px=marker.area_px or (SMALLEST_AREA_PX, LARGEST_AREA_SHARE * width * height),
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

    def run(self, frames: Iterable[tuple[float, Frame]]) -> None:
        """Follow through all frames."""
        for time, frame in frames:
            self.step(time, frame)

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
                if self._frame % ADAPT_EVERY == 0 and blob.confidence > 0.3 and not blob.at_edge:
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

    def _follow(self, group: _Group, time: float, frame: Frame) -> dict[str, Blob]:
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

    def _in_windows(self, group: _Group, known: list[Target], time: float, frame: Frame) -> dict[str, Blob]:
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

    def _window(self, group: _Group, target: Target, time: float, frame: Frame) -> list[Blob]:
        """Blobs in the target's window, grown until nothing that matters is cut by its border."""
        cx, cy = target.predicted(time)
        half = 1.3 * target.radius + target.reach(time - target.time) + 4
        step = max(min(int(target.radius / 6), search.MASK_STEP), 1)
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

    def _cost(self, group: _Group, target: Target, blob: Blob, time: float) -> float:
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

    def _was_there(self, group: _Group, target: Target, blob: Blob) -> bool:
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
        self, group: _Group, lost: list[Target], blobs: list[Blob], time: float
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

    def _return_cost(self, group: _Group, target: Target, blob: Blob, time: float) -> float:
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

    def _contest(self, group: _Group, target: Target, blobs: list[Blob], time: float) -> Blob | None:
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
