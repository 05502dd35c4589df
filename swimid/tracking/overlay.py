"""The video again, with the track drawn in."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.formats import atomic
from swimid.formats.setup import Setup
from swimid.progress import Progress, silent
from swimid.tracking.pictures import Painter
from swimid.tracking.reader import Frame, Video

#: Ticks a second of the overlay's time stamps.
_CLOCK = 90_000


class _Writer(Protocol):
    def write(self, time_s: float, frame: Frame) -> None: ...
    def close(self) -> None: ...


class _H264:
    """H.264 through PyAV: plays in browsers, keeps the frames' own times."""

    def __init__(self, path: Path, rate: float, width: int, height: int) -> None:
        import av

        self._av = av
        self._container = av.open(str(path), "w")
        self._stream = self._container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000))
        self._stream.width, self._stream.height = width, height
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = Fraction(1, _CLOCK)
        self._stream.options = {"preset": "veryfast", "crf": "23"}

    def write(self, time_s: float, frame: Frame) -> None:
        picture = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="bgr24")
        picture.pts = round(time_s * _CLOCK)
        picture.time_base = Fraction(1, _CLOCK)
        for packet in self._stream.encode(picture):
            self._container.mux(packet)

    def close(self) -> None:
        for packet in self._stream.encode():
            self._container.mux(packet)
        self._container.close()


class _Mpeg4:
    """MPEG-4 through OpenCV: the fallback; most players show it, browsers do not."""

    def __init__(self, path: Path, rate: float, width: int, height: int) -> None:
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
        if not self._writer.isOpened():
            raise InputError("no video can be written with this ending", file=path, hint="name it .mp4")

    def write(self, time_s: float, frame: Frame) -> None:
        self._writer.write(frame)

    def close(self) -> None:
        self._writer.release()


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
        writer: _Writer
        try:
            writer = _H264(temporary, rate, width, height)
        except ImportError:
            writer = _Mpeg4(temporary, rate, width, height)
            remark = (
                "the overlay is MPEG-4, which browsers do not play; pip install 'swimid[video]' for H.264"
            )
        try:
            for index, (_, frame) in enumerate(source.frames()):
                if index >= len(times):
                    break
                writer.write(float(times[index]), painter.draw(index, frame)[:height, :width])
                step()
        finally:
            writer.close()
    return remark
