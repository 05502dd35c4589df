"""A peer: equation-error regression; accelerations from the logged pose, forces as regressors.

Forward selection by the error reduced (S. A. Billings, *Nonlinear System Identification*, 2013, chapter 3;
V. Klein and E. A. Morelli, *Aircraft System Identification*, 2006, chapter 5), while the BIC falls.
Derivatives come from a Savitzky-Golay filter of third order. It knows only effects that are forces, on rigs
and on robots in a plane, and does not take other trials. What a term of the nominal equation imitates is not
seen, and coefficients known from elsewhere are not used.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from benchmarks.gapbench.peers import Case, verdict
from swimid.effects import catalogue
from swimid.fitting.fit_common import pose_channels
from swimid.fitting.model import Trial

Array = np.ndarray

#: Order of the filter, its least window in samples, and shares of a beat or swing and of a record it spans.
ORDER, LEAST, OF_BEAT, OF_RECORD = 3, 7, 0.25, 0.1
#: A speed at which friction has lost its excess over sliding, as a share of the typical one.
STRIBECK = 0.2
#: Effects together at most.
MOST = 2
#: Share of a term's norm that the nominal terms leave, below which the term counts as one of them.
NOMINAL = 1e-6


class Rows(NamedTuple):
    """Equations at independent samples.

    Attributes
    ----------
    left : ndarray, shape (n, equations)
        Left side.
    nominal : ndarray, shape (n, equations, k)
        Terms of the nominal model, each of which has a coefficient of its own.
    effects : dict of name to ndarray of shape (n, equations, k)
        Terms of effects.
    speed : ndarray, shape (n,)
        Speed along the body, m/s (rad/s of a rig that swings).
    """

    left: Array
    nominal: Array
    effects: dict[str, Array]
    speed: Array


def diagnose(case: Case) -> dict[str, Any]:
    """Return the part of a gap file that the BIC of terms gives."""
    return verdict(rounds(case))


def rounds(case: Case) -> list[dict[str, float]]:
    """BIC of the nominal equation, under ``""``, and with the terms of each effect; then beside the best."""
    left, base, terms, _ = equations(case)
    found: list[dict[str, float]] = []
    while len(found) < MOST:
        bic = {"": compute_bic(base, left)}
        bic |= {name: compute_bic(np.concatenate([base, term], axis=2), left) for name, term in terms.items()}
        found.append(bic)
        best = min(bic, key=bic.__getitem__)
        if best == "":
            break
        base = np.concatenate([base, terms.pop(best)], axis=2)
    return found


def equations(case: Case) -> Rows:
    """Return the equations of all trials, in units of the residuals that the nominal terms leave of each.

    Terms of effects that the nominal terms can express are left out.
    """
    if pose_channels(case.model) and not case.model.in_space:
        rows = [_planar(case, trial) for trial in case.trials]
    elif getattr(case.model, "rig", None) is not None:
        rows = [_rig(case, trial) for trial in case.trials]
    else:
        raise SystemExit(f"no equation of forces for the model '{case.model.name}'")
    known = {e.name for e in catalogue.applicable(catalogue.list_effects(), case.model, case.trials)}
    left = np.concatenate([r.left for r in rows])
    base = np.concatenate([r.nominal for r in rows])
    terms = {
        name: np.concatenate([r.effects[name] for r in rows]) for name in rows[0].effects if name in known
    }
    terms = {name: term for name, term in terms.items() if _is_new(term, base)}
    size = np.sqrt(np.mean(residuals(base, left) ** 2, axis=0))
    terms = {name: term / size[:, None] for name, term in terms.items()}
    return Rows(left / size, base / size[:, None], terms, np.concatenate([r.speed for r in rows]))


def library(rows: Rows) -> dict[tuple[str, ...], Array]:
    """Return the terms of effects by the names of all effects that have them."""
    found: dict[tuple[str, ...], Array] = {}
    for name, term in rows.effects.items():
        same = next((names for names, other in found.items() if np.array_equal(other, term)), ())
        found.pop(same, None)
        found[*same, name] = term
    return found


def _is_new(term: Array, nominal: Array) -> bool:
    return bool(np.linalg.norm(residuals(nominal, term)) > NOMINAL * np.linalg.norm(term))


def residuals(terms: Array, left: Array) -> Array:
    """Return the residuals of least squares.

    Parameters
    ----------
    terms : ndarray, shape (n, equations, k)
        Each equation has its own non-zero columns.
    left : ndarray, shape (n, equations) or (n, equations, m)
        One left side, or several.
    """
    flat = terms.reshape(-1, terms.shape[2])
    scale = np.linalg.norm(flat, axis=0)
    flat = flat / np.where(scale > 0, scale, 1.0)
    weights = np.linalg.lstsq(flat, left.reshape(len(flat), -1), rcond=1e-8)[0]
    return left - (flat @ weights).reshape(left.shape)


def compute_bic(terms: Array, left: Array) -> float:
    """``m log(rss / m) + rank log m`` with ``m`` samples in all."""
    m = left.size
    rank = np.linalg.matrix_rank(terms.reshape(m, -1))
    return m * float(np.log(np.mean(residuals(terms, left) ** 2))) + rank * float(np.log(m))


def _derivatives(time: Array, series: Array, window_s: float) -> tuple[list[Array], Array]:
    """Time, value, rate and acceleration on an even grid, and places half a window apart, ends left out."""
    good = np.isfinite(series)
    step = float(np.median(np.diff(time)))
    grid = np.arange(time[good][0], time[good][-1], step)
    even = np.interp(grid, time[good], series[good])
    width = max(LEAST, 2 * round(0.5 * window_s / step) + 1)
    if len(grid) <= 2 * width:
        raise SystemExit("a trial is too short for its derivatives")
    found = [savgol_filter(even, width, ORDER, deriv=d, delta=step) for d in range(3)]
    return [grid, *found], np.arange(width, len(grid) - width, width // 2)


def _rig(case: Case, trial: Trial) -> Rows:
    """``(M + added) a = F - quadratic v |v| - linear v - dry sgn(v) - stiffness x``, and effects.

    Noise of the acceleration stays on the left side alone: where the inertia is estimated, the known forces
    are a term with a factor of its own, to first order.
    """
    rig, model, coordinate = trial.rig, case.model, case.model.rig
    assert coordinate is not None
    measured = trial.measured[coordinate.displacement.name]
    span = float(trial.time_s[-1] - trial.time_s[0])
    centred = measured[np.isfinite(measured)] - np.nanmean(measured)
    swings = max(int(np.sum(np.diff(np.sign(centred)) != 0)) // 2, 1)
    (time, x, v, a), at = _derivatives(trial.time_s, measured, min(OF_BEAT / swings, OF_RECORD) * span)
    logged = trial.inputs.get("force_N")
    force = np.full(len(time), rig.pull) if logged is None else np.interp(time, trial.time_s, logged)
    side, square, none = np.sign(v), v * np.abs(v), np.zeros(len(v))
    own = {
        "drag_coefficient": rig.area_factor * square, "quadratic_drag": square, "quadratic_damping": square,
        "linear_drag": v, "linear_damping": v, "pulley_friction": side if rig.pulley else none,
        "stiffness": x, "force_offset": -np.ones(len(v)),
    }  # fmt: skip
    known = force - sum(p.start * own[p.name] for p in model.parameters if p.name in own and not p.free)
    # per unit of an inertia that is not known
    unknown = bool(np.isnan(rig.inertia))
    inertia = (1.0 if unknown else rig.inertia) + model.start("added_mass", "added_inertia")
    estimated = any(p.free for p in model.parameters if p.name in ("added_mass", "added_inertia"))
    left = inertia * a - (none if estimated else known)
    nominal = [own[p.name] for p in model.parameters if p.name in own and p.free]
    nominal += [known] if estimated else []
    typical = float(np.sqrt(np.mean(v**2)))
    effects = {
        "linear-drag": v, "pulley-viscous": v, "quadratic-drag": square, "pulley-friction": side,
        "drag-reynolds": square * np.log(np.maximum(np.abs(v) / typical, 1e-3)),
        "stribeck": side * np.exp(-((v / (STRIBECK * typical)) ** 2)),
        "load-friction": (np.abs(x) if coordinate.swings else np.abs(force)) * side,
        "hardening": x**3, "tether": x, "current": np.abs(v),
    }  # fmt: skip
    if not unknown:
        effects |= {"added-mass": known, "pulley-inertia": known}
    return Rows(
        left[at, None],
        np.stack(nominal or [none], axis=1)[at, None, :],
        {name: term[at, None, None] for name, term in effects.items()},
        np.abs(v)[at],
    )


def _planar(case: Case, trial: Trial) -> Rows:
    """Accelerations along, across and about the body.

    The nominal terms are the library that the mirror symmetry of a robot in a plane allows, of its speeds and
    of what its first joint is told to do.
    """
    swimmer, pose, beat = case.model.swimmer, pose_channels(case.model), trial.swim.beat
    if swimmer is None or beat is None or any(c not in trial.measured for c in pose):
        raise SystemExit("no pose and beat in every trial")
    window = OF_BEAT / beat.frequency_hz
    series = [_derivatives(trial.time_s, _whole(trial.measured[c], c), window) for c in pose]
    count = min(len(s[0][0]) for s in series)
    at = series[0][1][series[0][1] < count - 1]
    time = series[0][0][0][:count]
    (x, dx, ddx), (y, dy, ddy), (turn, r, dr) = ([values[:count] for values in s[0][1:]] for s in series)
    c, s = np.cos(turn), np.sin(turn)
    u, v, along, across = c * dx + s * dy, c * dy - s * dx, c * ddx + s * ddy, c * ddy - s * ddx
    q = swimmer.command(0, trial.swim, time, 0.0)
    dq = np.gradient(q, time)
    ddq = np.gradient(dq, time)
    none = np.zeros(count)
    even = [u * np.abs(u), v * r, r**2, v**2, q * ddq, dq**2, q * dq * np.abs(dq), r * dq]
    odd = [v * np.abs(v), r * np.abs(r), u * v, u * r, q, dq, ddq, dq * np.abs(dq), u * q]
    nominal = (
        [(t, none, none) for t in even] + [(none, t, none) for t in odd] + [(none, none, t) for t in odd]
    )
    size = float(np.sqrt(np.mean(u**2)))
    slower = u * np.abs(u) * np.log(np.maximum(np.abs(u) / size, 1e-3))
    away = (x - x[0], y - y[0])
    effects: dict[str, list[tuple[Array, Array, Array]]] = {
        "linear-drag": [(u, none, none), (none, v, none), (none, none, r)],
        "drag-reynolds": [(slower, none, none)],
        "current": [
            (np.abs(u) * c, none, none), (np.abs(u) * s, none, none),
            (none, u * s, none), (none, u * c, none),
        ],
        "tether": [(c * away[0] + s * away[1], none, none), (none, c * away[1] - s * away[0], none)],
        "com-offset": [(dr, none, none), (none, none, along)],
        "buoyancy": [(s, none, none), (none, c, none)],
    }  # fmt: skip
    return Rows(
        np.stack([along, across, dr], axis=1)[at],
        _columns(nominal, at),
        {name: _columns(terms, at) for name, terms in effects.items()},
        np.abs(u)[at],
    )


def _columns(terms: list[tuple[Array, Array, Array]], at: Array) -> Array:
    """Terms as an array, shape (n, equations, k)."""
    return np.stack([np.stack(t, axis=1) for t in terms], axis=2)[at]


def _whole(values: Array, channel: str) -> Array:
    """An angle without jumps by whole turns; missing samples stay missing."""
    if not channel.endswith("_rad"):
        return values
    found, good = values.copy(), np.isfinite(values)
    found[good] = np.unwrap(values[good])
    return found
