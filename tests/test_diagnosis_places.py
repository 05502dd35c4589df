"""Places of a gap: settings, phases of the stroke, and times."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from swimid.diagnosis import places
from swimid.diagnosis.study import GapStudy
from swimid.fitting.model import RigInput, SwimInput, Trial
from tests.diagnosis_models import nothing
from tests.toy_models import Toy


def residual_map(series: list[np.ndarray], floor: float, **known: list[Any]) -> places.Map:
    """Return the map of given residuals with one channel."""
    time = np.linspace(0.0, 10.0, len(series[0]))
    trials = [
        Trial(f"t{k}", "fit", time, {"y": s}, **{n: v[k] for n, v in known.items()})
        for k, s in enumerate(series)
    ]
    study = GapStudy(Toy(nothing, (), ("y",)), (), trials, {})
    return places.Map(study, study.at((), np.empty(0)), {"y": floor})


def test_a_cell_is_residual_over_floor() -> None:
    rig = [RigInput(force=1.0), RigInput(force=2.0)]
    found = places.regimes(residual_map([np.full(50, 0.1), np.full(50, 0.3)], 0.1, rig=rig))
    by = {c.label: c for c in found if c.kind == "force"}
    assert by["1 N"].ratio == pytest.approx(1.0)
    assert by["2 N"].ratio == pytest.approx(3.0)
    assert by["2 N"].share == pytest.approx(1.0)
    assert max(found, key=lambda c: c.ratio).label in ("2 N", "t1")


def test_start_up_and_steady_motion_share_the_gap() -> None:
    time = np.linspace(0.0, 10.0, 201)
    found = places.times(residual_map([np.where(time <= 2.0, 0.4, 0.2)] * 3, 0.1))
    by = {c.label: c for c in found}
    assert by["start-up"].ratio == pytest.approx(4.0)
    assert by["steady"].ratio == pytest.approx(2.0)
    assert sum(c.share for c in found if c.kind == "time") == pytest.approx(1.0)


def test_the_gap_is_located_in_the_phase_of_the_stroke() -> None:
    """A gap in the first eighth of the stroke is located there at every frequency."""
    time, series, beats = np.linspace(0.0, 10.0, 2001), [], []
    for f in (1.0, 1.7):
        series.append(np.where((time * f) % 1.0 < 0.125, 0.5, 0.1))
        beats.append(SimpleNamespace(frequency_hz=f, amplitude_rad=0.3, bias_rad=0.0))
    found = places.phases(residual_map(series, 0.1, swim=[SwimInput(b) for b in beats]))
    first, *others = sorted(found, key=lambda c: -c.ratio)
    assert first.label == "0-45 deg"
    assert first.ratio == pytest.approx(5.0, rel=0.02)
    assert all(c.ratio == pytest.approx(1.0, abs=0.1) for c in others)
