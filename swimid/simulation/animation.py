"""A simulated run as a film: the links drawn to scale, the path they take, a scale bar and the time."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.files.video import REMARK, Frame, Mpeg4, open_writer
from swimid.progress import Progress, silent

Array = NDArray[np.float64]
#: Pictures a second.
RATE_HZ = 25.0
#: Longer side of the picture, pixels, by the file's ending.
SIZE = {".mp4": 960, ".gif": 560}
#: Largest width of the body over its length, and the least (a fin), with the share along it.
FULLNESS, THINNEST = 0.16, 0.012
#: Blue, green, red.
WATER, RIPPLE, INK, TRACE = (250, 246, 240), (238, 228, 214), (70, 55, 40), (190, 150, 60)
DRIVEN, PASSIVE = (150, 105, 45), (80, 130, 225)
#: Coordinates are drawn to 1 / 16 of a pixel.
_SHIFT = 4


@dataclass(frozen=True)
class Film:
    """What is shown.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    x_m, y_m, heading_rad : ndarray, shape (links, n)
        Front end and heading of every link; y points up in the picture.
    lengths_m, begins_m : ndarray, shape (links,)
        Length of every link, and distance of its front end from the robot's, all joints straight.
    passive : collection of int
        The links on passive joints.
    length_m, width_m : float
        Of the robot.
    title : str
    tapered : bool
        The links make up a body as fish have; else each is a bar.
    """

    time_s: Array
    x_m: Array
    y_m: Array
    heading_rad: Array
    lengths_m: Array
    begins_m: Array
    passive: Collection[int]
    length_m: float
    width_m: float
    title: str
    tapered: bool


def half_width(share: Array, width: float, length: float) -> Array:
    """Half the width of the body along it, 0 at the nose to 1 at the tail: full in front, thin behind.

    Parameters
    ----------
    share : ndarray, shape (n,)
    width, length : float, m
    """
    s = np.clip(share, 0.0, 1.0)
    # the thickness of a NACA four-digit section, open at its end, scaled to a maximum of one half
    thickness = 0.2969 * np.sqrt(s) - 0.126 * s - 0.3516 * s**2 + 0.2843 * s**3 - 0.1015 * s**4
    return np.maximum(width * thickness / 0.10 * 0.5, 0.5 * THINNEST * length)


def outline(film: Film, link: int) -> Array:
    """A link's outline in its own axes, x forward from its front end; shape (points, 2), m."""
    along = np.linspace(0.0, film.lengths_m[link], 24)
    if film.tapered:
        half = half_width((film.begins_m[link] + along) / film.length_m, film.width_m, film.length_m)
    else:
        half = np.full(len(along), 0.03 * film.length_m)
    port = np.column_stack((-along, half))
    # a round front closes the gap that a bent joint opens
    round_front = film.begins_m[link] > 0 or not film.tapered
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 12)[1:-1] if round_front else np.empty(0)
    cap = half[0] * np.column_stack((np.cos(turn), np.sin(turn)))
    return np.concatenate((cap, port, port[::-1] * (1.0, -1.0)))


def write(path: Path, film: Film, *, view: str = "auto", progress: Progress = silent) -> str:
    """Write a film or an animated GIF, whole or not at all.

    Parameters
    ----------
    path : Path
        With an ending of :data:`SIZE`.
    view : {"auto", "fixed", "follow"}
        Whether the picture holds the whole path or moves with the robot.

    Returns
    -------
    str
        A remark for the user, empty when there is none.
    """
    camera = _Camera.over(film, view, SIZE[path.suffix.lower()])
    shown = np.arange(film.time_s[0], film.time_s[-1] + 1e-9, 1.0 / RATE_HZ)
    with atomic.replacing(path) as temporary, progress("animation", total=len(shown)) as step:
        writer = open_writer(temporary, RATE_HZ, camera.width, camera.height)
        try:
            for time in shown:
                writer.write(float(time - shown[0]), picture(film, camera, float(time)))
                step()
        finally:
            writer.close()
    return REMARK.format("animation") if isinstance(writer, Mpeg4) else ""


def picture(film: Film, camera: _Camera, time_s: float) -> Frame:
    """One frame."""
    x, y, heading = (
        np.array([np.interp(time_s, film.time_s, row) for row in rows])
        for rows in (film.x_m, film.y_m, film.heading_rad)
    )
    if camera.follows:
        camera = camera.centred(float(np.mean(x)), float(np.mean(y)))
    frame = np.full((camera.height, camera.width, 3), WATER, dtype=np.uint8)
    _grid(frame, camera)
    past = film.time_s <= time_s
    points = np.column_stack((np.append(film.x_m[0][past], x[0]), np.append(film.y_m[0][past], y[0])))
    cv2.polylines(frame, [camera.pixels(points)], False, TRACE, 2, cv2.LINE_AA, _SHIFT)
    # from the tail forward, so that each link overlaps the one behind it
    for link in reversed(range(len(film.lengths_m))):
        c, s = math.cos(heading[link]), math.sin(heading[link])
        shape = outline(film, link) @ np.array([[c, s], [-s, c]]) + (x[link], y[link])
        pixels = camera.pixels(shape)
        cv2.fillPoly(frame, [pixels], PASSIVE if link in film.passive else DRIVEN, cv2.LINE_AA, _SHIFT)
        cv2.polylines(frame, [pixels], True, INK, 1, cv2.LINE_AA, _SHIFT)
    _scale_bar(frame, camera, film.length_m)
    _text(frame, f"{time_s:6.2f} s", (12, 26))
    _text(frame, film.title, (12, camera.height - 14))
    return frame


@dataclass(frozen=True)
class _Camera:
    """From metres to pixels."""

    scale: float
    width: int
    height: int
    follows: bool
    left: float = 0.0
    bottom: float = 0.0

    @classmethod
    def over(cls, film: Film, view: str, size: int) -> _Camera:
        ends = [
            np.concatenate((rows, rows - film.lengths_m[:, None] * turn(film.heading_rad)))
            for rows, turn in ((film.x_m, np.cos), (film.y_m, np.sin))
        ]
        path = [float(np.ptp(rows[0])) for rows in (film.x_m, film.y_m)]
        # a path longer than twelve robots makes a fixed picture useless: the view then follows
        follows = view == "follow" or (view == "auto" and max(path) > 12.0 * film.length_m)
        # with some water around
        spans = [float(np.ptp(rows)) + 0.4 * film.length_m for rows in ends]
        if follows:
            spans = [3.2 * film.length_m, 1.9 * film.length_m]
        scale = size / max(spans)
        # neither a strip nor odd numbers, which encoders refuse
        width, height = (2 * math.ceil(max(span * scale, 0.4 * size) / 2) for span in spans)
        middle = [0.5 * float(rows.min() + rows.max()) for rows in ends]
        return cls(scale, width, height, follows).centred(*middle)

    def centred(self, x: float, y: float) -> _Camera:
        """The same, looking at a point."""
        left, bottom = x - 0.5 * self.width / self.scale, y - 0.5 * self.height / self.scale
        return replace(self, left=left, bottom=bottom)

    def pixels(self, points: Array) -> NDArray[np.int32]:
        x = (points[:, 0] - self.left) * self.scale
        y = self.height - (points[:, 1] - self.bottom) * self.scale
        pixels: NDArray[np.int32] = np.round(np.column_stack((x, y)) * 2**_SHIFT).astype(np.int32)
        return pixels


def round_length(wanted: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not longer.

    >>> round_length(0.37)
    0.2
    """
    power = 10.0 ** math.floor(math.log10(wanted))
    return float(next(k * power for k in (5, 2, 1) if k * power <= wanted * (1 + 1e-9)))


def _grid(frame: Frame, camera: _Camera) -> None:
    """Lines in the water, by which a moving picture shows that it moves."""
    pitch = round_length(0.25 * camera.width / camera.scale)
    for first, span, upright in ((camera.left, camera.width, True), (camera.bottom, camera.height, False)):
        k = math.ceil(first / pitch)
        while k * pitch < first + span / camera.scale:
            at = (k * pitch - first) * camera.scale
            place = round(at if upright else camera.height - at)
            ends = ((place, 0), (place, camera.height)) if upright else ((0, place), (camera.width, place))
            cv2.line(frame, *ends, RIPPLE, 1)
            k += 1


def _scale_bar(frame: Frame, camera: _Camera, length: float) -> None:
    bar = round_length(min(0.3 * camera.width / camera.scale, max(length, 0.1 * camera.width / camera.scale)))
    right, base = camera.width - 16, camera.height - 18
    left = right - round(bar * camera.scale)
    cv2.line(frame, (left, base), (right, base), INK, 3)
    text = f"{bar:g} m" if bar >= 0.1 else f"{100 * bar:g} cm"
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.55, 1)
    _text(frame, text, ((left + right - width) // 2, base - 9))


def _text(frame: Frame, text: str, place: tuple[int, int]) -> None:
    # the drawing font has no characters beyond ASCII
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(frame, plain, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, INK, 1, cv2.LINE_AA)
