"""Which parameters the trials determine, which only together, and in what order.

Everything here follows from the information matrix of the fit: the inverse of the covariance,
which stays finite where the covariance does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg
from scipy.sparse import csgraph

from swimid.fitting import output_error
from swimid.fitting.fit_result import FitResult
from swimid.fitting.model import Array
from swimid.fitting.output_error import UNIDENTIFIABLE
from swimid.fitting.sandwich import orthogonal_part
from swimid.progress import Progress, silent
from swimid.results import numbers

#: Directions seen less than this, relatively to the one seen best, are not seen.
UNSEEN = 1e-7
#: A standard error above this share of a parameter's size lets it be part of a confounded group.
VAGUE = 0.5 * UNIDENTIFIABLE
#: Weights of a combination below this share of the largest are left out.
NEGLIGIBLE = 0.01


@dataclass(frozen=True)
class Combination:
    """A weighted sum of parameters that is known though its members are not."""

    #: Dict of label to float: the largest is 1, where units differ that of the most important; those of the
    #: parameters over :attr:`divisors` then.
    weights: dict[str, float]
    #: The confounded parameters it belongs to, those of negligible weight too.
    members: tuple[str, ...]
    value: float
    stderr: float
    #: Of the member whose weight is 1; none where units differ.
    unit: str
    #: Dict of label to str: where units differ, what each member is divided by to have none: its size, with
    #: its unit.
    divisors: dict[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The sum in words, ``c_f0 + 0.31 c_f13 = 0.0123 ± 0.0002``."""
        terms = ""
        for label, weight in self.weights.items():
            divisor = self.divisors.get(label, "")
            label = f"{label}/({divisor})" if divisor else label
            factor = f"{abs(weight):.2g} ".removeprefix("1 ")
            sign = ("-" if weight < 0 else "") if not terms else (" - " if weight < 0 else " + ")
            terms += f"{sign}{factor}{label}"
        return f"{terms} = {numbers.measured(self.value, self.stderr, self.unit)}"


def unidentifiable(result: FitResult) -> list[str]:
    """Labels of the numbers the trials do not determine."""
    return [label for label in result.labels if result.status[label] == "unidentifiable"]


def confounded(result: FitResult) -> list[tuple[str, ...]]:
    """Groups of parameters that the trials cannot tell apart.

    Each has an unidentifiable member and one that all trials share; others belong to it when they
    share its uncertainty and are themselves not known to :data:`VAGUE` of their size. A parameter
    the trials do not see at all is in no group, nor is a random effect.
    """
    index = [i for i in _usable(result) if math.isinf(result.parameter(result.labels[i]).spread)]
    vague = [i for i in index if np.linalg.norm(_marginal(result, [i])) * VAGUE < 1.0]
    if len(vague) < 2:
        return []
    _, singular, vt = np.linalg.svd(_marginal(result, vague))
    dark = vt[singular * UNIDENTIFIABLE < 1.0]
    overlap = np.abs(dark.T @ dark) > 0.02
    _, numbers = csgraph.connected_components(overlap, directed=False)
    groups = [
        tuple(result.labels[i] for i, g in zip(vague, numbers, strict=True) if g == n) for n in set(numbers)
    ]
    unknown = set(unidentifiable(result))
    groups = [g for g in groups if len(g) > 1 and unknown & set(g) and any("[" not in label for label in g)]
    return sorted(groups, key=lambda g: result.labels.index(g[0]))


def combinations(result: FitResult) -> list[Combination]:
    """For each group of confounded parameters, the weighted sum the trials determine best.

    Groups no sum of which is known are left out. The sum is the eigenvector of the group's
    information, all other parameters free, with parameters scaled to their sizes.
    """
    found = []
    for group in confounded(result):
        index = [result.labels.index(label) for label in group]
        size = _sizes(result)[index]
        _, singular, vt = np.linalg.svd(_marginal(result, index), full_matrices=False)
        if singular[0] * UNIDENTIFIABLE < 1.0:
            continue
        kept = np.where(np.abs(vt[0]) < NEGLIGIBLE * np.abs(vt[0]).max(), 0.0, vt[0])
        direction = kept if _sd(kept, singular, vt) * singular[0] <= 1.1 else vt[0]
        units = [result.parameter(g).unit for g in group]
        alike = len(set(units)) == 1
        counted, divisors = np.ones(len(group)), {}
        if not alike:
            # quantities of different units cannot be added: each is then counted in its own size, to two
            # digits, so that the sum can be computed from its words
            short = [f"{s:.2g}" for s in size]
            words = [t if unit == "1" else f"{t} {unit}" for t, unit in zip(short, units, strict=True)]
            counted, divisors = np.array([float(t) for t in short]), dict(zip(group, words, strict=True))
        weights = direction * counted / size
        one = float(weights[np.argmax(np.abs(weights))])
        weights /= one
        found.append(
            Combination(
                weights={g: float(w) for g, w in zip(group, weights, strict=True) if w != 0},
                members=group,
                value=float(weights @ (result.estimate[index] / counted)),
                stderr=_sd(direction, singular, vt) / abs(one),
                unit=units[0] if alike else "1",
                divisors=divisors,
            )
        )
    return found


def sentences(result: FitResult) -> list[str]:
    """What the trials cannot tell, and what they tell instead, for the report."""
    known = {c.members: c for c in combinations(result)}
    said, grouped = [], set()
    for group in confounded(result):
        grouped |= set(group)
        names = f"{', '.join(group[:-1])} and {group[-1]}"
        if group in known:
            said.append(f"{names} cannot be told apart from these trials; known is {known[group].text}")
        else:
            said.append(f"{names} cannot be told apart from these trials, and no sum of them is known")
    alone = [label for label in unidentifiable(result) if label not in grouped]
    own = [label.partition("[") for label in alone if "[" in label]
    for name in dict.fromkeys(name for name, _, _ in own):
        trials = [trial.rstrip("]") for other, _, trial in own if other == name]
        said.append(f"{name} is not identifiable in {', '.join(trials)}")
    return said + [f"{label} is not identifiable from these trials" for label in alone if "[" not in label]


def ranked(result: FitResult) -> list[tuple[str, float]]:
    """Shared parameters from the best to the least identifiable, by pivoted QR decomposition.

    Returns
    -------
    list of (label, share)
        ``share`` is the part of the residuals' sensitivity to a parameter that those ranked
        before it, and the numbers of single trials, cannot imitate: 1 for one all of its own,
        0 for one wholly confounded. Parameters their bound holds are left out.

    Notes
    -----
    On the sensitivities scaled by the parameters' sizes (Lund and Foss, "Parameter ranking by
    orthogonalization", Automatica 2008).
    """
    index = [i for i in _usable(result) if "[" not in result.labels[i]]
    if not index:
        return []
    whole = np.linalg.norm((result.information_root * _sizes(result))[:, index], axis=0)
    r, order = linalg.qr(_marginal(result, index), mode="r", pivoting=True)
    own = np.zeros(len(index))
    own[: min(r.shape)] = np.abs(np.diag(r))
    return [
        (result.labels[index[j]], float(own[k] / whole[j]) if whole[j] > 0 else 0.0)
        for k, j in enumerate(order)
    ]


def select_subset(
    result: FitResult, *, jobs: int | None = None, progress: Progress = silent
) -> tuple[FitResult, list[str]]:
    """Fix the least identifiable parameters until the trials determine all the others; with their names.

    One at a time the lowest ranked of those not identifiable is fixed at its start value and
    the others are fitted again.

    Raises
    ------
    NoTrustworthyResult
        When a fit does not converge.
    """
    fixed: list[str] = []
    while not result.interrupted:
        weak = [label for label, _ in ranked(result) if result.status[label] == "unidentifiable"]
        if not weak:
            break
        fixed.append(weak[-1])
        begin = np.array([v for v, k in zip(result.estimate, result.labels, strict=True) if k != weak[-1]])
        result = output_error.fit(
            result.model,
            result.trials,
            parameters=[replace(p, free=p.free and p.name != weak[-1]) for p in result.parameters],
            progress=progress,
            jobs=jobs,
            loss=result.loss,
            begin=begin,
        )
    return result, fixed


def _sizes(result: FitResult) -> Array:
    """Size of each number: its value, or its parameter's scale where that is larger."""
    return np.maximum(np.abs(result.estimate), [result.parameter(label).scale for label in result.labels])


def _usable(result: FitResult) -> list[int]:
    """Numbers not held by their bound; none where a result was rewritten without its information."""
    if result.information_root.shape[1] != len(result.labels):
        return []
    return [int(i) for i in np.flatnonzero(np.isfinite(result.information_root).all(axis=0))]


def _marginal(result: FitResult, index: Sequence[int]) -> Array:
    """Square root of the information about some numbers, all others free, scaled by size."""
    scaled = result.information_root * _sizes(result)
    others = [i for i in _usable(result) if i not in index]
    chosen = scaled[:, list(index)]
    return orthogonal_part(scaled[:, others], chosen, UNSEEN) if others else chosen


def _sd(direction: Array, singular: Array, vt: Array) -> float:
    """Standard error of a sum of scaled parameters under the information ``vt' s^2 vt``."""
    parts = vt @ direction
    floor = np.maximum(singular, UNSEEN * singular[0])
    return float(np.linalg.norm(parts / floor))
