"""Rendered films of robots in a pool, with the truth beside them.

A pin-hole camera looks at the water plane a little askew. One or more bodies, each with a
red disc at the nose and a yellow one behind it, swim in it under caustics, glare, sensor
noise and drifting exposure. Everything is drawn here with numpy; nothing of the tracker is used.

::

    python -m tests.generators.pool_video OUTPUT_FOLDER
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from tests.generators import film_writer
from tests.generators.marks import mark

#: Distance from the nose marker back to the tail marker, m.
SEPARATION_M = 0.16
MARKER_RADIUS_M = 0.022
RED, YELLOW = (38, 38, 205), (45, 200, 225)  # BGR
_CLOCK = 90_000
_FINE = 2000  # truth is integrated at this rate, Hz


@dataclass(frozen=True)
class Swim:
    """One body's motion: a steady turn with a beat on heading and speed."""

    x_m: float = -0.45
    y_m: float = 0.0
    heading_rad: float = -math.pi / 2
    speed_m_s: float = 0.2
    turn_rad_s: float = 0.42
    beat_hz: float = 1.1
    beat_rad: float = 0.14
    #: Speed ripple at twice the beat, as a share.
    ripple: float = 0.15


@dataclass(frozen=True)
class Scene:
    """All that makes a film. Lengths on the water in m, in the picture in px."""

    width: int = 640
    height: int = 480
    duration_s: float = 12.0
    rate_hz: float = 30.0
    seed: int = 1
    swims: tuple[Swim, ...] = (Swim(),)
    noise: float = 3.0
    caustics: float = 0.10
    glare: int = 3
    exposure_drift: float = 0.2
    blur_px: float = 0.8
    perspective: float = 0.10
    #: Times between which foam hides the markers of every body.
    dropout_s: tuple[float, float] | None = (7.0, 7.5)
    variable_rate: bool = False
    crf: float = 14
    #: Of x264.
    preset: str = "ultrafast"
    corners_m: tuple[tuple[float, float], ...] = field(
        default=((-0.9, 0.65), (0.9, 0.65), (0.9, -0.65), (-0.9, -0.65))
    )

    def corners_px(self) -> np.ndarray:
        """Where the camera sees ``corners_m``, shape (4, 2): a trapezoid, upper side farther."""
        w, h, p = self.width, self.height, self.perspective
        return np.array(
            [
                [w * (0.06 + 0.45 * p), h * 0.09],
                [w * (0.94 - 0.35 * p), h * 0.07],
                [w * 0.95, h * 0.93],
                [w * 0.04, h * 0.92],
            ]
        )

    def to_image(self) -> np.ndarray:
        """Homography from the water plane to the picture, shape (3, 3)."""
        return cv2.getPerspectiveTransform(
            np.array(self.corners_m, dtype=np.float32), self.corners_px().astype(np.float32)
        )

    def times(self) -> np.ndarray:
        """Time of each frame, s."""
        count = round(self.duration_s * self.rate_hz)
        if not self.variable_rate:
            return np.arange(count) / self.rate_hz
        rng = np.random.default_rng(self.seed + 1000)
        steps = rng.choice([0.6, 1.0, 1.0, 1.7], size=count - 1) / self.rate_hz
        return np.round(np.concatenate([[0.0], np.cumsum(steps)]) * _CLOCK) / _CLOCK


@dataclass(frozen=True)
class Truth:
    """Nose pose and body speeds of one body at the frames, each shape (n,)."""

    x_m: np.ndarray
    y_m: np.ndarray
    yaw_rad: np.ndarray
    u_m_s: np.ndarray
    v_m_s: np.ndarray
    yaw_rate_rad_s: np.ndarray


def motion(swim: Swim, times: np.ndarray) -> Truth:
    """Integrate a body's motion finely and take it at ``times``."""
    t = np.arange(0.0, times[-1] + 2 / _FINE, 1 / _FINE)
    beat = 2 * np.pi * swim.beat_hz
    course = swim.heading_rad + swim.turn_rad_s * t
    yaw = course + swim.beat_rad * np.sin(beat * t)
    rate = swim.turn_rad_s + swim.beat_rad * beat * np.cos(beat * t)
    speed = swim.speed_m_s * (1 + swim.ripple * np.sin(2 * beat * t))
    # The middle of the body follows its course; the nose swings with the beat.
    arm = 0.5 * SEPARATION_M
    x = swim.x_m + np.concatenate([[0], np.cumsum((speed * np.cos(course))[:-1]) / _FINE]) + arm * np.cos(yaw)
    y = swim.y_m + np.concatenate([[0], np.cumsum((speed * np.sin(course))[:-1]) / _FINE]) + arm * np.sin(yaw)
    vx = speed * np.cos(course) - arm * rate * np.sin(yaw)
    vy = speed * np.sin(course) + arm * rate * np.cos(yaw)
    u, v = vx * np.cos(yaw) + vy * np.sin(yaw), vy * np.cos(yaw) - vx * np.sin(yaw)
    return Truth(*(np.interp(times, t, values) for values in (x, y, yaw, u, v, rate)))


class _Canvas:
    """Draws with sub-pixel accuracy on the water plane through the camera's homography."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.forward = scene.to_image()
        self.back = np.linalg.inv(self.forward)

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        p = self.forward @ (x, y, 1.0)
        return p[0] / p[2], p[1] / p[2]

    def metres_per_pixel(self, x: float, y: float) -> float:
        a, b = self.pixel(x, y), self.pixel(x + 1e-3, y)
        return 1e-3 / math.hypot(b[0] - a[0], b[1] - a[1])

    def capsule(
        self,
        image: np.ndarray,
        start: tuple[float, float],
        end: tuple[float, float],
        radius: float,
        colour: tuple,
    ) -> None:
        """A rounded bar on the water (a disc where start is end), its rim softened by the lens."""
        scale = self.metres_per_pixel(*start)
        ends = np.array([self.pixel(*start), self.pixel(*end)])
        reach = radius / scale * 1.4 + 4
        x0, y0 = np.maximum(np.floor(ends.min(0) - reach).astype(int), 0)
        x1, y1 = np.minimum(np.ceil(ends.max(0) + reach).astype(int) + 1, (image.shape[1], image.shape[0]))
        if x1 <= x0 or y1 <= y0:
            return
        columns, rows = np.meshgrid(np.arange(x0, x1), np.arange(y0, y1))
        w = self.back[2, 0] * columns + self.back[2, 1] * rows + self.back[2, 2]
        px = (self.back[0, 0] * columns + self.back[0, 1] * rows + self.back[0, 2]) / w
        py = (self.back[1, 0] * columns + self.back[1, 1] * rows + self.back[1, 2]) / w
        dx, dy = end[0] - start[0], end[1] - start[1]
        along = np.clip(((px - start[0]) * dx + (py - start[1]) * dy) / max(dx * dx + dy * dy, 1e-12), 0, 1)
        away = (np.hypot(px - start[0] - along * dx, py - start[1] - along * dy) - radius) / scale
        softness = 1.0 + 2.0 * self.scene.blur_px
        alpha = np.clip(0.5 - away / softness, 0, 1)
        alpha = (alpha * alpha * (3 - 2 * alpha))[..., None]
        part = image[y0:y1, x0:x1]
        part += alpha * (np.array(colour, dtype=np.float32) - part)


def frames(scene: Scene) -> Iterator[np.ndarray]:
    """The pictures, uint8 BGR."""
    rng = np.random.default_rng(scene.seed)
    canvas = _Canvas(scene)
    times = scene.times()
    truths = [motion(swim, times) for swim in scene.swims]
    w, h = scene.width, scene.height
    water = _water(scene, rng)
    waves = [
        (rng.uniform(5, 11) / w, rng.uniform(0, 2 * np.pi), rng.uniform(1.5, 3.5), rng.uniform(0, 2 * np.pi))
        for _ in range(6)
    ]
    small_x, small_y = np.meshgrid(
        np.arange(0, w + 8, 8, dtype=np.float32), np.arange(0, h + 8, 8, dtype=np.float32)
    )
    # Sensor noise: one large tile, shifted at random for every frame.
    tile = rng.normal(0, scene.noise, (h + 64, w + 64, 1)) + rng.normal(
        0, 0.5 * scene.noise, (h + 64, w + 64, 3)
    )
    tile = tile.astype(np.float32)
    for i, t in enumerate(times):
        image = water.copy()
        for truth in truths:
            _body(canvas, image, truth, i)
        if scene.dropout_s is not None and scene.dropout_s[0] <= t < scene.dropout_s[1]:
            for truth in truths:
                _foam(canvas, image, truth, i)
        light = np.zeros_like(small_x)
        for k, (wave, phase, speed, angle) in enumerate(waves):
            light += np.sin(
                2 * np.pi * wave * (small_x * math.cos(angle) + small_y * math.sin(angle))
                + phase
                + speed * t
                + k
            )
        light = 1 + scene.caustics * np.maximum(light / 3, -0.6) ** 3
        gain = 1 - 0.5 * scene.exposure_drift * (1 - math.cos(2 * math.pi * t / max(scene.duration_s, 1e-9)))
        image *= (gain * cv2.resize(light, (w, h), interpolation=cv2.INTER_LINEAR))[..., None]
        dx, dy = rng.integers(0, 64, 2)
        image += tile[dy : dy + h, dx : dx + w]
        yield np.clip(image + 0.5, 0, 255).astype(np.uint8)


def _water(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """The empty pool: blue-green with lane lines, uneven light and patches of glare."""
    w, h = scene.width, scene.height
    x, y = np.meshgrid(np.arange(w, dtype=np.float32) / w, np.arange(h, dtype=np.float32) / h)
    shade = 0.9 + 0.2 * np.exp(-((x - 0.4) ** 2 + (y - 0.45) ** 2) / 0.3)
    image = np.empty((h, w, 3), np.float32)
    image[:] = (158, 128, 62)
    for line in (0.25, 0.5, 0.75):
        image *= (1 - 0.12 * np.exp(-(((y - line) * h / (0.004 * h + 1)) ** 2)))[..., None]
    image *= shade[..., None]
    for _ in range(scene.glare):
        cx, cy, sx, sy = (
            rng.uniform(0.1, 0.9),
            rng.uniform(0.1, 0.9),
            rng.uniform(0.01, 0.04),
            rng.uniform(0.01, 0.03),
        )
        bright = np.exp(-(((x - cx) / sx) ** 2 + ((y - cy) / sy) ** 2))
        image += 70 * bright[..., None]
    return image


def _body(canvas: _Canvas, image: np.ndarray, truth: Truth, i: int) -> None:
    x, y, yaw = truth.x_m[i], truth.y_m[i], truth.yaw_rad[i]

    def behind(d: float, turn: float = 0.0) -> tuple[float, float]:
        return x - d * math.cos(yaw + turn), y - d * math.sin(yaw + turn)

    sway = 0.35 * math.sin(6.9 * i / 30)
    canvas.capsule(image, behind(-0.02), behind(0.21), 0.036, (62, 58, 56))
    canvas.capsule(image, behind(0.21), behind(0.30, sway * 0.3), 0.014, (70, 66, 62))
    canvas.capsule(image, (x, y), (x, y), MARKER_RADIUS_M, RED)
    tail = behind(SEPARATION_M)
    canvas.capsule(image, tail, tail, MARKER_RADIUS_M, YELLOW)


def _foam(canvas: _Canvas, image: np.ndarray, truth: Truth, i: int) -> None:
    x, y, yaw = truth.x_m[i], truth.y_m[i], truth.yaw_rad[i]
    rear = (x - SEPARATION_M * math.cos(yaw), y - SEPARATION_M * math.sin(yaw))
    canvas.capsule(image, (x, y), rear, 0.045, (225, 222, 214))


def write_video(path: Path, scene: Scene) -> None:
    """Render a scene as H.264, every frame with its own time stamp."""
    film_writer.write(
        path,
        frames(scene),
        size=(scene.width, scene.height),
        times=scene.times(),
        rate_hz=scene.rate_hz,
        crf=scene.crf,
        preset=scene.preset,
    )


def write_truth(path: Path, scene: Scene, body: int = 0) -> None:
    """The nose pose of one body at every frame, as a log."""
    times = scene.times()
    truth = motion(scene.swims[body], times)
    names = ["x_m", "y_m", "yaw_rad", "u_m_s", "v_m_s", "yaw_rate_rad_s"]
    with path.open("w", newline="") as stream:
        stream.write("# source: simulated (rendered film), exact\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["t_s", *names])
        for i, time in enumerate(times):
            writer.writerow([f"{time:.6f}", *(f"{getattr(truth, name)[i]:.7f}" for name in names)])


def setup_text(scene: Scene, *, number: int = 1) -> str:
    """The setup file for a scene, with comments."""
    corners = ", ".join(f"[{x:.3f}, {y:.3f}]" for x, y in scene.corners_px())
    world = ", ".join(f"[{x:g}, {y:g}]" for x, y in scene.corners_m)
    several = "" if number == 1 else f"\n    number: {number}"
    which = "" if number == 1 else "1"
    area = math.pi * (MARKER_RADIUS_M * scene.width / 1.9) ** 2
    return f"""\
format: swimid-setup/1
# Red disc on the nose, yellow disc behind it, on the rigid front part.
markers:
  - name: red{several}
    hsv: {{hue_deg: [345, 15], saturation: [0.45, 1], value: [0.3, 1]}}
    area_px: [{0.3 * area:.0f}, {3 * area:.0f}]
  - name: yellow{several}
    hsv: {{hue_deg: [40, 75], saturation: [0.4, 1], value: [0.35, 1]}}
    area_px: [{0.3 * area:.0f}, {3 * area:.0f}]
head: red{which}
tail: yellow{which}
plane: horizontal
# Corners of the pool floor, seen from above: pixels and metres, going round the same way.
scale:
  points_px: [{corners}]
  points_m: [{world}]
max_gap_s: 1.0
"""


def write_scene(folder: Path, scene: Scene, name: str = "pool") -> tuple[Path, Path, Path]:
    """Write ``<name>.mp4``, ``<name>_setup.yaml`` and ``<name>_truth.csv``; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    video, setup, truth = (folder / f"{name}{end}" for end in (".mp4", "_setup.yaml", "_truth.csv"))
    write_video(video, scene)
    setup.write_text(setup_text(scene, number=len(scene.swims)), encoding="utf-8")
    mark(setup.parent)
    write_truth(truth, scene)
    return video, setup, truth


def crossing() -> Scene:
    """Two like robots whose paths cross, and whose markers meet."""
    left = Swim(x_m=-0.4, y_m=-0.042, heading_rad=0.12, turn_rad_s=0.0)
    right = Swim(x_m=0.4, y_m=-0.042, heading_rad=math.pi - 0.12, turn_rad_s=0.0, beat_hz=1.4)
    return Scene(duration_s=4.4, swims=(left, right), dropout_s=None)


def write_sample(folder: Path) -> list[Path]:
    """The small sample that ships with the source: 640 x 480, 12 s, 30 fps, under 2.5 MB."""
    return list(write_scene(folder, replace(Scene(), noise=1.0, crf=16, preset="veryfast")))


if __name__ == "__main__":
    for written in write_sample(Path(sys.argv[1])):
        print(f"{written}  {written.stat().st_size} bytes")
