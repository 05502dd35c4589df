"""``python -m tests.blind.calibrate OUT [OUT ...]``: the constants of the probabilities, from blind cases.

OUT are folders that ``python -m tests.blind`` has filled. Every case with a single effect is judged once more
with that effect hidden from the catalogue (leave one effect out): what is left is a cause from outside. The
constants are those under which the truth is likeliest.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML
from scipy.optimize import minimize

from swimid.diagnosis.posterior import Calibration, Candidate, posterior

#: What an effect must lower the score by for its case to tell anything of it.
SEEN = 20.0
#: A hidden effect has a twin where its best rival leaves no more than this share of what it leaves itself,
#: and what is seen, beyond it.
TWIN = 0.1
#: Weight of a case with its effect hidden, of which there is one for each single effect.
HIDDEN = 0.35
#: Share of answers that are right by chance: no single case decides.
CHANCE = 0.004


@dataclass(frozen=True)
class Truth:
    """A case and what is true of it.

    Attributes
    ----------
    null : Candidate
    candidates : list of Candidate
    true : frozenset of str or None
        The effects; empty where there is no gap, None where the cause is outside the catalogue.
    small : bool
        Whether there might as well be no gap.
    """

    null: Candidate
    candidates: list[Candidate]
    samples: int
    effects: int
    true: frozenset[str] | None
    weight: float = 1.0
    small: bool = False

    def probability(self, known: Calibration) -> float:
        """What the truth is given."""
        found = posterior(
            self.null, self.candidates, samples=self.samples, effects=self.effects, calibration=known
        )
        inside = found.outside if self.true is None else found.sets.get(self.true, 0.0)
        return found.none if self.true == frozenset() else inside + self.small * found.none


def read(folders: Iterable[Path]) -> list[Truth]:
    """The cases of folders, with hidden effects, too."""
    found = []
    for folder in folders:
        for place in sorted((folder / "results").glob("*/gap.yaml")):
            gap = YAML(typ="safe").load(place.read_text())
            label = json.loads((folder / "labels" / f"{place.parent.name}.json").read_text())
            rows = [
                Candidate(
                    frozenset(h["effects"]), h["score"], np.array(h["folds"]), h["numbers"], h.get("slow")
                )
                for h in gap["hypotheses"]
            ]
            found += truths(rows, label["kind"], label["effects"], gap["samples"], gap["tried"])
    return found


def truths(
    rows: Sequence[Candidate], kind: str, effects: Sequence[str], samples: int, tried: int
) -> list[Truth]:
    """What one case tells."""
    null, *rest = rows
    true = frozenset(effects)
    if "marker-dropout" in true:
        return []
    best = min(c.score for c in rows)
    if kind == "clean":
        return [Truth(null, rest, samples, tried, frozenset())]
    if kind == "outside":
        return [Truth(null, rest, samples, tried, None, small=null.score - best < SEEN)]
    mine = next((c for c in rest if c.names == true), None)
    if mine is None:
        return []
    small = null.score - mine.score < SEEN
    found = [Truth(null, rest, samples, tried, true, small=small)]
    without = [c for c in rest if not c.names & true]
    nearest = min((c.score for c in without), default=null.score)
    alike = SEEN + TWIN * max(mine.score - samples, 0.0)
    if kind == "single" and not small and nearest - mine.score > alike:
        found.append(Truth(null, without, samples, tried, None, HIDDEN))
    return found


def calibrated(cases: Sequence[Truth], start: Calibration) -> Calibration:
    """The constants under which what is true is likeliest."""

    def loss(x: np.ndarray) -> float:
        known = _constants(x)
        p = np.array([c.probability(known) for c in cases])
        weight = np.array([c.weight for c in cases])
        return float(-weight @ np.log((1.0 - CHANCE) * p + CHANCE))

    begin = np.array([np.log(start.directions), np.log(start.form), start.number, start.outside, start.grows])
    simplex = np.vstack((begin, begin + 0.5 * np.eye(len(begin))))
    options = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 0.01, "maxfev": 2000}
    return _constants(minimize(loss, begin, method="Nelder-Mead", options=options).x)


def _constants(x: np.ndarray) -> Calibration:
    """Positive ones by their logarithms."""
    return Calibration(float(np.exp(x[0])), float(np.exp(x[1])), float(x[2]), float(x[3]), float(x[4]))


def bins(cases: Sequence[Truth], known: Calibration) -> list[tuple[float, float, int]]:
    """Probability given to the likeliest answer on average, how often it was the truth, and of how many."""
    edges, given = (0.0, 0.5, 0.8, 0.95, 1.01), []
    for c in cases:
        found = posterior(c.null, c.candidates, samples=c.samples, effects=c.effects, calibration=known)
        answers = {**found.sets, frozenset(): found.none, None: found.outside}
        said = max(answers, key=lambda a: answers[a])  # type: ignore[arg-type]
        given.append((answers[said], said == c.true or (c.small and said == frozenset())))
    rows = []
    for low, high in pairwise(edges):
        mine = [(p, right) for p, right in given if low <= p < high]
        if mine:
            p, right = (float(np.mean(x)) for x in zip(*mine, strict=True))
            rows.append((p, right, len(mine)))
    return rows


def main() -> None:
    """Print the constants and how they do on the very cases."""
    cases = read(Path(a) for a in sys.argv[1:])
    known = calibrated(cases, Calibration(7.0, 0.001, 1.0, -2.0, 1.5))
    print(f"{len(cases)} truths: {known}")
    for p, right, count in bins(cases, known):
        print(f"said {p:.2f}  true {right:.2f}  of {count}")


if __name__ == "__main__":
    main()
