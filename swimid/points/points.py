"""Pose and joint angles of a robot from tracked points (``docs/points.md``).

``point_files`` reads the files and the columns, and ``bundle`` computes the estimate. This module makes the
columns of the log, and examines stated distances and places. A chain of points without a robot is a linkage
whose lengths are estimated from the film.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.kinematics import wave
from swimid.kinematics.jumps import OUTLYING
from swimid.kinematics.speed import mean_of_blocks
from swimid.kinematics.wave import Swing
from swimid.logs.log import TIME
from swimid.logs.sampling import usual_step
from swimid.logs.units import safe
from swimid.notices import warn
from swimid.points import bundle
from swimid.points import linkage as links
from swimid.points import point_files as files
from swimid.points.bundle import FilmFit
from swimid.points.film import Film
from swimid.points.linkage import Array, Complex, Flags, Linkage
from swimid.robots import file as robot_format
from swimid.robots import planar

#: Maximum standard deviation of an angle that is written to the log, rad. The exact 95 % interval of an angle
#: from a point on an arm is then within 5 % of the linear one.
MAX_ANGLE_SD = 0.25
#: Maximum standard deviation of a value that is written to the log, relative to the median of its column.
#: Other commands weigh all samples alike, and a value with a larger error would act as an outlier.
MAX_SD_RATIO = OUTLYING
#: Maximum bias of a distance or a place of a point, in standard deviations of its noise. With a larger bias,
#: a 95 % interval contains the true value with a probability of less than 92 %.
MAX_BIAS = 0.5
#: Probability of a false alarm: a film whose stated distances are all right is reported to have a wrong one.
WRONG_DISTANCE = 0.01
#: Maximum relative standard error of a scale that is estimated from the links of a robot.
MAX_SCALE_SE = 0.05
#: Hint in the error message for a scale that the points do not determine.
SCALE_HINT = "state a scale in the points file: scale: {metres_per_pixel: 0.0005}"
#: Maximum number of frames that a message lists.
MAX_LISTED = 5


@dataclass
class Distance:
    """Distance of two points of one link: stated in a file, and measured in the film, in the unit of the log.

    For a chain, ``stated`` is the distance in the first half of the film, and ``measured`` that in the second
    half. ``wrong`` is whether the difference is significant and larger than :data:`MAX_BIAS` allows.
    """

    names: tuple[str, str]
    link: str
    stated: float
    measured: float
    stderr: float
    wrong: bool


@dataclass
class Posed:
    """Pose and joint angles from a film of tracked points, with the results of all checks.

    Attributes
    ----------
    fit : FilmFit
        Estimate of the film. The linkage is in the unit of the log, and ``fit.linkage.scale`` is 1 if the
        scale is stated.
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
    perspective : float
        Relative change of the distances on rigid links along the path; 0 if it is not significant.
    empty : dict of str to int
        Number of frames in which a column is left empty, because the points do not determine it.
    time_s : ndarray, shape (n,)
        Sample times, s.
    zero : str
        Zero of the joint angles: ``stated`` or ``mean``.
    swings : dict of str to Swing
        Mean and amplitude of each joint angle that swings periodically, before the mean is subtracted.
    """

    fit: FilmFit
    stated: Linkage
    columns: dict[str, Array]
    unit: str
    scale: tuple[float, float] | None
    scale_source: str
    robot: str
    distances: list[Distance]
    offsets: Complex
    misplaced: list[str]
    perspective: float
    empty: dict[str, int]
    time_s: Array
    zero: str = "stated"
    swings: dict[str, Swing] = field(default_factory=dict)

    def centre(self, columns: dict[str, Array], frequency_hz: float | None) -> None:
        """Measure the swing of each joint angle; if ``zero`` is ``mean``, subtract its mean in place.

        Parameters
        ----------
        columns : dict of str to ndarray, each shape (n,)
            Columns of the log.
        frequency_hz : float or None
            Stroke frequency. Without it, the frequency of the sine that fits an angle best is taken.
        """
        for name in self.fit.linkage.columns:
            if name not in columns:
                continue
            angle = columns[name]
            swing = wave.measure_swing(self.time_s, angle, frequency_hz)
            mean = float(np.nanmean(angle))
            if swing is not None:
                self.swings[name], mean = swing, swing.mean
            elif self.zero == "mean":
                text = "zero: mean subtracts the mean of all samples, because fewer than two cycles are found"
                warn("SWM179", f"{name}: {text}")
            if self.zero == "mean":
                columns[name] = angle - mean

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
        if self.zero == "mean":
            found["joint_zero"] = "mean"
        return found

    @property
    def data(self) -> dict[str, Any]:
        """Results of the checks as plain data."""
        linkage, fit = self.fit.linkage, self.fit
        errors, scale = np.sqrt(np.maximum(np.diag(linkage.covariance), 0.0)), None
        if self.scale is not None:
            scale = dict(zip(("value", "stderr"), self.scale, strict=True))
        return {
            "unit": self.unit,
            "swings": {name: one.data for name, one in self.swings.items()},
            "scale": scale,
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
            "mirrored": self.fit.mirrored,
            "perspective": self.perspective,
            "undetermined": self.free_coordinates,
            "estimated": {
                name: {"value": float(value), "stderr": float(error)}
                for name, value, error in zip(linkage.quantities, linkage.values, errors, strict=True)
                if name != "scale"
            },
        }

    @property
    def free_coordinates(self) -> dict[str, str]:
        """Coordinates of the places that the film does not determine, such as ``x`` or ``x, y``, by point.

        A coordinate is listed if its component of the undetermined directions is at least half of the largest
        component.
        """
        names, axes = self.fit.linkage.names, self.fit.undetermined
        shares = np.sum(axes**2, axis=1).reshape(2, -1)
        if not axes.size:
            return {}
        found = {}
        for name, share in zip(names, shares.T, strict=True):
            words = [word for word, part in zip("xy", share, strict=True) if part >= 0.25 * shares.max()]
            if words:
                found[name] = ", ".join(words)
        return found

    @property
    def free_coordinates_text(self) -> str:
        """Coordinates that the film does not determine, as text; empty if there are none."""
        return ", ".join(f"{name} ({words})" for name, words in self.free_coordinates.items())

    @property
    def perspective_text(self) -> str:
        """Sentence on distances on rigid links that change along the path."""
        return (
            f"the distances on a link change by {100 * self.perspective:.2g} % along the path: the camera is "
            "tilted, the lens distorts, or the pixels are not square. Give scale as four points_px with "
            "points_m, or camera"
        )

    @property
    def frames(self) -> np.ndarray:
        """Frame number of each sample, from 0, shape (n,)."""
        return np.round(self.time_s / usual_step(self.time_s)).astype(int)

    def list_frames(self, rows: np.ndarray) -> str:
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
            (f.kind, words.get(f.kind, "").join(f.names), len(f.frames), self.list_frames(f.frames))
            for f in found
        ]


# ---------------------------------------------------------------- points of a film


def pose_of(columns: dict[str, Array], request: files.Request, path: Path) -> Posed:
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
            raise robot_format.add_location(error, file) from error
        raise


def _pose_of(columns: dict[str, Array], request: files.Request, path: Path) -> Posed:
    spec, body, robot, where = request.read()
    placed: Mapping[str, planar.TrackedPoint] = spec.points
    plane = "horizontal"
    if body is not None:
        placed, plane = spec.points or body.points, body.plane
    names, unit = _select_points(columns, spec, placed, where, path)
    if spec.facing == "left" and plane == "horizontal":
        text = "'facing: left' is valid only for a robot in the vertical plane: omit it"
        raise InputError(text, file=where, column="facing")
    shown = files.in_plane(columns, plane)
    seen = np.column_stack([files.point_coordinates(shown, name) for name in names])
    known_scale, source = None, "the file of the points is in metres"
    if spec.scale is not None:
        if unit == "m":
            text = "the points are in metres: omit the scale"
            raise InputError(text, file=where, column="scale")
        view = files.View(spec.scale, spec.camera, plane)
        seen, known_scale = files.in_metres(seen, shown, view, where, path)
        unit, source = "m", "stated"
        if known_scale is not None:
            source = f"from the distance of {' and '.join(spec.scale.between or ())}"
    if spec.facing == "left":
        seen = -seen.conj()
    there = np.isfinite(seen)
    if not (there.sum(axis=1) >= 2).any():
        raise InputError("no frame shows two points", file=path, hint="--min-likelihood may be too high")
    likelihood = np.column_stack([files.likelihood(columns, name) for name in names])
    film = Film(columns[TIME], np.where(there, seen, 0.0), there, likelihood)
    linkage, estimated = _linkage(film, body, names, placed, where, unit, request.calibrate)
    fit = bundle.fit_film(film, linkage)
    if estimated:
        known_scale = _invert_scale(fit.linkage, where)
        unit, source = "m", "from the links of the robot"
    tracked = files.find_tracked_points(shown)
    _remove_faults(columns, [tracked[safe(name)] for name in names], fit)
    made, empty = _columns(fit, unit, plane, known_scale, relative=spec.zero == "mean")
    examined, time_s = _examine_points(fit, linkage, bool(robot)), columns[TIME]
    posed = Posed(fit, linkage, made, unit, known_scale, source, robot, *examined, empty, time_s, spec.zero)
    _warn(posed, path)
    return posed


def _select_points(
    columns: Mapping[str, Array],
    spec: files.PointsFile,
    placed: Mapping[str, planar.TrackedPoint],
    where: str,
    path: Path,
) -> tuple[list[str], str]:
    """Return the tracked points that the files name, and their unit."""
    place = (where, "points.{}")
    if spec.chain:
        place = (where, "chain")
    return files.select_points(
        columns, spec.chain or list(placed), not (spec.chain or spec.points), place, path
    )


def _invert_scale(linkage: Linkage, where: str) -> tuple[float, float]:
    """Return the estimated scale in metres per unit of the tracked points, with its standard error."""
    error = math.sqrt(float(linkage.covariance[0, 0]))
    if not error < MAX_SCALE_SE:
        text = f"the points do not determine the scale, whose standard error is {100 * error:.2g} %"
        raise InputError(text, file=where, hint=SCALE_HINT)
    return 1.0 / linkage.scale, error / linkage.scale


def _remove_faults(columns: dict[str, Array], tracked: list[tuple[str, str, str]], fit: FilmFit) -> None:
    """Correct exchanged labels in the columns of a log, and set points that were left out to NaN."""
    for axis in range(2):
        pair = [names[axis] for names in tracked]
        values = np.take_along_axis(np.column_stack([columns[name] for name in pair]), fit.order, axis=1)
        columns.update(zip(pair, np.where(fit.used, values, np.nan).T, strict=True))


def _linkage(
    film: Film,
    body: planar.MultilinkRobot | None,
    names: list[str],
    placed: Mapping[str, planar.TrackedPoint],
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
                text = f"no frame shows both '{names[k]}' and '{name}'"
                raise InputError(text, file=where, column="chain")
        lengths = np.array([np.median(pair[both[:, k]]) for k, pair in enumerate(pairs)])
        return links.chain(tuple(safe(name) for name in names), lengths), False
    linkage = files.linkage_of(body, placed, where).part([safe(name) for name in names])
    estimated = unit == "px"
    free = {"places"} if calibrate else set()
    if estimated:
        free.add("scale")
        if linkage.redundancy < 1:
            text = f"{len(names)} points with this number of joints do not determine the scale"
            raise InputError(text, file=where, hint=SCALE_HINT)
        linkage = replace(linkage, scale=files.start_scale(linkage, film.seen, film.there))
    return replace(linkage, free=frozenset(free)), estimated


def _columns(
    fit: FilmFit, unit: str, plane: str, stated: tuple[float, float] | None, *, relative: bool
) -> tuple[dict[str, Array], dict[str, int]]:
    """Return the columns of pose and joint angles, and the number of empty frames in each column.

    If the joint angles are ``relative`` to their means, unknown places of points add no error to them.
    """
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
    if relative:
        variance[:, 3:] = found.alone[:, 3:]
    sd = np.sqrt(np.maximum(variance, 0.0))
    limit = np.full(sd.shape[1], MAX_ANGLE_SD)
    limit[:2] *= linkage.scale * linkage.size
    # An unknown position of a point shifts the zero of an angle in all frames, but leaves no frame empty.
    sharp = np.sqrt(np.maximum(found.alone, 0.0)) < limit
    known: Flags = np.array(found.known & fit.used.any(axis=1, keepdims=True) & sharp & ~fit.ambiguous)
    for k in np.flatnonzero(known.any(axis=0)).tolist():
        known[:, k] &= sd[:, k] <= MAX_SD_RATIO * np.median(sd[known[:, k], k])
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


def _test_mean(values: Array, level: float, error: float = 0.0) -> tuple[float, float, bool]:
    """Return mean and standard error of values in time, and whether the mean is significant and large."""
    from scipy.special import stdtrit

    mean = mean_of_blocks(values, np.ones(len(values)))
    stderr = math.hypot((mean.high - mean.value) / float(stdtrit(11, 0.975)), error)
    scatter = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    large = abs(mean.value) > max(MAX_BIAS * scatter, float(stdtrit(11, 1 - level / 2)) * stderr)
    return mean.value, stderr, large


def _examine_points(
    fit: FilmFit, stated: Linkage, robot: bool
) -> tuple[list[Distance], Complex, list[str], float]:
    """Return distances of points of one link, mean residuals, misplaced points, and perspective."""
    linkage, seen_at = fit.linkage, links.predict_points(fit.linkage, fit.state) + fit.residuals.value
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
        off, error, wrong = _test_mean(apart - longer - given, WRONG_DISTANCE / len(pairs), relative * given)
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
        (x, _, wrong_x), (y, _, wrong_y) = (_test_mean(part, level) for part in (values.real, values.imag))
        offsets[k] = complex(x, y)
        if robot and (wrong_x or wrong_y):
            misplaced.append(name)
    return distances, offsets, misplaced, _perspective(seen_at, fit.used, pairs)


def _perspective(seen: Complex, used: Flags, pairs: list[tuple[int, int]]) -> float:
    """Return the relative change of distances on rigid links along the path; 0 if it is not significant.

    A linear function of the position in the picture is fitted to the relative distances. If the direction of
    the links turns by more than 60 degrees, the function also depends on this direction, because pixels may
    not be square. The function is significant if it reduces the sum of squares in held-out blocks of frames
    by at least three standard errors.
    """
    parts = []
    for i, j in pairs:
        # labels on one place have no direction
        rows = np.flatnonzero(used[:, i] & used[:, j] & (seen[:, i] != seen[:, j]))
        if len(rows) < MIN_FRAMES:
            continue
        line, middle = seen[rows, i] - seen[rows, j], 0.5 * (seen[rows, i] + seen[rows, j])
        apart = np.abs(line) / np.median(np.abs(line)) - 1.0
        turn = (line / np.abs(line)) ** 2 * (np.ptp(np.unwrap(np.angle(line))) > math.radians(60.0))
        columns = np.column_stack([middle.real, middle.imag, turn.real, turn.imag, apart])
        columns = (columns - columns.mean(axis=0)) / max(float(apart.std()), 1e-12)
        parts.append(np.column_stack([columns, rows * BLOCKS // len(used), np.full(len(rows), apart.std())]))
    if not parts:
        return 0.0
    table = np.concatenate(parts)
    design, apart, block = table[:, :4], table[:, 4], table[:, 5]
    gains = []
    for one in np.unique(block):
        own = block == one
        slope = np.linalg.lstsq(design[~own], apart[~own])[0]
        gains.append(np.sum(apart[own] ** 2 - (apart[own] - design[own] @ slope) ** 2))
    if len(gains) < 3 or np.mean(gains) < 3.0 * np.std(gains, ddof=1) / math.sqrt(len(gains)):
        return 0.0
    slope = np.linalg.lstsq(design, apart)[0]
    return float(np.ptp(design @ slope * table[:, 6]))


#: BLOCKS is the number of blocks of frames in the test for perspective. MAX_PERSPECTIVE is the maximum
#: relative change of distances along the path; films with markers have the same limit.
BLOCKS, MAX_PERSPECTIVE = 12, 0.02
#: Minimum number of frames from which a distance or a mean residual is judged.
MIN_FRAMES = 24


#: Text of the warning of each kind of fault.
LEFT_OUT = {
    "exchanged": "exchanged labels, corrected",
    "merged": "two labels at one position, left out",
    "stray": "labels far from their points, left out",
    "lost": "frames in which half of the points or fewer agree, left out",
}


def _warn(posed: Posed, path: Path) -> None:
    """Warn of points that were left out, and of places and distances that are wrong or not determined."""
    for kind, word in LEFT_OUT.items():
        found = [(names, count, frames) for of, names, count, frames in posed.faults if of == kind]
        if not found:
            continue
        parts = [f"{names} {count} × ({frames})".strip() for names, count, frames in found[:MAX_LISTED]]
        if len(found) > MAX_LISTED:
            parts.append(f"and {len(found) - MAX_LISTED} more")
        total = sum(count for _, count, _ in found)
        warn("SWM120", f"{path.name}: {word} {total} ×: {'; '.join(parts)}")
    if posed.fit.mirrored:
        text = "the picture is mirrored: its mirror image fits the points on the robot better. Export pixels"
        warn("SWM121", f"{path.name}: {text} with y downwards, or give scale as four points_px with points_m")
    if posed.perspective > MAX_PERSPECTIVE:
        warn("SWM042", f"{path.name}: {posed.perspective_text}")
    if posed.free_coordinates:
        names = posed.free_coordinates_text
        text = f"the film does not determine these coordinates of points on the robot: {names}"
        warn("SWM121", f"{path.name}: {text}: bend the joints more, or track two points on a link")
    for one in posed.distances:
        if one.wrong:
            text = f"{' and '.join(one.names)} are {one.measured:.4g} ± {one.stderr:.1g} {posed.unit} apart"
            given = f"{one.stated:.4g} {posed.unit}"
            if posed.robot:
                warn("SWM121", f"{path.name}: {text}; the robot file states {given} on {one.link}")
            else:
                text += f" in its second half and {given} in its first half: they are on no rigid link"
                warn("SWM121", f"{path.name}: {text}")
    for name in posed.misplaced * (not posed.fit.mirrored):
        at = 1e3 * posed.offsets[posed.fit.linkage.names.index(name)]
        text = f"'{name}' lies {at.real:+.3g} mm forward and {at.imag:+.3g} mm to port of its stated position"
        warn("SWM121", f"{path.name}: {text}")
