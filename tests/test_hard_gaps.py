"""The diagnosis is right on hard cases, whose generators know nothing of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from swimid.diagnosis.gap_file import GapFile
from tests.conftest import ROOT
from validation.hard_gaps import CASES, outcome


def test_the_generators_do_not_know_the_package() -> None:
    said = "import sys, validation.hard_gaps; print([m for m in sys.modules if m.split('.')[0] == 'swimid'])"
    ran = subprocess.run([sys.executable, "-c", said], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_required_statements_are_checked(tmp_path: Path, name: str) -> None:
    found = outcome(CASES[name], tmp_path)
    assert found.faults == [], f"{CASES[name].says}: {found.answer.verdict}, {found.answer.causes}"
    # the same file whatever order Python's sets of names have
    for hypothesis in GapFile.read(tmp_path / "gap.yaml").hypotheses:
        assert list(hypothesis.alike) == sorted(hypothesis.effects if len(hypothesis.effects) > 1 else [])
