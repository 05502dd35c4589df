"""What several effects are made of: their parameters, what they ask of a model, and hooks of one kind."""

from __future__ import annotations

import math
from abc import ABC
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from swimid.effects.base import Effect
from swimid.fitting.hooks import Force, Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

if TYPE_CHECKING:
    from swimid.swimmer.planar.body import Body


def parameter(
    name: str,
    unit: str,
    scale: float,
    meaning: str,
    *,
    lower: float = -math.inf,
    upper: float = math.inf,
    start: float = 0.0,
    per_trial: bool = False,
) -> Parameter:
    """A parameter of an effect; most vanish at zero."""
    return Parameter(name, unit, lower, upper, start, scale, per_trial=per_trial, meaning=meaning)


# ---------------------------------------------------------------- models


def rotates(model: Model) -> bool:
    """Whether it has one coordinate, and that is an angle."""
    return model.rig is not None and model.rig.rotation


def pulled(model: Model) -> bool:
    """Whether it is a body on a rig that is pulled from place to place."""
    return model.rig is not None and not model.rig.swings


def with_pulley(trials: Sequence[Trial]) -> bool:
    """Whether some trial has a pulley."""
    return any(trial.rig.pulley for trial in trials)


def free_body(model: Model) -> Body | None:
    """Its links where the base moves."""
    return model.body if model.body is not None and model.body.free else None


def links(model: Model) -> Body:
    """Its links, for an effect that applies to nothing else."""
    assert model.body is not None
    return model.body


# ---------------------------------------------------------------- hooks


def more(coefficient: str, value: float) -> Hooks:
    """More of one coefficient of a model's equation."""

    def change(coefficients: dict[str, float]) -> None:
        coefficients[coefficient] += value

    return Hooks(coefficients=(change,))


def at_hull(body: Body, function: Any, constants: Array) -> Force:
    """A force at the centre of mass of the heaviest link."""
    x, y = body.centre(body.hull)
    return Force(function, constants, body.hull, x, y)


class RigCoefficient(Effect, ABC):
    """More of one coefficient of a rig's equation, where the model does not estimate it.

    Attributes
    ----------
    coefficient : str
        In the model's equation.
    own : tuple of str
        Parameters of the model that stand for the same.
    pulley : bool
        Whether it acts only in trials that have one.
    """

    needs = frozenset({"coefficients"})
    smooth = True
    coefficient: ClassVar[str]
    own: ClassVar[tuple[str, ...]] = ()
    pulley: bool = False

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Rigs whose model does not estimate it, of a pulley's those with one."""
        applies = model.rig is not None and not model.estimates(*self.own)
        return [self] if applies and (not self.pulley or with_pulley(trials)) else []

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the coefficient."""
        acts = trial.rig.pulley or not self.pulley
        return more(self.coefficient, values[0]) if acts else Hooks()
