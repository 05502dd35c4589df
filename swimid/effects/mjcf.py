"""Forms of effects that a file of MuJoCo can express, as changes of its compiled model.

The hooks change arrays of the compiled model (:meth:`swimid.simulators.mjcf.MjcfModel.fields`).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.effects import base, environment, fluid, structure
from swimid.effects.base import Array, Effect, Effects, Parameters, Trial, Trials, parameter
from swimid.fitting.model import Hooks
from swimid.simulators.mjcf import HINGE, SLIDE, base_joints

#: Kind of model of which the effects of this module are forms.
KIND = "mjcf"
#: Typical motion of a joint, m and rad, if the commands do not show it.
USUAL = {SLIDE: 0.05, HINGE: base.USUAL_ANGLE}
#: Damping and friction that a diagnosis tries first, as a fraction of the typical torque of the joint.
SMALL_TORQUE_SHARE = 0.05
#: Maximum change of the drag coefficients, as a fraction of their values.
MAX_DRAG_CHANGE = 4.0


class MjcfJoint(NamedTuple):
    """Joint of a compiled model with one coordinate, and its typical motion."""

    name: str
    number: int
    dof: int
    kind: int
    #: Typical torque (N m) or force (N), and rate (rad/s or m/s).
    torque: float
    rate: float

    @property
    def units(self) -> tuple[str, str, str]:
        """Units of torque, damping and inertia."""
        return ("N m", "N m s/rad", "kg m^2") if self.kind == HINGE else ("N", "N s/m", "kg")


def joints(model: Any, trials: Trials) -> list[MjcfJoint]:
    """Return the joints between the links of a robot."""
    compiled, omega = model.compiled, 2.0 * math.pi / base.typical_period(model, trials)
    found = []
    for k in sorted({*range(compiled.njnt)} - {*base_joints(compiled)}):
        dof, kind = int(compiled.jnt_dofadr[k]), int(compiled.jnt_type[k])
        stiffness = max(float(compiled.jnt_stiffness[k]), float(compiled.dof_M0[dof]) * omega**2)
        found.append(
            MjcfJoint(model.joint_names[k], k, dof, kind, stiffness * USUAL[kind], omega * USUAL[kind])
        )
    return found


def drift_dofs(compiled: Any) -> list[int]:
    """Return the degrees of freedom in which the base is displaced in the world."""
    found: list[int] = []
    for k in base_joints(compiled):
        first, kind = int(compiled.jnt_dofadr[k]), int(compiled.jnt_type[k])
        found += range(first, first + 3) if kind == 0 else [first] * (kind == SLIDE)
    return found


def heaviest(compiled: Any) -> int:
    """Return the index of the heaviest body."""
    return int(np.argmax(compiled.body_mass))


def in_fluid(compiled: Any) -> bool:
    """Return whether the file has a fluid with drag."""
    return bool(compiled.opt.density > 0.0)


def carry(fields: Any, body: int, mass: float, inertia: float = 0.0) -> None:
    """Add a mass (kg) without weight to a body, and an inertia (kg m2) about each of its axes."""
    before = float(fields["body_mass"][body])
    fields["body_gravcomp"][body] = (fields["body_gravcomp"][body] * before + mass) / max(
        before + mass, 1e-12
    )
    fields["body_mass"][body] = before + mass
    fields["body_inertia"][body] += inertia


def gyration(compiled: Any) -> float:
    """Return the largest radius of gyration of the heaviest body, m."""
    body = heaviest(compiled)
    return float(np.sqrt(np.max(compiled.body_inertia[body]) / compiled.body_mass[body]))


def load(fields: Any, body: int, mass: float, offset: Array) -> None:
    """Add a point mass (kg) without weight to a body, at an offset (m) from its centre of mass."""
    before = float(fields["body_mass"][body])
    turn = Rotation.from_quat(fields["body_iquat"][body], scalar_first=True).as_matrix()
    inertia = turn @ np.diag(fields["body_inertia"][body]) @ turn.T
    # the inertia about the common centre of mass (reduced mass), in the axes of the body
    reduced = before * mass / (before + mass)
    inertia += reduced * (float(offset @ offset) * np.eye(3) - np.outer(offset, offset))
    carry(fields, body, mass)
    fields["body_ipos"][body] += mass / (before + mass) * offset
    moments, axes = np.linalg.eigh(inertia)
    axes *= np.sign(np.linalg.det(axes))
    fields["body_inertia"][body] = moments
    fields["body_iquat"][body] = Rotation.from_matrix(axes).as_quat(scalar_first=True)


class MjcfEffect(Effect):
    """Effect that changes arrays of the compiled model."""

    of_model = KIND

    def hooks(self, values: Array, trial: Trial, model: Any) -> Hooks:
        """Return the hook that changes the arrays of the compiled model."""
        return Hooks(tables=(lambda fields: self.change(fields, values, model),))

    @abstractmethod
    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Change the arrays of the compiled model in place."""


class OfBase(MjcfEffect):
    """Effect on a robot whose base moves."""

    def applies(self, model: Any, trials: Trials) -> bool:
        """Return whether the base of the robot moves."""
        return bool(drift_dofs(model.compiled))


class OfJoint(MjcfEffect):
    """Effect on one joint, with one parameter that is added to an array of the model.

    Parameters
    ----------
    joint : str
        Name of the joint.
    """

    smooth = True
    #: Name of the changed array of the compiled model (``field``), and part of the parameter's name
    #: (``word``).
    field: ClassVar[str]
    word: ClassVar[str]

    def __init__(self, joint: str = "") -> None:
        self.joint = joint

    def variants(self, model: Any, trials: Trials) -> Effects:
        """Return one form for each joint between the links."""
        return [type(self)(joint.name) for joint in joints(model, trials)]

    def parameters(self, model: Any, trials: Trials) -> Parameters:
        """Return as a parameter the value that is added to that of the joint. The sum is not negative."""
        joint = next(joint for joint in joints(model, trials) if joint.name == self.joint)
        unit, size = self.measure(joint, model)
        least = -float(getattr(model.compiled, self.field)[joint.dof])
        ending = unit.replace(" ", "_").replace("/", "_").replace("^", "")
        name = f"{self.joint}_{self.word}_{ending}"
        return (parameter(name, unit, size, f"{self.word} of {self.joint} beyond the model's", lower=least),)

    @abstractmethod
    def measure(self, joint: MjcfJoint, model: Any) -> tuple[str, float]:
        """Return the unit and the scale of the added value."""

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Add the parameter to the joint's entry of the array, in place."""
        dof = int(model.compiled.jnt_dofadr[model.joint_names.index(self.joint)])
        fields[self.field][dof] += values[0]


class MjcfJointDamping(OfJoint, structure.JointDamping):
    """Viscous damping of a joint, in addition to that of the file (``joint/@damping``)."""

    field, word = "dof_damping", "damping"

    def measure(self, joint: MjcfJoint, model: Any) -> tuple[str, float]:
        """Return unit and scale of the damping."""
        return joint.units[1], SMALL_TORQUE_SHARE * joint.torque / joint.rate


class MjcfJointFriction(OfJoint, structure.JointFriction):
    """Dry friction of a joint, in addition to that of the file (``joint/@frictionloss``)."""

    field, word = "dof_frictionloss", "friction"

    def measure(self, joint: MjcfJoint, model: Any) -> tuple[str, float]:
        """Return unit and scale of the friction."""
        return joint.units[0], SMALL_TORQUE_SHARE * joint.torque


class JointArmature(OfJoint):
    """Inertia of the rotor behind the gear of a joint, beyond that of the file (``joint/@armature``)."""

    name = "joint-armature"
    stage = "structure"
    meaning = "inertia of a joint's motor and gear beyond the model's"
    sources = ("MuJoCo documentation, XML reference, joint/armature",)
    field, word = "dof_armature", "armature"

    def measure(self, joint: MjcfJoint, model: Any) -> tuple[str, float]:
        """Return unit and scale of the inertia."""
        return joint.units[2], 0.1 * float(model.compiled.dof_M0[joint.dof])


class MjcfJointLocked(MjcfEffect, structure.JointLocked):
    """Joint without an actuator that gains the stiffness ``K lock / (1 - lock)``.

    K is the stiffness of the joint in the file. For a joint without a spring, K gives the natural frequency
    :data:`~swimid.effects.structure.HELD_HZ`.
    """

    def variants(self, model: Any, trials: Trials) -> Effects:
        """Return one form for each joint between the links that no actuator drives."""
        compiled = model.compiled
        driven = {
            int(k)
            for k, kind in zip(compiled.actuator_trnid[:, 0], compiled.actuator_trntype, strict=True)
            if kind == 0
        }
        return [MjcfJointLocked(joint.name) for joint in joints(model, trials) if joint.number not in driven]

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Stiffen the joint."""
        compiled, number, lock = model.compiled, model.joint_names.index(self.column), float(values[0])
        inertia = float(compiled.dof_M0[compiled.jnt_dofadr[number]])
        own = float(fields["jnt_stiffness"][number])
        own = own or inertia * (2.0 * math.pi * structure.HELD_HZ) ** 2
        fields["jnt_stiffness"][number] += own * lock / (1.0 - lock)


class MjcfJointStiffness(MjcfEffect, structure.JointStiffness):
    """Relative change of the stiffness of all springs, of joints and of tendons."""

    def applies(self, model: Any, trials: Trials) -> bool:
        """Return whether the file has a spring."""
        compiled = model.compiled
        return bool(np.any(compiled.jnt_stiffness > 0) or np.any(compiled.tendon_stiffness > 0))

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Multiply the stiffnesses of all springs by one plus the parameter."""
        for name in ("jnt_stiffness", "tendon_stiffness"):
            fields[name] *= 1.0 + values[0]


class MjcfHardening(MjcfEffect, structure.Hardening):
    """Springs ``-K (1 + h q^2) q`` that stiffen with the deflection q (``joint/@stiffnesspoly``)."""

    def applies(self, model: Any, trials: Trials) -> bool:
        """Return whether a joint has a spring."""
        return bool(np.any(model.compiled.jnt_stiffness > 0))

    def parameters(self, model: Any, trials: Trials) -> Parameters:
        """Return the relative growth of the stiffness with the squared deflection, 1/rad^2."""
        words = "relative growth of stiffness with squared deflection"
        return (parameter("hardening_rad_2", "rad^-2", 2.0, words, -10.0, 60.0),)

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Set the quadratic term of the stiffness."""
        fields["jnt_stiffnesspoly"][:, 1] += values[0] * fields["jnt_stiffness"]


class MjcfWaterIngress(OfBase, structure.WaterIngress):
    """Mass without weight that is added to the heaviest body at a place along its x axis."""

    def parameters(self, model: Any, trials: Trials) -> Parameters:
        """Return the mass of the water (kg), and its distance ahead of the centre of mass of the body (m)."""
        size, radius = 0.05 * model.scales(trials).inertia, 3.0 * gyration(model.compiled)
        words = "distance of the water ahead of the body's centre of mass"
        return (
            parameter("mass_kg", "kg", size, "mass of the water inside", lower=0.0),
            parameter("along_m", "m", 0.3 * radius, words, -radius, radius),
        )

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Add the mass of the water to the heaviest body, in place."""
        mass, along = (float(v) for v in values)
        load(fields, heaviest(model.compiled), mass, np.array([along, 0.0, 0.0]))


class MjcfComOffset(OfBase, structure.ComOffset):
    """Displacement of the centre of mass of the heaviest body along the axes of the body."""

    def parameters(self, model: Any, trials: Trials) -> Parameters:
        """Return the displacements along the axes of the body, m."""
        compiled = model.compiled
        size = 0.03 * gyration(compiled)
        axes = "xyz" if np.any(compiled.opt.gravity) else "xy"
        words = "displacement of the centre of mass along"
        return tuple(parameter(f"{a}_m", "m", size, f"{words} {a}", -20.0 * size, 20.0 * size) for a in axes)

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Move the centre of mass."""
        body = heaviest(model.compiled)
        fields["body_ipos"][body, : len(values)] += values


class MjcfAddedMass(OfBase, fluid.AddedMassFactor):
    """Added mass in acceleration, which the fluid forces of MuJoCo do not have.

    Each body gains a share of the mean added mass and added inertia that MuJoCo computes for its ellipsoids
    (Lamb 1932). A body without ellipsoids gains a share of its own mass, as if it displaced that mass of
    water. The added mass is equal in all directions.
    """

    def applies(self, model: Any, trials: Trials) -> bool:
        """Return whether the file has a fluid, and the base of the robot moves."""
        return super().applies(model, trials) and in_fluid(model.compiled)

    def parameters(self, model: Any, trials: Trials) -> Parameters:
        """Return the share of the theoretical added mass, without unit."""
        return (parameter("share", "1", 0.2, "added mass over that of theory", 0.0, 5.0),)

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Add mass and inertia to the bodies."""
        compiled, share = model.compiled, float(values[0])
        shaped = compiled.geom_fluid[:, 0] > 0
        if not shaped.any():
            for body in range(1, compiled.nbody):
                carry(fields, body, share * float(compiled.body_mass[body]))
        for geom in np.flatnonzero(shaped):
            mass, inertia = (compiled.geom_fluid[geom, at : at + 3].mean() for at in (6, 9))
            density = share * float(compiled.opt.density)
            carry(fields, int(compiled.geom_bodyid[geom]), density * mass, density * inertia)


class MjcfLinearDrag(OfBase, fluid.LinearDrag):
    """Linear drag ``-c v`` of the base in the world, equal in all directions (damping of its joints)."""

    def parameters(self, model: Any, trials: Trials) -> Parameters:
        """Return the drag per speed as a parameter, N s/m."""
        scales = model.scales(trials)
        size = scales.inertia / max(scales.duration, 1e-9)
        return (parameter("linear_N_s_m", "N s/m", size, "drag per speed", lower=0.0),)

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Add the drag to the damping of the joints of the base, in place."""
        dofs = drift_dofs(model.compiled)
        fields["dof_damping"][dofs] += values[0]


class MjcfQuadraticDrag(MjcfEffect, fluid.QuadraticDrag):
    """Relative change of the drag coefficients of all ellipsoids; without any, of the fluid's density."""

    def applies(self, model: Any, trials: Trials) -> bool:
        """Return whether the file has a fluid."""
        return in_fluid(model.compiled)

    def parameters(self, model: Any, trials: Trials) -> Parameters:
        """Return the relative change of the drag, without unit."""
        return (parameter("change", "1", 0.1, "relative change of the drag", -0.95, MAX_DRAG_CHANGE),)

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Multiply the drag coefficients."""
        if (fields["geom_fluid"][:, 0] > 0).any():
            fields["geom_fluid"][:, 1:4] *= 1.0 + values[0]
        else:
            fields["opt.density"] *= 1.0 + values[0]


class MjcfCurrent(OfBase, environment.Current):
    """Steady current of the fluid (``option/@wind``)."""

    def applies(self, model: Any, trials: Trials) -> bool:
        """Return whether the file has a fluid, and the base of the robot moves."""
        return super().applies(model, trials) and in_fluid(model.compiled) and bool(model.axes)

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Set the velocity of the fluid."""
        axes = ["xyz".index(axis) for axis in model.axes]
        fields["opt.wind"][axes] += values


class MjcfBuoyancy(OfBase, environment.Buoyancy):
    """Buoyancy of the heaviest body, as a share of its weight (``body/@gravcomp``)."""

    def applies(self, model: Any, trials: Trials) -> bool:
        """Return whether gravity acts, and the base of the robot moves."""
        return super().applies(model, trials) and bool(np.any(model.compiled.opt.gravity))

    def parameters(self, model: Any, trials: Trials) -> Parameters:
        """Return the share of the weight that is lifted, without unit."""
        return (parameter("share", "1", 0.02, "share of the weight that is lifted", -0.5, 0.5),)

    def change(self, fields: dict[str, Any], values: Array, model: Any) -> None:
        """Increase the buoyancy of the heaviest body by a share of its weight, in place."""
        body = heaviest(model.compiled)
        fields["body_gravcomp"][body] += values[0]
