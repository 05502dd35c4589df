"""Recorded inputs of ``diagnose``: a parameter that changed, and black boxes that describe little."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from swimid.diagnosis.evidence import Diagnosis
from swimid.diagnosis.gap_file import ChangedValue, GapFile
from swimid.simulation.compare_series import ComparisonFile
from tests.conftest import Ran

Case = Callable[..., Path]
Run = Callable[..., Ran]


@pytest.mark.slow
def test_a_spring_that_became_softer_is_the_cause(case: Case, swimid: Run) -> None:
    folder = case("n-softer-spring")
    trials = folder / "soft" / "trials.yaml"
    ran = swimid("diagnose", trials, "--params", folder / "day1.yaml", "-o", folder / "gap.yaml")
    assert ran.status == 0, ran.err
    assert "EXPLAINED" in ran.out
    file = GapFile.read(folder / "gap.yaml")
    (cause,) = file.causes
    assert (cause.effect, cause.equivalent) == ("parameter:k_t", ["joint-stiffness"])
    value = cause.parameters["k_t"]
    assert isinstance(value, ChangedValue)
    assert value.given == pytest.approx(0.0599757, abs=1e-7)
    assert value.value == pytest.approx(0.0552, abs=3 * value.stderr)
    assert 30 < value.standard_errors < 90
    assert all(s.closed > 0.9 for s in cause.shrinkage if s.closed is not None)
    # the errors as given are those of compare, to the last digit
    compared = swimid("compare", trials, "--params", folder / "day1.yaml", "-o", folder / "compared.yaml")
    assert compared.status == 0, compared.err
    assert file.as_given == ComparisonFile.read(folder / "compared.yaml").channels


@pytest.mark.slow
def test_a_black_box_of_unrelated_noise_describes_nothing(case: Case, swimid: Run) -> None:
    folder = case("r-diagnose-none-noise", "make.py")
    made = swimid("rwls", "t.yaml", "--na", "3", "--nb", "2", "--validate", "0.25", "-o", "arx.yaml")
    assert made.status == 0, made.err
    ran = swimid("diagnose", "t.yaml", "--params", "arx.yaml", "-o", "gap.yaml")
    assert ran.status == 0, ran.err
    assert "the model reproduces 0.3" in " ".join(ran.out.split())
    file = GapFile.read(folder / "gap.yaml")
    assert (file.verdict, file.causes) == ("unexplained", [])
    assert Diagnosis.load(folder / "gap.yaml").verdict == "bad"
    assert file.facts.unreproduced["y"] < 0.02


@pytest.mark.slow
def test_play_is_estimated_with_a_step_that_resolves_it(
    case: Case, swimid: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The default step of 5 ms changes samples of the model with play by 40 times their noise."""
    monkeypatch.setenv("SWIMID_LANES", "")
    folder = case("t4-diagnose-step")
    asked = ("--effects", "servo-backlash,servo-lag,amplitude-loss")
    words = ("diagnose", "play.trials.yaml", "--params", "old.yaml", *asked, "-o", "gap.yaml")
    ran = swimid(*words)
    assert ran.status == 0, ran.err
    file = GapFile.read(folder / "gap.yaml")
    (cause,) = file.causes
    assert (file.verdict, cause.effect) == ("explained", "servo-backlash")
    found = cause.parameters["backlash_rad"]
    assert found.value == pytest.approx(0.10472, abs=3 * found.stderr)
    (last,) = (step for step in file.waterfall if step.label == "+ servo-backlash")
    assert last.squared < 1.2**2
    assert "SWM016" not in ran.err
    compared = swimid("compare", "play.trials.yaml", "--params", "repaired.yaml", "-o", "compared.yaml")
    assert compared.status == 0, compared.err
    error = ComparisonFile.read(folder / "compared.yaml").channels["x_m"].rmse
    assert error is not None
    assert error < 5e-4
