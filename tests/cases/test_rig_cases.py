"""Recorded inputs of rigs: free decays, towed bodies and falling weights."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import Ran
from validation.real_gaps.row import Sources
from validation.real_gaps.rows import screw_drive

Run = Callable[..., Ran]
Case = Callable[..., Path]


def verdict(ran: Ran) -> str:
    """Return the grade of the verdict, the last paragraph of the summary."""
    return ran.out.strip().split("\n\n")[-1].split(":")[0]


def parameter(ran: Ran, name: str) -> dict:
    """Return an estimate of the JSON result, or a quantity derived from estimates."""
    result = ran.json["result"]
    found: dict = {**result["parameters"], **result["derived"]}[name]
    return found


def near(ran: Ran, name: str, true: float, errors: float = 3.0) -> bool:
    """Return whether an estimate lies within so many of its standard errors of the truth."""
    e = parameter(ran, name)
    return bool(abs(e["value"] - true) <= errors * e["stderr"])


@pytest.mark.parametrize("record", ["short", pytest.param("long", marks=pytest.mark.slow)])
def test_a_decay_is_kept_from_its_first_swing_on(case: Case, swimid: Run, record: str) -> None:
    case("r-decay-first-swing-cut", "make.py")
    ran = swimid("fit-drag", f"{record}.yaml", "--json")
    assert "SWM018" not in ran.err
    assert parameter(ran, "first_swing")["value"] == pytest.approx(0.95, abs=0.002)
    assert near(ran, "natural_period_s", 2.0 * math.pi / 7.9)


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4, 5, 6, 7))]
)
def test_dry_friction_is_named_beside_a_linear_damping(case: Case, swimid: Run, seed: int) -> None:
    case("r-decay-good-dry-as-linear", ("make.py", str(seed), "1"))
    ran = swimid("fit-drag", "d.yaml", "--fix", "quadratic_damping=0")
    assert verdict(ran) in ("CAUTION", "BAD")
    assert "SWM024" in ran.err
    assert "--free dry_friction" in ran.err


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4, 5, 6, 7))]
)
def test_a_pendulum_is_named_in_the_place_of_a_spring(case: Case, swimid: Run, seed: int) -> None:
    case("r-decay-good-large-swing", ("make.py", str(seed), "0"))
    held = ("--fix", "quadratic_damping=0")
    ran = swimid("fit-drag", "d.yaml", *held)
    assert verdict(ran) in ("CAUTION", "BAD")
    assert "--fix gravity_stiffness=0.48 --fix stiffness=0" in ran.err
    again = ("--fix", "gravity_stiffness=0.48", "--fix", "stiffness=0", "--json")
    ran = swimid("fit-drag", "d.yaml", *held, *again)
    assert near(ran, "added_inertia", 0.0018)
    assert near(ran, "natural_period_s", 0.7423)


def test_a_linear_drag_has_a_terminal_speed(case: Case, swimid: Run) -> None:
    case("r-linear-drag-no-terminal-speed", "make.py")
    linear = ("--free", "linear_drag", "--fix", "drag_coefficient=0", "--fix", "added_mass=0")
    ran = swimid("fit-drag", "t.yaml", *linear, "--json")
    assert parameter(ran, "terminal_speed[t1]")["value"] == pytest.approx(0.0278, rel=1e-3)
    assert "SWM024" not in ran.err
    assert "SWM024" not in swimid("fit-drag", "t.yaml").err


@pytest.mark.parametrize(
    "record, tare", [pytest.param("tare", 0.08, marks=pytest.mark.slow), ("tare2", 0.02)]
)
def test_the_tare_of_a_load_cell_is_named(case: Case, swimid: Run, record: str, tare: float) -> None:
    case("c-11-load-cell-tare")
    ran = swimid("fit-drag", f"{record}.yaml")
    assert verdict(ran) == "BAD"
    found = re.search(r"force_offset −(\S+) ±", ran.err)
    assert found
    assert float(found[1]) == pytest.approx(tare, abs=0.001)
    assert "--free force_offset" in ran.err


@pytest.mark.slow
def test_a_freed_tare_gives_the_drag(case: Case, swimid: Run) -> None:
    case("c-11-load-cell-tare")
    ran = swimid("fit-drag", "tare.yaml", "--free", "force_offset", "--json")
    assert near(ran, "drag_coefficient", 0.705)
    assert near(ran, "added_mass", 0.684)
    assert near(ran, "force_offset", -0.08)
    assert "SWM024" not in ran.err


@pytest.mark.slow
def test_the_drift_of_a_load_cell_is_named(case: Case, swimid: Run) -> None:
    case("c-11-load-cell-tare", "gen2.py")
    ran = swimid("fit-drag", "drift.yaml")
    assert verdict(ran) == "BAD"
    assert "--free force_drift" in ran.err


@pytest.mark.slow
def test_perfect_data_give_their_parameters(case: Case, swimid: Run) -> None:
    case("c-23-perfect-data")
    ran = swimid("fit-drag", "perf.yaml", "--json")
    for name, true in {"drag_coefficient": 0.705, "added_mass": 0.684, "pulley_friction": 0.0308}.items():
        assert parameter(ran, name)["value"] == pytest.approx(true, abs=1e-9)


@pytest.mark.parametrize("record", ["hold", pytest.param("off", marks=pytest.mark.slow)])
def test_a_decay_that_is_held_or_rests_aside(case: Case, swimid: Run, record: str) -> None:
    case("c-27-free-decay-held-and-offset")
    ran = swimid("fit-drag", f"{record}.yaml", "--json")
    for name, true in {"added_inertia": 0.0015, "linear_damping": 0.004, "quadratic_damping": 0.012}.items():
        assert near(ran, name, true), name
    assert ("SWM018" in ran.err) == (record == "hold")


@pytest.mark.slow
def test_degrees_under_a_name_in_radians_are_bad(case: Case, swimid: Run) -> None:
    case("c-27-free-decay-held-and-offset")
    ran = swimid("fit-drag", "deg.yaml")
    assert "SWM002" in ran.err
    assert verdict(ran) == "BAD"


@pytest.mark.slow
def test_a_body_towed_backwards(case: Case, swimid: Run) -> None:
    case("c-31-towed-backwards", "gen.py")
    ran = swimid("fit-drag", "back.yaml", "--json")
    assert near(ran, "drag_coefficient", 0.705)
    assert near(ran, "added_mass", 0.684)
    assert "SWM024" not in ran.err
    assert "SWM110" not in ran.err


@pytest.mark.slow
def test_a_decay_whose_swings_a_creep_hides_is_fitted(case: Case, swimid: Run) -> None:
    """A programmed spring of 15 kN/m. The body is still pushed before its first extreme, at 4 ms."""
    folder = case("t4-decay-of-quarter-damping-refused")
    text = (folder / "d25.yaml").read_text()
    (folder / "later.yaml").write_text(text.replace(".csv", ".csv, start_s: 0.004"))
    held = ("--fix", "quadratic_drag=0")
    assert swimid("fit-drag", "d25.yaml", *held, "-o", "whole.yaml").status == 0
    ran = swimid("fit-drag", "later.yaml", *held, "--json")
    assert near(ran, "stiffness", 15000.0)
    assert parameter(ran, "linear_drag")["value"] == pytest.approx(25.3, rel=0.15)


@pytest.mark.parametrize("record", ["d50", pytest.param("d50_s0.04", marks=pytest.mark.slow)])
def test_a_decay_that_hardly_swings_says_what_to_do(case: Case, swimid: Run, record: str) -> None:
    case("t4-decay-of-quarter-damping-refused")
    ran = swimid("fit-drag", f"{record}.yaml", "--fix", "quadratic_drag=0")
    assert ran.status == 3
    assert "needs 'experiment: towed' with a measured force" in " ".join(ran.err.split())


@pytest.mark.slow
@pytest.mark.parametrize("record", ["tow", "clean"])
def test_a_drift_that_changes_nothing_is_caution(case: Case, swimid: Run, record: str) -> None:
    """Noise of the force looks like a drift. Without the spikes its interval contains zero."""
    case("t4-o02-loadcell-spikes")
    ran = swimid("fit-drag", f"{record}.yaml")
    assert verdict(ran) == {"tow": "CAUTION", "clean": "GOOD"}[record]
    assert ("which changes no estimate materially" in " ".join(ran.out.split())) == (record == "tow")


@pytest.mark.slow
@pytest.mark.parametrize("drift", [(), ("--free", "force_drift")])
def test_a_drive_that_is_fitted_within_its_errors_is_caution(
    real_data: Path, swimid: Run, tmp_path: Path, drift: tuple[str, ...]
) -> None:
    """A drift is named beside the published friction; with it, nothing is left to name."""
    screw_drive.write(Sources(real_data, real_data), tmp_path)
    trials = tmp_path / "drive.yaml"
    free = ("--free", "dry_friction", "--free", "linear_drag", "--free", "force_offset", *drift)
    ran = swimid("fit-drag", trials, "--fix", "quadratic_drag=0", *free)
    assert verdict(ran) == "CAUTION"
    assert ("SWM024" in ran.err) is not bool(drift)
    assert "SWM058" not in ran.err
