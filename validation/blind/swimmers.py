"""Cases of free swimming with a known hidden cause, none, two, or one that no catalogue holds.

`make_case` writes what a user would have: a trials file, its logs and sometimes an earlier calibration.
The cause stays in the label it returns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from tests.generators import swimmer
from validation.blind import common, swim_body, swim_files
from validation.blind import odd_swims as odd
from validation.blind import swim_actuation as actuation
from validation.blind import swim_effects as effects
from validation.blind import swim_sensing as sensing
from validation.blind.common import ODD, PARAMETER
from validation.blind.swim_case import Act, Channels, Entry, Trial, held_out
from validation.blind.swim_sensing import UP
from validation.blind.swim_tables import Water

SIZES = (0.3, 1.0, 3.0)


def _entries(stage: str, *makers: Callable[..., Act], sizes: tuple[float, ...] = SIZES) -> dict[str, Entry]:
    return {maker.__name__.replace("_", "-"): Entry(maker, sizes, stage) for maker in makers}


_BOTH = {
    **_entries(
        "actuation",
        actuation.servo_lag,
        actuation.servo_delay,
        actuation.servo_backlash,
        actuation.amplitude_loss,
        actuation.rate_limit,
        actuation.amplitude_offset,
        actuation.slip,
    ),
    **_entries(
        "structure",
        effects.fin_flexibility,
        effects.joint_stiffness,
        effects.joint_damping,
        effects.joint_locked,
        effects.water_ingress,
        effects.com_offset,
        effects.hardening,
        actuation.stribeck,
        actuation.load_friction,
    ),
    **_entries(
        "fluid",
        effects.linear_drag,
        effects.drag_reynolds,
        effects.added_mass,
        effects.wake_lift,
        effects.lift_damping,
    ),
    **_entries("environment", effects.current, effects.waves, effects.tether, effects.wall),
    **_entries(
        "sensing",
        sensing.camera_scale,
        sensing.camera_rotation,
        sensing.time_offset,
        sensing.clock_rate,
        sensing.marker_dropout,
        sensing.marker_offset,
        sensing.imu_tilt,
        sensing.imu_bias,
    ),
}
_VERTICAL = _entries("environment", effects.surface_breach, effects.buoyancy)
CATALOGUE: dict[str, dict[str, Entry]] = {"tfish": _BOTH, "dolphin": {**_BOTH, **_VERTICAL}}
_OUTSIDE = _entries(
    "outside",
    actuation.battery_droop,
    effects.vortex_shedding,
    effects.wake_memory,
    effects.spring_drift,
    effects.asymmetric_thrust,
    effects.fin_tear,
    effects.gusts,
)
_SPREAD = _entries("outside", effects.spread_drag, sizes=(0.3, 1.0))
OUTSIDE: dict[str, dict[str, Entry]] = {"tfish": {**_OUTSIDE, **_SPREAD}, "dolphin": _OUTSIDE}

#: Coefficients a fit estimates, with the published value and upper bound of the robot's file.
FITTED = {
    "tfish": {
        **{n: (swimmer.TFISH[n], 3.0) for n in ("c_ma", "c_Ia")},
        **{n: (swimmer.TFISH[n], b) for n, b in (("c_d0", 5.0), ("c_d13", 5.0), ("c_d4", 6.0))},
        **{n: (swimmer.TFISH[n], 1.0) for n in ("c_f0", "c_f13", "c_f4")},
    },
    "dolphin": {
        f"{kind}{k}": (swimmer.DOLPHIN[f"{kind}{k}"], bound)
        for kind, bound in (("c_m", 2.0), ("c_f", 0.5), ("c_d", 10.0))
        for k in range(3)
    },
}
#: Spring of the passive joint: name, published value, unit and upper bound.
SPRING = {"tfish": ("d_p", 0.030, "m", 0.2), "dolphin": ("K_s", swimmer.DOLPHIN["K_s"], "N m/rad", 20.0)}
#: Parameters that may change between the fit of the parameter file and the trials: masses, drag, springs.
CHANGED = {"tfish": ("c_ma", "c_d0", "c_d4", "d_p"), "dolphin": ("c_m0", "c_d1", "c_d2", "K_s")}


#: What one trial of a robot may have of its own.
_ODD = {f"{ODD}{maker.__name__}": Entry(maker, (), "odd") for maker in (odd.mirrored, odd.entry, odd.thrust)}
ODD_TRIALS = {robot: tuple(_ODD) for robot in CATALOGUE}


@dataclass(frozen=True)
class Noise:
    """Tracking noise: white and first-order autoregressive parts of each channel, SI."""

    white: dict[str, float]
    coloured: dict[str, float]
    pole: float

    def sd(self, name: str) -> float:
        return float(np.hypot(self.white[name], self.coloured[name]))

    def draw(self, name: str, n: int, rng: np.random.Generator) -> np.ndarray:
        walk = np.empty(n)
        walk[0] = rng.normal()
        kick = np.sqrt(1.0 - self.pole**2) * rng.normal(size=n)
        for i in range(1, n):
            walk[i] = self.pole * walk[i - 1] + kick[i]
        return self.white[name] * rng.normal(size=n) + self.coloured[name] * walk


def swim(
    trial: Trial,
    coefficients: dict[str, float],
    acts: Sequence[Act] = (),
    *,
    step_s: float = swim_body.STEP_S,
    drag_at: str = "mid-link",
) -> Channels:
    """All channels of a trial without noise, at the log's times."""
    factors = _factors(acts)
    changed_to = {name: value * factors.get(name, 1.0) for name, value in coefficients.items()}
    body = swim_body.of(trial.robot, changed_to, drag_at=drag_at)
    steps = int(np.ceil((trial.duration_s + 0.5) / step_s))
    t = np.arange(2 * steps + 1) * 0.5 * step_s
    drive = {**trial.drive, "amplitude_deg": trial.drive["amplitude_deg"] * (1.0 + trial.amplitude)}
    joints = actuation.command(drive, body.gain, t)
    joints[0] += (trial.trim * actuation.moved(trial.robot))[: joints.shape[1], None]
    flow, changed = np.zeros(len(t), complex), {"thrust": 1.0 + trial.thrust}
    for act in acts:
        joints = joints if act.joints is None else act.joints(trial, t, joints)
        flow = flow if act.flow is None else flow + act.flow(trial, t)
        changed |= {} if act.water is None else act.water(trial)
        if act.body is not None:
            act.body(trial, body)
    table = np.ascontiguousarray(joints.transpose(2, 0, 1))
    poses, angles = swim_body.run(body, Water(**changed), table, step_s, trial.start, flow)
    if not (np.isfinite(poses).all() and np.isfinite(angles).all()):
        raise FloatingPointError(f"{trial.id}: the swim is unstable")
    return _sampled(trial, acts, t[::2], poses, angles)


def _sampled(
    trial: Trial, acts: Sequence[Act], grid: np.ndarray, poses: np.ndarray, angles: np.ndarray
) -> Channels:
    log = np.arange(round(trial.duration_s * trial.rate_hz) + 1) / trial.rate_hz
    true = log - trial.late
    camera = true
    for act in acts:
        camera = camera if act.clock is None else act.clock(trial, camera)
    pose = CubicSpline(grid, poses[:, :3])(np.clip(camera, 0.0, grid[-1]))
    still = np.clip(true, 0.0, grid[-1])
    found = {"x_m": pose[:, 0]}
    up, angle, rate = UP[trial.robot]
    found[up], found[angle] = pose[:, 1], pose[:, 2]
    found[rate] = CubicSpline(grid, poses[:, 5])(still)
    turned = CubicSpline(grid, angles)(still)
    for j in range({"tfish": 4, "dolphin": 3}[trial.robot]):
        found[f"joint{j + 1}_rad"] = turned[:, j]
    for act in acts:
        found = found if act.seen is None else act.seen(trial, found, log)
    return {"t_s": log, **found}


def _broken(trial: Trial, acts: Sequence[Act], log: Channels) -> Channels:
    for act in acts:
        log = log if act.broken is None else act.broken(trial, log, log["t_s"])
    return log


def plan(robot: str, rng: np.random.Generator) -> list[Trial]:
    """Six to nine trials over three frequencies and two or three amplitudes, one setting repeated."""
    if robot == "tfish":
        frequencies = np.round(np.array([1.0, 1.4, 1.8]) + rng.uniform(-0.1, 0.1, 3), 2)
        amplitudes = np.round(np.array([20.0, 25.0, 30.0]) + rng.uniform(-2.0, 2.0, 3))
    else:
        frequencies = np.round(np.array([1.5, 2.0, 2.5]) + rng.uniform(-0.15, 0.15, 3), 2)
        amplitudes = np.round(np.array([18.0, 23.0, 28.0]) + rng.uniform(-1.0, 1.0, 3))
    amplitudes = amplitudes[: rng.integers(2, 4)]
    settings = [(f, a) for f in frequencies for a in amplitudes]
    chosen = [settings[i] for i in rng.permutation(len(settings))][: rng.integers(5, 8)]
    missing = [f for f in frequencies if f not in {c[0] for c in chosen}]
    chosen += [(f, amplitudes[0]) for f in missing]
    drives = [{"frequency_hz": float(f), "amplitude_deg": float(a)} for f, a in chosen]
    if robot == "tfish":
        for drive in drives[:: int(rng.integers(2, 4))]:
            drive["bias_deg"] = float(rng.choice([-1, 1]) * rng.integers(6, 16))
    repeated = int(rng.integers(len(drives)))
    drives.insert(repeated + 1, dict(drives[repeated]))
    rate, duration = float(rng.choice([25.0, 30.0, 40.0, 50.0])), float(rng.integers(8, 16))
    held: Any = rng.choice(len(drives), size=rng.integers(1, 3), replace=False) if rng.random() < 0.5 else []
    spread = rng.uniform(0.005, 0.015), rng.uniform(0.2, 0.5), rng.uniform(0.002, 0.008)
    seed, trials = int(rng.integers(2**31)), []
    for i, drive in enumerate(drives):
        turn = rng.uniform(-np.pi, np.pi) if robot == "tfish" else np.radians(rng.uniform(-4.0, 4.0))
        start = (rng.uniform(-1.0, 1.0), rng.uniform(-0.5, 0.5), turn)
        found = Trial(f"run{i + 1:02d}", i, robot, drive, duration, rate, start, seed)
        found.role = "validate" if i in held else "fit"
        found.amplitude, found.thrust = spread[0] * rng.normal(size=2)
        found.trim = float(np.radians(spread[1]) * rng.normal())
        found.late = float(spread[2] * rng.normal())
        trials.append(found)
    return trials


def _noise(robot: str, rng: np.random.Generator) -> Noise:
    up, angle, rate = UP[robot]
    place, turn = rng.uniform(0.001, 0.003), np.radians(rng.uniform(0.3, 1.0))
    gyro, joint = np.radians(rng.uniform(0.5, 1.0)), np.radians(rng.uniform(0.2, 0.4))
    total = {"x_m": place, up: place, angle: turn, rate: gyro}
    total |= {f"joint{k}_rad": joint for k in range(1, 5)}
    share = rng.uniform(0.2, 0.5)
    coloured = {name: sd * np.sqrt(share) for name, sd in total.items()}
    white = {name: sd * np.sqrt(1.0 - share) for name, sd in total.items()}
    return Noise(white, coloured, float(rng.uniform(0.6, 0.9)))


def truth(robot: str, rng: np.random.Generator) -> dict[str, float]:
    """Coefficients of this animal: the published ones within a fifth or a quarter, and within bounds."""
    found = {}
    for name, (published, bound) in FITTED[robot].items():
        found[name] = min(published * float(np.exp(rng.uniform(np.log(0.8), np.log(1.25)))), 0.93 * bound)
    return found


def make_case(
    folder: str | Path,
    *,
    robot: str,
    effect: str | Sequence[str] | None,
    size: float | Sequence[float],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Write one case and return what is hidden in it.

    Parameters
    ----------
    folder : path
        Made if missing. Gets ``trials.yaml``, one log per trial and, in two thirds of the cases,
        ``params_prior.yaml``: a calibration of another day.
    robot : {"tfish", "dolphin"}
    effect : str, tuple of str or None
        Names in `CATALOGUE` or `OUTSIDE`, or ``parameter:NAME`` for a name in `CHANGED`.
    size : float, or one per effect
        About 0.3 barely visible, 1 clearly, 3 dominant. Of a parameter, its relative change.
    rng : numpy Generator

    Returns
    -------
    dict
        ``robot``, ``effects``, ``stages`` and ``sizes``; ``coefficients``; ``noise_sd`` per channel;
        ``gap_over_floor`` per channel and ``overall``: rms change the causes make to the noise-free channels,
        with the same coefficients, over the noise, a broken marker included; ``with`` and
        ``without``: those channels per trial id, the marker whole;
        ``columns`` and ``channels``: those logged, and those of them that a diagnosis can be held to;
        ``facts`` chosen at random; ``trials``, ``acts`` and ``noise``, for `swim_gap.Refit`.
    """
    names = () if effect is None else (effect,) if isinstance(effect, str) else tuple(effect)
    sizes = (size,) * len(names) if isinstance(size, int | float) else tuple(size)
    known = {**CATALOGUE[robot], **OUTSIDE[robot], **_changes(robot), **_ODD}
    acts = [known[name].make(rng, s, robot) for name, s in zip(names, sizes, strict=True)]
    trials, noise, coefficients = plan(robot, rng), _noise(robot, rng), truth(robot, rng)
    if set(names) & set(_ODD):
        rng.choice([trial for trial in trials if trial.role == "fit"]).is_odd = True
    factors, upper = _factors(acts), _bounds(robot)
    if factors:
        coefficients[SPRING[robot][0]] = SPRING[robot][1]
    for name, factor in factors.items():
        coefficients[name] = min(coefficients[name], 0.95 * upper[name] / factor)
    for act in acts:
        for trial in trials if act.start is not None else ():
            act.start(trial, rng)  # type: ignore[misc]
    columns = ["x_m", *UP[robot][:2]]
    if rng.random() < 0.5 or any(act.gyro for act in acts):
        columns.append(UP[robot][2])
    channels = list(columns)
    joints = rng.random()
    if joints < 0.3:
        count = {"tfish": 4, "dolphin": 3}[robot] - (joints < 0.15)
        columns += [f"joint{k}_rad" for k in range(1, count + 1)]
        if joints >= 0.15:
            channels.append(columns[-1])
    with_it = {t.id: swim(t, coefficients, acts) for t in trials}
    without = {t.id: swim(t, coefficients) for t in trials} if acts else with_it
    logs: dict[str, Channels] = {}
    drawn: dict[str, Channels] = {}
    for trial in trials:
        clean = with_it[trial.id]
        own = trial.rng("noise")
        drawn[trial.id] = {name: noise.draw(name, len(clean["t_s"]), own) for name in columns}
        log = {name: clean[name] + drawn[trial.id][name] for name in columns}
        logs[trial.id] = _broken(trial, acts, {"t_s": clean["t_s"], **log})
    swim_files.write_case(Path(folder), robot, trials, logs)
    covariance = None
    if factors:
        covariance = _write_fit(Path(folder) / "params_prior.yaml", robot, coefficients, noise, channels, rng)
    elif rng.random() < 2.0 / 3.0:
        swim_files.write_prior(Path(folder) / "params_prior.yaml", robot, coefficients, FITTED[robot], rng)
    sd = {name: noise.sd(name) for name in columns}
    of_held = {name: np.concatenate([drawn[t.id][name] for t in held_out(trials)]) for name in columns}
    shown = {t.id: _broken(t, acts, with_it[t.id]) for t in trials}
    gap = {name: rms_change(shown, without, name) / sd[name] for name in channels}
    return {
        "robot": robot,
        "effects": list(names),
        "stages": [known[name].stage for name in names],
        "sizes": list(sizes),
        "facts": {name: act.facts for name, act in zip(names, acts, strict=True)},
        "coefficients": coefficients,
        "truth": coefficients,
        "factors": factors,
        "known": covariance,
        "odd": next((t.id for t in trials if t.is_odd), None),
        "columns": columns,
        "channels": channels,
        "noise_sd": sd,
        "noise_rms": {name: float(np.sqrt(np.mean(v**2))) for name, v in of_held.items()},
        "gap_over_floor": {**gap, "overall": float(np.sqrt(np.mean(np.square(list(gap.values())))))},
        "with": with_it,
        "without": without,
        "noise_free": {f"{t.id}.csv": _noise_free(t, coefficients, acts, columns) for t in trials},
        "trials": trials,
        "acts": acts,
        "noise": noise,
    }


def plain(trial: Trial) -> Trial:
    """Return a trial without the scatter between trials."""
    return replace(trial, amplitude=0.0, thrust=0.0, trim=0.0, late=0.0)


def _factors(acts: Sequence[Act]) -> dict[str, float]:
    """Return the factor of each coefficient that has changed."""
    found: dict[str, float] = {}
    for act in acts:
        found |= act.factors
    return found


def _bounds(robot: str) -> dict[str, float]:
    """Return the upper bound of each coefficient and of the spring."""
    spring, _, _, bound = SPRING[robot]
    return {name: upper for name, (_, upper) in FITTED[robot].items()} | {spring: bound}


def _noise_free(trial: Trial, coefficients: dict[str, float], acts: Sequence[Act], columns: list[str]) -> str:
    """Return the log of a trial without noise and without scatter between trials."""
    fair = swim(plain(trial), coefficients, acts)
    return common.log_text(**{name: fair[name] for name in ("t_s", *columns)})


def _changes(robot: str) -> dict[str, Entry]:
    """Return the changed parameters of a robot as entries of a catalogue."""

    def entry(name: str) -> Entry:
        return Entry(lambda rng, size, robot: Act(factors={name: 1.0 + size}), (), "parameter")

    return {f"{PARAMETER}{name}": entry(name) for name in CHANGED[robot]}


def _write_fit(
    path: Path,
    robot: str,
    coefficients: dict[str, float],
    noise: Noise,
    channels: list[str],
    rng: np.random.Generator,
) -> np.ndarray:
    """Write the estimates of a fit to the trials of another day, and return the root of their covariance.

    The covariance is that of the relative errors, to first order. The other day has the same camera.
    """
    from validation.blind.swim_gap import Refit

    day = {"trials": plan(robot, rng), "noise": noise, "channels": channels, "coefficients": coefficients}
    covariance = Refit(day).covariance(len(coefficients))
    spring, _, unit, _ = SPRING[robot]
    upper = _bounds(robot)
    values = np.array(list(coefficients.values()))
    bounds = np.array([upper[name] for name in coefficients])
    estimates, stderr, correlation = common.draw_fit(values, covariance, bounds, rng)
    rows = {}
    units = dict.fromkeys(coefficients, "1") | {spring: unit}
    for name, value, error in zip(coefficients, estimates, stderr, strict=True):
        rows[name] = (value, error, units[name], "estimated")
    for name, value, unit in swim_files.FIXED[robot]:
        rows.setdefault(name, (value, 0.0, unit, "fixed"))
    common.write_parameters(path, "multilink", robot, rows, correlation)
    return np.linalg.cholesky(covariance)


def rms_change(with_it: dict[str, Channels], without: dict[str, Channels], name: str) -> float:
    """Root mean square difference of one channel over all samples of all trials that are not missing."""
    off = np.concatenate([with_it[key][name] - without[key][name] for key in with_it])
    return float(np.sqrt(np.nanmean(off**2)))
