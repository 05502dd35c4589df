"""Cruise tables and straight free swimming: trials that tell how a fin propels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from swimid.errors import InputError, nearest
from swimid.fitting.drives import CruiseInput, SurgeInput
from swimid.fitting.experiment import Experiment, inputs_of, read_log
from swimid.fitting.model import Trial
from swimid.logs import trials as trials_format
from swimid.logs.beat import find_beat, stated_against_found
from swimid.logs.log import FREQUENCY_RTOL, Log
from swimid.logs.trials import Cruise, Drive, FreeSwim, StrokeDrive, TrialSet
from swimid.notices import warn
from swimid.propulsion import cruise_table as cruise_format
from swimid.propulsion.model import SPEED, RecoilModel, SurgeModel, plate_inertia
from swimid.results import parameters as parameters_format
from swimid.results.parameters import ParameterFile
from swimid.robots.file import Robot

#: The paper's stop-watch error (section 3.4), s, and the scatter of speeds between runs taken
#: beside it: they set how runs weigh against each other, the overall size is estimated.
STOP_WATCH_SD_S = 0.1
SPEED_SCATTER = 0.01
#: The keys of a trials file that are used, by experiment. The phase of the drive does not touch
#: averages over beats; a stroke is refused by name.
USES = {
    "cruise": frozenset({"format", "experiment", "robot", "table", "drag"}),
    "free-swim": trials_format.EVERYWHERE
    | {"trials.drive"}
    | {f"trials.drive.{key}" for kind in (Drive, StrokeDrive) for key in kind.model_fields},
}


def load(source: str | Path | TrialSet, *, drag: parameters_format.Source | None = None) -> Experiment:
    """Read a cruise or free-swim trials file.

    Parameters
    ----------
    drag : path, ParameterFile or result of fit_drag, optional
        Parameters of the falling-weight rig, in place of the trials file's ``drag``.

    Raises
    ------
    InputError
        For anything wrong in one of the files.
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


def drag_numbers(drag: ParameterFile, path: Path, robot: Robot) -> tuple[float, float]:
    """``rho C_d A / 2`` (kg/m) and ``m_f + m_a`` (kg) from a drag file and the robot."""
    coefficient, added = parameters_format.require(drag, ("drag_coefficient", "added_mass"), path)
    body = robot.body
    if body.inertial_mass_kg is None or body.frontal_area_m2 is None:
        raise InputError(
            f"the robot '{robot.name}' needs body.inertial_mass_kg and body.frontal_area_m2 for a "
            "cruise experiment"
        )
    return 0.5 * robot.fluid.density_kg_m3 * coefficient * body.frontal_area_m2, body.inertial_mass_kg + added


def fin_inertias(robot: Robot, fins: list[str], path: Path) -> dict[str, float | None]:
    """Hydrodynamic inertia of each fin, kg m2: as given, from Eq 6 for a rectangle, or None."""
    inertias: dict[str, float | None] = {}
    for fin in dict.fromkeys(fins):
        if fin not in robot.fins:
            close = nearest(fin, list(robot.fins))
            hint = f"did you mean '{close}'? " if close else ""
            raise InputError(
                f"the robot '{robot.name}' has no fin '{fin}'",
                file=path,
                column="fin",
                hint=f"{hint}it has: {', '.join(robot.fins) or 'none'}",
            )
        known, density = robot.fins[fin], robot.fluid.density_kg_m3
        inertias[fin] = known.hydrodynamic_inertia_kg_m2
        if inertias[fin] is None and known.shape == "rectangle":
            inertias[fin] = plate_inertia(known.height_m, known.length_m, known.axle_gap_m, density)
    return inertias


def recoil_model(
    robot: Robot, fins: list[str], drag: parameters_format.Source, *, unknown: Sequence[str] = (), path: Path
) -> RecoilModel:
    """Return the recoil law of the fins of a robot, with the drag of a rig.

    Parameters
    ----------
    fins : list of str
    drag : path or ParameterFile
        Parameters of the rig.
    unknown : sequence of str
        Fins whose inertia is a parameter, whatever the robot file says.
    path : Path
        File that names the fins.
    """
    file = parameters_format.read(drag, model=("falling-weight", "towed", "free-decay"))
    area, mass = drag_numbers(file, parameters_format.place(drag), robot)
    inertias = fin_inertias(robot, fins, path)
    inertias |= dict.fromkeys(unknown)
    return RecoilModel(drag_area_kg_m=area, moving_mass_kg=mass, fins=inertias)


def _cruise(path: Path, entries: Cruise, robot: Robot, source: parameters_format.Source) -> Experiment:
    drag_path = parameters_format.place(source)
    drag = parameters_format.read(source, model=("falling-weight", "towed", "free-decay"))
    table = cruise_format.read(path.parent / entries.table if entries._held is None else entries._held)
    model = recoil_model(robot, table.fin, source, path=table.path)
    middle = (float(np.median(table.frequency_hz)), float(np.deg2rad(0.7 * np.median(table.amplitude_deg))))
    trials = []
    for fin, inertia in model.fins.items():
        rows = np.array([f == fin for f in table.fin])
        speed, distance = table.mean_speed_m_s[rows], table.distance_m[rows]
        spread = np.hypot(speed**2 / distance * STOP_WATCH_SD_S, SPEED_SCATTER * speed)
        inputs = {
            "frequency_hz": table.frequency_hz[rows],
            "amplitude_rad": np.deg2rad(table.amplitude_deg[rows]),
            "distance_m": distance,
        }
        trials.append(
            Trial(
                id=fin,
                role="fit",
                time_s=np.arange(len(speed), dtype=float),
                measured={SPEED: speed},
                inputs=inputs,
                cruise=CruiseInput(fin, inertia, middle, np.flatnonzero(rows)),
                value_sd={SPEED: np.nan_to_num(spread, nan=1.0)},
            )
        )
    read = [*inputs_of(path, entries, [table.source]), parameters_format.origin(source)]
    facts = {"drag": drag, "drag_path": drag_path}
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
                f"the trial '{entry.id}' has no 'drive' that says its beat",
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
        beat_facts[entry.id] = stated_against_found(entry.id, drive.frequency_hz, beat, used="measured")
        if drive.bias_deg != 0:
            turning.append(entry.id)
            continue
        waveforms.setdefault(_waveform(drive), entry.id)
        frequency = beat.frequency_hz if beat is not None else drive.frequency_hz
        time, speed = beat_averages(log, 1.0 / frequency)
        # the law knows the full stroke only; a ramp that nobody stated is none of a measured log
        ramp = drive.ramp_s if "ramp_s" in drive.model_fields_set else 0.0
        full = time - 0.5 / frequency >= ramp - 1e-9
        time, speed = time[full], speed[full]
        whole = int(np.isfinite(speed).sum())
        if whole < 4:
            after = "" if full.all() else f" after the drive's ramp of {ramp:g} s"
            raise InputError(f"holds {whole} whole beats{after}; at least 4 are needed", file=log.path)
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
            f"'{first}' swims with the drive {_said(one)}, '{second}' with {_said(other)}: each has a thrust "
            "of its own",
            file=path,
            column="drive.waveform",
            hint="write a trials file for each",
        )
    if any(t.surge.amplitude_rad <= 0 for t in trials):
        raise InputError("a drive amplitude is zero", file=path, column="amplitude_deg")
    # frequencies measured as one setting scatter by their error: take the settings' medians
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
    """What makes the thrust of one stroke another's; on its limit cycle the Hopf oscillator is the sine."""
    if drive.waveform == "a-cpg" and drive.asymmetry != 0:
        return "a-cpg", drive.asymmetry
    return "sine", 0.0


def _said(waveform: tuple[str, float]) -> str:
    return waveform[0] if waveform[1] == 0 else f"{waveform[0]} of asymmetry {waveform[1]:g}"


def _pooled_frequencies(trials: list[Trial]) -> list[Trial]:
    """Frequencies within the tolerance of each other are one setting: their median."""
    values = np.array([t.surge.frequency_hz for t in trials])
    pooled = [float(np.median(values[np.abs(values / v - 1) < FREQUENCY_RTOL])) for v in values]
    return [replace(t, surge=replace(t.surge, frequency_hz=f)) for t, f in zip(trials, pooled, strict=True)]


def beat_averages(log: Log, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Surge averaged over whole beats: middle of each (s) and its average; NaN where samples are missing.

    From ``u_m_s``, or from position and yaw: then the displacement over a beat along its mean heading.

    Raises
    ------
    InputError
        When the log does not resolve the beat, or holds no complete samples.
    """
    columns = ["u_m_s"] if "u_m_s" in log else ["x_m", "y_m", "yaw_rad"]
    there = np.all([np.isfinite(log[c]) for c in columns], axis=0)
    time = log.time_s[there]
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
    middles = 0.5 * (edges[1:] + edges[:-1])

    def over_beats(values: np.ndarray) -> np.ndarray:
        return np.diff(np.interp(edges, time, values))

    def averages(values: np.ndarray) -> np.ndarray:
        # integrated to the very edges of a beat: a sample more or less would leave a ripple
        return over_beats(cumulative_trapezoid(values, time, initial=0.0)) / period_s

    if "u_m_s" in log:
        speeds = averages(log["u_m_s"][there])
    else:
        x, y = (over_beats(log[c][there]) for c in ("x_m", "y_m"))
        heading = averages(np.unwrap(log["yaw_rad"][there]))
        speeds = (x * np.cos(heading) + y * np.sin(heading)) / period_s
    gaps = np.diff(time)
    for k in np.flatnonzero(gaps > 3 * np.median(gaps)):
        speeds[(edges[1:] > time[k]) & (edges[:-1] < time[k + 1])] = np.nan
    return middles, speeds
