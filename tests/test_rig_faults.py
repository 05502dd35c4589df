"""Effects and faults that the default model of a rig lacks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cases.test_rig_cases import near, parameter, verdict
from tests.conftest import Ran
from tests.generators import rig_faults as generator

Run = Callable[..., Ran]


@pytest.mark.slow
def test_gravity_is_suggested_for_a_pitching_pendulum(swimid: Run, tmp_path: Path) -> None:
    trials = generator.pitch_pendulum(tmp_path)
    assert "--free gravity_stiffness --fix stiffness=0" in swimid("fit-drag", trials).err
    ran = swimid("fit-drag", trials, "--free", "gravity_stiffness", "--fix", "stiffness=0", "--json")
    assert near(ran, "gravity_stiffness", 2.4)
    assert "SWM024" not in ran.err


@pytest.mark.slow
def test_a_cubic_stiffness_is_suggested_for_a_hardening_mooring(swimid: Run, tmp_path: Path) -> None:
    trials = generator.hard_heave(tmp_path)
    ran = swimid("fit-drag", trials)
    assert verdict(ran) == "BAD"
    assert "--free cubic_stiffness" in ran.err
    ran = swimid("fit-drag", trials, "--free", "cubic_stiffness", "--json")
    assert near(ran, "cubic_stiffness", 4000.0)
    assert near(ran, "added_mass", 1.5)


@pytest.mark.slow
def test_dry_friction_is_suggested_for_a_rubbing_torsion_wire(swimid: Run, tmp_path: Path) -> None:
    ran = swimid("fit-drag", generator.rubbing_yaw(tmp_path))
    assert verdict(ran) == "BAD"
    assert "--free dry_friction" in ran.err


def test_all_samples_of_a_decay_from_a_blow_are_used(swimid: Run, tmp_path: Path) -> None:
    ran = swimid("fit-drag", generator.pushed_roll(tmp_path), "--json")
    assert "SWM018" not in ran.err
    assert "SWM024" not in ran.err
    assert ran.json["result"]["fit"]["samples"] == 320
    assert near(ran, "added_inertia", 0.02)


@pytest.mark.slow
def test_a_stated_gravity_stiffness_is_used(swimid: Run, tmp_path: Path) -> None:
    trials = generator.pitch_pendulum(tmp_path)
    robot = tmp_path / "robot.yaml"
    robot.write_text(robot.read_text() + "rig: {pitch_gravity_stiffness_N_m_rad: 2.4}\n")
    ran = swimid("fit-drag", trials, "--json")
    assert "SWM019" not in ran.err
    assert parameter(ran, "added_inertia")["value"] == pytest.approx(0.0, abs=1e-3)


def test_a_sound_tow_gives_no_warning(swimid: Run, tmp_path: Path) -> None:
    ran = swimid("fit-drag", generator.towed(tmp_path), "--json")
    assert not {"SWM024", "SWM110"} & {w["code"] for w in ran.json["warnings"]}
    assert near(ran, "quadratic_drag", 12.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault, option", [({"tare": -0.4}, "--free force_offset"), ({"drift": 0.03}, "--free force_drift")]
)
def test_an_offset_or_drift_of_the_force_at_rest_is_found(
    swimid: Run, tmp_path: Path, fault: dict, option: str
) -> None:
    ran = swimid("fit-drag", generator.towed(tmp_path, **fault))
    assert verdict(ran) == "BAD"
    assert option in ran.err


@pytest.mark.parametrize("turned, where", [(("tow1",), "tow1"), (("tow0", "tow1", "tow2"), "all trials")])
def test_the_wrong_sign_of_a_force_is_found(
    swimid: Run, tmp_path: Path, turned: tuple[str, ...], where: str
) -> None:
    ran = swimid("fit-drag", generator.towed(tmp_path, turned=turned))
    assert f"SWM110: with force_N times -1 in {where} the error of u_m_s falls" in ran.err
    assert "SWM024" not in ran.err
