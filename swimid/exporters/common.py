"""What the targets share: what comes out of them, XML, and limits that hold for all of them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from swimid.exporters.source import Source, about, central, isotropic
from swimid.fitting.model import Array
from swimid.results.parameters import Estimate

NO_ERRORS = "standard errors and correlations stand in a comment only; --to json keeps them as numbers"


@dataclass(frozen=True)
class Exported:
    """A finished export.

    Attributes
    ----------
    text : str
        The file.
    limits : sequence of str
        What the target cannot carry, one sentence each.
    """

    text: str
    limits: Sequence[str] = ()


def number(*values: float) -> str:
    """Numbers as XML wants them, to the last bit.

    >>> number(0.1, -0.0)
    '0.1 0.0'
    """
    return " ".join(repr(float(v) + 0.0) for v in values)


def document(template: str, source: Source, limits: Iterable[str], **more: Any) -> str:
    """The XML text of a template, with the source of the numbers and the limits in a comment.

    Parameters
    ----------
    template : str
        Its file in ``templates``. It is given ``source``, and numbers and tuples stand in it as they are.
    limits : iterable of str
    **more
        What else it is given.
    """
    environment = Environment(
        loader=PackageLoader("swimid.exporters"), autoescape=True, undefined=StrictUndefined, finalize=_shown
    )
    root = ET.fromstring(environment.get_template(template).render(source=source, **more))
    for element in root.iter():
        element.text = element.text if element.text and element.text.strip() else None
    ET.indent(root)
    held = [f"  {name} = {_told(e)}" for name, e in source.parameters.parameters.items()]
    lines = [
        f"Written by swimid {source.origin['version']}.",
        f"Parameters: {source.origin['file']}, sha256 {source.origin['sha256']}.",
        f"Robot: {source.robot.name}.",
        *held,
        "Not carried by this format:",
        *(f"  {limit}" for limit in limits),
    ]
    # a comment must not hold two hyphens in a row
    note = "\n".join(lines).replace("--", "- -")
    return f'<?xml version="1.0"?>\n<!--\n{note}\n-->\n{ET.tostring(root, encoding="unicode")}\n'


def _shown(value: Any) -> Any:
    if isinstance(value, str):
        return value
    return number(*value) if isinstance(value, list | tuple) else number(value)


def _told(estimate: Estimate) -> str:
    error = "" if estimate.stderr is None else f" +- {estimate.stderr!r}"
    unit = "" if estimate.unit == "1" else f" {estimate.unit}"
    return f"{estimate.value!r}{error}{unit} ({estimate.status})"


def bodies(source: Source, *, fold: bool) -> list[Array]:
    """Inertia each link's body gets, over (u, v, r) at its origin; with ``fold`` the water's is in it.

    An anisotropic added mass is folded with its mean.
    """
    inertias = []
    for link in source.links:
        inertia = link.rigid
        if fold and np.any(link.added):
            mass, (x, y), moment = central(link.added)
            inertia = inertia + about(np.diag([mass, mass, moment]), -x, -y)
        inertias.append(inertia)
    return inertias


def added_mass_limits(source: Source, choice: str) -> list[str]:
    """Limits of folding or leaving out the added mass, for a target without one of its own."""
    wet = [link for link in source.links if np.any(link.added)]
    if not wet:
        return []
    if choice == "none":
        return ["added mass and inertia are left out, as asked"]
    if choice != "fold":
        return []
    limits = [
        "added mass is part of the bodies' masses: their weight, where gravity acts, is that much too large"
    ]
    uneven = [
        f"{link.name} {link.added[0, 0]:.4g} kg forward, {link.added[1, 1]:.4g} kg sideways"
        for link in wet
        if not isotropic(link.added)
    ]
    if uneven:
        limits.append(f"added mass that differs by direction is folded with its mean: {', '.join(uneven)}")
    return limits


def joint_limits(source: Source, servo_hz: float) -> list[str]:
    """Limits of dry friction, which swimid rounds off, and of driven joints, whose motion it prescribes."""
    limits = [
        f"{name}: swimid rounds the dry friction of {law.friction:.4g} N m off below "
        f"{law.friction_below:g} rad/s; the target holds the joint still there"
        for name, law in source.laws.items()
        if law.friction
    ]
    driven = [axis.joint for axis in source.assembly.driven]
    assumed = [joint.name for joint in driven if joint.driven and joint.driven.servo is None]
    if assumed:
        limits.append(
            f"driven joints follow their command exactly in swimid; here a position servo of {servo_hz:g} Hz "
            f"moves them: {', '.join(assumed)}"
        )
    return limits
