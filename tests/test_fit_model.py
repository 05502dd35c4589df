"""``fit_model``: any model and any trials in memory, with all the evidence of a fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files.provenance import InputInMemory
from swimid.fitting.fit import fit_model
from swimid.fitting.model import Trial
from swimid.results.parameters import Fitted
from tests.toy_models import DECAY, TRUTH, Toy, decay, parameter, trials

NOISE = {"y": 0.01}


@pytest.fixture
def model() -> Toy:
    return Toy(decay, DECAY, ("y", "v"))


@pytest.fixture
def swings(model: Toy, rng: np.random.Generator) -> list[Trial]:
    return trials(model, TRUTH, NOISE, rng)


def test_a_fit_recovers_the_truth_with_its_evidence(model: Toy, swings: list[Trial]) -> None:
    fitted = fit_model(model, swings)
    for one, truth in zip(DECAY, TRUTH, strict=True):
        estimate = fitted[one.name]
        assert estimate.stderr is not None
        assert estimate.value == pytest.approx(truth, abs=3.5 * estimate.stderr)
    checks = fitted.checks()
    assert list(checks["name"][checks["verdict"] == "warn"]) == ["held-out trials"]
    assert {"overlay-y", "residuals-y"} <= set(fitted.figure_names)
    assert {"converged", "identifiable", "trials agree"} <= set(fitted.checks()["name"])
    assert fitted.summary().startswith("Fit of toy\n  model toy; trials 3\n")


def test_choices_are_applied_and_recorded(model: Toy, swings: list[Trial]) -> None:
    fitted = fit_model(model, swings, fixed={"rate": 0.3}, bounds={"size": (0.0, 2.0)}, robot="swing")
    assert fitted["rate"].status == "fixed"
    assert fitted["size"].bounds == (0.0, 2.0)
    assert fitted.file.robot == "swing"
    settings = fitted.file.provenance["settings"]
    assert settings == {"fixed": {"rate": 0.3}, "freed": [], "bounds": {"size": [0.0, 2.0]}}


def test_the_correlation_of_an_offset_and_a_slope(rng: np.random.Generator) -> None:
    """Of samples at times t it is -mean(t) / rms(t); a single parameter has none."""
    line = (parameter("offset", 0.0), parameter("slope", 0.0))
    straight = Toy(lambda v, t: {"y": v[0] + v[1] * t}, line)
    runs = trials(straight, [0.3, 0.2], {"y": 0.01}, rng, count=4, samples=400)
    found = fit_model(straight, runs).correlation
    time = np.concatenate([run.time_s for run in runs])
    expected = -np.mean(time) / np.sqrt(np.mean(time**2))
    assert list(found.index) == list(found.columns) == ["offset", "slope"]
    np.testing.assert_allclose(found, [[1.0, expected], [expected, 1.0]], atol=0.05)
    assert fit_model(straight, runs, fixed={"slope": 0.2}).correlation.empty


def test_held_out_trials_are_scored_not_fitted(model: Toy, swings: list[Trial]) -> None:
    *kept, last = swings
    alone = fit_model(model, kept)
    assert alone.verdict == "caution"
    for shift, verdict in ((0.0, "good"), (1.0, "bad")):
        held_out = Trial(last.id, "validate", last.time_s, {"y": last.measured["y"] + shift})
        beside = fit_model(model, [*kept, held_out])
        assert beside["rate"].value == alone["rate"].value
        assert beside.verdict == verdict


def test_nothing_is_written_unless_asked(
    model: Toy, swings: list[Trial], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    fitted = fit_model(model, swings, inputs=[InputInMemory("swings", "abc")])
    assert list(tmp_path.iterdir()) == []
    assert fitted.file.provenance["inputs"] == {"swings": "abc"}
    written = fit_model(model, swings, output=tmp_path / "toy.yaml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["toy.evidence.json", "toy.yaml"]
    assert written.outputs == [tmp_path / "toy.yaml", tmp_path / "toy.evidence.json"]
    assert Fitted.load(tmp_path / "toy.yaml").parameters.equals(written.parameters)


def test_errors_of_fits_that_cannot_be_made(
    model: Toy, swings: list[Trial], rng: np.random.Generator
) -> None:
    with pytest.raises(UsageError, match="none of the 0 trials has role: fit"):
        fit_model(model, [])
    with pytest.raises(UsageError, match="the model has no parameter 'rat'"):
        fit_model(model, swings, fixed={"rat": 1.0})
    blind = Toy(lambda values, t: {"y": 0.0 * values.sum() + 0.0 * t}, DECAY)
    noise = [Trial("noise", "fit", swings[0].time_s, {"y": rng.normal(0.0, 1.0, len(swings[0].time_s))})]
    with pytest.raises(NoTrustworthyResult):
        fit_model(blind, noise)
