"""What blind cases tell of the constants of the probabilities."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from swimid.diagnosis.posterior import Candidate, PosteriorConstants
from validation import calibrate


def _rows(null: float, **deviances: float) -> list[Candidate]:
    def made(names: frozenset[str], deviance: float) -> Candidate:
        return Candidate(names=names, deviances=np.full(5, deviance / 5), numbers=len(names))

    return [made(frozenset(), null), *(made(frozenset(n.split("_")), d) for n, d in deviances.items())]


@pytest.mark.slow
def test_the_constants_are_those_under_which_the_truth_is_likeliest(tmp_path: Path) -> None:
    """Cases whose true effect leaves a tenth of what its rival does, and such as no effect closes.

    What the rival leaves is more than two standard deviations of the squared noise.
    """
    rng = np.random.default_rng(5)
    for k in range(12):
        gap = float(np.exp(rng.uniform(7.5, 10.0)))
        outside = k % 3 == 0
        best, rival = (0.7 * gap, 0.8 * gap) if outside else (0.01 * gap, 0.1 * gap)
        rows = _rows(1000.0 + gap, lag=1000.0 + best, delay=1000.0 + rival)
        place = tmp_path / "results" / f"{k:04d}"
        place.mkdir(parents=True)
        (tmp_path / "labels").mkdir(exist_ok=True)
        file = {
            "trials": ["one"] * 3,
            "samples": 1000,
            "tried": 20,
            "hypotheses": [
                {
                    "effects": sorted(c.names),
                    "numbers": c.numbers,
                    "strain": c.strain,
                    "deviances": c.deviances.tolist(),
                }
                for c in rows
            ],
        }
        with (place / "gap.yaml").open("w") as out:
            YAML().dump(file, out)
        label = {"kind": "outside" if outside else "single", "effects": ["droop"] if outside else ["lag"]}
        (tmp_path / "labels" / f"{k:04d}.json").write_text(json.dumps(label))
    cases = calibrate.read([tmp_path])
    assert len(cases) == 4 + 2 * 8
    start = PosteriorConstants(1.0, 0.1, 0.0)
    known = calibrate.calibrated(cases, start)

    def likelihood(c: PosteriorConstants) -> float:
        p = np.array([case.probability(c) for case in cases])
        return float(calibrate.weights(cases) @ np.log(p))

    assert likelihood(known) > likelihood(start) + 5.0
    assert all(case.probability(known) > 0.5 for case in cases)
    assert sum(count for *_, count in calibrate.bins(cases, known)) == len(cases)
