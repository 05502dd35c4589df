"""Where the links of a planar robot are, from its pose and joint angles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from swimid.fitting.model import Array

if TYPE_CHECKING:
    from swimid.swimmer.planar.model import MultilinkModel


def link_frames(
    model: MultilinkModel, values: Array, columns: Mapping[str, Array]
) -> tuple[Array, Array, Array]:
    """Front end and heading of every link in the plane of motion.

    Parameters
    ----------
    model : MultilinkModel
    values : ndarray, shape (len(model.parameters),)
    columns : mapping of str to ndarray, each shape (n,)
        Joint angles and, of a free robot, the pose of its reference point, as
        :meth:`MultilinkModel.simulate` gives them.

    Returns
    -------
    x, y, heading : ndarray, shape (links, n)
        m and rad; links in the order of ``model.assembly.links``.
    """
    assembly = model.assembly
    tables = assembly.tables(values[: len(assembly.names)])
    topology, joint = tables["topology"], tables["joint"]
    count, n = len(assembly.links), len(next(iter(columns.values())))
    x, y, heading = np.zeros((count, n)), np.zeros((count, n)), np.zeros((count, n))
    body = model.robot.multilink
    assert body is not None
    if assembly.free_base:
        heading[0] = columns[model.plane.pose[2]]
        a, b = -body.reference.station_m, body.reference.offset_m
        x[0] = columns[model.plane.pose[0]] - a * np.cos(heading[0]) + b * np.sin(heading[0])
        y[0] = columns[model.plane.pose[1]] - a * np.sin(heading[0]) - b * np.cos(heading[0])
    else:
        heading[0] = np.radians(body.heading_deg)
    angles: dict[int, Array] = {a.link: columns[a.column] for a in (*assembly.driven, *assembly.passive)}
    for i in range(1, count):
        parent = int(topology[i, 0])
        c, s = np.cos(heading[parent]), np.sin(heading[parent])
        x[i] = x[parent] + c * joint[i, 0] - s * joint[i, 1]
        y[i] = y[parent] + s * joint[i, 0] + c * joint[i, 1]
        mount = np.arctan2(joint[i, 3], joint[i, 2])
        heading[i] = heading[parent] + mount + angles.get(i, np.zeros(n))
    return x, y, heading


def rear_ends(model: MultilinkModel, frames: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Rear end of every link.

    Parameters
    ----------
    frames : tuple of ndarray, each shape (links, n)
        As :func:`link_frames` gives them.

    Returns
    -------
    x, y : ndarray, shape (links, n)
    """
    x, y, heading = frames
    length = np.array([[link.length_m] for link in model.assembly.links])
    return x - length * np.cos(heading), y - length * np.sin(heading)


def straight(model: MultilinkModel, values: Array) -> tuple[Array, Array]:
    """Distance of every link's front and rear end from the first link's front end, all joints straight.

    Returns
    -------
    front, rear : ndarray, shape (links,), m
    """
    columns = {a.column: np.zeros(1) for a in (*model.assembly.driven, *model.assembly.passive)}
    if model.assembly.free_base:
        columns |= {name: np.zeros(1) for name in model.plane.pose}
    columns = columns or {"": np.zeros(1)}
    frames = link_frames(model, values, columns)
    x, y = rear_ends(model, frames)
    x0, y0 = frames[0][0], frames[1][0]
    return (
        np.hypot(frames[0] - x0, frames[1] - y0)[:, 0],
        np.hypot(x - x0, y - y0)[:, 0],
    )


def body_length(model: MultilinkModel, values: Array) -> float:
    """Length of the robot, m: its file's, or from the front end to the farthest link's rear end."""
    given = model.robot.body.length_m
    return given if given is not None else float(straight(model, values)[1].max())
