"""Friction in proportion to the load that is carried."""

import math

import numpy as np
from numba import cfunc

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.hooks import FORCE_SIGNATURE, Force

#: Friction of a load that changes sets in over this share of the typical speed.
ROUND = 0.02


@cfunc(FORCE_SIGNATURE, cache=True)
def loaded(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """``-mu |load| sgn(v)``, sign rounded off; the load a spring's and a force's that was measured.

    Constants: mu, the rounding speed, stiffness and rest position of the spring, then times and forces.
    """
    count = (len(constants) - 4) // 2
    load = -constants[2] * (pose[0] - constants[3])
    if count > 0:
        low, high = 0, count - 1
        while high - low > 1:
            middle = (low + high) // 2
            if constants[4 + middle] <= t:
                low = middle
            else:
                high = middle
        begin, end = constants[4 + low], constants[4 + high]
        share = min(max((t - begin) / (end - begin), 0.0), 1.0) if end > begin else 0.0
        first, second = constants[4 + count + low], constants[4 + count + high]
        load += first + share * (second - first)
    v = velocity[2]
    wrench[0] -= constants[0] * abs(load) * v / math.sqrt(v * v + constants[1] * constants[1])


class LoadFriction(Effect):
    """``mu |load|`` of dry friction (Coulomb): the bearing, slide or gear that carries more brakes more.

    The load of a rig is what its bearing, guide or slide passes on: the pull of a weight (in the trials with
    a pulley, where any has one), the measured force of a tow, the restoring force of a decay (Reid's
    damping). A driven joint carries the torque ``I q'' + D q' |q'|`` of inertia and drag beyond it, the joint
    itself held in place and those beyond it straight; a position servo of stiffness k stands still while it
    is closer to its command than ``mu |torque| / k``.

    Parameters
    ----------
    everywhere : bool
        On rigs, whether it acts in trials without a pulley.
    """

    name = "load-friction"
    meaning = "friction in proportion to the load that a bearing, slide or servo carries"
    sources = (
        "boxfish paper, Eq 7 and section 4.1",
        "Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30:1083",
        "Reid 1956, J. R. Aeronaut. Soc. 60:283",
    )
    needs = frozenset({"command", "coefficients", "force"})
    smooth = True

    def __init__(self, *, everywhere: bool = False) -> None:
        self.everywhere = everywhere

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Rigs, and planar robots that some trial drives by a command."""
        if model.rig is not None:
            return [LoadFriction(everywhere=not common.with_pulley(trials))]
        driven = model.body is not None and bool(model.body.driven)
        return [self] if driven and any(model.commanded(t) for t in trials) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The share of the load, or of servos the angle per torque.

        Pulleys and slides lose 3 to 10 % of what they carry; what holds a joint back by a twentieth of its
        amplitude at the largest torque is a size that one begins to see.
        """
        if model.rig is not None:
            size, words = (0.01 if model.rig.swings else 0.03), "friction per load"
            return (common.parameter("share", "1", size, words, lower=0.0, upper=0.9),)
        yields = []
        for trial in trials:
            for load, (time, told, _) in zip(_loads(model), model.commands(trial), strict=True):
                torque = float(np.max(_torque(load, time, told), initial=0.0))
                if torque > 0.0:
                    yields.append(0.5 * float(np.ptp(told)) / torque)
        size = 0.05 * float(np.median(yields)) if yields else 1.0
        words = "angle by which a joint is held back per torque it carries"
        return (common.parameter("held_rad_N_m", "rad/(N m)", size, words, lower=0.0, upper=30.0 * size),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """More dry friction, or joints that stick under load."""
        share = float(values[0])
        if model.rig is None:
            loads = _loads(model)

            def command(time_s: Array, angle: Array, joint: int) -> Array:
                def stuck(time: Array, told: Array) -> Array:
                    return common.held_back(told, share * _torque(loads[joint], time, told))

                return common.bridged(stuck, time_s, angle)

            return Hooks(command=(command,) if model.commanded(trial) else ())
        if not (trial.rig.pulley or self.everywhere):
            return Hooks()
        measured = trial.inputs.get("force_N")
        if measured is None and not model.rig.swings:
            return common.more("dry", share * abs(trial.rig.pull))
        slow = ROUND * model.scales([trial]).speed
        table = np.zeros(0) if measured is None else np.concatenate([trial.time_s, measured])
        constants = np.array([share, slow, 0.0, 0.0, *table])

        def take(c: dict[str, float]) -> None:
            constants[2:4] = c["stiffness"], c["rest"]

        return Hooks(coefficients=(take,), force=(Force(loaded, constants),))


def _loads(model: Model) -> list[tuple[float, float]]:
    """Inertia and quadratic drag of what each driven joint carries."""
    body = common.links(model)
    tables = body.tables()
    return [body.carried(tables, k) for k in range(len(body.driven))]


def _torque(load: tuple[float, float], time_s: Array, angle: Array) -> Array:
    """Size of the torque of a joint that moves so, N m."""
    if len(time_s) < 2:
        return np.zeros(len(time_s))
    rate = np.gradient(angle, time_s)
    return np.abs(load[0] * np.gradient(rate, time_s) + load[1] * rate * np.abs(rate))
