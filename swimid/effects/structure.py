"""Effects of the robot's own mechanics: fins, passive joints, masses."""

from __future__ import annotations

import itertools
import math
from abc import ABC
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.effects import base
from swimid.effects.base import Array, Effect, Effects, Model, Parameters, Trial, Trials, parameter
from swimid.files.kernels import numba
from swimid.fitting.model import FORCE_SIGNATURE, ExternalForce, Hooks, Stroke, traceable, typical


class ComOffset(Effect):
    """A displacement of the centre of mass of the heaviest link, along and across the link.

    The inertia about the centre of mass is unchanged. If the model has weights, the weight moves with the
    mass.
    """

    name = "com-offset"
    meaning = "centre of mass of the hull off the model's"
    sources = ("sea lion paper, section on identification", "tendon fish paper, Table II")
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must be a free swimmer."""
        return model.swimmer is not None and model.swimmer.free_base

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the offsets of the centre of mass, m: forwards, to port, and in 3-D upwards.

        In the vertical plane the second offset is upwards. In a plane, the centre of mass stays between the
        ends of the link.
        """
        if model.in_space:
            size, words = 0.01 * model.swimmer.extent, ("ahead of", "to port of", "above")
            names = zip(("along_m", "across_m", "up_m"), words, strict=True)
            most = 20.0 * size
            return tuple(
                parameter(n, "m", size, f"centre of mass {w} the model's", -most, most) for n, w in names
            )
        body = model.body
        length, (x, _) = body.lengths_m[body.hull], body.centre(body.hull)
        size, most = 0.01 * length, 0.2 * length
        side = "to port"
        if body.vertical:
            side = "above"
        return (
            parameter("along_m", "m", size, "centre of mass ahead of the model's", -length - x, -x),
            parameter("across_m", "m", size, f"centre of mass {side} of the model's", -most, most),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that move the centre of mass of the heaviest link, and its weight with it."""
        return Hooks(tables=(lambda tables: model.swimmer.shift(tables, values),))


@traceable(on="last", constants=3)
def add_bent_fin_force(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add the change of the fin's normal force by bending to the wrench.

    The constants are the compliance c, the quadratic drag coefficient k and the lift coefficient l. The force
    ``N = -(k |w| + l u) w`` of the straight fin rotates its chord by ``delta = -c N / sqrt(1 + (c N)^2)``.
    The force of the bent fin is normal to the rotated chord, and is computed from the velocities along and
    across that chord.
    """
    compliance, quadratic, lift = constants[0], constants[1], constants[2]
    u, w = velocity[0], velocity[1]
    straight = -(quadratic * abs(w) + lift * abs(u)) * w
    bend = -compliance * straight
    bend /= math.sqrt(1.0 + bend * bend)
    c, s = math.cos(bend), math.sin(bend)
    along, across = c * u + s * w, c * w - s * u
    bent = -(quadratic * abs(across) + lift * abs(along)) * across
    wrench[0] -= bent * s
    wrench[1] += bent * c - straight


class FinFlexibility(Effect):
    """A caudal fin that bends in proportion to the force across it (quasi-static, first bending mode).

    The chord of a swimmer's fin rotates by the compliance times the load. This tilts the force forwards and
    reduces the load. In a model of the average over a beat, thrust is divided by ``1 + kappa L``. L is the
    load ``I f^2 theta`` divided by its typical value.

    Parameters
    ----------
    load, inertia_kg_m2 : float
        Typical load ``I f^2 theta`` of the trials, and the inertia of fins with unknown inertia.
    """

    name = "fin-flexibility"
    meaning = "caudal fin that bends under its load"
    sources = ("dolphin paper, section 1", "Katz and Weihs 1978, J. Fluid Mech. 88:485")

    def __init__(self, load: float = 1.0, inertia_kg_m2: float = 1.0) -> None:
        self.load, self.inertia_kg_m2 = load, inertia_kg_m2

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return the form for a swimmer, or the form for a model of the average over a stroke.

        A swimmer must have drag or lift across its last link, which is the fin.
        """
        body = model.body
        if body is not None and sum(body.fin(body.tables())[:2]) > 0:
            return [self]
        if body is None and "stroke" in model.offers:
            return [FinFlexibility(*_typical(trials))]
        return []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the compliance of the fin as a parameter: rotation of its chord per force, rad/N.

        In models of the average over a beat, the parameter is the relative loss of thrust at the typical
        load.
        """
        body = model.body
        if body is not None:
            quadratic, lift, _ = body.fin(body.tables())
            across = _stroke_speed(model, body.lengths_m[-1], trials)
            load = (quadratic * across + lift * model.scales(trials).speed) * across
            words = "angle by which the fin bends per force across it"
            most = 30.0 / load
            return (parameter("compliance_rad_N", "rad/N", 0.1 / load, words, 0.0, most),)
        return (parameter("loss", "1", 0.2, "loss of thrust at the typical load", 0.0, 20.0),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the force of the bent fin to the last link, or reduce the mean thrust."""
        body = model.body
        if body is not None:
            constants = np.array([values[0], 0.0, 0.0])
            x, y = body.fin(body.tables())[2]

            def read(tables: dict[str, Any]) -> None:
                constants[1:3] = body.fin(tables)[:2]

            return Hooks(
                tables=(read,), force=(ExternalForce(add_bent_fin_force, constants, body.last, x, y),)
            )

        def weaken(stroke: Stroke) -> Stroke:
            inertia = stroke.inertia_kg_m2 if math.isfinite(stroke.inertia_kg_m2) else self.inertia_kg_m2
            load = inertia * stroke.frequency_hz**2 * np.abs(stroke.amplitude_rad) / self.load
            return replace(stroke, thrust=stroke.thrust / (1.0 + values[0] * load))

        return Hooks(stroke=(weaken,))


def _stroke_speed(model: Model, length: float, trials: Trials) -> float:
    """Return the typical speed with which the end of a fin moves across its chord, m/s.

    The length of the fin is ``length``, m.
    """
    beats = [t.swim.beat for t in trials if t.swim.beat is not None]
    speeds = [2.0 * math.pi * b.frequency_hz * abs(b.amplitude_rad) * length for b in beats]
    return typical(speeds, 0.0) or model.scales(trials).speed


def _typical(trials: Trials) -> tuple[float, float]:
    """Return the median load ``I f^2 theta`` and the median inertia I of the fins; 1 if unknown."""
    known = [t.cruise.inertia_kg_m2 for t in trials]
    middle = typical([own for own in known if own is not None], 1.0)
    loads: list[float] = []
    for trial, own in zip(trials, known, strict=True):
        frequency, amplitude = (np.where(np.isnan(v), 1.0, v) for v in trial.steady)
        loads += list(np.square(frequency) * np.abs(amplitude) * (middle if own is None else own))
    return typical(loads, 1.0), middle


@numba.cfunc(FORCE_SIGNATURE, cache=True)
def cubic(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add the cubic spring force ``-h k (x - rest)^3`` to the wrench.

    The constants are the relative growth h, the stiffness k and the rest position.
    """
    off = pose[0] - constants[2]
    wrench[0] -= constants[0] * constants[1] * off * off * off


class Hardening(Effect):
    """Duffing spring ``-K (1 + h q^2) q`` of passive joints with a spring, or of a free decay.

    K is the model's stiffness at small deflections q. With ``h < 0`` the spring softens. The restoring moment
    of a roll is proportional to the sine of the angle, which gives ``h = -1/6`` per rad^2.
    """

    name = "hardening"
    meaning = "stiffness that grows with deflection"
    sources = (
        "tendon fish paper, Eqs 3 and 4",
        "Kovacic and Brennan 2011, The Duffing Equation, chapter 2",
    )

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies.

        It applies to a swimmer with a spring in a joint, or a free decay.
        """
        return _has_spring(model)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the hardening h as a parameter: relative growth of stiffness per squared deflection.

        The unit is rad^-2 or m^-2. The scale of the parameter increases the torque at the largest deflection
        by a fifth. The lower bound keeps the stiffness of a softening spring positive up to the largest
        deflection, ``1 + 3 h q^2 > 0``.
        """
        largest, unit = _deflection(model, trials), "rad"
        if model.rig is not None:
            unit = model.rig.displacement.unit
        size, least = 0.2 / largest**2, -1.0 / (3.0 * largest**2)
        words = "growth of the stiffness with squared deflection"
        return (parameter(f"hardening_{unit}_2", f"{unit}^-2", size, words, least, 30.0 * size),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add a cubic term to the springs of the joints or of the rig."""
        body = model.body
        if body is not None:
            return base.change_springs(body, lambda own: {"cubic": max(own, 0.0) * values[0]})
        return base.force_on_rig(cubic, [values[0], 0.0, 0.0], stiffness=1, rest=2)


def _deflection(model: Model, trials: Trials) -> float:
    """Return the largest deflection of a spring in a typical trial, in the unit of the coordinate."""
    if model.body is None:
        return 0.5 * model.scales(trials).span
    columns = [axis.column for axis in model.body.passive]
    seen = [np.abs(t.measured[c]) for t in trials for c in columns if c in t.measured]
    return typical([float(np.nanmax(s)) for s in seen if np.isfinite(s).any()], base.USUAL_ANGLE)


def _has_spring(model: Model) -> bool:
    """Return whether the model is a swimmer with a spring in a joint, or a free decay."""
    body = model.body
    if body is None:
        return model.rig is not None and model.rig.swings
    tables = body.tables()
    return any(body.stiffness(tables, k) > 0 for k in range(len(body.passive)))


class JointDamping(Effect):
    """Damping ``-d phi'`` of every passive joint, in addition to that of the model."""

    name = "joint-damping"
    meaning = "viscous friction of the passive joints beyond the model's"
    sources = ("tendon fish paper, Eq 5", "dolphin paper, Eq 5")
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must be a swimmer with a passive joint."""
        return model.body is not None and bool(model.body.passive)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the additional damping of the joints as a parameter, N m s/rad.

        Its scale corresponds to a damping ratio of 0.05.
        """
        body = model.body
        tables, joints = body.tables(), range(len(body.passive))
        sizes = [
            math.sqrt(max(body.stiffness(tables, k), 1e-6) * body.joint_inertia(tables, k)) for k in joints
        ]
        size, least = 0.1 * float(np.median(sizes)), -min(body.damping(tables, k) for k in joints)
        words = "damping of each passive joint beyond the model's"
        return (parameter("damping_N_m_s_rad", "N m s/rad", size, words, lower=least),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add damping to the passive joints."""
        return base.change_springs(model.body, lambda _: {"damping": values[0]})


#: Deflection of a passive joint whose spring has 20 times the moment of the typical dry friction, rad.
DEFLECTED_RAD = 0.2


class JointFriction(Effect):
    """Dry friction of every passive joint, in addition to that of the model."""

    name = "joint-friction"
    meaning = "dry friction of a joint beyond the model's"
    sources = (
        "Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30:1083",
        "MuJoCo documentation, Computation, friction loss",
    )
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must be a swimmer with a passive joint."""
        return model.body is not None and bool(model.body.passive)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the additional moment of friction as a parameter, N m.

        Its scale is a twentieth of the moment of the spring at :data:`DEFLECTED_RAD`. A joint without a
        spring has the stiffness of the natural frequency :data:`HELD_HZ` instead.
        """
        body = model.body
        tables, joints, held = body.tables(), range(len(body.passive)), (2.0 * math.pi * HELD_HZ) ** 2
        stiff = [max(body.stiffness(tables, k), held * body.joint_inertia(tables, k)) for k in joints]
        size, least = (
            0.05 * DEFLECTED_RAD * float(np.median(stiff)),
            -min(body.friction(tables, k) for k in joints),
        )
        words = "dry friction of each passive joint beyond the model's"
        return (parameter("friction_N_m", "N m", size, words, lower=least),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add friction to the passive joints."""
        return base.change_springs(model.body, lambda _: {"friction": values[0]})


#: Maximum locked fraction of a joint, which makes a passive joint 33 times as stiff.
MAX_LOCK = 0.97
#: Natural frequency that a locked fraction of one half gives to a passive joint without a spring, Hz.
HELD_HZ = 1.0
#: Maximum product of natural frequency and integration step of a locked joint, well within the limit of
#: stability.
STABLE = 1.0


class JointLocked(Effect):
    """Partly locked joint: a driven joint moves less than its command, or a passive joint is stiffer.

    A driven joint moves by ``1 - lock`` times its command. A passive joint gains the stiffness ``K lock / (1
    - lock)``, at most that at which the integration stays stable. K is the stiffness of the joint's spring.
    Without a spring, K gives the natural frequency :data:`HELD_HZ`.

    Parameters
    ----------
    column : str
        Column of the joint in a log, for example ``joint1_rad``.
    """

    name = "joint-locked"
    meaning = "a joint that is held fast, wholly or in part"
    sources = ("dolphin paper, section 4.2.1",)

    def __init__(self, column: str = "joint1_rad") -> None:
        self.column = column

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return one form of the effect for each joint that may be locked.

        These are the passive joints, and the actuators that move and whose angle is not measured.
        """
        if model.body is None:
            return []
        given = any(t.swim.commanded for t in trials)
        beaten = any(t.swim.joints is None for t in trials)
        laws = [(actuator.column, actuator.law) for actuator in model.body.actuators]
        columns = [name for name, law in laws if given or (beaten and (law.gain or law.bias_gain))]
        columns += [axis.column for axis in model.body.passive]
        return [JointLocked(column) for column in sorted(columns)]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the locked fraction of the joint, from 0 to nearly 1."""
        words = f"locked fraction of the motion of {self.column}"
        return (parameter(f"locked_{self.column.removesuffix('_rad')}", "1", 0.3, words, 0.0, MAX_LOCK),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that reduce the command of the joint, or increase its stiffness."""
        body = model.body
        lock = float(values[0])
        driven = [actuator.column for actuator in body.actuators]
        if self.column in driven:
            number = driven.index(self.column)

            def hold(time_s: Array, angle: Array, joint: int) -> Array:
                if joint != number:
                    return angle
                return angle[0] + (1.0 - lock) * (angle - angle[0])

            return Hooks(command=(hold,))
        number = [axis.column for axis in body.passive].index(self.column)

        def stiffen(tables: dict[str, Any]) -> None:
            inertia = body.joint_inertia(tables, number)
            own = max(body.stiffness(tables, number), (2.0 * math.pi * HELD_HZ) ** 2 * inertia)
            limit = (STABLE / body.step_s) ** 2 * inertia
            body.stiffen(tables, number, stiffness=min(own * lock / (1.0 - lock), limit))

        return Hooks(tables=(stiffen,))


class JointStiffness(Effect):
    """Stiffness of passive joints, or of a free decay, that differs from the stiffness in the model.

    With the model's stiffness K at small angles, the additional torque is ``-K (change + hardening phi^2)
    phi``.
    """

    name = "joint-stiffness"
    meaning = "stiffness of the passive joints against the model's"
    sources = ("tendon fish paper, Eqs 3 and 4", "dolphin paper, Eq 5 and section 4.2.1")

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies.

        The model must be a swimmer with a spring in a joint, or a free decay. A free decay whose stiffness
        the model estimates is excluded.
        """
        known = model.body is None and model.estimates("stiffness")
        return _has_spring(model) and not known

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the relative change of stiffness as a parameter, and for a swimmer also the hardening."""
        change = parameter("change", "1", 0.2, "relative change of stiffness", -0.95, 6.0)
        if model.body is None:
            return (change,)
        words = "relative growth with squared angle"
        return change, parameter("hardening_rad_2", "rad^-2", 2.0, words, -10.0, 60.0)

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return parameter vectors with softer, stiffer and hardening springs, for simulation before a fit.

        The stiffest springs are four times as stiff as in the model.
        """
        changes = [np.array([c, 0.0][: len(parameters)]) for c in (-0.5, 0.3, 0.8, 1.6, 3.0)]
        return changes + [np.array([0.0, h]) for h in (2.0, 8.0) if len(parameters) > 1]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that change the springs of the joints, or the restoring force of the free decay."""
        body = model.body
        if body is not None:
            stiffer, harder = values
            return base.change_springs(body, lambda own: {"stiffness": own * stiffer, "cubic": own * harder})

        def restoring(c: dict[str, float]) -> None:
            c["stiffness"] *= 1.0 + values[0]

        return Hooks(coefficients=(restoring,))


#: Speed range around zero over which dry friction changes sign smoothly, as a fraction of the typical speed.
FRICTION_ROUNDING = 0.02


@numba.cfunc(FORCE_SIGNATURE, cache=True)
def add_load_friction(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add the friction ``-mu |load| sgn(v)`` to the wrench, with a smoothed sign.

    The load is the sum of a spring force and a measured force. The constants are mu, the smoothing speed, the
    stiffness and the rest position of the spring, and then the times and values of the measured force.
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


class Friction(Effect, ABC):
    """Dry friction of a rig, or of servos that follow a command.

    Parameters
    ----------
    everywhere : bool
        Whether friction acts also in trials of a rig without a pulley.
    """

    def __init__(self, *, everywhere: bool = False) -> None:
        self.everywhere = everywhere

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return the variant of this effect for rigs, or the variant for servos that follow a command."""
        if model.rig is not None:
            return [type(self)(everywhere=not base.has_pulley(trials))]
        return super().variants(model, trials)

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: a command must drive the joints in some trial."""
        return "command" in model.offers and any(model.is_commanded(t) for t in trials)


class LoadFriction(Friction):
    """Dry friction ``mu |load|`` (Coulomb) of a bearing, slide or gear, proportional to the load.

    On a rig, the load of the bearing, guide or slide is one of three forces: the pull of a weight (in the
    trials with a pulley, if there are any), the measured force of a tow, or the restoring force of a decay
    (Reid's damping). A driven joint carries the torque ``I q'' + D q' |q'|`` of the links that it moves. I is
    their inertia and D their quadratic drag, with the joint itself fixed and the joints beyond it straight. A
    position servo of stiffness k stands still while its distance from the command is below ``mu |torque| /
    k``.
    """

    name = "load-friction"
    meaning = "friction in proportion to the load that a bearing, slide or servo carries"
    sources = (
        "boxfish paper, Eq 7 and section 4.1",
        "Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30:1083",
        "Reid 1956, J. R. Aeronaut. Soc. 60:283",
    )
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies.

        It applies to planar robots whose joints follow a command in some trial.
        """
        return model.body is not None and bool(model.body.driven) and super().applies(model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the friction per load as a parameter. For servos it is an angle per torque.

        Pulleys and slides lose 3 to 10 % of their load. With the scale for servos, a joint is held back by a
        twentieth of its amplitude at the largest torque.
        """
        if model.rig is not None:
            size = 0.01 if model.rig.swings else 0.03
            words = "friction per load"
            return (parameter("share", "1", size, words, 0.0, 0.9),)
        yields = []
        for trial in trials:
            # The commands of the actuators precede those of the inputs, which carry no joint.
            for load, (time, told, _) in zip(model.body.loads, model.commands(trial), strict=False):
                torque = float(np.max(_torque(load, time, told), initial=0.0))
                if torque > 0.0:
                    yields.append(0.5 * float(np.ptp(told)) / torque)
        size = 0.05 * typical(yields, 20.0)
        words = "angle by which a joint is held back per torque it carries"
        return (parameter("held_rad_N_m", "rad/(N m)", size, words, 0.0, 30.0 * size),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add dry friction to a rig, or let the joints of a robot stick under load."""
        share = float(values[0])
        if model.rig is None:
            loads = model.body.loads

            def command(time_s: Array, angle: Array, joint: int) -> Array:
                def stuck(time: Array, told: Array) -> Array:
                    return np.asarray(base.hold_back(told, share * _torque(loads[joint], time, told)))

                return base.bridge_missing(stuck, time_s, angle)

            return base.on_command(model, trial, command, of_angles=True)
        if not (trial.rig.pulley or self.everywhere):
            return Hooks()
        measured = trial.inputs.get("force_N")
        if measured is None and not model.rig.swings:
            return base.add_to_coefficient(share * abs(trial.rig.pull), "dry")
        slow = FRICTION_ROUNDING * model.scales([trial]).speed
        constants = np.array([share, slow, 0.0, 0.0])
        if measured is not None:
            constants = np.concatenate([constants, trial.time_s, measured])
        return base.force_on_rig(add_load_friction, constants, stiffness=2, rest=3)


def _torque(load: tuple[float, float], time_s: Array, angle: Array) -> Array:
    """Return the absolute torque of a joint that follows the given angle, N m.

    The load consists of the inertia and the quadratic drag of the links that the joint moves.
    """
    if len(time_s) < 2:
        return np.zeros(len(time_s))
    rate = np.gradient(angle, time_s)
    return np.abs(load[0] * np.gradient(rate, time_s) + load[1] * rate * np.abs(rate))


@numba.cfunc(FORCE_SIGNATURE, cache=True)
def add_stribeck_friction(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add the Stribeck reduction of dry friction in motion to the wrench.

    The constants are the increase of the friction at rest, and the Stribeck speed.
    """
    v = velocity[2]
    share = v / constants[1]
    wrench[0] += math.copysign(constants[0] * (1.0 - math.exp(-share * share)), v)


class Stribeck(Friction):
    """Friction ``(F_s - F_c) exp(-(v / v_s)^2) sgn(v)`` in addition to the Coulomb friction of the model.

    F_s is the friction at rest, F_c the Coulomb friction in motion, and v_s the Stribeck speed. On a rig, the
    whole difference ``F_s - F_c`` holds a body at rest. It is the friction of the pulley in the trials with a
    pulley, or of the bearing or slide if there are none. A position servo of stiffness k stands still while
    its distance from the command is below ``(T_s - T_c) exp(-(w / w_s)^2) / k``. Here w is the rate of the
    command, so that the servo sticks where the command reverses. Steady beats of average models do not
    distinguish this friction from a play.
    """

    name = "stribeck"
    meaning = "friction that is higher at rest than in motion"
    sources = (
        "Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30:1083",
        "boxfish paper, Eq 7 (a friction that does not depend on speed)",
    )

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters: excess of friction at rest ``F_s - F_c``, N or N m, and Stribeck speed.

        For servos these are the angle by which the friction at rest holds a joint back, and a rate of the
        command. The Stribeck speed is at most half the typical speed of a rig, or half the largest rate of
        the commands. A friction that falls more slowly is practically constant. It is then that of
        ``pulley-friction`` or a play.
        """
        if model.rig is not None:
            scales = model.scales(trials)
            rise, unit = base.pick_by_motion(model, ("rise_N", "N"), ("rise_N_m", "N m"))
            size, most, top = scales.brake, math.inf, scales.speed
            word = f"stribeck_{model.rig.speed.unit.replace('/', '_')}"
            rates, moving = model.rig.speed.unit, "speed"
            what = "friction at rest minus friction in motion"
        else:
            largest = base.typical_amplitude(model, trials)
            rise, unit, size, most = "stick_rad", "rad", 0.05 * largest, 0.9 * largest
            word, rates, top = "stribeck_rad_s", "rad/s", base.largest_rate(model, trials)
            what, moving = "angle by which a joint at rest is held back", "rate"
        over, least = f"{moving} over which the friction falls", 0.01 * top
        return (
            parameter(rise, unit, size, what, 0.0, most),
            parameter(word, rates, 0.1 * top, over, least, 0.5 * top, start=0.2 * top),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the parameter vectors that are simulated before a fit.

        They have a small and a large excess of friction at rest, each at a low and a high Stribeck speed.
        """
        rise, speed = parameters
        sizes = itertools.product((rise.scale, min(3.0 * rise.scale, rise.upper)), (0.4, 1.5))
        return [np.array([size, share * speed.start]) for size, share in sizes]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add a friction that falls with speed on a rig, or that let servos stick."""
        rise, slow = (float(v) for v in values)
        if model.rig is not None:
            if not (trial.rig.pulley or self.everywhere):
                return Hooks()
            spared = ExternalForce(add_stribeck_friction, np.array([rise, slow]))
            return Hooks(coefficients=base.add_to_coefficient(rise, "dry").coefficients, force=(spared,))

        def stuck(time_s: Array, angle: Array) -> Array:
            if len(time_s) < 2:
                return angle
            rate = np.gradient(angle, time_s)
            return np.asarray(base.hold_back(angle, rise * np.exp(-np.square(rate / slow))))

        return base.follow_commands(model, trial, stuck)


#: Unit of force in a model without an inertia of its own (force per mass).
PER_MASS = "m/s^2"


class WaterIngress(Effect):
    """Water in the hull: a mass that is added to the heaviest link at the place where the water collects.

    The weight of the water is trimmed out by buoyancy. On rigs and in averages over a beat, only the mass
    matters, not its place.
    """

    name = "water-ingress"
    meaning = "water inside the hull that moves with the hull"
    sources = ("sea lion paper, discussion",)
    needs = frozenset({"tables", "coefficients"})
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must have an inertia.

        Models with forces per mass, and models with a held base, have none.
        """
        has_inertia = model.force_unit != PER_MASS and not base.is_held(model)
        return super().applies(model, trials) and has_inertia

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the mass of the water in the hull (kg), and for a swimmer also the position of this water.

        The position is the distance ahead of the centre of mass of the hull, m. For a rotation the mass is
        replaced by a moment of inertia, kg m2.
        """
        linear, angular = ("mass_kg", "kg", "mass"), ("inertia_kg_m2", "kg m^2", "inertia")
        name, unit, what = base.pick_by_motion(model, linear, angular)
        size = 0.05 * model.scales(trials).inertia
        much = parameter(name, unit, size, f"{what} of the water inside", lower=0.0)
        body = model.body
        if body is None:
            return (much,)
        length, (x, _) = body.lengths_m[body.hull], body.centre(body.hull)
        words = "distance of the water ahead of the hull's centre of mass"
        place = parameter("along_m", "m", 0.2 * length, words, -length - x, -x)
        return much, place

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the parameter vectors that are simulated before a fit.

        For a swimmer, the water is at the centre of mass, or half way to either end of the hull.
        """
        if len(parameters) == 1:
            return super().tries(parameters)
        much, place = parameters
        return [np.array([much.scale, share]) for share in (0.0, 0.5 * place.lower, 0.5 * place.upper)]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the mass of the water to the inertia."""
        body = model.body
        if body is not None:
            mass, (x, y) = values[0], body.centre(body.hull)
            at = x + float(values[1]), y
            return Hooks(tables=(lambda tables: body.weigh(tables, body.hull, at, mass, mass),))

        return base.add_to_coefficient(values[0], "mass", "inertia")
