"""The drafted setup file as commented YAML."""

from __future__ import annotations

from typing import Any

from swimid.files import yamlio
from swimid.tracking.propose import Passed
from swimid.tracking.setup import Setup


def write(
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
        low, high = marker.area_px or (12.0, 1e5)
        found = ", ".join(f"{100 * shares[name]:.1f} %" for name in marker.names)
        lines += [
            f"  - name: {marker.name}",
            f"    # Found in {found} of the frames; {remark}.",
            "    # Hue runs from the first to the second angle, through 0 for red.",
            f"    hsv: {{hue_deg: {_list(hsv.hue_deg)}, saturation: {_list(hsv.saturation)}, "
            f"value: {_list(hsv.value)}}}",
            f"    area_px: [{low:g}, {high:g}]",
        ]
        if marker.number > 1:
            lines += [
                f"    # They are named {marker.names[0]}, {marker.names[1]}, ...",
                f"    number: {marker.number}",
            ]
        if marker.start_px is not None:
            lines += [f"    start_px: [{', '.join(_list(place) for place in marker.start_px)}]"]
    lines += [f"# Passed over: {colour}" for colour in passed]
    lines += ["# The head marker gives the position, head and tail together the heading."]
    lines += [f"head: {setup.head or setup.marker_names[0]}"]
    lines += [f"tail: {setup.tail}" if setup.tail else "# tail: name of the marker behind it"]
    lines += [
        "# horizontal: camera above, x, y and yaw. vertical: camera at the side, x, z and pitch.",
        f"plane: {setup.plane}",
    ]
    if setup.plane == "vertical":
        lines += [
            "# Which way in the picture the robot faces and x runs: right, left, or auto (tail to head).",
            f"facing: {setup.facing}",
        ]
    lines += [
        "# The pose is that of the head marker; that of the robot's reference point with at_m of head and",
        "# tail, or with the name of a robot whose file names markers like these.",
        "# robot: sealion",
    ]
    if setup.scale is not None:
        lines += ["scale:"]
        lines += [
            f"  {line}"
            for line in yamlio.dumps_flat(setup.scale.model_dump(mode="json", exclude_none=True)).splitlines()
        ]
    else:
        lines += [
            "# Without a scale positions are in pixels. One of:",
            "# scale: {metres_per_pixel: 0.0015}",
            "# scale: {points_px: [[x1, y1], [x2, y2]], distance_m: 1.0}",
            "# scale: {points_px: [four corners], points_m: [the same corners]}",
        ]
    lines += [
        "# True frame rate, where the container's stamps are wrong.",
        f"frame_rate_hz: {setup.frame_rate_hz:g}" if setup.frame_rate_hz else "# frame_rate_hz: 240",
        "# Longest dropout that is bridged, s.",
        f"max_gap_s: {setup.max_gap_s:g}",
    ]
    if setup.ignore_px:
        lines += ["# Motionless things of a marker's colour: [left, top, right, bottom].", "ignore_px:"]
        lines += [f"  - {_list(box)}" for box in setup.ignore_px]
    else:
        lines += ["# ignore_px: [[left, top, right, bottom]]"]
    return "\n".join(lines) + "\n"


def _list(values: Any) -> str:
    return "[" + ", ".join(f"{v:g}" for v in values) + "]"
