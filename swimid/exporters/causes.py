"""Application of the effects in a parameter file (causes) to the exported robot.

A cause is an effect whose parameters are in the parameter file. The hooks of the effect change the exported
robot as they change a simulation. The hooks ``tables`` change the masses, springs and force elements of every
export. Forces and motion of the water are exported only if the simulator can apply them. Changes of the
commands need a simulator with the same servo law, or a filter of :mod:`swimid.exporters.filters`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swimid.effects.base import Effect
from swimid.errors import InputError
from swimid.exporters import filters
from swimid.exporters.filters import Filter
from swimid.files.templates import environment
from swimid.fitting.drives import TailBeat
from swimid.fitting.model import NONE, Hooks, SwimInput, Trial
from swimid.results.parameters import ParameterFile
from swimid.simulation.catalogue import constants_of, form_of, load_effects
from swimid.swimmer.planar.model import MultilinkModel
from swimid.swimmer.tree import Actuated

#: Trial for which the changes by an effect are computed, in place of the trials of the fit. The trial begins
#: at the origin and has a sine command.
EXPORT_TRIAL = Trial(
    "export", "fit", np.linspace(0.0, 1.0, 51), {}, swim=SwimInput(TailBeat("sine", 1.0, 0.3))
)
#: Effects that depend on quantities of the fitted trials. Each has a function, which returns whether the
#: parameter file contains these quantities as constants of the effect, and a reason, which is stated if the
#: effect is left out because they are missing.
OF_TRIALS: dict[str, tuple[Callable[[Mapping[str, Any]], bool], str]] = {
    "drag-reynolds": (
        lambda constants: "reference_m_s" in constants and not constants.get("whole"),
        "its reference speed is that of the trials",
    ),
    "wall": (lambda constants: "extreme_m" in constants, "the place of the wall is that of the tracks"),
    "waves": (lambda _: False, "their amplitudes and phases are those of single trials"),
}


@dataclass(frozen=True)
class ExportedCause:
    """Effect of a parameter file, with the values of its parameters and its changes of the robot.

    Attributes
    ----------
    name : str
        Name of the effect.
    values : mapping of str to float
        Values of the effect's parameters.
    effect : Effect
    hooks : Hooks
        Changes of a simulation that begins at the origin. They are empty for an effect of the sensors, for an
        effect that is left out, and for parameters at their null values.
    reason : str
        Reason for which every export leaves out the effect; empty if an export can contain the effect.
    """

    name: str
    values: Mapping[str, float]
    effect: Effect
    hooks: Hooks = NONE
    reason: str = ""

    @property
    def rigid(self) -> bool:
        """Whether the effect changes masses and inertias of the robot itself, and not of the added water."""
        return self.effect.stage == "structure" and not self.hooks.force


def read_causes(file: ParameterFile, model: MultilinkModel, path: Path) -> list[ExportedCause]:
    """Return the effects of a parameter file with their parameter values, in the order in which they act.

    Parameters
    ----------
    model : MultilinkModel
        Model of the robot, whose parameters start at the values of the file.

    Raises
    ------
    InputError
        If an effect is unknown or has other parameters, or if a parameter is negative that must not be
        negative.
    """
    causes = []
    for effect in load_effects(file, path):
        name = effect.name
        own = {parameter: e.value for parameter, e in file.of_effect(name).items()}
        contained, reason = OF_TRIALS.get(name, (None, ""))
        if effect.stage == "sensing" or (contained and not contained(constants_of(file, name))):
            causes.append(ExportedCause(name, own, effect, reason=reason))
            continue
        effect = form_of(effect, file, path, model, [EXPORT_TRIAL])
        needed = effect.parameters(model, [EXPORT_TRIAL])
        for p in needed:
            if p.lower == 0.0 and own[p.name] < 0.0:
                column = f"parameters.{name}/{p.name}"
                text = f"{own[p.name]:g} is negative; it must be zero or positive"
                raise InputError(text, file=path, column=column)
        hooks = NONE
        if any(own[p.name] != p.start for p in needed):
            hooks = effect.hooks(np.array([own[p.name] for p in needed]), EXPORT_TRIAL, model)
        causes.append(ExportedCause(name, own, effect, hooks))
    return causes


def limits_of(
    causes: Sequence[ExportedCause], filtered: Sequence[ExportedCause], *, forces: bool
) -> list[str]:
    """Return sentences on the effects that an exported file does not contain.

    These effects are left out, or a Python file next to the exported file applies them.

    Parameters
    ----------
    filtered : sequence of Cause
        Effects that the Python file applies as filters of the commands.
    forces : bool
        Whether the simulator applies the forces of effects.
    """
    applied = [cause for cause in causes if cause.hooks.force and not forces]
    sensing = [cause for cause in causes if cause.effect.stage == "sensing"]
    limits = [f"{cause.name} is left out: {cause.reason}" for cause in causes if cause.reason]
    for several, words in (
        (applied, "left out, because the target has no such force"),
        (sensing, "an error of the measurement, not a part of the robot"),
        (
            filtered,
            "the target has no such law of a servo; a Python file beside the output filters the commands, "
            "and without this file the joints follow their commands exactly",
        ),
    ):
        if several:
            limits.append(f"{', '.join(cause.name for cause in several)}: {words}")
    return limits


# ---------------------------------------------------------------- filters of the commands


#: Class of the command filter for each effect of the actuators.
FILTERS: dict[str, type[Filter]] = {
    "amplitude-loss": filters.AmplitudeLossFilter,
    "amplitude-offset": filters.AmplitudeOffsetFilter,
    "joint-locked": filters.JointLockedFilter,
    "load-friction": filters.LoadFrictionFilter,
    "rate-limit": filters.RateLimitFilter,
    "servo-backlash": filters.ServoBacklashFilter,
    "servo-delay": filters.ServoDelayFilter,
    "servo-lag": filters.ServoLagFilter,
    "slip": filters.SlipFilter,
    "stribeck": filters.StribeckFilter,
}


def filter_arguments(cause: ExportedCause, actuator: Actuated, model: MultilinkModel) -> Mapping[str, float]:
    """Return the arguments of an effect's command filter for an actuator; empty if it has no filter."""
    lock = f"locked_{actuator.column.removesuffix('_rad')}"
    if cause.name == "load-friction":
        inertia, drag = model.body.loads[model.actuators.index(actuator)]
        return {**cause.values, "inertia_kg_m2": inertia, "drag_N_m_s2": drag}
    if cause.name == "joint-locked":
        return {"lock": cause.values[lock]} if lock in cause.values else {}
    if cause.name == "amplitude-offset" and actuator.law.gain == 0.0:
        return {}
    return cause.values


def filters_text(filtered: Sequence[ExportedCause], model: MultilinkModel, origin: Mapping[str, str]) -> str:
    """Return the text of a Python file that filters the commands without importing swimid.

    The Python file filters the command of each driven joint, or of each actuator that several joints follow.
    """
    joints = {}
    for actuator in model.actuators:
        calls = []
        for cause in filtered:
            if values := filter_arguments(cause, actuator, model):
                words = ", ".join(f"{name}={value!r}" for name, value in values.items())
                calls.append(f"{FILTERS[cause.name].__name__}({words})")
        joints[actuator.name] = calls
    kinds: list[type[Filter]] = [Filter, *dict.fromkeys(FILTERS[cause.name] for cause in filtered)]
    sources = [inspect.getsource(kind) for kind in kinds]
    templates = environment("swimid.exporters", autoescape=False, keep_trailing_newline=True)
    template = templates.get_template("causes.jinja")
    return template.render(origin=origin, filtered=filtered, joints=joints, sources=sources)
