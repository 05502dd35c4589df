"""What effects ask of a model and its trials: typical sizes, and changes that several of them make."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from swimid.fitting.model import Array, Model, Trial
from swimid.propulsion.model import RecoilModel
from swimid.rig.model import COORDINATES, RigModel
from swimid.swimmer.planar import engine
from swimid.swimmer.planar.model import MultilinkModel
from swimid.swimmer.polynomial import Polynomial

#: Columns that hold a position.
POSITIONS = ("x_m", "y_m", "z_m")
#: Stretches into which a track is cut to find its speed, so that noise does not lengthen it.
STRETCHES = 12


def start(model: Model, *names: str) -> float:
    """Start value of the first of these parameters that the model has; 0 where it has none."""
    found = {p.name: p.start for p in model.parameters}
    return next((found[name] for name in names if name in found), 0.0)


def estimated(model: Model, *names: str) -> bool:
    """Whether one of these parameters is free: an effect of the same form is then no effect."""
    return any(p.name in names and p.free for p in model.parameters)


def rotates(model: Model) -> bool:
    """Whether a rig's coordinate is an angle."""
    return isinstance(model, RigModel) and COORDINATES[model.coordinate][2]


def swims_freely(model: Model) -> bool:
    """Whether it is a multi-link robot whose base moves."""
    return isinstance(model, MultilinkModel) and model.assembly.free_base


def vertical(model: Model) -> bool:
    """Whether it is a multi-link robot in the vertical plane."""
    return isinstance(model, MultilinkModel) and "z_m" in model.plane.pose


def axes(model: Model) -> tuple[str, ...]:
    """Axes of the world in which it moves from place to place; one where the model has one coordinate."""
    if isinstance(model, MultilinkModel):
        return tuple(name.removesuffix("_m") for name in model.plane.pose[:2])
    return (model.coordinate.removesuffix("_m"),) if isinstance(model, RigModel) else ("x",)


def reference(model: MultilinkModel) -> tuple[float, float]:
    """The reference point in the base's axes, m."""
    body = model.robot.multilink
    assert body is not None
    return -body.reference.station_m, body.reference.offset_m


def duration(trials: Sequence[Trial]) -> float:
    """Median length of a trial, s; 1 where that is not known."""
    found = [float(t.time_s[-1] - t.time_s[0]) for t in trials if len(t.time_s) > 1]
    return float(np.median(found)) or 1.0 if found else 1.0


def track(trial: Trial) -> tuple[Array, Array]:
    """Times and positions where all measured coordinates are there, shapes (n,) and (n, coordinates)."""
    names = [name for name in POSITIONS if name in trial.measured]
    if not names:
        return np.zeros(0), np.zeros((0, 1))
    values = np.column_stack([trial.measured[name] for name in names])
    there = np.isfinite(values).all(axis=1)
    return trial.time_s[there], values[there]


def speed(model: Model, trials: Sequence[Trial]) -> float:
    """Typical speed of the trials, m/s (rad/s for an angle); 0.1 where nothing tells."""
    if isinstance(model, RigModel) and model.name == "free-decay":
        rate = math.sqrt(max(start(model, "stiffness"), 1e-12) / inertia(model, trials))
        return span(model, trials) * rate or 0.1
    found = []
    for trial in trials:
        for name in ("u_m_s", "mean_speed_m_s"):
            if name in trial.measured:
                found.append(float(np.sqrt(np.nanmean(trial.measured[name] ** 2))))
                break
        else:
            time, place = track(trial)
            every = slice(None, None, max(len(time) // STRETCHES, 1))
            if len(time) > 1 and time[every][-1] > time[0]:
                path = float(np.linalg.norm(np.diff(place[every], axis=0), axis=1).sum())
                found.append(path / float(time[every][-1] - time[0]))
    return float(np.median(found)) or 0.1 if found else 0.1


def span(model: Model, trials: Sequence[Trial]) -> float:
    """Typical extent of the motion, m (rad for an angle); 1 where nothing tells."""
    names = (model.coordinate,) if isinstance(model, RigModel) else POSITIONS
    found = [
        float(np.nanmax(t.measured[name]) - np.nanmin(t.measured[name]))
        for t in trials
        for name in names
        if name in t.measured and np.isfinite(t.measured[name]).any()
    ]
    return float(np.median(found)) or 1.0 if found else 1.0


def inertia(model: Model, trials: Sequence[Trial]) -> float:
    """What has to be accelerated: kg, kg m2 for an angle; 1 where nothing tells."""
    if isinstance(model, RigModel):
        known = [float(t.settings["inertia"]) for t in trials if "inertia" in t.settings]
        return float(np.median(known)) + start(model, "added_mass", "added_inertia") if known else 1.0
    if isinstance(model, MultilinkModel):
        return float(tables(model)["inertia"][:, 0].sum())
    if isinstance(model, RecoilModel):
        return model.drag_area_kg_m / model.b1
    return 1.0


def force(model: Model, trials: Sequence[Trial]) -> float:
    """Typical force that moves the robot, N (N m for an angle, m/s2 where the model is per mass)."""
    typical = speed(model, trials)
    if isinstance(model, RigModel):
        if model.name == "free-decay":
            return max(start(model, "stiffness"), 1e-12) * span(model, trials)
        known = [
            float(np.sqrt(np.mean(np.square(t.inputs.get("force_N", t.settings.get("force", 0.0))))))
            for t in trials
        ]
        return float(np.median(known)) or 0.1 if known else 0.1
    if isinstance(model, MultilinkModel):
        drag = axial_drag(tables(model))
        return drag * typical**2 + inertia(model, trials) * typical / duration(trials)
    if isinstance(model, RecoilModel):
        return model.drag_area_kg_m * typical**2
    return max(start(model, "surge_drag"), 0.1) * typical**2


def brake(model: Model, trials: Sequence[Trial]) -> float:
    """Size of a drag or friction that one begins to see: a tenth of what moves the robot.

    In a free decay, where losses add up over many swings, a hundredth.
    """
    return (0.01 if model.name == "free-decay" else 0.1) * force(model, trials)


def tables(model: MultilinkModel) -> dict[str, Any]:
    """The engine's tables at the start values of the coefficients."""
    count = len(model.assembly.names)
    found: dict[str, Any] = model.assembly.tables(np.array([p.start for p in model.parameters[:count]]))
    return found


def axial_drag(found: dict[str, Any]) -> float:
    """Quadratic drag of all links along their axes, N s2/m2."""
    return float(found["drag"][:, 2].sum() + found["foil"][:, 2] @ found["foil"][:, 4])


def hull(model: MultilinkModel) -> int:
    """The heaviest link."""
    return int(np.argmax([rigid(model, link)[0] for link in range(len(model.assembly.links))]))


def centre(model: MultilinkModel, link: int) -> tuple[float, float]:
    """Centre of mass of a link in its axes, m."""
    mass, _, ur, _, vr, _ = rigid(model, link)
    return float(vr / mass), float(-ur / mass)


def rigid(model: MultilinkModel, link: int) -> Array:
    """Inertia of a link without water, columns of ``engine.INERTIA``, at the start values."""
    own = model.assembly.links[link]
    values = {p.name: p.start for p in model.parameters}
    mass, com, y, about = (
        Polynomial.of(q).at(values) for q in (own.mass_kg, own.com_m, own.com_offset_m, own.inertia_kg_m2)
    )
    if own.inertia_about == "com":
        about += mass * (com * com + y * y)
    return np.array([mass, 0.0, -mass * y, mass, -mass * com, about])


def weigh(found: dict[str, Any], link: int, at: tuple[float, float], along: float, across: float) -> None:
    """Add a mass (kg) at a point of a link to the tables; it may differ by direction."""
    x, y = at
    rows = found["inertia"].copy()
    rows[link] += (along, 0.0, -along * y, across, across * x, along * y * y + across * x * x)
    found["inertia"] = rows


def joint_stiffness(found: dict[str, Any], joint: int) -> float:
    """Stiffness of a passive joint where it is straight, its wire and spring included, N m/rad."""
    row = found["passive"][joint]
    small = 1e-4
    wire = -engine.tendon_torque(small, *row[5:9]) / small if row[5] != 0.0 else 0.0
    return float(row[0] + wire)


def joint_inertia(model: MultilinkModel, found: dict[str, Any], joint: int) -> float:
    """Inertia about a passive joint of the link it carries, water included, kg m2."""
    return float(found["inertia"][model.assembly.passive[joint].link, 5])
