"""Recorded inputs whose numbers are at the ends of the range, and result files that contradict themselves."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import Ran

Run = Callable[..., Ran]


@pytest.mark.parametrize(
    "words",
    [
        (
            "simulate",
            "--pulling-mass-kg",
            "0.02",
            "--duration-s",
            "3",
            "--params",
            "drag.yaml",
            "-o",
            "o.csv",
        ),
        ("compare", "trials.yaml", "--params", "drag.yaml", "-o", "o.yaml"),
        ("report", "drag.yaml", "-o", "o.html"),
    ],
    ids=["simulate", "compare", "report"],
)
def test_a_ragged_correlation_matrix(words: tuple[str, ...], case: Callable[..., Path], swimid: Run) -> None:
    case("t4-ragged-correlation")
    ran = swimid(*words)
    assert ran.status == 3, ran.err
    assert "drag.yaml, line 28, 'correlation': the correlation matrix has rows of 3, 2, 3 numbers" in ran.err


def test_rows_of_a_table_in_evidence(case: Callable[..., Path], swimid: Run) -> None:
    folder = case("t4-evidence-rows")
    ran = swimid("report", "cmp.yaml", "-o", "o.html")
    assert ran.status == 3, ran.err
    assert "'scores' has 12 cells in row 1 for 11 columns" in ran.err
    place = folder / "cmp.evidence.json"
    content = json.loads(place.read_text())
    content["tables"][1]["rows"][0].pop()
    for key, value in (("result", "../x.yaml"), ("result", ""), ("provenance", {"inputs": True})):
        place.write_text(json.dumps(content | {key: value}))
        ran = swimid("report", ".", "-o", "o.html")
        assert ran.status == 3, ran.err
        assert f"cmp.evidence.json, '{key}" in ran.err
