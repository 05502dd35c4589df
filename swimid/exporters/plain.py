"""Export to JSON with all known values, for simulators that have no export format of their own."""

from __future__ import annotations

import json
from typing import Any

from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Exported, Link, Source, central

TITLE = "JSON"
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


def export(source: Source, options: ExportOptions) -> Exported:
    """Return the JSON document of a multi-link robot. This format has no limits."""
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
    return Exported(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


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
        # adding 0.0 changes -0.0 to 0.0
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
