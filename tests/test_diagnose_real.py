"""Gaps between models and recordings made by others, whose causes are known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import ROOT, Ran
from tests.generators import real_logs

pytestmark = pytest.mark.slow

Command = Callable[..., Ran]


def diagnosed(swimid: Command, trials: Path, parameters: Path, *options: str) -> dict[str, Any]:
    """The gap file of a diagnosis."""
    ran = swimid("diagnose", trials, "--params", parameters, "--json", *options)
    assert ran.status == 0, ran.err
    return ran.json["result"]


def answer(gap: dict[str, Any]) -> set[str]:
    """The first cause and what cannot be told from it."""
    first = gap["causes"][0]
    return {first["effect"], *first["equivalent"]}


def left(gap: dict[str, Any]) -> float:
    """Error with the causes over that without them, on what took no part in the fit.

    It does not ask how large the noise is, which one record of unknown noise hardly tells.
    """
    (channel,) = gap["causes"][0]["shrinkage"]
    return float(channel["after"] / channel["before"])


def test_a_simulator_without_viscosity_lacks_roll_damping(
    swimid: Command, real_data: Path, tmp_path: Path
) -> None:
    """Stiffness over inertia agrees; what lacks is a damping force, of which form one decay does not tell."""
    simulated, measured = real_logs.write_roll(tmp_path, real_data)
    wave, nominal = tmp_path / "waves.yaml", tmp_path / "nominal.yaml"
    ran = swimid("fit-drag", simulated, "--fix", "quadratic_damping=0", "-o", wave, "--json")
    found = ran.json["result"]
    damping, stiffness = (found["parameters"][n]["value"] for n in ("linear_damping", "stiffness"))
    # the simulator's own: damping ratio 0.0016, period 2.54 s
    assert found["derived"]["damping_ratio_linear"]["value"] == pytest.approx(0.0016, abs=1e-4)
    fixed = ("--fix", "quadratic_damping=0", "--fix", f"linear_damping={damping:.5f}")
    assert swimid("fit-drag", simulated, *fixed, "-o", nominal).status == 0
    gap = diagnosed(swimid, measured, nominal)
    # the real decay leaves more than noise beside any one form of damping
    assert gap["verdict"] in ("explained", "ambiguous", "partial")
    assert gap["causes"][0]["effect"] in ("linear-drag", "quadratic-drag")
    assert answer(gap) <= {"linear-drag", "quadratic-drag", "pulley-friction", "load-friction"}
    assert gap["causes"][0]["probability"] > 0.7
    assert left(gap) < 0.5
    (absorbed,) = gap["causes"][0]["absorbed"]
    for side in ("without", "with_effect"):
        assert absorbed[side]["value"] == pytest.approx(stiffness, rel=0.02)
    if gap["causes"][0]["effect"] == "linear-drag":
        # the basin's damping ratio by itself is 0.0058
        more = gap["causes"][0]["parameters"]["linear_N_m_s_rad"]["value"]
        assert (damping + more) / (2 * np.sqrt(stiffness)) == pytest.approx(0.0058, rel=0.35)


def test_a_drive_modelled_as_viscous_lacks_dry_friction(
    swimid: Command, real_data: Path, tmp_path: Path
) -> None:
    """Published: 95.1 kg, 203.5 N s/m, 20.4 N. Twice integrated, what is left of the force still drifts."""
    trials, nominal = real_logs.write_screw_drive(tmp_path, real_data), tmp_path / "viscous.yaml"
    free = ("--free", "linear_drag", "--free", "force_offset")
    ran = swimid("fit-drag", trials, "--fix", "quadratic_drag=0", *free, "-o", nominal)
    assert ran.status == 0
    gap = diagnosed(swimid, trials, nominal)
    assert gap["verdict"] == "partial"
    assert [c["effect"] for c in gap["causes"]] == ["pulley-friction"]
    assert answer(gap) <= {"pulley-friction", "load-friction"}
    assert gap["causes"][0]["shrinkage"][0]["after"] < 0.014
    assert left(gap) < 0.8
    first = gap["causes"][0]
    friction = first["parameters"]["friction_N"]
    assert friction["stderr"] < 0.15 * 20.4
    assert abs(friction["value"] - 20.4) < 2.0 * friction["stderr"]
    numbers = {a["coefficient"]: a["with_effect"] for a in first["absorbed"]}
    assert numbers["linear_drag"]["stderr"] < 0.15 * 203.5
    assert abs(numbers["linear_drag"]["value"] - 203.5) < 2.0 * numbers["linear_drag"]["stderr"]
    assert 60 + numbers["added_mass"]["value"] == pytest.approx(95.1, rel=0.06)


def test_force_of_the_drive_that_dry_friction_leaves(real_data: Path) -> None:
    """The inverse model, with nothing simulated: 17 % of the force is left without it and 4 % with it."""
    time, position, force = real_logs.read_screw_drive(real_data)
    place, push = real_logs.smoothed(position), real_logs.smoothed(force)
    speed = np.gradient(place, time)
    columns = [np.gradient(speed, time), speed, np.ones_like(speed)]
    left = []
    for design in (columns, [*columns, np.sign(speed)]):
        rows = np.column_stack(design)[200:-200]
        weights = np.linalg.lstsq(rows, push[200:-200], rcond=None)[0]
        left.append(np.linalg.norm(push[200:-200] - rows @ weights) / np.linalg.norm(push[200:-200]))
    assert left[0] == pytest.approx(0.17, abs=0.01)
    assert left[1] == pytest.approx(0.04, abs=0.01)


def test_a_block_on_a_ramp_is_not_frictionless(swimid: Command, real_data: Path, tmp_path: Path) -> None:
    """Two slopes in films of unknown scale, which the moving mass takes up: coefficient about 0.33."""
    tracked = {}
    for name in ("R1", "R3"):
        video, setup = real_data / "phystrack" / f"{name}.MP4", tmp_path / f"{name}.yaml"
        tracked[name] = tmp_path / f"{name}-px.csv"
        assert swimid("track", "setup", video, "-o", setup).status == 0
        words = ("--setup", setup, "--fps", "240", "-o", tracked[name])
        assert swimid("track", "video", video, *words).status == 0
    trials, nominal = real_logs.write_ramp(tmp_path, tracked), tmp_path / "frictionless.yaml"
    assert swimid("fit-drag", trials, "--fix", "quadratic_drag=0", "-o", nominal).status == 0
    gap = diagnosed(swimid, trials, nominal)
    assert gap["verdict"] == "explained"
    assert answer(gap) == {"pulley-friction"}
    assert left(gap) < 0.12
    friction = gap["causes"][0]["parameters"]["friction_N"]["value"]
    # per weight across slopes of 21.9 and 26.6 degrees
    assert friction / (9.81 * np.cos(np.radians([21.9, 26.6])).mean()) == pytest.approx(0.33, abs=0.03)


def test_overflowing_tanks_are_unexplained(swimid: Command, real_data: Path, tmp_path: Path) -> None:
    """A linear black box; outflow as the root of the level, and a level that cannot pass 10 V."""
    trials, nominal = real_logs.write_tanks(tmp_path, real_data), tmp_path / "arx.yaml"
    orders = ("--input", "u", "--output", "y", "--na", "2", "--nb", "2")
    assert swimid("rwls", tmp_path / "estimation.csv", *orders, "-o", nominal).status == 0
    gap = diagnosed(swimid, trials, nominal)
    assert gap["verdict"] == "unexplained"
    assert not gap["causes"]


def test_a_cause_of_the_fish_reduces_held_out_errors(
    swimid: Command, real_data: Path, tmp_path: Path
) -> None:
    """Nothing is known to be missing: the amplitude that took no part in any fit judges what is named."""
    runs = real_logs.mild(real_logs.read_fish(real_data))
    robot, nominal = ROOT / "docs" / "examples" / "msu-fish.yaml", tmp_path / "fish.yaml"
    trials = real_logs.write_fish(tmp_path, runs, robot, lag_rad=real_logs.LAG_RAD, rates_only=True)
    words = ("--start-state", "estimate", "--free", "drive_phase", "--dt", "0.012")
    assert swimid("fit-graybox", trials, *words, "-o", nominal).status == 0
    gap = diagnosed(swimid, trials, nominal, "--dt", "0.012")
    if gap["verdict"] == "explained":
        rows = gap["causes"][0]["shrinkage"]
        assert np.mean([r["after"] / r["before"] for r in rows]) < 0.98
