"""Frames of a film, markers in one frame, and detections of all markers in all frames.

A :class:`Video` yields the frames of a film, or of a series of pictures, with their time stamps. A
:class:`ColourModel` is the range of colours of a marker, which follows slow changes of light.
:func:`measure_blob` returns a marker in a window of the picture as a :class:`Blob`. A :class:`RawTrack`
contains the detections of all markers in all frames. :func:`scene_shifts` measures the motion of the camera.
"""

from __future__ import annotations

import colorsys
import itertools
import math
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Silence FFmpeg, so that it prints no remarks on damaged frames between the messages of swimid.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")

import cv2

from swimid import reading
from swimid.errors import InputError
from swimid.notices import warn
from swimid.points.plane import MAX_SCALE_DIFFERENCE, Plane, plane_of
from swimid.tracking.setup import HsvRange, Setup

Array = NDArray[np.float64]
Frame = NDArray[np.uint8]

#: File name extensions of pictures that can be read.
PICTURE_EXTENSIONS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm")
#: Colour in which measured points are drawn into frames, BGR (Okabe and Ito, for colour-blind readers).
MEASURED = (0, 159, 230)
#: Minimum number of detections of a marker for statistics of its area and motion.
MIN_DETECTIONS = 10
#: Minimum range of motion of a marker that counts as moving, in radii of the marker. A motionless object that
#: is seen through ripples, or is covered at times, has a smaller range.
MIN_RADII = 1.0
#: Limits of the standard deviation of the distance between two markers on a rigid body, relative to the
#: distance. Above the first limit the check warns, and above the second it fails.
MAX_DISTANCE_SD = (0.02, 0.06)
#: Minimum fraction of the frames of a film in which a marker must be found whole, so that it can be tracked.
MIN_FOUND_SHARE = 0.05
#: Width to which frames are reduced before the motion of the camera is measured, px.
SCENE_WIDTH = 480
#: Maximum shift of the scene relative to the first frame for a camera at rest, px of a picture that is
#: reduced to SCENE_WIDTH.
MAX_SHIFT_PX = 2.0
#: Minimum difference between a moving pixel and the empty scene: MIN_DIFFERENCE in grey levels, and
#: MIN_DIFFERENCE_RATIO relative to the median difference in the frame. Both must be reached.
MIN_DIFFERENCE, MIN_DIFFERENCE_RATIO = 16.0, 4.0
#: Pattern of the placeholder for a whole number in a file name, as in the C function printf.
_HOLDER = re.compile(r"%0?\d*d")
#: Type of a frame that was read: position in the film, time stamp (s; NaN for pictures), and picture.
_Read = tuple[int, float, Frame]


def _pictures(path: Path, files: list[Path]) -> Iterator[_Read]:
    """Yield the pictures of a series in the order of the numbers in their names.

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
            text = f"has {here} pixels, but the pictures before have {before}"
            hint = "all pictures of a film have one size; name them by a pattern (%05d.png)"
            raise InputError(text, file=file, hint=hint)
        yield position, math.nan, np.asarray(frame, np.uint8)
    if bad:
        text = f"{len(bad)} of {len(files)} pictures could not be decoded ({', '.join(bad[:3])})"
        warn("SWM044", f"{path.name}: {text}; their times are gaps in the film")


def _open_film(path: Path) -> cv2.VideoCapture:
    """Open a film, and return its decoder."""
    if not path.is_file():
        raise InputError("cannot be read: no such file", file=path, hint="check the path")
    if path.stat().st_size == 0:
        raise InputError("is empty", file=path)
    reading.note(path)
    # Use one thread more than there are processor cores, so that decoding continues while a frame is
    # evaluated.
    threads = min(os.cpu_count() or 1, 16) + 1
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, threads])
    if not capture.isOpened():
        text = "is not a video that can be decoded, or its index is missing (a recording cut short)"
        hint = "check that a player plays it; 'ffmpeg -i in.mp4 -c copy out.mkv' may repair a cut recording"
        raise InputError(text, file=path, hint=hint)
    # Rotate the frames as the film's metadata say. Set this explicitly, because the default of OpenCV depends
    # on its version.
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1.0)
    return capture


def _pixel_aspect(capture: cv2.VideoCapture) -> float:
    """Return the width of a pixel relative to its height, after the rotation that the container states."""
    across, down = (capture.get(key) for key in (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN))
    if min(across, down) <= 0:
        return 1.0
    if capture.get(cv2.CAP_PROP_ORIENTATION_META) % 180:
        across, down = down, across
    return across / down


def _warn_of_densities(file: Path) -> None:
    """Warn if a picture states different numbers of pixels per length across and down.

    Programs contradict each other in the order of the two numbers: FFmpeg writes the ratio of width to height
    of a pixel, but the standards of PNG and JPEG mean the reciprocal ratio. Therefore the numbers are not
    used.
    """
    from PIL import Image

    with suppress(OSError, ValueError), Image.open(file) as picture:
        about = picture.info
        across, down = about.get("dpi") or about.get("aspect") or about.get("jfif_density") or (1, 1)
        if min(across, down) > 0 and abs(across / down - 1) > MAX_SCALE_DIFFERENCE:
            text = f"{file.name} states {across:.3g} : {down:.3g} for the pixels across and down: they may "
            text += "not be square. They are taken as square: give scale as four points_px with points_m"
            warn("SWM173", text)


def _decode_frames(capture: cv2.VideoCapture) -> Iterator[_Read]:
    """Yield the frames that a decoder returns. Each frame overwrites the previous one in memory."""
    picture: Frame | None = None
    for position in itertools.count():
        ok, frame = capture.read(picture)
        if not ok or frame is None:
            break
        picture = np.asarray(frame, np.uint8)
        yield position, capture.get(cv2.CAP_PROP_POS_MSEC) / 1000, picture
    capture.release()


class Video:
    """Film or series of pictures that is read once, from its first frame to its last.

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
    pixel_aspect : float
        Width of a pixel relative to its height, according to the container; 1 if it states none.
    claimed : int
        Number of frames according to the container; 0 if the container does not state it.
    stated_rate_hz : float
        Frame rate according to the container; 0 if it states none.
    first_stamp_s : float
        Stamp of the first frame, which is t = 0; NaN for pictures.

    Raises
    ------
    InputError
        The file does not exist, or no frame of it can be decoded.
    """

    def __init__(self, path: str | Path, *, frame_rate_hz: float | None = None) -> None:
        self.path = Path(path)
        # Let OpenCV evaluate a picture in a single thread. Decoding already uses all processor cores, and
        # threads make the evaluation of small pictures slower.
        cv2.setNumThreads(1)
        self._rate = frame_rate_hz
        self.stated_rate_hz, self.pixel_aspect = 0.0, 1.0
        # The path is a series of pictures if it is a folder, or if it is a pattern such as %04d and no such
        # file exists.
        if self.path.is_dir() or (not self.path.exists() and _HOLDER.search(self.path.name)):
            self.files = _list_pictures(self.path)
            reading.note(self.path, self.files)
            self.claimed = len(self.files)
            _warn_of_densities(self.files[0])
            self._read = _pictures(self.path, self.files)
        else:
            self.files = [self.path]
            capture = _open_film(self.path)
            self.stated_rate_hz, self.pixel_aspect = capture.get(cv2.CAP_PROP_FPS), _pixel_aspect(capture)
            count, self.claimed = capture.get(cv2.CAP_PROP_FRAME_COUNT), 0
            if 0 < count < 1e9:
                self.claimed = int(count)
            self._read = _decode_frames(capture)
        first = next(self._read, None)
        if first is None:
            hint = "check that a player plays it"
            raise InputError("no frame of this file can be decoded", file=self.path, frame=0, hint=hint)
        self._first = first
        self.first_stamp_s = first[1]
        self.height, self.width = first[2].shape[:2]

    def frames(self) -> Iterator[tuple[float, Frame]]:
        """Yield the time in s and the BGR picture of every frame of the film.

        The next picture overwrites the array. Pictures without a frame rate have the time NaN.
        """
        for position, stamp, frame in itertools.chain([self._first], self._read):
            if self._rate:
                yield (position - self._first[0]) / self._rate, frame
            else:
                yield stamp - self.first_stamp_s, frame
        # Warn only if clearly fewer frames were decoded than the container states. Some containers state one
        # or two frames more than they contain.
        count = position + 1
        if len(self.files) == 1 and count < self.claimed - max(2, 0.01 * self.claimed):
            text = f"{count} of {self.claimed} frames could be decoded"
            warn("SWM044", f"{self.path.name}: {text}; the video is damaged or cut after frame {count - 1}")

    def to_square_pixels(self, frame: Frame) -> Frame:
        """Return a frame of this film with square pixels: its width is multiplied by the aspect."""
        if self.pixel_aspect == 1:
            return frame
        return np.asarray(cv2.resize(frame, None, fx=self.pixel_aspect, fy=1.0), np.uint8)

    def plane(self, setup: Setup, file: str | None = None) -> Plane:
        """Return the map from the pixels of this film to the world; ``file`` names the setup in messages."""
        return plane_of(setup, self.width, self.height, pixel_aspect=self.pixel_aspect, file=file)


def reduce_frame(frame: Frame, width: int) -> Frame:
    """Return a copy of a picture, reduced to a width of at most ``width`` px."""
    factor = max(frame.shape[1] / width, 1.0)
    if factor == 1:
        return frame.copy()
    small = cv2.resize(frame, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def find_difference(frame: Frame, scene: Frame) -> tuple[Frame, float, NDArray[np.bool_]]:
    """Return the difference of a frame from the empty scene, its noise, and the flags of all moving pixels.

    The frame is smoothed by a filter of 3 x 3 pixels. ``scene`` must be smoothed by the same filter.
    """
    blue, green, red = cv2.split(cv2.absdiff(cv2.blur(frame, (3, 3)), scene))
    difference = np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)
    noise = float(np.median(difference))
    return difference, noise, difference > max(MIN_DIFFERENCE, MIN_DIFFERENCE_RATIO * noise)


def draw_text(image: Frame, text: str, where: tuple[int, int], size: float, line: int = 1) -> None:
    """Write a line of text with an outline into a picture, in place."""
    for shade, width in (((0, 0, 0), 3 * line), ((255, 255, 255), line)):
        cv2.putText(image, text, where, cv2.FONT_HERSHEY_SIMPLEX, size, shade, width, cv2.LINE_AA)


class FrameKeeper:
    """Store of up to ``most`` frames, spread evenly over a film of unknown length, and reduced in size.

    At first every ``every``-th frame is stored. If more than ``most`` frames are stored, every second one is
    removed, and the interval ``every`` is doubled. Frames wider than ``width`` px are reduced to this width.
    """

    def __init__(self, most: int, every: int = 1, width: int | None = None) -> None:
        self.kept: dict[int, Frame] = {}
        self._most, self._every, self._width = most, every, width

    def take(self, index: int, frame: Frame) -> None:
        """Store a copy of a frame if its index is a multiple of the current interval."""
        if index % self._every:
            return
        self.kept[index] = reduce_frame(frame, self._width or frame.shape[1])
        if len(self.kept) > self._most:
            self._every *= 2
            self.kept = {k: f for k, f in self.kept.items() if k % self._every == 0}


def _list_pictures(path: Path) -> list[Path]:
    """Return the files of a series of pictures in the order of the numbers in their names."""
    folder, name, text = path, r"[^.].*", "is a folder without pictures"
    if not path.is_dir():
        folder, text = path.parent, "no picture has a name like this"
        name = r"\d+".join(map(re.escape, _HOLDER.split(path.name)))
    if not folder.is_dir():
        raise InputError("cannot be read: no such folder", file=path, hint="check the path")
    files = [
        f for f in folder.iterdir() if re.fullmatch(name, f.name) and f.suffix.lower() in PICTURE_EXTENSIONS
    ]
    if not files:
        raise InputError(text, file=path, hint=f"a picture is one of {', '.join(PICTURE_EXTENSIONS)}")
    series = Counter(re.sub(r"\d+", "#", f.name) for f in files)
    if len(series) > 1:
        found = ", ".join(f"{count} like {name}" for name, count in series.most_common(4))
        hint = "name the series by a pattern, as in 'folder/frame_%05d.png'"
        raise InputError(f"holds several series of pictures: {found}", file=path, hint=hint)
    return sorted(files, key=lambda f: _numbers(f.name))


def _numbers(name: str) -> list[int]:
    return [int(digits) for digits in re.findall(r"\d+", name)]


def _positions(path: Path, files: list[Path]) -> list[int]:
    """Return the index of each picture in the complete series, missing pictures included, from its name.

    The index is the number in the name. If each name contains several numbers, the index is the number that
    changes. If several numbers change, the index is the position of the name in the sorted list.
    """
    columns = np.array([_numbers(f.name) for f in files], dtype=object).T
    counting = [list(column) for column in columns if len(set(column)) > 1]
    order = list(range(len(files)))
    if len(counting) != 1:
        return order
    numbers = counting[0]
    steps = [b - a for a, b in itertools.pairwise(numbers)]
    usual = max(Counter(steps).most_common(1)[0][0], 1)
    if any(step < 1 or step % usual for step in steps):
        text = f"the numbers of the pictures step unevenly (by {min(steps)} to {max(steps)})"
        warn("SWM043", f"{path.name}: {text}; the pictures are taken at even steps")
        return order
    missing = [f"after {files[k].name}" for k, step in enumerate(steps) if step != usual]
    if missing:
        count = sum(step // usual - 1 for step in steps)
        text = f"{count} pictures are missing by their numbers ({', '.join(missing[:3])})"
        warn("SWM044", f"{path.name}: {text}; their times are gaps in the film")
    return [(number - numbers[0]) // usual for number in numbers]


# ---------------------------------------------------------------- colours

#: Fraction by which a detection moves the colour model: the model moves by this fraction of the difference
#: between the mean colour of the detected marker and the model.
ADAPTATION = 0.12
#: Maximum drift of a marker's colour model from the colours of the setup: hue (OpenCV steps of 2 deg),
#: saturation and value (both on a scale from 0 to 255).
MAX_DRIFT = np.array([6.0, 40.0, 70.0])
#: Width by which the range of saturation and value is extended at both ends in a colour model (scale from 0
#: to 255). Pixels in the extended range belong to the marker if they touch pixels in the original range.
SLACK = 20.0
#: Minimum saturation of a marker pixel on a scale from 0 to 255. The extended colour range (:data:`SLACK`)
#: ends at this limit, because pixels of lower saturation are nearly grey and have no reliable hue.
MIN_SATURATION = 30.0
#: Half and whole period of the hue on the 8-bit scale of OpenCV.
_HALF, _TURN = 90.0, 180.0
#: Minimum chroma of a coloured pixel, in grey levels. Chroma is the largest minus the smallest channel.
MIN_CHROMA = 24
#: Common names of hues, and the upper limit of each hue in degrees. Red is at both ends of the scale.
_HUE_NAMES = ("red", "orange", "yellow", "green", "cyan", "blue", "violet", "magenta", "red")
_HUE_LIMITS = (15, 45, 70, 165, 200, 260, 290, 345, 361)
_TOUCH = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))

_Bounds = list[tuple[Frame, Frame]]


class ColourModel:
    """Colour range of a marker in hue, saturation and value, which follows exposure and white balance.

    Hue is stored as centre and half-width, because the range of red lies at both ends of the scale.

    Parameters
    ----------
    colours : HsvRange
        Colours of the marker in the setup.
    """

    _first: Array | None

    def __init__(self, colours: HsvRange) -> None:
        low, high = (h / 2 for h in colours.hue_deg)
        width = (high - low) % _TURN
        if colours.hue_deg == (0.0, 360.0):
            width = _TURN
        self._half_width = width / 2
        middle = (127.5 * sum(colours.saturation), 127.5 * sum(colours.value))
        self._centre = np.array([(low + width / 2) % _TURN, *middle])
        self._lower, self._upper = 255 * np.array([colours.saturation, colours.value]).T
        self._any = np.array([width >= _TURN, *((self._lower <= 0) & (self._upper >= 255))])
        self.restart()

    def mask(self, hsv: Frame) -> Frame:
        """Return a mask with 255 for the pixels of an HSV picture that belong to the marker, (rows, columns).

        The picture is on OpenCV's scale. Pixels slightly outside the colour range belong to the marker if
        they touch pixels inside the range (within ``_TOUCH``). Therefore a range that is slightly too narrow
        does not split the marker, and a background of a similar colour adds only a narrow rim.
        """
        strong = _mask_range(hsv, self._strong)
        near = cv2.dilate(strong, _TOUCH)
        return cv2.bitwise_or(strong, cv2.bitwise_and(near, _mask_range(hsv, self._weak)))

    def holds(self, hsv: Array) -> NDArray[np.bool_]:
        """Return for each of n HSV colours, shape (n, 3), whether it is in the extended colour range."""
        pixels = np.clip(np.round(hsv), 0, 255).astype(np.uint8).reshape(1, -1, 3)
        return np.asarray(_mask_range(pixels, self._weak)[0] > 0)

    def distance(self, hsv: Array) -> float:
        """Return the distance of an HSV colour from the middle of the colour range, in half-widths."""
        centre = self._centre + self.drift
        hue = abs(hue_difference(hsv[0], centre[0])) / max(self._half_width, 1.0)
        half = np.maximum((self._upper - self._lower) / 2, 1.0)
        return float(np.max([hue, *(np.abs(hsv[1:] - centre[1:]) / half)]))

    def adapt(self, hsv: Array) -> None:
        """Move the colour model towards the mean colour of a detection, by the fraction ``ADAPTATION``."""
        if self._first is None:
            self._first = hsv.copy()
        offset = colour_difference(hsv, self._first)
        # Do not adapt a channel that has no bounds. If the hue has no bounds, the marker may be grey, and the
        # measured hue of a grey pixel is noise.
        offset[self._any] = 0.0
        moved = self.drift + ADAPTATION * (offset - self.drift)
        self._move(np.clip(moved, -MAX_DRIFT, MAX_DRIFT))

    def forget(self) -> None:
        """Move the colour model one step back towards the colours of the setup, if the marker is lost."""
        if self.drift.any():
            self._move(self.drift * (1 - 0.2 * ADAPTATION))

    def restart(self) -> None:
        """Reset the model to the colours of the setup, if another object was taken for the marker."""
        self._first = None
        self._move(np.zeros(3))

    def _move(self, drift: Array) -> None:
        self.drift = drift
        self._strong = self._arcs(0.0, 0.0)
        self._weak = self._arcs(0.25 * self._half_width + 3.0, SLACK)

    def _arcs(self, hue_slack: float, slack: float) -> _Bounds:
        """Return bounds of the colour range for ``cv2.inRange``: one pair, or two if it contains hue 0.

        The range is extended by ``hue_slack`` at both ends of the hue, and by ``slack`` at both ends of
        saturation and value.
        """
        shift = np.round(self.drift)
        # Do not move a bound that is at the end of the scale, because such a bound does not limit the
        # colours.
        low = np.clip(np.where(self._lower <= 0, 0, self._lower + shift[1:] - slack), 0, 255)
        high = np.clip(np.where(self._upper >= 255, 255, self._upper + shift[1:] + slack), 0, 255)
        low[0] = max(low[0], min(self._lower[0], MIN_SATURATION))
        centre, half = self._centre[0] + shift[0], self._half_width + hue_slack
        first, last = (centre - half) % _TURN, (centre + half) % _TURN
        if half >= _HALF:
            first, last = 0.0, 179.0
        arcs = [(first, last)]
        if first > last:
            arcs = [(first, 179.0), (0.0, last)]
        ends = [([np.ceil(a), *np.floor(low)], [np.floor(b), *np.ceil(high)]) for a, b in arcs]
        return [(np.array(first, np.uint8), np.array(last, np.uint8)) for first, last in ends]


def _mask_range(hsv: Frame, bounds: _Bounds) -> Frame:
    found = cv2.inRange(hsv, *bounds[0])
    for low, high in bounds[1:]:
        cv2.bitwise_or(found, cv2.inRange(hsv, low, high), found)
    return found


def hue_difference(a: Any, b: Any) -> Any:
    """Return the difference a - b of two hues, modulo the period of 180 steps, in [-90, 90)."""
    return (a - b + _HALF) % _TURN - _HALF


def colour_difference(a: Array, b: Array) -> Array:
    """Return the difference a - b of two HSV colours, with the difference in hue modulo its period."""
    out = a - b
    out[0] = hue_difference(a[0], b[0])
    return out


def has_colour(hsv: Any, usual: Any, hue: float, saturation: float) -> Any:
    """Return whether colours, shape (3,) or (3, n), agree with a reference colour in hue and saturation.

    Colours are HSV on the scale of OpenCV. ``hue`` is the maximum difference in hue, and ``saturation`` the
    maximum difference in saturation relative to the reference. If the reference is nearly grey, its hue is
    noise and is not compared.
    """
    least = 255 * MIN_CHROMA / max(float(usual[2]), 1.0)
    saturated = np.abs(hsv[1] - usual[1]) <= max(saturation * usual[1], least)
    if usual[1] < least:
        return saturated
    return saturated & (np.abs(hue_difference(hsv[0], usual[0])) <= hue)


def mean_hsv(bgr: Array) -> Array:
    """Return one BGR colour (0 .. 255) as HSV, on the 8-bit scale of OpenCV but not rounded."""
    hue, saturation, value = colorsys.rgb_to_hsv(*(float(c) for c in bgr[::-1]))
    return np.array([_TURN * hue, 255 * saturation, value])


def chroma(frame: Frame) -> Frame:
    """Return the chroma of each pixel after smoothing: the largest minus the smallest colour channel."""
    blue, green, red = cv2.split(cv2.blur(frame, (3, 3)))
    return cv2.subtract(cv2.max(cv2.max(blue, green), red), cv2.min(cv2.min(blue, green), red))


def hue_name(hue_deg: float) -> str:
    """Return the common name of a hue, such as "orange"."""
    return next(name for name, limit in zip(_HUE_NAMES, _HUE_LIMITS, strict=True) if hue_deg % 360 < limit)


def describe_colours(frames: list[Frame]) -> str:
    """Return a sentence that lists the colours in some frames with their shares, for an error message."""
    shares: Counter[str] = Counter()
    for frame in frames:
        small = np.ascontiguousarray(frame[::2, ::2])
        colourful = chroma(small) >= MIN_CHROMA
        hue = cv2.cvtColor(small, cv2.COLOR_BGR2HSV)[..., 0][colourful].astype(float) * 2
        counts, _ = np.histogram(hue, [0, *_HUE_LIMITS])
        for name, count in zip(_HUE_NAMES, counts, strict=True):
            shares[name] += count / colourful.size / len(frames)
    listed = ", ".join(f"{name} {100 * share:.2g} %" for name, share in shares.most_common() if share >= 1e-4)
    if not listed:
        return "The video is grey: no pixel of it has a colour, so no colour marker can be seen"
    return f"Colours in the picture: {listed}"


#: Names of the status of a detection, in the order of their codes: marker not found, found in a window about
#: its predicted position, found in a larger window, found in a search of the whole picture.
STATUS_NAMES = ("lost", "window", "grown", "full")
LOST, WINDOW, GROWN, FULL = range(4)
#: Name of the status of a frame in which the edge of the picture cuts a marker.
CUT = "cut"
#: Width of the strip around a blob that is measured together with the blob, px. The strip contains the rim of
#: the blob and its background.
MARGIN = 8
#: Minimum contrast between a blob and its background: in grey levels, and as a multiple of the standard
#: deviation of the background. A standard deviation above MAX_SCATTER grey levels is replaced by MAX_SCATTER.
MIN_CONTRAST, MIN_CONTRAST_RATIO, MAX_SCATTER = 12.0, 1.2, 15.0
_KERNEL3 = np.ones((3, 3), np.uint8)
_KERNEL5 = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


@dataclass(eq=False, slots=True)
class Blob:
    """Patch of pixels with the colour of a marker, after it is measured. Lengths are in px of the picture."""

    #: Coordinates of the centre of the patch, with sub-pixel resolution.
    x: float
    y: float
    #: Area of the marker: sum of the weights of all pixels, px. Unlike the number of pixels in the mask, it
    #: does not change if motion or the codec blurs the rim.
    area: float
    #: Left, top, right and bottom side of the patch's bounding box, px. Right and bottom are exclusive.
    box: tuple[int, int, int, int]
    #: Difference between the mean colours of the patch and of its background, grey levels.
    contrast: float
    #: Confidence of the detection, from 0 to 1 (most confident).
    confidence: float
    #: Mean colour of the patch as HSV on the scale of OpenCV, shape (3,).
    hsv: Array
    #: Whether the patch touches the edge of the picture. The centre is then biased inwards.
    at_edge: bool
    #: Status of the detection, as an index into :data:`STATUS_NAMES`.
    status: int = FULL

    def distance_to(self, x: float, y: float) -> float:
        """Return the distance of the centre of the patch from a point, px."""
        return math.hypot(self.x - x, self.y - y)

    @property
    def radius(self) -> float:
        """Radius of the patch: half of the longer side of its bounding box, px."""
        return 0.5 * max(self.box[2] - self.box[0], self.box[3] - self.box[1])


@dataclass(eq=False, slots=True)
class Patch:
    """Connected patch of pixels in a colour mask, before it is measured."""

    #: Outline of the patch in pixels of the mask, shape (n, 1, 2).
    contour: NDArray[np.int32]
    #: Area of the patch in pixels of the picture.
    area: float
    #: Left, top, right and bottom side of the patch's bounding box in pixels of the mask. Right and bottom
    #: are exclusive.
    sides: tuple[int, int, int, int]
    #: Whether the border of the search window cuts the patch.
    clipped: bool

    def box(self, origin: tuple[int, int], step: int) -> tuple[int, int, int, int]:
        """Return the bounding box of the patch in px of the picture.

        The mask begins at ``origin`` in the picture, and its pixels are ``step`` px wide.
        """
        left, top, right, bottom = (step * side for side in self.sides)
        return origin[0] + left, origin[1] + top, origin[0] + right, origin[1] + bottom


def marker_mask(window: Frame, model: ColourModel) -> Frame:
    """Return a mask with 255 for the pixels of a marker in a window of the picture.

    The window is first smoothed against chroma noise.
    """
    return model.mask(cv2.cvtColor(cv2.blur(window, (3, 3)), cv2.COLOR_BGR2HSV))


def thin_window(window: Frame, step: int) -> Frame:
    """Return a window reduced to the middle pixel of every complete block of ``step`` x ``step`` pixels."""
    if step == 1:
        return window
    half = step // 2
    rows, columns = (window.shape[0] - half) // step, (window.shape[1] - half) // step
    blocks = window[half : half + step * rows, half : half + step * columns]
    return cv2.resize(blocks, (columns, rows), interpolation=cv2.INTER_NEAREST)


def find_patches(
    mask: Frame,
    area_px: tuple[float, float],
    *,
    step: int = 1,
    inside: tuple[bool, bool, bool, bool] = (False, False, False, False),
) -> list[Patch]:
    """Return the connected patches of a mask with an area in range, and all patches that the window cuts.

    Parameters
    ----------
    mask : ndarray of uint8, shape (rows, columns)
        Mask that is not 0 in pixels of the marker.
    area_px : (float, float)
        Minimum and maximum area in pixels of the picture.
    step : int
        Width of a pixel of the mask in pixels of the picture.
    inside : (bool, bool, bool, bool)
        Whether the left, top, right and bottom side of the window are inside the picture. A patch that
        touches such a side is ``clipped``.
    """
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    found = []
    for contour in contours:
        # Compute the number of pixels inside and on the outline, including holes, by Pick's theorem.
        outline = len(contour)
        area = step**2 * (cv2.contourArea(contour) + 0.5 * min(outline, 2) + 0.5 * outline)
        if area < 0.5 * area_px[0]:
            continue
        left, top, width, height = cv2.boundingRect(contour)
        sides = (left, top, left + width, top + height)
        touched = (left == 0, top == 0, sides[2] == mask.shape[1], sides[3] == mask.shape[0])
        clipped = any(touch and side for touch, side in zip(touched, inside, strict=True))
        if clipped or area_px[0] <= area <= area_px[1]:
            found.append(Patch(contour, area, sides, clipped))
    return found


def measure_blob(
    window: Frame, patch: Patch, step: int, origin: tuple[int, int], picture: tuple[int, int]
) -> Blob | None:
    """Measure a patch in the picture; return a :class:`Blob`, or None if its contrast is too low.

    Parameters
    ----------
    window : ndarray of uint8, shape (rows, columns, 3)
        Part of the picture at full resolution.
    patch : Patch
        Patch of a mask that contains every ``step``-th pixel of the window.
    step : int
        Width of a pixel of the mask in pixels of the picture.
    origin : (int, int)
        Upper left corner of the window in the picture, px.
    picture : (int, int)
        Width and height of the picture, px.
    """
    x0, y0, core, near, far = _regions(patch, step, window.shape[0], window.shape[1])
    part = window[y0 : y0 + core.shape[0], x0 : x0 + core.shape[1]]
    back, deviation = (values[:, 0] for values in cv2.meanStdDev(part, mask=cv2.bitwise_not(far)))
    colour = np.array(cv2.mean(part, core)[:3])
    axis = colour - back
    contrast = math.sqrt(axis @ axis)
    # Compute the standard deviation of the background colour along the line from the background colour to the
    # marker colour. The noise of the colour channels is taken to be independent.
    scatter = math.sqrt((deviation * axis) @ (deviation * axis)) / max(contrast, 1e-12)
    if contrast < max(MIN_CONTRAST, MIN_CONTRAST_RATIO * min(scatter, MAX_SCATTER)) or far.all():
        return None
    # Weight each pixel at the rim by the position p of its colour on the line from the mean background colour
    # (p = 0) to the mean colour of the core (p = 1). The weight rises from 0 at p = 0.25 to 1 at p = 0.75.
    scale = 2 * axis / contrast**2
    weight = cv2.transform(part.astype(np.float32), np.array([[*scale, -(scale @ back) - 0.5]]))
    weight = np.where(core > 0, 1.0, np.clip(weight, 0, 1) * (near > 0))
    m = cv2.moments(weight)
    column, row = m["m10"] / m["m00"], m["m01"] / m["m00"]
    left, top, right, bottom = box = patch.box(origin, step)
    # A coarse mask does not contain the incomplete blocks at the right and lower side of the picture.
    # Therefore a patch that ends less than 1.5 blocks before one of these sides counts as cut.
    at_edge = left <= 0 or top <= 0 or right > picture[0] - 1.5 * step or bottom > picture[1] - 1.5 * step
    confidence = min(contrast / (contrast + 2 * scatter + 6.0), 1.0)
    if at_edge:
        confidence *= 0.6
    x, y = origin[0] + x0 + column, origin[1] + y0 + row
    return Blob(x, y, m["m00"], box, contrast, confidence, mean_hsv(colour), at_edge)


def _regions(patch: Patch, step: int, rows: int, columns: int) -> tuple[int, int, Any, Any, Any]:
    """Return left and top side of a part of the window about a patch, px, and masks of this part.

    The masks have 255 for the pixels of the core, of the core with its rim, and of the surroundings of both.
    """
    left, top, right, bottom = patch.sides
    margin, rim = max(MARGIN // step, 4), (_KERNEL5, _KERNEL3)[step >= 3]
    x0, y0 = max(left - margin, 0), max(top - margin, 0)
    x1 = min(right + margin, (columns - step // 2) // step)
    y1 = min(bottom + margin, (rows - step // 2) // step)
    hull = np.zeros((y1 - y0, x1 - x0), np.uint8)
    cv2.fillConvexPoly(hull, cv2.convexHull(patch.contour) - np.array([x0, y0], np.int32), 255)
    # Give weight 1 to the core of the patch's convex hull, so that a reflection on the marker leaves no hole.
    kernel = (_KERNEL3, _KERNEL5)[min(right - left, bottom - top) >= 10]
    core = cv2.erode(hull, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=255)
    if not core.any():
        core = hull
    near = cv2.dilate(hull, rim)
    far = cv2.dilate(near, rim)
    if step > 1:
        size = (min(step * x1, columns) - step * x0, min(step * y1, rows) - step * y0)
        core, near, far = (cv2.resize(m, size, interpolation=cv2.INTER_NEAREST) for m in (core, near, far))
    return step * x0, step * y0, core, near, far


#: Type of the values of one detection: x, y, area, confidence, status, whether the edge of the picture cuts
#: the marker, and mean hue, saturation and value.
Row = tuple[float, ...]
NOT_SEEN: Row = (math.nan, math.nan, math.nan, 0.0, LOST, False, math.nan, math.nan, math.nan)


#: Names of the attributes of a track that have a row for each marker.
TRACKED = ("x", "y", "area", "confidence", "status", "at_edge")


@dataclass(frozen=True)
class RawTrack:
    """Detections of all markers in all frames, in px of the picture.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Times of the frames, s.
    names : list of str
        Names of the m markers.
    x, y, area, confidence : ndarray, shape (m, n)
        Centre, area and confidence of each detection; NaN (confidence 0) in frames without a detection. The y
        axis points down. If the edge of the picture cuts the marker, the centre is that of the visible part.
    status : ndarray of int, shape (m, n)
        Status of the detection, as an index into :data:`STATUS_NAMES`.
    at_edge : ndarray of bool, shape (m, n)
        Whether the edge of the picture cuts the marker.
    rivals : dict of str to int
        For each kind of marker, maximum number of other objects of its colour in one frame.
    mistaken : dict of str to (int, float)
        Number of detections of another object that was first taken for the marker, and its area in px.
    others : dict of str to str
        Sentence on other moving objects that look like the marker, for each kind of marker that has some.
    """

    times: Array
    names: list[str]
    x: Array
    y: Array
    area: Array
    confidence: Array
    status: NDArray[np.int64]
    at_edge: NDArray[np.bool_]
    rivals: dict[str, int] = field(default_factory=dict)
    mistaken: dict[str, tuple[int, float]] = field(default_factory=dict)
    others: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of_table(cls, times: Any, names: list[str], table: Array, *more: Any) -> RawTrack:
        """Return a track from the detections of all markers, shape (m, n, 9).

        The last axis has the values of :data:`Row`. ``more`` are the values of ``rivals``, ``mistaken`` and
        ``others``.
        """
        x, y, area, confidence, status, at_edge = table[..., :6].transpose(2, 0, 1)
        found = (status.astype(int), at_edge.astype(bool))
        return cls(np.array(times), names, x, y, area, confidence, *found, *more)

    def select(self, names: list[str]) -> RawTrack:
        """Return a copy of the track with only the markers ``names``, in this order."""
        rows = [self.row(name) for name in names]
        arrays = {key: getattr(self, key)[rows] for key in TRACKED}
        return replace(self, names=names, **arrays)

    @property
    def is_visible(self) -> NDArray[np.bool_]:
        """Flags of frames in which each marker was seen, whole or cut by the picture's edge, shape (m, n)."""
        return self.status > LOST

    @property
    def is_whole(self) -> NDArray[np.bool_]:
        """Flags of frames in which each marker was seen whole, so that its centre is known, shape (m, n)."""
        return self.is_visible & ~self.at_edge

    def row(self, name: str) -> int:
        """Return the row index of a marker in the arrays of the track."""
        return self.names.index(name)

    def centre(self, marker: int) -> tuple[Array, Array]:
        """Return the centre coordinates x and y of a marker, each of shape (n,), in px.

        They are NaN if the marker was not seen whole.
        """
        cut = self.at_edge[marker]
        return np.where(cut, np.nan, self.x[marker]), np.where(cut, np.nan, self.y[marker])

    def measure_range(self, name: str, scene: Array | None = None) -> tuple[float, float]:
        """Return the range of motion of a marker, in px and in radii of the marker.

        The two values are 0 if the marker is found in less than :data:`MIN_FOUND_SHARE` of the frames. The
        range is the 95th percentile of the distance from the median position, over detections of the whole
        marker. ``scene``, shape (2, n), is the shift of the whole scene in each frame, px.
        """
        i = self.row(name)
        seen = self.is_whole[i]
        if seen.mean() < MIN_FOUND_SHARE:
            return 0.0, 0.0
        area = self.area[i]
        usual = float(np.median(area[seen]))
        # Use only detections with the usual area. Other detections show only a part of the marker, and the
        # centre of the visible part moves if the covered part changes. With the limit of 15 % of the area,
        # the centre of a bar 20 times as long as wide moves by 0.6 radii if objects pass in front of the bar.
        whole = seen & (np.abs(area - usual) <= 0.15 * usual)
        part = whole if whole.sum() >= MIN_DETECTIONS else seen
        place = np.stack([self.x[i], self.y[i]])
        if scene is not None:
            place = place - scene
        away = np.hypot(*(place[:, part] - np.median(place[:, part], axis=1, keepdims=True)))
        reach = float(np.percentile(away, 95))
        return reach, reach / max(math.sqrt(usual / math.pi), 1.0)

    def head_first(self, head: str, tail: str) -> float | None:
        """Return the fraction of time steps in which two markers move in the direction from tail to head.

        The result is None for fewer than 4 time steps.
        """
        i, j = self.row(head), self.row(tail)
        # Divide the film into about 100 time steps.
        every = slice(None, None, max(len(self.times) // 100, 1))
        front, rear = (np.stack(self.centre(row))[:, every] for row in (i, j))
        line = front - rear
        length = np.hypot(*line)
        # Use only frames in which the distance between the two markers is within 30 % of its median. In other
        # frames one of the two detections is false: perspective of an inclined camera changes the distance by
        # less than 30 %.
        sound = np.abs(length / np.nanmedian(length) - 1) <= 0.3
        ahead = np.sum(np.diff(front + rear, axis=1) * line[:, :-1], axis=0)[sound[1:] & sound[:-1]]
        return float(np.mean(ahead > 0)) if len(ahead) >= 4 else None


# ---------------------------------------------------------------- motion of the camera


def scene_shifts(frames: Sequence[Frame]) -> Array:
    """Return the shift of the scene in each frame of a film relative to the first frame, px.

    Parameters
    ----------
    frames : sequence of n frames
        Frames of one size.

    Returns
    -------
    ndarray, shape (n, 2)
        Shift in px, x to the right and y down; NaN if most corners have no common shift (ripples, plain
        water, another scene).

    Notes
    -----
    Corners of the first frame are followed forwards and backwards by the pyramidal optical flow of Lucas and
    Kanade (Bouguet 2001). The shift is the median over the corners that return to their initial position.
    """
    out = np.full((len(frames), 2), np.nan)
    if not frames:
        return out
    factor = max(frames[0].shape[1] / SCENE_WIDTH, 1.0)
    small = [reduce_frame(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), SCENE_WIDTH) for frame in frames]
    # Find up to 300 corners in the first frame. At least 12 are needed.
    corners = cv2.goodFeaturesToTrack(small[0], 300, 0.02, 7)
    if corners is None or len(corners) < 12:
        return out
    for k, picture in enumerate(small):
        there, found, _ = cv2.calcOpticalFlowPyrLK(small[0], picture, corners, None)
        back, again, _ = cv2.calcOpticalFlowPyrLK(picture, small[0], there, None)
        sound = (found[:, 0] > 0) & (again[:, 0] > 0)
        # Use only corners that return to within half a pixel of their start when they are followed forwards
        # and backwards.
        sound &= np.linalg.norm((back - corners)[:, 0], axis=1) < 0.5
        if not sound.any():
            continue
        flow = (there - corners)[sound, 0]
        middle = np.median(flow, axis=0)
        # A corner belongs to the scene if its shift is within one pixel of the median shift of all corners.
        alike = np.linalg.norm(flow - middle, axis=1) < 1.0
        # The corners of the scene must be half of all corners, and must be in 8 of 4 x 4 cells of the
        # picture. If they are not, they may be the corners of a robot near the camera.
        cells = (corners[sound, 0][alike] * 4 / np.array(picture.shape[::-1])).astype(int)
        if alike.sum() >= 0.5 * len(corners) and len(np.unique(cells, axis=0)) >= 8:
            out[k] = factor * middle
    return out


def check_camera(shift: Array, width: int, consequence: str) -> tuple[float, float]:
    """Return the maximum shift of the scene and the allowed maximum, px. Warn if the shift exceeds it."""
    largest = float(np.nanmax(np.hypot(*shift.T), initial=0.0))
    limit = MAX_SHIFT_PX * max(width / SCENE_WIDTH, 1.0)
    if largest > limit:
        text = f"the whole scene shifts by {largest:.1f} px in the film: the camera moves"
        warn("SWM068", f"{text}{consequence}")
    return largest, limit
