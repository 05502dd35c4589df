"""The user's file of MuJoCo with the smallest change that gives it other values and effects
(``repaired.xml``).

Attributes are changed in the text of the file, so that comments, order and defaults are kept.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat

import numpy as np

from swimid.fitting.model import Array, Hooks, Trial
from swimid.simulators.mjcf import MjcfModel, base_array, element_name, mujoco

#: Maximum relative difference between an array of the changed file and the intended array.
ARRAY_RTOL = 1e-7


class SimulatorFile(NamedTuple):
    """File of a user's simulator with other values and with effects.

    Attributes
    ----------
    text : str
    changed : list of str
        Changed attributes, with old and new value.
    left_out : list of str
        Changes that the file cannot express.
    """

    text: str
    changed: list[str]
    left_out: list[str]


class XmlElement(NamedTuple):
    """Element of an XML text: tag, name, tags of enclosing elements, and byte range of its start tag."""

    tag: str
    name: str | None
    around: tuple[str, ...]
    first: int
    end: int


class Change(NamedTuple):
    """Change of an attribute of an element. The old value is that in the compiled file."""

    kind: str
    element: str
    attribute: str
    old: Array
    new: Array


#: XML tags of the elements of each kind. Actuators and tendons have many tags, which are not listed.
TAGS = {
    "joint": ("joint", "freejoint"),
    "body": ("body",),
    "geom": ("geom",),
    "site": ("site",),
    "option": ("option",),
}
#: Tag of the section of an MJCF file in which the elements of a kind are, by kind.
AROUND = dict.fromkeys(("joint", "body", "geom", "site"), "worldbody") | {
    "actuator": "actuator",
    "tendon": "tendon",
}
#: XML tags of actuators that have a servo gain as an attribute, by name of the gain.
SERVO_TAGS = {"kp": ("position",), "kv": ("position", "velocity", "intvelocity")}
#: Place in the file of each array of the compiled model: array, kind of element, attribute, and columns of
#: the array (None for all columns).
WRITTEN: tuple[tuple[str, str, str, slice | None], ...] = (
    ("jnt_stiffness", "joint", "stiffness", None),
    ("dof_damping", "joint", "damping", None),
    ("dof_armature", "joint", "armature", None),
    ("dof_frictionloss", "joint", "frictionloss", None),
    ("body_gravcomp", "body", "gravcomp", None),
    ("body_pos", "body", "pos", None),
    ("geom_fluid", "geom", "fluidcoef", slice(1, 6)),
    ("geom_friction", "geom", "friction", None),
    ("geom_margin", "geom", "margin", None),
    ("site_pos", "site", "pos", None),
    ("tendon_stiffness", "tendon", "stiffness", None),
    ("tendon_damping", "tendon", "damping", None),
    ("tendon_frictionloss", "tendon", "frictionloss", None),
    ("tendon_armature", "tendon", "armature", None),
    ("tendon_lengthspring", "tendon", "springlength", None),
    ("actuator_gear", "actuator", "gear", None),
    ("actuator_dynprm", "actuator", "dynprm", None),
    ("opt.density", "option", "density", None),
    ("opt.viscosity", "option", "viscosity", None),
    ("opt.wind", "option", "wind", None),
    ("opt.gravity", "option", "gravity", None),
)


def edit(model: MjcfModel, values: Array, hooks: Hooks) -> SimulatorFile:
    """Return the file of a model with the values of its parameters and with effects.

    Parameters
    ----------
    values : ndarray
        Parameters of the model, without those of effects.
    hooks : Hooks
            Effects. Effects of commands, clocks and sensors cannot be written to the file.
    """
    text = model.path.read_text(encoding="utf-8")
    wanted = model.fields(values, hooks)
    changes, left_out = _changes(model, wanted)
    said: list[str] = []
    for change in changes:
        changed = _with_attribute(text, change)
        if changed is None:
            left_out.append(
                f"{change.attribute} of the {change.kind} '{change.element}', which has no such place"
            )
            continue
        text = changed
        said.append(
            f"{change.kind} {change.element}: {change.attribute} {_words(change.old)} to {_words(change.new)}"
        )
    text, more = _with_masses(model, text, wanted)
    said += more
    left_out += _differences(model, text, wanted)
    return SimulatorFile(text, said, left_out)


def _changes(model: MjcfModel, wanted: dict[str, Any]) -> tuple[list[Change], list[str]]:
    """Return the attributes to change, and the names of changed arrays that no attribute of the file sets."""
    changes, left_out = [], []
    for field, kind, attribute, columns in WRITTEN:
        if field not in wanted:
            continue
        old, new = base_array(model.compiled, field), np.asarray(wanted[field])
        if kind == "option":
            if not np.array_equal(old, new):
                changes.append(Change(kind, "", attribute, old, new))
            continue
        for row in np.flatnonzero(np.any((old != new).reshape(len(old), -1), axis=1)):
            number = int(model.compiled.dof_jntid[row]) if field.startswith("dof") else int(row)
            part = columns or slice(None)
            name = element_name(model.compiled, kind, number)
            before, after = (np.atleast_1d(a[row])[part] for a in (old, new))
            if name and attribute == "dynprm":
                left_out.append(f"dynprm of the actuator '{name}'")
            elif name:
                changes.append(Change(kind, name, attribute, before, after))
            else:
                left_out.append(f"{attribute} of a {kind} without a name")
    changes += _servos(model, wanted)
    return changes, left_out


def _servos(model: MjcfModel, wanted: dict[str, Any]) -> list[Change]:
    """Return the changed gains of position servos."""
    compiled, changes = model.compiled, []
    for k in range(compiled.nu):
        name = element_name(compiled, "actuator", k)
        for field, column, attribute, sign in (
            ("actuator_gainprm", 0, "kp", 1.0), ("actuator_biasprm", 2, "kv", -1.0),
        ):  # fmt: skip
            if name and field in wanted:
                old, new = base_array(compiled, field)[k, column], wanted[field][k, column]
                if old != new:
                    changes.append(
                        Change("actuator", name, attribute, np.array([sign * old]), np.array([sign * new]))
                    )
    return changes


def _words(values: Sequence[float] | Array) -> str:
    return " ".join(f"{value:.9g}" for value in np.atleast_1d(values))


def elements(text: str) -> list[XmlElement]:
    """Return the elements of an XML text in their order, with the places of their start tags."""
    parser, found, around = expat.ParserCreate(encoding="utf-8"), [], list[str]()
    raw = text.encode()

    def start(tag: str, attributes: dict[str, str]) -> None:
        first = parser.CurrentByteIndex
        found.append(XmlElement(tag, attributes.get("name"), tuple(around), first, _tag_end(raw, first)))
        around.append(tag)

    def end(tag: str) -> None:
        around.pop()

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(raw, True)
    return found


def _tag_end(raw: bytes, first: int) -> int:
    """Return the index after a start tag. Quoted values may contain a bracket."""
    quote = 0
    for at in range(first, len(raw)):
        if quote:
            quote = 0 if raw[at] == quote else quote
        elif raw[at] in b"\"'":
            quote = raw[at]
        elif raw[at] == ord(">"):
            return at + 1
    return len(raw)


def _find(text: str, kind: str, name: str) -> XmlElement | None:
    for element in elements(text):
        if kind == "option":
            if element.tag == "option" and element.around == ("mujoco",):
                return element
        elif (
            element.name == name
            and AROUND[kind] in element.around
            and element.tag in TAGS.get(kind, (element.tag,))
        ):
            return element
    return None


def _set(tag: str, attribute: str, value: str) -> str:
    """Return a start tag with an attribute set to a value."""
    pattern = re.compile(rf"""(\s{attribute}\s*=\s*)("[^"]*"|'[^']*')""")
    if pattern.search(tag):
        return pattern.sub(rf'\g<1>"{value}"', tag, count=1)
    ending = "/>" if tag.endswith("/>") else ">"
    return f'{tag[: -len(ending)].rstrip()} {attribute}="{value}"{ending}'


def _with_attribute(text: str, change: Change) -> str | None:
    """Return the file's text with a changed attribute; None if the element cannot state it."""
    element, raw = _find(text, change.kind, change.element), text.encode()
    if element is None and change.kind == "option":
        root = elements(text)[0]
        new = f'\n  <option {change.attribute}="{_words(change.new)}"/>'
        return (raw[: root.end] + new.encode() + raw[root.end :]).decode()
    if element is None or element.tag == "freejoint":
        return None
    if change.kind == "actuator" and element.tag not in SERVO_TAGS.get(change.attribute, (element.tag,)):
        return None
    tag = raw[element.first : element.end].decode()
    tag = _set(tag, change.attribute, _words(change.new))
    return (raw[: element.first] + tag.encode() + raw[element.end :]).decode()


def _with_masses(model: MjcfModel, text: str, wanted: dict[str, Any]) -> tuple[str, list[str]]:
    """Return the file's text with changed masses, inertias and mass centres, and the changes in words."""
    compiled, said = model.compiled, []
    parts = ("body_mass", "body_inertia", "body_ipos", "body_iquat")
    changed = [n for n in parts if n in wanted]
    for body in range(1, compiled.nbody):
        if all(np.array_equal(base_array(compiled, n)[body], wanted[n][body]) for n in changed):
            continue
        name = element_name(compiled, "body", body)
        element = _find(text, "body", name) if name else None
        if element is None:
            continue
        own = {n: np.asarray(wanted.get(n, base_array(compiled, n)))[body] for n in parts}
        inertial = (
            f'<inertial pos="{_words(own["body_ipos"])}" quat="{_words(own["body_iquat"])}" '
            f'mass="{_words(own["body_mass"])}" diaginertia="{_words(own["body_inertia"])}"/>'
        )
        text = _with_inertial(text, element, inertial)
        before = _words(compiled.body_mass[body])
        said.append(f"body {name}: mass {before} to {_words(own['body_mass'])}, with its inertial element")
    return text, said


def _with_inertial(text: str, body: XmlElement, inertial: str) -> str:
    """Return the file's text in which the element ``inertial`` of one body is added or replaced."""
    raw = text.encode()
    inner = next((e for e in elements(text) if e.first >= body.end), None)
    if inner is not None and inner.tag == "inertial" and inner.around[-1] == "body":
        return (raw[: inner.first] + inertial.encode() + raw[inner.end :]).decode()
    indent = re.search(rb"[ \t]*$", raw[: body.first])
    gap = "\n" + (indent[0].decode() if indent else "") + "  "
    return (raw[: body.end] + (gap + inertial).encode() + raw[body.end :]).decode()


def _differences(model: MjcfModel, text: str, wanted: dict[str, Any]) -> list[str]:
    """Return the names of arrays in which the compiled text differs from the wanted arrays."""
    module = mujoco()
    assets = {}
    for path in model.path.parent.rglob("*"):
        if (
            path.is_file()
            and path != model.path
            and path.suffix.lower() in (".xml", ".stl", ".obj", ".msh", ".png")
        ):
            assets[path.relative_to(model.path.parent).as_posix()] = path.read_bytes()
    try:
        made = module.MjSpec.from_string(text, assets=assets).compile()
    except ValueError as error:
        return [f"MuJoCo cannot compile the changed file: {error}"]
    found = []
    for name, array in wanted.items():
        new = base_array(made, name)
        scale = max(float(np.max(np.abs(array))), 1e-12)
        if new.shape != array.shape or np.max(np.abs(new - array)) > ARRAY_RTOL * scale:
            found.append(f"{name} of the compiled file")
    return found


def with_comment(edited: SimulatorFile, said: Sequence[str]) -> str:
    """Return the text of a changed file, with a comment that lists its changes before the first element."""
    lines = [
        *said,
        *(f"changed: {one}" for one in edited.changed),
        *(f"not here: {o}" for o in edited.left_out),
    ]
    words = "\n     ".join(lines).replace("--", "-")
    first = elements(edited.text)[0].first
    raw = edited.text.encode()
    return (raw[:first] + f"<!-- {words} -->\n".encode() + raw[first:]).decode()


def make_repaired_file(model: MjcfModel, values: Array, trial: Trial, path: Path) -> SimulatorFile:
    """Return the user's file, changed to the parameter values and the effects of a model.

    Parameters
    ----------
    model : MjcfModel
        Model with its effects.
    values : ndarray
            Parameter values, including those of the effects.
    trial : Trial
    path : Path
            Parameter file that belongs to the changed file.
    """
    hooks = model.hooks(values, trial)
    own = values[: model.acting[0].first] if model.acting else values
    edited = edit(model, own, hooks)
    outside = [
        acting.effect.name
        for acting in model.acting
        if not acting.hooks(values, trial).tables and acting.adds_to is None
    ]
    left_out = [*edited.left_out, *(f"{name}, which acts outside the file" for name in outside)]
    said = [f"{model.path.name} with the values and effects of {path.name}"]
    edited = edited._replace(left_out=left_out)
    return edited._replace(text=with_comment(edited, said))
