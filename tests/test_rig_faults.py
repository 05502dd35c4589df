"""Effects and faults that the default model of a rig lacks."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Ran
from tests.generators import rig_faults as generator
from tests.test_rig_trials import near, parameter, rig, verdict

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
    assert (
        f"SWM110: force_N has the wrong sign in {where}: multiplied by -1, force_N lowers the error of u_m_s"
        in ran.err
    )
    assert "SWM024" not in ran.err


def test_an_omission_that_moves_no_estimate_is_no_reason_for_bad(swimid: Run, tmp_path: Path) -> None:
    """The force drifts by 0.02 N in 10 s, which is significant and changes the drag by 0.3 %."""
    ran = swimid("fit-drag", generator.towed(tmp_path, drift=0.002), "--json")
    assert "SWM024" in ran.err or "SWM024" in {w["code"] for w in ran.json["warnings"]}
    assert ran.json["verdict"]["level"] == "caution"
    assert parameter(ran, "quadratic_drag")["value"] == pytest.approx(12.0, rel=0.005)


def test_a_force_that_changes_in_steps_has_no_outliers(
    swimid: Run, tmp_path: Path, rng: np.random.Generator
) -> None:
    """A drive with dry friction: its force changes by 40 N within a sample where the body reverses."""
    time = np.arange(0.0, 12.0, 0.05)
    speed = 0.2 * np.sin(1.5 * time)
    force = 20.0 * np.sign(speed) + 100.0 * speed + 50.0 * 0.3 * np.cos(1.5 * time)
    place = 0.2 / 1.5 * (1.0 - np.cos(1.5 * time)) + 1e-5 * rng.normal(size=len(time))
    rows = [f"{t:.2f},{f:.5f},{x:.7f}" for t, f, x in zip(time, force, place, strict=True)]
    trials = rig(tmp_path, "towed", 50.0, "\n".join(["t_s,force_N,x_m", *rows]) + "\n")
    held = ("--fix", "quadratic_drag=0", "--fix", "added_mass=0")
    ran = swimid("fit-drag", trials, *held, "--free", "linear_drag", "--free", "dry_friction", "--json")
    assert ran.status == 0, ran.err
    assert "SWM058" not in {w["code"] for w in ran.json["warnings"]}
    assert parameter(ran, "linear_drag")["value"] == pytest.approx(100.0, rel=0.05)
    assert parameter(ran, "dry_friction")["value"] == pytest.approx(20.0, rel=0.05)


def decays(folder: Path, ratio: float, creep: float = 0.0, name: str = "x_m", rest: float = 0.0) -> Path:
    """Write three decays of 2.5 kg (or kg m2) on a spring of 50 N/m (or N m/rad), and return the trials file.

    ``creep`` is the motion of the rest position during the record, as a fraction of the first excursion.
    """
    (folder / "body.yaml").write_text(
        "format: swimid-robot/1\nname: body\nbody: {inertial_mass_kg: 2.0, yaw_inertia_kg_m2: 2.0}\n"
        "rig: {stiffness_N_m: 50.0, yaw_stiffness_N_m_rad: 50.0}\n"
    )
    time, rate = np.linspace(0.0, 4.0, 401), math.sqrt(50.0 / 2.5)
    damped = rate * cmath.sqrt(1.0 - ratio**2)
    shape = np.exp(-ratio * rate * time) * (
        np.cos(damped * time) + ratio * rate / damped * np.sin(damped * time)
    )
    lines = ["format: swimid-trials/1", "experiment: free-decay", "robot: body.yaml", "trials:"]
    for k, amplitude in enumerate((0.1, 0.12, 0.14)):
        noise = 1e-4 * np.random.default_rng(k).normal(size=len(time))
        values = amplitude * (shape.real + creep * time / 4.0) + noise + rest
        if name == "yaw_rad":
            values = np.angle(np.exp(1j * values))
        rows = [f"{t:.2f},{x:.6f}" for t, x in zip(time, values, strict=True)]
        (folder / f"{k}.csv").write_text("\n".join([f"t_s,{name}", *rows]) + "\n")
        lines.append(f"  - {{log: {k}.csv}}")
    (folder / "t.yaml").write_text("\n".join(lines) + "\n")
    return folder / "t.yaml"


@pytest.mark.parametrize("ratio, creep, allowed", [(0.25, 0.0, 0.01), (0.5, 0.0, 0.01), (0.25, 0.04, 0.03)])
def test_a_decay_with_one_overshoot_is_fitted(
    swimid: Run, tmp_path: Path, ratio: float, creep: float, allowed: float
) -> None:
    ran = swimid("fit-drag", decays(tmp_path, ratio, creep), "--fix", "quadratic_drag=0", "--json")
    assert ran.status == 0, ran.err
    damping = 2.0 * ratio * math.sqrt(50.0 * 2.5)
    assert parameter(ran, "linear_drag")["value"] == pytest.approx(damping, rel=allowed)
    assert near(ran, "added_mass", 0.5)


@pytest.mark.parametrize("ratio, creep", [(0.8, 0.0), (1.2, 0.0), (1.2, 0.3), (0.5, -0.3)])
def test_a_decay_without_an_overshoot_or_with_a_large_creep_is_refused(
    swimid: Run, tmp_path: Path, ratio: float, creep: float
) -> None:
    ran = swimid("fit-drag", decays(tmp_path, ratio, creep))
    assert ran.status == 3
    assert "does not oscillate" in ran.err
    assert "experiment: towed" in ran.err


def test_a_decay_about_a_heading_of_180_degrees_is_fitted(swimid: Run, tmp_path: Path) -> None:
    trials = decays(tmp_path, 0.05, name="yaw_rad", rest=math.pi)
    ran = swimid("fit-drag", trials, "--fix", "quadratic_damping=0", "--json")
    assert ran.status == 0, ran.err
    assert near(ran, "added_inertia", 0.5)
    assert not {"SWM002", "SWM018"} & {w["code"] for w in ran.json["warnings"]}
