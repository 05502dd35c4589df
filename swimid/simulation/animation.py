"""Film of a simulated run, with the links to scale, the path of the robot, a grid and the time."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.files.video import REMARK, Frame, Mpeg4, open_writer
from swimid.notices import Progress, silent
from swimid.swimmer.planar.model import Body

Array = NDArray[np.float64]
#: Frame rate of the film, Hz.
RATE_HZ = 25.0
#: Length of the longer side of a frame for each file ending, px.
SIZE_PX = {".mp4": 960, ".gif": 560}
#: Width of a link, in body lengths.
WIDTH = 0.08
#: Maximum extent of a path in a fixed view, in body lengths. For a longer path, the view follows the robot.
MAX_FIXED_PATH = 12.0
#: Size of a view that follows the robot (width, height), and margin of a fixed view, in body lengths.
FOLLOWING_VIEW, MARGIN = (3.2, 1.9), 0.4
#: Colours, each as blue, green and red.
WATER, GRID, INK, PATH = (250, 246, 240), (238, 228, 214), (70, 55, 40), (190, 150, 60)
DRIVEN, PASSIVE = (150, 105, 45), (80, 130, 225)
#: Number of fractional bits of the pixel coordinates that OpenCV draws.
SHIFT = 4


def write(
    path: Path, time_s: Array, ends_m: Array, body: Body, title: str, *, progress: Progress = silent
) -> str:
    """Write a film or an animated GIF, complete or not at all.

    The view holds the whole path. If the path is long, the view follows the robot.

    Parameters
    ----------
    path : Path
        Film to write; its ending is a key of :data:`SIZE_PX`.
    time_s : ndarray, shape (n,)
    ends_m : ndarray, shape (2, 2, links, n)
        Front end and rear end of every link, each with x and y. The y axis points up in the film.
    title : str
        Text at the bottom of every frame.

    Returns
    -------
    str
        Remark for the user; empty if there is none.
    """
    length, longer_px = sum(body.lengths_m), SIZE_PX[path.suffix.lower()]
    low, high = ends_m.min(axis=(0, 2, 3)), ends_m.max(axis=(0, 2, 3))
    spans, centre = high - low + MARGIN * length, 0.5 * (low + high)
    follows = max(np.ptp(ends_m[0, :, 0], axis=-1)) > MAX_FIXED_PATH * length
    if follows:
        spans = np.array(FOLLOWING_VIEW) * length
    scale = longer_px / float(spans.max())
    # avoid very flat frames, and odd sizes, which encoders refuse
    width, height = (2 * math.ceil(max(span * scale, 0.4 * longer_px) / 2) for span in spans)
    pitch = round_length(0.25 * width / scale)
    thickness = max(round(WIDTH * length * scale), 3)
    passive = {axis.link for axis in body.passive}
    colours = [PASSIVE if link in passive else DRIVEN for link in range(len(body.lengths_m))]

    def draw(now_s: float) -> Frame:
        place = np.array([np.interp(now_s, time_s, row) for row in ends_m.reshape(-1, len(time_s))])
        place = place.reshape(ends_m.shape[:3])
        corner = centre - 0.5 * np.array([width, height]) / scale
        if follows:
            corner += place.mean(axis=(0, 2)) - centre

        def pixels(points: Array) -> NDArray[np.int32]:
            x, y = (points.T - corner[:, None]) * scale
            return np.round(np.column_stack([x, height - y]) * 2**SHIFT).astype(np.int32)

        frame = np.full((height, width, 3), WATER, dtype=np.uint8)
        # the grid makes the motion visible in a view that follows the robot
        for at in np.arange(-corner[0] % pitch, width / scale, pitch) * scale:
            cv2.line(frame, (round(at), 0), (round(at), height), GRID, 1)
        for at in height - np.arange(-corner[1] % pitch, height / scale, pitch) * scale:
            cv2.line(frame, (0, round(at)), (width, round(at)), GRID, 1)
        travelled = np.vstack([ends_m[0, :, 0, time_s <= now_s], place[0, :, 0]])
        cv2.polylines(frame, [pixels(travelled)], False, PATH, 2, cv2.LINE_AA, SHIFT)
        # draw from the tail forward, so that each link overlaps the link behind it
        for link in reversed(range(len(colours))):
            front, rear = pixels(place[:, :, link]).tolist()
            cv2.line(frame, front, rear, INK, thickness + 2, cv2.LINE_AA, SHIFT)
            cv2.line(frame, front, rear, colours[link], thickness, cv2.LINE_AA, SHIFT)
        # the OpenCV font has ASCII characters only
        for text, base in ((f"{now_s:.2f} s, grid {pitch:g} m", 26), (title, height - 14)):
            plain = text.encode("ascii", "replace").decode()
            cv2.putText(frame, plain, (12, base), cv2.FONT_HERSHEY_SIMPLEX, 0.55, INK, 1, cv2.LINE_AA)
        return frame

    times = np.arange(time_s[0], time_s[-1] + 1e-9, 1.0 / RATE_HZ)
    with atomic.replacing(path) as temporary, progress("animation", total=len(times)) as step:
        writer = open_writer(temporary, RATE_HZ, width, height)
        try:
            for time in times:
                writer.write(float(time - times[0]), draw(float(time)))
                step()
        finally:
            writer.close()
    return REMARK.format("animation") * isinstance(writer, Mpeg4)


def round_length(most: float) -> float:
    """Return the largest length not above ``most`` that is 1, 2 or 5 times a power of ten.

    >>> round_length(0.37)
    0.2
    """
    power = 10.0 ** math.floor(math.log10(most))
    return float(max(k * power for k in (1, 2, 5) if k * power <= most * (1 + 1e-9)))
