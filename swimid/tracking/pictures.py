"""What a person looks at: frames with the track drawn in, and the track itself."""

from __future__ import annotations

import base64
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.results.evidence import Figure, Image, Panel, Span, Trace, thinned
from swimid.tracking import checks
from swimid.tracking.pose import Pose
from swimid.tracking.rawtrack import CUT, LOST, STATUS, RawTrack
from swimid.tracking.reader import Frame
from swimid.tracking.setup import Setup

Array = NDArray[np.float64]

#: Frames kept for the report, and their largest width, px.
KEPT, KEPT_WIDTH = 6, 640
#: Seconds of path drawn behind the markers.
TRAIL_S = 2.0
# Okabe-Ito colours, BGR: told apart by colour-blind readers.
_SEEN, _GUESSED, _TRAIL, _TEXT = (0, 159, 230), (167, 121, 204), (233, 180, 86), (255, 255, 255)


class FrameKeeper:
    """Keeps a few frames spread evenly over a video of unknown length."""

    def __init__(self) -> None:
        self._every = 1
        self._kept: dict[int, Frame] = {}

    def take(self, index: int, frame: Frame) -> None:
        """Look at the next frame; a copy is kept now and then."""
        if index % self._every:
            return
        self._kept[index] = frame.copy()
        if len(self._kept) >= 4 * KEPT:
            self._every *= 2
            self._kept = {k: f for k, f in self._kept.items() if k % self._every == 0}

    def chosen(self, number: int = KEPT) -> dict[int, Frame]:
        """At most ``number`` of the kept frames, evenly spread."""
        keys = sorted(self._kept)
        if len(keys) > number:
            keys = [keys[i] for i in np.unique(np.linspace(0, len(keys) - 1, number).round().astype(int))]
        return {k: self._kept[k] for k in keys}


class Painter:
    """Draws the track into frames.

    Parameters
    ----------
    track, pose, setup
        The finished track.
    """

    def __init__(self, track: RawTrack, pose: Pose, setup: Setup) -> None:
        self.track, self.pose, self.setup = track, pose, setup
        self._path = np.array(pose.plane.to_image(*pose.path.position))
        self._tip: Array | None = None
        if pose.angle is not None and pose.separation is not None:
            length = float(np.nanmedian(pose.separation))
            ahead = pose.path.position + length * np.stack(
                [np.cos(pose.angle.position[0]), np.sin(pose.angle.position[0])]
            )
            self._tip = np.array(pose.plane.to_image(*ahead))

    def draw(self, index: int, frame: Frame) -> Frame:
        """The frame, drawn into: trail, markers, heading, a line of text. ``frame`` is changed."""
        size = max(frame.shape[1] / 960, 0.5)
        line = max(round(1.5 * size), 1)
        times, i = self.track.times, index
        first = int(np.searchsorted(times, times[i] - TRAIL_S))
        trail = self._path[:, first : i + 1]
        for part in _unbroken(trail):
            cv2.polylines(frame, [_fixed(part)], False, _TRAIL, line, cv2.LINE_AA, shift=3)
        for m in range(len(self.track.names)):
            if self.track.status[m, i] != LOST:
                centre = (self.track.x[m, i], self.track.y[m, i])
                radius = int(np.sqrt(self.track.area[m, i] / np.pi) + 4 * size)
                colour = _GUESSED if self.track.at_edge[m, i] else _SEEN
                cv2.circle(frame, _point(*centre), 8 * radius, colour, line, cv2.LINE_AA, shift=3)
        if np.isfinite(self._path[0, i]):
            colour = _SEEN if self.pose.measured[i] else _GUESSED
            here = self._path[:, i]
            if self._tip is not None and np.isfinite(self._tip[0, i]):
                cv2.arrowedLine(
                    frame, _point(*here), _point(*self._tip[:, i]), colour, line, cv2.LINE_AA, 3, 0.2
                )
            cv2.drawMarker(
                frame,
                tuple(np.round(here).astype(int)),
                colour,
                cv2.MARKER_CROSS,
                int(14 * size),
                line,
                cv2.LINE_AA,
            )
        text = f"{times[i]:.2f} s  frame {i}  {self._word(i)}"
        where = (int(8 * size), int(frame.shape[0] - 10 * size))
        # Outlined: legible on light and dark water.
        for shade, width in (((0, 0, 0), 3 * line), (_TEXT, line)):
            cv2.putText(frame, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.55 * size, shade, width, cv2.LINE_AA)
        return frame

    def _word(self, i: int) -> str:
        if self.pose.measured[i]:
            worst = max(int(s) for s in self.track.status[:, i])
            return STATUS[worst]
        word = CUT if self.track.at_edge[:, i].any() else STATUS[LOST]
        return f"{word}, interpolated" if self.pose.interpolated[i] else word


def _fixed(points: Array) -> NDArray[np.int32]:
    # OpenCV draws with sub-pixel accuracy in fixed point, here eighths of a pixel.
    return np.round(8 * points.T).astype(np.int32).reshape(-1, 1, 2)


def _point(x: float, y: float) -> tuple[int, int]:
    return round(8 * float(np.clip(x, -1e5, 1e5))), round(8 * float(np.clip(y, -1e5, 1e5)))


def _unbroken(points: Array) -> list[Array]:
    known = np.flatnonzero(np.isfinite(points[0]))
    parts = np.split(known, np.flatnonzero(np.diff(known) > 1) + 1)
    return [points[:, part] for part in parts if len(part) > 1]


def images(painter: Painter, frames: dict[int, Frame]) -> list[Image]:
    """The kept frames, drawn into and compressed, for the report."""
    out = []
    for index, frame in frames.items():
        if index >= len(painter.track.times):
            continue
        drawn = painter.draw(index, frame.copy())
        factor = min(KEPT_WIDTH / drawn.shape[1], 1.0)
        if factor < 1:
            drawn = cv2.resize(drawn, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        ok, data = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 80])
        assert ok
        out.append(
            Image(
                id=f"frame-{index}",
                title=f"Frame {index}, t = {painter.track.times[index]:.2f} s",
                caption="Circles: markers as found, purple where the edge of the picture cuts them. Cross "
                "and arrow: smoothed reference point and heading, orange where measured, purple where "
                "bridged. Blue: the path of the last two seconds.",
                media_type="image/jpeg",
                base64=base64.b64encode(data.tobytes()).decode(),
            )
        )
    return out


def figures(track: RawTrack, pose: Pose, setup: Setup) -> list[Figure]:
    """Path, coordinates with their bands, speeds and the status strip, as data."""
    unit = pose.plane.unit
    up, angle_name, side = ("y", "yaw", "v") if setup.plane == "horizontal" else ("z", "pitch", "w")
    t = pose.times
    spans = [Span(start=a, end=b, label="gap") for a, b in checks.gaps(pose.measured, t)][:60]
    # A parametric curve has no envelope in x: take every k-th point instead.
    every = max(len(t) // 1500, 1)
    plan = Panel(
        x_label=f"x ({unit})",
        y_label=f"{up} ({unit})",
        equal_aspect=True,
        traces=[
            Trace(x=pose.raw[0][::every], y=pose.raw[1][::every], label="measured", style="points", group=0),
            Trace(
                x=pose.path.position[0][::every], y=pose.path.position[1][::every], label="smoothed", group=0
            ),
        ],
    )
    rows = [
        (f"x ({unit})", pose.path.position[0], pose.path.position_sd[0], pose.raw[0]),
        (f"{up} ({unit})", pose.path.position[1], pose.path.position_sd[1], pose.raw[1]),
    ]
    if pose.angle is not None and pose.raw_angle is not None:
        rows.append(
            (f"{angle_name} (rad)", pose.angle.position[0], pose.angle.position_sd[0], pose.raw_angle)
        )
    coordinates = [
        Panel(x_label="t (s)", y_label=label, traces=_banded(t, smooth, sd, raw), spans=spans)
        for label, smooth, sd, raw in rows
    ]
    vx, vy = pose.path.velocity
    if pose.angle is not None:
        cos, sin = np.cos(pose.angle.position[0]), np.sin(pose.angle.position[0])
        speeds = [
            (f"u ({unit}/s)", vx * cos + vy * sin),
            (f"{side} ({unit}/s)", vy * cos - vx * sin),
            (f"{angle_name} rate (rad/s)", pose.angle.velocity[0]),
        ]
    else:
        speeds = [(f"vx ({unit}/s)", vx), (f"v{up} ({unit}/s)", vy)]
    speed_panels = [
        Panel(x_label="t (s)", y_label=label, traces=[_line(t, values)], spans=spans)
        for label, values in speeds
    ]
    out = [
        Figure(
            id="path",
            title="Path",
            caption="A good track is one unbroken line through its measurements.",
            panels=[plan],
        ),
        Figure(
            id="pose",
            title="Pose over time",
            caption="Smoothed with a band of two standard deviations; points are measurements, shaded "
            "stretches have none. The band should widen there and nowhere else.",
            panels=coordinates,
        ),
        Figure(
            id="speed",
            title="Speeds",
            caption="From the smoother. A beat shows as a regular ripple; single spikes are bad detections.",
            panels=speed_panels,
        ),
    ]
    quality = [
        Panel(
            x_label="t (s)",
            y_label="confidence",
            traces=[_line(t, track.confidence[i], name) for i, name in enumerate(track.names)],
            spans=spans,
        )
    ]
    if pose.separation is not None:
        shown = np.where(pose.measured, pose.separation, np.nan)
        quality.append(
            Panel(x_label="t (s)", y_label=f"separation ({unit})", traces=[_line(t, shown)], spans=spans)
        )
    out.append(
        Figure(
            id="quality",
            title="Quality",
            caption="Confidence of each marker (0 where lost), and the distance of head and tail marker, "
            "which should be constant.",
            panels=quality,
        )
    )
    return out


def _line(t: Array, values: Array, label: str = "") -> Trace:
    x, y = thinned(t, values)
    return Trace(x=x, y=y, label=label)


def _banded(t: Array, smooth: Array, sd: Array, raw: Array) -> list[Trace]:
    every = max(len(t) // 1500, 1)
    part = slice(None, None, every)
    return [
        Trace(x=t[part], y=raw[part], label="measured", style="points", group=0),
        Trace(
            x=t[part],
            y=smooth[part],
            label="smoothed",
            group=1,
            lower=(smooth - 2 * sd)[part],
            upper=(smooth + 2 * sd)[part],
        ),
    ]


def save_plot(path: Path, pose: Pose, setup: Setup, title: str) -> None:
    """The track as a PNG: path on the left, coordinates over time on the right."""
    from matplotlib.figure import Figure as Canvas

    unit = pose.plane.unit
    up, angle_name = ("y", "yaw") if setup.plane == "horizontal" else ("z", "pitch")
    rows = [
        (f"x ({unit})", pose.raw[0], pose.path.position[0], pose.path.position_sd[0]),
        (f"{up} ({unit})", pose.raw[1], pose.path.position[1], pose.path.position_sd[1]),
    ]
    if pose.angle is not None and pose.raw_angle is not None:
        degrees = np.degrees
        rows.append(
            (
                f"{angle_name} (deg)",
                degrees(pose.raw_angle),
                degrees(pose.angle.position[0]),
                degrees(pose.angle.position_sd[0]),
            )
        )
    figure = Canvas(figsize=(11, 5.2), dpi=110, layout="constrained")
    grid = figure.add_gridspec(len(rows), 2, width_ratios=(1, 1.15))
    plan = figure.add_subplot(grid[:, 0])
    plan.plot(*pose.raw, ".", color="#E69F00", markersize=3, label="measured")
    plan.plot(*pose.path.position, color="#0072B2", linewidth=1.1, label="smoothed")
    bridged = np.where(pose.interpolated, pose.path.position, np.nan)
    if pose.interpolated.any():
        plan.plot(*bridged, color="#CC79A7", linewidth=2.2, label="bridged")
    begin = int(np.argmax(pose.segment > 0))
    plan.plot(*pose.path.position[:, begin], "o", color="#0072B2", markersize=6, label="start")
    plan.set_aspect("equal", adjustable="datalim")
    plan.set_xlabel(f"x ({unit})")
    plan.set_ylabel(f"{up} ({unit})")
    plan.legend(loc="best", fontsize=8, framealpha=0.8)
    plan.set_title(title, fontsize=10, loc="left")
    first = None
    for k, (label, raw, smooth, sd) in enumerate(rows):
        axes = figure.add_subplot(grid[k, 1], sharex=first)
        first = first or axes
        axes.plot(pose.times, raw, ".", color="#E69F00", markersize=3)
        axes.plot(pose.times, smooth, color="#0072B2", linewidth=1.0)
        axes.fill_between(
            pose.times, smooth - 2 * sd, smooth + 2 * sd, color="#0072B2", alpha=0.25, linewidth=0
        )
        for start, end in checks.gaps(pose.measured, pose.times):
            axes.axvspan(start, end, color="#CC79A7", alpha=0.25, linewidth=0)
        axes.set_ylabel(label)
        axes.tick_params(labelbottom=k == len(rows) - 1)
        axes.margins(x=0.01)
    assert first is not None
    figure.axes[-1].set_xlabel("t (s)")
    for axes in figure.axes:
        axes.grid(True, color="0.9", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": "swimid"})
