"""The video again, with the track drawn in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.files.video import REMARK, Mpeg4, open_writer
from swimid.progress import Progress, silent
from swimid.tracking.pictures import Painter
from swimid.tracking.reader import Video
from swimid.tracking.setup import Setup


def write(
    path: Path,
    video: str | Path,
    painter: Painter,
    setup: Setup,
    times: NDArray[np.float64],
    *,
    progress: Progress = silent,
) -> str:
    """Read the video a second time and write it with the track drawn in.

    What is drawn is the finished track: smoothed and bridged, without the sights that were taken back. None
    of it is known while the video is read first, and all its frames do not fit into memory. The second
    decoding is an eighth of what tracking with an overlay costs; encoding is most of it.

    Returns
    -------
    str
        A remark for the user, empty when there is none.
    """
    source = Video(video, apply_rotation=setup.apply_rotation)
    width, height = source.info.width // 2 * 2, source.info.height // 2 * 2
    rate = 1 / float(np.median(np.diff(times))) if len(times) > 1 else 25.0
    remark = ""
    with atomic.replacing(path) as temporary, progress("overlay", total=len(times)) as step:
        writer = open_writer(temporary, rate, width, height)
        if isinstance(writer, Mpeg4):
            remark = REMARK.format("overlay")
        try:
            for index, (_, frame) in enumerate(source.frames()):
                if index >= len(times):
                    break
                writer.write(float(times[index]), painter.draw(index, frame)[:height, :width])
                step()
        finally:
            writer.close()
    return remark
