"""Figures of ``swimid track imu``: velocity, position and attitude with their bands."""

from __future__ import annotations

from typing import Any

import numpy as np

from swimid.inertial.alignment import Poses
from swimid.inertial.record import Array
from swimid.inertial.run import Run
from swimid.inertial.sensor import DEG
from swimid.inertial.trust import BAND
from swimid.logs.rotation import angles
from swimid.results import evidence as ev

#: Points a curve with a band is drawn with.
POINTS = 800


def figures(run: Run, poses: Poses | None) -> list[ev.Figure]:
    """The figures of a run."""
    if run.paper is not None:
        return [_paper(run)]
    assert run.motion is not None
    found = run.motion
    t = found.time_s
    rest = [ev.Span(start=float(t[r.first]), end=float(t[r.last - 1]), label="rest") for r in run.still.used]
    times = None if poses is None or run.fused is None else poses.time_s + run.fused.offset.value_s
    out = [
        ev.Figure(
            id="velocity",
            title="Body velocity",
            caption="Surge, sway and heave with the 95 % band; rests shaded. Good: a band "
            "narrow against the motion.",
            panels=[
                _panel(t, f"{name} (m/s)", found.body_velocity[:, k], found.body_velocity_sd[:, k], rest)
                for k, name in enumerate(("surge", "sway", "heave"))
            ],
        ),
        ev.Figure(
            id="position",
            title="Position",
            caption="Position with its 95 % band"
            + ("" if times is None else "; dots are what the other log saw")
            + ". Good: dots inside the band, and a band that ends before the way does.",
            panels=[
                _panel(
                    t,
                    f"{name} (m)",
                    found.position[:, k],
                    found.position_sd[:, k],
                    rest,
                    None if times is None or poses is None else (times, poses.position[:, k]),
                )
                for k, name in enumerate("xyz")
            ],
        ),
        _growth(run),
        ev.Figure(
            id="attitude",
            title="Attitude",
            caption="Roll, pitch (nose up) and yaw with the 95 % band. Good: roll and "
            "pitch come back after the run.",
            panels=[
                _panel(t, f"{name} (deg)", a / DEG, found.angle_sd[:, k] / DEG, rest)
                for k, (name, a) in enumerate(
                    zip(("roll", "pitch", "yaw"), angles(found.rotation), strict=True)
                )
            ],
        ),
        _track(run, poses),
    ]
    if run.surge_osc is not None and run.surge_osc_sd is not None:
        sd = np.full(len(t), run.surge_osc_sd)
        out.append(
            ev.Figure(
                id="oscillation",
                title="Surge within a stroke",
                caption=f"Surge above {run.cutoff_hz:.2f} Hz with its 95 % band: the part that "
                f"needs no help from outside.",
                panels=[_panel(t, "surge (m/s)", run.surge_osc, sd, rest)],
            )
        )
    return out


def _few(*series: Array) -> list[Array]:
    step = max(len(series[0]) // POINTS, 1)
    return [s[::step] for s in series]


def _panel(
    t: Array,
    label: str,
    value: Array,
    sd: Array,
    rest: list[ev.Span],
    seen: tuple[Array, Array] | None = None,
) -> ev.Panel:
    time, low, high = _few(t, value - BAND * sd, value + BAND * sd)
    x, y = ev.thinned(t, value)
    traces = [
        ev.Trace(x=x, y=y, label="estimate", group=0),
        ev.Trace(x=time, y=0.5 * (low + high), lower=low, upper=high, group=0),
    ]
    if seen is not None and np.isfinite(seen[1]).any():
        there = np.isfinite(seen[1])
        a, b = _few(seen[0][there], seen[1][there])
        traces.append(ev.Trace(x=a, y=b, label="other log", style="points", group=1))
    return ev.Panel(x_label="time (s)", y_label=label, traces=traces, spans=rest)


def _growth(run: Run) -> ev.Figure:
    assert run.motion is not None
    t = run.motion.time_s
    traces = []
    for k, name in enumerate("xyz"):
        x, y = _few(t, np.maximum(BAND * run.motion.position_sd[:, k], 1e-5))
        traces.append(ev.Trace(x=x, y=y, label=name))
    marks = [ev.Mark(at=0.1, label="0.1 m")]
    if run.trust is not None and run.trust.until_s is not None:
        marks.append(ev.Mark(at=run.trust.until_s, axis="x", label="trusted until"))
    return ev.Figure(
        id="band",
        title="How far the position can be trusted",
        caption="Half-width of the 95 % band of each coordinate. Left of the mark the path can be used.",
        panels=[ev.Panel(x_label="time (s)", y_label="± (m)", y_scale="log", traces=traces, marks=marks)],
    )


def _track(run: Run, poses: Poses | None) -> ev.Figure:
    assert run.motion is not None
    trusted = slice(None)
    if run.trust is not None and run.trust.until_s is not None:
        trusted = slice(0, max(int(np.searchsorted(run.motion.time_s, run.trust.until_s)), 2))
    x, y = _few(*run.motion.position[trusted, :2].T)
    traces = [ev.Trace(x=x, y=y, label="estimate", group=0)]
    if poses is not None and np.isfinite(poses.position[:, :2]).all(axis=1).any():
        there = np.isfinite(poses.position[:, :2]).all(axis=1)
        a, b = _few(*poses.position[there, :2].T)
        traces.append(ev.Trace(x=a, y=b, label="other log", style="points", group=1))
    return ev.Figure(
        id="track",
        title="Track from above",
        caption="The path to scale, as far as it can be trusted.",
        panels=[ev.Panel(x_label="x (m)", y_label="y (m)", traces=traces, equal_aspect=True)],
    )


def _paper(run: Run) -> ev.Figure:
    assert run.paper is not None
    t = run.record.time_s
    panels: list[Any] = []
    for label, values in (
        ("acceleration (m/s²)", run.paper.acceleration),
        ("velocity (m/s)", run.paper.velocity),
        ("position (m)", run.paper.position),
    ):
        traces = []
        for k, name in enumerate("xyz"):
            x, y = ev.thinned(t, values[:, k])
            traces.append(ev.Trace(x=x, y=y, label=name))
        panels.append(ev.Panel(x_label="time (s)", y_label=label, traces=traces))
    return ev.Figure(
        id="paper",
        title="The paper's steps",
        caption="Earth axes: acceleration without its mean (Eq 10), velocity (Eq 12) "
        "and position (Eq 13). No uncertainty is stated.",
        panels=panels,
    )
