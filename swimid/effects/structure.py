"""Effects of the robot's own mechanics: fins, passive joints, masses."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numba import cfunc

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.effects.common import parameter
from swimid.fitting.hooks import FORCE_SIGNATURE, Force, Stroke, traceable


class ComOffset(Effect):
    """The heaviest link's mass moved along and across it, its inertia about the centre kept.

    Where the model has weights, the weight moves with it.
    """

    name = "com-offset"
    meaning = "centre of mass of the hull off the model's"
    sources = ("sea lion paper, section on identification", "tendon fish paper, Table II")
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Free swimmers."""
        return [self] if common.free_body(model) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Offsets forwards and to port (up in the vertical plane), m."""
        body = common.links(model)
        length = body.lengths_m[body.hull]
        size, most = 0.01 * length, 0.2 * length
        return tuple(
            parameter(name, "m", size, f"centre of mass {way} of the model's", lower=-most, upper=most)
            for name, way in (("along_m", "ahead"), ("across_m", "above" if body.vertical else "to port"))
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Moves the mass, and its weight."""
        body = common.links(model)
        by = float(values[0]), float(values[1])
        return Hooks(tables=(lambda tables: body.shift(tables, body.hull, by),))


@traceable(on="last", constants=3)
def bent_fin(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """What bending adds to the fin's normal force; constants compliance, quadratic and lift gain.

    The straight fin's normal force ``N = -(k |w| + l u) w`` turns its chord by
    ``delta = -c N / sqrt(1 + (c N)^2)``; the bent fin's acts across its own chord, on the motion across it.
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
    """The caudal fin bends in proportion to the force across it (quasi-static, first bending mode).

    A swimmer's fin turns its chord by compliance times load, which tilts the force forwards and unloads
    it; a model of the average over a beat loses thrust by ``1 / (1 + kappa L)`` with the load
    ``L = I f^2 theta`` over its typical size.

    Parameters
    ----------
    load, inertia_kg_m2 : float
        Typical ``I f^2 theta`` of the trials, and the inertia taken for a fin whose own is not known.
    """

    name = "fin-flexibility"
    meaning = "caudal fin that bends under its load"
    sources = ("dolphin paper, section 1", "Katz and Weihs 1978, J. Fluid Mech. 88:485")
    needs = frozenset({"force", "stroke"})

    def __init__(self, load: float = 1.0, inertia_kg_m2: float = 1.0) -> None:
        self.load, self.inertia_kg_m2 = load, inertia_kg_m2

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers whose last link has drag or lift across it, and models of the stroke."""
        body = model.body
        if body is not None:
            return [self] if sum(body.fin(body.tables())[:2]) > 0 else []
        return [FinFlexibility(*_typical(trials))] if "stroke" in model.offers else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Chord angle per force, rad/N; or loss per load, 1."""
        body = model.body
        if body is not None:
            quadratic, lift, _ = body.fin(body.tables())
            across = _stroke_speed(model, body.lengths_m[-1], trials)
            load = (quadratic * across + lift * model.scales(trials).speed) * across
            words = "angle by which the fin bends per force across it"
            most = 30.0 / load
            return (parameter("compliance_rad_N", "rad/N", 0.1 / load, words, lower=0.0, upper=most),)
        return (parameter("loss", "1", 0.2, "loss of thrust at the typical load", lower=0.0, upper=20.0),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A force on the last link, or a factor on the thrust."""
        body = model.body
        if body is not None:
            constants = np.array([values[0], 0.0, 0.0])
            x, y = body.fin(body.tables())[2]

            def read(tables: dict[str, Any]) -> None:
                constants[1:3] = body.fin(tables)[:2]

            return Hooks(tables=(read,), force=(Force(bent_fin, constants, body.last, x, y),))

        def weaken(stroke: Stroke) -> Stroke:
            inertia = stroke.inertia_kg_m2 if math.isfinite(stroke.inertia_kg_m2) else self.inertia_kg_m2
            load = inertia * stroke.frequency_hz**2 * np.abs(stroke.amplitude_rad) / self.load
            return replace(stroke, thrust=stroke.thrust / (1.0 + values[0] * load))

        return Hooks(stroke=(weaken,))


def _stroke_speed(model: Model, length: float, trials: Trials) -> float:
    """Typical speed of a fin of this length (m) across itself, m/s."""
    beats = [t.swim.beat for t in trials if t.swim.beat is not None]
    speeds = [2.0 * math.pi * b.frequency_hz * abs(b.amplitude_rad) * length for b in beats]
    return (float(np.median(speeds)) if speeds else 0.0) or model.scales(trials).speed


def _typical(trials: Trials) -> tuple[float, float]:
    """Median load and median inertia of the fins, 1 where that is not known."""
    known = [t.cruise.inertia_kg_m2 for t in trials if t.cruise.inertia_kg_m2 is not None]
    middle = float(np.median(known)) if known else 1.0
    loads = []
    for trial in trials:
        own = trial.cruise.inertia_kg_m2
        frequency, amplitude = (np.where(np.isnan(v), 1.0, v) for v in trial.steady)
        loads += list(np.square(frequency) * np.abs(amplitude) * (middle if own is None else own))
    return float(np.median(loads)) if loads else 1.0, middle


#: Deflection of a joint that no log shows, rad.
USUAL_ANGLE = 0.3


@cfunc(FORCE_SIGNATURE, cache=True)
def cubic(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """``-k_3 (x - rest)^3``; constants cubic stiffness and rest position."""
    off = pose[0] - constants[1]
    wrench[0] -= constants[0] * off * off * off


class Hardening(Effect):
    """``-K (1 + h q^2) q``, Duffing's spring: at the passive joints that have one, or of a free decay.

    K is the model's stiffness at small deflections q, ``h < 0`` a spring that softens (the restoring moment
    of a roll goes with the sine: ``h = -1/6`` per rad^2).
    """

    name = "hardening"
    meaning = "stiffness that grows with deflection"
    sources = (
        "tendon fish paper, Eqs 3 and 4",
        "Kovacic and Brennan 2011, The Duffing Equation, chapter 2",
    )
    needs = frozenset({"tables", "force"})

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers with a spring in a joint, and decays."""
        body = model.body
        if body is not None:
            tables = body.tables()
            return [self] if any(body.stiffness(tables, k) > 0 for k in range(len(body.passive))) else []
        return [self] if model.rig is not None and model.rig.swings else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Growth with squared deflection, rad^-2 or m^-2.

        A fifth more torque at the largest deflection is what one begins to see; a spring that softens keeps a
        stiffness above zero out to there, ``1 + 3 h q^2 > 0``.
        """
        largest = _deflection(model, trials)
        unit = "rad" if model.rig is None else model.rig.displacement.unit
        size, least = 0.2 / largest**2, -1.0 / (3.0 * largest**2)
        words = "growth of the stiffness with squared deflection"
        return (parameter(f"hardening_{unit}_2", f"{unit}^-2", size, words, lower=least, upper=30.0 * size),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds a cubic term to the springs."""
        body = model.body
        if body is not None:

            def springs(tables: dict[str, Any]) -> None:
                for k in range(len(body.passive)):
                    body.stiffen(tables, k, cubic=max(body.stiffness(tables, k), 0.0) * values[0])

            return Hooks(tables=(springs,))
        constants = np.zeros(2)

        def take(c: dict[str, float]) -> None:
            constants[:] = c["stiffness"] * values[0], c["rest"]

        return Hooks(coefficients=(take,), force=(Force(cubic, constants),))


def _deflection(model: Model, trials: Trials) -> float:
    """Largest deflection of a typical trial, in the unit of the coordinate."""
    if model.body is None:
        return 0.5 * model.scales(trials).span
    columns = [axis.column for axis in model.body.passive]
    seen = [np.abs(t.measured[c]) for t in trials for c in columns if c in t.measured]
    found = [float(np.nanmax(s)) for s in seen if np.isfinite(s).any()]
    return (float(np.median(found)) if found else 0.0) or USUAL_ANGLE


class JointDamping(Effect):
    """``-d phi'`` at every passive joint, on top of the model's."""

    name = "joint-damping"
    meaning = "viscous friction of the passive joints beyond the model's"
    sources = ("tendon fish paper, Eq 5", "dolphin paper, Eq 5")
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers with a passive joint."""
        return [self] if model.body is not None and model.body.passive else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Torque per rate, N m s/rad; its scale is a damping ratio of 0.05."""
        body = common.links(model)
        tables, joints = body.tables(), range(len(body.passive))
        sizes = [
            math.sqrt(max(body.stiffness(tables, k), 1e-6) * body.joint_inertia(tables, k)) for k in joints
        ]
        size, least = 0.1 * float(np.median(sizes)), -min(body.damping(tables, k) for k in joints)
        words = "damping of each passive joint beyond the model's"
        return (parameter("damping_N_m_s_rad", "N m s/rad", size, words, lower=least),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the damping."""
        body = common.links(model)

        def damp(tables: dict[str, Any]) -> None:
            for k in range(len(body.passive)):
                body.stiffen(tables, k, damping=values[0])

        return Hooks(tables=(damp,))


#: The most a joint may be locked, and how much stiffer than its own spring half a lock makes it.
MOST, STIFFER = 0.97, 10.0
#: Largest ``omega h`` of a locked joint, well inside the stability of the integration.
STABLE = 1.0


class JointLocked(Effect):
    """One joint is held: a driven one moves by ``1 - lock`` of its way, a passive one is stiffened.

    A passive joint gains the stiffness ``K lock / (1 - lock)``, K ten times its own, or less where the
    integration step could not follow.

    Parameters
    ----------
    column : str
        The joint's column in a log, ``joint1_rad`` say.
    """

    name = "joint-locked"
    meaning = "a joint that is held fast, wholly or in part"
    sources = ("dolphin paper, section 4.2.1",)
    needs = frozenset({"command", "tables"})

    def __init__(self, column: str = "joint1_rad") -> None:
        self.column = column

    def variants(self, model: Model, trials: Trials) -> Effects:
        """One for each passive joint, and each driven one that is told to move and not measured."""
        if model.body is None:
            return []
        columns = [axis.column for axis in model.body.passive]
        given = any(t.swim.commanded for t in trials)
        beaten = any(t.swim.joints is None for t in trials)
        for axis in model.body.driven:
            law = axis.driven
            assert law is not None
            if given or (beaten and (law.gain != 0.0 or law.bias_gain)):
                columns.append(axis.column)
        return [JointLocked(column) for column in sorted(columns)]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """How far it is locked, 0 to nearly 1."""
        name = f"locked_{self.column.removesuffix('_rad')}"
        words = f"share to which {self.column} is held"
        return (parameter(name, "1", 0.3, words, lower=0.0, upper=MOST),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Holds the joint."""
        body = common.links(model)
        lock = float(values[0])
        driven = [axis.column for axis in body.driven]
        if self.column in driven:
            number = driven.index(self.column)

            def hold(time_s: Array, angle: Array, joint: int) -> Array:
                return angle[0] + (1.0 - lock) * (angle - angle[0]) if joint == number else angle

            return Hooks(command=(hold,))
        number = [axis.column for axis in body.passive].index(self.column)

        def stiffen(tables: dict[str, Any]) -> None:
            own = max(body.stiffness(tables, number), 0.0)
            limit = (STABLE / body.step_s) ** 2 * body.joint_inertia(tables, number) * (1.0 - MOST) / MOST
            gain = min(STIFFER * own, limit) if own > 0 else limit
            body.stiffen(tables, number, stiffness=gain * lock / (1.0 - lock))

        return Hooks(tables=(stiffen,))


class JointStiffness(Effect):
    """Springs of the passive joints other than the model's, or a free decay's restoring force.

    With K the model's stiffness at small angles the torque gains ``-K (change + hardening phi^2) phi``.
    """

    name = "joint-stiffness"
    meaning = "stiffness of the passive joints against the model's"
    sources = ("tendon fish paper, Eqs 3 and 4", "dolphin paper, Eq 5 and section 4.2.1")
    needs = frozenset({"tables", "coefficients"})

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers with a spring, and decays whose stiffness is not estimated."""
        body = model.body
        if body is not None:
            tables = body.tables()
            return [self] if any(body.stiffness(tables, k) > 0 for k in range(len(body.passive))) else []
        held = model.rig is not None and model.rig.swings
        return [self] if held and not model.estimates("stiffness") else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The relative change, and for a swimmer's joints the hardening."""
        change = parameter("change", "1", 0.2, "relative change of stiffness", lower=-0.95, upper=6.0)
        if model.body is None:
            return (change,)
        words = "relative growth with squared angle"
        return change, parameter("hardening_rad_2", "rad^-2", 2.0, words, lower=-10.0, upper=60.0)

    def tries(self, parameters: Parameters) -> list[Array]:
        """Softer, stiffer, several times as stiff, and hardening."""
        changes = [np.array([c, 0.0][: len(parameters)]) for c in (-0.5, 0.3, 0.8, 1.6, 3.0)]
        return changes + [np.array([0.0, h]) for h in (2.0, 8.0) if len(parameters) > 1]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the springs."""
        body = model.body
        if body is not None:

            def springs(tables: dict[str, Any]) -> None:
                for k in range(len(body.passive)):
                    own = body.stiffness(tables, k)
                    body.stiffen(tables, k, stiffness=own * values[0], cubic=own * values[1])

            return Hooks(tables=(springs,))

        def restoring(c: dict[str, float]) -> None:
            c["stiffness"] *= 1.0 + values[0]

        return Hooks(coefficients=(restoring,))


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
            return (parameter("share", "1", size, words, lower=0.0, upper=0.9),)
        yields = []
        for trial in trials:
            for load, (time, told, _) in zip(_loads(model), model.commands(trial), strict=True):
                torque = float(np.max(_torque(load, time, told), initial=0.0))
                if torque > 0.0:
                    yields.append(0.5 * float(np.ptp(told)) / torque)
        size = 0.05 * float(np.median(yields)) if yields else 1.0
        words = "angle by which a joint is held back per torque it carries"
        return (parameter("held_rad_N_m", "rad/(N m)", size, words, lower=0.0, upper=30.0 * size),)

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
            parameter(rise, unit, size, what, lower=0.0, upper=most),
            parameter(word, rates, 0.1 * top, over, lower=least, upper=0.5 * top, start=0.2 * top),
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


#: Unit of the forces of a model that has no inertia of its own.
PER_MASS = "m/s^2"


class WaterIngress(Effect):
    """Mass added to the heaviest link where the water collects; its weight is taken as trimmed out.

    On rigs and in averages over a beat only how much it is matters.
    """

    name = "water-ingress"
    meaning = "water inside the hull that moves with it"
    sources = ("sea lion paper, discussion",)
    needs = frozenset({"tables", "coefficients"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Models with an inertia: not those per mass, nor of a base that is held."""
        held = model.body is not None and not model.body.free
        if held or model.force_unit == PER_MASS:
            return []
        return super().variants(model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Mass (kg; for an angle kg m2) and, of a swimmer, place (m ahead of the link's centre of mass)."""
        name, unit, what = "mass_kg", "kg", "mass"
        if common.rotates(model):
            name, unit, what = "inertia_kg_m2", "kg m^2", "inertia"
        size = 0.05 * model.scales(trials).inertia
        much = parameter(name, unit, size, f"{what} of the water inside", lower=0.0)
        body = model.body
        if body is None:
            return (much,)
        length, (x, _) = body.lengths_m[body.hull], body.centre(body.hull)
        words = "where it collects, ahead of the hull's centre of mass"
        place = parameter("along_m", "m", 0.2 * length, words, lower=-length - x, upper=-x)
        return much, place

    def tries(self, parameters: Parameters) -> list[Array]:
        """Of a swimmer at the centre of mass, and half way to either end."""
        if len(parameters) == 1:
            return super().tries(parameters)
        much, place = parameters
        return [np.array([much.scale, share]) for share in (0.0, 0.5 * place.lower, 0.5 * place.upper)]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the inertia."""
        body = model.body
        if body is not None:
            mass, (x, y) = values[0], body.centre(body.hull)
            at = x + float(values[1]), y
            return Hooks(tables=(lambda tables: body.weigh(tables, body.hull, at, mass, mass),))

        def change(c: dict[str, float]) -> None:
            c["mass" if "mass" in c else "inertia"] += values[0]

        return Hooks(coefficients=(change,))
