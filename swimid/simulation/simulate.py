"""Command ``simulate``: simulation of any robot as a log, and of a robot with links also as a film."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

import swimid
from swimid.errors import Named, NoTrustworthyResult, UsageError
from swimid.files import atomic, yamlio
from swimid.files.atomic import file_names
from swimid.files.provenance import Input
from swimid.fitting import fit_common
from swimid.fitting.model import Array
from swimid.fitting.problem import choose_step, is_broken_down
from swimid.kinematics.cycles import CYCLE_QUANTITIES, UNSTEADY
from swimid.logs import log as log_format
from swimid.notices import Progress, silent, warn
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.evidence import remove_outdated
from swimid.results.result import LOG_ENDINGS, Result
from swimid.simulation import cases
from swimid.simulation.cases import Case, format_quantity
from swimid.simulation.catalogue import Quantity
from swimid.simulation.options import SimulateOptions

if TYPE_CHECKING:
    import pandas as pd
    import xarray

#: Frame rate of a film, Hz, and width of a frame for each file extension, px.
FILM_RATE_HZ, FILM_PX = 25.0, {".mp4": 960, ".gif": 560}
#: Width of the view of a film, and drawn width of a link, both in body lengths.
FILM_WIDTH, LINK_WIDTH = 2.4, 0.08
#: Colours of a film, each as blue, green and red components. LINKS has those of active and passive links.
WATER, GRID, INK, PATH = (250, 246, 240), (238, 228, 214), (70, 55, 40), (190, 150, 60)
LINKS = ((150, 105, 45), (80, 130, 225))
#: Number of fractional bits of the pixel coordinates that OpenCV draws.
SHIFT = 4


@dataclass(frozen=True)
class Simulated:
    """Result of one simulation: columns of its log, quantities, and error of the integration step.

    Attributes
    ----------
    columns : dict of str to ndarray
        Columns of the log, ``t_s`` first.
    step : dict of str to float
        Maximum change of each channel when the integration step is halved, divided by the allowed change
        (:func:`swimid.fitting.problem.choose_step`); empty if nothing is integrated.
    """

    case: Case
    columns: dict[str, Any]
    quantities: dict[str, Quantity]
    step: dict[str, float]


def simulate_case(case: Case) -> Simulated:
    """Simulate one case, and return the columns of its log and its quantities.

    Raises
    ------
    NoTrustworthyResult
        If the simulation diverges.
    """
    chosen = choose_step(case.applied.model, [(case.values, case.trial)], [case.applied.noise()])
    case, model, (step,) = case.at_step(chosen.model), chosen.model, chosen.changes
    simulated = model.run(case.values, case.trial)
    _refuse_broken(case, simulated)
    _warn_folded(case, simulated)
    quantities = {}
    if case.quantities is not None:
        compute = partial(case.quantities, case.applied)
        found = np.column_stack(case.applied.with_errors(case.values, compute))
        for (name, unit), (value, stderr) in zip(
            case.units.items(), yamlio.plain(found, finite=True), strict=True
        ):
            if value is not None:
                quantities[name] = Quantity(value, unit, stderr)
    columns: dict[str, Any] = {c.name: simulated[c.name] for c in model.channels if c.name in simulated}
    added = {k: v for k, v in case.extra.items() if k not in columns}
    if model.timed_runs:
        return Simulated(case, added | columns, quantities, step)
    return Simulated(case, {log_format.TIME: case.trial.time_s} | columns | added, quantities, step)


def _refuse_broken(case: Case, simulated: Mapping[str, Array]) -> None:
    """Raise an error if a simulation diverges before its inputs end."""
    if not is_broken_down(case.trial, simulated):
        return
    lost = np.any([~np.isfinite(v) for v in simulated.values()], axis=0)
    whole = np.flatnonzero(~lost)
    where = "at its start"
    if len(whole) and not case.applied.model.timed_runs:
        where = f"at t = {case.trial.time_s[min(whole[-1] + 1, len(lost) - 1)]:.4g} s"
    raise NoTrustworthyResult(
        f"the simulation of '{case.id}' diverges {where}, with every integration step that was tried",
        hint="check the parameters' signs and units and the drive, or take a smaller step with --dt",
    )


def _warn_folded(case: Case, simulated: Mapping[str, Array]) -> None:
    """Warn of a joint angle of more than 180 degrees."""
    for name, values in simulated.items():
        if re.fullmatch(r"joint\d+_rad", name) and np.nanmax(np.abs(values), initial=0.0) > math.pi:
            turned = math.degrees(float(np.nanmax(np.abs(values))))
            warn(
                "SWM054",
                f"{case.id}: {name.removesuffix('_rad')} turns by {turned:.0f} degrees; more than 180 is "
                "impossible, because the link would pass through the link ahead: check the amplitude",
            )


def places(output: Path | None, ids: Sequence[str]) -> list[Path]:
    """Return the path of the log of each simulation.

    The path of a single log is ``output`` itself. Several logs are files in the folder ``output``, which are
    named after their trials.
    """
    if output is None:
        return []
    folder = output.is_dir()
    if output.suffix.lower() in LOG_ENDINGS and not folder and len(ids) == 1:
        return [output]
    if output.suffix.lower() in LOG_ENDINGS and not folder:
        raise UsageError(
            f"{len(ids)} trials do not fit into one log: name a folder, or one trial with --trial"
        )
    if output.exists() != folder or (len(ids) == 1 and not folder):
        raise UsageError(f"'{output.name}' must be a folder, or end in {' or '.join(LOG_ENDINGS)}")
    return [output / name for name in file_names(ids, LOG_ENDINGS)]


@dataclass(frozen=True, eq=False)
class Simulation(Result):
    """Result of ``simulate``: one simulation, or one for each recorded trial.

    Attributes
    ----------
    frame : DataFrame
        Log of the only simulation, one row for each sample. Column names state the units (SI and radians).
    quantities : dict of str to Quantity
        Quantities of the only simulation, each with ``value``, ``unit`` and ``stderr`` (None if the
        uncertainty of the coefficients is unknown).
    frames : dict of str to DataFrame
        Log of each simulation, by the name of the simulation.
    runs : dict of str to Simulated
        Simulations by name, each with ``columns``, ``quantities``, and ``step``, the effect of halving the
        integration step.
    inputs : sequence of path or Log
        Files of the recorded trials.

    Examples
    --------
    >>> import swimid
    >>> made = swimid.simulate(robot="tfish", frequency_hz=1.4, amplitude_deg=20.0, duration_s=6.0)
    >>> list(made.frame)[:4], round(made.quantities["mean_speed_m_s"].value, 2)
    (['t_s', 'x_m', 'y_m', 'yaw_rad'], 0.11)
    """

    inputs: Sequence[Input] = field(default=(), repr=False)

    ending = ".csv"
    next_step = "swimid plot {file} -o {free[log.svg]}"

    @property
    def runs(self) -> dict[str, Simulated]:
        """Simulations by name, each with its channels and its quantities."""
        return Named({one.case.id: one for one in self.document})

    @property
    def frames(self) -> dict[str, pd.DataFrame]:
        """Log of each simulation, by the name of the simulation. Column names state the (SI) units."""
        import pandas as pd

        return Named({name: pd.DataFrame(one.columns) for name, one in self.runs.items()})

    @property
    def frame(self) -> pd.DataFrame:
        """Log of the only simulation.

        Raises
        ------
        UsageError
            If there are several simulations. Use :attr:`frames` in that case.
        """
        return self._only("frames")

    def to_xarray(self) -> xarray.Dataset:
        """Return the log of the only simulation as an ``xarray.Dataset`` over ``t_s``, with units."""
        return log_format.to_xarray(self.frame, [log_format.TIME])

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Quantities of the only simulation, such as mean speed and stride, each with its standard error."""
        return Named(self._only("runs").quantities)

    def _only(self, several: str) -> Any:
        runs = getattr(self, several)
        if len(runs) > 1:
            text = f"the result has {len(runs)} simulations, and this attribute describes only one"
            raise UsageError(text, hint=f"select a simulation by its id in .{several}")
        return next(iter(runs.values()))

    def save(self, path: str | Path) -> Self:
        """Write the log of one simulation, or the logs of several simulations in a folder.

        Logs in a folder are named after their trials.

        Raises
        ------
        InputError
            If a log cannot be written.
        UsageError
            If the path is neither the log of one simulation nor a folder, or if a log of the trials would be
            replaced.
        """
        output = Path(path)
        targets = places(output, list(self.runs))
        for place in targets:
            if place.parent.is_dir():
                atomic.check_writable(place, inputs=self.inputs)
        with atomic.write_together():
            if targets != [output]:
                atomic.make_folder(output)
            for place, one in zip(targets, self.document, strict=True):
                metadata = {"made_by": "swimid simulate", "version": swimid.__version__, **one.case.metadata}
                remove_outdated(place)
                log_format.write(place, one.columns, metadata)
        return replace(self, outputs=[*self.outputs, *targets])


#: Options of ``simulate`` that are allowed together with recorded trials.
WITH_TRIALS = (
    *("params", "robot", "dt", "chosen", "own_effects", "own_experiments", "readings", "trials", "trial"),
    "animate",
)
#: Quantities in the table of several simulations of a robot in a plane.
TABLE_QUANTITIES = ("mean_speed_m_s", "max_yaw_rate_rad_s", "max_pitch_rate_rad_s", "turning_radius_m")


@takes(SimulateOptions)
def simulate(
    *,
    options: SimulateOptions,
    output: Path | None = None,
    allow: Callable[[Path], object] = atomic.check_writable,
    progress: Progress = silent,
) -> Simulation:
    """Simulate a robot with given coefficients: its motion over time, and quantities such as its speed.

    The options of a beat are the keys of ``drive`` in a trials file. An input log has joint angles or
    commands, or the input column of a discrete-time model. By default, the simulation is then as long as the
    log. Standard errors contain the uncertainty of the coefficients, not the error of the model. Use
    :func:`swimid.compare` to test the model.

    Parameters
    ----------
    output : Path, optional
        Log to write; for several trials a folder.
    allow : callable
        Function that is called with every file before it is written. It raises an error if the file must not
        be written.
    progress : Progress
        Progress over the simulations and over the frames of a film.

    Returns
    -------
    Simulation
        ``.frame`` has a row for each sample: ``t_s`` (s), position (m), angles (rad), speeds (m/s, rad/s),
        joints and commands (rad). ``.quantities`` has mean speed (m/s), stride (body lengths), amplitudes
        (rad) and others, each with ``value``, ``unit`` and ``stderr``. For several trials, use ``.frames``
        and ``.runs``.

    Raises
    ------
    UsageError, InputError
        If options exclude each other, or a file is invalid.
    NoTrustworthyResult
        If the simulation diverges.

    Examples
    --------
    Pull the boxfish, with the drag of its drops, by 20 g:

    >>> import swimid
    >>> drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> made = simulate(params=drag, pulling_mass_kg=0.020, duration_s=3.0)
    >>> list(made.frame)
    ['t_s', 'x_m', 'u_m_s']
    >>> terminal = made.quantities["terminal_speed_m_s"]
    >>> round(terminal.value, 2), terminal.unit
    (0.26, 'm/s')
    """
    asked, inputs = _list_cases(options)
    targets = places(output, [case.id for case in asked])
    if options.animate is not None:
        _refuse_film(asked, options.animate)
        allow(atomic.check_writable(options.animate, inputs=inputs))
    for place in targets:
        if place == output or place.parent.is_dir():
            allow(atomic.check_writable(place, inputs=inputs))
    asked[0].applied.model.prepare(progress)
    done = []
    with progress("simulating", total=len(asked)) as step:
        for case in asked:
            done.append(simulate_case(case))
            step()
    if done[0].quantities:
        done[0].case.applied.warn_without_error("the uncertainties given here")
    notes: list[str] = []
    films = [path for path in [options.animate] if path is not None]
    with atomic.write_together():
        for film in films:
            notes = _write_film(film, done[0], progress)
        evidence = _evidence(done, options, notes)
        made = Simulation("simulate", "", _data(done, options), (), evidence, done, inputs)
        if output is not None:
            made = made.write_output(output)
    return replace(made, outputs=[*made.outputs, *films])


def _list_cases(options: SimulateOptions) -> tuple[list[Case], Sequence[Input]]:
    """Return the simulations that the options ask for, and the files of their trials."""
    if options.trials is not None:
        _refuse_run_options(options)
        return cases.cases_of_trials(options)
    if options.trial is not None:
        raise UsageError("--trial is given without --trials: give the trials file, too")
    return [cases.case_of_options(options)], ()


def _refuse_run_options(options: SimulateOptions) -> None:
    """Refuse options of a commanded motion together with recorded trials, which have their own motion."""
    for name, entry in options.declarations().items():
        if name not in WITH_TRIALS and getattr(options, name) != entry.default:
            text = f"{entry.flag} cannot be combined with --trials: trials state drives. Omit it"
            raise UsageError(text)


def _refuse_film(asked: Sequence[Case], path: Path) -> None:
    """Refuse a film in an unknown format, of several simulations, or of a robot that is no chain in a plane.

    Raises
    ------
    UsageError
        If the film cannot be made.
    """
    if len(asked) > 1:
        raise UsageError("an animation shows one trial: name it with --trial")
    if asked[0].applied.model.body is None:
        raise UsageError("an animation needs a robot with links in one plane")
    if path.suffix.lower() not in FILM_PX:
        endings = " or ".join(FILM_PX)
        raise UsageError(
            f"'{path.name}' is not a valid file name for an animation", hint=f"let it end in {endings}"
        )


def _write_film(path: Path, done: Simulated, progress: Progress) -> list[str]:
    """Write the film of a simulation, and return remarks for the user.

    The film shows the links to scale, the path of the front and a grid. The view follows the robot.
    """
    # import the codecs only here, because they take long to load
    import cv2

    from swimid.files.video import REMARK, Frame, Mpeg4, check_length, open_writer

    case, time_s = done.case, done.case.trial.time_s
    body, drive, title = case.applied.model.body, case.metadata.get("drive"), case.metadata["robot"]
    assert body is not None
    if isinstance(drive, dict):
        title += f"  {drive['frequency_hz']:g} Hz, {drive['amplitude_deg']:g} deg"
    frames = body.frames(case.values, done.columns)
    # collect the front end and the rear end of every link, each with x and y
    ends = np.array([frames[:2], body.rear_ends(frames)])
    length, width = sum(body.lengths_m), FILM_PX[path.suffix.lower()]
    height, scale = 2 * round(0.3 * width), width / (FILM_WIDTH * length)
    thickness, passive = max(round(LINK_WIDTH * length * scale), 3), {axis.link for axis in body.passive}

    def draw(now_s: float) -> Frame:
        place = np.array([np.interp(now_s, time_s, row) for row in ends.reshape(-1, len(time_s))])
        place = place.reshape(ends.shape[:3])
        corner = place.mean(axis=(0, 2)) - 0.5 * np.array([width, height]) / scale

        def pixels(points: Array) -> Any:
            x, y = (points.T - corner[:, None]) * scale
            return np.round(np.column_stack([x, height - y]) * 2**SHIFT).astype(np.int32)

        frame = np.full((height, width, 3), WATER, dtype=np.uint8)
        for at in np.arange(-corner[0] % length, width / scale, length) * scale:
            cv2.line(frame, (round(at), 0), (round(at), height), GRID, 1)
        for at in height - np.arange(-corner[1] % length, height / scale, length) * scale:
            cv2.line(frame, (0, round(at)), (width, round(at)), GRID, 1)
        travelled = np.vstack([ends[0, :, 0, time_s <= now_s], place[0, :, 0]])
        cv2.polylines(frame, [pixels(travelled)], False, PATH, 2, cv2.LINE_AA, SHIFT)
        # draw from the tail forward, so that each link overlaps the link behind it
        for link in reversed(range(len(body.lengths_m))):
            front, rear = pixels(place[:, :, link]).tolist()
            cv2.line(frame, front, rear, INK, thickness + 2, cv2.LINE_AA, SHIFT)
            cv2.line(frame, front, rear, LINKS[link in passive], thickness, cv2.LINE_AA, SHIFT)
        # the OpenCV font has ASCII characters only
        for text, base in ((f"{now_s:.2f} s, grid {length:.3g} m", 26), (title, height - 14)):
            plain = text.encode("ascii", "replace").decode()
            cv2.putText(frame, plain, (12, base), cv2.FONT_HERSHEY_SIMPLEX, 0.55, INK, 1, cv2.LINE_AA)
        return frame

    times = np.arange(time_s[0], time_s[-1] + 1e-9, 1.0 / FILM_RATE_HZ)
    check_length(path, len(times), width, height)
    with atomic.replace_file(path) as temporary, progress("animation", total=len(times)) as step:
        writer = open_writer(temporary, FILM_RATE_HZ, width, height)
        try:
            for time in times:
                writer.write(float(time - times[0]), draw(float(time)))
                step()
        finally:
            writer.close()
    return [REMARK.format("animation")] * isinstance(writer, Mpeg4)


# ------------------------------------------------------------ evidence


def _evidence(done: Sequence[Simulated], options: SimulateOptions, notes: list[str]) -> ev.Evidence:
    """Return the evidence (verdict, checks, tables) of the command ``simulate``.

    The evidence has the quantities, and the checks of the integration step and of steady swimming.
    """
    first, path = done[0], cases.describe_point(options)
    facts = {"Parameters": "values of the robot file", "Runs": str(len(done))}
    if path is not None:
        facts["Parameters"] = path.name
    robot = first.case.metadata["robot"]
    quantities = _quantity_table(done)
    answer = f"{robot} was simulated in {len(done)} runs."
    if len(done) == 1:
        drive = first.case.metadata.get("drive", {})
        if drive:
            facts["Drive"] = ", ".join(cases.setting_text(*item) for item in drive.items() if item[1])
        if not first.case.applied.model.timed_runs:
            facts["Duration"] = numbers.format_number(float(np.ptp(first.case.trial.time_s)), unit="s")
        answer = f"{robot}: {' '.join(map(str, quantities.rows[0]))}."
    checks = fit_common.step_check([d.case.id for d in done], [d.step for d in done]) + _steady_check(done)
    if first.quantities and not first.case.applied.uncertain()[0]:
        notes = [*notes, "No uncertainty known: the parameters have no standard errors."]
    return ev.Evidence(
        command="simulate",
        title=f"Simulation of {robot}",
        verdict=ev.make_verdict(answer, checks),
        facts=facts,
        checks=checks,
        tables=[quantities],
        notes=notes,
    )


def _quantity_table(done: Sequence[Simulated]) -> ev.Table:
    """Return a table of quantities: a row for each quantity, or for each of several simulations."""
    if len(done) == 1:
        rows: list[list[Any]] = [list(row) for row in _texts(done[0]).items()]
        return ev.Table(id="quantities", title="Quantities", columns=["quantity", "value"], rows=rows)
    kept: Sequence[str] = TABLE_QUANTITIES
    if done[0].case.applied.model.in_space:
        kept = CYCLE_QUANTITIES
    shown = {d.case.id: _texts(d, kept) for d in done}
    names = list(dict.fromkeys(name for row in shown.values() for name in row))
    rows = [[run, *(row.get(name, "") for name in names)] for run, row in shown.items()]
    return ev.Table(id="quantities", title="Quantities", columns=["run", *names], rows=rows)


def _steady_check(done: Sequence[Simulated]) -> list[ev.Check]:
    """Return a failed check if the mean speed of the only simulation still changes from beat to beat."""
    speed, change = (done[0].quantities.get(n) for n in ("mean_speed_m_s", "speed_change_per_beat_m_s"))
    if len(done) > 1 or not speed or not change or abs(change.value) <= UNSTEADY * abs(speed.value):
        return []
    value = numbers.percent(change.value / speed.value, 2)
    reason = f"the speed still changes by {value} a beat, so the run is not yet steady"
    return [ev.make_check("steady", value, False, f"≤ {numbers.percent(UNSTEADY)} a beat", reason=reason)]


def _texts(done: Simulated, kept: Sequence[str] = ()) -> dict[str, str]:
    """Return the quantities of a simulation as text, by their names in words.

    If there are no quantities, return the last value of each channel.
    """
    found = {n: q for n, q in done.quantities.items() if n in kept or not kept}
    tail = ""
    if not done.quantities:
        channels = [c for c in done.case.applied.model.channels if c.name in done.columns]
        found = {c.name: Quantity(float(done.columns[c.name][-1]), c.unit) for c in channels}
        tail = " at the end"
    found.pop("speed_change_per_beat_m_s", None)
    texts = {}
    for name, quantity in found.items():
        label = f"{numbers.split_unit(name)[0].replace('_', ' ')}{tail}"
        if name == "mean_speed_BL_s":
            label = "mean speed in body lengths"
        texts[label] = format_quantity(quantity.value, quantity.unit, quantity.stderr, digits=4)
    return texts


def _data(done: Sequence[Simulated], options: SimulateOptions) -> dict[str, Any]:
    """Return the result of ``simulate`` as data for ``--json``."""
    case, place = done[0].case, cases.describe_point(options)
    return {
        "model": case.applied.model.name,
        "robot": case.metadata["robot"],
        "params": str(place) if place else None,
        "runs": [
            {
                "id": d.case.id,
                "metadata": dict(d.case.metadata),
                "quantities": {name: vars(quantity) for name, quantity in d.quantities.items()},
                "step_check": d.step,
            }
            for d in done
        ],
    }
