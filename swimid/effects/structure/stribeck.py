"""Friction that is larger at rest than in motion."""

import math

import numpy as np
from numba import cfunc

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.hooks import FORCE_SIGNATURE, Force


@cfunc(FORCE_SIGNATURE, cache=True)
def relieved(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """What a body in motion is spared of its friction at rest; constants the rise and the Stribeck speed."""
    v = velocity[2]
    share = v / constants[1]
    wrench[0] += math.copysign(constants[0] * (1.0 - math.exp(-share * share)), v)


class Stribeck(Effect):
    """``(F_s - F_c) exp(-(v / v_s)^2) sgn(v)`` beyond the Coulomb friction that a model may have.

    On a rig a body at rest is held by the whole rise ``F_s - F_c`` (of a pulley in the trials that have one,
    else of the bearing or slide). A position servo of stiffness k stands still while it is closer to its
    command than ``(T_s - T_c) exp(-(w / w_s)^2) / k``, w the command's rate: it sticks where the command
    turns round. Steady beats of average models do not tell that from play.

    Parameters
    ----------
    everywhere : bool
        On rigs, whether it acts in trials without a pulley.
    """

    name = "stribeck"
    meaning = "friction that falls from its level at rest to a lower one in motion"
    sources = (
        "Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30:1083",
        "boxfish paper, Eq 7 (a friction that does not depend on speed)",
    )
    needs = frozenset({"command", "force"})

    def __init__(self, *, everywhere: bool = False) -> None:
        self.everywhere = everywhere

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Rigs, and where some trial is driven by a command."""
        if model.rig is not None:
            return [Stribeck(everywhere=not common.with_pulley(trials))]
        told = "command" in model.offers and any(model.commanded(t) for t in trials)
        return [self] if told else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The rise, N or N m, of the size of a friction one begins to see, and the Stribeck speed.

        Of servos: the angle by which the rise holds a joint back, and the rate, both against the command.
        The latter is at most half the typical speed of a rig, or half the fastest command: a friction of
        which more than 2 % are left there has not fallen, and is that of ``pulley-friction`` or play.
        """
        if model.rig is not None:
            scales = model.scales(trials)
            rise, unit = ("rise_N_m", "N m") if common.rotates(model) else ("rise_N", "N")
            size, most, top = scales.brake, math.inf, scales.speed
            word = f"stribeck_{model.rig.speed.unit.replace('/', '_')}"
            rates, moving = model.rig.speed.unit, "speed"
            what = "friction at rest beyond that in motion"
        else:
            largest = common.amplitude(model, trials)
            rise, unit, size, most = "stick_rad", "rad", 0.05 * largest, 0.9 * largest
            word, rates, top = "stribeck_rad_s", "rad/s", common.fastest(model, trials)
            what, moving = "angle by which a joint at rest is held back", "rate"
        over, least = f"{moving} over which it falls", 0.01 * top
        return (
            common.parameter(rise, unit, size, what, lower=0.0, upper=most),
            common.parameter(word, rates, 0.1 * top, over, lower=least, upper=0.5 * top, start=0.2 * top),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """A smaller and a larger rise, at a slow and at a fast Stribeck speed."""
        rise, speed = parameters
        return [
            np.array([min(size * rise.scale, rise.upper), share * speed.start])
            for size in (1.0, 3.0)
            for share in (0.4, 1.5)
        ]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """More friction at rest, less of it in motion; joints that stick."""
        rise, slow = (float(v) for v in values)
        if model.rig is not None:
            if not (trial.rig.pulley or self.everywhere):
                return Hooks()
            spared = Force(relieved, np.array([rise, slow]))
            return Hooks(coefficients=common.more("dry", rise).coefficients, force=(spared,))

        def stuck(time_s: Array, angle: Array) -> Array:
            if len(time_s) < 2:
                return angle
            rate = np.gradient(angle, time_s)
            return common.held_back(angle, rise * np.exp(-np.square(rate / slow)))

        def command(time_s: Array, angle: Array) -> Array:
            return common.bridged(stuck, time_s, angle)

        return Hooks(command=(common.every_joint(command),) if model.commanded(trial) else ())
