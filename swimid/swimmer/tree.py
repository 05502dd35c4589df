"""Tree of the links of a robot, in a plane or in 3-D, with its checks and its input arrays for an engine.

An engine is the compiled equations of motion with their time integration. Its input arrays (tables) hold the
inertias, joints and hydrodynamic elements of the robot.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np

from swimid.errors import InputError, suggestion
from swimid.fitting.model import Array, Parameter
from swimid.robots.file import Fluid
from swimid.robots.planar import (
    MAX_FACTORS,
    Actuator,
    Coefficient,
    Connection,
    DerivativeTerms,
    Driven,
    PropellerLaw,
    RudderLaw,
    derivative_parts,
    factors,
)
from swimid.swimmer.planar.engine import PASSIVE

#: Maximum number of coefficient vectors whose input arrays are cached.
MAX_TABLES = 64
#: Indices that expand the upper triangle of a symmetric 3 by 3 matrix, stored row by row, to the whole
#: matrix.
SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


class Polynomial:
    """Polynomial in the coefficients of a robot file.

    Attributes
    ----------
    terms : dict of tuple of str to float
        Factor of each monomial. The key of a monomial is the sorted tuple of its coefficient names.

    >>> mass = Polynomial.of("2 * c_m")
    >>> (mass * mass + 1.0).at({"c_m": 3.0})
    37.0
    """

    __slots__ = ("terms",)

    def __init__(self, terms: dict[tuple[str, ...], float]) -> None:
        self.terms = {names: number for names, number in terms.items() if number != 0.0}

    @classmethod
    def of(cls, quantity: float | str | Polynomial | None) -> Polynomial:
        """Convert a number, a quantity of a robot file (None is zero) or a polynomial to a polynomial."""
        if isinstance(quantity, Polynomial):
            return quantity
        number, names = factors(use_default(quantity, 0.0))
        return cls({names: number})

    def __add__(self, other: Polynomial | float) -> Polynomial:
        terms = dict(self.terms)
        for names, number in Polynomial.of(other).terms.items():
            terms[names] = terms.get(names, 0.0) + number
        return Polynomial(terms)

    def __mul__(self, other: Polynomial | float) -> Polynomial:
        terms: dict[tuple[str, ...], float] = {}
        for names, number in self.terms.items():
            for more, factor in Polynomial.of(other).terms.items():
                key = tuple(sorted((*names, *more)))
                terms[key] = terms.get(key, 0.0) + number * factor
        return Polynomial(terms)

    def __neg__(self) -> Polynomial:
        return self * -1.0

    def __sub__(self, other: Polynomial | float) -> Polynomial:
        return self + -Polynomial.of(other)

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other: float) -> Polynomial:
        return Polynomial.of(other) - self

    @property
    def names(self) -> set[str]:
        """Names of all coefficients in the polynomial."""
        return {name for factors in self.terms for name in factors}

    def at(self, values: Mapping[str, float]) -> float:
        """Return the value of the polynomial at values of the coefficients."""
        return float(sum(n * np.prod([values[name] for name in names]) for names, n in self.terms.items()))


def use_default(quantity: Any, default: Any) -> Any:
    """Return an optional entry of a robot file, or the default value if the file lacks the entry."""
    if quantity is None:
        return default
    return quantity


#: Type of an entry of an input array before it is evaluated. A string is a quantity of a robot file.
Entry = Polynomial | float | str
#: Type of a row of an input array before it is evaluated.
Row = list[Entry]


@dataclass
class TableRows:
    """Rows of the input arrays of an engine, as they are collected from a robot file.

    Attributes
    ----------
    density_kg_m3, gravity_m_s2 : float
    index : mapping of link name to int
    inertia : list of rows, one per link
        Apparent inertia about the origin of the link.
    elements : mapping of input array to list of (link index, row)
        Hydrodynamic elements. The module of the engine defines their columns.
    inputs : sequence of str
        Names of the inputs, in the order of their rows in the drive array.
    loads : list of int
        Index of the input of each load.
    first_input : int
        Row of the first input in the drive array, after the driven joints.
    propellers : sequence of str
        Names of the propellers, in the order of their rows.
    """

    density_kg_m3: float
    gravity_m_s2: float
    index: Mapping[str, int]
    inertia: list[Row]
    elements: dict[str, list[tuple[tuple[int, ...], Row]]]
    inputs: Sequence[str] = ()
    loads: list[int] = field(default_factory=list)
    first_input: int = 0
    propellers: Sequence[str] = ()

    def add_inertia(self, link: str, terms: Row) -> None:
        """Add terms to the row of a link in the ``inertia`` input array."""
        row = self.inertia[self.index[link]]
        row[:] = [Polynomial.of(a) + Polynomial.of(b) for a, b in zip(row, terms, strict=True)]

    def add(self, table: str, link: str, row: Row, *integers: int) -> None:
        """Add a row to the input array ``table``, for an element of a link.

        Further integers of the element follow the index of the link (``INTEGERS`` of the engine).
        """
        self.elements[table].append(((self.index[link], *integers), row))

    def add_load(self, link: str, name: str, row: Row) -> None:
        """Add a row to the input array ``load``, for a load on a link that is proportional to an input."""
        self.add("load", link, row)
        self.loads.append(self.inputs.index(name))

    def row_of(self, name: str) -> int:
        """Return the row of an input in the drive array."""
        return self.first_input + self.inputs.index(name)

    def add_propeller(self, element: PropellerLaw, point: Row, axis: Row) -> None:
        """Add a propeller at a point of its link, with the unit vector of its axis."""
        size = element.diameter_m
        padded = [*element.thrust_coefficients, 0.0, 0.0][:3]
        gains = [
            self.density_kg_m3 * size**power * Polynomial.of(k)
            for power, k in zip((4, 3, 2), padded, strict=True)
        ]
        shares = [1.0 - Polynomial.of(e) for e in (element.thrust_deduction, element.wake_fraction)]
        jet = 8.0 / (math.pi * self.density_kg_m3 * size**2)
        growth = [Polynomial.of(element.wake_port) - 1.0, Polynomial.of(element.wake_starboard) - 1.0]
        row = [*point, *axis, *gains, *shares, jet, element.wake_decay, *growth]
        self.add("propeller", element.link, row, self.row_of(element.input))

    def add_rudder(self, element: RudderLaw, points: Row) -> None:
        """Add a rudder with the points of its force, of the induced force on the hull, and of the inflow."""
        port, starboard = (
            element.straightening,
            use_default(element.straightening_starboard, element.straightening),
        )
        row = [
            *points,
            0.5 * self.density_kg_m3 * Polynomial.of(element.area_m2) * Polynomial.of(element.lift_slope),
            1.0 - Polynomial.of(element.resistance_deduction),
            element.hull_force,
            port,
            starboard,
            element.inflow_ratio,
            element.slipstream_gain,
            element.slipstream_share,
        ]
        behind = self.propellers.index(element.propeller) if element.propeller else -1
        self.add("rudder", element.link, row, self.row_of(element.input), behind)

    def add_mass(self, element: Any, point: Row) -> None:
        """Add a mass that an input moves, with its point for an input of 0."""
        weight = self.gravity_m_s2 * float(element.weighs) * Polynomial.of(element.mass_kg)
        row = [*point, *element.travel_m, element.mass_kg, weight]
        self.add("slider", element.link, row, self.row_of(element.input))

    def add_terms(
        self,
        element: DerivativeTerms,
        point: Row,
        components: Mapping[str, int],
        velocities: Mapping[str, int],
    ) -> None:
        """Add the hydrodynamic derivatives of a link at a point.

        ``components`` and ``velocities`` have the index in the engine of each component and of each velocity.
        """
        for name, coefficient in element.terms.items():
            component, factors = derivative_parts(name)
            padded = [*factors, *["1"] * (MAX_FACTORS - len(factors))]
            integers = components[component], *(velocities[factor] for factor in padded)
            self.add("term", element.link, [*point, coefficient], *integers)


def gauss_points(low: Any, high: Any, count: int) -> Iterator[tuple[Any, float]]:
    """Yield the points of Gauss's quadrature rule between two positions, each with its weight.

    The sum of the weights is 1.
    """
    for node, weight in zip(*np.polynomial.legendre.leggauss(count), strict=True):
        yield low + 0.5 * (high - low) * (1.0 + float(node)), 0.5 * float(weight)


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
    def driven(self) -> Driven | None:
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
    driven : Actuator
        Law by which it follows the drive.
    """

    name: str
    column: str
    driven: Actuator

    @property
    def command(self) -> str:
        """Log column of the commanded angle."""
        return self.column.replace("joint", "cmd", 1)


def check_names(body: Any, part: str) -> None:
    """Raise an error for duplicate or unknown names in one part of the robot file.

    The error states the dotted path of the name.
    """
    links = [link.name for link in body.links]
    joints = [joint.name for joint in body.joints]
    for kind, given in (("links", links), ("joints", joints)):
        for n, own in enumerate(given):
            if own in given[:n]:
                raise InputError(f"the name '{own}' stands twice", column=f"{part}.{kind}.{n}")
    for name in body.actuators:
        if name in joints:
            raise InputError(
                f"a joint is called '{name}', too",
                column=f"{part}.actuators.{name}",
                hint="rename one of them",
            )
    used = [(f"joints.{j.name}.{end}", getattr(j, end)) for j in body.joints for end in ("parent", "child")]
    used += [(f"elements.{n}.link", e.link) for n, e in enumerate(body.elements)]
    asked = [(f"elements.{n}.input", e.input) for n, e in enumerate(body.elements) if hasattr(e, "input")]
    asked += [(f"joints.{j.name}.torque.input", j.torque.input) for j in body.joints if j.torque is not None]
    follow = [
        (f"joints.{j.name}.driven.actuator", j.driven.actuator)
        for j in body.joints
        if j.driven is not None and j.driven.actuator is not None
    ]
    behind = [(f"elements.{n}.propeller", getattr(e, "propeller", "")) for n, e in enumerate(body.elements)]
    tables = (
        ("link", links, used),
        ("input", list(body.inputs), asked),
        ("actuator", body.actuators, follow),
        ("propeller", propellers(body), [(where, name) for where, name in behind if name]),
    )
    for kind, known, names in tables:
        for where, name in names:
            if name not in known:
                where_known = f"'{part}.{kind}s' has"
                if kind == "propeller":
                    where_known = "the elements of the kind 'propeller' have the names"
                hint = suggestion(name, list(known), where_known)
                raise InputError(f"there is no {kind} '{name}'", column=f"{part}.{where}", hint=hint)
    stated = list(body.coefficients)
    for path, quantity in list_quantities(body, part):
        unknown = sorted(Polynomial.of(quantity).names - set(stated))
        if unknown:
            hint = suggestion(unknown[0], stated)
            raise InputError(f"there is no coefficient '{unknown[0]}'", column=path, hint=hint)


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
                f"the link '{joint.child}' hangs on two joints: '{joint_of[joint.child].name}' "
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
    #: Names of the input arrays for elements, in the order of the engine's arguments.
    elements: tuple[str, ...]
    #: Module of the compiled equations of motion (the engine), which defines the columns of the input arrays.
    engine: ModuleType
    #: Functions that add the rows of an element to the input arrays, by kind of element.
    adders: Mapping[str, Callable[[Any, Any, TableRows], None]]
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
        self.topology = np.full((len(self.links), 3), -1, dtype=np.int64)
        for i in range(1, len(self.links)):
            self.topology[i, 0] = self.index[self._joints[i].parent]
        for column, moved in ((1, self.driven), (2, self.passive)):
            for k, axis in enumerate(moved):
                self.topology[axis.link, column] = k
        #: Names of the inputs that move masses, whose rates and accelerations act, too.
        self.moving_inputs = {e.input for e in body.elements if e.kind == "moving-mass"}
        self.free_base = body.base == "free"
        if not (self.free_base or moving or body.inputs):
            raise InputError(
                "a robot on a fixed base without a moving joint or an input has nothing to simulate",
                column=f"{self.part}.base",
            )
        self.constants = {"free_base": self.free_base}
        self._evaluated = lru_cache(MAX_TABLES)(self._evaluate)

    def fill(self, fluid: Fluid) -> TableRows:
        """Collect the rows of the input arrays from all links and elements of the robot file.

        Masses and inertias are checked at the coefficient values of the file.
        """
        engine = self.engine
        empty: list[Row] = [[0.0] * len(engine.INERTIA) for _ in self.links]
        elements: dict[str, list[tuple[tuple[int, ...], Row]]] = {name: [] for name in self.elements}
        rows = TableRows(
            fluid.density_kg_m3,
            fluid.gravity_m_s2,
            self.index,
            empty,
            elements,
            list(self.body.inputs),
            first_input=len(self.driven),
            propellers=propellers(self.body),
        )
        for link in self.links:
            self._add_rigid(link, rows)
        rigid = [list(row) for row in rows.inertia]
        for element in self.body.elements:
            self.adders[element.kind](element, self.links[self.index[element.link]], rows)
        for joint in self.body.joints:
            if joint.torque is not None:
                self._add_torque(joint, rows)
        self._load_inputs = len(self.driven) + np.array(rows.loads, dtype=np.int64)

        def table(entries: list[Any], columns: tuple[str, ...]) -> PolynomialTable:
            return PolynomialTable(entries, len(columns), self.names)

        self._joint = table([self._place(j) for j in self._joints], engine.JOINT)
        self.rigid, self._inertia = table(rigid, engine.INERTIA), table(rows.inertia, engine.INERTIA)
        self._passive = table([law_of(axis.joint) for axis in self.passive], PASSIVE)
        self._elements = []
        for name, own in elements.items():
            width = engine.INTEGERS.get(name)
            owners = np.array([integers for integers, _ in own], dtype=np.int64)
            owners = owners.reshape(len(own), width) if width else owners.reshape(-1)
            entries = [row for _, row in own]
            self._elements.append((name, owners, table(entries, getattr(engine, name.upper()))))
        self.check(np.array([c.value for c in self.body.coefficients.values()]))
        return rows

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
        """Return the arguments of the engine at the coefficient values whose bytes are ``key``."""
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

    @abstractmethod
    def _add_rigid(self, link: Any, rows: TableRows) -> None:
        """Add the mass and inertia of a link, without added mass."""

    @abstractmethod
    def _add_torque(self, joint: Any, rows: TableRows) -> None:
        """Add the torque of an actuator on a joint: moments on its child link and on its parent link."""

    @abstractmethod
    def _place(self, joint: Any) -> Row:
        """Return the row of a joint in the ``joint`` input array. The joint of the base is None."""


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
            "its apparent inertia (with added mass) is not positive definite", column=column, hint=hint
        )


def law_of(joint: Connection) -> list[Polynomial]:
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
