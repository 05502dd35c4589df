"""``swimid optimise stiffness``: optima against scans, the rule in Python and in C, resumption."""

from __future__ import annotations

import timeit
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import swimid as package
from swimid.errors import InputError, UsageError
from swimid.optimisation.optimise_stiffness import COST, SPEED, RuleFile, StiffnessRule
from tests.conftest import Ran, interrupting

DOLPHIN = {"robot": "dolphin", "amplitude_deg": 27.0, "duration_s": 6.0, "between": (0.1, 2.0)}
SMALL = {**DOLPHIN, "over": {"frequency_hz": (2.0, 4.0, 5)}, "population": 16, "generations": 8}


@pytest.fixture(scope="module")
def rule() -> StiffnessRule:
    return package.optimise_stiffness(**SMALL)


@pytest.fixture(scope="module")
def two() -> RuleFile:
    """A rule of two amplitudes, written down."""
    return RuleFile.model_validate(
        {
            "verdict": "good", "robot": "tfish", "model": "multilink", "drive": {}, "duration_s": 15.0,
            "coefficient": "d_p", "unit": "m", "between": (0.0, 0.05), "objective": "speed",
            "objectives": ("a", "b"), "reference": 0.03, "frequency_hz": (0.6, 2.0),
            "amplitude_deg": (15.0, 35.0), "optima": [],
            "curves": [
                {"amplitude_deg": 15.0, "coefficients": (0.001, 0.002, 0.003), "rms": 0.0},
                {"amplitude_deg": 25.0, "coefficients": (-0.001, 0.002, 0.009), "rms": 0.0},
                {"amplitude_deg": 35.0, "coefficients": (-0.003, 0.002, 0.03), "rms": 0.0},
            ],
        }
    )  # fmt: skip


@pytest.mark.slow
def test_the_optima_agree_with_a_scan_over_the_stiffness(rule: StiffnessRule) -> None:
    scan = np.linspace(0.1, 2.0, 96)
    for one in rule.file.optima[1:4:2]:
        made = package.performance_map(
            robot="dolphin", amplitude_deg=27.0, frequency_hz=one.frequency_hz, duration_s=6.0,
            over={"K_s": (0.1, 2.0, 96)},
        )  # fmt: skip
        speeds = made.frame["mean_surge_from_start_m_s"]
        # the speed is flat about its maximum: found to a thousandth, the stiffness to a few steps of the scan
        front = np.array(one.front, dtype=float)
        assert -front[:, 1].min() == pytest.approx(max(speeds), rel=1e-3)
        assert one.stiffness == pytest.approx(scan[int(np.argmax(speeds))], abs=0.1)
        # no point of the front is better than another in both
        order = np.argsort(front[:, 1])
        assert np.all(np.diff(front[order, 2]) <= 0)


@pytest.mark.slow
def test_the_rule_follows_its_optima(rule: StiffnessRule) -> None:
    stiff = [one.stiffness for one in rule.file.optima]
    assert np.all(np.diff(stiff) > 0)
    for one in rule.file.optima:
        assert rule.stiffness_for(one.frequency_hz) == pytest.approx(one.stiffness, abs=0.05)
        assert one.ruled[SPEED] == pytest.approx(one.best[SPEED], rel=0.01)
        # what is searched is the mean from rest (Eq 12), a little off the speed at the end
        assert one.best[SPEED] >= one.reference[SPEED] * 0.98
    f = np.array([one.frequency_hz for one in rule.file.optima])
    assert rule.file.curves[0].coefficients == pytest.approx(np.polyfit(f, stiff, 2)[::-1], abs=1e-9)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_also_after_an_interrupt(tmp_path: Path) -> None:
    given = {**SMALL, "generations": 3, "jobs": 1}
    whole, parted, other = (tmp_path / f"{name}.yaml" for name in ("whole", "parted", "other"))
    package.optimise_stiffness(output=whole, **given)
    with pytest.raises(KeyboardInterrupt):
        package.optimise_stiffness(output=parted, progress=interrupting(3), **given)
    assert list(tmp_path.glob("parted.yaml.partial"))
    package.optimise_stiffness(output=parted, **given)
    assert parted.read_bytes() == whole.read_bytes()
    package.optimise_stiffness(output=other, **{**given, "seed": 1, "jobs": 2})
    assert other.read_bytes() != whole.read_bytes()


def test_the_rule_interpolates_linearly_between_amplitudes(two: RuleFile) -> None:
    """Compare with values by hand: at 1 Hz the curves say 0.006, 0.010 and 0.029."""
    assert two.stiffness_for(1.0, 15.0) == pytest.approx(0.006)
    assert two.stiffness_for(1.0, 20.0) == pytest.approx(0.008)
    assert two.stiffness_for(1.0, 30.0) == pytest.approx(0.0195)
    assert two.stiffness_for(2.0, 35.0) == 0.05
    for frequency, amplitude in ((0.5, 20.0), (1.0, 36.0), (float("nan"), 20.0)):
        with pytest.raises(UsageError, match="outside the range of the rule"):
            two.stiffness_for(frequency, amplitude)
    assert two.stiffness_for(5.0, 50.0, outside="hold") == two.stiffness_for(2.0, 35.0)
    with pytest.raises(UsageError, match="amplitude"):
        two.stiffness_for(1.0)
    assert timeit.timeit(lambda: two.stiffness_for(1.1, 22.0), number=200) / 200 < 1e-3


def test_the_command_writes_and_reads(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    words = (
        "optimise", "stiffness", "--robot", "dolphin", "--amplitude-deg", "27",
        "--over", "frequency_hz=2:4:3",
        "--between", "0.1,2", "--duration-s", "5", "--generations", "3", "--population", "8",
    )  # fmt: skip
    out = tmp_path / "rule.yaml"
    ran = swimid(*words, "-o", out)
    assert ran.status == 0
    assert "K_s" in ran.out
    rule = package.load_result(out)
    assert isinstance(rule, StiffnessRule)
    assert rule.figure_names == ["rule"]
    assert rule.evidence.facts["Stiffness"] == "K_s, 0.1 … 2 N·m/rad"
    assert max(len(line) for line in ran.out.splitlines()) <= 100
    assert ran.out.splitlines()[-2].startswith("GOOD: ")
    out.write_text("mine")
    assert swimid(*words, "-o", out).status == 2  # what swimid did not write is not overwritten


@pytest.mark.slow
def test_the_cheapest_stiffness_costs_less_than_the_fastest(rule: StiffnessRule) -> None:
    cheap = package.optimise_stiffness(objective="cost-of-transport", **SMALL)
    for a, b in zip(cheap.file.optima, rule.file.optima, strict=True):
        assert a.best[COST] <= b.best[COST]
        assert a.best[SPEED] <= b.best[SPEED] * 1.001


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"over": {"K_s": (0.1, 1.0, 3)}}, "frequency_hz"),
        ({"over": {"frequency_hz": (1.0, 2.0, 2)}}, "three frequencies"),
        ({"coefficient": "K"}, "no law of a passive joint contains K"),
        ({"robot": "sealion", "stroke": "characteristic"}, "tail beat"),
        ({"between": (-1.0, 2.0)}, "must be within 0 to 20"),
        ({"amplitude_deg": None}, "the beat has no amplitude_deg"),
    ],
)
def test_wrong_options_are_refused(changed: dict[str, object], says: str) -> None:
    given = {k: v for k, v in {**SMALL, **changed}.items() if v is not None}
    with pytest.raises((UsageError, InputError), match=says):
        package.optimise_stiffness(**given)
