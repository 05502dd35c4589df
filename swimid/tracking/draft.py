"""The drafted setup: its commented YAML, and a picture with the markers drawn in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.files import atomic, yamlio
from swimid.results.result import Result
from swimid.tracking import setup as setup_format
from swimid.tracking.pictures import SEEN, write_text
from swimid.tracking.propose import Passed
from swimid.tracking.run import Run
from swimid.tracking.setup import Setup

#: Pictures on the contact sheet, and the width of each.
_SHEET, _SHEET_WIDTH = 4, 640


#: Lines of a drafted setup.
FACING = (
    "# Which way in the picture the robot faces and x runs: right, left, or auto (tail to head).",
    "facing: auto",
)
POSE = (
    "# The pose is that of the head marker; that of the robot's reference point with at_m of head and",
    "# tail, or with the name of a robot whose file names markers like these.",
    "# robot: sealion",
)
NO_SCALE = (
    "# Without a scale positions are in pixels. One of:",
    "# scale: {metres_per_pixel: 0.0015}",
    "# scale: {points_px: [[x1, y1], [x2, y2]], distance_m: 1.0}",
    "# scale: {points_px: [four corners], points_m: [the same corners]}",
)


@dataclass(frozen=True, eq=False)
class SetupDraft(Result):
    """A setup to look through, as ``track_setup`` gives it; ``document`` is its commented YAML.

    Attributes
    ----------
    sheet : ndarray of uint8, shape (height, width, 3)
        Frames of the film with the markers circled and named, RGB: ``plt.imshow(draft.sheet)``.
    """

    sheet: NDArray[np.uint8] | None = None

    format = setup_format.FORMAT

    @property
    def setup(self) -> Setup:
        """The setup itself, for ``track_video``."""
        return setup_format.of(yamlio.parse_scalar(self.document))

    def _write(self, path: Path) -> list[Path]:
        atomic.write_text(path, self.document)
        if self.sheet is None:
            return [path]
        picture = path.with_suffix(".markers.png")
        _, data = cv2.imencode(".png", cv2.cvtColor(self.sheet, cv2.COLOR_RGB2BGR))
        with atomic.replacing(picture) as temporary:
            temporary.write_bytes(data.tobytes())
        return [path, picture]


def text_of(
    setup: Setup, shares: dict[str, float], remarks: list[str], passed: list[Passed], video: str
) -> str:
    """The setup as commented YAML.

    Parameters
    ----------
    shares : dict of str to float
        Share of the frames each marker is found in.
    remarks : list of str
        One for each kind of marker.
    passed : list of Passed
        Colours that were taken for no marker's.
    video : str
        The film's name.
    """
    lines = [
        f"# Drafted by swimid track setup from {video}; edit what is wrong. Every key: docs/tracking.md",
        f"format: {setup.format}",
        "markers:",
    ]
    for marker, remark in zip(setup.markers, remarks, strict=True):
        hsv = marker.colour_range()
        found = ", ".join(f"{100 * shares[name]:.1f} %" for name in marker.names)
        lines += [
            f"  - name: {marker.name}",
            f"    # Found in {found} of the frames; {remark}.",
            "    # Hue runs from the first to the second angle, through 0 for red.",
            f"    hsv: {{hue_deg: {_list(hsv.hue_deg)}, saturation: {_list(hsv.saturation)}, "
            f"value: {_list(hsv.value)}}}",
            f"    area_px: {_list(marker.area_px or (12.0, 1e5))}",
        ]
        if marker.number > 1:
            lines += [f"    # They are named {marker.names[0]}, {marker.names[1]}, ..."]
            lines += [f"    number: {marker.number}"]
        if marker.start_px is not None:
            lines += [f"    start_px: [{', '.join(_list(place) for place in marker.start_px)}]"]
    tail = f"tail: {setup.tail}" if setup.tail else "# tail: name of the marker behind it"
    rate = f"frame_rate_hz: {setup.frame_rate_hz:g}" if setup.frame_rate_hz else "# frame_rate_hz: 240"
    lines += [f"# Passed over: {colour}" for colour in passed]
    lines += [
        "# The head marker gives the position, head and tail together the heading.",
        f"head: {setup.head_name}",
        tail,
        "# horizontal: camera above, x, y and yaw. vertical: camera at the side, x, z and pitch.",
        f"plane: {setup.plane}",
        *(FACING if setup.plane == "vertical" else ()),
        *POSE,
        *(NO_SCALE if setup.scale is None else _scale(setup.scale)),
        "# True frame rate, where the container's stamps are wrong.",
        rate,
        "# Longest dropout that is bridged, s.",
        f"max_gap_s: {setup.max_gap_s:g}",
    ]
    if setup.ignore_px:
        lines += ["# Motionless things of a marker's colour: [left, top, right, bottom].", "ignore_px:"]
        lines += [f"  - {_list(box)}" for box in setup.ignore_px]
    else:
        lines += ["# ignore_px: [[left, top, right, bottom]]"]
    return "\n".join(lines) + "\n"


def _scale(scale: setup_format.Scale) -> list[str]:
    keys = yamlio.dumps_flat(scale.model_dump(mode="json", exclude_none=True))
    return ["scale:", *(f"  {line}" for line in keys.splitlines())]


def _list(values: Any) -> str:
    return "[" + ", ".join(f"{v:g}" for v in values) + "]"


def sheet_of(run: Run) -> NDArray[np.uint8]:
    """A contact sheet: frames with the markers circled and named, ignored boxes crossed out."""
    tiles, track = [], run.track
    ranked = sorted(run.kept, key=lambda k: (not (k < len(track.times) and track.found[:, k].all()), k))
    for index in sorted(ranked[:_SHEET]):
        frame = run.kept[index]
        factor = _SHEET_WIDTH / frame.shape[1]
        tile = cv2.resize(frame, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        for box in run.setup.ignore_px:
            corners = [round(factor * v) for v in box]
            cv2.rectangle(tile, corners[:2], corners[2:], (200, 200, 200), 1)
            cv2.line(tile, corners[:2], corners[2:], (200, 200, 200), 1)
        for i, name in enumerate(track.names):
            if index < len(track.times) and track.found[i, index]:
                x, y = round(factor * track.x[i, index]), round(factor * track.y[i, index])
                radius = round(factor * float(np.sqrt(track.area[i, index] / np.pi))) + 5
                cv2.circle(tile, (x, y), radius, SEEN, 2, cv2.LINE_AA)
                write_text(tile, name, (x + radius + 3, y + 4), 0.5)
        write_text(tile, f"frame {index}", (8, tile.shape[0] - 8), 0.5)
        tiles.append(tile)
    while len(tiles) % 2:
        tiles.append(np.zeros_like(tiles[0]))
    sheet = np.vstack([np.hstack(tiles[i : i + 2]) for i in range(0, len(tiles), 2)])
    return np.asarray(cv2.cvtColor(sheet, cv2.COLOR_BGR2RGB), dtype=np.uint8)
