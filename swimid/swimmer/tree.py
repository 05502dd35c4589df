"""A robot's tree of links, in a plane or in space: what is checked of it, and its tables for an engine."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, suggestion
from swimid.fitting.model import Array, Parameter
from swimid.robots.file import Fluid
from swimid.robots.planar import Coefficient, Driven, Joint, factors
from swimid.robots.spatial import Hinge
from swimid.swimmer.planar.engine import PASSIVE


class Polynomial:
    """A polynomial with numbers for factors and coefficient names for unknowns.

    Attributes
    ----------
    terms : dict of tuple of str to float
        Sorted names of a monomial's factors, and what it is multiplied by.

    >>> mass = Polynomial.of("2 * c_m")
    >>> (mass * mass + 1.0).at({"c_m": 3.0})
    37.0
    """

    __slots__ = ("terms",)

    def __init__(self, terms: dict[tuple[str, ...], float]) -> None:
        self.terms = {names: number for names, number in terms.items() if number != 0.0}

    @classmethod
    def of(cls, quantity: float | str | Polynomial | None) -> Polynomial:
        """A number, a quantity of a robot file (None counts as zero), or a polynomial."""
        if isinstance(quantity, Polynomial):
            return quantity
        number, names = factors(0.0 if quantity is None else quantity)
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

    def at(self, values: dict[str, float]) -> float:
        """Its value."""
        return float(sum(n * np.prod([values[name] for name in names]) for names, n in self.terms.items()))


#: An entry of a table before it is evaluated; words are quantities of a robot file. A row of a table.
Entry = Polynomial | float | str
Row = list[Entry]


class Table:
    """A table of polynomials, evaluated together.

    The width is that of a table without rows; coefficients are named in the order their values come in.
    """

    def __init__(
        self, rows: Sequence[Sequence[Polynomial | float]], columns: int, names: Sequence[str]
    ) -> None:
        self.shape = (len(rows), columns)
        entries = [Polynomial.of(entry) for row in rows for entry in row]
        monomials = sorted({m for entry in entries for m in entry.terms if m})
        self.constant = np.array([entry.terms.get((), 0.0) for entry in entries])
        # monomials of fewer factors are padded by a one behind the coefficients
        longest = max((len(m) for m in monomials), default=0)
        padded = [[names.index(name) for name in m] + [len(names)] * (longest - len(m)) for m in monomials]
        self.factors = np.array(padded, dtype=int).reshape(len(monomials), longest)
        self.gains = np.array([[entry.terms.get(m, 0.0) for m in monomials] for entry in entries]).reshape(
            len(entries), len(monomials)
        )

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Entries that are not zero whatever the coefficients, shape (rows, columns)."""
        return np.asarray(((self.constant != 0.0) | (self.gains != 0.0).any(axis=1)).reshape(self.shape))

    def __call__(self, values: Array) -> Array:
        """The table at the coefficients' values, shape (rows, columns); it may be the object's own."""
        if not len(self.factors):
            return self.constant.reshape(self.shape)
        padded = np.append(values, 1.0)
        products = padded[self.factors[:, 0]]
        for column in self.factors.T[1:]:
            products = products * padded[column]
        return np.asarray((self.constant + self.gains @ products).reshape(self.shape))


#: Keys that hold words, not quantities.
WORDS = {
    "name",
    "link",
    "parent",
    "child",
    "kind",
    "inertia_about",
    "plane",
    "base",
    "frame",
    "added_mass_direction",
}


@dataclass(frozen=True)
class Axis:
    """A joint (or hinge) of a robot file that moves, its column in a log, and the link it turns."""

    joint: Any
    column: str
    link: int

    @property
    def name(self) -> str:
        """Of the joint."""
        return str(self.joint.name)

    @property
    def driven(self) -> Driven | None:
        """How it follows the drive; None where it yields."""
        law: Driven | None = self.joint.driven
        return law

    @property
    def rate(self) -> str:
        """The column of its rate."""
        return self.column.replace("_rad", "_rate_rad_s")


def check_names(body: Any, part: str) -> None:
    """Refuse names that stand twice or are not there, with their dotted path in a part of the robot file."""
    links = [link.name for link in body.links]
    for kind, given in (("links", links), ("joints", [joint.name for joint in body.joints])):
        for n, own in enumerate(given):
            if own in given[:n]:
                raise InputError(f"the name '{own}' stands twice", column=f"{part}.{kind}.{n}")
    used = [(f"joints.{j.name}.{end}", getattr(j, end)) for j in body.joints for end in ("parent", "child")]
    used += [(f"elements.{n}.link", e.link) for n, e in enumerate(body.elements)]
    for where, name in used:
        if name not in links:
            raise InputError(
                f"there is no link '{name}'", column=f"{part}.{where}", hint=suggestion(name, links)
            )
    known = list(body.coefficients)
    for path, quantity in quantities(body, part):
        for name in Polynomial.of(quantity).terms:
            for factor in name:
                if factor not in known:
                    raise InputError(
                        f"there is no coefficient '{factor}'",
                        column=path,
                        hint=suggestion(factor, known),
                    )


def quantities(body: Any, part: str) -> list[tuple[str, float | str]]:
    """The quantities of a tree and their dotted paths, list members by their names."""
    return _leaves(body.model_dump(include={"links", "joints", "elements"}), part)


def _leaves(value: object, path: str) -> list[tuple[str, float | str]]:
    if isinstance(value, dict):
        return [
            found
            for key, member in value.items()
            if key not in WORDS and key != "coefficients"
            for found in _leaves(member, f"{path}.{key}")
        ]
    if isinstance(value, list | tuple):
        return [
            found
            for n, member in enumerate(value)
            for found in _leaves(
                member, f"{path}.{(member.get('name') or n) if isinstance(member, dict) else n}"
            )
        ]
    return [(path, value)] if isinstance(value, float | int | str) and not isinstance(value, bool) else []


def ordered(body: Any, part: str) -> tuple[list[Any], list[Any]]:
    """Links with parents before children, and the joint that holds each (None for the base)."""
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
        loose = [name for name in left if name not in joint_of]
        if loose:
            raise InputError(f"no joint holds the link '{loose[0]}'", column=f"{part}.links.{loose[0]}")
        raise InputError(
            f"the links {', '.join(left)} hang on each other in a circle and not on the base",
            column=f"{part}.joints.{joint_of[left[0]].name}",
        )
    return [by_name[name] for name in order], joints


def coefficients(known: Mapping[str, Coefficient]) -> list[Parameter]:
    """The coefficients of a robot file as parameters."""
    found = []
    for name, c in known.items():
        start = c.value if c.start is None else c.start
        low, high = c.bounds
        found.append(
            Parameter(
                name,
                c.unit,
                -math.inf if low is None else low,
                math.inf if high is None else high,
                start,
                c.scale or abs(c.value) or abs(start) or 1.0,
                c.free,
                c.per_trial,
                meaning=c.meaning,
                source=c.source,
                known=c.value,
            )
        )
    return found


class Tree(ABC):
    """A robot's links, checked, with their tables as functions of the coefficients.

    Parameters
    ----------
    body : Multilink or Multibody

    Attributes
    ----------
    names : list of str
        Coefficients, in the order of the values given to :meth:`tables`.
    links : list of Link or Body
        Parents before children; the first is the base.
    driven, passive : list of Axis
    free_base : bool
    topology : ndarray of int, shape (links, 3)
        Parent, driven joint and passive joint of each link, -1 for none.

    Raises
    ------
    InputError
        With the dotted path of what is wrong: unknown or repeated names, a link without or with
        two joints, a cycle, an element on a link that is not there, masses and inertias that no
        body has.
    """

    #: Its place in the robot file, and what a joint is called there.
    part: str
    hinge: str
    #: The element tables in the order the engine takes them.
    elements: tuple[str, ...]
    #: The last arguments of the engine, which do not depend on the coefficients.
    constants: dict[str, Any]

    def __init__(self, body: Any) -> None:
        self.body = body
        self.names = list(body.coefficients)
        check_names(body, self.part)
        self.links, self._joints = ordered(body, self.part)
        self.index = {link.name: i for i, link in enumerate(self.links)}
        moving = [j for j in body.joints if j.driven is not None or j.passive is not None]
        axes = [Axis(j, f"joint{k + 1}_rad", self.index[j.child]) for k, j in enumerate(moving)]
        self.driven = [a for a in axes if a.joint.driven is not None]
        self.passive = [a for a in axes if a.joint.passive is not None]
        self.topology = np.full((len(self.links), 3), -1, dtype=np.int64)
        for i in range(1, len(self.links)):
            self.topology[i, 0] = self.index[self._joints[i].parent]
        for column, moved in ((1, self.driven), (2, self.passive)):
            for k, axis in enumerate(moved):
                self.topology[axis.link, column] = k
        self.free_base = body.base == "free"
        if not self.free_base and not self.passive:
            raise InputError(
                f"a robot on a fixed base without a passive {self.hinge} has nothing to simulate",
                column=f"{self.part}.base",
            )
        self.constants = {"free_base": self.free_base}
        self._known: dict[bytes, dict[str, Any]] = {}

    def fill(self, fluid: Fluid, rows_of: Any, adders: Mapping[str, Callable[..., None]], engine: Any) -> Any:
        """Collect and return the rows of links and elements, checked at the file's coefficients.

        ``rows_of`` makes them (``Tables``); the engine names the columns of its tables.
        """
        empty = [[0.0] * len(engine.INERTIA) for _ in self.links]
        rows = rows_of(fluid.density_kg_m3, fluid.gravity_m_s2, self.index, empty)
        for link in self.links:
            self._add_rigid(link, rows)
        rigid = [list(row) for row in rows.inertia]
        for element in self.body.elements:
            adders[element.kind](element, self.links[self.index[element.link]], rows)

        def table(entries: list[Any], columns: tuple[str, ...]) -> Table:
            return Table(entries, len(columns), self.names)

        self._joint = table([self._place(j) for j in self._joints], engine.JOINT)
        self._rigid, self._inertia = table(rigid, engine.INERTIA), table(rows.inertia, engine.INERTIA)
        self._passive = table([law_of(axis.joint) for axis in self.passive], PASSIVE)
        self._elements = []
        for name in self.elements:
            owners = np.array([link for link, _ in getattr(rows, name)], dtype=np.int64)
            entries = [row for _, row in getattr(rows, name)]
            self._elements.append((name, owners, table(entries, getattr(engine, name.upper()))))
        self.check(np.array([c.value for c in self.body.coefficients.values()]))
        return rows

    def tables(self, values: Array) -> dict[str, Any]:
        """The arguments of the engine's ``integrate`` from ``topology`` on, by their names.

        Parameters
        ----------
        values : ndarray, shape (len(names),)

        Returns
        -------
        dict
            Its arrays are kept for the next call with these values: nobody writes into them.
        """
        key = values.tobytes()
        known = self._known.get(key)
        if known is None:
            known = self._filled(values)
            if len(self._known) >= 64:
                self._known.clear()
            self._known[key] = known
        return dict(known)

    def _filled(self, values: Array) -> dict[str, Any]:
        found: dict[str, Any] = {
            "topology": self.topology,
            "joint": self._joint(values),
            "inertia": self._inertia(values),
            "passive": self._passive(values),
        }
        for name, owner, table in self._elements:
            found[f"{name}_link"], found[name] = owner, table(values)
        found.update(self.constants)
        return found

    @abstractmethod
    def check(self, values: Array) -> None:
        """Refuse masses and inertias that no body has.

        Raises
        ------
        InputError
        """

    @abstractmethod
    def _add_rigid(self, link: Any, rows: Any) -> None:
        """Add a link's own mass and inertia."""

    @abstractmethod
    def _place(self, joint: Any) -> Row:
        """A joint's row of the engine's table; of the base with None."""


def law_of(joint: Joint | Hinge) -> list[Polynomial]:
    """A passive joint's row of the engine's table."""
    law = joint.passive
    assert law is not None
    tendon = getattr(law, "tendon", None)
    wire = (tendon.spring_N_m, tendon.pretension_m, tendon.arm_m, tendon.crank_m) if tendon else (0.0,) * 4
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
