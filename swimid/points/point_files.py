"""Points file (``swimid-points/1``), linkage of a robot with its points, and columns of tracked points.

A robot file or a points file says which point sits where on which link. Without a robot, a points file names
a chain of points from front to rear.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import model_validator

from swimid.errors import InputError, UsageError, suggestion
from swimid.files import yamlio
from swimid.files.tabular import find_repeated
from swimid.kinematics.speed import mean_of_blocks
from swimid.logs.log import TIME
from swimid.logs.units import safe
from swimid.points.linkage import Array, Complex, Flags, Linkage
from swimid.points.scale import Camera, Positive, Scale
from swimid.robots import file as robot_format
from swimid.robots import planar
from swimid.robots.quantities import Polynomial

FORMAT: Literal["swimid-points/1"] = "swimid-points/1"


class PointScale(Scale):
    """Scale of a points file: that of a setup file, or a known distance between two tracked points."""

    #: Two tracked points at the distance ``distance_m``.
    between: tuple[str, str] | None = None
    #: Ratio of a length in the water to the apparent length that the camera sees through the refracting
    #: surface.
    refraction: Positive = 1.0

    @model_validator(mode="after")
    def _one_kind(self) -> PointScale:
        if self.between is None:
            data = self.model_dump(exclude={"between", "refraction"})
            Scale.model_validate({key: value for key, value in data.items() if value is not None})
        elif self.distance_m is None or self.points_px or self.points_m or self.metres_per_pixel:
            raise ValueError("'between' needs distance_m, and excludes every other scale")
        elif safe(self.between[0]) == safe(self.between[1]):
            raise ValueError(
                f"'between' names the point '{self.between[0]}' twice: name two different points"
            )
        return self


class PointsFile(yamlio.Document):
    """Content of a points file: positions of tracked points on a robot, or names of a chain of points."""

    format: Literal["swimid-points/1"] = FORMAT
    #: Place of each point, by the name that the tracker uses. It replaces the points of the robot file.
    points: dict[str, planar.TrackedPoint] = {}
    #: Points from front to rear of a body without a robot file.
    chain: list[str] = []
    #: Scale from pixels to metres; by default it is estimated from the lengths of the links.
    scale: PointScale | None = None
    camera: Camera | None = None
    #: Direction in the picture in which a robot in the vertical plane faces. x of the log increases in this
    #: direction.
    facing: Literal["right", "left"] = "right"
    #: Zero of the joint angles: given by the stated places of the points, or the mean of each angle in the
    #: film.
    zero: Literal["stated", "mean"] = "stated"

    @property
    def name(self) -> str:
        """Name of a points file in memory, by which the provenance of a result refers to it."""
        return "points"

    @model_validator(mode="after")
    def _consistent(self) -> PointsFile:
        names = [safe(name) for name in (self.chain or self.points)]
        twice = find_repeated(names)
        if twice is not None:
            raise ValueError(f"the point '{twice}' is listed twice")
        if self.chain and self.points:
            raise ValueError("give points (with a robot) or chain (without a robot), not both")
        if len(self.chain) == 1:
            raise ValueError(f"chain has only '{self.chain[0]}'; name two points or more, from front to rear")
        if self.camera is not None and self.scale is None:
            raise ValueError("'camera' is given without a scale: give 'scale', too")
        return self


def read_points(given: str | Path | PointsFile | Mapping[str, Any]) -> PointsFile:
    """Return the content of a points file, given its path, the content, or a dict with its keys.

    Raises
    ------
    InputError
        The content is invalid. The message names line and key.
    """
    if isinstance(given, PointsFile):
        return given
    if isinstance(given, str | Path):
        return yamlio.read_document(given, PointsFile)
    return yamlio.validate(dict(given), PointsFile, "points")


@dataclass(frozen=True)
class View:
    """Scale and calibration of a camera, and the plane of motion that it films."""

    scale: PointScale
    camera: Camera | None
    plane: str


# ---------------------------------------------------------------- linkage of a robot


def linkage_of(body: planar.MultilinkRobot, points: Mapping[str, planar.TrackedPoint], where: str) -> Linkage:
    """Return the linkage of a robot in a plane with tracked points.

    Links on rigid joints become a part of their parent. Coefficients have the values in the robot file.

    Raises
    ------
    InputError
        A point is on an unknown link, or the links are no tree. ``where`` names the file.
    """
    known = {link.name: link for link in body.links}
    _check_links(body, points, where)
    moving = [joint for joint in body.joints if joint.driven is not None or joint.passive is not None]
    columns = {joint.name: f"joint{k}_rad" for k, joint in enumerate(moving, 1)}
    values = {name: coefficient.value for name, coefficient in body.coefficients.items()}

    #: By the name of each link: index of the moving link to which it belongs, and its direction and front end
    #: in the axes of that moving link.
    frames: dict[str, tuple[int, complex, complex]] = {body.links[0].name: (0, 1 + 0j, 0j)}
    parent, joints, mounts, names, order = [-1], [0j], [0.0], [""], [body.links[0].name]
    for joint in _order_joints(body, where):
        up, way, front = frames[joint.parent]
        behind = known[joint.parent].length_m
        if joint.at_m is not None:
            behind = Polynomial.of(joint.at_m).at(values)
        at = front + way * complex(-behind, Polynomial.of(joint.offset_m).at(values))
        turn = math.radians(joint.mount_deg)
        if joint.name in columns:
            parent.append(up)
            joints.append(at)
            mounts.append(turn + float(np.angle(way)))
            names.append(columns[joint.name])
            order.append(joint.child)
            frames[joint.child] = (len(parent) - 1, 1 + 0j, 0j)
        else:
            frames[joint.child] = (up, way * np.exp(1j * turn), at)
    placed = [frames[place.link] for place in points.values()]
    pairs = zip(placed, points.values(), strict=True)
    spots = [front + way * complex(*place.at_m) for (_, way, front), place in pairs]
    reference = complex(-body.reference.station_m, body.reference.offset_m)
    rear = [complex(-known[name].length_m, 0.0) for name in order]
    return Linkage(
        tuple(safe(name) for name in points),
        np.array([link for link, _, _ in placed], dtype=np.intp),
        np.array(spots, dtype=complex),
        np.array(parent, dtype=np.intp),
        np.array(joints, dtype=complex),
        np.array(mounts),
        tuple(names[1:]),
        tuple(order),
        reference,
        np.array(rear, dtype=complex),
    )


def _check_links(body: planar.MultilinkRobot, points: Mapping[str, planar.TrackedPoint], where: str) -> None:
    """Raise an error for a point on an unknown link."""
    links = [link.name for link in body.links]
    for name, place in points.items():
        if place.link not in links:
            hint = suggestion(place.link, links, "the links are")
            text, key = f"the robot has no link '{place.link}'", f"points.{name}.link"
            if points is body.points:
                key = f"multilink.{key}"
            raise InputError(text, file=where, column=key, hint=hint)


def _order_joints(body: planar.MultilinkRobot, where: str) -> list[planar.PlanarJoint]:
    """Return the joints of a robot, each after the joint of its parent link."""
    reached, waiting, order = {body.links[0].name}, list(body.joints), []
    names = {link.name for link in body.links}
    while waiting:
        joint = next((joint for joint in waiting if joint.parent in reached and joint.child in names), None)
        if joint is None:
            text = f"no joints connect the link '{waiting[0].parent}' with the first link"
            raise InputError(text, file=where, column=f"multilink.joints.{waiting[0].name}")
        waiting.remove(joint)
        reached.add(joint.child)
        order.append(joint)
    return order


# ---------------------------------------------------------------- tracked points


@dataclass(frozen=True)
class Request:
    """Request for a pose from tracked points: robot, points file, and whether places are estimated."""

    robot: str | None
    points: Any
    calibrate: bool

    @property
    def inputs(self) -> list[Any]:
        """Files and data on which the result depends, for its provenance."""
        found: list[Any] = []
        if isinstance(self.points, str | Path):
            found.append(self.points)
        elif self.points is not None:
            found.append(read_points(self.points))
        if self.robot is not None:
            found.append(robot_format.locate(self.robot))
        return found

    def read(self) -> tuple[PointsFile, planar.MultilinkRobot | None, str, str]:
        """Return the points file, links and name of the robot, and the file that places the points.

        Raises
        ------
        InputError
            A file is invalid, or the robot does not move in a plane.
        UsageError
            Neither a robot nor a chain is given, or both are.
        """
        spec, where = PointsFile(), "points"
        if self.points is not None:
            spec = read_points(self.points)
        if isinstance(self.points, str | Path):
            where = str(self.points)
        if self.robot is None:
            if not spec.chain:
                text = "--points places points on a robot: name it with --robot"
                hint = "a body without a robot file is a chain, as in chain: [snout, mid, tail]"
                raise UsageError(text, hint=hint)
            if self.calibrate:
                raise UsageError("--calibrate-points needs a robot: a chain has no stated positions")
            return spec, None, "", where
        robot = robot_format.read(self.robot)
        path = robot_format.locate(self.robot)
        if robot.multilink is None:
            text = f"the robot '{robot.name}' has no 'multilink' part: points need a robot in a plane"
            raise InputError(text, file=path)
        if spec.chain:
            text = "a chain describes a body without a robot; with --robot give points"
            raise InputError(text, file=where, column="chain")
        if not spec.points:
            where = str(path)
            if not robot.multilink.points:
                text = f"the robot '{robot.name}' places no points"
                hint = "give the places with --points: points: {snout: {link: head, at_m: [0, 0]}}"
                raise InputError(text, file=path, column="multilink.points", hint=hint)
        return spec, robot.multilink, robot.name, where


def find_tracked_points(columns: Mapping[str, Array]) -> dict[str, tuple[str, str, str]]:
    """Return the columns of both coordinates of each tracked point, and their unit, by name of the point."""
    found = {}
    for name in columns:
        for unit in ("px", "m"):
            point = name.removesuffix(f"_x_{unit}")
            others = [f"{point}_{axis}_{unit}" for axis in "yz" if f"{point}_{axis}_{unit}" in columns]
            if point != name and others:
                found[point] = (name, others[0], unit)
    return found


def in_plane(columns: Mapping[str, Array], plane: str) -> Mapping[str, Array]:
    """Return the columns; leave out y of points that have x, y and z if the plane of motion is vertical."""
    if plane == "horizontal":
        return columns
    aside = [name for name in columns if name.endswith("_y_m") and f"{name[:-3]}z_m" in columns]
    return {name: values for name, values in columns.items() if name not in aside}


def keep_markers(columns: dict[str, Array]) -> None:
    """Keep only times and markers in the columns of a log of ``swimid track video``, in place.

    The pose of head and tail is left out. Pixels, which have y down in such a log, are turned to y up.
    """
    markers = find_tracked_points(columns)
    for name in list(columns):
        point = next((one for one in markers if name.startswith(f"{one}_")), None)
        if name != TIME and (point is None or not re.fullmatch(_OF_MARKER, name.removeprefix(f"{point}_"))):
            del columns[name]
        elif name.endswith("_y_px"):
            columns[name] = -columns[name]


#: Pattern of the part of a column name that follows the name of the marker.
_OF_MARKER = r"[xyz]_(px|m)|confidence"


def select_points(
    columns: Mapping[str, Array], names: list[str], optional: bool, where: tuple[str, str], path: Path
) -> tuple[list[str], str]:
    """Return the points that are tracked, in the order of ``names``, and their unit.

    ``where`` has the file that names the points, and the key in this file.

    Raises
    ------
    InputError
        A point is neither tracked nor optional, fewer than two points are tracked, or their units differ.
    """
    tracked = find_tracked_points(columns)
    if not tracked:
        hint = "columns of a tracked point are named snout_x_px, snout_y_px, snout_likelihood"
        raise InputError("has no tracked points", file=path, hint=hint)
    chosen = []
    for name in names:
        if safe(name) in tracked:
            chosen.append(name)
        elif not optional:
            hint = suggestion(safe(name), list(tracked), "the film has")
            text, (file, key) = f"the point '{name}' is not in {path.name}", where
            raise InputError(text, file=file, column=key.format(name), hint=hint)
    if len(chosen) < 2:
        text = f"{len(chosen)} of the points of the robot are tracked; at least 2 are needed"
        hint = f"the film has {', '.join(tracked)}; --points places points under other names"
        raise InputError(text, file=path, hint=hint)
    units = {tracked[safe(name)][2] for name in chosen}
    if len(units) > 1:
        text = "some points are in pixels, other points in metres"
        raise InputError(text, file=path, hint="export all points in one unit")
    return chosen, units.pop()


def point_coordinates(columns: Mapping[str, Array], name: str) -> Complex:
    """Return a tracked point as complex numbers x + iy, in its unit, shape (n,)."""
    x, y, _ = find_tracked_points(columns)[safe(name)]
    return np.asarray(columns[x] + 1j * columns[y])


def likelihood(columns: Mapping[str, Array], name: str) -> Array:
    """Return the likelihood, score or confidence of a tracked point, shape (n,); 1 if the log has none."""
    for word in ("likelihood", "score", "confidence"):
        values = columns.get(f"{safe(name)}_{word}")
        if values is not None:
            return np.where(np.isfinite(values) & (values > 0), values, 1.0)
    return np.ones(len(columns[TIME]))


def in_metres(
    seen: Complex, columns: Mapping[str, Array], view: View, where: str, path: Path
) -> tuple[Complex, tuple[float, float] | None]:
    """Return points in metres, converted from pixels with the stated scale.

    The second result is the scale in metres per pixel with its standard error, if the scale follows from two
    tracked points.
    """
    scale = view.scale
    if scale.between is None:
        from swimid.points.plane import plane_of

        width, height = 1, 1
        if view.camera is not None:
            width, height = (round(size) for size in view.camera.size_px)
        plane = plane_of(view, width, height, file=where)
        flat = seen.ravel()
        x, y = plane.to_world(flat.real, -flat.imag)
        world: Complex = np.empty(seen.shape, dtype=complex)
        world.real, world.imag = x.reshape(seen.shape), y.reshape(seen.shape)
        return scale.refraction * world, None
    chosen, _ = select_points(columns, list(scale.between), False, (where, "scale.between"), path)
    first, second = (point_coordinates(columns, name) for name in chosen)
    apart = np.abs(first - second)
    apart = apart[np.isfinite(apart)]
    if len(apart) < 2:
        names = " and ".join(chosen)
        raise InputError(f"fewer than 2 frames show both {names}", file=where, column="scale.between")
    middle = float(np.median(apart))
    spread = 1.4826 * float(np.median(np.abs(apart - middle)))
    good = apart[np.abs(apart - middle) <= 5 * spread]
    mean = mean_of_blocks(good, np.ones(len(good)))
    # Noise across the line between two points lengthens their distance.
    length = mean.value - float(np.var(good)) / (2 * middle)
    assert scale.distance_m is not None
    factor = scale.refraction * scale.distance_m / length
    return factor * seen, (factor, factor * (mean.high - mean.value) / 2.2 / length)


def start_scale(linkage: Linkage, seen: Complex, there: Flags) -> float:
    """Return a start value of the scale: length of a metre in the unit of the tracked points.

    Pairs of points of one link have their stated distance. Without such pairs the largest distances of other
    pairs are compared with those of the straight robot.
    """
    straight = linkage.shape(np.zeros((1, len(linkage.parent))))[2][0]
    ratios: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    for i, j in combinations(range(len(linkage.link)), 2):
        both, same = there[:, i] & there[:, j], bool(linkage.link[i] == linkage.link[j])
        stated = float(abs(straight[i] - straight[j]))
        if both.any() and stated > 0:
            part = {True: 0.5, False: 0.9}[same]
            seen_apart = float(np.quantile(np.abs(seen[both, i] - seen[both, j]), part))
            ratios[same].append((seen_apart / stated, stated))
    chosen = np.array(ratios[True] or ratios[False])
    order = np.argsort(chosen[:, 0])
    half = np.cumsum(chosen[order, 1]) / chosen[:, 1].sum()
    return float(chosen[order][np.searchsorted(half, 0.5), 0])
