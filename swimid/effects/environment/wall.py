"""A wall near the tracks."""

import math
from typing import ClassVar

import numpy as np
from numba import cfunc

from swimid.effects import common
from swimid.effects.base import SIZES, Array, Effect, Effects, Hooks, Inside, Model, Parameters, Trial, Trials
from swimid.fitting.hooks import FORCE_SIGNATURE, Force, traceable

#: Largest exponent: a start beyond the extreme of the measured tracks is not far beyond.
STEEPEST = 2.0


@traceable(on="hull", constants=5)
def push_off(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """A force along a world axis; constants force, decay length, direction to the wall, extreme along it."""
    along, across = constants[2], constants[3]
    gap = constants[4] - (along * pose[0] + across * pose[1])
    push = constants[0] * math.exp(min(-gap / constants[1], STEEPEST))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    wrench[0] -= push * (c * along + s * across)
    wrench[1] -= push * (c * across - s * along)


@cfunc(FORCE_SIGNATURE, cache=True)
def blockage(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """More drag towards the end of a run; constants drag, gain, decay length and end."""
    grown = constants[1] * math.exp(min(-(constants[3] - pose[0]) / constants[2], STEEPEST))
    wrench[0] -= constants[0] * grown * velocity[0] * abs(velocity[0])


class Wall(Effect):
    """A wall at one side of the pool, felt as ``exp(-d / l)``, d the distance from the tracks' extreme.

    A swimmer is pushed away from it (drawn to it where the force is negative); the quadratic drag of a
    body on a rig grows towards it by the factor ``1 + gain exp(-d / l)``.

    Parameters
    ----------
    side : str
        ``x_max``, ``x_min``, ``y_max`` and so on.
    extreme_m : float
        The tracks' extreme coordinate on that side.
    """

    name = "wall"
    meaning = "wall near the tracks"
    sources = ("tendon fish paper, section V", "dolphin paper, section 4.2.1")
    needs = frozenset({"force"})

    def __init__(self, side: str = "x_max", extreme_m: float = 0.0) -> None:
        self.side = side
        self.extreme_m = extreme_m

    def variants(self, model: Model, trials: Trials) -> Effects:
        """One per side for free swimmers; the far end for falling weights and towed bodies."""
        names = tuple(f"{axis}_m" for axis in model.axes)
        if common.free_body(model):
            ends: tuple[str, ...] = ("max", "min")
        elif common.pulled(model):
            ends = ("max",)
        else:
            return []
        walls: list[Effect] = []
        for name in names:
            values = np.concatenate([np.zeros(0), *(t.measured[name] for t in trials if name in t.measured)])
            values = values[np.isfinite(values)]
            for end in ends if len(values) else ():
                extreme = float(values.max() if end == "max" else values.min())
                kind = _Push if common.free_body(model) else Wall
                walls.append(kind(f"{name.removesuffix('_m')}_{end}", extreme))
        return walls

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Force at the tracks' extreme, N (gain of the drag on a rig), and its decay length, m."""
        if model.body is not None:
            length = sum(model.body.lengths_m)
            size = 0.05 * model.scales(trials).force
            words = "push of the wall at the extreme"
            first = common.parameter(f"{self.side}_force_N", "N", size, words)
        else:
            length = 0.4 * model.scales(trials).span
            words = "relative growth of drag at the extreme"
            first = common.parameter(f"{self.side}_gain", "1", 1.0, words, lower=0.0)
        lower, upper, start, size = (share * length for share in (0.1, 3.0, 0.5, 0.2))
        words = "length over which it decays"
        name = f"{self.side}_decay_m"
        return first, common.parameter(name, "m", size, words, lower=lower, upper=upper, start=start)

    def tries(self, parameters: Parameters) -> list[Array]:
        """The force, in which the change is nearly linear, at two decay lengths."""
        force, decay = parameters
        return [np.array([SIZES[1] * force.scale, share * decay.start]) for share in (0.5, 1.5)]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A force at the centre of mass of the heaviest link."""
        body = model.body
        if body is not None:
            axis, end = self.side.split("_")
            side = 1.0 if end == "max" else -1.0
            place = [side if axis == "x" else 0.0, 0.0 if axis == "x" else side, side * self.extreme_m]
            return Hooks(force=(common.at_hull(body, push_off, np.array([*values, *place])),))
        constants = np.array([0.0, *values, self.extreme_m])

        def take(c: dict[str, float]) -> None:
            constants[0] = c["quadratic"]

        return Hooks(coefficients=(take,), force=(Force(blockage, constants),))


class _Push(Wall):
    """Of a free swimmer: a push felt three lengths of its body away could stand for any slow force."""

    inside: ClassVar[Inside] = {f"{axis}_{end}_decay_m": "upper" for axis in "xyz" for end in ("min", "max")}
