"""Functions that read the trials of ``fit-propulsion``: cruise tables and logs of straight free swimming."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import cumulative_trapezoid

from swimid.errors import InputError, file_errors, suggestion
from swimid.files import tabular
from swimid.files.provenance import Held
from swimid.fitting.fit_common import Experiment, inputs_of, read_log
from swimid.fitting.model import Array, CruiseInput, SurgeInput, Trial
from swimid.logs import trials as trials_format
from swimid.logs.beat import find_beat, stated_against_found
from swimid.logs.log import FREQUENCY_RTOL, Log
from swimid.logs.trials import Cruise, Drive, FreeSwim, StrokeDrive, TrialSet
from swimid.notices import warn
from swimid.propulsion.model import SPEED, RecoilModel, SurgeModel, plate_inertia
from swimid.results import parameters as parameters_format
from swimid.robots.file import Robot

if TYPE_CHECKING:
    import pandas as pd

#: Standard deviation of the stop-watch times of cruise runs, s (boxfish paper, section 3.4), and relative
#: standard deviation of the average speed between repeated runs with the same setting.
TIME_SD_S, SPEED_RSD = 0.1, 0.01
#: Names of the rig models whose parameter files can be used as a drag file.
RIGS = ("falling-weight", "towed", "free-decay")
#: Minimum number of complete tail beats in a free-swim trial.
MIN_BEATS = 4
#: Keys of a trials file that each propulsion experiment uses. Other keys have no effect on the experiment.
#: The keys of stroke drives are included, although strokes are not supported, so that they get a specific
#: error message.
USES = {
    "cruise": frozenset({"format", "experiment", "robot", "table", "drag"}),
    "free-swim": trials_format.EVERYWHERE
    | {"trials.drive"}
    | {f"trials.drive.{key}" for kind in (Drive, StrokeDrive) for key in kind.model_fields},
}


def load(source: str | Path | TrialSet, *, drag: parameters_format.Source | None = None) -> Experiment:
    """Read the trials file of a cruise experiment or of a free-swim experiment.

    Parameters
    ----------
    drag : path, ParameterFile or result of fit_drag, optional
        Parameters of the falling-weight rig. They replace ``drag`` of the trials file.

    Raises
    ------
    InputError
        If one of the files is wrong.
    """
    path = trials_format.place(source)
    entries = trials_format.read(source, Cruise, FreeSwim, uses=USES)
    robot = trials_format.robot_of(entries, path)
    if isinstance(entries, FreeSwim):
        return _free_swim(path, entries, robot)
    assert isinstance(entries, Cruise)
    if drag is None and entries.drag:
        drag = path.parent / entries.drag
    if drag is None:
        raise InputError(
            "no drag file is given",
            file=path,
            column="drag",
            hint="run fit-drag first, then give --drag drag.yaml",
        )
    return _cruise(path, entries, robot, drag)


# ------------------------------------------------------------ cruise


def fin_inertias(robot: Robot, fins: list[str], path: Path) -> dict[str, float | None]:
    """Return the hydrodynamic inertia of each fin, kg m2; None if it is unknown.

    An inertia that the robot file does not state is computed for a rectangular fin (boxfish paper, Eq 6).
    """
    inertias: dict[str, float | None] = {}
    for fin in dict.fromkeys(fins):
        if fin not in robot.fins:
            hint = suggestion(fin, list(robot.fins), "it has")
            raise InputError(
                f"the robot '{robot.name}' has no fin '{fin}'", file=path, column="fin", hint=hint
            )
        known, density = robot.fins[fin], robot.fluid.density_kg_m3
        inertias[fin] = known.hydrodynamic_inertia_kg_m2
        if inertias[fin] is None and known.shape == "rectangle":
            inertias[fin] = plate_inertia(known.height_m, known.length_m, known.axle_gap_m, density)
    return inertias


def recoil_model(
    robot: Robot, fins: list[str], drag: parameters_format.Source, *, unknown: Sequence[str] = (), path: Path
) -> RecoilModel:
    """Return the recoil-law model of a robot's fins, with the drag parameters of a rig experiment.

    Parameters
    ----------
    fins : list of str
        Names of the fins.
    drag : path or ParameterFile
        Drag parameters of the rig.
    unknown : sequence of str
        Fins whose inertia is estimated even if the robot file states it.
    path : Path
        File that names the fins, for error messages.
    """
    file = parameters_format.read(drag, model=RIGS)
    if file.effects:
        names, place = ", ".join(file.effects), parameters_format.place(drag).name
        warn("SWM076", f"{place}: the law of propulsion takes drag and added mass only, without {names}")
    coefficient, added = parameters_format.require(
        file, ("drag_coefficient", "added_mass"), parameters_format.place(drag)
    )
    body = robot.body
    if body.inertial_mass_kg is None or body.frontal_area_m2 is None:
        raise InputError(
            f"the robot '{robot.name}' needs body.inertial_mass_kg and body.frontal_area_m2 for a "
            "cruise experiment"
        )
    area = 0.5 * robot.fluid.density_kg_m3 * coefficient * body.frontal_area_m2
    inertias = fin_inertias(robot, fins, path)
    inertias |= dict.fromkeys(unknown)
    return RecoilModel(drag_area_kg_m=area, moving_mass_kg=body.inertial_mass_kg + added, fins=inertias)


def _cruise(path: Path, entries: Cruise, robot: Robot, source: parameters_format.Source) -> Experiment:
    drag = parameters_format.read(source, model=RIGS)
    table = read_table(path.parent / entries.table if entries._held is None else entries._held)
    model = recoil_model(robot, table.fin, source, path=table.path)
    middle = (float(np.median(table.frequency_hz)), float(np.deg2rad(0.7 * np.median(table.amplitude_deg))))
    trials = []
    for fin, inertia in model.fins.items():
        rows = np.array([f == fin for f in table.fin])
        speed, distance = table.mean_speed_m_s[rows], table.distance_m[rows]
        # Compute standard deviations of the speeds. Only their ratios between runs matter, because the fit
        # estimates the size of the noise.
        spread = np.hypot(speed**2 / distance * TIME_SD_S, SPEED_RSD * speed)
        inputs = {
            "frequency_hz": table.frequency_hz[rows],
            "amplitude_rad": np.deg2rad(table.amplitude_deg[rows]),
            "distance_m": distance,
        }
        trial = Trial(fin, "fit", np.arange(len(speed), dtype=float), {SPEED: speed}, inputs)
        weights = {SPEED: np.nan_to_num(spread, nan=1.0)}
        trials.append(replace(trial, cruise=CruiseInput(fin, inertia, middle), value_sd=weights))
    read = [*inputs_of(path, entries, [table.source]), parameters_format.origin(source)]
    facts = {"drag": drag, "drag_path": parameters_format.place(source)}
    return Experiment("cruise", robot, model, trials, read, facts=facts)


# ------------------------------------------------------------ straight free swimming


def _free_swim(path: Path, entries: FreeSwim, robot: Robot) -> Experiment:
    trials, logs, turning = [], [], []
    beat_facts: dict[str, dict[str, float | str | None]] = {}
    waveforms: dict[tuple[str, float], str] = {}
    for entry in entries.trials:
        drive = entry.drive
        if not isinstance(drive, Drive):
            raise InputError(
                f"the trial '{entry.id}' has no 'drive' with a beat",
                file=path,
                column="drive",
                hint="give its waveform, frequency_hz and amplitude_deg",
            )
        log = read_log(
            entry, path.parent, required=("x_m", "y_m", "yaw_rad"), optional=("u_m_s", "yaw_rate_rad_s")
        )
        logs.append(log.source)
        seen = np.isfinite(log["yaw_rad"])
        beat = find_beat(log.time_s[seen], np.unwrap(log["yaw_rad"][seen]))
        used = "the measured frequency is used"
        beat_facts[entry.id] = stated_against_found(entry.id, drive.frequency_hz, beat, used)
        if drive.bias_deg != 0:
            turning.append(entry.id)
            continue
        waveforms.setdefault(_waveform(drive), entry.id)
        frequency = drive.frequency_hz
        if beat is not None:
            frequency = beat.frequency_hz
        time, speed = beat_averages(log, 1.0 / frequency)
        # Use only tail beats with the full amplitude, because the thrust law is valid for these only. Assume
        # no initial ramp of the amplitude unless the trial states one.
        ramp = 0.0
        if "ramp_s" in drive.model_fields_set:
            ramp = drive.ramp_s
        full = time - 0.5 / frequency >= ramp - 1e-9
        time, speed = time[full], speed[full]
        whole = int(np.isfinite(speed).sum())
        if whole < MIN_BEATS:
            after = f" after the drive's ramp of {ramp:g} s" * (not full.all())
            raise InputError(
                f"holds {whole} whole beats{after}; at least {MIN_BEATS} are needed", file=log.path
            )
        steady = SurgeInput(frequency, float(np.deg2rad(drive.amplitude_deg)), float(time[0]))
        trials.append(Trial(entry.id, entry.role, time, {"u_m_s": speed}, surge=steady))
    if turning:
        warn(
            "SWM018",
            f"{len(turning)} trials with a turning bias left out of the straight-swimming fit: "
            f"{', '.join(turning)}",
        )
    if not trials:
        raise InputError("no straight trial (bias_deg 0) is left", file=path, column="trials")
    if len(waveforms) > 1:
        (one, first), (other, second) = list(waveforms.items())[:2]
        raise InputError(
            f"'{first}' has the waveform {one[0]} (asymmetry {one[1]:g}), '{second}' {other[0]} (asymmetry "
            f"{other[1]:g}), which give different thrusts",
            file=path,
            column="drive.waveform",
            hint="write a trials file for each",
        )
    if any(t.surge.amplitude_rad <= 0 for t in trials):
        raise InputError("a drive amplitude is zero", file=path, column="amplitude_deg")
    trials = _pooled_frequencies(trials)
    model = SurgeModel(
        amplitudes_rad=[t.surge.amplitude_rad for t in trials],
        frequencies_hz=[t.surge.frequency_hz for t in trials],
        speed_m_s=max(float(np.nanmax(t.measured["u_m_s"])) for t in trials),
    )
    waveform, asymmetry = next(iter(waveforms))
    facts = {"beats": beat_facts, "waveform": waveform, "asymmetry": asymmetry}
    return Experiment("free-swim", robot, model, trials, inputs_of(path, entries, logs), facts=facts)


def _waveform(drive: Drive) -> tuple[str, float]:
    """Return the name of the waveform of a drive and its asymmetry.

    A Hopf oscillator without asymmetry counts as a sine, which it gives on its limit cycle.
    """
    if drive.waveform == "a-cpg" and drive.asymmetry != 0:
        return "a-cpg", drive.asymmetry
    return "sine", 0.0


def _pooled_frequencies(trials: list[Trial]) -> list[Trial]:
    """Replace the beat frequency of each trial by the median over trials with nearly the same frequency."""
    values = np.array([t.surge.frequency_hz for t in trials])
    pooled = [float(np.median(values[np.abs(values / v - 1) < FREQUENCY_RTOL])) for v in values]
    return [replace(t, surge=replace(t.surge, frequency_hz=f)) for t, f in zip(trials, pooled, strict=True)]


def beat_averages(log: Log, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Average the surge of a log over complete tail beats.

    The surge is the column ``u_m_s``. If the log has no such column, the surge is the displacement during a
    beat along the mean heading, divided by the period.

    Returns
    -------
    middle, surge : ndarray, shape (n,)
        Time of the middle of each beat (s), and average surge over the beat (m/s). NaN if samples are
        missing.

    Raises
    ------
    InputError
        If the samples are too few for the beat frequency, or if no samples are complete.
    """
    columns = [c for c in ("u_m_s",) if c in log] or ["x_m", "y_m", "yaw_rad"]
    there = np.all([np.isfinite(log[c]) for c in columns], axis=0)
    time, values = log.time_s[there], [log[c][there] for c in columns]
    if len(time) < 2:
        raise InputError(f"no two samples have all of {', '.join(columns)}", file=log.path)
    count = int((time[-1] - time[0]) / period_s)
    if 2 * count > len(time):
        raise InputError(
            f"has {len(time)} samples in {count} beats; a beat needs at least 2",
            file=log.path,
            hint="check the unit of t_s and the beat frequency",
        )
    edges = time[0] + period_s * np.arange(count + 1)

    def over_beats(values: np.ndarray) -> np.ndarray:
        return np.diff(np.interp(edges, time, values))

    averaged = values[-1]
    if len(values) > 1:
        averaged = np.unwrap(averaged)
    # Integrate to the exact ends of each beat by interpolation. A mean over whole samples would have an error
    # of up to one sample at each end.
    speeds = over_beats(cumulative_trapezoid(averaged, time, initial=0.0)) / period_s
    if len(values) > 1:
        heading, (x, y) = speeds, (over_beats(place) for place in values[:2])
        speeds = (x * np.cos(heading) + y * np.sin(heading)) / period_s
    gaps = np.diff(time)
    for k in np.flatnonzero(gaps > 3 * np.median(gaps)):
        speeds[(edges[1:] > time[k]) & (edges[:-1] < time[k + 1])] = np.nan
    return 0.5 * (edges[1:] + edges[:-1]), speeds


# ---------------------------------------------------------------- cruise table


#: Columns of a cruise table in which every row must have a positive number.
NUMBERS = ("frequency_hz", "amplitude_deg", "distance_m")
#: Type of a row of a cruise table. It has the line number in the file (None for a table in memory), and the
#: text of each cell by column name.
Row = tuple[int | None, dict[str, str]]


@dataclass(frozen=True)
class CruiseTable:
    """Table of timed runs in which a robot swims a known distance from rest (cruise table).

    The mean speed of a run without a measurement is NaN. ``source`` is the entry of the table in the
    provenance.
    """

    path: Path
    source: Path | Held
    fin: list[str]
    frequency_hz: Array
    amplitude_deg: Array
    distance_m: Array
    mean_speed_m_s: Array


def read_table(source: str | Path | pd.DataFrame) -> CruiseTable:
    """Read a cruise table, from a file or from a DataFrame with the same columns.

    Raises
    ------
    InputError
        For missing columns, for cells that are no positive number, and for a table without rows.
    """
    path, held, line = Path("table"), None, None
    if isinstance(source, str | Path):
        path = Path(source)
        with file_errors(path):
            _, header, line = tabular.head(path)
            text = path.read_text(encoding="utf-8-sig", errors="replace")
        names = tabular.column_names(header, path, line)
    else:
        names, text = [str(name) for name in source.columns], source.to_csv(index=False)
        held = Held("table", hashlib.sha256(text.encode()).hexdigest())
    speed, what = "time_s", "neither time_s nor mean_speed_m_s is there"
    if "mean_speed_m_s" in names:
        speed = "mean_speed_m_s"
    for column in ("fin", *NUMBERS, speed):
        if column not in names:
            reason = {"time_s": what}.get(column, "this column is missing")
            raise tabular.missing_column(column, names, path, line, reason)
    rows = _rows(text, path, line, names)
    if not rows:
        raise InputError("has a header and no runs", file=path, line=line)
    columns = {name: _numbers(rows, name, path) for name in (*NUMBERS, speed)}
    distance, speeds = columns["distance_m"], columns[speed]
    if np.isnan(speeds).all():
        raise InputError("every run's value is missing", file=path, column=speed)
    if speed == "time_s":
        with np.errstate(over="ignore", under="ignore"):
            speeds = distance / speeds
    none = np.isinf(speeds) | (speeds == 0)
    if none.any():
        row = int(np.argmax(none))
        raise InputError(f"the speed is {speeds[row]:g} m/s", file=path, line=rows[row][0], column=speed)
    missing = int(np.isnan(speeds).sum())
    if missing:
        warn("SWM001", f"{path.name}: {missing} of {len(speeds)} runs have no {speed}; they are left out")
    typical = np.nanmedian(speeds)
    doubts = [
        (speed, typical > 20, f"speeds of {typical:.3g} m/s; is it mm/s (a factor of 1000)?"),
        ("distance_m", np.max(distance) > 50, "looks like centimetres or millimetres"),
        ("amplitude_deg", np.max(columns["amplitude_deg"]) < 1.6, "looks like radians (a factor of 57.3)"),
    ]
    for column, doubtful, words in doubts:
        if doubtful:
            warn("SWM002", f"{path.name}, '{column}': {words}")
    fins = [cells["fin"] for _, cells in rows]
    frequency, amplitude, distance = (columns[name] for name in NUMBERS)
    return CruiseTable(path, held or path, fins, frequency, amplitude, distance, speeds)


def _rows(text: str, path: Path, header_line: int | None, names: list[str]) -> list[Row]:
    """Return the rows of a cruise table without its header, blank lines and comments."""
    rows: list[Row] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if number <= (header_line or 1) or not line.strip(", \t") or line.startswith("#"):
            continue
        count = tabular.count_cells(line)
        if count != len(names):
            what = f"has {count} cells where the header names {len(names)} columns"
            raise InputError(what, file=path, line=header_line and number)
        cells = next(csv.reader([line], skipinitialspace=True))
        rows.append((header_line and number, {n: c.strip() for n, c in zip(names, cells, strict=True)}))
    return rows


def _numbers(rows: list[Row], name: str, path: Path) -> Array:
    """Return the values of a column of a cruise table; NaN where a measurement is missing.

    Raise an error if a value is not a positive number.
    """
    values = np.full(len(rows), np.nan)
    for row, (line, cells) in enumerate(rows):
        text = cells[name]
        value, what, hint = tabular.number(text), "", None
        if text in tabular.MISSING and name not in NUMBERS:
            continue
        if text in tabular.MISSING:
            what = "has no value"
        elif value is None or not math.isfinite(value):
            what, hint = f"'{text}' is not a number", tabular.number_hint(text)
        elif value <= 0:
            what = f"{value:g} is not positive"
        if what:
            raise InputError(what, file=path, line=line, column=name, hint=hint)
        values[row] = value
    return values
