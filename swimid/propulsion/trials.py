"""Functions that read cruise tables, make the recoil-law model of a robot, and average logs over beats."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swimid.errors import InputError, file_errors, suggestion
from swimid.files import tabular
from swimid.files.provenance import InputInMemory
from swimid.fitting.model import Array
from swimid.kinematics.cycles import cycle_means
from swimid.logs.log import Log
from swimid.notices import warn
from swimid.propulsion.model import RecoilModel, plate_inertia
from swimid.results import parameters as parameters_format
from swimid.robots.file import Robot

if TYPE_CHECKING:
    import pandas as pd

#: Names of the rig models whose parameter files can be used as a drag file.
RIGS = ("falling-weight", "towed", "free-decay")


# ---------------------------------------------------------------- model of the recoil law


def fin_inertias(robot: Robot, fins: list[str], path: Path) -> dict[str, float | None]:
    """Return the hydrodynamic inertia of each fin, kg m2; None if it is unknown.

    An inertia that the robot file does not state is that of a rectangular fin (Chan et al., boxfish, Eq 6).
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
        names, place = ", ".join(file.effects), parameters_format.source_path(drag).name
        warn("SWM076", f"{place}: the law of propulsion takes drag and added mass only, without {names}")
    coefficient, added = parameters_format.require(
        file, ("drag_coefficient", "added_mass"), parameters_format.source_path(drag)
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


# ---------------------------------------------------------------- averages over beats


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
        text = (
            f"has {len(time)} samples without a missing value in {', '.join(columns)}; at least 2 are needed"
        )
        raise InputError(text, file=log.path)
    count = int((time[-1] - time[0]) / period_s)
    if 2 * count > len(time):
        raise InputError(
            f"has {len(time)} samples in {count} beats; a beat needs at least 2",
            file=log.path,
            hint="check the unit of t_s and the beat frequency",
        )
    edges = time[0] + period_s * np.arange(count + 1)
    if len(values) == 1:
        speeds = cycle_means(time, values[0], edges)
    else:
        heading = cycle_means(time, np.unwrap(values[2]), edges)
        x, y = (np.diff(np.interp(edges, time, place)) for place in values[:2])
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

    The mean speed of a run without a measurement is NaN. ``source`` is the file path or the table, as the
    provenance records it.
    """

    path: Path
    source: Path | InputInMemory
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
        held = InputInMemory("table", hashlib.sha256(text.encode()).hexdigest())
    speed, what = "time_s", "a column time_s or mean_speed_m_s is needed, and both are missing"
    if "mean_speed_m_s" in names:
        speed = "mean_speed_m_s"
    for column in ("fin", *NUMBERS, speed):
        if column not in names:
            reason = {"time_s": what}.get(column, "this column is missing")
            raise tabular.column_error(column, names, path, line, reason)
    rows = _rows(text, path, line, names)
    if not rows:
        raise InputError("has a header, but no line with a run", file=path, line=line)
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
        text = f"the speed is {speeds[row]:g} m/s; it must be positive and finite"
        raise InputError(text, file=path, line=rows[row][0], column=speed)
    missing = int(np.isnan(speeds).sum())
    if missing:
        warn("SWM001", f"{path.name}: {missing} of {len(speeds)} runs have no {speed}; they are left out")
    _warn_units(path, speed, float(np.nanmedian(speeds)), columns)
    fins = [cells["fin"] for _, cells in rows]
    frequency, amplitude, distance = (columns[name] for name in NUMBERS)
    return CruiseTable(path, held or path, fins, frequency, amplitude, distance, speeds)


def _warn_units(path: Path, speed: str, typical: float, columns: Mapping[str, Array]) -> None:
    """Warn of a column whose values look like those of another unit."""
    distance = columns["distance_m"]
    doubts = [
        (speed, typical > 20, f"speeds of {typical:.3g} m/s; is it mm/s (a factor of 1000)?"),
        ("distance_m", np.max(distance) > 50, "looks like centimetres or millimetres"),
        ("amplitude_deg", np.max(columns["amplitude_deg"]) < 1.6, "looks like radians (a factor of 57.3)"),
    ]
    for column, doubtful, words in doubts:
        if doubtful:
            warn("SWM002", f"{path.name}, '{column}': {words}")


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
        value, what, hint = tabular.parse_number(text), "", None
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


def table_columns(fin: str, inputs: Mapping[str, Array]) -> dict[str, Any]:
    """Return the columns of a table of cruises, without the speed, by name, from the inputs of a trial."""
    return {
        "fin": [fin] * len(inputs["frequency_hz"]),
        "frequency_hz": inputs["frequency_hz"],
        "amplitude_deg": np.rad2deg(inputs["amplitude_rad"]),
        "distance_m": inputs["distance_m"],
    }
