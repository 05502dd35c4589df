"""Write an identified swimmer as a scenario of Stonefish, from swimid's JSON export.

python docs/examples/stonefish.py > tfish.scn

Stonefish sums the water's forces over the faces of a shape. Each link becomes a box with the link's length
that displaces its own mass, and its drag vectors are set so that the forces along and across the link are
the identified ones. Since 2024 Stonefish's form drag grows with the cube of the speed: the coefficients
give the identified force at 1 m/s. Lift, trailing edges, moments, springs of joints and standard errors are
left out; the added mass is Stonefish's own. Axes are x forward, y to starboard, z down.
"""

from __future__ import annotations

import json
import math
import warnings
import xml.etree.ElementTree as ET
from typing import Any

import swimid

#: Height of a link over its length: no identification tells it.
SLENDERNESS = 0.3


def vector(*values: float) -> str:
    """Return numbers as Stonefish reads them."""
    return " ".join(repr(float(v) + 0.0) for v in values)


def box(parent: ET.Element, robot: dict[str, Any], link: dict[str, Any]) -> None:
    """Add a link as a box that displaces its mass and drags as it does."""
    density, vertical = robot["fluid"]["density_kg_m3"], robot["plane"] == "vertical"
    length, mass, (x, y) = link["length_m"], link["mass_kg"], link["com_m"]
    height = SLENDERNESS * length
    width = mass / (density * length * height)
    drag = [point for point in robot["drag_points"] if point["link"] == link["name"]]
    total = {
        key: sum(point[key] for point in drag)
        for key in ("quadratic_x", "quadratic_y", "linear_x", "linear_y")
    }
    quadratic = [2 * total["quadratic_x"] / (density * height * width)]
    quadratic.append(2 * total["quadratic_y"] / (density * length * height))
    viscous = [total["linear_x"] / (2 * density * length * (height + width))]
    viscous.append(total["linear_y"] / (2 * density * width * (length + height)))

    def three(along: float, across: float, other: float = 0.0) -> str:
        return vector(along, other, across) if vertical else vector(along, across, other)

    tag = "base_link" if link["parent"] is None else "link"
    node = ET.SubElement(parent, tag, name=link["name"], type="box", physics="submerged", buoyant="true")
    centre = three(x, -y)
    ET.SubElement(node, "dimensions", xyz=three(length, width, height))
    ET.SubElement(node, "origin", xyz=centre, rpy="0 0 0")
    ET.SubElement(node, "material", name="body")
    ET.SubElement(node, "look", name="body")
    ET.SubElement(node, "mass", value=repr(mass))
    ET.SubElement(node, "inertia", xyz=vector(*[link["inertia_about_com_kg_m2"]] * 3))
    ET.SubElement(node, "cg", xyz=centre, rpy="0 0 0")
    ET.SubElement(node, "hydrodynamics", viscous_drag=three(*viscous), quadratic_drag=three(*quadratic))


def joint(parent: ET.Element, vertical: bool, given: dict[str, Any]) -> None:
    """Add a joint with its damping and friction, and a servo where it is driven."""
    law, driven, (x, y), turn = given["passive"], given["driven"], given["at_m"], given["mount_rad"]
    kind = "revolute" if law or driven else "fixed"
    node = ET.SubElement(parent, "joint", name=given["name"], type=kind)
    ET.SubElement(node, "parent", name=given["parent"])
    ET.SubElement(node, "child", name=given["child"])
    place = (vector(x, 0, -y), vector(0, turn, 0)) if vertical else (vector(x, -y, 0), vector(0, 0, -turn))
    ET.SubElement(node, "origin", xyz=place[0], rpy=place[1])
    if kind == "revolute":
        ET.SubElement(node, "axis", xyz="0 1 0" if vertical else "0 0 -1")
    if law:
        ET.SubElement(node, "damping", constant=repr(law["friction"]), viscous=repr(law["damping"]))
    if driven:
        servo = ET.SubElement(parent, "actuator", name=f"{given['name']}_servo", type="servo")
        ET.SubElement(servo, "controller", position_gain="1.0", velocity_gain="0.5", max_torque="1000.0")
        ET.SubElement(servo, "joint", name=given["name"])


def scenario(params: Any) -> str:
    """Return the scenario of a parameter file of a multi-link robot."""
    robot = json.loads(swimid.export(params, to="json").document)
    density, vertical = str(robot["fluid"]["density_kg_m3"]), robot["plane"] == "vertical"
    root = ET.Element("scenario")
    environment = ET.SubElement(root, "environment")
    ET.SubElement(environment, "ned", latitude="0.0", longitude="0.0")
    ET.SubElement(ET.SubElement(environment, "ocean"), "water", density=density, jerlov="0.2")
    materials = ET.SubElement(root, "materials")
    ET.SubElement(materials, "material", name="body", density=density, restitution="0.5")
    looks = ET.SubElement(root, "looks")
    ET.SubElement(looks, "look", name="body", rgb="0.9 0.6 0.1", roughness="0.5")
    fixed = str(robot["base"] == "fixed").lower()
    body = ET.SubElement(root, "robot", name=robot["robot"], fixed=fixed, self_collisions="false")
    for link in robot["links"]:
        box(body, robot, link)
    for given in robot["joints"]:
        joint(body, vertical, given)
    heading = math.radians(robot["heading_deg"]) if fixed == "true" else 0.0
    turned = vector(0, heading, 0) if vertical else vector(0, 0, -heading)
    ET.SubElement(body, "world_transform", xyz="0 0 1", rpy=turned)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", swimid.SwimidWarning)
        print(scenario(swimid.fit_graybox("sample_logs/tfish/trials.yaml", share=["c_f"])))
