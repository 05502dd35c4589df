"""Frames of a video, or of a series of pictures, with the stamps they carry."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# FFmpeg's own remarks on damaged frames would stand on stderr between swimid's messages.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")

import cv2

from swimid.errors import InputError
from swimid.notices import warn
from swimid.tracking.stills import Stills, is_sequence

Frame = NDArray[np.uint8]

#: A step of the stamps this far from the median step is irregular.
JITTER = 0.25


@dataclass(frozen=True)
class VideoInfo:
    """What the container says about a video."""

    path: Path
    width: int
    height: int
    #: Mean rate the container claims, Hz; 0 where it claims none.
    frame_rate_hz: float
    #: Number of frames the container claims; 0 where it claims none.
    frames: int
    #: Rotation tag, degrees.
    rotation_deg: int
    #: The file, or the pictures.
    files: tuple[Path, ...]


class _Container:
    """A video file, decoded frame by frame."""

    def __init__(self, path: Path, *, apply_rotation: bool) -> None:
        if not path.is_file():
            raise InputError("cannot be read: no such file", file=path, hint="check the path")
        if path.stat().st_size == 0:
            raise InputError("is empty", file=path)
        # One thread more than cores: the decoder goes on while a frame is looked at.
        threads = min(os.cpu_count() or 1, 16) + 1
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, threads])
        if not self._capture.isOpened():
            raise InputError(
                "is not a video that can be decoded, or its index is missing (a recording cut short)",
                file=path,
                hint="check that a player plays it; a cut recording can be repaired with "
                "'ffmpeg -i in.mp4 -c copy out.mkv' or untrunc",
            )
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, float(apply_rotation))
        self.files = [path]
        #: Number of the frame last read.
        self.position = -1
        self._frame: Frame | None = None

    def read(self) -> Frame | None:
        """The next frame, into the memory of the one before; None after the last."""
        ok, frame = self._capture.read(self._frame)
        if not ok or frame is None:
            self._capture.release()
            return None
        self._frame = np.asarray(frame, np.uint8)
        self.position += 1
        return self._frame

    @property
    def stamp_s(self) -> float:
        """The container's stamp of the frame last read."""
        return self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000

    def claims(self) -> tuple[float, int, int]:
        """Mean rate in Hz, number of frames (0 where there is none) and rotation tag in degrees."""
        properties = (cv2.CAP_PROP_FPS, cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_ORIENTATION_META)
        rate, count, rotation = (self._capture.get(key) for key in properties)
        rate = rate if np.isfinite(rate) and rate > 0 else 0.0
        return rate, int(count) if 0 < count < 1e9 else 0, int(rotation)


class Video:
    """A video that is read once, from its first frame to its last.

    Parameters
    ----------
    path : path
        A video file; or a folder of pictures, or a pattern of their names (``pool/%05d.png``).
    frame_rate_hz : float, optional
        True frame rate where the stamps of the container lie; frame i is then at
        i / frame_rate_hz. Pictures have no other clock.
    apply_rotation : bool
        Turn the picture as the rotation tag says. Set explicitly, because the default
        changed between OpenCV versions.

    Raises
    ------
    InputError
        When the file is missing or no frame of it decodes.
    """

    def __init__(
        self, path: str | Path, *, frame_rate_hz: float | None = None, apply_rotation: bool = True
    ) -> None:
        self.path = Path(path)
        # On few cores decoding uses them all; threads for small images only cost.
        cv2.setNumThreads(1)
        kind = Stills if is_sequence(self.path) else _Container
        self._source: _Container | Stills = kind(self.path, apply_rotation=apply_rotation)
        self._first = self._source.read()
        if self._first is None:
            hint = "check that a player plays it"
            raise InputError("no frame of this file can be decoded", file=self.path, frame=0, hint=hint)
        self.first_stamp_s = self._source.stamp_s
        height, width = self._first.shape[:2]
        self.info = VideoInfo(self.path, width, height, *self._source.claims(), tuple(self._source.files))
        self._rate = frame_rate_hz
        self._stamps: list[float] = []
        self._positions: list[int] = []

    def demand_clock(self) -> None:
        """Raise where nothing tells the time of the frames: pictures without a frame rate."""
        if self._rate is None and np.isnan(self.first_stamp_s):
            raise InputError(
                "is a series of pictures, which carry no time stamps",
                file=self.path,
                hint="give their rate with --fps, or frame_rate_hz in the setup",
            )

    def frames(self) -> Iterator[tuple[float, Frame]]:
        """Every frame as (time in s, picture in BGR). The picture is overwritten by the next.

        The time of pictures without a frame rate is NaN.
        """
        frame = self._first
        self._stamps, self._positions = [], []
        while frame is not None:
            self._stamps.append(self._source.stamp_s)
            self._positions.append(self._source.position)
            if self._rate:
                time = (self._positions[-1] - self._positions[0]) / self._rate
            else:
                time = self._stamps[-1] - self.first_stamp_s
            yield time, frame
            frame = self._source.read()
        count, claimed = len(self._stamps), self.info.frames
        # Some containers count one or two frames more than they hold.
        if len(self.info.files) == 1 and claimed and count < claimed - max(2, 0.01 * claimed):
            warn(
                "SWM044",
                f"{self.path.name}: {count} of {claimed} frames could be decoded; the video is damaged or "
                f"cut after frame {count - 1}",
            )

    def times(self) -> NDArray[np.float64]:
        """Times of the frames read so far, s, strictly increasing, from 0 at the first.

        Stamps that stand still or run backwards are replaced by even steps, with a warning.
        """
        if self._rate:
            positions = np.array(self._positions, dtype=float)
            return (positions - positions[:1]) / self._rate
        stamps = np.array(self._stamps)
        stamps -= stamps[:1]
        backwards, rate = np.diff(stamps) <= 0, self.info.frame_rate_hz
        if not backwards.any():
            return stamps
        bad = int(np.argmax(backwards)) + 1
        if not rate:
            hint = "give the true frame rate with --fps"
            raise InputError("its frames carry no usable time stamps", file=self.path, frame=bad, hint=hint)
        warn(
            "SWM043",
            f"{self.path.name}: the stamp of frame {bad} does not follow the one before; even steps of "
            f"1/{rate:g} s are used instead. Give --fps if that is not the camera's rate",
        )
        return np.arange(len(stamps)) / rate


def reduced(frame: Frame, width: int) -> Frame:
    """A copy of a picture, at most ``width`` px wide."""
    factor = max(frame.shape[1] / width, 1.0)
    if factor == 1:
        return frame.copy()
    small = cv2.resize(frame, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


class FrameKeeper:
    """Keeps some frames spread evenly over a video of unknown length.

    Parameters
    ----------
    most : int
        As soon as more are kept every second one is dropped.
    every : int
        At first every so many frames are kept.
    width : int, optional
        They are reduced to this width.
    """

    def __init__(self, most: int, every: int = 1, width: int | None = None) -> None:
        self.kept: dict[int, Frame] = {}
        self._most, self._every, self._width = most, every, width

    def take(self, index: int, frame: Frame) -> None:
        """Look at the next frame; a copy is kept now and then."""
        if index % self._every:
            return
        self.kept[index] = reduced(frame, self._width or frame.shape[1])
        if len(self.kept) > self._most:
            self._every *= 2
            self.kept = {k: f for k, f in self.kept.items() if k % self._every == 0}


def irregular(times: NDArray[np.float64]) -> tuple[float, float]:
    """Spread of the time steps.

    Returns
    -------
    share : float
        Share of steps further than ``JITTER`` from the median step.
    largest : float
        Longest step over the median step.
    """
    steps = np.diff(times)
    if len(steps) < 2:
        return 0.0, 1.0
    middle = float(np.median(steps))
    return float(np.mean(np.abs(steps - middle) > JITTER * middle)), float(steps.max() / middle)
