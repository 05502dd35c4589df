"""Figures of ``swimid track imu``: velocity, position and attitude with their bands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.inertial.aiding import AXES
from swimid.inertial.record import Array
from swimid.inertial.run import ANGLES, Run
from swimid.inertial.sensor import BAND, DEG
from swimid.logs.rotation import angles
from swimid.results import blocks
from swimid.results.evidence import Figure, Mark, Panel, Span, Trace, thinned

#: Points a curve with a band is drawn with.
POINTS = 800


def figures(run: Run) -> list[Figure]:
    """The figures of a run."""
    if run.paper is not None:
        return [_paper(run)]
    motion = run.motion
    assert motion is not None
    seen = None
    if run.poses is not None and run.fused is not None:
        seen = (run.poses.time_s + run.fused.offset.value_s, run.poses.position)
    turn = np.column_stack(angles(motion.rotation)) / DEG
    dots = "" if seen is None else "; dots are what the other log saw"
    out = [
        Figure(
            id="velocity",
            title="Body velocity",
            caption="Surge, sway and heave with the 95 % band; rests shaded. Good: a band narrow against the "
            "motion.",
            panels=_panels(run, AXES, "m/s", motion.body_velocity, motion.body_velocity_sd),
        ),
        Figure(
            id="position",
            title="Position",
            caption=f"Position with its 95 % band{dots}. Good: dots inside the band, and a band that ends "
            "before the way does.",
            panels=_panels(run, "xyz", "m", motion.position, motion.position_sd, seen),
        ),
        _growth(run),
        Figure(
            id="attitude",
            title="Attitude",
            caption="Roll, pitch (nose up) and yaw with the 95 % band. Good: roll and pitch come back after "
            "the run.",
            panels=_panels(run, ANGLES, "deg", turn, motion.angle_sd / DEG),
        ),
        _track(run),
    ]
    if run.surge_osc is not None and run.surge_osc_sd is not None:
        sd = run.surge_osc_sd[:, None]
        out.append(
            Figure(
                id="oscillation",
                title="Surge within a stroke",
                caption=f"Surge above {run.cutoff_hz:.2f} Hz with its 95 % band: the part that needs no help "
                "from outside.",
                panels=_panels(run, ["surge"], "m/s", run.surge_osc[:, None], sd),
            )
        )
    return out


def _few(*series: Array) -> list[Array]:
    step = max(len(series[0]) // POINTS, 1)
    return [s[::step] for s in series]


def _panels(
    run: Run,
    names: Sequence[str],
    unit: str,
    values: Array,
    sds: Array,
    seen: tuple[Array, Array] | None = None,
) -> list[Panel]:
    """Every column over time with its band; ``seen``: times and columns of the other log."""
    t = run.record.time_s
    spans = [Span(start=float(t[r.first]), end=float(t[r.last - 1]), label="rest") for r in run.still.rests]
    panels = []
    for k, name in enumerate(names):
        value, sd = values[:, k], sds[:, k]
        time, low, high = _few(t, value - BAND * sd, value + BAND * sd)
        x, y = thinned(t, value)
        traces = [
            Trace(x=x, y=y, label="estimate", group=0),
            Trace(x=time, y=0.5 * (low + high), lower=low, upper=high, group=0),
        ]
        there = np.isfinite(seen[1][:, k]) if seen is not None else np.zeros(1, dtype=bool)
        if seen is not None and there.any():
            traces.append(_other_log(seen[0][there], seen[1][there, k]))
        panels.append(Panel(x_label="time (s)", y_label=f"{name} ({unit})", traces=traces, spans=spans))
    return panels


def _other_log(x: Array, y: Array) -> Trace:
    x, y = _few(x, y)
    return Trace(x=x, y=y, label="other log", style="points", group=1)


def _growth(run: Run) -> Figure:
    assert run.motion is not None
    traces = []
    for k, name in enumerate("xyz"):
        x, y = _few(run.motion.time_s, np.maximum(BAND * run.motion.position_sd[:, k], 1e-5))
        traces.append(Trace(x=x, y=y, label=name))
    marks = [Mark(at=0.1, label="0.1 m")]
    if run.trust is not None and run.trust.until_s is not None:
        marks.append(Mark(at=run.trust.until_s, axis="x", label="trusted until"))
    title = "How far the position can be trusted"
    caption = "Half-width of the 95 % band of each coordinate. Left of the mark the path can be used."
    return blocks.figure("band", title, caption, "time (s)", "± (m)", traces, y_scale="log", marks=marks)


def _track(run: Run) -> Figure:
    assert run.motion is not None
    trusted = slice(None)
    if run.trust is not None and run.trust.until_s is not None:
        trusted = slice(0, max(int(np.searchsorted(run.motion.time_s, run.trust.until_s)), 2))
    x, y = _few(*run.motion.position[trusted, :2].T)
    traces = [Trace(x=x, y=y, label="estimate", group=0)]
    if run.poses is not None:
        there = np.isfinite(run.poses.position[:, :2]).all(axis=1)
        if there.any():
            traces.append(_other_log(*run.poses.position[there, :2].T))
    caption = "The path to scale, as far as it can be trusted."
    return blocks.figure("track", "Track from above", caption, "x (m)", "y (m)", traces, equal_aspect=True)


def _paper(run: Run) -> Figure:
    assert run.paper is not None
    panels = []
    for name, unit in (("acceleration", "m/s²"), ("velocity", "m/s"), ("position", "m")):
        columns = [thinned(run.record.time_s, column) for column in getattr(run.paper, name).T]
        traces = [Trace(x=x, y=y, label=axis) for axis, (x, y) in zip("xyz", columns, strict=True)]
        panels.append(Panel(x_label="time (s)", y_label=f"{name} ({unit})", traces=traces))
    return Figure(
        id="paper",
        title="The paper's steps",
        caption="Earth axes: acceleration without its mean (Eq 10), velocity (Eq 12) "
        "and position (Eq 13). No uncertainty is stated.",
        panels=panels,
    )
