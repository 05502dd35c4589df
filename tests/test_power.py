"""What trials could show, before it is asked what they do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ncx2

import swimid
from swimid.diagnosis import posterior, power
from swimid.diagnosis.power import DetectionPower, PowerFile
from tests.conftest import ROOT

RIG = ROOT / "sample_logs" / "rig"


@pytest.mark.parametrize("record", [posterior.DataSize(3000.0, 6, 20), posterior.DataSize(400.0, 4, 12)])
def test_the_needed_excess_agrees_with_the_posterior(record: posterior.DataSize) -> None:
    """A single effect that leaves nothing: there being no gap has a tenth of what the two have."""
    excess = power.compute_needed_excess(record, 1)
    n = record.samples
    null = posterior.Candidate(names=frozenset(), deviances=np.full(6, (n + excess) / 6))
    effect = posterior.Candidate(names=frozenset("a"), deviances=np.full(6, n / 6), numbers=1)
    found = posterior.compute_posterior_probabilities(null, [effect], record=record)
    told = found.sets[frozenset("a")]
    assert found.none / (found.none + told) == pytest.approx(posterior.MAX_NO_GAP_PROBABILITY, rel=1e-6)


def test_noncentrality_gives_ninety_percent_power() -> None:
    assert ncx2.sf(30.0, 3, power.compute_noncentrality(30.0, 3)) == pytest.approx(0.9, abs=1e-6)


def test_equal_changes_are_never_distinguished() -> None:
    record = posterior.DataSize(3000.0, 6, 20)
    assert not power.is_distinguishable(record, 1.0)
    assert not power.is_distinguishable(record, -1.0)
    assert power.is_distinguishable(record, 0.95)


@pytest.fixture(scope="module")
def of_the_rig() -> pd.DataFrame:
    found = swimid.diagnose(RIG / "trials.yaml", power=True)
    assert isinstance(found, DetectionPower)
    return found.effects.set_index("effect")


def test_two_effects_with_one_force_are_never_distinguished(of_the_rig: pd.DataFrame) -> None:
    """Friction in proportion to the speed, and drag; mass of water, of a pulley, of the body."""
    assert "pulley-viscous" in of_the_rig.loc["linear-drag", "alike"]
    assert {"water-ingress", "pulley-inertia"} <= set(of_the_rig.loc["added-mass", "alike"])
    assert "linear-drag" not in of_the_rig.loc["start-offset", "alike"]
    assert of_the_rig.loc["linear-drag", "size"] == pytest.approx(of_the_rig.loc["pulley-viscous", "size"])


def test_an_imitated_effect_is_detected_if_it_is_large(of_the_rig: pd.DataFrame) -> None:
    absorbed = of_the_rig["absorbed"]
    assert absorbed["added-mass"] > 0.99
    assert absorbed["start-offset"] < 0.9


@pytest.mark.slow
def test_more_noise_hides_more(tmp_path: Path, of_the_rig: pd.DataFrame) -> None:
    """Twice the noise, twice the size: of an effect that is linear in it."""
    rng = np.random.default_rng(8)
    for path in RIG.glob("*.csv"):
        log = pd.read_csv(path, comment="#")
        noisy = log["x_m"] + 3e-3 * rng.standard_normal(len(log))
        log.assign(x_m=noisy).to_csv(tmp_path / path.name, index=False)
    (tmp_path / "trials.yaml").write_text((RIG / "trials.yaml").read_text())
    found = swimid.diagnose(tmp_path / "trials.yaml", power=True, effects=["start-offset", "tether"])
    assert isinstance(found, DetectionPower)
    assert list(found.effects["effect"]) == ["tether", "start-offset"]
    for name, size in found.effects.set_index("effect")["size"].items():
        assert size > 1.5 * of_the_rig.loc[name, "size"]


def test_the_power_file_is_read_back(tmp_path: Path) -> None:
    made = swimid.diagnose(
        RIG / "trials.yaml", power=True, effects=["tether"], output=tmp_path / "power.yaml"
    )
    read = swimid.load_result(tmp_path / "power.yaml")
    assert isinstance(read, DetectionPower)
    assert isinstance(read.document, PowerFile)
    assert read.summary() == made.summary()
    assert "tether" in made.tables()["power"].to_string()
    assert swimid.report([tmp_path / "power.yaml"], output=tmp_path / "power.html").outputs
