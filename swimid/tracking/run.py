"""One video from its first frame to its last, with a second look where the first was fooled."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swimid.notices import warn
from swimid.progress import Step
from swimid.tracking import motion, plane
from swimid.tracking.follow import Follower
from swimid.tracking.rawtrack import RawTrack
from swimid.tracking.reader import Frame, FrameKeeper, Video
from swimid.tracking.setup import Box, Setup
from swimid.tracking.silhouette import Silhouette, empty_scene

#: Frames kept for the report.
REPORT_FRAMES = 6
#: Least way, in marker radii, for a second look to be preferred.
_LEAST_WAY = 3.0


@dataclass(frozen=True)
class Run:
    """Raw result of following a video."""

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
    boxes = _motionless(first)
    if not boxes:
        return first
    second = _once(path, setup.model_copy(update={"ignore_px": [*setup.ignore_px, *boxes]}), step, file)
    for name in second.track.names:
        if motion.reach(second.track, name).radii < _LEAST_WAY and name in _static_names(first):
            return first
    listed = "; ".join(f"[{', '.join(f'{v:.0f}' for v in box)}]" for box in boxes)
    warn(
        "SWM049",
        f"{path.name}: a thing of the marker's colour never moves and was left out (box {listed}); "
        "write it into ignore_px of the setup to save the second reading",
    )
    return second


def _once(path: Path, setup: Setup, step: Step, file: str | None) -> Run:
    video = Video(path, frame_rate_hz=setup.frame_rate_hz, apply_rotation=setup.apply_rotation)
    video.demand_clock()
    if setup.camera is not None:
        plane.camera_matrix(setup.camera, video.width, video.height, file)
    follower: Follower | Silhouette
    if setup.markers[0].method == "background":
        follower = Silhouette(setup, empty_scene(path, setup), video.width, video.height)
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


def _static_names(run: Run) -> list[str]:
    """Markers that are alone of their colour in the setup, are seen, never move, and had rivals."""
    return [
        marker.name
        for marker in run.setup.markers
        if marker.number == 1
        and marker.name in run.track.rivals
        and not motion.reach(run.track, marker.name).moves
    ]


def _motionless(run: Run) -> list[Box]:
    boxes: list[Box] = []
    for name in _static_names(run):
        i = run.track.row(name)
        x, y, area = (float(np.nanmedian(v[i])) for v in (run.track.x, run.track.y, run.track.area))
        half = 0.7 * math.sqrt(area) + 3
        boxes.append((round(x - half), round(y - half), round(x + half), round(y + half)))
    return boxes
