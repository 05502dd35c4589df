"""Film of a simulated run, with the links to scale, the path of the robot, a scale bar and the time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.files.video import REMARK, Frame, Mpeg4, open_writer
from swimid.progress import Progress, silent
from swimid.swimmer.planar.model import Body

Array = NDArray[np.float64]
#: Frame rate of the film, Hz.
RATE_HZ = 25.0
#: Length of the longer side of a frame for each file ending, px.
SIZE_PX = {".mp4": 960, ".gif": 560}
#: Maximum width of a body whose width is not stated, and minimum width of any body (a thin fin), in body
#: lengths.
MAX_WIDTH, MIN_WIDTH = 0.16, 0.012
#: Width of the links of a robot with a fixed base, in body lengths.
BAR_WIDTH = 0.06
#: Maximum extent of a path in a fixed view, in body lengths. For a longer path, the view follows the robot.
MAX_FIXED_PATH = 12.0
#: Size of a view that follows the robot (width, height), and margin of a fixed view, in body lengths.
FOLLOWING_VIEW, MARGIN = (3.2, 1.9), 0.4
#: Colours, each as blue, green and red.
WATER, GRID, INK, PATH = (250, 246, 240), (238, 228, 214), (70, 55, 40), (190, 150, 60)
DRIVEN, PASSIVE = (150, 105, 45), (80, 130, 225)
#: Number of fractional bits of the pixel coordinates that OpenCV draws.
SHIFT = 4


@dataclass(frozen=True)
class Film:
    """Motion of a robot for a film.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    body : Body
        Links of the robot.
    frames : (ndarray, ndarray, ndarray), shape (links, n) each
        Front end (x, y), m, and heading, rad, of every link. The y axis points up in the film.
    begins_m : ndarray, shape (links,)
        Distance from the front end of the robot to the front end of every link, with all joints straight.
    length_m, width_m : float
        Length and maximum width of the robot.
    title : str
    """

    time_s: Array
    body: Body
    frames: tuple[Array, Array, Array]
    begins_m: Array
    length_m: float
    width_m: float
    title: str

    @property
    def lengths_m(self) -> Array:
        """Length of every link, m, shape (links,)."""
        return np.array(self.body.lengths_m)

    def outline(self, link: int) -> Array:
        """Return the outline of a link, m, shape (points, 2); x points forward from its front end."""
        along = np.linspace(0.0, self.lengths_m[link], 24)
        half = np.full(len(along), 0.5 * BAR_WIDTH * self.length_m)
        if self.body.free:
            s = np.clip((self.begins_m[link] + along) / self.length_m, 0.0, 1.0)
            # thickness function of a NACA four-digit section; its maximum is 0.1
            thickness = 0.2969 * np.sqrt(s) - 0.126 * s - 0.3516 * s**2 + 0.2843 * s**3 - 0.1015 * s**4
            half = np.maximum(self.width_m * thickness / 0.20, 0.5 * MIN_WIDTH * self.length_m)
        side = np.column_stack((-along, half))
        turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 12)[1:-1]
        if self.body.free and self.begins_m[link] == 0:
            turn = np.empty(0)
        # a round front end closes the gap at a bent joint
        front = half[0] * np.column_stack((np.cos(turn), np.sin(turn)))
        return np.concatenate((front, side, side[::-1] * (1.0, -1.0)))


@dataclass(frozen=True)
class View:
    """Part of the plane of motion that a frame of the film shows.

    Attributes
    ----------
    scale : float
        Pixels per metre.
    size_px : (int, int)
        Width and height of a frame, px.
    centre_m : ndarray, shape (2,), or None
        Centre of the view; None for a view that follows the robot.
    """

    scale: float
    size_px: tuple[int, int]
    centre_m: Array | None

    @classmethod
    def of(cls, film: Film, view: str, size_px: int) -> View:
        """Return the view of a film for the option ``auto``, ``fixed`` or ``follow``."""
        ends = np.array([film.frames[:2], film.body.rear_ends(film.frames)])
        low, high = np.min(ends, axis=(0, 2, 3)), np.max(ends, axis=(0, 2, 3))
        path = max(float(np.ptp(rows[0])) for rows in film.frames[:2])
        follows = view == "follow" or (view == "auto" and path > MAX_FIXED_PATH * film.length_m)
        spans, centre = high - low + MARGIN * film.length_m, 0.5 * (low + high)
        if follows:
            spans, centre = np.array(FOLLOWING_VIEW) * film.length_m, None
        scale = size_px / float(spans.max())
        # avoid very flat frames, and odd sizes, which encoders refuse
        width, height = (2 * math.ceil(max(span * scale, 0.4 * size_px) / 2) for span in spans)
        return cls(scale, (width, height), centre)


def write(path: Path, film: Film, *, view: str = "auto", progress: Progress = silent) -> str:
    """Write a film or an animated GIF, complete or not at all.

    Parameters
    ----------
    path : Path
        Film to write; its ending is a key of :data:`SIZE_PX`.
    view : {"auto", "fixed", "follow"}
        Whether the view holds the whole path or follows the robot; ``auto`` decides by the extent of the
        path.

    Returns
    -------
    str
        Remark for the user; empty if there is none.
    """
    seen = View.of(film, view, SIZE_PX[path.suffix.lower()])
    times = np.arange(film.time_s[0], film.time_s[-1] + 1e-9, 1.0 / RATE_HZ)
    with atomic.replacing(path) as temporary, progress("animation", total=len(times)) as step:
        writer = open_writer(temporary, RATE_HZ, *seen.size_px)
        try:
            for time in times:
                writer.write(float(time - times[0]), _frame(film, seen, float(time)))
                step()
        finally:
            writer.close()
    return REMARK.format("animation") if isinstance(writer, Mpeg4) else ""


def _frame(film: Film, view: View, time_s: float) -> Frame:
    x, y, heading = (np.array([np.interp(time_s, film.time_s, row) for row in rows]) for rows in film.frames)
    width, height = view.size_px
    centre = np.array([x.mean(), y.mean()]) if view.centre_m is None else view.centre_m
    corner = centre - 0.5 * np.array(view.size_px) / view.scale

    def pixels(points: Array) -> NDArray[np.int32]:
        place = (points - corner) * view.scale
        place[:, 1] = height - place[:, 1]
        return np.round(place * 2**SHIFT).astype(np.int32)

    frame = np.full((height, width, 3), WATER, dtype=np.uint8)
    # the grid makes the motion visible in a view that follows the robot
    pitch = round_length(0.25 * width / view.scale)
    for at in np.arange(math.ceil(corner[0] / pitch) * pitch, corner[0] + width / view.scale, pitch):
        column = round((at - corner[0]) * view.scale)
        cv2.line(frame, (column, 0), (column, height), GRID, 1)
    for at in np.arange(math.ceil(corner[1] / pitch) * pitch, corner[1] + height / view.scale, pitch):
        row = round(height - (at - corner[1]) * view.scale)
        cv2.line(frame, (0, row), (width, row), GRID, 1)
    past = film.time_s <= time_s
    points = np.column_stack(
        [np.append(rows[0][past], at[0]) for rows, at in zip(film.frames, (x, y), strict=False)]
    )
    cv2.polylines(frame, [pixels(points)], False, PATH, 2, cv2.LINE_AA, SHIFT)
    passive = {axis.link for axis in film.body.passive}
    # draw from the tail forward, so that each link overlaps the link behind it
    for link in reversed(range(len(film.lengths_m))):
        c, s = math.cos(heading[link]), math.sin(heading[link])
        shape = pixels(film.outline(link) @ np.array([[c, s], [-s, c]]) + (x[link], y[link]))
        colour = PASSIVE if link in passive else DRIVEN
        cv2.fillPoly(frame, [shape], colour, cv2.LINE_AA, SHIFT)
        cv2.polylines(frame, [shape], True, INK, 1, cv2.LINE_AA, SHIFT)
    _scale_bar(frame, view.scale, film.length_m)
    _text(frame, f"{time_s:6.2f} s", (12, 26))
    _text(frame, film.title, (12, height - 14))
    return frame


def round_length(most: float) -> float:
    """Return the largest length not above ``most`` that is 1, 2 or 5 times a power of ten.

    >>> round_length(0.37)
    0.2
    """
    power = 10.0 ** math.floor(math.log10(most))
    return float(max(k * power for k in (1, 2, 5) if k * power <= most * (1 + 1e-9)))


def _scale_bar(frame: Frame, scale: float, length_m: float) -> None:
    height, width = frame.shape[:2]
    bar = round_length(min(0.3 * width / scale, max(length_m, 0.1 * width / scale)))
    right, base = width - 16, height - 18
    left = right - round(bar * scale)
    cv2.line(frame, (left, base), (right, base), INK, 3)
    text = f"{bar:g} m" if bar >= 0.1 else f"{100 * bar:g} cm"
    (text_width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.55, 1)
    _text(frame, text, ((left + right - text_width) // 2, base - 9))


def _text(frame: Frame, text: str, place: tuple[int, int]) -> None:
    # the OpenCV font has ASCII characters only
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(frame, plain, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, INK, 1, cv2.LINE_AA)
