"""Frames of a film, or of a series of pictures, with their time stamps."""

from __future__ import annotations

import itertools
import math
import os
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# FFmpeg would print remarks on damaged frames between the messages of swimid.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")

import cv2

from swimid.errors import InputError, UsageError
from swimid.notices import warn

Frame = NDArray[np.uint8]

#: File name extensions of pictures.
ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm")
#: Colour of measured points in a drawing, BGR (Okabe and Ito).
MEASURED = (0, 159, 230)
#: Placeholder for a whole number in a format of the C function printf.
_HOLDER = re.compile(r"%0?\d*d")
#: A frame: position in the film, time stamp (s; NaN for pictures), and picture.
_Read = tuple[int, float, Frame]


def _pictures(path: Path, files: list[Path]) -> Iterator[_Read]:
    """Yield pictures in the order of the numbers in their names.

    A missing picture leaves a gap in time.
    """
    bad, first = [], None
    for position, file in zip(_positions(path, files), files, strict=True):
        frame = cv2.imread(str(file))
        if frame is None:
            bad.append(file.name)
            continue
        first = first or frame.shape
        if frame.shape != first:
            here, before = (f"{size[1]} x {size[0]}" for size in (frame.shape, first))
            text = f"is {here} pixels, those before it are {before}"
            hint = "all pictures of a film have one size; name them by a pattern (%05d.png)"
            raise InputError(text, file=file, hint=hint)
        yield position, math.nan, np.asarray(frame, np.uint8)
    if bad:
        text = f"{len(bad)} of {len(files)} pictures could not be decoded ({', '.join(bad[:3])})"
        warn("SWM044", f"{path.name}: {text}; their time is left out")


def _opened(path: Path) -> cv2.VideoCapture:
    """Open a film for decoding."""
    if not path.is_file():
        raise InputError("cannot be read: no such file", file=path, hint="check the path")
    if path.stat().st_size == 0:
        raise InputError("is empty", file=path)
    # with one thread more than cores the decoder continues while a frame is evaluated
    threads = min(os.cpu_count() or 1, 16) + 1
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, threads])
    if not capture.isOpened():
        text = "is not a video that can be decoded, or its index is missing (a recording cut short)"
        hint = "check that a player plays it; 'ffmpeg -i in.mp4 -c copy out.mkv' may repair a cut recording"
        raise InputError(text, file=path, hint=hint)
    # the default of this setting depends on the version of OpenCV
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1.0)
    return capture


def _decoded(capture: cv2.VideoCapture) -> Iterator[_Read]:
    """Yield the frames of a film. Each frame overwrites the previous one in memory."""
    picture: Frame | None = None
    for position in itertools.count():
        ok, frame = capture.read(picture)
        if not ok or frame is None:
            break
        picture = np.asarray(frame, np.uint8)
        yield position, capture.get(cv2.CAP_PROP_POS_MSEC) / 1000, picture
    capture.release()


class Video:
    """Film that is read once, from its first frame to its last.

    Parameters
    ----------
    path : path
        A film, a folder of pictures, or a pattern of their names (``pool/%05d.png``).
    frame_rate_hz : float, optional
        True frame rate, if the stamps of the container are wrong. The time of frame i is then i /
        frame_rate_hz. Pictures need a frame rate because they have no stamps.

    Attributes
    ----------
    files : list of path
        File of the film, or files of the pictures.
    width, height : int
        Size of the picture, px.
    claimed : int
        Number of frames according to the container; 0 if the container does not state it.
    first_stamp_s : float
        Stamp of the first frame, which is t = 0; NaN for pictures.

    Raises
    ------
    InputError
        The file does not exist, or no frame of it can be decoded.
    """

    def __init__(self, path: str | Path, *, frame_rate_hz: float | None = None) -> None:
        self.path = Path(path)
        # decoding uses all cores, and threads for small pictures only cost time
        cv2.setNumThreads(1)
        self._rate = frame_rate_hz
        # the path names pictures if it is a folder, or a pattern such as %04d and no file
        if self.path.is_dir() or (not self.path.exists() and _HOLDER.search(self.path.name)):
            self.files = _listed(self.path)
            self.claimed = len(self.files)
            self._read = _pictures(self.path, self.files)
        else:
            self.files = [self.path]
            capture = _opened(self.path)
            count, self.claimed = capture.get(cv2.CAP_PROP_FRAME_COUNT), 0
            if 0 < count < 1e9:
                self.claimed = int(count)
            self._read = _decoded(capture)
        first = next(self._read, None)
        if first is None:
            hint = "check that a player plays it"
            raise InputError("no frame of this file can be decoded", file=self.path, frame=0, hint=hint)
        self._first = first
        self.first_stamp_s = first[1]
        self.height, self.width = first[2].shape[:2]

    def frames(self) -> Iterator[tuple[float, Frame]]:
        """Yield the time in s and the BGR picture of every frame. The next picture overwrites the array.

        Pictures without a frame rate have the time NaN.
        """
        count = 0
        for position, stamp, frame in itertools.chain([self._first], self._read):
            count += 1
            if self._rate:
                yield (position - self._first[0]) / self._rate, frame
            else:
                yield stamp - self.first_stamp_s, frame
        # some containers state one or two frames more than they contain
        if len(self.files) == 1 and count < self.claimed - max(2, 0.01 * self.claimed):
            text = f"{count} of {self.claimed} frames could be decoded"
            warn("SWM044", f"{self.path.name}: {text}; the video is damaged or cut after frame {count - 1}")


def reduced(frame: Frame, width: int) -> Frame:
    """Return a copy of a picture that is at most ``width`` px wide."""
    factor = max(frame.shape[1] / width, 1.0)
    if factor == 1:
        return frame.copy()
    small = cv2.resize(frame, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def largest_channel(picture: Frame) -> Frame:
    """Return the largest of the three channels of every pixel, shape (rows, columns)."""
    blue, green, red = cv2.split(picture)
    return np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)


def write_text(image: Frame, text: str, where: tuple[int, int], size: float, line: int = 1) -> None:
    """Write text with an outline into a picture, in place."""
    for shade, width in (((0, 0, 0), 3 * line), ((255, 255, 255), line)):
        cv2.putText(image, text, where, cv2.FONT_HERSHEY_SIMPLEX, size, shade, width, cv2.LINE_AA)


class FrameKeeper:
    """Store of up to ``most`` frames, spread evenly over a film of unknown length, at most ``width`` px wide.

    At first every ``every``-th frame is stored. If there are more than ``most``, every second one is removed.
    """

    def __init__(self, most: int, every: int = 1, width: int | None = None) -> None:
        self.kept: dict[int, Frame] = {}
        self._most, self._every, self._width = most, every, width

    def take(self, index: int, frame: Frame) -> None:
        """Store a copy of the next frame if its index is a multiple of the current interval."""
        if index % self._every:
            return
        self.kept[index] = reduced(frame, self._width or frame.shape[1])
        if len(self.kept) > self._most:
            self._every *= 2
            self.kept = {k: f for k, f in self.kept.items() if k % self._every == 0}


def check_output(path: Path, output: Path) -> None:
    """Raise if the output is in the folder of the pictures.

    A plot in this folder would become one of the pictures.
    """
    if path.is_dir() and output.resolve().parent == path.resolve():
        text = f"the output {output} would lie among the pictures of {path}"
        raise UsageError(text, hint="name another folder")


def _listed(path: Path) -> list[Path]:
    """Return the files of the pictures in the order of the numbers in their names."""
    folder, name, text = path, r"[^.].*", "is a folder without pictures"
    if not path.is_dir():
        folder, text = path.parent, "no picture has a name like this"
        name = r"\d+".join(map(re.escape, _HOLDER.split(path.name)))
    if not folder.is_dir():
        raise InputError("cannot be read: no such folder", file=path, hint="check the path")
    files = [f for f in folder.iterdir() if re.fullmatch(name, f.name) and f.suffix.lower() in ENDINGS]
    if not files:
        raise InputError(text, file=path, hint=f"a picture is one of {', '.join(ENDINGS)}")
    series = Counter(re.sub(r"\d+", "#", f.name) for f in files)
    if len(series) > 1:
        found = ", ".join(f"{count} like {name}" for name, count in series.most_common(4))
        hint = "name the one that is the film by a pattern, as in 'folder/frame_%05d.png'"
        raise InputError(f"holds several series of pictures: {found}", file=path, hint=hint)
    return sorted(files, key=lambda f: _numbers(f.name))


def _numbers(name: str) -> list[int]:
    return [int(digits) for digits in re.findall(r"\d+", name)]


def _positions(path: Path, files: list[Path]) -> list[int]:
    """Return the position of each picture in an even series, from the number in its name.

    If the names contain several numbers, the only one that changes is used.
    """
    table = np.array([_numbers(f.name) or [0] for f in files], dtype=object)
    counting = [k for k in range(table.shape[1]) if len(set(table[:, k])) > 1]
    order = list(range(len(files)))
    if len(counting) != 1:
        return order
    numbers = [int(n) for n in table[:, counting[0]]]
    steps = [b - a for a, b in itertools.pairwise(numbers)]
    usual = max(Counter(steps).most_common(1)[0][0], 1)
    if any(step < 1 or step % usual for step in steps):
        text = f"the numbers of the pictures step unevenly (by {min(steps)} to {max(steps)})"
        warn("SWM043", f"{path.name}: {text}; they are taken at even steps, in their order")
        return order
    missing = [f"after {files[k].name}" for k, step in enumerate(steps) if step != usual]
    if missing:
        count = sum(step // usual - 1 for step in steps)
        text = f"{count} pictures are missing by their numbers ({', '.join(missing[:3])})"
        warn("SWM044", f"{path.name}: {text}; their time is left out")
    return [(number - numbers[0]) // usual for number in numbers]
