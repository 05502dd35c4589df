"""What the generators of blind cases share: the pinned names of effects and the parameter file."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

#: name -> (function of size and generator, sizes from barely visible to dominant)
Catalogue = dict[str, tuple[Callable[..., Any], list[float]]]

#: Sizes of the draws of an effect that stand for it in a comparison with two effects.
DRAWS = (0.4, 1.0, 1.0, 2.5)

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
#: Prefix of the names of truths that a parameter of the parameter file has changed.
PARAMETER = "parameter:"
#: Prefix of the names of truths that concern a single trial.
ODD = "odd:"
#: Stage of every effect whose name the gap file's format pins.
STAGE_OF = {name: stage for stage, names in _STAGES.items() for name in names.split()}


def stages_of(names: Iterable[str], outside: Iterable[str] = ()) -> list[str]:
    """Return the stage of each truth; a changed parameter is the stage ``parameter``."""
    stages = dict.fromkeys(outside, "outside") | STAGE_OF
    return ["odd" if name.startswith(ODD) else stages.get(name, "parameter") for name in names]


def write_parameters(
    path: Path,
    model: str,
    robot: str,
    parameters: Mapping[str, tuple[float, float, str, str]],
    correlation: np.ndarray | None = None,
) -> None:
    """Write a parameter file from value, standard error, unit and status of each parameter.

    ``correlation`` is that of the estimated parameters, in their order. The provenance then names a log of
    another day.
    """
    lines = ["format: swimid-parameters/1", f"model: {model}", f"robot: {robot}", "parameters:"]
    for name, (value, stderr, unit, status) in parameters.items():
        error = "null" if status == "fixed" else f"{stderr:.6g}"
        lines.append(
            f'  {name}: {{value: {value:.8g}, stderr: {error}, unit: "{unit}", '
            f"bounds: [0, null], status: {status}}}"
        )
    if correlation is not None:
        estimated = [name for name, row in parameters.items() if row[-1] == "estimated"]
        lines += ["correlation:", f"  names: [{', '.join(estimated)}]", "  matrix:"]
        lines += [f"  - [{', '.join(f'{v:.8g}' for v in row)}]" for row in correlation]
        digest = hashlib.sha256("\n".join(lines).encode()).hexdigest()
        lines.append(f"provenance: {{inputs: {{other_day.csv: {digest}}}}}")
    path.write_text("\n".join(lines) + "\n")


def draw_fit(
    values: np.ndarray, covariance: np.ndarray, upper: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw the estimates of a fit to other trials.

    Parameters
    ----------
    values, upper : ndarray, shape (k,)
        True parameters, and their upper bounds. The lower bound is zero.
    covariance : ndarray, shape (k, k)
        Covariance of the relative errors of the estimates.

    Returns
    -------
    estimates, stderr : ndarray, shape (k,)
        Estimates within the bounds, and their standard errors, in the units of the parameters. The standard
        errors do not depend on the drawn estimates.
    correlation : ndarray, shape (k, k)
    """
    sd = np.sqrt(np.diag(covariance))
    while True:
        estimates = values * (1.0 + rng.multivariate_normal(np.zeros(len(sd)), covariance))
        if np.all((estimates > 0.05 * values) & (estimates < upper)):
            return estimates, sd * values, covariance / np.outer(sd, sd)


def stacked(
    shared: Sequence[np.ndarray], own: Sequence[np.ndarray], noise_sd: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the linear system of a refit, with one prior row for each column.

    Parameters
    ----------
    shared, own : sequence of ndarray, shapes (n, k) and (n, m)
        Changes of each trial by one prior standard deviation of each coefficient, and of each quantity that
        scatters between trials.
    noise_sd : sequence of ndarray, shape (n,)
        Standard deviation of the noise of each sample.

    Returns
    -------
    ndarray, shape (samples + columns, columns)
        The rows of the samples are in units of the noise. The first k columns are the coefficients.
    """
    width, extra = shared[0].shape[1], own[0].shape[1]
    rows = []
    for place, (common, mine, sd) in enumerate(zip(shared, own, noise_sd, strict=True)):
        block = np.zeros((len(sd), width + extra * len(own)))
        block[:, :width] = common
        block[:, width + extra * place : width + extra * (place + 1)] = mine
        rows.append(block / sd[:, None])
    return np.vstack([*rows, np.eye(rows[0].shape[1])])


def fit_covariance(system: np.ndarray, width: int) -> np.ndarray:
    """Return the covariance of the first ``width`` unknowns of a least-squares system with unit noise."""
    return np.linalg.inv(system.T @ system)[:width, :width]


def candidates(
    catalogue: Catalogue, acting: Mapping[str, Any], change_of: Callable[[Any], Sequence[np.ndarray]]
) -> dict[str, list[Sequence[np.ndarray]]]:
    """Return the changes of the trials by draws of every effect, for :func:`left_by_refit`.

    Parameters
    ----------
    catalogue : Catalogue
    acting : mapping of name to act
        Effects of the case. Each of them is also a candidate with its true size and form.
    change_of : callable
        Function of an act that returns the change of each trial.
    """
    found = {name: [change_of(act)] for name, act in acting.items()}
    for name, (maker, _) in catalogue.items():
        own = found.setdefault(name, [])
        for k, size in enumerate(DRAWS):
            # a draw that makes a trial unstable is no alternative
            with contextlib.suppress(FloatingPointError):
                own.append(change_of(maker(size, np.random.default_rng(k))))
    return {name: draws for name, draws in found.items() if draws}


def alone(
    parameters: Iterable[str], shared: Sequence[np.ndarray], but: Collection[str]
) -> dict[str, list[Sequence[np.ndarray]]]:
    """Return the changes of the trials by each single parameter, for :func:`left_by_refit`.

    Parameters
    ----------
    parameters : iterable of str
        Names of the columns of ``shared``.
    shared : sequence of ndarray, shape (n, k)
    but : collection of str
        Changed parameters of the case, which are left out.
    """
    found: dict[str, list[Sequence[np.ndarray]]] = {}
    for k, name in enumerate(parameters):
        if f"{PARAMETER}{name}" not in but:
            found[f"{PARAMETER}{name}"] = [[slopes[:, k] for slopes in shared]]
    return found


def left_by_each(
    system: np.ndarray, whole: np.ndarray, candidates: Mapping[str, np.ndarray]
) -> dict[str, float]:
    """Return the squared length that each candidate leaves of a vector after a refit.

    Parameters
    ----------
    system : ndarray, shape (rows, columns)
    whole : ndarray, shape (rows,)
    candidates : mapping of name to ndarray, shape (rows, draws)
        Changes by several draws of the candidate. Any linear combination of them is allowed.
    """
    basis, _ = np.linalg.qr(system)
    rest = whole - basis @ (basis.T @ whole)
    found = {}
    for name, columns in candidates.items():
        free = columns - basis @ (basis.T @ columns)
        found[name] = float(np.sum((rest - free @ np.linalg.lstsq(free, rest, rcond=1e-6)[0]) ** 2))
    return found


def left_by_refit(
    changes: Sequence[np.ndarray],
    shared: Sequence[np.ndarray],
    own: Sequence[np.ndarray],
    noise_sd: Sequence[np.ndarray],
    candidates: Mapping[str, Sequence[Sequence[np.ndarray]]] | None = None,
) -> tuple[float, float, dict[str, float]]:
    """Return what a refit of the nominal model and the scatter between trials leave of an effect.

    The refit is of first order.

    Parameters
    ----------
    changes : sequence of ndarray, shape (n,)
        Change of each trial by the effect, without noise and scatter.
    shared, own, noise_sd : sequence of ndarray
        See :func:`stacked`.
    candidates : mapping of name to sequence of draws, optional
        Changes of the trials by each draw of other effects, in the form of ``changes``.

    Returns
    -------
    rms : float
        Root mean square of the residual, in units of the changes.
    noncentrality : float
        Squared length of the residual in standard deviations, including the moves of the coefficients.
    singles : dict of name to float
        Noncentrality that a refit with each candidate leaves.
    """
    system = stacked(shared, own, noise_sd)
    columns = system.shape[1]

    def scaled(parts: Sequence[np.ndarray]) -> np.ndarray:
        white = [part / sd for part, sd in zip(parts, noise_sd, strict=True)]
        return np.concatenate([*white, np.zeros(columns)])

    whole = scaled(changes)
    rest = whole - system @ np.linalg.lstsq(system, whole, rcond=None)[0]
    size = rest[:-columns] * np.concatenate(list(noise_sd))
    drawn = {}
    for name, draws in (candidates or {}).items():
        drawn[name] = np.stack([scaled(draw) for draw in draws], axis=1)
    singles = left_by_each(system, whole, drawn)
    return float(np.sqrt(np.mean(size**2))), float(rest @ rest), singles


def log_text(**columns: np.ndarray) -> str:
    """Return the text of a log with these columns."""
    rows = [",".join(f"{value:.8g}" for value in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join([",".join(columns), *rows]) + "\n"
