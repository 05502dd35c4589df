"""Films of a tendon-driven fish: two are fitted, the speeds of two others are predicted."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.conftest import ROOT, Ran
from tests.generators import sprung_tail

#: Mean error of the speeds of the published MuJoCo model of this fish, m/s (arXiv 2602.23283).
PUBLISHED_ERROR_M_S = 0.019


@pytest.mark.slow
def test_speeds_of_held_out_films(tmp_path: Path, real_data: Path, swimid: Callable[..., Ran]) -> None:
    shutil.copy(ROOT / "docs" / "examples" / "sprung-tail.yaml", tmp_path)
    trials = sprung_tail.write(real_data / "fishsim", tmp_path)
    assert swimid("fit-graybox", trials, "--starts", "1", "-o", tmp_path / "fish.yaml").status == 0
    swimid("compare", trials, "--params", tmp_path / "fish.yaml", "-o", tmp_path / "cmp.yaml")
    compared = yaml.safe_load((tmp_path / "cmp.yaml").read_text())["trials"]
    speeds = {
        t["id"]: (t["mean_speed"]["measured"], t["mean_speed"]["simulated"])
        for t in compared
        if t["role"] == "validate"
    }
    assert len(speeds) == 2
    errors = [abs(measured - simulated) for measured, simulated in speeds.values()]
    assert np.mean(errors) < 0.75 * PUBLISHED_ERROR_M_S
