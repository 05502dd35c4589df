"""Experiment ``mjcf``: trials of a robot whose model is a MuJoCo model file (MJCF or URDF)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from swimid.errors import InputError
from swimid.files import yamlio
from swimid.fitting.fit_common import Experiment
from swimid.logs.experiments import TrialEntry
from swimid.notices import warn
from swimid.simulators.model import SimulatorParameter, SimulatorTrials

if TYPE_CHECKING:
    from swimid.simulators.mjcf import MjcfModel

#: Maximum change of a channel between simulations with the whole and half the MuJoCo time step, as a fraction
#: of its range. A larger change is reported in a warning.
SMALL_CHANGE = 1e-3


class MjcfParameter(SimulatorParameter):
    """Attribute of an element of a MuJoCo model file that is fitted as a parameter."""

    #: Kind and name of the element, and attribute: ``joint/tail/stiffness``, ``geom/fin/fluidcoef[0]``,
    #: ``option/density``.
    path: str
    #: Whether the moments of inertia of a body change in proportion to a fitted mass.
    scale_inertia: bool = False


class MjcfEntry(yamlio.Document):
    """Entry ``model`` of a trials file: a MuJoCo model file, with its parameters, inputs and outputs."""

    #: Path of the MuJoCo model file, MJCF or URDF.
    mjcf: str
    #: Name of the keyframe from which the trials start.
    keyframe: str | None = None
    parameters: Annotated[dict[str, MjcfParameter], Field(min_length=1)]
    #: Column of the log with the command of each actuator, by the name of the actuator.
    inputs: dict[str, str] = {}
    #: Quantity of the MuJoCo model that each channel measures: ``site/led/x``, ``body/head/yaw``,
    #: ``joint/tail``, ``sensor/gyro/2``.
    outputs: Annotated[dict[str, str], Field(min_length=1)]


class MjcfTrial(TrialEntry):
    """Trial of a robot whose model is a MuJoCo model file."""

    #: State at the first sample: at rest, or with estimated velocities. ``auto`` decides from the log.
    start_state: Literal["auto", "rest", "estimate"] = "auto"


class Mjcf(SimulatorTrials):
    """Trials file of a robot whose model is a MuJoCo model file.

    Example::

        format: swimid-trials/1
        experiment: mjcf
        model:
          mjcf: fish.xml
          parameters:
            k_tail: {path: joint/tail/stiffness, bounds: [0, 1]}
          inputs: {servo: cmd_servo_rad}
          outputs: {x_m: site/led/x, y_m: site/led/y, yaw_rad: body/head/yaw}
        trials:
          - {log: run1.csv}
          - {log: run2.csv, role: validate}
    """

    about = "a robot whose model is a file of MuJoCo"
    models = ("mjcf",)

    experiment: Literal["mjcf"]
    model: MjcfEntry
    trials: Annotated[list[MjcfTrial], Field(min_length=1)]

    def simulator_name(self) -> str:
        """Return the name of the MuJoCo model file."""
        return Path(self.model.mjcf).stem

    def load(self, path: Path, **options: Any) -> Experiment:
        """Read the MuJoCo model file and the logs (see :meth:`Trials.load`)."""
        from swimid.simulators.mjcf import MjcfModel

        entry, file = self.model, path.parent / self.model.mjcf
        parameters = {name: (p, p.path, p.scale_inertia) for name, p in entry.parameters.items()}
        try:
            model = MjcfModel(file, parameters, entry.inputs, entry.outputs, entry.keyframe)
        except InputError:
            raise
        except ValueError as error:
            raise self.error_at(path, ["model", "parameters"], error) from error
        trials, sources = self.read_trials(path, list(entry.inputs.values()), list(entry.outputs))
        state = options.get("start_state", "auto")
        states = [state if state != "auto" else one.start_state for one in self.trials]
        trials = [model.set_start(trial, one) for trial, one in zip(trials, states, strict=True)]
        _warn_of_step(model, trials)
        return self.make_experiment(path, model, trials, [file, *sources])


def _warn_of_step(model: MjcfModel, trials: list[Any]) -> None:
    """Warn if half the time step of the model file changes the simulation of the first trial."""
    trial = trials[0]
    values = np.array([trial.starts.get(p.name, p.start) for p in model.parameters])
    (whole,), (half,) = (
        one.run_many([(values, trial)]) for one in (model, model.at_step(0.5 * model.step_s))
    )
    if not all(np.isfinite(series).all() for series in whole.values()):
        raise InputError(
            f"the simulation of the trial '{trial.id}' diverges with the values of the file",
            file=model.path,
            hint="try a smaller timestep, or the integrator implicitfast, in the file",
        )
    # use measured ranges: a channel that hardly moves then has the range of its noise, not about zero
    measured = {name: np.ptp(v[np.isfinite(v)]) for name, v in trial.measured.items() if np.isfinite(v).any()}
    ranges = {name: max(float(np.ptp(v)), float(measured.get(name, 0.0))) for name, v in whole.items()}
    changes = {
        name: float(np.max(np.abs(half[name] - whole[name]))) / span
        for name, span in ranges.items()
        if span > 0
    }
    worst = max(changes, key=changes.__getitem__, default="")
    if worst and changes[worst] > SMALL_CHANGE:
        warn(
            "SWM091",
            f"{model.path.name}: halving the timestep of {model.step_s:g} s changes {worst} by up to "
            f"{100 * changes[worst]:.2g} % of its range in the trial '{trial.id}'; the timestep is kept, "
            "because it is part of the model",
        )
