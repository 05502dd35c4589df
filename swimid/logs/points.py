"""Pose and joint angles of a robot from tracked points (``swimid-points/1``, ``docs/import.md``).

A robot file or a points file says which point sits where on which link. Without a robot, a chain of points
from front to rear is a linkage of its own, whose lengths are estimated from the film. ``bundle`` computes the
estimate; this module reads the files, makes the columns of the log, and examines the stated distances.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import model_validator

from swimid.errors import InputError, UsageError, suggestion
from swimid.files import yamlio
from swimid.logs import bundle
from swimid.logs import linkage as links
from swimid.logs.bundle import Film, Fit
from swimid.logs.foreign import safe
from swimid.logs.linkage import Array, Complex, Flags, Linkage
from swimid.logs.log import TIME
from swimid.logs.sampling import usual_step
from swimid.logs.scale import Camera, Positive, Scale
from swimid.logs.tracks import mean_of_blocks
from swimid.notices import warn
from swimid.robots import file as robot_format
from swimid.robots import planar

FORMAT: Literal["swimid-points/1"] = "swimid-points/1"
#: Maximum standard deviation of an angle that is written to the log, rad. The exact 95 % interval of an angle
#: from a point on an arm is then within 5 % of the linear one.
MAX_ANGLE_SD = 0.25
#: Maximum bias of a distance or a place, in standard deviations of its scatter. With a larger bias a 95 %
#: interval covers less than 92 %.
MAX_BIAS = 0.5
#: Probability that a film with right distances is reported to have a wrong one.
WRONG_DISTANCE = 0.01
#: Maximum relative standard error of a scale that is estimated from the links of a robot.
MAX_SCALE_SE = 0.05
#: Hint of an error about a scale that the points do not determine.
SCALE_HINT = "state it in the points file: scale: {metres_per_pixel: 0.0005}"
#: Maximum number of frames that a message lists.
MAX_LISTED = 5


class PointScale(Scale):
    """Scale of a points file: that of a setup file, or a known distance between two tracked points."""

    #: Two tracked points at the distance ``distance_m``.
    between: tuple[str, str] | None = None
    #: Length in the water for a length that appears to the camera, because the surface refracts the light.
    refraction: Positive = 1.0

    @model_validator(mode="after")
    def _one_kind(self) -> PointScale:
        if self.between is None:
            data = self.model_dump(exclude={"between", "refraction"})
            Scale.model_validate({key: value for key, value in data.items() if value is not None})
        elif self.distance_m is None or self.points_px or self.points_m or self.metres_per_pixel:
            raise ValueError("between needs distance_m, and no other scale")
        elif safe(self.between[0]) == safe(self.between[1]):
            raise ValueError("the two points of between are the same")
        return self


class PointsFile(yamlio.Document):
    """Content of a points file, which says where tracked points sit on a robot, or name a chain of points."""

    format: Literal["swimid-points/1"] = FORMAT
    #: Place of each point, by the name that the tracker uses. It replaces the points of the robot file.
    points: dict[str, planar.Place] = {}
    #: Points from front to rear of a body without a robot file.
    chain: list[str] = []
    scale: PointScale | None = None
    camera: Camera | None = None
    #: Direction in the picture in which a robot in the vertical plane faces. x of the log increases in this
    #: direction.
    facing: Literal["right", "left"] = "right"

    @property
    def name(self) -> str:
        """Name of a points file in memory, by which the provenance of a result refers to it."""
        return "points"

    @model_validator(mode="after")
    def _consistent(self) -> PointsFile:
        names = [safe(name) for name in (self.chain or self.points)]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ValueError(f"the point '{twice[0]}' stands twice")
        if self.chain and self.points:
            raise ValueError("give points (with a robot) or chain (without one), not both")
        if len(self.chain) == 1:
            raise ValueError("a chain needs two points or more, from front to rear")
        if self.camera is not None and self.scale is None:
            raise ValueError("camera needs a scale")
        return self


def of(given: str | Path | PointsFile | Mapping[str, Any]) -> PointsFile:
    """Return the content of a points file, given its path, the content, or a dict with its keys.

    Raises
    ------
    InputError
        The content is invalid. The message names line and key.
    """
    if isinstance(given, PointsFile):
        return given
    if isinstance(given, str | Path):
        return yamlio.validated(given, PointsFile)
    return yamlio.validate(dict(given), PointsFile, "points")


@dataclass(frozen=True)
class View:
    """Scale and calibration of a camera, and the plane of motion that it films."""

    scale: PointScale
    camera: Camera | None
    plane: str


@dataclass
class Distance:
    """Distance of two points of one link: stated in a file, and measured in the film, in the unit of the log.

    For a chain ``stated`` is that of the first half of the film, and ``measured`` that of the second.
    ``wrong`` is whether the difference is significant and larger than :data:`MAX_BIAS` allows.
    """

    names: tuple[str, str]
    link: str
    stated: float
    measured: float
    stderr: float
    wrong: bool


@dataclass
class Posed:
    """Pose and joint angles of a film, with all findings.

    Attributes
    ----------
    fit : Fit
        Its linkage is in the unit of the log, and ``fit.linkage.scale`` is 1 if the scale is stated.
    stated : Linkage
        Linkage as the files state it.
    columns : dict of str to ndarray, each shape (n,)
        Pose, joint angles and their standard deviations.
    unit : str
        Unit of positions: ``m`` or ``px``.
    scale : (float, float) or None
        Metres per pixel and standard error, if it is estimated from points; None otherwise.
    scale_source : str
        Source of the scale, for messages.
    robot : str
        Name of the robot; empty for a chain.
    distances : list of Distance
    offsets : ndarray of complex, shape (points,)
        Mean residual of each point in the axes of its link, m.
    misplaced : list of str
        Points whose mean residual is significant and larger than :data:`MAX_BIAS` allows.
    empty : dict of str to int
        Number of frames in which a column is left empty, because the points do not determine it.
    time_s : ndarray, shape (n,)
        Sample times, s.
    """

    fit: Fit
    stated: Linkage
    columns: dict[str, Array]
    unit: str
    scale: tuple[float, float] | None
    scale_source: str
    robot: str
    distances: list[Distance]
    offsets: Complex
    misplaced: list[str]
    empty: dict[str, int]
    time_s: Array

    @property
    def noise_unit(self) -> str:
        """Unit in which the points were fitted, and in which their noise is given: ``m`` or ``px``."""
        return "px" if "scale" in self.fit.linkage.free else self.unit

    @property
    def metadata(self) -> dict[str, Any]:
        """Entries for the metadata of the log."""
        linkage = self.fit.linkage
        if not self.robot:
            return {"reference": linkage.names[0], "chain": list(linkage.names)}
        found: dict[str, Any] = {"robot": self.robot, "reference": self.robot}
        if self.scale is not None:
            found["metres_per_pixel"] = float(f"{self.scale[0]:.8g}")
        return found

    @property
    def data(self) -> dict[str, Any]:
        """Findings as plain data."""
        linkage, fit = self.fit.linkage, self.fit
        errors = np.sqrt(np.maximum(np.diag(linkage.covariance), 0.0))
        return {
            "unit": self.unit,
            "scale": None if self.scale is None else dict(zip(("value", "stderr"), self.scale, strict=True)),
            "scale_source": self.scale_source,
            f"noise_{self.noise_unit}": dict(zip(linkage.names, fit.noise.tolist(), strict=True)),
            "likelihood_exponent": fit.exponent,
            "left_out": [
                {"fault": f.kind, "points": list(f.names), "frames": self.frames[f.frames].tolist()}
                for f in fit.faults
            ],
            "level": fit.level,
            "empty": self.empty,
            "distances": [asdict(one) for one in self.distances],
            "misplaced": self.misplaced,
            "estimated": {
                name: {"value": float(value), "stderr": float(error)}
                for name, value, error in zip(linkage.quantities, linkage.values, errors, strict=True)
                if name != "scale"
            },
        }

    @property
    def frames(self) -> np.ndarray:
        """Frame number of each sample, from 0, shape (n,)."""
        return np.round(self.time_s / usual_step(self.time_s)).astype(int)

    def listed(self, rows: np.ndarray) -> str:
        """Return the numbers of the first frames of a list, as text."""
        text = ", ".join(str(frame) for frame in self.frames[rows[:MAX_LISTED]])
        more = f" and {len(rows) - MAX_LISTED} more" * (len(rows) > MAX_LISTED)
        return f"frame{'s' * (len(rows) > 1)} {text}{more}"

    @property
    def faults(self) -> list[tuple[str, str, int, str]]:
        """Kind, points, number of frames and first frames of each fault, the most frequent first."""
        found = sorted(self.fit.faults, key=lambda fault: -len(fault.frames))
        words = {"exchanged": " and ", "merged": " on "}
        return [
            (f.kind, words.get(f.kind, "").join(f.names), len(f.frames), self.listed(f.frames)) for f in found
        ]


# ---------------------------------------------------------------- linkage of a robot


def linkage_of(body: planar.Multilink, points: Mapping[str, planar.Place], where: str) -> Linkage:
    """Return the linkage of a robot in a plane with tracked points.

    Links on rigid joints become a part of their parent. The coefficients have the values of the file.

    Raises
    ------
    InputError
        A point is on an unknown link, or the links are no tree. ``where`` names the file.
    """
    known = {link.name: link for link in body.links}
    for name, place in points.items():
        if place.link not in known:
            hint = suggestion(place.link, list(known), "the links are")
            text, key = f"there is no link '{place.link}'", f"points.{name}.link"
            if points is body.points:
                key = f"multilink.{key}"
            raise InputError(text, file=where, column=key, hint=hint)
    moving = [joint for joint in body.joints if joint.driven is not None or joint.passive is not None]
    columns = {joint.name: f"joint{k}_rad" for k, joint in enumerate(moving, 1)}

    def value(quantity: float | str) -> float:
        number, names = planar.factors(quantity)
        return number * math.prod(body.coefficients[name].value for name in names)

    #: Index of the moving link of each link, its direction and its front end in the axes of that link.
    frames: dict[str, tuple[int, complex, complex]] = {body.links[0].name: (0, 1 + 0j, 0j)}
    parent, joints, mounts, names, order = [-1], [0j], [0.0], [""], [body.links[0].name]
    waiting = list(body.joints)
    while waiting:
        joint = next((one for one in waiting if one.parent in frames and one.child in known), None)
        if joint is None:
            text = "the joints connect no tree of links with the first link"
            raise InputError(text, file=where, column=f"multilink.joints.{waiting[0].name}")
        waiting.remove(joint)
        up, way, front = frames[joint.parent]
        behind = known[joint.parent].length_m if joint.at_m is None else value(joint.at_m)
        at = front + way * complex(-behind, value(joint.offset_m))
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
    spots = [
        front + way * complex(*place.at_m)
        for (_, way, front), place in zip(placed, points.values(), strict=True)
    ]
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


# ---------------------------------------------------------------- points of a film


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
            found.append(of(self.points))
        if self.robot is not None:
            found.append(robot_format.locate(self.robot))
        return found

    def read(self) -> tuple[PointsFile, planar.Multilink | None, str, str]:
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
            spec = of(self.points)
        if isinstance(self.points, str | Path):
            where = str(self.points)
        if self.robot is None:
            if not spec.chain:
                text = "--points places points on a robot: name it with --robot"
                hint = "a body without a robot file is a chain, as in chain: [snout, mid, tail]"
                raise UsageError(text, hint=hint)
            if self.calibrate:
                raise UsageError("--calibrate-points needs a robot: a chain has no stated places")
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
                hint = "say where they sit with --points: points: {snout: {link: head, at_m: [0, 0]}}"
                raise InputError(text, file=path, column="multilink.points", hint=hint)
        return spec, robot.multilink, robot.name, where


def _tracked(columns: Mapping[str, Array]) -> dict[str, tuple[str, str, str]]:
    """Return the columns of both coordinates of each tracked point, and their unit, by name of the point."""
    found = {}
    for name in columns:
        for unit in ("px", "m"):
            point = name.removesuffix(f"_x_{unit}")
            others = [f"{point}_{axis}_{unit}" for axis in "yz" if f"{point}_{axis}_{unit}" in columns]
            if point != name and others:
                found[point] = (name, others[0], unit)
    return found


def keep_markers(columns: dict[str, Array]) -> None:
    """Keep only times and markers in the columns of a log of ``swimid track video``, in place.

    The pose of head and tail is left out. Pixels, which have y down in such a log, are turned to y up.
    """
    markers = _tracked(columns)
    for name in list(columns):
        point = next((one for one in markers if name.startswith(f"{one}_")), None)
        if name != TIME and (point is None or not re.fullmatch(_OF_MARKER, name.removeprefix(f"{point}_"))):
            del columns[name]
        elif name.endswith("_y_px"):
            columns[name] = -columns[name]


#: Pattern of the rest of the name of a marker's column after the name of the marker.
_OF_MARKER = r"[xyz]_(px|m)|confidence"


def _chosen(
    columns: Mapping[str, Array], names: list[str], optional: bool, where: tuple[str, str], path: Path
) -> tuple[list[str], str]:
    """Return the points that are tracked, in the order of ``names``, and their unit.

    ``where`` has the file that names the points, and the key there.

    Raises
    ------
    InputError
        A point is not tracked and not optional, fewer than two are, or their units differ.
    """
    tracked = _tracked(columns)
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
        raise InputError("some of its points are in pixels and others in metres", file=path)
    return chosen, units.pop()


def _coordinates(columns: Mapping[str, Array], name: str) -> Complex:
    x, y, _ = _tracked(columns)[safe(name)]
    return np.asarray(columns[x] + 1j * columns[y])


def _likelihood(columns: Mapping[str, Array], name: str) -> Array:
    for word in ("likelihood", "score", "confidence"):
        values = columns.get(f"{safe(name)}_{word}")
        if values is not None:
            return np.where(np.isfinite(values) & (values > 0), values, 1.0)
    return np.ones(len(columns[TIME]))


def _in_metres(
    seen: Complex, columns: Mapping[str, Array], view: View, where: str, path: Path
) -> tuple[Complex, tuple[float, float] | None]:
    """Return points in metres for points in pixels with a stated scale.

    The second result is the scale in metres per pixel with its standard error, if two tracked points give it.
    """
    scale = view.scale
    if scale.between is None:
        from swimid.logs.plane import plane_of

        width, height = 1, 1
        if view.camera is not None:
            width, height = (round(size) for size in view.camera.size_px)
        plane = plane_of(view, width, height, file=where)
        flat = seen.ravel()
        x, y = plane.to_world(flat.real, -flat.imag)
        world: Complex = np.empty(seen.shape, dtype=complex)
        world.real, world.imag = x.reshape(seen.shape), y.reshape(seen.shape)
        return scale.refraction * world, None
    chosen, _ = _chosen(columns, list(scale.between), False, (where, "scale.between"), path)
    first, second = (_coordinates(columns, name) for name in chosen)
    apart = np.abs(first - second)
    apart = apart[np.isfinite(apart)]
    if len(apart) < 2:
        names = " and ".join(chosen)
        raise InputError(f"{names} are never tracked together", file=where, column="scale.between")
    middle = float(np.median(apart))
    spread = 1.4826 * float(np.median(np.abs(apart - middle)))
    good = apart[np.abs(apart - middle) <= 5 * spread]
    mean = mean_of_blocks(good, np.ones(len(good)))
    # Noise across the line between two points lengthens their distance.
    length = mean.value - float(np.var(good)) / (2 * middle)
    assert scale.distance_m is not None
    factor = scale.refraction * scale.distance_m / length
    return factor * seen, (factor, factor * (mean.high - mean.value) / 2.2 / length)


def _start_scale(linkage: Linkage, seen: Complex, there: Flags) -> float:
    """Return a start value of the scale: the unit of the tracked points for a metre.

    Pairs of points of one link have their stated distance. Without such pairs the largest distances of other
    pairs are compared with those of the straight robot.
    """
    straight = linkage.shape(np.zeros((1, len(linkage.parent))))[2][0]
    ratios: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    for i, j in combinations(range(len(linkage.link)), 2):
        both, same = there[:, i] & there[:, j], bool(linkage.link[i] == linkage.link[j])
        stated = float(abs(straight[i] - straight[j]))
        if both.any() and stated > 0:
            seen_apart = float(np.quantile(np.abs(seen[both, i] - seen[both, j]), 0.5 if same else 0.9))
            ratios[same].append((seen_apart / stated, stated))
    chosen = np.array(ratios[True] or ratios[False])
    order = np.argsort(chosen[:, 0])
    half = np.cumsum(chosen[order, 1]) / chosen[:, 1].sum()
    return float(chosen[order][np.searchsorted(half, 0.5), 0])


def pose_of(columns: dict[str, Array], request: Request, path: Path) -> Posed:
    """Compute pose and joint angles from the tracked points of a film.

    Parameters
    ----------
    columns : dict of str to ndarray, each shape (n,)
        Columns of the imported log, with the tracked points. Points that are left out become NaN in place.
    request : Request
    path : Path
        File of the tracked points, for messages.

    Raises
    ------
    InputError
        A file is invalid, a point is not tracked, or the film does not determine the scale.
    UsageError
        The request is contradictory.
    """
    try:
        return _pose_of(columns, request, path)
    except InputError as error:
        file = Path(error.file or "")
        if error.line is None and error.column and file.suffix.lower() in (".yaml", ".yml"):
            raise robot_format.located(error, file) from error
        raise


def _pose_of(columns: dict[str, Array], request: Request, path: Path) -> Posed:
    spec, body, robot, where = request.read()
    placed: Mapping[str, planar.Place] = spec.points
    if body is not None and not spec.points:
        placed = body.points
    place = (where, "points.{}")
    if spec.chain:
        place = (where, "chain")
    names, unit = _chosen(columns, spec.chain or list(placed), not (spec.chain or spec.points), place, path)
    plane = "horizontal"
    if body is not None:
        plane = body.plane
    if spec.facing == "left" and plane == "horizontal":
        raise InputError("facing: left goes with a robot in the vertical plane", file=where, column="facing")
    seen = np.column_stack([_coordinates(columns, name) for name in names])
    known_scale, source = None, "the file of the points is in metres"
    if spec.scale is not None:
        if unit == "m":
            raise InputError(
                "the points are in metres already: leave the scale out", file=where, column="scale"
            )
        view = View(spec.scale, spec.camera, plane)
        seen, known_scale = _in_metres(seen, columns, view, where, path)
        source = "stated"
        if known_scale is not None:
            source = f"from the distance of {' and '.join(spec.scale.between or ())}"
        unit = "m"
    if spec.facing == "left":
        seen = -seen.conj()
    there = np.isfinite(seen)
    if not (there.sum(axis=1) >= 2).any():
        raise InputError("no frame has two of the points", file=path, hint="--min-likelihood may be too high")
    film = Film(
        columns[TIME],
        np.where(there, seen, 0.0),
        there,
        np.column_stack([_likelihood(columns, name) for name in names]),
    )
    linkage, estimated = _linkage(film, body, names, placed, where, unit, request.calibrate)
    fit = bundle.fit(film, linkage)
    if estimated:
        error = math.sqrt(float(fit.linkage.covariance[0, 0]))
        if not error < MAX_SCALE_SE:
            text = f"the points do not determine the scale: its standard error is {100 * error:.2g} %"
            raise InputError(text, file=where, hint=SCALE_HINT)
        known_scale = (1.0 / fit.linkage.scale, error / fit.linkage.scale)
        source = "from the links of the robot"
        unit = "m"
    for k, name in enumerate(names):
        for column in _tracked(columns)[safe(name)][:2]:
            columns[column] = np.where(fit.used[:, k], columns[column], np.nan)
    made, empty = _columns(fit, unit, plane, known_scale)
    posed = Posed(
        fit,
        linkage,
        made,
        unit,
        known_scale,
        source,
        robot,
        *_examined(fit, linkage, bool(robot)),
        empty,
        columns[TIME],
    )
    _warn(posed, path)
    return posed


def _linkage(
    film: Film,
    body: planar.Multilink | None,
    names: list[str],
    placed: Mapping[str, planar.Place],
    where: str,
    unit: str,
    calibrate: bool,
) -> tuple[Linkage, bool]:
    """Return the linkage with start values, and whether its scale is estimated."""
    if body is None:
        pairs = np.abs(np.diff(film.seen, axis=1)).T
        both = film.there[:, 1:] & film.there[:, :-1]
        for k, name in enumerate(names[1:]):
            if not both[:, k].any():
                text = f"'{names[k]}' and '{name}' are never tracked together"
                raise InputError(text, file=where, column="chain")
        lengths = np.array([np.median(pair[both[:, k]]) for k, pair in enumerate(pairs)])
        return links.chain(tuple(safe(name) for name in names), lengths), False
    linkage = linkage_of(body, placed, where).part([safe(name) for name in names])
    estimated = unit == "px"
    free = {"scale"} if estimated else set()
    if estimated:
        if linkage.redundancy < 1:
            text = f"{len(names)} points with this number of joints do not determine the scale"
            raise InputError(text, file=where, hint=SCALE_HINT)
        linkage = replace(linkage, scale=_start_scale(linkage, film.seen, film.there))
    return replace(linkage, free=frozenset(free | ({"places"} if calibrate else set()))), estimated


def _columns(
    fit: Fit, unit: str, plane: str, stated: tuple[float, float] | None
) -> tuple[dict[str, Array], dict[str, int]]:
    """Return the columns of pose and joint angles, and the number of frames without each of them."""
    found, linkage = fit.residuals, fit.linkage
    variance = np.einsum("nii->ni", found.covariance).copy()
    place = fit.state.position / linkage.scale
    variance[:, :2] /= linkage.scale**2
    xy = np.column_stack([place.real, place.imag])
    if "scale" in linkage.free:
        # An error of the scale moves positions in proportion to their distance from the origin.
        cross = found.cross[:, :2, 0] / linkage.scale
        variance[:, :2] += xy**2 * linkage.covariance[0, 0] - 2.0 * xy * cross
    elif stated is not None:
        variance[:, :2] += (xy * stated[1] / stated[0]) ** 2
    sd = np.sqrt(np.maximum(variance, 0.0))
    limit = np.full(sd.shape[1], MAX_ANGLE_SD)
    limit[:2] *= linkage.scale * linkage.size
    # An unknown place of a point shifts the zero of an angle in all frames. It leaves none of them empty.
    sharp = np.sqrt(np.maximum(found.alone, 0.0)) < limit
    known: Flags = np.array(found.known & fit.used.any(axis=1, keepdims=True) & sharp)
    known[:, 0] = known[:, 1] = known[:, 0] & known[:, 1]
    angles = (fit.state.angles + np.pi) % (2 * np.pi) - np.pi
    yaw = known[:, 2]
    angles[yaw, 0] = np.unwrap(angles[yaw, 0])
    up, heading = {"horizontal": ("y", "yaw"), "vertical": ("z", "pitch")}[plane]
    names = [f"x_{unit}", f"{up}_{unit}", f"{heading}_rad", *linkage.columns]
    values = np.column_stack([xy, angles])
    order = [0, 1, 2, *sorted(range(3, len(names)), key=lambda k: int(names[k][5:-4]))]
    made = {names[k]: np.where(known[:, k], values[:, k], np.nan) for k in order}
    for k in order:
        stem, _, ending = names[k].rpartition("_")
        made[f"{stem}_sd_{ending}"] = np.where(known[:, k], sd[:, k], np.nan)
    empty = {names[k]: int((~known[:, k]).sum()) for k in order}
    for name in [name for name, count in empty.items() if count == len(place)]:
        stem, _, ending = name.rpartition("_")
        del made[name], made[f"{stem}_sd_{ending}"]
    return made, empty


# ---------------------------------------------------------------- stated distances and places


def _biased(values: Array, level: float, error: float = 0.0) -> tuple[float, float, bool]:
    """Return mean and standard error of values in time, and whether the mean is significant and large."""
    from scipy.special import stdtrit

    mean = mean_of_blocks(values, np.ones(len(values)))
    stderr = math.hypot((mean.high - mean.value) / float(stdtrit(11, 0.975)), error)
    scatter = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    large = abs(mean.value) > max(MAX_BIAS * scatter, float(stdtrit(11, 1 - level / 2)) * stderr)
    return mean.value, stderr, large


def _examined(fit: Fit, stated: Linkage, robot: bool) -> tuple[list[Distance], Complex, list[str]]:
    """Return the distances of points of one link, the mean residuals, and the misplaced points."""
    linkage, seen_at = fit.linkage, links.predicted(fit.linkage, fit.state) + fit.residuals.value
    of, relative, distances = stated.link, 0.0, []
    pairs = [(i, j) for i, j in combinations(range(len(of)), 2) if of[i] == of[j]]
    if not robot:
        pairs = [(k, k + 1) for k in range(len(of) - 1)]
    if "scale" in linkage.free:
        relative = math.sqrt(float(linkage.covariance[0, 0]))
    for i, j in pairs:
        apart = np.abs(seen_at[:, i] - seen_at[:, j])[fit.used[:, i] & fit.used[:, j]] / linkage.scale
        if len(apart) < MIN_FRAMES:
            continue
        given, half = float(abs(stated.place[i] - stated.place[j])), len(apart) // 2
        # Noise across the line between two points lengthens their distance.
        longer = float(np.var(apart)) / (2.0 * max(given, float(np.median(apart)), 1e-12))
        if not robot:
            given, apart, longer = float(apart[:half].mean()), apart[half:], 0.0
        off, error, wrong = _biased(apart - longer - given, WRONG_DISTANCE / len(pairs), relative * given)
        names, link = (linkage.names[i], linkage.names[j]), linkage.links[of[max(i, j)]]
        distances.append(Distance(names, link, given, given + off, error, wrong))
    axes = linkage.shape(fit.state.angles)[0]
    turned = fit.residuals.value * np.conj(axes[:, linkage.link]) / linkage.scale
    offsets, misplaced = np.zeros(len(stated.link), dtype=complex), []
    for k, name in enumerate(linkage.names):
        values = turned[fit.used[:, k], k]
        if len(values) < MIN_FRAMES:
            continue
        level = WRONG_DISTANCE / (2 * len(stated.link))
        (x, _, wrong_x), (y, _, wrong_y) = (_biased(part, level) for part in (values.real, values.imag))
        offsets[k] = complex(x, y)
        if robot and (wrong_x or wrong_y):
            misplaced.append(name)
    return distances, offsets, misplaced


#: Minimum number of frames from which a distance or a mean residual is judged.
MIN_FRAMES = 24


#: Text of the warning of each kind of fault.
LEFT_OUT = {
    "exchanged": "labels exchanged",
    "merged": "two labels on one place",
    "stray": "labels astray",
    "lost": "frames in which no more than half of the points agree",
}


def _warn(posed: Posed, path: Path) -> None:
    """Warn of points that were left out, and of wrong distances and places."""
    for kind, word in LEFT_OUT.items():
        found = [(names, count, frames) for of, names, count, frames in posed.faults if of == kind]
        if not found:
            continue
        parts = [f"{names} {count} times ({frames})".strip() for names, count, frames in found[:MAX_LISTED]]
        if len(found) > MAX_LISTED:
            parts.append(f"and {len(found) - MAX_LISTED} more")
        total = sum(count for _, count, _ in found)
        warn("SWM120", f"{path.name}: {total} {word}, left out: {'; '.join(parts)}")
    for one in posed.distances:
        if one.wrong:
            text = f"{' and '.join(one.names)} are {one.measured:.4g} ± {one.stderr:.1g} {posed.unit} apart"
            given = f"{one.stated:.4g} {posed.unit}"
            if posed.robot:
                warn("SWM121", f"{path.name}: {text}; on {one.link} {given} is stated")
            else:
                text += f" in the second half of the film, and {given} in the first: no rigid link"
                warn("SWM121", f"{path.name}: {text}")
    for name in posed.misplaced:
        at = 1e3 * posed.offsets[posed.fit.linkage.names.index(name)]
        text = f"'{name}' lies {at.real:+.3g} mm forward and {at.imag:+.3g} mm to port of its place"
        warn("SWM121", f"{path.name}: {text}")
