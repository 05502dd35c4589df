"""Frames of a film with the track drawn in: for the report, and as a film of their own."""

from __future__ import annotations

import base64
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.logs.log import runs
from swimid.progress import Progress
from swimid.results.evidence import Image
from swimid.tracking.detect import CUT, LOST, STATUS
from swimid.tracking.pose import Pose
from swimid.tracking.reader import Frame, Video, reduced
from swimid.tracking.tracker import Run

Array = NDArray[np.float64]

#: Below a frame in the report.
CAPTION = (
    "Circles: markers as found, purple where the edge of the picture cuts them. Cross and arrow: smoothed "
    "reference point and heading, orange where measured, purple where bridged. Blue: the path of the last "
    "two seconds."
)
#: Largest width of such a frame, px.
REPORT_WIDTH = 640
#: Seconds of path drawn behind the markers.
TRAIL_S = 2.0
# Okabe-Ito colours, BGR: told apart by colour-blind readers.
SEEN, GUESSED, TRAIL = (0, 159, 230), (167, 121, 204), (233, 180, 86)


class Painter:
    """Draws a finished track into the frames of its film."""

    def __init__(self, run: Run, pose: Pose) -> None:
        self.run, self.track, self.pose = run, run.track, pose
        self._path = pose.plane.to_image(*pose.path.position)
        self._tip: Array | None = None
        if pose.angle is not None and pose.separation is not None:
            length = float(np.nanmedian(pose.separation))
            ahead = pose.path.position + length * np.stack(
                [np.cos(pose.angle.position[0]), np.sin(pose.angle.position[0])]
            )
            self._tip = pose.plane.to_image(*ahead)

    def draw(self, index: int, frame: Frame) -> Frame:
        """The frame, drawn into: trail, markers, heading, a line of text. ``frame`` is changed."""
        size = max(frame.shape[1] / 960, 0.5)
        line = max(round(1.5 * size), 1)
        times, i = self.track.times, index
        first = int(np.searchsorted(times, times[i] - TRAIL_S))
        trail = self._path[:, first : i + 1]
        for start, end in runs(np.isfinite(trail[0])):
            if end - start > 1:
                # OpenCV draws with sub-pixel accuracy in fixed point, here eighths of a pixel.
                part = np.round(8 * trail[:, start:end].T).astype(np.int32).reshape(-1, 1, 2)
                cv2.polylines(frame, [part], False, TRAIL, line, cv2.LINE_AA, shift=3)
        for m in range(len(self.track.names)):
            if self.track.status[m, i] != LOST:
                centre = (self.track.x[m, i], self.track.y[m, i])
                radius = int(np.sqrt(self.track.area[m, i] / np.pi) + 4 * size)
                colour = GUESSED if self.track.at_edge[m, i] else SEEN
                cv2.circle(frame, _point(*centre), 8 * radius, colour, line, cv2.LINE_AA, shift=3)
        if np.isfinite(self._path[0, i]):
            colour = SEEN if self.pose.measured[i] else GUESSED
            here = self._path[:, i]
            if self._tip is not None and np.isfinite(self._tip[0, i]):
                cv2.arrowedLine(
                    frame, _point(*here), _point(*self._tip[:, i]), colour, line, cv2.LINE_AA, 3, 0.2
                )
            at = tuple(np.round(here).astype(int))
            cv2.drawMarker(frame, at, colour, cv2.MARKER_CROSS, int(14 * size), line, cv2.LINE_AA)
        where = (int(8 * size), int(frame.shape[0] - 10 * size))
        write_text(frame, f"{times[i]:.2f} s  frame {i}  {self._word(i)}", where, 0.55 * size, line)
        return frame

    def _word(self, i: int) -> str:
        if self.pose.measured[i]:
            worst = max(int(s) for s in self.track.status[:, i])
            return STATUS[worst]
        word = CUT if self.track.at_edge[:, i].any() else STATUS[LOST]
        return f"{word}, interpolated" if self.pose.interpolated[i] else word

    def images(self) -> list[Image]:
        """The kept frames, drawn into and compressed, for the report."""
        out = []
        for index, frame in self.run.kept.items():
            drawn = reduced(self.draw(index, frame.copy()), REPORT_WIDTH)
            _, data = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 80])
            out.append(
                Image(
                    id=f"frame-{index}",
                    title=f"Frame {index}, t = {self.track.times[index]:.2f} s",
                    caption=CAPTION,
                    media_type="image/jpeg",
                    base64=base64.b64encode(data.tobytes()).decode(),
                )
            )
        return out

    def write(self, path: Path, progress: Progress) -> str:
        """Read the video a second time and write it with the track drawn in; returns a remark, if any.

        What is drawn is the finished track: smoothed and bridged, without the sights that were taken back.
        None of it is known while the video is read first, and all its frames do not fit into memory. The
        second decoding is an eighth of what tracking with an overlay costs; encoding is most of it.
        """
        from swimid.files.video import REMARK, Mpeg4, open_writer

        times, source = self.track.times, self.run.video
        width, height = source.width // 2 * 2, source.height // 2 * 2
        rate = 1 / float(np.median(np.diff(times)))
        again = Video(source.path, apply_rotation=self.run.setup.apply_rotation).frames()
        with atomic.replacing(path) as temporary, progress("overlay", total=len(times)) as step:
            writer = open_writer(temporary, rate, width, height)
            try:
                for index, (time, (_, frame)) in enumerate(zip(times, again, strict=False)):
                    writer.write(float(time), self.draw(index, frame)[:height, :width])
                    step()
            finally:
                writer.close()
        return REMARK.format("overlay") if isinstance(writer, Mpeg4) else ""


def write_text(image: Frame, text: str, where: tuple[int, int], size: float, line: int = 1) -> None:
    """Outlined: legible on light and dark water."""
    for shade, width in (((0, 0, 0), 3 * line), ((255, 255, 255), line)):
        cv2.putText(image, text, where, cv2.FONT_HERSHEY_SIMPLEX, size, shade, width, cv2.LINE_AA)


def _point(x: float, y: float) -> tuple[int, int]:
    return round(8 * float(np.clip(x, -1e5, 1e5))), round(8 * float(np.clip(y, -1e5, 1e5)))
