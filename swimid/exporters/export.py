"""Command ``swimid export``: writes estimated coefficients in the format of a simulator."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import swimid
from swimid.errors import InputError
from swimid.exporters import gazebo, mjcf
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Exported, Link, Source, central
from swimid.files import atomic
from swimid.files.provenance import digests_of
from swimid.notices import warn
from swimid.options import takes
from swimid.results import parameters
from swimid.results.result import Text
from swimid.robots import file as robot
from swimid.swimmer.planar.model import MultilinkModel

FORMAT = "swimid-export/1"
#: Name of the list of force elements in the JSON document, by kind of element.
LISTS = {"drag": "drag_points", "foil": "foils", "force": "forces", "wake": "trailing_edges"}
CONVENTIONS = (
    "SI units and radians. A link's frame sits at its front end, x forward, y to port (up in the vertical "
    "plane). Inertias are 3x3 over (u, v, r) at the link's origin. With momentum P = G nu the wrench on a "
    "link is G nu' + (-r P_y, r P_x, u P_y - v P_x). A drag point at (x, y) feels u - r y and v + r x and "
    "answers -(quadratic |v| + linear) v along each axis and -(quadratic_r |r| + linear_r) r. A trailing "
    "edge that moves with u along and w across its link is pushed by half_mass (w^2, -2 max(u, 0) w). A "
    "joint angle is positive when the child is turned from x towards y; dry friction is friction w / "
    "sqrt(w^2 + friction_below^2) against the joint's rate w."
)


@takes(ExportOptions)
def export(params: parameters.Source, *, options: ExportOptions, output: str | Path | None = None) -> Text:
    """Write the coefficients of a parameter file in the format of a simulator.

    The robot file that the parameter file names is searched in the folder of the parameter file. No simulator
    represents all effects: read the limits before you trust a motion that the simulator computes
    (``docs/export.md``).

    Parameters
    ----------
    params : path, ParameterFile or result of a fit
        Parameters of a robot with links in one plane.
    output : path, optional
        Path of the file to write. With None or ``-`` the text is only returned.

    Returns
    -------
    Result
        ``.document`` is the text of the file (XML or JSON), in SI units. ``.data`` has ``target``,
        ``added_mass`` and ``limits``, the effects that the format cannot represent. Each limit is also a
        warning SWM060.

    Raises
    ------
    InputError
        A file is invalid, the parameters are those of another model, or the robot file lacks a value that the
        format needs.

    Examples
    --------
    >>> import json
    >>> made = export("sample_logs/gap/params.yaml", to="json")
    >>> json.loads(made.document)["robot"], made.data["limits"]
    ('tfish', [])
    """
    title, write = TARGETS[options.to]
    source = load(params)
    out = None if output is None or str(output) == "-" else Path(output)
    if out is not None:
        atomic.check_writable(out, inputs=[parameters.origin(params)])
    text, limits = write(source, options)
    held = source.parameters.parameters
    unknown = [name for name, one in held.items() if one.status == "unidentifiable" and "[" not in name]
    if unknown:
        names = ", ".join(unknown)
        warn("SWM010", f"exported as they stand, though their trials do not determine them: {names}")
    for limit in limits:
        warn("SWM060", f"{title}: {limit}")
    result = {
        "target": options.to,
        "model": source.parameters.model,
        "robot": source.robot.name,
        "added_mass": options.added_mass,
        "limits": limits,
    }
    if out is None:
        return Text("export", text.rstrip("\n"), result | {"text": text}, document=text)
    atomic.write_text(out, text)
    carried = "everything is carried"
    if limits:
        carried = f"{len(limits)} limits, see the warnings"
    summary = f"{source.robot.name} as {title}: {carried}"
    return Text("export", summary, result, [out], document=text)


def load(params: parameters.Source) -> Source:
    """Read a parameter file and the robot that it names, and return both as the source of an export.

    Raises
    ------
    InputError
        A file is invalid, no robot is named, or the parameters are those of another robot.
    """
    path = parameters.place(params)
    file = parameters.read(params, model="multilink")
    if file.robot is None:
        hint = "write the name of a built-in robot, or the path of a robot file, to this entry"
        raise InputError("names no robot", file=path, column="robot", hint=hint)
    readings = {str(key): str(value) for key, value in (file.settings.get("readings") or {}).items()}
    origin = {
        "file": path.name,
        "sha256": next(iter(digests_of([parameters.origin(params)]).values())),
        "version": swimid.__version__,
        "robot": file.robot,
    }
    source = Source(file, robot.read(file.robot, path.parent, readings=readings), origin)
    _check_robot(source, robot.locate(file.robot, path.parent), path)
    return source


def _check_robot(source: Source, place: Path | str, path: Path) -> None:
    """Raise an error if the robot cannot be exported with the parameters of the file.

    The robot must have links, a valid mass matrix, and all coefficients of the file.
    """
    if source.robot.multilink is None:
        raise InputError("has no multilink part", file=place, column="multilink")
    try:
        source.assembly.check(source.values)
    except InputError as error:
        raise robot.located(error, Path(place)) from error
    known = {parameter.name for parameter in MultilinkModel(source.robot).parameters}
    known |= set(source.parameters.settings.get("shared") or {})
    for name in source.parameters.parameters:
        if name.partition("[")[0] not in known:
            raise InputError(
                f"the robot '{source.robot.name}' has no coefficient '{name}'",
                file=path,
                column=f"parameters.{name}",
                hint=f"it has: {', '.join(source.assembly.names) or 'none'}",
            )


# ---------------------------------------------------------------- JSON


def _to_json(source: Source, _: ExportOptions) -> Exported:
    """Return the JSON document of a multi-link robot. This format represents all effects."""
    file, body, links = source.parameters.model_dump(mode="json"), source.body, source.links
    data: dict[str, Any] = {
        "format": FORMAT,
        "generator": f"swimid {source.origin['version']}",
        "source": dict(source.origin),
        "model": file["model"],
        "robot": source.robot.name,
        "fluid": source.robot.fluid.model_dump(),
        **{key: file[key] for key in ("parameters", "correlation", "identifiability", "derived")},
        "conventions": CONVENTIONS,
        "plane": body.plane,
        "base": body.base,
        "heading_deg": body.heading_deg,
        "reference": body.reference.model_dump(),
        "readings": {key: reading.chosen for key, reading in source.robot.readings.items()},
        "coefficients": dict(zip(source.assembly.names, source.values.tolist(), strict=True)),
        "links": [_link(link, links) for link in links],
        "joints": [_joint(source, link) for link in links[1:]],
    }
    for kind, name in LISTS.items():
        data[name] = [{"link": links[e.link].name, **e.numbers} for e in source.elements if e.kind == kind]
    return json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n", []


def _link(link: Link, links: list[Link]) -> dict[str, Any]:
    mass, centre, moment = central(link.rigid)
    parents = {i: parent.name for i, parent in enumerate(links)}
    return {
        "name": link.name,
        "parent": parents.get(link.parent),
        "length_m": link.length_m,
        "mass_kg": mass,
        "com_m": list(centre),
        "inertia_about_com_kg_m2": moment,
        # add 0.0, which changes -0.0 to 0.0
        "rigid_inertia": (link.rigid + 0.0).tolist(),
        "added_inertia": (link.added + 0.0).tolist(),
        "apparent_inertia": (link.rigid + link.added + 0.0).tolist(),
    }


def _joint(source: Source, link: Link) -> dict[str, Any]:
    assert link.joint is not None
    columns = {axis.joint.name: axis.column for axis in (*source.assembly.driven, *source.assembly.passive)}
    joint = link.joint.model_dump(mode="json")
    return {
        "name": link.joint.name,
        "column": columns.get(link.joint.name),
        "parent": source.links[link.parent].name,
        "child": link.name,
        "at_m": list(link.at),
        "mount_rad": link.mount_rad,
        "driven": joint["driven"],
        "passive": source.laws.get(link.joint.name),
    }


#: Title of each export format and the function that writes it, by the value of the option ``--to``.
TARGETS: dict[str, tuple[str, Callable[[Source, ExportOptions], Exported]]] = {
    "mjcf": (mjcf.TITLE, mjcf.export),
    "gazebo": (gazebo.TITLE, gazebo.export),
    "json": ("JSON", _to_json),
}
