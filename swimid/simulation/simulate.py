"""``simulate``: any robot from any parameter file, as a log, and as a film where it has links."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, UsageError
from swimid.files import atomic
from swimid.notices import warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import numbers
from swimid.simulation import animation
from swimid.simulation import cases as simulate_cases
from swimid.simulation import run as simulation
from swimid.simulation.options import RUN, SimulateOptions
from swimid.simulation.run import Simulated
from swimid.simulation.simulated import Simulation
from swimid.swimmer import stroke_cycles

#: A change of speed from beat to beat above this share is told.
UNSTEADY = 0.005
#: What a trial of many says in its line, where it has it.
BRIEF = ("mean_speed_m_s", "peak_yaw_rate_rad_s", "peak_pitch_rate_rad_s", "turning_radius_m")


@takes(SimulateOptions)
def simulate(
    *,
    options: SimulateOptions,
    output: Path | None = None,
    allow: Callable[[Path], object] = atomic.check_writable,
    progress: Progress = silent,
) -> Simulation:
    """Simulate a robot.

    The beat is given as ``drive`` of a trials file gives it. An input log has joint angles or commands that
    drive a robot, a force, or the input column of a discrete-time model; the run is then as long as the log.

    Parameters
    ----------
    output : Path, optional
        Log to write; for several trials a folder.
    allow : callable
        Called with every file before it is written; raises where that must not be.
    progress : Progress

    Raises
    ------
    UsageError, InputError
        For options that do not fit together and for bad files.
    NoTrustworthyResult
        When the simulation breaks down.
    """
    if options.trials is None:
        if options.trial is not None:
            raise UsageError("--trial belongs to --trials")
        cases = [simulate_cases.of_options(options)]
    else:
        _insist_on_trials_alone(options)
        cases = simulate_cases.of_trials(options.trials, options, options.trial)
    animate = options.animate
    targets = simulation.places(output, [c.id for c in cases])
    if animate is not None:
        if len(cases) > 1:
            raise UsageError("an animation shows one trial: name it with --trial")
        if cases[0].applied.model.body is None:
            raise UsageError("an animation needs a robot with links in one plane")
        if animate.suffix.lower() not in animation.ENDINGS:
            raise UsageError(
                f"'{animate.name}' can be no animation",
                hint=f"let it end in {' or '.join(animation.ENDINGS)}",
            )
        allow(animate)
    folder = output if output is not None and targets != [output] else None
    if folder is not None and not folder.parent.is_dir():
        raise InputError(f"the folder {folder.parent} does not exist", file=folder)
    for place in targets:
        if folder is None or folder.is_dir():
            allow(place)
    done = []
    with progress("simulating", total=len(cases)) as step:
        for case in cases:
            done.append(simulation.run(case))
            step()
    outputs = []
    for place, one in zip(targets, done, strict=False):
        if folder is not None:
            folder.mkdir(exist_ok=True)
        simulation.write(place, one)
        outputs.append(place)
    remark = ""
    if animate is not None:
        remark = animation.write(animate, _film(done[0]), view=options.view, progress=progress)
        outputs.append(animate)
    _warn_unknown(done)
    text = _summary(done, options, remark)
    return Simulation("simulate", text, _result(done, options), outputs, document=done)


def _insist_on_trials_alone(options: SimulateOptions) -> None:
    """Refuse options that describe a run beside trials, which bring their own."""
    for name, entry in options.declared().items():
        if entry.part == RUN and getattr(options, name) != entry.default:
            raise UsageError(f"{entry.flag} has no place beside --trials: the trials bring their own drive")


def _film(done: Simulated) -> animation.Film:
    case = done.case
    model, body = case.applied.model.swimmer, case.applied.model.body
    assert model is not None
    assert body is not None
    x, y, heading = body.frames(case.values, done.columns)
    front, _ = body.straight(case.values)
    length = body.length(case.values)
    passive = {a.link for a in body.passive}
    drive = case.metadata.get("drive")
    title = model.robot.name
    if isinstance(drive, dict):
        title += f"  {drive['frequency_hz']:g} Hz, {drive['amplitude_deg']:g} deg"
    return animation.Film(
        time_s=case.trial.time_s,
        x_m=x,
        y_m=y,
        heading_rad=heading,
        links=[
            animation.Link(own, float(begin), i in passive)
            for i, (own, begin) in enumerate(zip(body.lengths_m, front, strict=True))
        ],
        length_m=length,
        width_m=model.robot.body.width_m or animation.FULLNESS * length,
        title=title,
        tapered=body.free,
    )


# ------------------------------------------------------------ telling


def _warn_unknown(done: Sequence[Simulated]) -> None:
    lost = done[0].case.applied.without_error() if done[0].quantities else []
    if lost:
        warn(
            "SWM055",
            f"{', '.join(lost)} {'has' if len(lost) == 1 else 'have'} no standard error in the parameter "
            "file: what is not known of them is not in the uncertainties given here",
        )


def label(name: str) -> str:
    """A quantity's name in words, without its unit."""
    if name == "mean_speed_BL_s":
        return "in body lengths"
    name = name.removesuffix("_BL")
    bare, _ = numbers.split_unit(name)
    return bare.replace("_", " ")


def text(value: float, stderr: float | None, unit: str) -> str:
    """A quantity as people read it: angles in degrees."""
    if unit in ("rad", "rad/s"):
        factor = 180.0 / math.pi
        value, stderr, unit = value * factor, None if stderr is None else stderr * factor, f"deg{unit[3:]}"
    if not stderr:
        return numbers.number(value, 4, unit)
    return numbers.measured(value, stderr, unit)


def _summary(done: Sequence[Simulated], options: SimulateOptions, remark: str) -> str:
    lines = []
    if len(done) == 1:
        lines += _one(done[0], options)
    else:
        lines.append(f"{done[0].case.metadata['robot']}: {len(done)} trials")
        width = max(len(d.case.id) for d in done)
        for d in done:
            lines.append(f"  {d.case.id:<{width}}  {', '.join(_brief(d))}")
    changes = _worst_changes(done)
    if changes:
        shown = ", ".join(
            f"{label(name)} {numbers.number(largest, 2, numbers.split_unit(name)[1])}"
            for name, (largest, _) in changes.items()
            if largest > 0
        )
        lines += ["", f"  halving the step changes at most: {shown}"]
    if remark:
        lines.append(f"  {remark}")
    return "\n".join(lines)


def _brief(done: Simulated) -> list[str]:
    """What a trial of many comes to, or where it ends."""
    if done.quantities:
        last = [n for n in done.quantities if n.startswith("cycle_")][-len(stroke_cycles.QUANTITIES) :]
        found = [(n, done.quantities[n]) for n in (*BRIEF, *last) if n in done.quantities]
        return [f"{label(n)} {text(q.value, q.stderr, q.unit)}" for n, q in found]
    channels = [c for c in done.case.applied.model.channels if c.name in done.columns]
    if done.case.per_run:
        name, v = channels[0].name, done.columns[channels[0].name]
        low, high = numbers.number(float(np.min(v)), 4), numbers.number(float(np.max(v)), 4, channels[0].unit)
        return [f"{len(v)} runs, {label(name)} {low} to {high}"]
    ends = [f"{label(c.name)} {text(float(done.columns[c.name][-1]), None, c.unit)}" for c in channels]
    return [f"after {done.case.trial.time_s[-1] - done.case.trial.time_s[0]:.4g} s", *ends]


def _one(done: Simulated, options: SimulateOptions) -> list[str]:
    case = done.case
    place = simulate_cases.place(options)
    source = place.name if place else "the robot file's values"
    lines = [f"{case.metadata['robot']}, {source}"]
    drive = case.metadata.get("drive")
    if isinstance(drive, dict) and "stroke" in drive:
        parts = [f"{drive['stroke']} at {drive['frequency_hz']:.4g} Hz"]
        parts += [f"scaled by {drive['scale']:g}"] if drive["scale"] != 1.0 else []
        lines.append(f"  {', '.join(parts)}, {case.trial.time_s[-1] - case.trial.time_s[0]:g} s")
    if isinstance(drive, dict) and "waveform" in drive:
        parts = [f"{drive['waveform']} {drive['frequency_hz']:g} Hz", f"{drive['amplitude_deg']:g} deg"]
        parts += [f"bias {drive['bias_deg']:g} deg"] if drive["bias_deg"] else []
        parts += [f"asymmetry {drive['asymmetry']:g}"] if drive["asymmetry"] else []
        lines.append(f"  {', '.join(parts)}, {case.trial.time_s[-1] - case.trial.time_s[0]:g} s")
    shown = {n: q for n, q in done.quantities.items() if n != "speed_change_per_beat_m_s"}
    width = max((len(label(n)) for n in shown), default=0)
    for name, q in shown.items():
        lines.append(f"  {label(name):<{width}}  {text(q.value, q.stderr, q.unit)}")
    if not shown:
        lines.append(f"  {', '.join(_brief(done))}")
    speed, change = (done.quantities.get(n) for n in ("mean_speed_m_s", "speed_change_per_beat_m_s"))
    if speed and change and abs(change.value) > UNSTEADY * abs(speed.value):
        percent = 100 * change.value / speed.value
        lines.append(f"  not yet steady: the speed changes by {numbers.fixed(percent, 1)} % a beat")
    if shown and not case.applied.uncertain()[0]:
        lines.append("  no uncertainty known")
    return lines


def _worst_changes(done: Sequence[Simulated]) -> dict[str, tuple[float, float]]:
    worst: dict[str, tuple[float, float]] = {}
    for one in done:
        for name, change in one.step.items():
            before = worst.get(name, (0.0, 0.0))
            worst[name] = (max(before[0], change.largest), max(before[1], change.share))
    return worst if any(largest > 0 for largest, _ in worst.values()) else {}


def _result(done: Sequence[Simulated], options: SimulateOptions) -> dict[str, Any]:
    applied = done[0].case.applied
    model = applied.model
    values = done[0].case.values
    place = simulate_cases.place(options)
    return {
        "model": model.name,
        "robot": done[0].case.metadata["robot"],
        "params": None if place is None else str(place),
        "parameters": {
            p.name: float(v) for p, v in zip(model.parameters, values, strict=True) if not p.per_trial
        },
        "uncertain": applied.uncertain()[0],
        "step_limit": simulation.STEP_LIMIT,
        "runs": [
            {
                "id": d.case.id,
                "metadata": dict(d.case.metadata),
                "samples": len(d.case.trial.time_s),
                "quantities": {
                    n: {"value": q.value, "stderr": q.stderr, "unit": q.unit} for n, q in d.quantities.items()
                },
                "step_check": {
                    n: {"largest_change": c.largest, "share_of_range": c.share} for n, c in d.step.items()
                },
                "last": {
                    n: float(v[-1])
                    for n, v in d.columns.items()
                    if not isinstance(v[-1], str) and np.isfinite(v[-1])
                },
            }
            for d in done
        ],
    }
