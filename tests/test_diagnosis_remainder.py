"""Structure that generic smooth terms find in the residuals of a fit."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from swimid.diagnosis import remainder
from swimid.fitting.model import CruiseInput, Stroke, Trial
from tests.diagnosis_models import plain_study, ring, seen_trials


def test_a_table_has_a_factor_for_each_setting_and_each_fin() -> None:
    """A level is a setting that three runs share; frequencies that all differ have no levels."""
    amplitude = np.repeat([0.2, 0.3], 6)
    trials = [
        Trial(
            f"run{k}", "fit", np.zeros(1), {},
            inputs={"frequency_hz": np.array([1.0 + 0.1 * k]), "amplitude_rad": np.array([a])},
            cruise=CruiseInput(fin="ab"[k % 2]),
        )
        for k, a in enumerate(amplitude)
    ]  # fmt: skip
    table = remainder.StrokeTable(trials)
    assert table.terms[len(table.curve) :] == ("amplitude 0.2", "amplitude 0.3", "fin a", "fin b")
    values = np.zeros(len(table.terms))
    values[table.terms.index("amplitude 0.3")] = 0.1
    values[table.terms.index("fin b")] = -0.2
    for k, (trial, a) in enumerate(zip(trials, amplitude, strict=True)):
        (change,) = table.hooks(values, trial, SimpleNamespace()).stroke
        stroke = change(Stroke(trial.inputs["frequency_hz"], trial.inputs["amplitude_rad"], np.ones(1)))
        expected = (0.1 if a == 0.3 else 0.0) - (0.2 if k % 2 else 0.0)
        np.testing.assert_allclose(np.log(stroke.thrust), expected, atol=1e-12)


@pytest.mark.parametrize(("ringing", "found"), [(0.0, False), (0.3, True)])
def test_structure_is_found_in_a_gap_and_not_in_noise(
    ringing: float, found: bool, rng: np.random.Generator
) -> None:
    """A generic term has the curve of the gap."""
    study = plain_study(seen_trials(rng, 0.0, ringing), 0.02)
    base = study.fit((), [study.shape.start])
    terms = [
        remainder.Term(place, [curve(t.time_s) / 0.02 * 0.1 for t in study.trials])
        for place, curve in (("ringing", ring), ("waving", lambda t: np.cos(5.0 * t)))
    ]
    left = remainder.find_structure(study, base, terms, rng=rng)
    assert left.is_present == found
    assert max(left.places, key=lambda place: left.places[place]) == "ringing" or not found
