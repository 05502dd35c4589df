"""Usual mistakes in trials are named if a fit or a comparison is bad; nothing is changed."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.conftest import SAMPLES, Ran
from tests.generators import three_link

Columns = dict[str, np.ndarray]


def _from_the_tail(columns: Columns) -> None:
    columns["yaw_rad"] += np.pi


def _in_degrees(columns: Columns) -> None:
    columns["yaw_rad"] *= 180.0 / np.pi


def _in_millimetres(columns: Columns) -> None:
    columns["x_m"] *= 1000.0
    columns["y_m"] *= 1000.0


def _mirrored(columns: Columns) -> None:
    columns["y_m"] *= -1.0


FREQUENCIES = (0.9, 1.3, 1.7)
MISTAKES = {
    "tail": ({1.3: _from_the_tail}, 1.0, "With yaw + 180 degrees in trial f1.3 "),
    "degrees": (dict.fromkeys(FREQUENCIES, _in_degrees), 1.0, "With yaw_rad taken as degrees in all trials "),
    "millimetres": ({0.9: _in_millimetres}, 1.0, "With x_m and y_m multiplied by 0.001 in trial f0.9 "),
    "mirrored": (dict.fromkeys(FREQUENCIES, _mirrored), 1.0, "With y mirrored in all trials "),
    "amplitude": ({}, 2.0, "With half the amplitude of the drive in all trials "),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named(name: str, tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    spoiled, factor, says = MISTAKES[name]
    three_link.robot(tmp_path)
    trials = three_link.write(tmp_path, FREQUENCIES, duration_s=5.0, spoiled=spoiled, amplitude_factor=factor)
    before = {p: p.read_bytes() for p in tmp_path.glob("*.csv")}
    ran = swimid("fit-graybox", trials, "-o", tmp_path / "fit.yaml")
    assert says in ran.out + ran.err
    assert "BAD:" in ran.out
    assert {p: p.read_bytes() for p in tmp_path.glob("*.csv")} == before


@pytest.mark.slow
def test_good_trials_name_no_mistake(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    three_link.robot(tmp_path)
    trials = three_link.write(tmp_path, FREQUENCIES, duration_s=5.0)
    ran = swimid("fit-graybox", trials, "-o", tmp_path / "fit.yaml")
    assert "usual mistakes" not in ran.out
    assert "With " not in ran.out


def test_a_model_that_fails_everywhere_names_no_mistake(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    """The servos of these trials have backlash; no beat at all would describe one trial better."""
    for name in ("run01.csv", "run04.csv", "params.yaml"):
        shutil.copy(SAMPLES / "gap" / name, tmp_path)
    trials = yaml.safe_load((SAMPLES / "gap" / "trials.yaml").read_text())
    trials["trials"] = [trial for trial in trials["trials"] if trial["id"] in ("run01", "run04")]
    (tmp_path / "trials.yaml").write_text(yaml.safe_dump(trials))
    ran = swimid("compare", tmp_path / "trials.yaml", "--params", tmp_path / "params.yaml")
    assert "BAD:" in ran.out
    assert "usual mistake" not in ran.out
