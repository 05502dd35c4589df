"""``simulate``: any robot from any parameter file, as a log, and as a film where it has links."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, UsageError
from swimid.files import atomic
from swimid.files.provenance import Input
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import numbers
from swimid.simulation import animation, cases, run
from swimid.simulation.applied import Quantity
from swimid.simulation.options import RUN, SimulateOptions
from swimid.simulation.run import Case, Simulated, Simulation
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
    """Simulate a robot with given coefficients: its motion over time, and what the run comes to.

    The beat is given as ``drive`` of a trials file gives it. An input log has joint angles or commands that
    drive a robot, a force, or the input column of a discrete-time model; the run is then as long as the log.
    Standard errors are those of the coefficients alone; how far the model itself is off,
    :func:`swimid.compare` says.

    Parameters
    ----------
    output : Path, optional
        Log to write; for several trials a folder.
    allow : callable
        Called with every file before it is written; raises where that must not be.
    progress : Progress
        Shows the runs, and the pictures of a film.

    Returns
    -------
    Simulation
        ``.frame`` has a row a sample: ``t_s`` (s), position (m), angles (rad), speeds (m/s, rad/s), joints
        and commands (rad). ``.quantities`` has mean speed (m/s), stride (body lengths), amplitudes (rad) and
        others, each with ``value``, ``unit`` and ``stderr``. Of several trials ``.frames`` and ``.runs``.

    Raises
    ------
    UsageError, InputError
        For options that do not fit together and for bad files.
    NoTrustworthyResult
        When the simulation breaks down.

    References
    ----------
    .. [1] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Eqs 1 to 7: the model in the horizontal plane; Eq 10: the asymmetric oscillator.
    .. [2] D. Chen, Y. Xiong, B. Wang, R. Tong, Y. Meng, J. Yu, "Performance Optimization for Bionic Robotic
       Dolphin with Active Variable Stiffness Control".
       Eqs 3 to 9: the model in the vertical plane.
    .. [3] W. L. Chan, G. Lee, B. Kim, J. M. Choi, T. Kang, "Experimental Parameter Identification and
       Performance Analysis of a Fish Robot with Ostraciiform Swimming Mode using Rigid Caudal Fins".
       Eqs 3 to 10 and 25 to 27: rig and cruise.
    .. [4] L. Shang, S. Wang, M. Tan, L. Cheng, "Swimming locomotion modeling for biomimetic underwater
       vehicle with two undulating long-fins", Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159.
       Eqs 4 to 7: the discrete-time model.

    Examples
    --------
    The boxfish as its drops describe it, pulled by 20 g:

    >>> import swimid
    >>> drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> made = simulate(params=drag, pulling_mass_kg=0.020, duration_s=3.0)
    >>> list(made.frame)
    ['t_s', 'x_m', 'u_m_s']
    >>> terminal = made.quantities["terminal_speed_m_s"]
    >>> round(terminal.value, 2), terminal.unit
    (0.26, 'm/s')
    """
    inputs: Sequence[Input] = ()
    if options.trials is None:
        if options.trial is not None:
            raise UsageError("--trial belongs to --trials")
        asked = [cases.of_options(options)]
    else:
        _insist_on_trials_alone(options)
        asked, inputs = cases.of_trials(options.trials, options, options.trial)
    targets = run.places(output, [case.id for case in asked])
    if options.animate is not None:
        _insist_on_film(asked, options.animate)
        allow(atomic.check_writable(options.animate, inputs=inputs))
    folder = output if output is not None and targets != [output] else None
    if folder is not None and not folder.parent.is_dir():
        raise InputError(f"the folder {folder.parent} does not exist", file=folder)
    for place in targets:
        if folder is None or folder.is_dir():
            allow(atomic.check_writable(place, inputs=inputs))
    done = []
    with progress("simulating", total=len(asked)) as step:
        for case in asked:
            done.append(run.run(case))
            step()
    remark = ""
    with atomic.together():
        outputs = run.write(output, done)
        if options.animate is not None:
            remark = animation.write(options.animate, _film(done[0]), view=options.view, progress=progress)
            outputs.append(options.animate)
    if done[0].quantities:
        done[0].case.applied.warn_without_error("the uncertainties given here")
    text = _summary(done, options, remark)
    return Simulation("simulate", text, _data(done, options), outputs, document=done, inputs=inputs)


def _insist_on_trials_alone(options: SimulateOptions) -> None:
    """Refuse options that describe a run beside trials, which bring their own."""
    for name, entry in options.declared().items():
        if entry.part == RUN and getattr(options, name) != entry.default:
            raise UsageError(f"{entry.flag} has no place beside --trials: the trials bring their own drive")


def _insist_on_film(asked: Sequence[Case], path: Path) -> None:
    """Refuse a film of what cannot be filmed."""
    if len(asked) > 1:
        raise UsageError("an animation shows one trial: name it with --trial")
    if asked[0].applied.model.body is None:
        raise UsageError("an animation needs a robot with links in one plane")
    if path.suffix.lower() not in animation.SIZE:
        endings = " or ".join(animation.SIZE)
        raise UsageError(f"'{path.name}' can be no animation", hint=f"let it end in {endings}")


def _film(done: Simulated) -> animation.Film:
    case = done.case
    model, body = case.applied.model.swimmer, case.applied.model.body
    assert model is not None
    assert body is not None
    x, y, heading = body.frames(case.values, done.columns)
    length = body.length(case.values)
    drive = case.metadata.get("drive")
    title = model.robot.name
    if isinstance(drive, dict):
        title += f"  {drive['frequency_hz']:g} Hz, {drive['amplitude_deg']:g} deg"
    return animation.Film(
        time_s=case.trial.time_s,
        x_m=x,
        y_m=y,
        heading_rad=heading,
        lengths_m=np.array(body.lengths_m),
        begins_m=body.straight(case.values)[0],
        passive={a.link for a in body.passive},
        length_m=length,
        width_m=model.robot.body.width_m or animation.FULLNESS * length,
        title=title,
        tapered=body.free,
    )


# ------------------------------------------------------------ telling


def _label(name: str) -> str:
    """A quantity's name in words, without its unit."""
    if name == "mean_speed_BL_s":
        return "in body lengths"
    bare, _ = numbers.split_unit(name.removesuffix("_BL"))
    return bare.replace("_", " ")


def _text(value: float, stderr: float | None, unit: str) -> str:
    """A quantity as people read it: angles in degrees."""
    factor, shown = numbers.in_degrees(unit)
    if not stderr:
        return numbers.number(factor * value, 4, shown)
    return numbers.measured(factor * value, factor * stderr, shown)


def _told(name: str, quantity: Quantity) -> str:
    return f"{_label(name)} {_text(quantity.value, quantity.stderr, quantity.unit)}"


def _summary(done: Sequence[Simulated], options: SimulateOptions, remark: str) -> str:
    if len(done) == 1:
        lines = _one(done[0], options)
    else:
        lines = [f"{done[0].case.metadata['robot']}: {len(done)} trials"]
        width = max(len(d.case.id) for d in done)
        lines += [f"  {d.case.id:<{width}}  {', '.join(_brief(d))}" for d in done]
    worst: dict[str, float] = {}
    for name, change in ((name, change) for d in done for name, change in d.step.items()):
        worst[name] = max(worst.get(name, 0.0), change.largest)
    changes = [
        f"{_label(name)} {numbers.number(largest, 2, numbers.split_unit(name)[1])}"
        for name, largest in worst.items()
        if largest > 0
    ]
    if changes:
        lines += ["", f"  halving the step changes at most: {', '.join(changes)}"]
    if remark:
        lines.append(f"  {remark}")
    return "\n".join(lines)


def _brief(done: Simulated) -> list[str]:
    """What a trial of many comes to, or where it ends."""
    if done.quantities:
        last = [n for n in done.quantities if n.startswith("cycle_")][-len(stroke_cycles.QUANTITIES) :]
        return [_told(n, done.quantities[n]) for n in (*BRIEF, *last) if n in done.quantities]
    channels = [c for c in done.case.applied.model.channels if c.name in done.columns]
    if done.case.per_run:
        name, v = channels[0].name, done.columns[channels[0].name]
        low, high = numbers.number(float(np.min(v)), 4), numbers.number(float(np.max(v)), 4, channels[0].unit)
        return [f"{len(v)} runs, {_label(name)} {low} to {high}"]
    ends = [_told(c.name, Quantity(float(done.columns[c.name][-1]), c.unit)) for c in channels]
    return [f"after {_duration(done):.4g} s", *ends]


def _duration(done: Simulated) -> float:
    return float(done.case.trial.time_s[-1] - done.case.trial.time_s[0])


def _one(done: Simulated, options: SimulateOptions) -> list[str]:
    case = done.case
    place = cases.place(options)
    source = place.name if place else "the robot file's values"
    lines = [f"{case.metadata['robot']}, {source}"]
    drive = case.metadata.get("drive")
    parts = []
    if isinstance(drive, dict) and "stroke" in drive:
        parts = [f"{drive['stroke']} at {drive['frequency_hz']:.4g} Hz"]
        parts += [f"scaled by {drive['scale']:g}"] if drive["scale"] != 1.0 else []
    elif isinstance(drive, dict) and "waveform" in drive:
        parts = [f"{drive['waveform']} {drive['frequency_hz']:g} Hz", f"{drive['amplitude_deg']:g} deg"]
        parts += [f"bias {drive['bias_deg']:g} deg"] if drive["bias_deg"] else []
        parts += [f"asymmetry {drive['asymmetry']:g}"] if drive["asymmetry"] else []
    if parts:
        lines.append(f"  {', '.join(parts)}, {_duration(done):g} s")
    shown = {n: q for n, q in done.quantities.items() if n != "speed_change_per_beat_m_s"}
    width = max((len(_label(n)) for n in shown), default=0)
    lines += [f"  {_label(name):<{width}}  {_text(q.value, q.stderr, q.unit)}" for name, q in shown.items()]
    if not shown:
        lines.append(f"  {', '.join(_brief(done))}")
    speed, change = (done.quantities.get(n) for n in ("mean_speed_m_s", "speed_change_per_beat_m_s"))
    if speed and change and abs(change.value) > UNSTEADY * abs(speed.value):
        percent = 100 * change.value / speed.value
        lines.append(f"  not yet steady: the speed changes by {numbers.fixed(percent, 1)} % a beat")
    if shown and not case.applied.uncertain()[0]:
        lines.append("  no uncertainty known")
    return lines


def _data(done: Sequence[Simulated], options: SimulateOptions) -> dict[str, Any]:
    applied = done[0].case.applied
    values = done[0].case.values
    place = cases.place(options)
    return {
        "model": applied.model.name,
        "robot": done[0].case.metadata["robot"],
        "params": None if place is None else str(place),
        "parameters": {
            p.name: float(v) for p, v in zip(applied.model.parameters, values, strict=True) if not p.per_trial
        },
        "uncertain": applied.uncertain()[0],
        "step_limit": run.STEP_LIMIT,
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
