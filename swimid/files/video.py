"""Writers of videos frame by frame: H.264 (with PyAV), MPEG-4 (without PyAV), and animated GIF."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, UsageError
from swimid.files.provenance import MADE_BY_TEXT, VIDEO_BOX

Frame = NDArray[np.uint8]
#: Resolution of the time stamps of frames in H.264 videos, ticks per second.
CLOCK = 90_000
#: Remark for the user that browsers do not play an MPEG-4 video. The placeholder is the name of the output.
REMARK = "the {} is MPEG-4, which browsers do not play; pip install 'swimid[video]' for H.264"
#: Maximum memory of the frames of an animated GIF, bytes. The GIF writer holds all frames until it is closed.
MAX_GIF_BYTES = 2 << 30


class _Stream:
    """Output file for FFmpeg that keeps the first error of the operating system.

    This class hides a failed write from FFmpeg, which may crash the process if it is used after a failure.
    """

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        self._file = path.open("wb", buffering=0)
        self._error: OSError | None = None
        self.seek, self.tell = self._file.seek, self._file.tell

    def write(self, data: bytes) -> int:
        """Write bytes. After the first error they are discarded."""
        rest = memoryview(data)
        try:
            while rest and self._error is None:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self._error = error
        return len(data)

    def check(self) -> None:
        """Raise the first error of writing, if writing has failed."""
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class H264:
    """Writer of an H.264 video with the library PyAV. Browsers play H.264, and each frame has its own time.

    Raises
    ------
    ImportError
        If PyAV is not installed.
    """

    def __init__(self, path: Path, rate: float, width: int, height: int) -> None:
        import av

        self._av = av
        self._path, self._file = path, _Stream(path)
        self._container = av.open(self._file, "w")
        self._stream = self._container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000))
        self._stream.width, self._stream.height = width, height
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = Fraction(1, CLOCK)
        self._stream.options = {"preset": "veryfast", "crf": "23"}

    def write(self, time_s: float, frame: Frame) -> None:
        """Add a frame with its time stamp to the video."""
        picture = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="bgr24")
        picture.pts = round(time_s * CLOCK)
        picture.time_base = Fraction(1, CLOCK)
        for packet in self._stream.encode(picture):
            self._container.mux(packet)
        self._file.check()

    def close(self) -> None:
        """Write the remaining frames and close the video file.

        Raises
        ------
        OSError
            If the file could not be written, for instance because the disk is full.
        """
        for packet in self._stream.encode():
            self._container.mux(packet)
        self._container.close()
        self._file.close()
        self._file.check()
        _mark(self._path)


class Mpeg4:
    """Writer of an MPEG-4 video with OpenCV, for installations without the library PyAV.

    Most players show the video, but browsers do not.
    """

    def __init__(self, path: Path, rate: float, width: int, height: int) -> None:
        self._path, self._count = path, 0
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
        if not self._writer.isOpened():
            raise InputError(f"no video can be written as '{path.suffix}'", file=path, hint="name it .mp4")

    def write(self, time_s: float, frame: Frame) -> None:
        """Add a frame to the video. Its time follows from the frame rate, and ``time_s`` is ignored."""
        self._writer.write(frame)
        self._count += 1

    def close(self) -> None:
        """Close the video file and check that it has all frames.

        Raises
        ------
        InputError
            If frames are missing in the file. OpenCV reports no error when the disk is full.
        """
        self._writer.release()
        whole = int(cv2.VideoCapture(str(self._path)).get(cv2.CAP_PROP_FRAME_COUNT))
        if whole < self._count:
            what = f"holds {whole} of {self._count} frames"
            raise InputError(what, file=self._path, hint="is the disk full?")
        _mark(self._path)


def _mark(path: Path) -> None:
    with path.open("ab") as stream:
        stream.write(VIDEO_BOX)


class Gif:
    """Writer of an animated GIF with one palette for all frames."""

    def __init__(self, path: Path, rate: float, width: int, height: int) -> None:
        self._path, self._rate = path, rate
        self._frames: list[Frame] = []

    def write(self, time_s: float, frame: Frame) -> None:
        """Add a frame to the animation. Its time follows from the frame rate, and ``time_s`` is ignored."""
        self._frames.append(np.ascontiguousarray(frame[:, :, ::-1]))

    def close(self) -> None:
        """Write all frames to the GIF file. Without frames no file is written."""
        from PIL import Image

        if not self._frames:
            return
        # Use the palette of the last frame for all frames, because it shows the whole path of the robot.
        palette = Image.fromarray(self._frames[-1]).quantize(colors=64)
        first, *rest = (
            Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE) for f in self._frames
        )
        first.save(
            self._path,
            format="GIF",
            save_all=True,
            append_images=rest,
            duration=round(1000 / self._rate),
            loop=0,
            comment=MADE_BY_TEXT.encode(),
        )


def check_length(path: Path, count: int, width: int, height: int) -> None:
    """Check that a video of ``count`` frames, each ``width`` x ``height`` px, can be written.

    Raises
    ------
    UsageError
        The video is an animated GIF whose frames exceed :data:`MAX_GIF_BYTES`.
    """
    most = MAX_GIF_BYTES // (3 * width * height)
    if path.suffix.lower() == ".gif" and count > most:
        raise UsageError(
            f"{path}: an animated GIF holds at most {most} frames of {width} x {height} px, not the "
            f"{count} frames of this animation",
            hint=f"name a film: {path.with_suffix('.mp4')}",
        )


#: Type of a video writer. All frames have the same shape (height, width, 3) and the colour order blue, green,
#: red.
Writer = H264 | Mpeg4 | Gif


def open_writer(path: Path, rate: float, width: int, height: int) -> Writer:
    """Return a writer for a video file. The extension of the file determines the format.

    A ``.gif`` file is an animated GIF. Other files are H.264 videos, or MPEG-4 videos without PyAV.

    Parameters
    ----------
    rate : float, Hz
        Frame rate.
    width, height : int
        Size of a frame, px; even numbers.
    """
    if path.suffix.lower() == ".gif":
        return Gif(path, rate, width, height)
    try:
        return H264(path, rate, width, height)
    except ImportError:
        return Mpeg4(path, rate, width, height)
