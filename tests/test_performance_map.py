"""``swimid map``: points against single simulations, resumption, trials beside the map, wrong options."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import swimid as package
from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files.atomic import Checkpoint
from swimid.optimisation.study import Performance
from tests.conftest import Ran, interrupting
from tests.test_best_gait import parameters

Swimid = Callable[..., Ran]
DOLPHIN = {"robot": "dolphin", "amplitude_deg": 27.0, "duration_s": 8.0}


def test_a_point_agrees_with_simulate() -> None:
    """Compare with one run at these values, sampled at 50 Hz."""
    made = package.performance_map(over={"frequency_hz": (2.0, 3.0, 2), "K_s": (0.3, 0.9, 3)}, **DOLPHIN)
    row = made.frame.query("frequency_hz == 3.0 and K_s > 0.8").iloc[0]
    alone = package.simulate(frequency_hz=3.0, chosen={"K_s": 0.9}, **DOLPHIN).quantities
    for name in ("mean_speed_m_s", "cost_of_transport_J_m", "strouhal", "peak_torque_N_m"):
        # the windows' samples differ by part of an integration step
        assert row[name] == pytest.approx(alone[name].value, rel=2e-3), name


def test_the_best_stiffness_rises_with_frequency() -> None:
    """Dolphin, section 4.3: an optimum at every frequency, stiffer at a higher one."""
    made = package.performance_map(over={"frequency_hz": (2.5, 4.5, 3), "K_s": (0.2, 1.6, 8)}, **DOLPHIN)
    fastest = made.frame.loc[made.frame.groupby("frequency_hz")["mean_speed_m_s"].idxmax()]
    assert np.all(np.diff(fastest["K_s"]) > 0)
    assert fastest["K_s"].between(0.3, 1.5).all()


def test_steering_over_bias_and_asymmetry() -> None:
    """Tendon fish, Table V: the turn tightens with the bias, and asymmetry tightens it further."""
    made = package.performance_map(
        robot="tfish", frequency_hz=1.0, amplitude_deg=35.0, waveform="a-cpg", duration_s=20.0,
        over={"bias_deg": (25.0, 35.0, 2), "asymmetry": (0.0, 0.4, 2)},
    )  # fmt: skip
    radius = made.frame.pivot(index="bias_deg", columns="asymmetry", values="turning_radius_m").to_numpy()
    assert np.all(np.diff(radius, axis=0) < 0)
    assert np.all(np.diff(radius, axis=1) < 0)
    assert {"yaw_range_in_beat_rad", "max_yaw_rate_rad_s", "mean_yaw_rate_rad_s"} <= set(made.frame)


def test_an_interrupted_map_continues_to_the_same_file(tmp_path: Path) -> None:
    over = {"frequency_hz": (2.0, 4.0, 5), "K_s": (0.2, 1.0, 5)}
    whole, parted = tmp_path / "whole.yaml", tmp_path / "parted.yaml"
    package.performance_map(over=over, output=whole, jobs=1, **DOLPHIN)
    with pytest.raises(KeyboardInterrupt):
        package.performance_map(over=over, output=parted, jobs=1, progress=interrupting(2), **DOLPHIN)
    assert not parted.exists()
    assert (tmp_path / "parted.yaml.partial").exists()
    package.performance_map(over=over, output=parted, jobs=1, **DOLPHIN)
    assert parted.read_bytes() == whole.read_bytes()
    assert not list(tmp_path.glob("*.partial"))


def test_the_range_of_the_fit_is_framed(samples: Path) -> None:
    """Points outside the frame are extrapolation."""
    fitted = package.fit_graybox(samples / "tfish" / "trials.yaml", share=["c_f"])
    made = package.performance_map(
        params=fitted, over={"frequency_hz": (1, 2, 2), "amplitude_deg": (15, 35, 2)}, duration_s=5.0
    )
    assert made.file.identified["frequency_hz"] == (1.0, 1.8)
    checks = made.checks().set_index("name")
    assert "extrapolation" in checks.loc["inside the range of the identification trials", "text"]
    assert made.evidence is not None
    figures = {figure.id: figure for figure in made.evidence.figures}
    assert "identified inside" in {t.label for t in figures["contours"].panels[0].traces}


def test_standard_deviations_follow_the_covariance(tmp_path: Path) -> None:
    """One uncertain coefficient: the deviation of the speed is its slope times the standard error."""
    given = {"params": parameters(tmp_path, c_d2=0.2), "amplitude_deg": 27.0, "duration_s": 8.0}
    made = package.performance_map(over={"frequency_hz": (2.0, 3.0, 2)}, **given)
    stderr = made.file.quantities["mean_speed_m_s"].stderr
    assert stderr is not None
    ends = [
        package.performance_map(over={"frequency_hz": (2.0, 3.0, 2)}, chosen={"c_d2": c}, **given).frame
        for c in (5.75, 5.85)
    ]
    slope = (ends[1]["mean_speed_m_s"] - ends[0]["mean_speed_m_s"]) / 0.1
    assert [row[0] for row in stderr] == pytest.approx(0.2 * slope.abs(), rel=0.02)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"over": {"K": (0.1, 1.0, 3)}}, "no parameter 'K'"),
        ({"over": {"frequency_hz": (0.0, 1.0, 3)}}, "frequency_hz"),
        ({"over": {"frequency_hz": (2.0, 1.0, 3)}}, "not below"),
        ({"over": {"frequency_hz": (1.0, 2.0, 1)}}, "two or more"),
        ({"over": {"asymmetry": (0.0, 0.4, 3)}, "frequency_hz": 1.0}, "a-cpg"),
        ({"over": {"K_s": (0.1, 1.0, 3)}}, "the beat has no frequency_hz"),
        ({"over": {"frequency_hz": (1.0, 2.0, 3)}, "chosen": {"K_s": -1.0}}, "negative"),
    ],
)
def test_wrong_options_are_refused(changed: dict[str, object], says: str) -> None:
    with pytest.raises(Exception, match=says) as caught:
        package.performance_map(**{**DOLPHIN, **changed})
    assert isinstance(caught.value, UsageError | NoTrustworthyResult | package.InputError)


@pytest.mark.slow
def test_a_robot_in_space_over_its_stroke() -> None:
    made = package.performance_map(
        robot="sealion", stroke="characteristic", over={"scale": (0.8, 1.2, 2)}, duration_s=6.0
    )
    assert made.frame["mean_speed_m_s"].is_monotonic_increasing
    assert (made.frame["mean_power_W"] > 0).all()


def test_lag_delays_each_joint_behind_the_one_before() -> None:
    """Without a ramp the command of joint k is ``A/3 sin(2 pi f t - k lag)``."""
    options = package.performance_map.options.of(
        {"robot": "tfish", "over": {"lag_deg": (0.0, 40.0, 2)}, "frequency_hz": 1.0, "amplitude_deg": 30.0,
         "ramp_s": 0.0}
    )  # fmt: skip
    performance = Performance.of_options(options)
    swim = performance.swim({"lag_deg": 40.0})
    time = np.linspace(0.0, 2.0, 50)
    for k in range(3):
        told = performance.model.command(k, swim, time, 0.0)
        expected = math.radians(10.0) * np.sin(2 * np.pi * time - k * math.radians(40.0))
        assert told == pytest.approx(expected, abs=1e-12)


def test_there_is_no_checkpoint_without_an_output() -> None:
    assert Checkpoint.of_output(None, []).path is None


def test_a_robot_that_rests_throughout_is_no_map_rule_or_gait() -> None:
    """Without a beat there is no motion, and no result."""
    rest = {**DOLPHIN, "amplitude_deg": 0.0}
    with pytest.raises(NoTrustworthyResult, match="does not swim"):
        package.performance_map(over={"frequency_hz": (1, 3, 2)}, **rest)
    with pytest.raises(NoTrustworthyResult, match="does not swim"):
        package.optimise_gait(vary={"frequency_hz": (1, 3)}, **rest)
    with pytest.raises(NoTrustworthyResult, match="does not swim"):
        package.optimise_stiffness(
            over={"frequency_hz": (1, 3, 3)}, between=(0.1, 3), population=8, generations=2, **rest
        )
