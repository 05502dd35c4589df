"""Joints of a robot file, with the laws of their actuators and springs, and the inputs of a robot."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self

from pydantic import Field, PositiveFloat, model_validator

from swimid.files import yamlio
from swimid.robots.quantities import Quantity


class Servo(yamlio.Document):
    """Second-order system with the commanded angle of a joint as input and the joint angle as output."""

    natural_frequency_hz: Quantity
    damping_ratio: Quantity = 0.7


class Tendon(yamlio.Document):
    """Wire with a spring that pulls a passive joint to zero angle (tendon fish paper, Eqs 3 and 4)."""

    spring_N_m: Quantity
    pretension_m: Quantity
    arm_m: PositiveFloat
    crank_m: PositiveFloat

    @model_validator(mode="after")
    def _crank_shorter(self) -> Tendon:
        if self.crank_m >= self.arm_m:
            raise ValueError(
                "crank_m must be shorter than arm_m; otherwise the wire is loose at zero angle (Eq 3)"
            )
        return self


class Actuator(yamlio.Document):
    """Law of an actuator, whose angle follows the drive of the trial or a logged angle."""

    #: Amplitude of the angle divided by the amplitude of the drive. The bias of the drive is multiplied by
    #: the same factor unless ``bias_gain`` is given.
    gain: float = 1.0
    bias_gain: float | None = None
    #: Phase lag of the angle behind the drive, degrees.
    phase_lag_deg: float = 0.0
    servo: Servo | None = None
    #: Maximum absolute angle and rate that may be commanded. Proposed trials respect these limits. Recorded
    #: trials are not checked.
    max_angle_deg: PositiveFloat | None = None
    max_rate_deg_s: PositiveFloat | None = None


class Driven(Actuator):
    """Law of a driven joint: its own actuator, or the transmission by which it follows a shared actuator.

    A shared actuator is named under ``actuators``, such as a tendon over several joints. The drive of a trial
    moves the actuator. Without a drive, the log has its measured angle (``joint_tendon_rad``) or its command
    (``cmd_tendon_rad``). Logged angles of the joints are then channels that a fit compares. Servo, limits and
    effects of actuation act on the actuator, and the joints follow without play.
    """

    #: Name of the shared actuator; by default the joint has its own.
    actuator: str | None = None
    #: Angle of the joint divided by that of the shared actuator.
    ratio: Quantity = 1.0
    #: Rows of actuator angle and joint angle, degrees, in place of a ratio. The actuator angles increase. A
    #: monotone cubic (PCHIP) interpolates the rows; beyond them the joint follows the tangent (SWM077).
    table_deg: Annotated[list[tuple[float, float]], Field(min_length=2)] | None = None

    @property
    def is_computed(self) -> bool:
        """Whether the angle follows from a command or a shared actuator. Such an angle is never an input."""
        return self.servo is not None or self.actuator is not None

    @model_validator(mode="after")
    def _one_law(self) -> Self:
        fields = Driven.model_fields
        stated = {name for name in self.model_fields_set if getattr(self, name) != fields[name].default}
        transmission = sorted(stated & {"ratio", "table_deg"})
        own = sorted(stated & set(Actuator.model_fields))
        if self.actuator is None:
            if transmission:
                raise ValueError(f"'{transmission[0]}' needs an 'actuator': name one of 'actuators'")
            return self
        if own:
            raise ValueError(
                f"'{own[0]}' would drive the joint a second time, because it follows the actuator "
                f"'{self.actuator}': state '{own[0]}' under 'actuators'"
            )
        if len(transmission) == 2:
            raise ValueError("give 'ratio' or 'table_deg', not both")
        for (low, _), (high, _) in pairwise(self.table_deg or ()):
            if high <= low:
                raise ValueError(
                    f"the actuator angles of 'table_deg' must increase, but {high:g} follows {low:g}: "
                    "sort the rows, and give each actuator angle once"
                )
        return self


class Yielding(yamlio.Document):
    """Law of the moment in a passive joint: spring, damper and dry friction."""

    stiffness_N_m_rad: Quantity = 0.0
    cubic_N_m_rad3: Quantity = 0.0
    damping_N_m_s_rad: Quantity = 0.0
    quadratic_damping_N_m_s2_rad2: Quantity = 0.0
    #: Moment of the dry friction in the joint, N m. It is smoothed at joint rates below
    #: ``friction_below_rad_s``.
    friction_N_m: Quantity = 0.0
    friction_below_rad_s: PositiveFloat = 0.02
    rest_deg: float = 0.0


class Input(yamlio.Document):
    """Column of a log that loads act by, and the law of the actuator between the column and the loads.

    The law maps a value u of the column to ``sign(u) (|u| - dead_band)^power``, or 0 within the dead band.
    The result is multiplied by ``reverse`` if u is negative, and then passes a first-order lag. The column is
    linear between its samples.

    Example::

        inputs:
          bow: {column: bow_N, measured: true}
          stern: {column: stern_pwm, power: 2, dead_band: 0.07, reverse: k_back, lag_s: tau}
        elements:
          - {kind: load, link: body, input: stern, at_m: 0.2, forward_N: k_s}
    """

    #: Column of the log: a measured force or torque, or the command of an actuator.
    column: str
    #: Whether the column was measured behind the actuator. Effects of actuators then do not apply.
    measured: bool = False
    power: Quantity = 1.0
    #: Absolute value of the column up to which the loads are zero, in the unit of the column.
    dead_band: Quantity = 0.0
    #: Factor applied to the loads for negative values of the column, for example of a propeller in reverse.
    reverse: Quantity = 1.0
    lag_s: Quantity = 0.0


class Torque(yamlio.Document):
    """Torque of an actuator on a passive joint, in the direction of a positive joint angle."""

    input: str
    #: Ratio of the torque to the input, after the law of the actuator is applied to the input.
    gain_N_m: Quantity = 1.0


class Joint(yamlio.Document):
    """Joint between a parent link and a child link: a rigid, a driven or a passive joint."""

    name: str
    parent: str
    child: str
    driven: Driven | None = None
    passive: Yielding | None = None
    torque: Torque | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.driven is not None and self.passive is not None:
            raise ValueError(f"the joint '{self.name}' is both driven and passive: omit either")
        if self.torque is not None and self.passive is None:
            raise ValueError(f"the joint '{self.name}' has a torque but is not passive: add 'passive: {{}}'")
        return self


class Holder(yamlio.Document):
    """Holder of a robot on a fixed base, between the robot and the load cell: a damped resonance.

    A robot with ``base: fixed`` has the force and the torque on its holder as channels, about the reference
    point and in the axes of the world: ``force_x_N``, ``force_y_N``, ``torque_yaw_N_m`` in the horizontal
    plane, ``force_x_N``, ``force_z_N``, ``torque_pitch_N_m`` in the vertical plane, and three forces and
    three torques in space. A fit estimates offset and drift of each channel in each trial. State the
    ``drive`` of such trials: a force of inertia from an encoder has the noise of a second derivative.
    """

    natural_frequency_hz: Quantity
    damping_ratio: Quantity = 0.05
