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
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.simulation import animation, cases, run
from swimid.simulation.applied import Quantity
from swimid.simulation.cases import Case
from swimid.simulation.options import RUN, SimulateOptions
from swimid.simulation.run import Simulated, Simulation
from swimid.swimmer import run_quantities

#: Largest change of the speed from beat to beat, over the speed, of a steady run.
UNSTEADY = 0.005
#: Quantities that the table of several runs holds.
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
    notes = []
    with atomic.together():
        outputs = run.write(output, done)
        if options.animate is not None:
            remark = animation.write(options.animate, _film(done[0]), view=options.view, progress=progress)
            notes = [remark] if remark else []
            outputs.append(options.animate)
    if done[0].quantities:
        done[0].case.applied.warn_without_error("the uncertainties given here")
    return Simulation(
        "simulate",
        "",
        _data(done, options),
        outputs,
        evidence=_evidence(done, options, notes),
        document=done,
        inputs=inputs,
    )


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


# ------------------------------------------------------------ evidence


def _evidence(done: Sequence[Simulated], options: SimulateOptions, notes: list[str]) -> ev.Evidence:
    """Return what the runs come to, and whether the integration step is small enough."""
    first, path = done[0], cases.place(options)
    facts = {"Parameters": path.name if path else "values of the robot file", "Runs": str(len(done))}
    if len(done) == 1:
        drive = first.case.metadata.get("drive", {})
        if drive:
            facts["Drive"] = ", ".join(cases.setting(*item) for item in drive.items() if item[1])
        if not first.case.per_run:
            facts["Duration"] = numbers.number(float(np.ptp(first.case.trial.time_s)), unit="s")
        rows: list[list[Any]] = [list(row) for row in _shown(first).items()]
        table = ev.Table(id="quantities", title="Quantities", columns=["quantity", "value"], rows=rows)
    else:
        of_cycles = [name for name in first.quantities if name.startswith("cycle_")]
        kept = [*BRIEF, *of_cycles[-len(run_quantities.QUANTITIES) :]]
        shown = {d.case.id: _shown(d, kept) for d in done}
        columns = list(dict.fromkeys(name for row in shown.values() for name in row))
        rows = [[name, *(row.get(column, "") for column in columns)] for name, row in shown.items()]
        table = ev.Table(id="quantities", title="Quantities", columns=["run", *columns], rows=rows)
    shares = {(d.case.id, name): change.share for d in done for name, change in d.step.items()}
    checks = []
    if shares:
        (run_id, name), share = max(shares.items(), key=lambda item: item[1])
        text = "largest change of a channel over its range when the step is halved"
        reason = f"halving the integration step changes {name} of {run_id} by {numbers.percent(share, 2)}"
        limit = f"≤ {numbers.percent(run.STEP_LIMIT)}"
        within = share <= run.STEP_LIMIT
        value = numbers.percent(share, 2) if share > 1e-6 else "below 0.0001 %"
        checks.append(ev.check("integration step", value, within, limit, text, reason=reason))
    speed, change = (first.quantities.get(n) for n in ("mean_speed_m_s", "speed_change_per_beat_m_s"))
    if len(done) == 1 and speed and change and abs(change.value) > UNSTEADY * abs(speed.value):
        value = numbers.percent(change.value / speed.value, 2)
        reason = f"the speed still changes by {value} a beat, so the run is not yet steady"
        checks.append(ev.check("steady", value, False, "≤ 0.5 % a beat", reason=reason))
    if first.quantities and not first.case.applied.uncertain()[0]:
        notes = [*notes, "No uncertainty known: the parameters have no standard errors."]
    robot = first.case.metadata["robot"]
    answer = f"{robot} was simulated in {len(done)} runs."
    if len(done) == 1:
        answer = f"{robot}: {' '.join(next(iter(_shown(first).items())))}."
    return ev.Evidence(
        verb="simulate",
        title=f"Simulation of {robot}",
        verdict=ev.judged(answer, checks),
        facts=facts,
        checks=checks,
        tables=[table],
        notes=notes,
    )


def _shown(done: Simulated, kept: Sequence[str] = ()) -> dict[str, str]:
    """Return quantities (all by default) by a name in words; without any, the channels at the end."""
    found = {n: q for n, q in done.quantities.items() if n in kept or not kept}
    if not done.quantities:
        channels = [c for c in done.case.applied.model.channels if c.name in done.columns]
        found = {c.name: Quantity(float(done.columns[c.name][-1]), c.unit) for c in channels}
    found.pop("speed_change_per_beat_m_s", None)
    texts = {}
    for name, quantity in found.items():
        words = numbers.split_unit(name)[0].replace("_", " ")
        factor, unit = numbers.in_degrees(quantity.unit)
        label = words if done.quantities else f"{words} at the end"
        label = "mean speed in body lengths" if name == "mean_speed_BL_s" else label
        if quantity.stderr:
            texts[label] = numbers.measured(factor * quantity.value, factor * quantity.stderr, unit)
        else:
            texts[label] = numbers.number(factor * quantity.value, 4, unit)
    return texts


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
