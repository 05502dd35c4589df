"""Experiment ``cruise``: a table of the times in which the robot swims a known distance from rest."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.errors import InputError, UsageError
from swimid.files.yamlio import ASK
from swimid.fitting.fit_common import Experiment, SimulationRun
from swimid.fitting.model import Array, CruiseInput, Trial
from swimid.logs.experiments import Params, Trials
from swimid.propulsion.model import SPEED, RecoilModel
from swimid.propulsion.trials import RIGS, read_table, recoil_model, table_columns
from swimid.results import parameters as parameters_format
from swimid.robots import file as robot_format

#: Standard deviation of the stop-watch times of cruise runs, s (boxfish paper, section 3.4), and relative
#: standard deviation of the average speed between repeated runs with the same setting.
TIME_SD_S, SPEED_RSD = 0.1, 0.01
#: Course length so large that the start from rest has a negligible effect on the mean speed, m.
FAR_M = 1e9


class Cruise(Trials):
    """Trials file of a cruise experiment, which names a table of cruising speeds.

    Example::

        format: swimid-trials/1
        experiment: cruise
        robot: boxfish
        table: speeds.csv
        drag: drag.yaml
    """

    about = "table of cruising speeds; drag is the result of fit-drag for this robot"
    models = (RecoilModel.name,)
    commands = ("fit-propulsion",)
    needs = (
        ("fin",),
        ("frequency_hz",),
        ("amplitude_deg",),
        ("distance_m",),
        ("time_s", "mean_speed_m_s"),
    )
    asked = {"drag": ASK}

    experiment: Literal["cruise"]
    table: str
    drag: str | None = None

    def load(
        self,
        path: Path,
        *,
        params: Params | None = None,
        drag: parameters_format.Source | None = None,
        **options: Any,
    ) -> Experiment:
        """Read the table (see :meth:`Trials.load`).

        Parameters
        ----------
        params : (Path, ParameterFile), optional
            Parameter file, which states the drag file of its fit.
        drag : path, ParameterFile or result of fit_drag, optional
            Parameters of the falling-weight rig. They replace ``drag`` of the trials file.
        """
        robot = self.read_robot(path.parent)
        if params is not None and params[1].settings.get("drag_file") is not None:
            drag = find_drag_file(*params)
        elif drag is None and self.drag:
            drag = path.parent / self.drag
        if drag is None:
            raise InputError(
                "no drag file is given",
                file=path,
                column="drag",
                hint="run fit-drag first, then give --drag drag.yaml",
            )
        facts = {
            "drag": parameters_format.read(drag, model=RIGS),
            "drag_path": parameters_format.source_path(drag),
        }
        source: Any = self._held
        if source is None:
            source = path.parent / self.table
        table = read_table(source)
        model = recoil_model(robot, table.fin, drag, path=table.path)
        middle = (
            float(np.median(table.frequency_hz)),
            float(np.deg2rad(0.7 * np.median(table.amplitude_deg))),
        )
        trials = []
        for fin, inertia in model.fins.items():
            rows = np.array([f == fin for f in table.fin])
            speed, distance = table.mean_speed_m_s[rows], table.distance_m[rows]
            # Compute standard deviations of the speeds. Only their ratios between runs matter, because the
            # fit estimates the size of the noise.
            spread = np.hypot(speed**2 / distance * TIME_SD_S, SPEED_RSD * speed)
            inputs = {
                "frequency_hz": table.frequency_hz[rows],
                "amplitude_rad": np.deg2rad(table.amplitude_deg[rows]),
                "distance_m": distance,
            }
            trial = Trial(fin, "fit", np.arange(len(speed), dtype=float), {SPEED: speed}, inputs)
            weights = {SPEED: np.nan_to_num(spread, nan=1.0)}
            trials.append(replace(trial, cruise=CruiseInput(fin, inertia, middle), value_sd=weights))
        sources = [table.source, parameters_format.origin(drag)]
        return Experiment.of(self, path, model, trials, sources, robot, facts=facts)

    @classmethod
    def prepare_run(cls, options: Any, params: Params, time_s: Array) -> SimulationRun:
        """Return a simulated cruise for ``--fin``, ``--frequency-hz`` and ``--amplitude-deg``."""
        path, file = params
        fin, frequency, amplitude = options.fin, options.frequency_hz, options.amplitude_deg
        if fin is None or frequency is None or amplitude is None:
            raise UsageError("cruising needs --fin, --frequency-hz and --amplitude-deg")
        unknown = [n.removeprefix("inertia_") for n in file.parameters if n.startswith("inertia_")]
        robot = robot_format.read(*parameters_format.robot_of(file, path, options.robot))
        drag, place = find_drag_file(path, file), robot_format.locate(robot.name)
        model = recoil_model(robot, [fin, *unknown], drag, unknown=unknown, path=place)
        distance = options.distance_m or FAR_M
        inputs = {
            "frequency_hz": np.array([frequency]),
            "amplitude_rad": np.deg2rad([amplitude]),
            "distance_m": np.array([distance]),
        }
        trial = Trial(fin, "fit", np.zeros(1), {}, inputs=inputs, cruise=CruiseInput(fin, model.fins[fin]))
        far = replace(trial, id=f"{fin} (far)", inputs={**inputs, "distance_m": np.array([FAR_M])})
        stated = {name: estimate.value for name, estimate in file.parameters.items()} | options.chosen
        for name, law in (("frequency_exponent", 3.0), ("amplitude_exponent", 2.0)):
            if stated.get(name, law) != law:
                raise UsageError(
                    f"{name} is {stated[name]:g} in place of {law:g}, so the reference values of the fitted "
                    "table are needed: give the trials file with --trials"
                )

        def compute(applied: Any, values: Array) -> list[float]:
            runs = applied.model.run_many([(values, trial), (values, far)], measured=False)
            mean, terminal = (float(run[SPEED][0]) for run in runs)
            if options.distance_m is None:
                mean = math.nan
            hooks, force = applied.model.hooks(values, far), math.nan
            if not hooks.flow:
                c = hooks.change_values(model.resistance(), "coefficients")
                force = c["dry"] + terminal * (c["linear"] + terminal * c["quadratic"])
            return [terminal, mean, force]

        units = {"terminal_speed_m_s": "m/s", SPEED: "m/s", "propulsive_force_N": "N"}
        extra = table_columns(fin, {**inputs, "distance_m": np.array([options.distance_m or math.nan])})
        return SimulationRun(model, trial, robot.name, extra=extra, units=units, quantities=compute)


def find_drag_file(path: Path, file: parameters_format.ParameterFile) -> parameters_format.Source:
    """Return the drag parameters with which the parameters of the recoil law were estimated.

    Raises
    ------
    InputError
        If the drag file is neither at the path that the fit recorded nor in the folder of the parameter file.
    """
    if file._drag is not None:
        return file._drag
    named = file.settings.get("drag_file")
    if named is None:
        raise InputError("this key is missing", file=path, column="settings.drag_file")
    # the path is relative to the folder in which the fit was run
    places = [path.parent / Path(str(named)).name, path.parent / str(named), Path(str(named))]
    place = next((p for p in places if p.is_file()), None)
    if place is None:
        raise InputError(
            f"the drag file {named}, with which these parameters were fitted, does not exist",
            file=path,
            column="settings.drag_file",
            hint="put it beside this file",
        )
    return place
