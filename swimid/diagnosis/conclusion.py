"""From what was tried to what is said: verdict, causes, what remains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from swimid.diagnosis import candidates, remainder
from swimid.diagnosis.bench import errors
from swimid.diagnosis.candidates import Refitted
from swimid.diagnosis.chain import FORM, STEADY, Round, State, passes
from swimid.diagnosis.chance import CHANCE
from swimid.diagnosis.floor import by_channel
from swimid.diagnosis.result import Score, Verdict
from swimid.effects.base import STAGES

#: An effect this likely against the best is told as equivalent to it.
EQUIVALENT = 0.12
#: So is one of whose change this much looks the same, if it gains nearly as much.
COSINE, NEARLY = 0.97, 0.85
#: Largest set of equivalents that still is an answer: of more, the likeliest are told.
SET = 3
#: The best explains the gap when what a generic description still finds is at most this share of it.
REMAINDER = 0.3
#: Something that moves this much more than noise is left whatever was found.
STRONG = 3.0
#: Trials that differ by so many times what chance may make them do not differ by chance.
DIFFERS = 2.0
#: Of answers that the evidence alone would make sure, so many name another cause than the true one: a true
#: effect never has quite its form in the catalogue, or is not in it. Read off blind cases with known causes.
MISTAKEN = 0.15
#: Softmax weight that the leader alone needs for a clear verdict.
CLEAR = 0.55


@dataclass(frozen=True)
class Named:
    """An effect chosen in a round, with its rivals there; the likeliest of them if they are too many.

    Attributes
    ----------
    probability : float
        Softmax weight of the effect and its equivalents, times ``1 - MISTAKEN``; no posterior probability.
    alone : float
        Softmax weight of the best alone.
    """

    best: Refitted
    equivalent: tuple[str, ...]
    probability: float
    alone: float
    found: Round
    crowded: bool = False

    @property
    def steady(self) -> bool:
        """Whether it helps in every held-out fold."""
        return self.best.lost <= STEADY * self.best.gain


def named(state: State, found: Round, unknown: float) -> Named:
    """The effect a round chose, those it cannot be told from, and their weight.

    Parameters
    ----------
    unknown : float
        Share of what can be found at all that no chosen effect accounts for.
    """
    best = found.ranked[0]
    weight = _by_name(found)
    name = best.tried.effect.name
    rivals = []
    for other in found.ranked[1:]:
        own = other.tried.effect.name
        if own == name or own in rivals:
            continue
        close = weight[own] >= EQUIVALENT
        if not close and other.gain > NEARLY * best.gain:
            close = (
                abs(candidates.alike(state.bench, found.base, found.lens, best.tried, other.tried)) > COSINE
            )
        if close:
            rivals.append(own)
    total = sum(weight.values())
    shown = sorted(rivals, key=lambda n: -weight[n])[: SET - 1]
    inside = sum(weight[n] for n in (name, *shown))
    alone = weight[name] / total
    known = 1.0 - unknown
    probability, alone = (1.0 - MISTAKEN) * known * inside / total, known * alone
    return Named(best, tuple(shown), probability, alone, found, crowded=len(rivals) > len(shown))


def _by_name(found: Round) -> dict[str, float]:
    """Softmax weight of each effect, its best variant's, against the best of all.

    The temperature grows with the best one's own merit: no likelihood, hence no posterior probability.
    """
    best = found.ranked[0]
    top = best.merit
    # an effect of unlike form would not leave many times what another leaves
    scale = max(2.0, min(FORM * top, best.fit.cost))
    weight: dict[str, float] = {}
    for r in found.ranked:
        w = float(np.exp(min(r.merit - top, 0.0) / scale))
        name = r.tried.effect.name
        weight[name] = max(weight.get(name, 0.0), w)
    return weight


def scores(state: State) -> tuple[Score, ...]:
    """How every effect did in the first round."""
    if not state.rounds:
        return ()
    found = state.rounds[0]
    weight = _by_name(found) if found.ranked else {}
    total = sum(weight.values()) or 1.0
    rows: dict[str, Score] = {}
    for r in found.ranked:
        e = r.tried.effect
        if e.name in rows:
            continue
        rows[e.name] = Score(
            e.name,
            e.stage,
            ", ".join(p.name for p in r.tried.parameters),
            r.gain,
            r.stderr,
            (int(np.sum(r.gains > 0)), len(r.gains)),
            r.tried.absorbed,
            r.tried.gain,
            True,
            weight[e.name] / total if r.gain > found.threshold else 0.0,
        )
    for t in found.screen.tried:
        e = t.effect
        if e.name not in rows:
            rows[e.name] = Score(
                e.name, e.stage, ", ".join(p.name for p in t.parameters), t.gain, float("nan"),
                (int(np.sum(t.gains > 0)), len(t.gains)), t.absorbed, t.gain, False, 0.0,
            )  # fmt: skip
    return tuple(sorted(rows.values(), key=lambda s: (not s.refitted, -s.gain)))


def stages(rows: Sequence[Score], gap: bool, applied: set[str]) -> dict[str, float]:
    """Share of the evidence each stage of the chain has."""
    shares: dict[str, float] = {stage: 0.0 for stage in STAGES if stage != "rig" or "rig" in applied}
    if not gap:
        return shares
    for row in rows:
        if row.stage in shares:
            shares[row.stage] += row.probability
    total = sum(shares.values())
    return {k: v / total if total > 0 else 0.0 for k, v in shares.items()}


def unknown_share(state: State) -> float:
    """Share of what can be found at all that no chosen effect accounts for."""
    left = state.left
    if left is None or not left.found:
        return 0.0
    gained = sum(r.ranked[0].gain for r in state.rounds if r.ranked and passes(state, r))
    return float(np.clip(left.gain / max(left.gain + gained, 1e-300), 0.0, 1.0))


def structured_share(state: State) -> float:
    """Share of the final squared residuals through the lens that a generic description still finds."""
    left = state.left
    if left is None or not left.found:
        return 0.0
    whole = sum(
        float(np.sum(state.lens.through(state.base.problem, k, r) ** 2))
        for k, r in enumerate(state.base.residuals)
    )
    return float(np.clip(left.gain / max(whole, 1e-300), 0.0, 1.0))


def stays(state: State, channel: str) -> float:
    """Share of a channel's squared residuals that stays once the causes are in the model."""
    fits = (state.rounds[0].base, state.base)
    before, after = (float(np.sum(by_channel(fit, fit.residuals)[channel] ** 2)) for fit in fits)
    return after / max(before, 1e-300)


def structured(state: State) -> bool:
    """Whether what is left in the end is more than noise."""
    return bool((state.left is not None and state.left.found) or remainder.moves(state.slow))


def verdict(state: State, chosen: Sequence[Named], share: float, *, dropout: bool) -> Verdict:
    """The verdict in one word."""
    found = state.left is not None and state.left.found
    moving = remainder.moves(state.slow)
    if not chosen:
        if dropout:
            return "explained"
        return "unexplained" if structured(state) or differs(state) else "none"
    if (found and share > REMAINDER) or any(
        state.slow[c].ratio > STRONG and stays(state, c) > REMAINDER for c in moving
    ):
        return "unexplained"
    first = chosen[0]
    if first.crowded or first.alone < CLEAR:
        return "ambiguous"
    return "explained"


def differs(state: State) -> list[str]:
    """In what the trials differ by more than chance would make them."""
    return [kind.name for kind in state.chance if kind.sd > DIFFERS * CHANCE]


def parameter_errors(state: State) -> Mapping[str, float]:
    """Standard errors of the final fit's numbers, by label."""
    _, weight = state.bench.expected(state.base.problem)
    sd = errors(state.base, state.lens, weight)
    return dict(zip(state.base.labels, sd, strict=True))
