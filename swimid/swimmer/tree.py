"""Tree of the links of a robot, in a plane or in 3-D, with its checks and its input arrays for an engine.

An engine is the compiled equations of motion with their time integration. Its input arrays (tables) hold the
inertias, joints and hydrodynamic elements of the robot.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from swimid.errors import InputError, suggestion
from swimid.fitting.model import Array, Parameter
from swimid.robots.file import Fluid
from swimid.robots.joints import Actuator, Driven, Joint
from swimid.robots.quantities import Coefficient, Polynomial, use_default
from swimid.swimmer.assembly import ADDERS, Row, TableRows, joint_row, mount_of, select_columns
from swimid.swimmer.engine import INTEGERS, Engine

#: Maximum number of coefficient vectors whose input arrays are cached.
MAX_TABLES = 64
#: Indices that expand the upper triangle of a symmetric 3 by 3 matrix, stored row by row, to the whole
#: matrix.
SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


class PolynomialTable:
    """Matrix whose entries are polynomials in the coefficients of a robot file.

    Parameters
    ----------
    rows : sequence of rows
    columns : int
        Number of columns, which is needed if there are no rows.
    names : sequence of str
        Names of the coefficients, in the order in which their values are passed.
    """

    def __init__(
        self, rows: Sequence[Sequence[Polynomial | float]], columns: int, names: Sequence[str]
    ) -> None:
        self.shape = (len(rows), columns)
        entries = [Polynomial.of(entry) for row in rows for entry in row]
        monomials = sorted({m for entry in entries for m in entry.terms if m})
        self.constant = np.array([entry.terms.get((), 0.0) for entry in entries])
        # pad monomials that have fewer factors with the index of the number 1, which follows the coefficients
        longest = max((len(m) for m in monomials), default=0)
        padded = [[names.index(name) for name in m] + [len(names)] * (longest - len(m)) for m in monomials]
        self.factors = np.array(padded, dtype=int).reshape(len(monomials), longest)
        self.gains = np.array([[entry.terms.get(m, 0.0) for m in monomials] for entry in entries]).reshape(
            len(entries), len(monomials)
        )

    def __call__(self, values: Array) -> Array:
        """Return the matrix at values of the coefficients, shape (rows, columns).

        Do not write into the result, because its memory may be shared.
        """
        if not len(self.factors):
            return self.constant.reshape(self.shape)
        padded = np.append(values, 1.0)
        products = padded[self.factors[:, 0]]
        for column in self.factors.T[1:]:
            products = products * padded[column]
        return np.asarray((self.constant + self.gains @ products).reshape(self.shape))


#: Keys of links, joints and elements whose strings are not physical quantities.
WORDS = {
    *("name", "link", "parent", "child", "kind", "inertia_about", "frame", "added_mass_direction"),
    *("input", "column", "measured", "actuator", "propeller", "weighs"),
}


@dataclass(frozen=True)
class MovingJoint:
    """A moving joint or hinge of a robot file, with its column in a log and the index of its child link."""

    joint: Any
    column: str
    link: int

    @property
    def name(self) -> str:
        """Name of the joint."""
        return str(self.joint.name)

    @property
    def law(self) -> Driven | None:
        """Law by which a driven joint follows the drive; None for a passive joint."""
        law: Driven | None = self.joint.driven
        return law

    @property
    def rate(self) -> str:
        """Log column of the rate of the joint."""
        return self.column.replace("_rad", "_rate_rad_s")


@dataclass(frozen=True)
class Actuated:
    """Actuator of one or several driven joints.

    Attributes
    ----------
    name : str
        Name of the actuator, or of the joint that has the actuator for itself.
    column : str
        Log column of its angle.
    law : Actuator
        Law by which the actuator follows the drive.
    """

    name: str
    column: str
    law: Actuator

    @property
    def command(self) -> str:
        """Log column of the commanded angle."""
        return self.column.replace("joint", "cmd", 1)


def check_names(body: Any, part: str) -> None:
    """Raise an error for duplicate or unknown names in one part of the robot file.

    The error states the dotted path of the name.
    """
    joints = [joint.name for joint in body.joints]
    for kind, names in (("links", [link.name for link in body.links]), ("joints", joints)):
        for n, name in enumerate(names):
            if name in names[:n]:
                raise InputError(
                    f"two {kind} have the name '{name}'",
                    column=f"{part}.{kind}.{n}",
                    hint="rename one of them",
                )
    for name in body.actuators:
        if name in joints:
            raise InputError(
                f"an actuator and a joint have the name '{name}'",
                column=f"{part}.actuators.{name}",
                hint="rename one of them",
            )
    known = {
        "link": [link.name for link in body.links],
        "input": list(body.inputs),
        "actuator": list(body.actuators),
        "propeller": propellers(body),
    }
    for kind, where, name in _list_references(body):
        if name not in known[kind]:
            owners = f"'{part}.{kind}s' has"
            if kind == "propeller":
                owners = "the elements of the kind 'propeller' have the names"
            hint = suggestion(name, known[kind], owners)
            raise InputError(f"the robot has no {kind} '{name}'", column=f"{part}.{where}", hint=hint)
    coefficients = list(body.coefficients)
    for path, quantity in list_quantities(body, part):
        unknown = sorted(Polynomial.of(quantity).names - set(coefficients))
        if unknown:
            hint = suggestion(unknown[0], coefficients, "it has")
            raise InputError(f"the robot has no coefficient '{unknown[0]}'", column=path, hint=hint)


def _list_references(body: Any) -> Iterator[tuple[str, str, str]]:
    """Yield kind, dotted path and value of each name by which joints and elements refer to a part."""
    for joint in body.joints:
        where = f"joints.{joint.name}"
        yield "link", f"{where}.parent", joint.parent
        yield "link", f"{where}.child", joint.child
        if joint.torque is not None:
            yield "input", f"{where}.torque.input", joint.torque.input
        if joint.driven is not None and joint.driven.actuator is not None:
            yield "actuator", f"{where}.driven.actuator", joint.driven.actuator
    for n, element in enumerate(body.elements):
        for kind in ("link", "input", "propeller"):
            name = getattr(element, kind, "")
            if name:
                yield kind, f"elements.{n}.{kind}", name


def propellers(body: Any) -> list[str]:
    """Return the names of the propellers of a robot, in the order of their rows in the input array."""
    return [element.name for element in body.elements if element.kind == "propeller"]


def list_quantities(body: Any, part: str) -> Iterator[tuple[str, float | str]]:
    """Yield the dotted path and the value of each physical quantity of the links, joints and elements.

    In the path, a member of a list has its name, or its index if it has no name.
    """
    parts = {"links", "joints", "elements", "inputs", "actuators", "holder"}
    yield from _leaves(body.model_dump(include=parts), part)


def _leaves(value: Any, path: str) -> Iterator[tuple[str, float | str]]:
    if isinstance(value, dict):
        for key in (key for key in value if key not in WORDS):
            yield from _leaves(value[key], f"{path}.{key}")
    elif isinstance(value, list | tuple):
        for n, member in enumerate(value):
            name = isinstance(member, dict) and member.get("name")
            yield from _leaves(member, f"{path}.{name or n}")
    elif isinstance(value, float | int | str) and not isinstance(value, bool):
        yield path, value


def sort_links(body: Any, part: str) -> tuple[list[Any], list[Any]]:
    """Return the links, parents before children, and the joint between each link and its parent.

    The joint of the base is None.
    """
    joint_of: dict[str, Any] = {}
    for joint in body.joints:
        where = f"{part}.joints.{joint.name}"
        if joint.child in joint_of:
            raise InputError(
                f"the link '{joint.child}' is the child of two joints: '{joint_of[joint.child].name}' "
                f"and '{joint.name}'",
                column=where,
            )
        joint_of[joint.child] = joint
    base = body.links[0].name
    if base in joint_of:
        raise InputError(
            f"the first link, '{base}', is the base and cannot be a joint's child",
            column=f"{part}.joints.{joint_of[base].name}.child",
            hint="the tree closes on itself, or the base is not listed first",
        )
    by_name = {link.name: link for link in body.links}
    order: list[str] = [base]
    joints: list[Any] = [None]
    for name in order:
        children = [j for j in body.joints if j.parent == name]
        order += [j.child for j in children]
        joints += children
    left = [name for name in by_name if name not in order]
    if left:
        raise InputError(
            f"no joints connect the link '{left[0]}' with the base '{base}'", column=f"{part}.links.{left[0]}"
        )
    return [by_name[name] for name in order], joints


def coefficients(known: Mapping[str, Coefficient]) -> list[Parameter]:
    """Return the coefficients of a robot file as model parameters."""
    found = []
    for name, c in known.items():
        start = use_default(c.start, c.value)
        scale = c.scale or abs(c.value) or abs(start) or 1.0
        words = c.meaning, c.source
        found.append(Parameter(name, c.unit, *c.limits, start, scale, c.free, c.per_trial, *words, c.value))
    return found


class Tree(ABC):
    """Links of a robot after all checks, with their input arrays as functions of the coefficients.

    Parameters
    ----------
    body : Multilink or Multibody

    Attributes
    ----------
    names : list of str
        Names of the coefficients, in the order of the values given to :meth:`tables`.
    links : list of Link or Body
        Parents before children. The first link is the base.
    driven, passive : list of Axis
    actuators : list of Actuated
        Actuators of the driven joints, in the order of the first joint that each of them moves.
    actuator_of : list of int
        Index of the actuator of each driven joint.
    free_base : bool
    world_forces : bool
        Whether forces with a fixed direction in the world act, such as weight.
    topology : ndarray of int, shape (links, 3)
        Indices of the parent, the driven joint and the passive joint of each link; -1 for none.

    Raises
    ------
    InputError
        For unknown or duplicate names, a link with no joint or with two joints, a cycle, an element on an
        unknown link, and impossible masses or inertias. The error states the dotted path.
    """

    #: Name of the part of the robot file that describes the links.
    part: str
    #: Compiled equations of motion, which define the columns of the input arrays.
    engine: Engine
    #: Upward direction along the axes of the links when all joints are straight.
    up: tuple[float, float, float]
    #: Last arguments of the engine, by name. They do not depend on the coefficients.
    constants: dict[str, Any]

    def __init__(self, body: Any) -> None:
        self.body = body
        self.names = list(body.coefficients)
        check_names(body, self.part)
        self.links, self._joints = sort_links(body, self.part)
        self.index = {link.name: i for i, link in enumerate(self.links)}
        moving = [j for j in body.joints if j.driven is not None or j.passive is not None]
        axes = [MovingJoint(j, f"joint{k + 1}_rad", self.index[j.child]) for k, j in enumerate(moving)]
        self.driven = [a for a in axes if a.joint.driven is not None]
        self.passive = [a for a in axes if a.joint.passive is not None]
        self.actuators, self.actuator_of = _list_actuators(body, self.driven)
        self.topology = self._connect()
        #: Names of the inputs that move masses. The rates and accelerations of these inputs act, too.
        self.moving_inputs = {e.input for e in body.elements if e.kind == "moving-mass"}
        self.free_base = body.base == "free"
        if not (self.free_base or moving or body.inputs):
            raise InputError(
                "a robot on a fixed base needs a driven or passive joint, or an input",
                column=f"{self.part}.base",
            )
        self.constants = {"free_base": self.free_base}
        self._evaluated = lru_cache(MAX_TABLES)(self._evaluate)

    def _connect(self) -> NDArray[np.int64]:
        """Return the indices of the parent, the driven joint and the passive joint of each link."""
        topology = np.full((len(self.links), 3), -1, dtype=np.int64)
        topology[1:, 0] = [self.index[joint.parent] for joint in self._joints[1:]]
        for column, axes in ((1, self.driven), (2, self.passive)):
            topology[[axis.link for axis in axes], column] = range(len(axes))
        return topology

    def fill(self, fluid: Fluid) -> TableRows:
        """Collect the rows of the input arrays from all links and elements of the robot file.

        Masses and inertias are checked at the coefficient values of the file.
        """
        columns = self.engine.columns
        rows = TableRows(
            self.engine,
            fluid.density_kg_m3,
            fluid.gravity_m_s2,
            self.up,
            self.index,
            list(self.body.inputs),
            len(self.driven),
            propellers(self.body),
        )
        for link in self.links:
            rows.add_rigid(link)
        rigid = [list(row) for row in rows.inertia]
        for element in self.body.elements:
            ADDERS[element.kind](element, self.links[self.index[element.link]], rows)
        for joint in self.body.joints:
            if joint.torque is not None:
                rows.add_torque(joint)
        self._load_inputs = len(self.driven) + np.array(rows.loads, dtype=np.int64)
        self.world_forces = rows.acts_in_world

        def table(name: str, entries: list[Any]) -> PolynomialTable:
            return PolynomialTable(entries, len(columns[name]), self.names)

        self._joint = table("joint", [self._joint_row(j) for j in self._joints])
        self.rigid, self._inertia = table("inertia", rigid), table("inertia", rows.inertia)
        self._passive = table("passive", [law_of(axis.joint) for axis in self.passive])
        self._elements = []
        for name, own in rows.elements.items():
            width = INTEGERS.get(name)
            owners = np.array([integers for integers, _ in own], dtype=np.int64)
            owners = owners.reshape(len(own), width) if width else owners.reshape(-1)
            self._elements.append((name, owners, table(name, [row for _, row in own])))
        self.check(np.array([c.value for c in self.body.coefficients.values()]))
        return rows

    def _joint_row(self, joint: Any) -> Row:
        """Return the row of a joint in the ``joint`` input array. The joint of the base is None."""
        if joint is None:
            row = joint_row([0.0] * 3, (0.0, 0.0, 1.0), Rotation.identity())
        else:
            parent = self.links[self.index[joint.parent]]
            row = joint_row(joint.point(parent), joint.axis, mount_of(joint))
        return select_columns(self.engine, "joint", row)

    def tables(self, values: Array) -> dict[str, Any]:
        """Return the arguments of the engine's ``integrate`` from ``topology`` on, by argument name.

        Parameters
        ----------
        values : ndarray, shape (len(names),)

        Returns
        -------
        dict
            The result is cached for later calls with these values. Do not change it.
        """
        return self._evaluated(np.asarray(values, dtype=float).tobytes())

    def name_values(self, values: Array) -> dict[str, float]:
        """Return the coefficients by name, from a parameter vector that begins with them."""
        return dict(zip(self.names, values, strict=False))

    def _evaluate(self, key: bytes) -> dict[str, Any]:
        """Return the arguments of the engine. ``key`` is the array of coefficient values, as bytes."""
        values = np.frombuffer(key)
        found = {
            "topology": self.topology,
            "joint": self._joint(values),
            "inertia": self._inertia(values),
            "passive": self._passive(values),
        }
        for name, owner, table in self._elements:
            found[f"{name}_link"], found[name] = owner, table(values)
        return {**found, "load_input": self._load_inputs, **self.constants}

    def move_weight(self, tables: dict[str, Any], link: int, centre: Any, by: Any) -> None:
        """Move the weight of a link, which acts at its centre of mass, by a vector in its axes."""
        force, n = tables["force"].copy(), len(by)
        for row, owner in zip(force, tables["force_link"], strict=True):
            down = row[2 * n] != 0.0 and row[2 * n - 1] < 0.0
            if owner == link and down and np.allclose(row[:n], centre, atol=1e-9):
                row[:n] += by
        tables["force"] = force

    @abstractmethod
    def check(self, values: Array) -> None:
        """Raise an error for physically impossible masses or inertias.

        Raises
        ------
        InputError
        """


def _list_actuators(body: Any, driven: Sequence[MovingJoint]) -> tuple[list[Actuated], list[int]]:
    """Return the actuators of driven joints, and the index of the actuator of each joint."""
    found: dict[str, Actuated] = {}
    names = []
    for axis in driven:
        law = axis.joint.driven
        own = Actuated(axis.name, axis.column, law)
        if law.actuator is not None:
            own = Actuated(law.actuator, f"joint_{law.actuator}_rad", body.actuators[law.actuator])
        found.setdefault(own.name, own)
        names.append(own.name)
    order = list(found)
    return list(found.values()), [order.index(name) for name in names]


def check_apparent(inertia: Array, sizes: Array, *, column: str, hint: str) -> None:
    """Raise an error if an apparent inertia (with added mass) is not positive definite.

    Parameters
    ----------
    inertia : ndarray, shape (n, n)
    sizes : ndarray, shape (n,)
        Typical magnitude of each diagonal entry.
    column, hint : str
        Dotted path of the link and possible cause, both for the error message.

    Raises
    ------
    InputError
    """
    scale = np.sqrt(np.maximum(sizes, 1e-300))
    if np.linalg.eigvalsh(inertia / np.outer(scale, scale)).min() <= 0:
        raise InputError(
            "the apparent inertia (with added mass) is not positive definite", column=column, hint=hint
        )


def law_of(joint: Joint) -> list[Polynomial]:
    """Return the row for the law of a passive joint in the ``passive`` input array of the engine."""
    law = joint.passive
    assert law is not None
    tendon = getattr(law, "tendon", None)
    wire = (0.0,) * 4
    if tendon is not None:
        wire = tendon.spring_N_m, tendon.pretension_m, tendon.arm_m, tendon.crank_m
    row = (
        law.stiffness_N_m_rad,
        law.cubic_N_m_rad3,
        law.damping_N_m_s_rad,
        law.quadratic_damping_N_m_s2_rad2,
        math.radians(law.rest_deg),
        *wire,
        law.friction_N_m,
        law.friction_below_rad_s,
    )
    return [Polynomial.of(entry) for entry in row]
