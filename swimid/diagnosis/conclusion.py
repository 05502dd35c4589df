"""From what was tried to what is said: verdict, causes, what remains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from swimid.diagnosis.candidates import Refitted, Tried
from swimid.diagnosis.context import Fit, covariance
from swimid.diagnosis.gap_file import Hypothesis, Score, Stage
from swimid.diagnosis.noise_model import NoiseModel, coloured
from swimid.diagnosis.search import Round, State
from swimid.effects.base import STAGES
from swimid.fitting.model import Array
from swimid.fitting.sandwich import sandwich

#: Effects that cannot be told from a cause are the fewest that with it make up so much of the probability.
CREDIBLE = 0.9
#: Largest such set that still is an answer: of more, the likeliest are told.
SET = 3
#: Trials that differ by so many times what chance may make them do not differ by chance.
DIFFERS = 2.0


@dataclass(frozen=True)
class Named:
    """A cause, with its rivals.

    Attributes
    ----------
    probability : float
        That it, or one of its equivalents, is among what the model lacks.
    closing : float
        That it, or one of these, closes most of what is closed, even if only as an imitation of something
        from outside the catalogue.
    alone : float
        Probability of it, and of those that change the trials just like it, against its rivals, the other
        causes given.
    crowded : bool
        Whether more effects than are told cannot be told from it.
    """

    best: Refitted
    equivalent: tuple[str, ...]
    probability: float
    closing: float
    alone: float
    crowded: bool = False

    @property
    def alike(self) -> tuple[str, ...]:
        """The cause and those that cannot be told from it."""
        return (self.best.tried.effect.name, *self.equivalent)


def named(state: State, found: Round) -> Named:
    """The cause of a round and those that cannot be told from it."""
    best = found.ranked[0]
    name = best.tried.effect.name
    posterior = state.posterior
    exact = best.tried.effect.adds_to is not None
    share = posterior.instead(name, frozenset(e.name for e in state.base.effects), exact=exact)
    order = [name, *(n for n in share if n != name)]
    before = np.cumsum([0.0, *(share[n] for n in order[:-1])])
    alike = [n for n, sum_before in zip(order, before, strict=True) if sum_before < CREDIBLE]
    shown = list(dict.fromkeys([name, *found.same, *alike]))[:SET]
    return Named(
        best,
        tuple(shown[1:]),
        posterior.having(*shown),
        posterior.closing(*shown),
        share[name] + sum(share.get(n, 0.0) for n in found.same),
        len(alike) > SET,
    )


def scores(state: State) -> list[Score]:
    """How every effect did alone."""
    rows: dict[str, Score] = {}
    for r in state.singles.ranked:
        name = r.tried.effect.name
        if name not in rows:
            rows[name] = _score(r.tried, r.gains, r.stderr, state.posterior.having(name), refitted=True)
    for t in state.singles.screen.tried:
        if t.effect.name not in rows:
            rows[t.effect.name] = _score(t, t.gains, None, 0.0, refitted=False)
    return list(rows.values())


def _score(tried: Tried, gains: Array, stderr: float | None, probability: float, *, refitted: bool) -> Score:
    return Score(
        effect=tried.effect.name,
        stage=tried.effect.stage,
        variant=", ".join(p.name for p in tried.parameters),
        gain=float(gains.sum()),
        stderr=stderr,
        won=(int(np.sum(gains > 0)), len(gains)),
        absorbed=tried.absorbed,
        screened=tried.gain,
        refitted=refitted,
        probability=probability,
    )


def hypotheses(state: State) -> list[Hypothesis]:
    """Every set of effects that was weighed, the model as it is first."""
    found = state.posterior
    return [
        Hypothesis(
            effects=sorted(c.names),
            numbers=c.numbers,
            score=c.score,
            slow=c.slow,
            alike=dict(c.alike),
            folds=c.folds.tolist(),
            probability=found.sets.get(c.names, found.none),
        )
        for c in found.candidates
    ]


def stages(rows: Sequence[Score], *, gap: bool) -> dict[Stage, float]:
    """Share of the evidence each stage of the chain has."""
    applied = {row.stage for row in rows}
    shares = {stage: 0.0 for stage in STAGES if stage != "rig" or "rig" in applied}
    if not gap:
        return shares
    for row in rows:
        if row.stage in shares:
            shares[row.stage] += row.probability or 0.0
    total = sum(shares.values())
    return {k: v / total if total > 0 else 0.0 for k, v in shares.items()}


def structured_share(state: State) -> float:
    """Share of the final squared whitened residuals that a generic description still finds."""
    left = state.left
    if left is None or not left.found:
        return 0.0
    whole = sum(
        float(np.sum(state.noise_model.whiten(state.base.problem, k, r) ** 2))
        for k, r in enumerate(state.base.residuals)
    )
    return float(np.clip(left.gain / max(whole, 1e-300), 0.0, 1.0))


def differs(state: State) -> list[str]:
    """In what the trials surely differ by more than chance would make them."""
    # two standard errors of a standard deviation
    least = 1.0 - 2.0 / np.sqrt(2.0 * len(state.context.trials))
    return [kind.name for kind in state.random_effects if least * kind.sd > DIFFERS * kind.most]


def parameter_errors(state: State, fit: Fit) -> Mapping[str, float]:
    """Return the standard errors of a fit's parameters by label.

    That of the new value of a changed parameter stands under the name of its effect.

    The residuals of a few trials are correlated, be it noise or gap: the errors are larger by that.
    """
    # the rows that give the parameters themselves, and each changed parameter with its change
    names, rows = list(fit.labels), list(np.eye(len(fit.labels)))
    for effect in fit.effects:
        if effect.adds_to is not None:
            parts = (effect.adds_to, f"{effect.name}/change")
            names.append(effect.name)
            rows.append(np.isin(fit.labels, parts).astype(float))
    combined = np.array(rows)

    def errors(covariance: Array) -> Array:
        variance = np.einsum("ij,jk,ik->i", combined, covariance, combined)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    sd = errors(covariance(fit, state.noise_model, state.context.precision(fit.problem)))
    if state.noise_model.long_memory is not None:
        scale = fit.problem.scale
        colour = coloured(fit.problem, fit.residuals, NoiseModel(state.noise_model.sd)).colour
        derivatives = [r * scale for r in fit.rows]
        robust = sandwich(fit.problem, derivatives, list(fit.residuals), dict(colour)).covariance
        sd = np.fmax(sd, errors(scale[:, None] * robust * scale))
    return dict(zip(names, sd, strict=True))
