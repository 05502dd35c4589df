"""Pictures to a film, for all that renders some."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

_CLOCK = 90_000


def write(
    path: Path,
    frames: Iterable[np.ndarray],
    *,
    size: tuple[int, int],
    times: Iterable[float],
    rate_hz: float,
    crf: float,
    preset: str = "ultrafast",
) -> Path:
    """Pictures (uint8 BGR) as H.264, each with its own stamp; returns ``path``.

    Parameters
    ----------
    size : (int, int)
        Width and height, px.
    times : iterable of float
        Of the pictures, s; to 1/90000 s.
    rate_hz : float
        What the container claims.
    crf : float
        Of x264: less is better.
    preset : str
        Of x264: "ultrafast" takes a third of the time of "veryfast", and twice the space, at the same error.
    """
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate_hz).limit_denominator(1001))
        (stream.width, stream.height), stream.pix_fmt = size, "yuv420p"
        stream.codec_context.time_base = Fraction(1, _CLOCK)
        stream.options = {"preset": preset, "crf": str(crf), "threads": "1"}
        for time, image in zip(times, frames, strict=True):
            picture = av.VideoFrame.from_ndarray(image, format="bgr24")
            picture.pts, picture.time_base = round(time * _CLOCK), Fraction(1, _CLOCK)
            for packet in stream.encode(picture):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path
