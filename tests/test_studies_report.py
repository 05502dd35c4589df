"""Maps, rules, gaits and sensitivity studies on one page of the report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import swimid as package
from tests.conftest import Ran

BEAT = {"robot": "dolphin", "amplitude_deg": 27.0, "duration_s": 4.0}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::swimid.SwimidWarning")
def test_studies_on_one_page(swimid: Callable[..., Ran], samples: Path, tmp_path: Path) -> None:
    """Their figures, tables and facts."""
    files = [tmp_path / f"{name}.yaml" for name in ("map", "rule", "gait", "sensitivity")]
    frequencies = {"frequency_hz": (2.0, 3.0, 3)}
    package.performance_map(over={**frequencies, "K_s": (0.3, 0.9, 2)}, output=files[0], **BEAT)
    search = {"population": 4, "generations": 1}
    package.optimise_stiffness(over=frequencies, between=(0.1, 2.0), output=files[1], **search, **BEAT)
    package.optimise_gait(vary={"K_s": (0.1, 2.0)}, frequency_hz=3.0, starts=1, output=files[2], **BEAT)
    package.sensitivity(
        samples / "tfish" / "trials.yaml", samples=2, ranges=["20%"],
        coefficients=["c_ma", "c_d4"], output=files[3],
    )  # fmt: skip
    page = tmp_path / "page.html"
    assert swimid("report", *files, "-o", page).status == 0
    text = page.read_text()
    for shown in (
        "Over the grid of gaits", "Stiffness rule", "Quantities of the best gait",
        "Sensitivity of each output", "4 s from rest",
    ):  # fmt: skip
        assert shown in text, shown
