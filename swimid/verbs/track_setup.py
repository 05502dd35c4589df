"""``swimid track setup``: draft a setup file from a video."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.formats import atomic, yamlio
from swimid.formats.setup import Marker, Setup
from swimid.notices import warn
from swimid.progress import Progress, silent
from swimid.tracking import census, propose
from swimid.tracking.reader import Frame, Video
from swimid.tracking.run import Run, follow
from swimid.verbs.outcome import Outcome

#: Pictures on the contact sheet, and the width of each.
_SHEET, _SHEET_WIDTH = 4, 640
#: A proposal the tracker itself finds in fewer frames than this share is dropped.
_LEAST_FOUND = 0.05


@dataclass(frozen=True)
class Pick:
    """A marker shown by hand: its name and one of its pixels."""

    name: str
    x: float
    y: float


def track_setup(
    video: str | Path,
    *,
    output: str | Path,
    picks: tuple[Pick, ...] = (),
    frame: int = 0,
    metres_per_pixel: float | None = None,
    scale_points: tuple[float, float, float, float] | None = None,
    scale_distance_m: float | None = None,
    plane: str = "horizontal",
    fps: float | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> Outcome:
    """Propose markers, draw them and write a setup that ``track video`` takes as it is.

    Parameters
    ----------
    video : path
        The film to draft from.
    output : path
        The setup file; a PNG with the markers drawn in goes beside it.
    picks : tuple of Pick
        Markers shown by hand in ``frame``; head first, then tail. Without any they are
        proposed from what moves.
    frame : int
        The frame the picks are in.
    metres_per_pixel, scale_points, scale_distance_m
        The scale: a factor, or x1, y1, x2, y2 in pixels and their distance.
    plane : {"horizontal", "vertical"}
        Camera above, or at the side.
    fps : float, optional
        True frame rate, Hz, to be written into the setup.
    force : bool
        Replace an existing setup.
    progress : Progress
        Shows the passes over the video.

    Raises
    ------
    UsageError
        The setup exists and ``force`` was not given; scale options that contradict.
    InputError
        The video cannot be read.
    NoTrustworthyResult
        No marker can be proposed.
    """
    output = atomic.check_writable(output, inputs=(video,))
    if output.exists() and not force:
        raise UsageError(f"{output} exists", hint="name another file, or give --force to replace it")
    scale = _scale(metres_per_pixel, scale_points, scale_distance_m)
    video = Path(video)
    common: dict[str, Any] = {"scale": scale, "plane": plane, "frame_rate_hz": fps}
    if picks:
        setup, run = _by_hand(video, picks, frame, common, progress)
        remarks = ["picked by hand"] * len(setup.markers)
    else:
        setup, run, remarks = _unattended(video, common, progress)
    setup = _measured(setup, run)
    shares = {name: float(run.track.found[i].mean()) for i, name in enumerate(run.track.names)}
    for name, share in shares.items():
        if share < _LEAST_FOUND:
            warn("SWM040", f"marker '{name}' is found in {100 * share:.1f} % of the frames only")
    atomic.write_text(output, _text(setup, shares, remarks, video.name))
    sheet = output.with_suffix(".markers.png")
    _draw(sheet, run, setup)
    lines = [
        f"{name}: found in {100 * share:.1f} % of the frames, hue {_hue(marker)}, area {_area(marker)} px"
        for (name, share), marker in zip(shares.items(), setup.markers, strict=True)
    ]
    lines.append(
        f"head {setup.head or setup.marker_names[0]}"
        + (f", tail {setup.tail}" if setup.tail else "; no tail, so no yaw")
    )
    if setup.scale is None:
        lines.append("no scale yet: positions will be in pixels. Fill in 'scale' in the file")
    lines.append(
        f"look at {sheet.name}, then: swimid track video {video.name} --setup {output.name} -o run.csv"
    )
    result = {
        "markers": [m.model_dump(mode="json", exclude_none=True) for m in setup.markers],
        "head": setup.head,
        "tail": setup.tail,
        "found_share": shares,
    }
    return Outcome("track setup", "\n".join(lines), result, [output, sheet])


def _scale(
    factor: float | None, points: tuple[float, float, float, float] | None, distance_m: float | None
) -> dict[str, Any] | None:
    if factor is not None and (points is not None or distance_m is not None):
        raise UsageError(
            "contradicting scales: give --metres-per-pixel, or --scale-points with --scale-distance-m"
        )
    if (points is None) != (distance_m is None):
        raise UsageError("--scale-points and --scale-distance-m go together")
    for name, value in (("--metres-per-pixel", factor), ("--scale-distance-m", distance_m)):
        if value is not None and not value > 0:
            raise UsageError(f"{name} {value:g} must be above 0")
    if factor is not None:
        return {"metres_per_pixel": factor}
    if points is None:
        return None
    if points[:2] == points[2:]:
        raise UsageError("the two --scale-points are the same")
    return {"points_px": [list(points[:2]), list(points[2:])], "distance_m": distance_m}


def _setup(markers: list[Marker], head: str | None, tail: str | None, common: dict[str, Any]) -> Setup:
    data = {
        "format": "swimid-setup/1",
        "markers": [m.model_dump(exclude_none=True) for m in markers],
        "head": head,
        "tail": tail,
        **common,
    }
    return Setup.model_validate(data)


def _unattended(video: Path, common: dict[str, Any], progress: Progress) -> tuple[Setup, Run, list[str]]:
    with progress(f"looking at {video.name}") as step:
        samples = propose.sample(video, step=step)
    found = propose.candidates(samples)
    tried = []
    for first in found[:3]:
        second = propose.partner(first, found)
        pair = (
            [first]
            if second is None
            else [first, second]
            if propose.leads(first, second)
            else [second, first]
        )
        names: list[str] = []
        for candidate in pair:
            names.append(propose.name_of(candidate, names))
        markers = [propose.as_marker(c, n) for c, n in zip(pair, names, strict=True)]
        setup = _setup(markers, names[0], names[1] if len(names) > 1 else None, common)
        still = [box for candidate in pair for box in candidate.still if not _crossed(box, pair)]
        setup = setup.model_copy(update={"ignore_px": still})
        with progress(f"trying {', '.join(names)}") as step:
            run = follow(video, setup, step=step)
        share = float(run.track.found.all(axis=0).mean())
        expected = min(c.presence for c in pair)
        if share >= max(_LEAST_FOUND, 0.3 * expected):
            remarks = [_remark(c) for c in pair]
            return run.setup, run, remarks
        tried.append(f"{' and '.join(names)} ({100 * share:.1f} % of the frames)")
    raise NoTrustworthyResult(
        f"no marker of {video.name} can be followed; tried {'; '.join(tried)}. "
        f"{census.describe_colours(samples.frames[::6])}",
        hint="pick the markers by hand: --marker name@x,y with --frame",
    )


def _crossed(box: tuple[float, float, float, float], pair: list[propose.Candidate]) -> bool:
    """Whether a marker was seen inside a box: it must not be ignored then."""
    left, top, right, bottom = box
    for candidate in pair:
        reach = np.sqrt(candidate.area_px[1] / 3)
        x, y = candidate.place.T
        if np.any((x > left - reach) & (x < right + reach) & (y > top - reach) & (y < bottom + reach)):
            return True
    return False


def _remark(candidate: propose.Candidate) -> str:
    text = f"score {candidate.score:.2f}, seen in {100 * candidate.presence:.0f} % of the samples"
    if candidate.like > 1:
        text += f"; {candidate.like} patches of this colour move together: the largest is followed"
    return text


def _by_hand(
    video: Path, picks: tuple[Pick, ...], index: int, common: dict[str, Any], progress: Progress
) -> tuple[Setup, Run]:
    names = [pick.name for pick in picks]
    if len(set(names)) < len(names):
        raise UsageError(f"two markers are named alike: {', '.join(names)}")
    picture = _frame(video, index)
    markers = [propose.picked(picture, p.name, p.x, p.y, path=video, index=index) for p in picks]
    setup = _setup(markers, names[0], names[1] if len(names) > 1 else None, common)
    with progress(f"trying {', '.join(names)}") as step:
        return setup, follow(video, setup, step=step)


def _frame(video: Path, index: int) -> Frame:
    if index < 0:
        raise UsageError(f"--frame {index} must not be negative")
    count = 0
    for count, (_, frame) in enumerate(Video(video).frames(), start=1):
        if count - 1 == index:
            return frame
    raise InputError(f"has {count} frames; frame {index} does not exist", file=video)


def _measured(setup: Setup, run: Run) -> Setup:
    """The setup with area ranges from what the tracker measured."""
    markers = []
    for marker in setup.markers:
        i = run.track.names.index(marker.names[0])
        whole = run.track.found[i] & ~run.track.at_edge[i]
        if whole.sum() >= 10:
            low, high = np.percentile(run.track.area[i, whole], [2, 98])
            marker = marker.model_copy(
                update={"area_px": (float(max(round(0.3 * low), 4)), float(round(2.5 * high)))}
            )
        markers.append(marker)
    return setup.model_copy(update={"markers": markers})


def _hue(marker: Marker) -> str:
    low, high = marker.colour_range().hue_deg
    return f"{low:g}..{high:g} deg"


def _area(marker: Marker) -> str:
    return "any" if marker.area_px is None else f"{marker.area_px[0]:g}..{marker.area_px[1]:g}"


def _text(setup: Setup, shares: dict[str, float], remarks: list[str], video: str) -> str:
    """The setup as commented YAML."""
    lines = [
        f"# Drafted by swimid track setup from {video}; edit what is wrong. Every key: docs/tracking.md",
        f"format: {setup.format}",
        "markers:",
    ]
    for marker, remark in zip(setup.markers, remarks, strict=True):
        hsv = marker.colour_range()
        low, high = marker.area_px or (12.0, 1e5)
        lines += [
            f"  - name: {marker.name}",
            f"    # Found in {100 * shares[marker.names[0]]:.1f} % of the frames; {remark}.",
            "    # Hue runs from the first to the second angle, through 0 for red.",
            f"    hsv: {{hue_deg: {_list(hsv.hue_deg)}, saturation: {_list(hsv.saturation)}, "
            f"value: {_list(hsv.value)}}}",
            f"    area_px: [{low:g}, {high:g}]",
        ]
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


def _draw(path: Path, run: Run, setup: Setup) -> None:
    """A contact sheet: frames with the markers circled and named, ignored boxes crossed out."""
    tiles = []
    everywhere = np.atleast_1d(run.track.found.all(axis=0))
    ranked = sorted(run.kept, key=lambda k: (not (k < len(everywhere) and everywhere[k]), k))
    for index in sorted(ranked[:_SHEET]):
        frame = run.kept[index].copy()
        factor = _SHEET_WIDTH / frame.shape[1]
        tile = cv2.resize(frame, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        for box in setup.ignore_px:
            corners = [round(factor * v) for v in box]
            cv2.rectangle(tile, corners[:2], corners[2:], (200, 200, 200), 1)
            cv2.line(tile, corners[:2], corners[2:], (200, 200, 200), 1)
        for i, name in enumerate(run.track.names):
            if index < len(everywhere) and run.track.found[i, index]:
                x, y = factor * run.track.x[i, index], factor * run.track.y[i, index]
                radius = round(factor * float(np.sqrt(run.track.area[i, index] / np.pi))) + 5
                cv2.circle(tile, (round(x), round(y)), radius, (0, 159, 230), 2, cv2.LINE_AA)
                _label(tile, name, (round(x) + radius + 3, round(y) + 4))
        _label(tile, f"frame {index}", (8, tile.shape[0] - 8))
        tiles.append(tile)
    while len(tiles) % 2:
        tiles.append(np.zeros_like(tiles[0]))
    sheet = np.vstack([np.hstack(tiles[i : i + 2]) for i in range(0, len(tiles), 2)])
    ok, data = cv2.imencode(".png", sheet)
    assert ok
    with atomic.replacing(path) as temporary:
        temporary.write_bytes(data.tobytes())


def _label(image: Frame, text: str, where: tuple[int, int]) -> None:
    for shade, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(image, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.5, shade, width, cv2.LINE_AA)
