"""Blind cases of the falling-weight rig and of free roll decays, made without swimid.

Centimetres, grams, seconds and dynes; adaptive Dormand-Prince 8(5,3). The logs are an encoder's clicks with
uncertain stamps, or a camera's frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from validation.blind import common, decays, rig_effects
from validation.blind.common import ODD, PARAMETER, Catalogue, left_by_refit, stages_of, write_parameters
from validation.blind.rig_effects import AREA, DENSITY, GRAVITY, MASS, PULLEY, TRAVEL, Act, Rig

CLICK = 0.785
#: Scatter of the body at its release, cm.
START_SD = 0.05
#: Effects the nominal coefficients can imitate: seen only against a calibration of another day.
CONFOUNDED = (
    "pulley-friction",
    "pulley-viscous",
    "pulley-inertia",
    "linear-drag",
    "drag-reynolds",
    "added-mass",
    "camera-scale",
    "clock-rate",
    "load-friction",
)

CATALOGUE: dict[str, Catalogue] = {"falling-weight": rig_effects.EFFECTS, "free-decay": decays.EFFECTS}
OUTSIDE: dict[str, Catalogue] = {"falling-weight": rig_effects.OUTSIDE, "free-decay": decays.OUTSIDE}
#: What one trial of a robot may have of its own.
ODD_TRIALS = {"falling-weight": tuple(rig_effects.ODD_TRIALS)}
#: Parameters that may change between the fit of the parameter file and the trials.
CHANGED = {"falling-weight": tuple(rig_effects.PARAMETERS), "free-decay": tuple(decays.PARAMETERS)}
#: Unit of each parameter of a falling weight, and its factor from centimetres, grams and dynes to SI.
UNITS = {"drag_coefficient": ("1", 1.0), "added_mass": ("kg", 1e-3), "pulley_friction": ("N", 1e-5)}
#: Relative prior standard deviation of each coefficient in a fit.
PRIOR = 0.6
#: Largest relative values of the estimates of a fit to other trials.
UPPER = 3.0


def nominal(t: np.ndarray, weight: float, drag: float, added: float, friction: float) -> np.ndarray:
    """Displacement of the nominal rig in closed form, cm (quadratic drag, constant friction)."""
    total = MASS + added + weight + PULLEY
    force = max(weight * GRAVITY - friction, 1.0)
    phase = np.sqrt(drag * force) / total * t
    return total / drag * (np.logaddexp(phase, -phase) - np.log(2.0))


def make_case(folder: Path, *, robot: str, effect: str | tuple[str, ...] | None, size: float, rng) -> dict:
    """Write one blind case.

    Parameters
    ----------
    folder : Path
        Where trials.yaml, the logs and perhaps params_prior.yaml go.
    robot : {"falling-weight", "free-decay"}
    effect : str, tuple of str or None
        Of ``CATALOGUE[robot]`` or ``OUTSIDE[robot]``, or ``parameter:NAME`` for a name of ``CHANGED[robot]``.
    size : float
        0.3 is barely visible, 1 clearly, 3 dominant. Of a parameter, its relative change.
    rng : numpy.random.Generator

    Returns
    -------
    dict
        The label, to be kept away from the folder.
    """
    names = () if effect is None else (effect,) if isinstance(effect, str) else tuple(effect)
    if robot == "free-decay":
        return decays.make_case(Path(folder), names, size, rng)
    return _falling_weight(Path(folder), names, size, rng)


def _falling_weight(folder: Path, names: tuple[str, ...], size: float, rng: np.random.Generator) -> dict:
    folder.mkdir(parents=True, exist_ok=True)
    cd, added, friction = (v * rng.uniform(0.8, 1.25) for v in (0.705, 685.0, 3080.0))
    drag = 0.5 * DENSITY * cd * AREA
    weights = np.sort(rng.choice(np.arange(10.0, 46.0, 2.5), rng.integers(7, 11), replace=False))
    weights[0] = min(weights[0], 12.5)
    clicks = bool(rng.random() < 0.5) and "marker-dropout" not in names
    known = {**rig_effects.EFFECTS, **rig_effects.OUTSIDE, **rig_effects.CHANGES, **rig_effects.ODD_TRIALS}
    acts = [known[name][0](size, rng) for name in names]
    is_changed = any(name.startswith(PARAMETER) for name in names)
    odd = -1
    order = rng.permutation(len(weights)) / max(len(weights) - 1, 1)
    spread, clock = rng.uniform(0.02, 0.03), rng.uniform(0.003, 0.008)
    seeds = rng.integers(0, 2**31, (len(weights), 3))
    rate, noise = rng.uniform(20.0, 50.0), rng.uniform(0.10, 0.20)
    jitter, pitch = 0.004, 0.02

    def rig(k: int, *, effects: Sequence[Act], scatter: bool) -> Rig:
        own, chance = Rig(weights[k], drag, added, friction, clicks, np.random.default_rng(seeds[k, 0])), None
        own.order, own.is_odd = float(order[k]), k == odd
        if scatter:
            chance = np.random.default_rng(seeds[k, 1])
            own.friction *= chance.normal(1.0, spread)
            own.late += chance.normal(0.0, clock)
            start = chance.normal(0.0, START_SD)
            own.seen.append(lambda _, x: x + start)
        for act in effects:
            act(own)
        return own

    def noise_of(speed: np.ndarray) -> np.ndarray:
        """Return the standard deviation of the noise at a speed (cm/s), in cm."""
        if clicks:
            return np.hypot(jitter * speed, pitch)
        return np.full(len(speed), noise)

    arrays: dict[str, np.ndarray] = {}
    squares: dict[str, list[np.ndarray]] = {"raw": [], "scatter": [], "noise": []}
    drawn: list[np.ndarray] = []
    grids, changes, noise_free = [], [], {}
    lines = ["format: swimid-trials/1", "experiment: falling-weight", "robot: boxfish", "trials:"]
    held = rng.choice(len(weights), rng.integers(1, 3), replace=False) if rng.random() < 0.4 else []
    odd = _odd_trial(names, np.setdiff1d(np.arange(len(weights)), held), rng)
    for k, weight in enumerate(weights):
        t, x = rig(k, effects=acts, scatter=True).fall()
        chance = np.random.default_rng(seeds[k, 2])
        stamps, read = _clicks(t, x, chance, jitter, pitch) if clicks else _camera(t, x, chance, rate, noise)
        name = f"run{k + 1:02d}"
        head = "# encoder_resolution_m: 0.00785\n" if clicks else ""
        rows = "\n".join(f"{a:.6f},{b / 100:.5f}" for a, b in zip(stamps, read, strict=True))
        (folder / f"{name}.csv").write_text(f"{head}t_s,x_m\n{rows}\n")
        role = ", role: validate" if k in held else ""
        lines.append(f"  - {{log: {name}.csv, id: {name}, pulling_mass_kg: {weight / 1000:.4f}{role}}}")
        fair, plain, moved = (
            rig(k, effects=e, scatter=s).fall() for e, s in ((acts, False), ((), False), ((), True))
        )
        # the noise of these very samples, and what scatter does there: of trials that errors are of
        if k in held or not len(held):
            drawn.append((read - np.interp(stamps, t, x)) ** 2)
            drawn[-1] += (np.interp(stamps, *moved) - np.interp(stamps, *plain)) ** 2
        grid = np.linspace(0.0, min(fair[0][-1], plain[0][-1], moved[0][-1]), 150)
        on = [np.interp(grid, *series) for series in (fair, plain, moved)]
        speed = np.gradient(on[1], grid)
        squares["raw"].append((on[0] - on[1]) ** 2)
        squares["scatter"].append((on[2] - on[1]) ** 2)
        squares["noise"].append(noise_of(speed) ** 2)
        noise_free[f"{name}.csv"] = common.log_text(t_s=fair[0][::20], x_m=fair[1][::20] / 100)
        grids.append(grid)
        changes.append(on[0] - on[1])
        arrays |= {f"{name}/t_s": grid, f"{name}/x_m": on[0] / 100, f"{name}/x_m_nominal": on[1] / 100}
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
    truth = np.array([cd, added, friction])
    scatter = (spread, clock, START_SD)
    known_to = np.diag(np.full(3, PRIOR))
    if is_changed:
        known_to, prior = _write_fit(folder, truth, noise_of, scatter, rng), True
    else:
        prior = bool(rng.random() < (0.85 if set(names) & set(CONFOUNDED) else 0.35))
    if prior and not is_changed:
        known_to = np.diag(_write_prior(folder, truth, "pulley-friction" in names, rng))
    size_of = {key: float(np.sqrt(np.mean(value))) for key, value in squares.items()}
    floor = float(np.sqrt(np.mean(np.concatenate(drawn))))
    sds = [np.sqrt(value) for value in squares["noise"]]

    def change_of(act: Act) -> list[np.ndarray]:
        """Return the change of each trial by another act, in cm."""
        found = []
        for k, grid in enumerate(grids):
            bent, plain = (rig(k, effects=e, scatter=False).fall() for e in ((act,), ()))
            found.append(np.interp(grid, *bent) - np.interp(grid, *plain))
        return found

    candidates = {}
    if len(names) == 2 and odd < 0:
        candidates = common.candidates(rig_effects.EFFECTS, dict(zip(names, acts, strict=True)), change_of)
    shared, own = _columns(weights, grids, truth, scatter)
    if is_changed:
        candidates = common.alone(UNITS, shared, names)
    shared = [slopes @ known_to for slopes in shared]
    left, noncentrality, singles = left_by_refit(changes, shared, own, sds, candidates)
    # chance differences are refitted, too: what is left is held against the noise within trials
    fair_gap = left / size_of["noise"]
    return {
        "robot": "falling-weight",
        "effects": list(names),
        "stages": stages_of(names, OUTSIDE["falling-weight"]),
        "size": size,
        "prior": prior,
        "clicks": clicks,
        "odd": f"run{odd + 1:02d}" if odd >= 0 else None,
        "truth": {name: value * UNITS[name][1] for name, value in zip(UNITS, truth, strict=True)},
        "factors": {name.removeprefix(PARAMETER): 1.0 + size for name in names if name.startswith(PARAMETER)},
        "noise_sd": {"x_m": size_of["noise"] / 100},
        "floor": {"x_m": floor / 100},
        "range": {"x_m": TRAVEL / 100},
        "gap_over_floor": {"x_m": size_of["raw"] / floor, "overall": size_of["raw"] / floor},
        "gap_refit": {"x_m": fair_gap, "overall": fair_gap},
        "noncentrality": noncentrality,
        "singles": singles,
        "arrays": arrays,
        "noise_free": noise_free,
    }


def _odd_trial(names: Sequence[str], fitted: np.ndarray, rng: np.random.Generator) -> int:
    """Return the number of the trial that has something of its own, or -1."""
    return int(rng.choice(fitted)) if any(name.startswith(ODD) for name in names) else -1


def _clicks(
    t: np.ndarray, x: np.ndarray, rng: np.random.Generator, jitter: float, pitch: float
) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and counts of an encoder: late or early stamps, uneven clicks."""
    highest = np.maximum.accumulate(x) + 1e-9 * np.arange(len(x))
    counts = np.arange(CLICK, highest[-1], CLICK)
    counts = counts[counts > highest[0]]
    times = np.interp(counts, highest, t)
    speed = np.maximum(np.gradient(counts, np.maximum.accumulate(times + 1e-6 * np.arange(len(times)))), 0.1)
    late = rng.normal(0.0, jitter, len(times)) + rng.normal(0.0, pitch, len(times)) / speed
    stamps = np.concatenate([[0.0], np.sort(np.maximum(times + late, 1e-4))])
    stamps = np.round(np.maximum.accumulate(stamps) + 2e-6 * np.arange(len(stamps)), 6)
    return stamps, np.concatenate([[0.0], counts])


def _camera(
    t: np.ndarray, x: np.ndarray, rng: np.random.Generator, rate: float, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Frames of a camera with white and slightly coloured noise."""
    frames = np.arange(0.0, t[-1], 1.0 / rate)
    white, slow = rng.normal(0.0, 0.9 * noise, len(frames)), np.zeros(len(frames))
    for k in range(1, len(frames)):
        slow[k] = 0.8 * slow[k - 1] + rng.normal(0.0, 0.6 * 0.44 * noise)
    return np.round(frames, 6), np.interp(frames, t, x) + white + slow


def _write_prior(
    folder: Path, truth: np.ndarray, friction_known: bool, rng: np.random.Generator
) -> np.ndarray:
    """A calibration of another day; its relative errors of drag coefficient, added mass and friction."""
    error = rng.uniform(0.02, 0.05, 3)
    if friction_known:
        error[2] = 0.015
    value = truth * (1.0 + error * rng.normal(size=3))
    rows = {}
    for k, (name, (unit, si)) in enumerate(UNITS.items()):
        fixed = friction_known and name == "pulley_friction"
        rows[name] = (value[k] * si, error[k] * value[k] * si, unit, "fixed" if fixed else "estimated")
    write_parameters(folder / "params_prior.yaml", "falling-weight", "boxfish", rows)
    return error


def _write_fit(
    folder: Path,
    truth: np.ndarray,
    noise_of: Callable[[np.ndarray], np.ndarray],
    scatter: tuple[float, float, float],
    rng: np.random.Generator,
) -> np.ndarray:
    """Write the estimates of a fit to the drops of another day.

    Returns
    -------
    ndarray, shape (3, 3)
        Square root of the covariance of the relative errors.
    """
    weights = np.sort(rng.choice(np.arange(10.0, 46.0, 2.5), rng.integers(7, 11), replace=False))
    grids, sds = [], []
    for weight in weights:
        t = np.arange(0.0, 40.0, 1e-3)
        x = nominal(t, weight, 0.5 * DENSITY * truth[0] * AREA, *truth[1:])
        grids.append(np.linspace(0.0, t[np.searchsorted(x, TRAVEL) - 1], 150))
        sds.append(noise_of(np.interp(grids[-1], t, np.gradient(x, t))))
    shared, own = _columns(weights, grids, truth, scatter)
    system = common.stacked([PRIOR * slopes for slopes in shared], own, sds)
    covariance = PRIOR**2 * common.fit_covariance(system, 3)
    estimates, stderr, correlation = common.draw_fit(truth, covariance, UPPER * truth, rng)
    rows = {}
    for k, (name, (unit, si)) in enumerate(UNITS.items()):
        rows[name] = (estimates[k] * si, stderr[k] * si, unit, "estimated")
    write_parameters(folder / "params_prior.yaml", "falling-weight", "boxfish", rows, correlation)
    return np.linalg.cholesky(covariance)


def _columns(
    weights: np.ndarray, grids: list[np.ndarray], truth: np.ndarray, scatter: tuple[float, float, float]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the changes of each drop (cm) by the coefficients, and by what scatters between drops.

    ``scatter`` has the standard deviations of friction (relative), clock (s) and start (cm). A change by a
    coefficient is for twice its value, to first order.
    """
    shared, own = [], []
    for t, weight in zip(grids, weights, strict=True):

        def fall(cd: float, added: float, friction: float, t=t, weight=weight) -> np.ndarray:
            return nominal(t, weight, 0.5 * DENSITY * cd * AREA, added, friction)

        base = fall(*truth)
        slopes = [(fall(*(truth * (1 + 0.01 * one))) - base) / 0.01 for one in np.eye(3)]
        shared.append(np.stack(slopes, axis=1))
        late = -np.gradient(base, t) * scatter[1]
        own.append(np.stack([slopes[2] * scatter[0], late, np.full(len(t), scatter[2])], axis=1))
    return shared, own
