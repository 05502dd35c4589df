"""From a robot file's links, joints and elements to the checked tables the engine reads."""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.fitting.model import Array
from swimid.robots.file import Fluid
from swimid.robots.planar import Joint, Link, Multilink
from swimid.swimmer.planar import engine
from swimid.swimmer.planar.elements import ADDERS, Row, Tables
from swimid.swimmer.polynomial import Polynomial, Table
from swimid.swimmer.tree import Tree, quantities

#: A radius of gyration outside these multiples of a link's length is taken for a slip of units.
GYRATION = (0.02, 5.0)
#: So is a link heavier than a block of this density, kg/m3, its own length and as wide and high as the
#: robot is long (solid lead has 11340).
DENSEST = 5000.0
#: A length may not exceed this times the robot's, an area this times its square.
FAR = 3.0
#: Keys that hold lengths, and keys of elements whose quantity has only one sign.
LENGTH = re.compile(r"(?!.*_(N|N_s|kg)_m$).*_m")
LOSS = re.compile(r"area_m2|coefficient|linear|quadratic|volume|mass_kg_m")
#: What of a passive joint's law has only one sign, and its column in the engine's table.
ONE_SIGN = {
    "stiffness_N_m_rad": 0,
    "damping_N_m_s_rad": 2,
    "quadratic_damping_N_m_s2_rad2": 3,
    "tendon.spring_N_m": 5,
    "friction_N_m": 9,
}
#: A number beyond this is a slip of the pen.
HUGE = 1e15


class Assembly(Tree):
    """A planar robot's links, checked, with their tables (:class:`swimid.swimmer.tree.Tree`).

    Parameters
    ----------
    body : Multilink
    fluid : Fluid
    """

    part, hinge = "multilink", "joint"
    elements = ("drag", "foil", "force", "wake")

    def __init__(self, body: Multilink, fluid: Fluid) -> None:
        super().__init__(body)
        self._sizes = self._sized()
        empty: list[Row] = [[0.0] * len(engine.INERTIA) for _ in self.links]
        rows = Tables(fluid.density_kg_m3, fluid.gravity_m_s2, self.index, empty)
        self.fill(rows, ADDERS, engine)
        self.world_forces = any(row[4] == 1.0 for _, row in rows.force)

    def _sized(self) -> tuple[list[str], NDArray[np.intp], NDArray[np.bool_], Table]:
        """Paths of the quantities, the power of a length each is, which have one sign, their values."""
        named = quantities(self.body, "multilink")
        paths = [path for path, _ in named]
        keys = [path.rsplit(".", 1)[-1] for path in paths]
        powers = [2 if key.endswith("area_m2") else 1 if LENGTH.fullmatch(key) else 0 for key in keys]
        losses = [
            path.startswith("multilink.elements") and LOSS.search(key) is not None
            for path, key in zip(paths, keys, strict=True)
        ]
        table = Table([[Polynomial.of(quantity)] for _, quantity in named], 1, self.names)
        return paths, np.array(powers), np.array(losses), table

    @property
    def unknowns(self) -> int:
        """Degrees of freedom n: 3 of the base and one per passive joint."""
        return 3 + len(self.passive)

    def check(self, values: Array) -> None:
        """Refuse masses and inertias that no body has, and what looks like a slip of units.

        Raises
        ------
        InputError
        """
        rigid, apparent = self._rigid(values), self._inertia(values)
        self._check_sizes(values)
        span = sum(link.length_m for link in self.links)
        for link, own, whole in zip(self.links, rigid, apparent, strict=True):
            _check_link(link, own, span)
            scale = np.sqrt(np.diag(_full(own)))
            if np.linalg.eigvalsh(_full(whole) / np.outer(scale, scale)).min() <= 0:
                raise InputError(
                    "its apparent inertia (with added mass) is not positive definite",
                    column=f"multilink.links.{link.name}",
                    hint="an added mass or inertia is negative",
                )
        for axis, law in zip(self.passive, self._passive(values), strict=True):
            for key, column in ONE_SIGN.items():
                if law[column] < 0:
                    raise InputError(
                        f"{law[column]:g} is negative; it must not be",
                        column=f"multilink.joints.{axis.joint.name}.passive.{key}",
                    )

    def _check_sizes(self, values: Array) -> None:
        """Refuse sizes out of proportion to the robot, and negative areas and coefficients."""
        paths, powers, one_sign, table = self._sizes
        numbers, span = table(values)[:, 0], sum(link.length_m for link in self.links)
        far = np.where(powers > 0, FAR * span**powers, np.inf)
        sound = (np.abs(numbers) < HUGE) & (np.abs(numbers) <= far) & ~(one_sign & (numbers < 0))
        for k in np.flatnonzero(~sound)[:1]:
            number, power = float(numbers[k]), powers[k]
            if not abs(number) < HUGE:
                raise InputError(f"{number:g} is out of all proportion", column=paths[k])
            if abs(number) > far[k]:
                unit = ("m", "m2")[power - 1]
                raise InputError(
                    f"{number:g} {unit} is out of proportion to a robot {span:g} m long",
                    column=paths[k],
                    hint=f"lengths are in m, areas in m2: is it in {'mm' if power == 1 else 'cm2'}?",
                )
            raise InputError(f"{number:g} is negative; it must not be", column=paths[k])

    def _add_rigid(self, link: Link, rows: Tables) -> None:
        mass = Polynomial.of(link.mass_kg)
        x, y = -Polynomial.of(link.com_m), Polynomial.of(link.com_offset_m)
        inertia = Polynomial.of(link.inertia_kg_m2)
        if link.inertia_about == "front":
            inertia = inertia - mass * (x * x + y * y)
        rows.add_inertia(link.name, x, y, mass, mass, inertia)

    def _place(self, joint: Joint | None) -> Row:
        if joint is None:
            return [0.0, 0.0, 1.0, 0.0]
        station = self.links[self.index[joint.parent]].length_m if joint.at_m is None else joint.at_m
        mount = math.radians(joint.mount_deg)
        return [-Polynomial.of(station), Polynomial.of(joint.offset_m), math.cos(mount), math.sin(mount)]


def _check_link(link: Link, own: Array, span: float) -> None:
    """Refuse a rigid link that no body is."""
    where = f"multilink.links.{link.name}"
    mass = float(own[0])
    if mass <= 0:
        raise InputError(f"its mass is {mass:g} kg; it must be positive", column=f"{where}.mass_kg")
    if mass > DENSEST * link.length_m * span**2:
        raise InputError(
            f"it weighs {mass:g} kg at a length of {link.length_m:g} m, in a robot {span:g} m long",
            column=f"{where}.mass_kg",
            hint="masses are in kg, lengths in m: is one of them in g or mm?",
        )
    x, y = own[4] / mass, -own[2] / mass
    central = float(own[5] - mass * (x * x + y * y))
    if central <= 1e-9 * mass * link.length_m**2:
        shift = f"the mass alone gives {mass * (x * x + y * y):.4g} kg m2 about the front end"
        raise InputError(
            f"its inertia leaves {central:.4g} kg m2 about the centre of mass; it must be positive",
            column=f"{where}.inertia_kg_m2",
            hint=f"the file says it is about the front end: {shift}"
            if link.inertia_about == "front"
            else None,
        )
    radius = math.sqrt(central / mass)
    if not GYRATION[0] <= radius / link.length_m <= GYRATION[1]:
        raise InputError(
            f"mass {mass:g} kg and inertia {central:.4g} kg m2 give a radius of gyration of "
            f"{1e3 * radius:.4g} mm for a length of {1e3 * link.length_m:.4g} mm",
            column=f"{where}.inertia_kg_m2",
            hint="lengths are in m, masses in kg, inertias in kg m2: is one in mm, g or g m2?",
        )


def _full(row: Array) -> Array:
    a, b, c, d, e, f = row
    return np.array([[a, b, c], [b, d, e], [c, e, f]])
