"""How visible a hidden cause is once the nominal coefficients have been fitted again."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

from validation.blind.common import PARAMETER, candidates, fit_covariance, left_by_each
from validation.blind.swim_case import Act, Channels, Maker, Trial, held_out
from validation.blind.swim_sensing import UP
from validation.blind.swimmers import CATALOGUE, Noise, swim

#: Step of the differences in the logarithm of a coefficient, and its prior's standard deviation.
STEP, PRIOR = 0.03, 0.6
#: Standard deviations of the scatter between trials: amplitude, thrust, trim (rad), clock (s).
SCATTER = {"amplitude": 0.01, "thrust": 0.01, "trim": np.radians(0.35), "late": 0.005}
COARSE_S = 0.004


def _whitener(noise: Noise, name: str, n: int) -> np.ndarray:
    column = noise.coloured[name] ** 2 * noise.pole ** np.arange(n)
    column[0] += noise.white[name] ** 2
    return cholesky(toeplitz(column), lower=True)


def _started(trial: Trial, base: Channels) -> list[Channels]:
    """What a shift or turn of the start pose does to the channels."""
    up, angle, _ = UP[trial.robot]
    off = base["x_m"] - base["x_m"][0] + 1j * (base[up] - base[up][0])
    one = np.ones(len(off))
    return [{"x_m": one}, {up: one}, {"x_m": -off.imag, up: off.real, angle: one}]


class Refit:
    """What a refit of the nominal model and the scatter between trials can imitate, to first order.

    Parameters
    ----------
    label : dict
        Of `swimmers.make_case`. With ``known``, the square root of a covariance, the coefficients have the
        prior of a fit to other trials.
    """

    def __init__(self, label: dict[str, Any]) -> None:
        self.trials, self.noise, self.names = label["trials"], label["noise"], label["channels"]
        keys = list(label["coefficients"])
        self.width = len(keys) + 7 * len(self.trials)
        self.blocks: dict[tuple[str, str], np.ndarray] = {}
        self.roots: dict[tuple[str, int], np.ndarray] = {}
        self.penalty = np.ones(self.width)
        for place, trial in enumerate(self.trials):
            at = len(keys) + 7 * place
            self.penalty[at + 4 : at + 7] = 1e-4
            for column, change in self._changes(trial, label["coefficients"], at).items():
                for name in self.names:
                    n = round(trial.duration_s * trial.rate_hz) + 1
                    block = self.blocks.setdefault((trial.id, name), np.zeros((n, self.width)))
                    block[:, column] = change.get(name, 0.0)
                    if (name, n) not in self.roots:
                        self.roots[name, n] = _whitener(self.noise, name, n)
        whitened = [self._whiten(key[1], block) for key, block in self.blocks.items()]
        # changes by one coefficient each, for a comparison with the change of a coefficient
        alone = np.vstack([*whitened, np.zeros((self.width, self.width))])
        self.slopes = {f"{PARAMETER}{key}": alone[:, [k]] for k, key in enumerate(keys)}
        known = label.get("known")
        if known is not None:
            for block in (*self.blocks.values(), *whitened):
                block[:, : len(keys)] = block[:, : len(keys)] / PRIOR @ known
        self.system = np.vstack([*whitened, np.diag(self.penalty)])

    def _changes(self, trial: Trial, coefficients: dict[str, float], at: int) -> dict[int, Channels]:
        base = swim(trial, coefficients, step_s=COARSE_S)
        found: dict[int, Channels] = {}
        for k, (key, value) in enumerate(coefficients.items()):
            moved = swim(trial, {**coefficients, key: value * np.exp(STEP)}, step_s=COARSE_S)
            found[k] = {n: (moved[n] - base[n]) * PRIOR / STEP for n in self.names}
        for k, (key, spread) in enumerate(SCATTER.items()):
            other = replace(trial, **{key: getattr(trial, key) + spread})
            moved = swim(other, coefficients, step_s=COARSE_S)
            found[at + k] = {n: moved[n] - base[n] for n in self.names}
        for k, change in enumerate(_started(trial, base)):
            found[at + 4 + k] = change
        return found

    def covariance(self, count: int) -> np.ndarray:
        """Return the covariance of the relative errors of the first ``count`` coefficients in a fit."""
        return PRIOR**2 * fit_covariance(self.system, count)

    def _whiten(self, name: str, values: np.ndarray) -> np.ndarray:
        return solve_triangular(self.roots[name, len(values)], values, lower=True)

    def left(self, with_it: dict[str, Channels], without: dict[str, Channels]) -> dict[str, Any]:
        """Linearised gap after the refit.

        Returns
        -------
        dict
            ``noncentrality``, the squared whitened length of what is left: that of a chi-square test;
            ``raw``, the same before the refit; ``refit_over_floor`` per channel, rms of what is left over
            the noise.
        """
        change = {key: with_it[key[0]][key[1]] - without[key[0]][key[1]] for key in self.blocks}
        whole = self._stacked(change)
        answer, *_ = np.linalg.lstsq(self.system, whole, rcond=None)
        rest = whole - self.system @ answer
        over = {}
        for name in self.names:
            off = [change[k] - self.blocks[k] @ answer for k in self.blocks if k[1] == name]
            over[name] = float(np.sqrt(np.mean(np.concatenate(off) ** 2)) / self.noise.sd(name))
        total = {"noncentrality": float(rest @ rest), "raw": float(whole @ whole)}
        return {**total, "refit_over_floor": over}

    def _stacked(self, change: dict[tuple[str, str], np.ndarray]) -> np.ndarray:
        white = [self._whiten(key[1], values) for key, values in change.items()]
        return np.concatenate([*white, np.zeros(self.width)])

    def singles(self, label: dict[str, Any]) -> dict[str, float]:
        """Return the noncentrality that a refit with each other explanation leaves of the case's causes.

        Those of a pair are single effects; a failed marker is compared with the other effect alone. Those of
        a changed parameter are changes of single other parameters.
        """
        robot, coefficients = label["robot"], label["coefficients"]
        acts = dict(zip(label["effects"], label["acts"], strict=True))
        others = {name: column for name, column in self.slopes.items() if name not in acts}
        base = {t.id: swim(t, coefficients, step_s=COARSE_S) for t in self.trials}

        def stacked(moved: dict[str, Channels], base: dict[str, Channels]) -> np.ndarray:
            return self._stacked({k: moved[k[0]][k[1]] - base[k[0]][k[1]] for k in self.blocks})

        def change_of(act: Act) -> list[np.ndarray]:
            moved = {t.id: swim(t, coefficients, [act], step_s=COARSE_S) for t in self.trials}
            return [stacked(moved, base)]

        whole = stacked(label["with"], label["without"])
        if len(acts) == 1:
            return left_by_each(self.system, whole, others)
        broken = [name for name, act in acts.items() if act.broken is not None]
        if broken:
            (other,) = acts.keys() - set(broken)
            failed = self._failed(label)
            left = left_by_each(self.system, whole, {broken[0]: np.zeros((len(whole), 1))})
            return {**left, other: failed}
        catalogue = {}
        for name, entry in CATALOGUE[robot].items():
            example = entry.make(np.random.default_rng(0), 1.0, robot)
            if example.start is None and example.broken is None:
                catalogue[name] = (partial(_make, entry.make, robot), [])
        drawn = candidates(catalogue, acts, change_of)
        columns = {name: np.stack([draw[0] for draw in draws], axis=1) for name, draws in drawn.items()}
        return left_by_each(self.system, whole, columns)

    def _failed(self, label: dict[str, Any]) -> float:
        """Return the squared errors of a failed marker in units of the noise variance."""
        samples = sum(len(block) for block in self.blocks.values())
        squared = label["gap_over_floor"]["overall"] ** 2 * samples
        for trial, name in self.blocks:
            off = label["with"][trial][name] - label["without"][trial][name]
            squared -= float(np.sum((off / self.noise.sd(name)) ** 2))
        return max(squared, 0.0)


def _make(maker: Maker, robot: str, size: float, rng: np.random.Generator) -> Act:
    """Return an act by the maker of a swimmer, with the arguments of the makers of rigs."""
    return maker(rng, size, robot)


def refit_gap(label: dict[str, Any]) -> dict[str, Any]:
    """Return :meth:`Refit.left` of a case, and :meth:`Refit.singles` of a pair or a changed parameter."""
    refit = Refit(label)
    found = refit.left(label["with"], label["without"])
    if len(label["effects"]) == 2 or label["factors"]:
        found["singles"] = refit.singles(label)
    return found


def floors(label: dict[str, Any]) -> dict[str, float]:
    """Noise of these very samples in each channel, and what the scatter between trials adds to it once start
    poses are fitted: of the trials that are held out, where there are any, else of all.
    """
    names, squares = label["channels"], {name: [] for name in label["channels"]}
    for trial in held_out(label["trials"]):
        plain = replace(trial, **dict.fromkeys(SCATTER, 0.0))
        seen, fair = label["with"][trial.id], swim(plain, label["coefficients"], label["acts"])
        change = np.concatenate([seen[n] - fair[n] for n in names])
        starts = [
            np.concatenate([c.get(n, 0.0) * np.ones(len(fair[n])) for n in names])
            for c in _started(trial, fair)
        ]
        columns = np.column_stack(starts)
        sd = np.concatenate([np.full(len(fair[n]), label["noise"].sd(n)) for n in names])
        rest = change - columns @ np.linalg.lstsq(columns / sd[:, None], change / sd, rcond=None)[0]
        for name, part in zip(names, np.split(rest, len(names)), strict=True):
            squares[name].append(part**2)
    return {
        n: float(np.hypot(label["noise_rms"][n], np.sqrt(np.mean(np.concatenate(v)))))
        for n, v in squares.items()
    }
