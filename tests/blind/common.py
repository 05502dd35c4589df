"""What the generators of blind cases share: the pinned names of effects and the parameter file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

#: name -> (function of size and generator, sizes from barely visible to dominant)
Catalogue = dict[str, tuple[Callable[..., Any], list[float]]]

_STAGES = {
    "actuation": "servo-lag servo-delay servo-backlash amplitude-loss rate-limit amplitude-offset slip",
    "structure": "fin-flexibility joint-stiffness joint-damping joint-locked water-ingress com-offset "
    "hardening stribeck load-friction",
    "fluid": "linear-drag drag-reynolds added-mass wake-lift lift-damping",
    "environment": "current waves tether wall surface-breach buoyancy",
    "sensing": "camera-scale camera-rotation time-offset clock-rate marker-dropout marker-offset imu-tilt "
    "imu-bias",
    "rig": "pulley-friction pulley-viscous pulley-inertia string-stretch start-offset initial-speed",
}
#: Stage of every effect whose name the gap file's format pins.
STAGE_OF = {name: stage for stage, names in _STAGES.items() for name in names.split()}


def stages_of(names: Iterable[str], outside: Iterable[str] = ()) -> list[str]:
    """Stage of each effect; ``outside`` for those that are in no catalogue."""
    return ["outside" if name in outside else STAGE_OF[name] for name in names]


def write_parameters(
    path: Path, *, model: str, robot: str, parameters: Mapping[str, tuple[float, float, str, str]]
) -> None:
    """Write a parameter file from value, standard error, unit and status of each parameter."""
    lines = ["format: swimid-parameters/1", f"model: {model}", f"robot: {robot}", "parameters:"]
    for name, (value, stderr, unit, status) in parameters.items():
        error = "null" if status == "fixed" else f"{stderr:.6g}"
        lines.append(
            f'  {name}: {{value: {value:.8g}, stderr: {error}, unit: "{unit}", '
            f"bounds: [0, null], status: {status}}}"
        )
    path.write_text("\n".join(lines) + "\n")


def left_by_refit(
    changes: Sequence[np.ndarray],
    shared: Sequence[np.ndarray],
    own: Sequence[np.ndarray],
    noise_sd: Sequence[np.ndarray],
) -> tuple[float, float]:
    """What a refit of the nominal model and the scatter between trials leave of an effect, to first order.

    Parameters
    ----------
    changes : sequence of ndarray, shape (n,)
        What the effect does to each trial, without noise and scatter.
    shared, own : sequence of ndarray, shapes (n, k) and (n, m)
        Changes by one prior standard deviation of each coefficient, and by one of each trial's own scatter.
    noise_sd : sequence of ndarray, shape (n,)

    Returns
    -------
    rms : float
        Of what is left, in units of the changes.
    noncentrality : float
        Squared length of what is left in standard deviations, with what the coefficients were moved for it.
    """
    width, extra = shared[0].shape[1], own[0].shape[1]
    rows = []
    for place, (common, mine, sd) in enumerate(zip(shared, own, noise_sd, strict=True)):
        block = np.zeros((len(sd), width + extra * len(own)))
        block[:, :width] = common
        block[:, width + extra * place : width + extra * (place + 1)] = mine
        rows.append(block / sd[:, None])
    columns = rows[0].shape[1]
    system = np.vstack([*rows, np.eye(columns)])
    scaled = [change / sd for change, sd in zip(changes, noise_sd, strict=True)]
    whole = np.concatenate([*scaled, np.zeros(columns)])
    rest = whole - system @ np.linalg.lstsq(system, whole, rcond=None)[0]
    size = rest[:-columns] * np.concatenate(list(noise_sd))
    return float(np.sqrt(np.mean(size**2))), float(rest @ rest)
