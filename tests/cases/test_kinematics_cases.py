"""Recorded inputs of stroke, speed, repeated samples and frozen channels, with their true values."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.conftest import Ran

Case = Callable[..., Path]
Run = Callable[..., Ran]


def imported(swimid: Run, source: str) -> dict:
    """Import a log and return the result with the warning codes."""
    ran = swimid("import", source, "-o", "out.csv", "--json")
    assert ran.status == 0, ran.err
    return ran.json["result"]


@pytest.mark.parametrize(
    "name", ["angle_rad", "fin_angle_rad", "force_N", "tail_rad", "tip_m", "y_m", "y_offset_m"]
)
def test_any_channel_shows_the_stroke(name: str, case: Case, swimid: Run) -> None:
    case("p-stroke-by-name")
    assert imported(swimid, f"{name}.csv")["stroke"]["frequency_hz"] == pytest.approx(0.9, abs=1e-3)


@pytest.mark.parametrize("kind", ["a ship of 161 m", "a step of 5.5 s"])
def test_a_stated_unit_is_believed(
    kind: str, tmp_path: Path, swimid: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 161.5, 0.5) if kind.startswith("a ship") else np.arange(0.0, 2500.0, 5.5)
    speed = 1.0 if kind.startswith("a ship") else 0.02
    frame = pd.DataFrame({"t_s": time, "x_m": speed * time + rng.normal(0, 0.01, len(time))})
    frame.to_csv("log.csv", index=False, float_format="%.4f")
    assert imported(swimid, "log.csv")["verdict"]["level"] == "caution"
