"""Rendered films of a robot seen from the side through a pool's window, with the truth beside them.

A pin-hole camera, a little askew, looks along the y axis at the vertical plane of motion: water
darker and greyer with depth, a bright surface with ripples, drifting specks, sensor noise and
H.264. The robot, a hull with a red disc at the front and a yellow one at the rear, makes cycles
of a stroke. Everything is drawn here with numpy and OpenCV; nothing of the tracker is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tests.generators import film_writer

#: Places of the markers, seen from the reference point: forward and up, m.
FRONT, REAR = (0.46, 0.08), (-0.43, 0.06)
MARKER_RADIUS_M = 0.03
RED, YELLOW, HULL = (40, 40, 200), (40, 190, 215), (66, 62, 60)  # BGR
PERIOD_S = 2.9
#: By the column's name in a log.
Motion = dict[str, np.ndarray]


@dataclass(frozen=True)
class View:
    """Camera and light.

    Attributes
    ----------
    flank : int
        1: the camera sees the starboard side, the robot swims to the right; -1: port, to the left.
    focal_px, distance_m : float
        Of the camera, and from it to the plane of motion.
    pan_deg, tilt_deg, roll_deg : float
        How far the camera is askew.
    """

    width: int = 1280
    height: int = 720
    rate_hz: float = 30.0
    flank: int = 1
    focal_px: float = 1250.0
    distance_m: float = 4.0
    pan_deg: float = 4.0
    tilt_deg: float = -2.0
    roll_deg: float = 0.8
    noise: float = 3.0
    blur_px: float = 0.9
    crf: int = 14
    seed: int = 5
    #: Three cycles, and half a second more.
    duration_s: float = 9.2

    def to_image(self) -> np.ndarray:
        """Homography from (x, z) of the plane of motion to the picture, shape (3, 3)."""
        pan, tilt, roll = (math.radians(a) for a in (self.pan_deg, self.tilt_deg, self.roll_deg))
        turn = (
            np.array([[math.cos(roll), -math.sin(roll), 0], [math.sin(roll), math.cos(roll), 0], [0, 0, 1]])
            @ np.array([[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]])
            @ np.array([[math.cos(pan), 0, math.sin(pan)], [0, 1, 0], [-math.sin(pan), 0, math.cos(pan)]])
        )
        # Camera axes: right, down, ahead. The camera stands opposite x = 1.1 m, z = 0 of the robot's path.
        place = np.array([[self.flank, 0, -1.1 * self.flank], [0, -1, 0], [0, 0, self.distance_m]])
        lens = np.array(
            [[self.focal_px, 0, (self.width - 1) / 2], [0, self.focal_px, (self.height - 1) / 2], [0, 0, 1]]
        )
        return lens @ turn @ place

    def times(self) -> np.ndarray:
        """Time of each frame, s."""
        return np.arange(round(self.duration_s * self.rate_hz)) / self.rate_hz


def motion(times: np.ndarray) -> Motion:
    """Pose and speeds of the reference point at ``times``: closed form, exact, nose up, each shape (n,).

    Every stroke pushes (a pulse of acceleration), drag brakes in between; pitch rises and falls
    with the stroke and drifts, heave follows.
    """
    w = 2 * np.pi / PERIOD_S
    # From rest to a cruise: 0.32 (1 - exp(-t / 3)), with a surge of the stroke that grows from rest likewise.
    tau, cruise, pulse = 3.0, 0.34, 0.07
    grown, growth = 1 - np.exp(-times / tau), np.exp(-times / tau) / tau
    drift = cruise * (times - tau * grown)
    wave = pulse / w * (1 - np.cos(w * times)) + 0.012 / (2 * w) * (
        np.sin(2 * w * times + 0.4) - math.sin(0.4)
    )
    wave_rate = pulse * np.sin(w * times) + 0.012 * np.cos(2 * w * times + 0.4)
    x, vx = drift + grown * wave, cruise * grown + growth * wave + grown * wave_rate
    lift = 0.030 * np.sin(w * times - 0.5) + 0.010 * np.sin(2 * w * times) - 0.016 * times
    lift_rate = 0.030 * w * np.cos(w * times - 0.5) + 0.020 * w * np.cos(2 * w * times) - 0.016
    z, vz = grown * lift, growth * lift + grown * lift_rate
    nod = 0.11 * np.sin(w * times + 0.3) + 0.03 * np.sin(3 * w * times) + 0.022 * times
    nod_rate = 0.11 * w * np.cos(w * times + 0.3) + 0.09 * w * np.cos(3 * w * times) + 0.022
    pitch, pitch_rate = grown * nod, growth * nod + grown * nod_rate
    return {
        "x_m": x,
        "z_m": z,
        "pitch_rad": pitch,
        "vx_m_s": vx,
        "vz_m_s": vz,
        "pitch_rate_rad_s": pitch_rate,
    }


def place(truth: Motion, point: tuple[float, float]) -> np.ndarray:
    """A point of the body in the plane of motion, shape (2, n)."""
    cos, sin = np.cos(truth["pitch_rad"]), np.sin(truth["pitch_rad"])
    ahead, up = point
    return np.stack([truth["x_m"] + ahead * cos - up * sin, truth["z_m"] + ahead * sin + up * cos])


class _Pane:
    """Draws on the plane of motion through the camera, rims softened over a pixel or two."""

    def __init__(self, view: View) -> None:
        self.view, self.forward = view, view.to_image()
        self.back = np.linalg.inv(self.forward)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Image points, shape (n, 2), of points of the plane, shape (n, 2)."""
        p = np.column_stack([points, np.ones(len(points))]) @ self.forward.T
        return p[:, :2] / p[:, 2:]

    def capsule(self, image: np.ndarray, start, end, radius: float, colour, shade: float = 0.0) -> None:
        """A rounded bar (a disc where start is end), lit from above by the share ``shade``."""
        ends = self.pixels(np.array([start, end]))
        scale = self.view.distance_m / self.view.focal_px
        reach = 1.3 * radius / scale + 5
        x0, y0 = np.maximum(np.floor(ends.min(0) - reach), 0).astype(int)
        x1, y1 = np.minimum(np.ceil(ends.max(0) + reach) + 1, (image.shape[1], image.shape[0])).astype(int)
        if x1 <= x0 or y1 <= y0:
            return
        columns, rows = np.meshgrid(np.arange(x0, x1), np.arange(y0, y1))
        px, pz, w = np.tensordot(self.back, np.stack([columns, rows, np.ones_like(rows)]), axes=1)
        px, pz = px / w, pz / w
        dx, dz = end[0] - start[0], end[1] - start[1]
        along = ((px - start[0]) * dx + (pz - start[1]) * dz) / max(dx * dx + dz * dz, 1e-12)
        along = np.clip(along, 0, 1)
        ox, oz = px - start[0] - along * dx, pz - start[1] - along * dz
        alpha = np.clip(0.5 - (np.hypot(ox, oz) - radius) / scale / (1 + 2 * self.view.blur_px), 0, 1)
        alpha = (alpha * alpha * (3 - 2 * alpha))[..., None]
        lit = 1 + shade * np.clip(oz / radius, -1, 1)[..., None]
        part = image[y0:y1, x0:x1]
        part += alpha * (np.array(colour, np.float32) * lit - part)


def frames(view: View, moved: Callable[[np.ndarray], Motion] = motion) -> Iterator[np.ndarray]:
    """The pictures, uint8 BGR, of a robot that moves as ``moved`` says."""
    rng = np.random.default_rng(view.seed)
    pane, w, h = _Pane(view), view.width, view.height
    times = view.times()
    truth = moved(times)
    front, rear = place(truth, FRONT), place(truth, REAR)
    nose, stern = place(truth, (0.45, 0.01)), place(truth, (-0.43, 0.0))
    depth = np.linspace(0, 1, h, dtype=np.float32)[:, None, None]
    # Light falls off fastest in red: blue-green above, dark blue below.
    water = np.array([172, 150, 96]) * np.exp(-depth * np.array([0.35, 0.55, 1.3]))
    water = np.repeat(water, w, axis=1).astype(np.float32)
    specks = rng.uniform(0, 1, (60, 2)) * (w, h)
    tile = rng.normal(0, view.noise, (h + 64, w + 64, 1)) + rng.normal(
        0, 0.5 * view.noise, (h + 64, w + 64, 3)
    )
    tile = tile.astype(np.float32)
    across, rows = np.arange(w, dtype=np.float32) / w, np.arange(90, dtype=np.float32)[:, None]
    for i, t in enumerate(times):
        image = water.copy()
        surface = 14 + 5 * np.sin(18 * across + 2.1 * t) + 3 * np.sin(41 * across - 3.3 * t)
        glow = np.exp(-np.abs(rows - surface) / 9).astype(np.float32)
        image[: len(rows)] += (70 * glow)[..., None]
        pane.capsule(image, stern[:, i], nose[:, i], 0.125, HULL, 0.25)
        pane.capsule(image, front[:, i], front[:, i], MARKER_RADIUS_M, RED, 0.06)
        pane.capsule(image, rear[:, i], rear[:, i], MARKER_RADIUS_M, YELLOW, 0.06)
        for k, (sx, sy) in enumerate(specks):
            where = (int((sx + (3 + k % 5) * 4 * t) % w * 8), int((sy + 6 * math.sin(t + k)) % h * 8))
            cv2.circle(image, where, 10, (150, 150, 140), -1, cv2.LINE_AA, shift=3)
        shafts = np.sin(23 * across + 0.9 * t) + np.sin(9 * across - 0.6 * t + 1)
        light = (1 + 0.035 * shafts) * (1 - 0.04 * math.sin(0.5 * t))
        image *= light.astype(np.float32)[None, :, None]
        dx, dy = rng.integers(0, 64, 2)
        image += tile[dy : dy + h, dx : dx + w]
        yield cv2.convertScaleAbs(np.maximum(image, 0, out=image))


def write_video(path: Path, view: View, moved: Callable[[np.ndarray], Motion] = motion) -> None:
    """Render a view as H.264."""
    size = (view.width, view.height)
    film_writer.write(
        path, frames(view, moved), size=size, times=view.times(), rate_hz=view.rate_hz, crf=view.crf
    )


#: Four marks held in the plane of motion, m: x along the robot's way, z up.
MARKS_M = ((-0.4, 0.8), (2.6, 0.8), (2.6, -0.8), (-0.4, -0.8))


def project(view: View, points: np.ndarray) -> np.ndarray:
    """Image points, shape (n, 2), of points of the plane of motion, shape (n, 2)."""
    return _Pane(view).pixels(points)


def marks(view: View) -> np.ndarray:
    """Where the marks are clicked, to whole pixels, shape (4, 2)."""
    return np.round(project(view, np.array(MARKS_M)))


def scale(view: View) -> dict[str, list[list[float]]]:
    """The marks as the scale of a setup."""
    return {"points_px": marks(view).tolist(), "points_m": [list(m) for m in MARKS_M]}


def setup_text(view: View, extra: str = "") -> str:
    """The setup file; ``extra`` is a further line."""
    return f"""\
format: swimid-setup/1
markers:
  - name: front
    hsv: {{hue_deg: [340, 20], saturation: [0.45, 1], value: [0.25, 1]}}
    area_px: [80, 800]
  - name: rear
    hsv: {{hue_deg: [38, 78], saturation: [0.4, 1], value: [0.3, 1]}}
    area_px: [80, 800]
head: front
tail: rear
plane: vertical
scale: {scale(view)}
{extra}
"""
