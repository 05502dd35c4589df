"""What a filmed run comes to: its speeds, accelerations and stroke."""

from __future__ import annotations

import math
from dataclasses import asdict, astuple, dataclass
from typing import Any

import numpy as np

from swimid.errors import UsageError
from swimid.logs import swimming
from swimid.logs.swimming import Swimming, Track
from swimid.logs.track_speed import Estimate
from swimid.notices import warn
from swimid.results import numbers
from swimid.results.evidence import Check, Table, check
from swimid.tracking.pose import SYSTEMATIC_PX, Pose

#: Names of the stroke's amplitudes by the plane of motion.
_NAMES = {
    "horizontal": {"sway": "sway", "turn": "yaw"},
    "vertical": {"sway": "heave", "turn": "pitch"},
}
METHODS = (
    "The path was averaged over a stroke and cut into blocks of one stroke. The steady part was found by the "
    "marginal standard error rule on both ends; speeds, accelerations and amplitudes are means over blocks, "
    "and their intervals Student's over the means of blocks."
)
REFERENCE = (
    "White, K. P. (1997). An effective truncation heuristic for bias reduction in simulation output. "
    "Simulation 69(6), 323-334. doi:10.1177/003754979706900601"
)


@dataclass(frozen=True)
class FilmedSwim:
    """Speeds, accelerations and stroke of a filmed run, and how they are told."""

    swimming: Swimming
    #: Horizontal or vertical.
    plane: str
    #: Of lengths: m, or px without a scale.
    unit: str

    def _rows(self) -> list[tuple[str, str, Estimate | None, str]]:
        """Key for the machine, name, value and unit of every figure."""
        figures, unit = self.swimming, self.unit
        up = "y" if self.plane == "horizontal" else "z"
        speed, rate = f"{unit}/s", f"{unit}/s^2"
        across = figures.acceleration_xy or (None, None)
        rows: list[tuple[str, str, Estimate | None, str]] = [
            ("path_speed", "path speed", figures.path_speed, speed),
            ("steady_speed", "steady speed", figures.advance if figures.steady else None, speed),
            ("advance_speed", self._advance_name(), figures.advance, speed),
            ("speed_change", "change of the advance speed", figures.change, speed),
            ("acceleration", "acceleration along the path", figures.acceleration, rate),
            ("acceleration_x", "acceleration in x", across[0], rate),
            (f"acceleration_{up}", f"acceleration in {up}", across[1], rate),
            ("stroke_frequency", "stroke frequency", figures.frequency_hz, "Hz"),
        ]
        for key, name in _NAMES[self.plane].items():
            if key in figures.amplitudes or figures.stroke is not None:
                kind = "rad" if key == "turn" else unit
                rows.append((f"{name}_amplitude", f"{name} amplitude", figures.amplitudes.get(key), kind))
        return rows

    def _advance_name(self) -> str:
        """Name of the advance speed."""
        return "displacement over time" if self.swimming.stroke is None else "advance speed, not steady"

    def to_dict(self) -> dict[str, Any]:
        """The figures for ``--json``; None where the window does not tell one."""
        figures = self.swimming
        out: dict[str, Any] = {"window": figures.window, "from_s": figures.begin_s, "to_s": figures.end_s}
        out["steady"] = figures.steady
        out["stroke_unknown"] = figures.unknown
        for key, _, value, kind in self._rows():
            out[key] = None if value is None else asdict(value) | {"unit": kind}
        return out

    def _shown(self) -> list[tuple[str, Estimate, str]]:
        """The figures a reader sees: angles in degrees, the steady speed once."""
        out = []
        for key, name, value, kind in self._rows():
            if value is None or (key == "advance_speed" and self.swimming.steady):
                continue
            if kind == "rad":
                kind, value = "deg", Estimate(*(math.degrees(1) * one for one in astuple(value)))
            out.append((name, value, kind))
        return out

    def _window(self) -> str:
        """The window in words, and whether the speed changes over it."""
        figures = self.swimming
        span = f"{figures.begin_s:.4g} to {figures.end_s:.4g} s"
        kinds = {"given": "as given", "whole track": "the whole track: no part of it is steady"}
        head = f"{span}, {kinds.get(figures.window, 'the steady part')}"
        if figures.advance is None or figures.change is None or figures.steady:
            return head
        change = 100 * figures.change.value / max(figures.advance.value, 1e-300)
        return f"{head}; the speed changes by {change:+.0f} % over it"

    def checks(self) -> list[Check]:
        """Whether the channels of the track agree on one stroke; warns where they do not."""
        stroke, doubt = self.swimming.stroke, self.swimming.doubt
        if stroke is None:
            return []
        if doubt:
            warn("SWM033", doubt)
        value = f"{stroke.frequency_hz:.4g} Hz{', doubted' if doubt else ''}"
        why = doubt or "Multiples of it counted in."
        return [check("One stroke", value, not doubt, "heading and path agree", why)]

    def table(self) -> Table:
        """The figures with their intervals."""
        rows: list[list[str | float | int | bool | None]] = [
            [name, *astuple(value), numbers.unit_text(kind)] for name, value, kind in self._shown()
        ]
        if self.swimming.stroke is None:
            rows.append(["stroke", f"unknown: {self.swimming.unknown}", None, None, None])
        return Table(
            id="swimming",
            title="Speed and stroke",
            columns=["quantity", "value", "95 % from", "to", "unit"],
            rows=rows,
            caption=f"Over {self._window()}. The path speed holds sway and turns; steady and advance speed "
            "are those of the path averaged over a stroke. Amplitudes are half of peak to peak of the "
            "fundamental, at the point the log is of.",
        )

    def headline(self) -> str:
        """Speed and stroke in one sentence; empty where neither is told."""
        figures = self.swimming
        speed = figures.advance if figures.steady else figures.path_speed
        said = []
        if speed is not None:
            kind = "steady speed" if figures.steady else "path speed"
            said.append(f"{kind} {numbers.number(speed.value, 4, f'{self.unit}/s')}")
        if figures.frequency_hz is not None:
            said.append(f"stroke {numbers.number(figures.frequency_hz.value, 4, 'Hz')}")
        text = ", ".join(said)
        return f" {text[0].upper()}{text[1:]}." if said else ""

    def lines(self) -> list[str]:
        """The figures for the terminal."""
        shown = self._shown()
        width = max((len(name) for name, _, _ in shown), default=0)
        out = [f"speed and stroke over {self._window()}:"]
        for name, value, kind in shown:
            text = f"{numbers.number(value.value, 4, kind)} (95 %: {numbers.interval(value.low, value.high)})"
            out.append(f"  {name:{width}}  {text}")
        if self.swimming.stroke is None:
            out.append(f"  stroke unknown: {self.swimming.unknown}")
        return out


def find(pose: Pose, plane: str, window_s: tuple[float | None, float | None]) -> FilmedSwim:
    """Speeds, accelerations and stroke of a pose, over a window (s) or the steady part.

    Raises
    ------
    UsageError
        The window holds next to nothing of the track.
    """
    seen = pose.times[pose.measured]
    begin, end = (v if v is not None else d for v, d in zip(window_s, (seen[0], seen[-1]), strict=True))
    inside = int(((seen >= begin) & (seen <= end)).sum())
    if inside < swimming.SHORTEST and window_s != (None, None):
        raise UsageError(
            f"only {inside} frames with the markers are between {begin:g} and {end:g} s; the track runs from "
            f"{seen[0]:.4g} to {seen[-1]:.4g} s",
            hint="give --from and --to in seconds from the first frame",
        )
    angle = None if pose.angle is None else pose.angle.position[0]
    path = pose.path
    middle = np.nanmedian(path.position, axis=1, keepdims=True)
    (x,), (y,) = pose.plane.to_image(*middle)
    error = SYSTEMATIC_PX * pose.plane.size_of_pixel(float(x), float(y))
    separation = math.inf if pose.separation is None else float(np.nanmedian(pose.separation))
    track = Track(
        time_s=pose.times,
        measured=pose.measured,
        raw=pose.raw,
        smooth=path.position,
        velocity=path.velocity,
        raw_angle=pose.raw_angle,
        angle=angle,
        error=error,
        angle_error=math.sqrt(2) * error / max(separation, 1e-12),
    )
    return FilmedSwim(swimming.figures(track, window_s), plane, pose.plane.unit)
