"""Export of a vehicle in 3-D with one link to Gazebo as an SDF model.

The plugin Hydrodynamics has drag and damping, and the tag ``<fluid_added_mass>`` has the added mass. The
frame of the link is at its centre of mass, as in :mod:`swimid.exporters.gazebo`. Each thruster is a propeller
link with the plugin Thruster, whose commands are forces. The plugin Buoyancy computes the buoyancy from the
volume of a collision box, if the world loads it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from swimid.errors import InputError
from swimid.exporters.causes import limits_of
from swimid.exporters.gazebo import DART_ONLY
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import NO_ERRORS, Exported, ExportSource, xml_text
from swimid.fitting.model import Array
from swimid.swimmer.assembly import lever_matrix
from swimid.swimmer.spatial.engine import COLUMNS
from swimid.swimmer.spatial.model import MultibodyModel, SpatialTree, centre_of_mass, full

#: Letters of forces and moments, and of velocities, in the tags of the plugin Hydrodynamics.
FORCES, SPEEDS = "xyzkmn", "UVWPQR"
#: Mass of a propeller or helper link, divided by the mass of the vehicle, and its radius of gyration, m.
SMALL_MASS, SMALL_RADIUS_M = 1e-6, 0.01
#: Maximum distance of a point from the centre of mass at which the point counts as the centre of mass, m.
SAME_M = 1e-9


@dataclass(frozen=True)
class VehicleSource(ExportSource):
    """Parameter file and robot of an export of a robot in 3-D."""

    part: ClassVar[str] = "multibody"

    @property
    def body(self) -> Any:
        """Entry ``multibody`` of the robot file."""
        return self.robot.multibody

    @cached_property
    def assembly(self) -> Any:
        """Validated description of the robot, which computes the input arrays of the equations of motion."""
        return SpatialTree(self.body, self.robot.fluid)

    def new_model(self) -> Any:
        """Return a simulation model of the robot as the robot file describes it."""
        return MultibodyModel(self.robot)


def export(source: VehicleSource, options: ExportOptions) -> Exported:
    """Return the SDF document of a vehicle with one link, and sentences on what SDF cannot represent.

    Raises
    ------
    InputError
        The robot has several links, or its base is fixed.
    """
    body = source.body
    if len(body.links) > 1 or body.base != "free":
        text = f"the robot '{source.robot.name}' has {len(body.links)} links and a {body.base} base"
        hint = "robots in space are exported as vehicles with one free link"
        raise InputError(text, file=source.path, column="robot", hint=hint)
    rigid, centre = full(source.rigid[0]), centre_of_mass(source.rigid[0])
    at_centre = np.block([[np.eye(3), lever_matrix(centre)], [np.zeros((3, 3)), np.eye(3)]])
    added = at_centre.T @ (full(source.tables["inertia"][0]) - rigid) @ at_centre
    added[np.abs(added) < 1e-9 * np.abs(added).max()] = 0.0
    central = (at_centre.T @ rigid @ at_centre)[3:, 3:]
    mass = float(rigid[0, 0])
    helpers, derivatives = _drag(source, centre)
    volumes, limits = _volumes(source, centre, mass)
    propellers, told = _propellers(source, centre)
    limits += told
    if options.added_mass != "native":
        limits.append(f"--added-mass {options.added_mass} has no effect: the added mass of SDF is exact")
    if len(source.tables["foil"]):
        limits.append(f"{len(source.tables['foil'])} foils are left out")
    for name, words in (("propeller", "propeller"), ("rudder", "rudder"), ("slider", "moving mass")):
        inputs = [list(body.inputs)[row] for row in source.tables[f"{name}_link"][:, 1]]
        limits += [f"the {words} of the input {own} is left out" for own in inputs]
    limits += source.derivative_limits
    limits += [
        f"{cause.name} acts on the commands of the thrusters, and is left out"
        for cause in source.causes
        if cause.hooks.command
    ]
    limits += limits_of(source.causes, [], forces=False)
    return xml_text(
        "vehicle.sdf",
        source,
        [*limits, DART_ONLY, NO_ERRORS],
        [],
        mass=mass,
        centre=centre,
        inertia=central,
        fluid=added.tolist(),
        derivatives=derivatives,
        helpers=helpers,
        volumes=volumes,
        propellers=propellers,
        small={"mass": SMALL_MASS * mass, "moment": SMALL_MASS * mass * SMALL_RADIUS_M**2},
    )


def _drag(source: ExportSource, centre: Array) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Return helper links for drag away from the centre of mass, and the derivatives of the main link."""
    rows = [dict(zip(COLUMNS["drag"], row, strict=True)) for row in source.tables["drag"]]
    own = np.zeros((2, 6))
    helpers = []
    for k, row in enumerate(rows):
        values = np.array([[row[f"{kind}_{c}"] for c in "xyz"] for kind in ("linear", "quadratic")])
        place = np.array([row[c] for c in "xyz"]) - centre
        if np.linalg.norm(place) < SAME_M:
            own[:, :3] += values
            continue
        tags = _tags(np.hstack([values, np.zeros((2, 3))]))
        helpers.append({"name": f"drag{k}", "place": place, "derivatives": tags})
    for damping in source.tables["damping"]:
        named = dict(zip(COLUMNS["damping"], damping, strict=True))
        own[:, 3:] += [[named[f"{kind}_{c}"] for c in "pqr"] for kind in ("linear", "quadratic")]
    return helpers, _tags(own)


def _tags(values: Array) -> dict[str, float]:
    """Return the tags of the plugin Hydrodynamics for linear and quadratic coefficients, shape (2, 6)."""
    tags: dict[str, float] = {}
    for force, speed, linear, quadratic in zip(FORCES, SPEEDS, *values, strict=True):
        tags |= {f"{force}{speed}": -linear, f"{force}{speed}abs{speed}": -quadratic}
    return {tag: float(value) for tag, value in tags.items() if value}


def _volumes(source: ExportSource, centre: Array, mass: float) -> tuple[list[dict[str, Any]], list[str]]:
    """Return boxes with the volume of water that the vehicle displaces, and sentences on forces left out."""
    fluid = source.robot.fluid
    volumes, limits = [], []
    weight = mass * fluid.gravity_m_s2
    for row in source.tables["force"]:
        place, force, world = row[:3] - centre, row[3:6], row[6] != 0.0
        if world and np.linalg.norm(place) < SAME_M and abs(force[2] + weight) < 1e-6 * weight:
            continue
        if world and force[2] > 0.0 and not force[:2].any():
            volume = force[2] / (fluid.density_kg_m3 * fluid.gravity_m_s2)
            volumes.append({"place": place, "side": float(np.cbrt(volume))})
            continue
        limits.append(f"a constant force of {np.linalg.norm(force):.4g} N is left out")
    if volumes:
        density = (
            f"uniform_fluid_density {fluid.density_kg_m3:g} and a gravity of {fluid.gravity_m_s2:g} m/s2"
        )
        limits.append(f"buoyancy acts if the world has the system Buoyancy with {density}")
    return volumes, limits


def _propellers(source: ExportSource, centre: Array) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the propeller links of the thrusters, and sentences on the commands that they need."""
    names, laws = list(source.body.inputs), list(source.body.inputs.values())
    propellers, limits = [], []
    loads = zip(source.tables["load"], source.tables["load_input"], strict=True)
    for k, (row, number) in enumerate(loads):
        name, law, force = names[number], laws[number], row[3:6]
        gain = float(np.linalg.norm(force))
        if not gain or row[6:9].any():
            limits.append(f"the moment of the input {name} is left out")
            continue
        if row[COLUMNS["load"].index("world")]:
            limits.append(f"the force of the input {name} along the axes of the world is left out")
            continue
        if row[COLUMNS["load"].index("loss")]:
            limits.append(f"the thrust of {name}_{k} does not fall with the speed of advance")
        propellers.append({"name": f"{name}_{k}", "place": row[:3] - centre, "axis": force / gain})
        is_plain = law == type(law)(column=law.column, measured=law.measured)
        if not is_plain or abs(gain - 1.0) > 1e-5:
            words = f"{name}_{k} takes a force in N: {gain:.6g} times the column {law.column}"
            limits.append(words + " after the law of its actuator" * (not is_plain))
    return propellers, limits
