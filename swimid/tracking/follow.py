"""Every marker from frame to frame: windows about predictions, the whole picture when lost."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from swimid.tracking import detect, search
from swimid.tracking.colour import ColourModel, same_hue_and_saturation
from swimid.tracking.detect import Blob
from swimid.tracking.rawtrack import (
    FULL,
    GROWN,
    LOST,
    RETURN_HUE,
    RETURN_SATURATION,
    WINDOW,
    RawTrack,
    drop_strangers,
)
from swimid.tracking.reader import Frame
from swimid.tracking.search import Kind, Search, is_new, same_place
from swimid.tracking.setup import Marker, Setup
from swimid.tracking.target import Bond, Challenger, Target

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


@dataclass
class _Group:
    """Markers of one colour."""

    marker: Marker
    kind: Kind
    targets: list[Target]
    #: Other things of the colour at the last look around, and where the markers were then.
    rivals: list[Blob] = field(default_factory=list)
    seen_from: list[tuple[float, float]] = field(default_factory=list)
    most_rivals: int = 0
    next_look: int = 0
    pause: int = 12


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
                marker,
                Kind(
                    ColourModel(marker.colour_range()),
                    marker.area_px or (SMALLEST_AREA_PX, LARGEST_AREA_SHARE * width * height),
                ),
                [Target(name) for name in marker.names],
            )
            for marker in setup.markers
        ]
        #: Between markers of different colours, where some colour is worn by several.
        self._bonds: dict[tuple[str, str], Bond] = {}
        self._targets = [t for g in self.groups for t in g.targets]
        if any(len(g.targets) > 1 for g in self.groups):
            for k, one in enumerate(self.groups):
                for other in self.groups[k + 1 :]:
                    self._bonds |= {(a.name, b.name): Bond() for a in one.targets for b in other.targets}
        #: Earlier frames, and where the markers were in them.
        self._memory: deque[tuple[Frame, dict[str, tuple[float, float]]]] = deque(maxlen=MEMORIES)
        self._rows: list[list[tuple[float, ...]]] = []
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
        for group in self.groups:
            sights = self._follow(group, time, frame)
            for target in group.targets:
                blob, status = sights.get(target.name, (None, LOST))
                if blob is None:
                    target.missed += 1
                    row.append(_NOT_SEEN)
                    continue
                row.append(_row(target, blob, status))
                target.see(blob, time)
                if self._frame % ADAPT_EVERY == 0 and blob.confidence > 0.3 and not blob.at_edge:
                    group.kind.model.adapt(blob.hsv)
            if not sights:
                group.kind.model.forget()
        for (one, other), bond in self._bonds.items():
            a, b = self._target(one), self._target(other)
            if a.time == time == b.time:
                bond.add(math.hypot(a.x - b.x, a.y - b.y))
        if self._frame % MEMORY_FRAMES == MEMORY_FRAMES // 6:
            places = {t.name: (t.x, t.y) for t in self._targets if t.sights and not t.missed}
            if places:
                # The oldest frame's memory is used again: fresh pages cost more than the copy.
                old = self._memory.popleft()[0] if len(self._memory) == MEMORIES else np.empty_like(frame)
                np.copyto(old, frame)
                self._memory.append((old, places))
        self._rows.append(row)
        self._times.append(time)
        self._frame += 1

    def _target(self, name: str) -> Target:
        return next(t for t in self._targets if t.name == name)

    def _misfit(self, target: Target, blob: Blob, time: float) -> float:
        """How badly a blob fits the target's rigid partners: 0 well, ``_NO`` not at all."""
        worst = 0.0
        for pair, bond in self._bonds.items():
            if target.name not in pair or not bond.rigid:
                continue
            partner = self._target(pair[1] if pair[0] == target.name else pair[0])
            if partner.missed:
                continue
            px, py = partner.predicted(time)
            error = abs(math.hypot(blob.x - px, blob.y - py) / bond.mean - 1)
            if error > RIGID_LIMIT:
                return _NO
            worst = max(worst, (error / RIGID_LIMIT) ** 2)
        return worst

    def track(self, times: NDArray[np.float64] | None = None) -> RawTrack:
        """What was found so far; ``times`` replaces the times given with the frames."""
        table = np.array(self._rows, dtype=float)  # (n, m, 9)
        names = [t.name for g in self.groups for t in g.targets]
        if not len(table):
            table = np.zeros((0, len(names), 9))
        track = RawTrack(
            times=np.array(self._times) if times is None else times,
            names=names,
            x=table[:, :, 0].T.copy(),
            y=table[:, :, 1].T.copy(),
            area=table[:, :, 2].T.copy(),
            confidence=table[:, :, 3].T.copy(),
            status=table[:, :, 4].T.astype(int),
            at_edge=table[:, :, 5].T.astype(bool),
            drift={g.marker.name: g.kind.model.largest_drift for g in self.groups if g.kind.model.drifted},
            rivals={g.marker.name: g.most_rivals for g in self.groups if g.most_rivals},
            mistaken=self._mistaken,
        )
        for i in range(len(names)):
            drop_strangers(track, i, table[:, i, 6:])
        return track

    # ------------------------------------------------------------ one colour, one frame

    def _follow(self, group: _Group, time: float, frame: Frame) -> dict[str, tuple[Blob, int]]:
        known = [t for t in group.targets if t.sights]
        sights = self._in_windows(group, known, time, frame)
        lost = [t for t in group.targets if t.name not in sights and not self._hidden(t, known, sights, time)]
        unsure = [t for t in known if t.name in sights and not t.whole]
        if lost or unsure:
            taken = [blob for blob, _ in sights.values()]
            area = max((t.area for t in lost), default=0.0)
            blobs = [b for b in self._search.picture(group.kind, frame, area) if is_new(b, taken)]
            for target, blob in self._in_picture(group, lost, blobs, time):
                sights[target.name] = (blob, FULL)
                blobs = [b for b in blobs if b is not blob]
            for target in (t for t in known if t.name not in sights or t in unsure):
                winner = self._contest(group, target, blobs, time)
                if winner is not None:
                    sights[target.name] = (winner, FULL)
                    blobs = [b for b in blobs if b is not winner]
        for target in known:
            if (
                target.missed
                and target.name in sights
                and self._was_there(group, target, sights[target.name][0])
            ):
                group.kind.scenery.append(sights.pop(target.name)[0])
        if not lost and not unsure and self._frame >= group.next_look:
            self._look_around(group, [blob for blob, _ in sights.values()], frame)
        return sights

    def _in_windows(
        self, group: _Group, known: list[Target], time: float, frame: Frame
    ) -> dict[str, tuple[Blob, int]]:
        """Each known target in a window about its prediction."""
        candidates: list[Blob] = []
        statuses: list[int] = []
        for target in known:
            if target.missed and time - target.time > self.setup.max_gap_s:
                continue
            blobs, status = self._window(group, target, time, frame)
            for blob in blobs:
                if not any(math.hypot(b.x - blob.x, b.y - blob.y) < 2 for b in candidates):
                    candidates.append(blob)
                    statuses.append(status)
        if not candidates:
            return {}
        cost = [[self._cost(group, target, blob, time) for blob in candidates] for target in known]
        found = {known[i].name: (candidates[j], statuses[j]) for i, j in _assigned(cost)}
        if len(known) > 1:
            self._drop_merged(known, found, time)
        return found

    def _cost(self, group: _Group, target: Target, blob: Blob, time: float) -> float:
        """How unlikely a blob near the prediction is the target, ``_NO`` for impossible."""
        px, py = target.predicted(time)
        allowed = target.radius + 2 * target.reach(time - target.time)
        away = math.hypot(blob.x - px, blob.y - py)
        if away > allowed + target.radius or not self._alike(group, target, blob):
            return _NO
        cost = (away / allowed) ** 2
        if target.whole and not blob.at_edge:
            cost += 0.3 * abs(math.log(blob.area / target.area))
        return min(cost + self._misfit(target, blob, time), _NO)

    def _window(self, group: _Group, target: Target, time: float, frame: Frame) -> tuple[list[Blob], int]:
        """Blobs in the target's window, grown until nothing that matters is cut by its border."""
        cx, cy = target.predicted(time)
        half = 1.3 * target.radius + target.reach(time - target.time) + 4
        status = WINDOW
        step = max(min(int(target.radius / 6), search.MASK_STEP), 1)
        for _ in range(3):
            blobs, cut = self._search.window(group.kind, frame, cx, cy, half, step)
            if any(self._alike(group, target, blob) for blob in blobs):
                return blobs, status
            if cut is not None:
                cx, cy = 0.5 * (cut[0] + cut[2]), 0.5 * (cut[1] + cut[3])
            half *= 2
            status = GROWN
        return [], LOST

    def _alike(self, group: _Group, target: Target, blob: Blob, gone: float = 0.0) -> bool:
        """Whether a blob may be the target by its size and contrast, as far as these are known."""
        if not target.whole:
            # Equal markers are of one size; else a blob of any the setup allows may be it.
            like = [t.usual_area for t in group.targets if t.whole]
            return not like or blob.at_edge or 0.5 < blob.area / max(like) < 2.0
        alone = len(group.targets) == 1
        # Equal markers that touch look like one of twice the size, half hidden ones are off centre.
        low, high = (0.3, 3.0) if alone else (0.7, 1.4)
        ratio = blob.area / (target.usual_area if gone or not alone else target.area)
        if blob.at_edge:
            low = 0.0
        if not low <= ratio <= high or blob.contrast < 0.4 * target.contrast:
            return False
        if not gone or target.colour is None:
            return True
        return bool(same_hue_and_saturation(blob.hsv, target.colour, RETURN_HUE, RETURN_SATURATION))

    def _drop_merged(self, known: list[Target], found: dict[str, tuple[Blob, int]], time: float) -> None:
        """Where equal markers meet and fewer blobs than markers are seen, none of them is known."""
        for i, first in enumerate(known):
            for second in known[i + 1 :]:
                if (first.name in found) == (second.name in found):
                    continue
                if self._together(first, second, found, time):
                    found.pop(first.name, None)
                    found.pop(second.name, None)

    def _together(
        self, first: Target, second: Target, found: dict[str, tuple[Blob, int]], time: float
    ) -> bool:
        places = []
        for target in (first, second):
            blob = found.get(target.name)
            places.append((blob[0].x, blob[0].y) if blob else target.predicted(time))
        away = math.hypot(places[0][0] - places[1][0], places[0][1] - places[1][1])
        return away < first.radius + second.radius + 4

    def _hidden(
        self, target: Target, known: list[Target], sights: dict[str, tuple[Blob, int]], time: float
    ) -> bool:
        """Whether the target is known to be behind or at its like: no use searching for it."""
        if not target.sights or time - target.time > self.setup.max_gap_s:
            return False
        return any(
            other is not target and other.name not in sights and self._together(target, other, sights, time)
            for other in known
        )

    def _was_there(self, group: _Group, target: Target, blob: Blob) -> bool:
        """Whether the blob was there already while the target was seen elsewhere."""
        for frame, places in self._memory:
            if target.name not in places:
                continue
            x, y = places[target.name]
            if math.hypot(blob.x - x, blob.y - y) < 2 * max(target.radius, blob.radius) + 4:
                continue
            old, _ = self._search.window(group.kind, frame, blob.x, blob.y, 1.3 * blob.radius + detect.MARGIN)
            taken = [place for name, place in places.items() if name != target.name]
            if any(same_place(blob, b) and _far(b, taken) for b in old):
                return True
        return False

    # ------------------------------------------------------------ the whole picture

    def _in_picture(
        self, group: _Group, lost: list[Target], blobs: list[Blob], time: float
    ) -> list[tuple[Target, Blob]]:
        """Which of the blobs of the whole picture are lost targets."""
        if not blobs:
            return []
        fresh = [t for t in lost if not t.sights]
        pairs: list[tuple[Target, Blob]] = []
        if fresh:
            if len(blobs) < len(fresh) and len(fresh) > 1:
                fresh = []  # names are given when all are there, from left to right
            chosen = self._first_choice(group, fresh, blobs)
            pairs += chosen
            blobs = [b for b in blobs if all(b is not c for _, c in chosen)]
            if chosen and len(chosen) == len(group.targets):
                self._note_rivals(group, blobs)
        missing = [t for t in lost if t.sights]
        if missing and blobs:
            cost = [[self._return_cost(group, t, blob, time) for blob in blobs] for t in missing]
            pairs += [(missing[i], blobs[j]) for i, j in _assigned(cost)]
        return pairs

    def _return_cost(self, group: _Group, target: Target, blob: Blob, time: float) -> float:
        gone = time - target.time
        if not self._alike(group, target, blob, gone):
            return _NO
        px, py = target.predicted(time) if gone <= self.setup.max_gap_s else (target.x, target.y)
        away = math.hypot(blob.x - px, blob.y - py)
        if gone <= self.setup.max_gap_s and target.sights >= 3:
            near = 4 * target.radius + 10 + 0.2 * target.missed * target.radius
            near += 2 * max(math.hypot(target.vx, target.vy), target.pace) * gone
            misfit = self._misfit(target, blob, time)
            return min(away * (1 + misfit), _NO) if away <= near and misfit < _NO else _NO
        if any(math.hypot(blob.x - r.x, blob.y - r.y) < 0.7 * r.radius for r in group.rivals):
            return _NO
        return 1e3 + away / (1e-3 + blob.confidence)

    def _first_choice(
        self, group: _Group, fresh: list[Target], blobs: list[Blob]
    ) -> list[tuple[Target, Blob]]:
        if not fresh:
            return []
        starts = group.marker.start_px
        if starts is not None:
            places = dict(zip(group.marker.names, starts, strict=True))
            away = np.array(
                [[math.hypot(b.x - places[t.name][0], b.y - places[t.name][1]) for b in blobs] for t in fresh]
            )
            return [(fresh[i], blobs[j]) for i, j in zip(*linear_sum_assignment(away), strict=True)]
        best = sorted(blobs, key=lambda blob: _merit(group, blob), reverse=True)[: len(fresh)]
        best.sort(key=lambda blob: blob.x)
        return list(zip(fresh, best, strict=False))

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
            and not (target.whole and self._alike(group, target, b, gone))
        ]
        rival = target.challenger
        if rival is not None and time - rival.time > self.setup.max_gap_s:
            rival = target.challenger = None
        if rival is None:
            if not blobs:
                return None
            rival = target.challenger = Challenger(target.name)
            best = max(blobs, key=lambda blob: _merit(group, blob))
        else:
            costs = [self._cost(group, rival, blob, time) for blob in blobs]
            if min(costs, default=_NO) >= _NO:
                rival.missed += 1
                return None
            best = blobs[int(np.argmin(costs))]
        rival.rows[self._frame] = _row(rival, best, FULL)
        rival.see(best, time)
        if not rival.prevails(target):
            return None
        column = self._targets.index(target)
        if target.whole:
            count, area = self._mistaken.get(target.name, (0, 0.0))[0] + target.whole, target.usual_area
            self._mistaken[target.name] = (count, area)
        for frame, row in enumerate(self._rows):
            row[column] = rival.rows.get(frame, _NOT_SEEN)
        vars(target).update({k: v for k, v in vars(rival).items() if k in _KNOWN}, challenger=None)
        group.kind.model.restart()
        return best

    def _look_around(self, group: _Group, taken: list[Blob], frame: Frame) -> None:
        """Remember what else has this colour, so that it is not taken for a lost marker."""
        area = max((t.area for t in group.targets), default=0.0)
        self._note_rivals(
            group, [b for b in self._search.picture(group.kind, frame, area) if is_new(b, taken)]
        )

    def _note_rivals(self, group: _Group, rivals: list[Blob]) -> None:
        here = [(t.x, t.y) for t in group.targets]
        moved = any(
            math.hypot(x - x0, y - y0) > t.radius + 2
            for t, (x, y), (x0, y0) in zip(group.targets, here, group.seen_from, strict=False)
        )
        if moved:
            still = [b for b in rivals if any(same_place(b, old) for old in group.rivals)]
            group.kind.scenery += [
                b for b in still if not any(same_place(b, old) for old in group.kind.scenery)
            ]
        if moved or not group.seen_from or math.isnan(group.seen_from[0][0]):
            group.rivals, group.seen_from = rivals, here
        group.most_rivals = max(group.most_rivals, len(rivals))
        group.next_look = self._frame + group.pause
        group.pause = min(2 * group.pause, LOOK_AROUND_FRAMES)


def _row(target: Target, blob: Blob, status: int) -> tuple[float, ...]:
    """What is kept of a sight: place, area, confidence, status, whether cut, and the mean colour."""
    usual = blob.area if blob.at_edge or not target.whole else target.usual_area
    likeness = min(blob.area / usual, usual / blob.area)
    sure = blob.confidence * likeness**0.5
    return (blob.x, blob.y, blob.area, sure, status, blob.at_edge, *blob.hsv)


def _merit(group: _Group, blob: Blob) -> float:
    """How much of a marker a blob looks, of which nothing but its colour is known."""
    fit = 1.5 - min(group.kind.model.distance(blob.hsv), 1.0)
    return math.sqrt(blob.contrast * blob.area) * fit * (0.3 if blob.at_edge else 1.0)


def _assigned(cost: list[list[float]]) -> list[tuple[int, int]]:
    """Pairs (row, column) of least total cost; pairs that cost ``_NO`` are left out."""
    if len(cost) == 1:
        best = min(range(len(cost[0])), key=cost[0].__getitem__)
        return [(0, best)] if cost[0][best] < _NO else []
    rows, columns = linear_sum_assignment(np.array(cost))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i][j] < _NO]


def _far(blob: Blob, places: list[tuple[float, float]]) -> bool:
    return all(math.hypot(blob.x - x, blob.y - y) > blob.radius for x, y in places)
