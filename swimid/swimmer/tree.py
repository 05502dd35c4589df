"""What every tree of links checks: names, quantities, and that it is one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, nearest
from swimid.fitting.model import Parameter
from swimid.robots.planar import Coefficient
from swimid.swimmer.polynomial import Polynomial, Table

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


def check_names(body: Any, part: str) -> None:
    """Refuse names that stand twice or are not there.

    Parameters
    ----------
    body : document with links, joints, elements and coefficients
    part : str
        Its place in the robot file.

    Raises
    ------
    InputError
        With the dotted path of what is wrong.
    """
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
                f"there is no link '{name}'", column=f"{part}.{where}", hint=_offer(name, links, "none")
            )
    known = list(body.coefficients)
    for path, quantity in quantities(body, part):
        for name in Polynomial.of(quantity).terms:
            for factor in name:
                if factor not in known:
                    raise InputError(
                        f"there is no coefficient '{factor}'", column=path, hint=_offer(factor, known, "none")
                    )


def _offer(name: str, known: list[str], nothing: str) -> str:
    close = nearest(name, known)
    return f"did you mean '{close}'?" if close else f"there are: {', '.join(known) or nothing}"


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
    """Links with parents before children, and the joint each hangs on (None for the base).

    Raises
    ------
    InputError
        A link without or with two joints, or a cycle.
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
        loose = [name for name in left if name not in joint_of]
        if loose:
            raise InputError(f"no joint holds the link '{loose[0]}'", column=f"{part}.links.{loose[0]}")
        raise InputError(
            f"the links {', '.join(left)} hang on each other in a circle and not on the base",
            column=f"{part}.joints.{joint_of[left[0]].name}",
        )
    return [by_name[name] for name in order], joints


def element_tables(
    rows: Any, columns: Sequence[tuple[str, Sequence[str]]], names: Sequence[str]
) -> list[tuple[str, NDArray[np.int64], Table]]:
    """The rows of elements as tables, each with the links they act on.

    Parameters
    ----------
    rows : object
        A list of (link, row) for each table, under its name.
    columns : sequence of (str, sequence of str)
        Each table's name and columns, in the order the engine takes them.
    names : sequence of str
        Coefficients, in the order of their values.
    """
    return [
        (
            name,
            np.array([link for link, _ in getattr(rows, name)], dtype=np.int64),
            Table([row for _, row in getattr(rows, name)], len(heads), list(names)),
        )
        for name, heads in columns
    ]


def coefficients(known: Mapping[str, Coefficient]) -> list[Parameter]:
    """The coefficients of a robot file as parameters."""
    found = []
    for name, c in known.items():
        start = c.value if c.start is None else c.start
        low, high = (math.inf if b is None else b for b in c.bounds)
        found.append(
            Parameter(
                name,
                c.unit,
                -math.inf if c.bounds[0] is None else low,
                high,
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
