"""A simulated run as a film: the links drawn to scale, the path they take, a scale bar and the time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import UsageError
from swimid.files import atomic
from swimid.files.video import REMARK, Frame, Mpeg4, open_writer
from swimid.progress import Progress, silent

Array = NDArray[np.float64]
ENDINGS = (".mp4", ".gif")
#: Pictures a second.
RATE_HZ = 25.0
#: Longer side of the picture, pixels: film and GIF.
SIZE = {".mp4": 960, ".gif": 560}
#: A path longer than so many robots makes a fixed picture useless: the view then follows.
LONGEST = 12.0
#: Largest width of the body over its length, and the least (a fin), with the share along it.
FULLNESS, THINNEST = 0.16, 0.012
#: Width of a bar over the robot's length.
BAR = 0.06
#: Water around what a fixed picture shows, robot lengths.
MARGIN = 0.4
#: Blue, green, red.
WATER, RIPPLE, INK, TRACE = (250, 246, 240), (238, 228, 214), (70, 55, 40), (190, 150, 60)
DRIVEN, PASSIVE = (150, 105, 45), (80, 130, 225)
#: Coordinates are drawn to 1 / 16 of a pixel.
_SHIFT = 4


@dataclass(frozen=True)
class Link:
    """How one link is drawn.

    Attributes
    ----------
    length_m : float
    begin_m : float
        Distance of its front end from the robot's, all joints straight.
    passive : bool
        It hangs on a passive joint.
    """

    length_m: float
    begin_m: float
    passive: bool


@dataclass(frozen=True)
class Film:
    """What is shown.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    x_m, y_m, heading_rad : ndarray, shape (links, n)
        Front end and heading of every link; y points up in the picture.
    links : sequence of Link
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
    links: Sequence[Link]
    length_m: float
    width_m: float
    title: str
    tapered: bool = True


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


def outline(link: Link, film: Film) -> Array:
    """A link's outline in its own axes, x forward from its front end; shape (points, 2), m."""
    along = np.linspace(0.0, link.length_m, 24)
    if film.tapered:
        half = half_width((link.begin_m + along) / film.length_m, film.width_m, film.length_m)
    else:
        half = np.full(len(along), 0.5 * BAR * film.length_m)
    port = np.column_stack((-along, half))
    # a round front closes the gap that a bent joint opens
    round_front = link.begin_m > 0 or not film.tapered
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 12)[1:-1] if round_front else np.empty(0)
    cap = half[0] * np.column_stack((np.cos(turn), np.sin(turn)))
    return np.concatenate((cap, port, port[::-1] * (1.0, -1.0)))


def write(path: Path, film: Film, *, view: str = "auto", progress: Progress = silent) -> str:
    """Write a film or an animated GIF, whole or not at all.

    Parameters
    ----------
    path : Path
        Ending in .mp4 or .gif.
    view : {"auto", "fixed", "follow"}
        Whether the picture holds the whole path or moves with the robot.

    Returns
    -------
    str
        A remark for the user, empty when there is none.

    Raises
    ------
    UsageError
        For another ending.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise UsageError(f"'{path.name}' can be no animation", hint=f"let it end in {' or '.join(ENDINGS)}")
    camera = _Camera.over(film, view, SIZE[ending])
    shown = np.arange(film.time_s[0], film.time_s[-1] + 1e-9, 1.0 / RATE_HZ)
    remark = ""
    with atomic.replacing(path) as temporary, progress("animation", total=len(shown)) as step:
        writer = open_writer(temporary, RATE_HZ, camera.width, camera.height)
        if isinstance(writer, Mpeg4):
            remark = REMARK.format("animation")
        try:
            for time in shown:
                writer.write(float(time - shown[0]), picture(film, camera, float(time)))
                step()
        finally:
            writer.close()
    return remark


def picture(film: Film, camera: _Camera, time_s: float) -> Frame:
    """One frame."""
    x, y, heading = (_at(film.time_s, rows, time_s) for rows in (film.x_m, film.y_m, film.heading_rad))
    camera = camera.looking_at(float(np.mean(x)), float(np.mean(y)))
    frame = np.full((camera.height, camera.width, 3), WATER, dtype=np.uint8)
    _grid(frame, camera)
    past = film.time_s <= time_s
    points = np.column_stack((np.append(film.x_m[0][past], x[0]), np.append(film.y_m[0][past], y[0])))
    cv2.polylines(frame, [camera.pixels(points)], False, TRACE, 2, cv2.LINE_AA, _SHIFT)
    # from the tail forward, so that each link overlaps the one behind it
    for i in reversed(range(len(film.links))):
        link = film.links[i]
        c, s = math.cos(heading[i]), math.sin(heading[i])
        shape = outline(link, film) @ np.array([[c, s], [-s, c]]) + (x[i], y[i])
        pixels = camera.pixels(shape)
        cv2.fillPoly(frame, [pixels], PASSIVE if link.passive else DRIVEN, cv2.LINE_AA, _SHIFT)
        cv2.polylines(frame, [pixels], True, INK, 1, cv2.LINE_AA, _SHIFT)
    _scale_bar(frame, camera, film.length_m)
    _text(frame, f"{time_s:6.2f} s", (12, 26))
    _text(frame, film.title, (12, camera.height - 14))
    return frame


def _at(time: Array, rows: Array, moment: float) -> Array:
    return np.array([np.interp(moment, time, row) for row in rows])


@dataclass(frozen=True)
class _Camera:
    """From metres to pixels."""

    left: float
    bottom: float
    scale: float
    width: int
    height: int
    follows: bool

    @classmethod
    def over(cls, film: Film, view: str, size: int) -> _Camera:
        lengths = np.array([[link.length_m] for link in film.links])
        ends = [
            np.concatenate((rows, rows - lengths * turn(film.heading_rad)))
            for rows, turn in ((film.x_m, np.cos), (film.y_m, np.sin))
        ]
        path = [float(np.ptp(rows[0])) for rows in (film.x_m, film.y_m)]
        follows = view == "follow" or (view == "auto" and max(path) > LONGEST * film.length_m)
        if follows:
            spans = (3.2 * film.length_m, 1.9 * film.length_m)
        else:
            spans = tuple(float(np.ptp(rows)) + MARGIN * film.length_m for rows in ends)  # type: ignore[assignment]
        scale = size / max(spans)
        # neither a strip nor odd numbers, which encoders refuse
        sides = [2 * math.ceil(max(span * scale, 0.4 * size) / 2) for span in spans]
        middle = [0.5 * float(rows.min() + rows.max()) for rows in ends]
        return cls(
            middle[0] - 0.5 * sides[0] / scale,
            middle[1] - 0.5 * sides[1] / scale,
            scale,
            sides[0],
            sides[1],
            follows,
        )

    def looking_at(self, x: float, y: float) -> _Camera:
        if not self.follows:
            return self
        return _Camera(
            x - 0.5 * self.width / self.scale,
            y - 0.5 * self.height / self.scale,
            self.scale,
            self.width,
            self.height,
            True,
        )

    def pixels(self, points: Array) -> NDArray[np.int32]:
        x = (points[:, 0] - self.left) * self.scale
        y = self.height - (points[:, 1] - self.bottom) * self.scale
        found: NDArray[np.int32] = np.round(np.column_stack((x, y)) * 2**_SHIFT).astype(np.int32)
        return found


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
