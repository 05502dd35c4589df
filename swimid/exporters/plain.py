"""JSON: everything that is known, evaluated, for a simulator of one's own."""

from __future__ import annotations

import json
from typing import Any

from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Exported, Link, Source, central, surge
from swimid.fitting.model import Array

FORMAT = "swimid-export/1"
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
    """The JSON document; see :class:`swimid.exporters.export.Target`."""
    file = source.parameters
    data: dict[str, Any] = {
        "format": FORMAT,
        "generator": f"swimid {source.origin['version']}",
        "source": dict(source.origin),
        "model": file.model,
        "robot": source.robot.name,
        "fluid": source.robot.fluid.model_dump(),
        "parameters": {name: e.model_dump(mode="json") for name, e in file.parameters.items()},
        "correlation": file.correlation.model_dump(mode="json") if file.correlation else None,
        "identifiability": list(file.identifiability),
        "derived": {name: e.model_dump(mode="json") for name, e in file.derived.items()},
    }
    data |= _multilink(source) if source.multilink else {"surge": surge(source)}
    return Exported(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def _multilink(source: Source) -> dict[str, Any]:
    body, links = source.body, source.links
    readings = {key: reading.chosen for key, reading in source.robot.readings.items()}
    columns = {a.joint.name: a.column for a in (*source.assembly.driven, *source.assembly.passive)}
    return {
        "conventions": CONVENTIONS,
        "plane": body.plane,
        "base": body.base,
        "heading_deg": body.heading_deg,
        "reference": body.reference.model_dump(),
        "readings": readings,
        "coefficients": dict(zip(source.assembly.names, (float(v) for v in source.values), strict=True)),
        "links": [_link(link, links) for link in links],
        "joints": [
            {
                "name": link.joint.name,
                "column": columns.get(link.joint.name),
                "parent": links[link.parent].name,
                "child": link.name,
                "at_m": list(link.at),
                "mount_rad": link.mount_rad,
                "driven": link.joint.driven.model_dump(mode="json") if link.joint.driven else None,
                "passive": _passive(source, link.joint.name),
            }
            for link in links
            if link.joint is not None
        ],
        **{
            plural: [{"link": links[e.link].name, **e.numbers} for e in source.elements if e.kind == kind]
            for plural, kind in (
                ("drag_points", "drag"),
                ("foils", "foil"),
                ("forces", "force"),
                ("trailing_edges", "wake"),
            )
        },
    }


def _passive(source: Source, joint: str) -> dict[str, float] | None:
    law = source.laws.get(joint)
    return None if law is None else {**vars(law), "wire_stiffness": law.wire_stiffness}


def _link(link: Link, links: list[Link]) -> dict[str, Any]:
    mass, centre, moment = central(link.rigid)
    return {
        "name": link.name,
        "parent": links[link.parent].name if link.parent >= 0 else None,
        "length_m": link.length_m,
        "mass_kg": mass,
        "com_m": list(centre),
        "inertia_about_com_kg_m2": moment,
        "rigid_inertia": _matrix(link.rigid),
        "added_inertia": _matrix(link.added),
        "apparent_inertia": _matrix(link.rigid + link.added),
    }


def _matrix(inertia: Array) -> list[list[float]]:
    return [[float(v) + 0.0 for v in row] for row in inertia]
