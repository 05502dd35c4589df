"""``python -m validation.calibrate OUT [OUT ...]``: the constants of the probabilities, from blind cases.

OUT are folders that ``python -m validation.blind`` has filled. Every case with a single effect is judged once
more with that effect hidden from the catalogue (leave one effect out), so that the cause is outside of it.
The constants are those under which the truth is likeliest.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML
from scipy.optimize import minimize

from swimid.diagnosis import posterior
from swimid.diagnosis.posterior import Candidate, DataSize, Posterior, PosteriorConstants
from validation.blind import runner

#: What an effect must lower the score by for its case to tell anything of it.
SEEN = 20.0
#: A hidden effect has a twin where its best rival leaves no more than this share of what it leaves itself,
#: and what is seen, beyond it.
TWIN = 0.1
#: Share of answers that are right by chance: no single case decides.
CHANCE = 0.004
#: Standard deviation of what is known of a constant, or of the logarithm of a positive one, before any case.
WIDE = 1.5


@dataclass(frozen=True)
class Truth:
    """A case and what is true of it.

    Attributes
    ----------
    null : Candidate
    candidates : list of Candidate
    true : tuple of frozenset of str
        The effects, and sets of them that leave nothing that is seen; empty where the cause is outside the
        catalogue.
    hidden : bool
        Whether the case is of an effect that is hidden from the catalogue.
    small : bool
        Whether there might as well be no gap.
    """

    null: Candidate
    candidates: list[Candidate]
    record: DataSize
    true: tuple[frozenset[str], ...]
    hidden: bool = False
    small: bool = False

    def probability(self, known: PosteriorConstants) -> float:
        """What the truth is given."""
        found = posterior.compute_posterior_probabilities(
            self.null, self.candidates, record=self.record, calibration=known
        )
        p = sum(self.answers(found).get(names, 0.0) for names in self.true) if self.true else found.outside
        return p + (self.small and frozenset() not in self.true) * found.none

    @staticmethod
    def answers(found: Posterior) -> dict[frozenset[str] | None, float]:
        """How likely each is; None is a cause from outside."""
        return {**found.sets, frozenset(): found.none, None: found.outside}

    def right(self, answer: frozenset[str] | None) -> bool:
        """Whether an answer is true."""
        if self.small and answer == frozenset():
            return True
        return answer in self.true if self.true else answer is None


def read(folders: Iterable[Path]) -> list[Truth]:
    """The cases of folders, with hidden effects, too."""
    found = []
    for folder in folders:
        for place in sorted((folder / "results").glob("*/gap.yaml")):
            gap = YAML(typ="safe").load(place.read_text())
            label = runner.label_of(folder / "labels" / f"{place.parent.name}.json")
            rows = [
                Candidate(
                    frozenset(h["effects"]),
                    np.array(h["deviances"]),
                    h["strain"],
                    h["numbers"],
                    h.get("widening", 0.0),
                    h.get("alike", {}),
                )
                for h in gap["hypotheses"]
            ]
            record = DataSize(gap["samples"], len(rows[0].deviances), gap["tried"])
            found += truths(rows, label["kind"], label["effects"], record)
    return found


def truths(rows: Sequence[Candidate], kind: str, effects: Sequence[str], record: DataSize) -> list[Truth]:
    """What one case tells."""
    null, *rest = rows
    true = frozenset(effects)
    if "marker-dropout" in true:
        return []
    best = min(c.deviance for c in rows)
    if kind == "clean":
        return [Truth(null, rest, record, (frozenset(),))]
    if kind == "outside":
        return [Truth(null, rest, record, (), small=null.deviance - best < SEEN)]
    mine = [c for c in rest if c.names <= true]
    if not mine:
        return []
    least = min(c.deviance for c in mine)
    small = null.deviance - least < SEEN
    told = tuple(c.names for c in mine if c.deviance - least < SEEN)
    found = [Truth(null, rest, record, told, small=small)]
    without = [c for c in rest if not c.names & true]
    nearest = min((c.deviance for c in without), default=null.deviance)
    alike = SEEN + TWIN * max(least - record.samples, 0.0)
    if kind == "single" and not small and nearest - least > alike:
        found.append(Truth(null, without, record, (), hidden=True))
    return found


def weights(cases: Sequence[Truth]) -> np.ndarray:
    """Of each case: all with a cause from outside, made or hidden, together as those that were made so."""
    foreign = np.array([not c.true for c in cases])
    hidden = np.array([c.hidden for c in cases])
    share = (foreign & ~hidden).sum() / max(foreign.sum(), 1)
    return np.where(foreign, max(float(share), 1.0 / len(cases)), 1.0)


def calibrated(cases: Sequence[Truth], start: PosteriorConstants) -> PosteriorConstants:
    """The constants under which what is true is likeliest."""
    begin = np.array([np.log(start.directions), np.log(start.form), start.outside])
    weight = weights(cases)

    def loss(x: np.ndarray) -> float:
        known = _constants(x)
        p = np.array([c.probability(known) for c in cases])
        told = float(-weight @ np.log((1.0 - CHANCE) * p + CHANCE))
        return told + 0.5 * float(np.sum(((x - begin) / WIDE) ** 2))

    simplex = np.vstack((begin, begin + 0.5 * np.eye(len(begin))))
    options = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 0.01, "maxfev": 2000}
    return _constants(minimize(loss, begin, method="Nelder-Mead", options=options).x)


def _constants(x: np.ndarray) -> PosteriorConstants:
    """Positive ones by their logarithms."""
    directions, form = (float(v) for v in np.exp(x[:2]))
    return PosteriorConstants(directions, form, float(x[2]))


def bins(cases: Sequence[Truth], known: PosteriorConstants) -> list[tuple[float, float, int]]:
    """Probability given to the likeliest answer on average, how often it was the truth, and of how many."""
    edges, given = (0.0, 0.5, 0.8, 0.95, 1.01), []
    for c, weight in zip(cases, weights(cases), strict=True):
        found = posterior.compute_posterior_probabilities(
            c.null, c.candidates, record=c.record, calibration=known
        )
        answers = c.answers(found)
        said = max(answers, key=lambda a: answers[a])
        given.append((answers[said], c.right(said), weight))
    rows = []
    for low, high in pairwise(edges):
        mine = np.array([g for g in given if low <= g[0] < high])
        if len(mine):
            p, right = mine[:, 2] @ mine[:, :2] / mine[:, 2].sum()
            rows.append((float(p), float(right), len(mine)))
    return rows


def told(case: Truth, known: PosteriorConstants) -> tuple[str, frozenset[str]]:
    """The answer in short: whether there is a gap, whether from outside, and the effects named."""
    found = posterior.compute_posterior_probabilities(
        case.null, case.candidates, record=case.record, calibration=known
    )
    if found.none > posterior.MAX_NO_GAP_PROBABILITY:
        return ("unexplained" if found.outside > found.none else "none"), frozenset()
    outside = found.outside > sum(found.sets.values())
    return ("unexplained" if outside else "explained"), found.best


def sensitivity(cases: Sequence[Truth], known: PosteriorConstants) -> list[tuple[str, float, float]]:
    """Share of the answers that are others with half of a constant, and with half as much again."""
    plain = [told(c, known) for c in cases]

    def changed(other: PosteriorConstants) -> float:
        return float(np.mean([told(c, other) != p for c, p in zip(cases, plain, strict=True)]))

    rows = []
    for field in fields(known):
        value = getattr(known, field.name)
        rows.append((field.name, *(changed(replace(known, **{field.name: f * value})) for f in (0.5, 1.5))))
    for name in ("MODEL_ERROR_SHARE", "FURTHER_CAUSE_ODDS", "MAX_NO_GAP_PROBABILITY"):
        value, shares = getattr(posterior, name), []
        for f in (0.5, 1.5):
            setattr(posterior, name, f * value)
            shares.append(changed(known))
            setattr(posterior, name, value)
        rows.append((name, shares[0], shares[1]))
    return rows


def main() -> None:
    """Print the constants, how they do on the very cases, and what changing each by half does."""
    cases = read(Path(a) for a in sys.argv[1:])
    known = calibrated(cases, PosteriorConstants(8.0, 0.2, -3.0))
    print(f"{len(cases)} truths: {known}")
    for p, right, count in bins(cases, known):
        print(f"said {p:.2f}  true {right:.2f}  of {count}")
    made = [c for c in cases if not c.hidden]
    for name, less, more in sensitivity(made, known):
        print(f"{name}: halved {less:.1%}, half as much again {more:.1%} of {len(made)} answers change")


if __name__ == "__main__":
    main()
