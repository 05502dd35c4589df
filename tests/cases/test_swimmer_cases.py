"""Steady swimming, errors of a pose, and coefficients that nothing uses, on recorded inputs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from tests.conftest import Ran


def _checks(path: str) -> dict[str, str]:
    evidence = yaml.safe_load(Path(path).with_suffix(".evidence.json").read_text())
    return {c["name"]: c["verdict"] for c in evidence["checks"]}


@pytest.mark.slow
def test_a_model_without_drag_does_not_pass_on_runs_that_begin_in_motion(
    case: Callable[..., Path], swimid: Callable[..., Ran]
) -> None:
    folder = case("p-compare-steady-vacuous")
    swimid("fit-graybox", "trials.yaml", "--start-state", "estimate", "-o", "dead_fit.yaml")
    ran = swimid("compare", "trials.yaml", "--params", "dead_fit.yaml", "-o", "cmp.yaml")
    assert "BAD:" in ran.out
    text = " ".join(ran.out.split())
    assert "the model has no steady speed with the gait of f0.8, f1.0, f1.2, f1.4" in text
    assert _checks("cmp.yaml")["cruising speed"] == "fail"
    ran = swimid("fit-graybox", "trials.yaml", "--start-state", "steady", "-o", "none.yaml")
    assert ran.status == 4
    assert "never becomes steady" in ran.err
    assert not (folder / "none.yaml").exists()


@pytest.mark.slow
def test_the_right_model_started_in_steady_swimming_finds_its_coefficients(
    case: Callable[..., Path], swimid: Callable[..., Ran]
) -> None:
    folder = case("p-compare-steady-vacuous")
    text = (folder / "trials.yaml").read_text()
    (folder / "trials.yaml").write_text(text.replace("dead.yaml", "eel.yaml"))
    ran = swimid("fit-graybox", "trials.yaml", "--start-state", "steady", "-o", "fit.yaml")
    # two trials do not show whether the coefficients differ between trials, and nothing else is in doubt
    assert "19 checks pass" in ran.out
    assert "BAD" not in ran.out
    found = yaml.safe_load((folder / "fit.yaml").read_text())["parameters"]
    for name, true in {"c_ma": 1.0, "c_Ia": 1.0, "c_d": 1.2, "c_f": 0.02, "k_tail": 0.08}.items():
        assert found[name]["value"] == pytest.approx(true, abs=3 * found[name]["stderr"])
    ran = swimid("compare", "trials.yaml", "--params", "fit.yaml", "-o", "cmp.yaml")
    assert "GOOD:" in ran.out
    assert yaml.safe_load((folder / "cmp.yaml").read_text())["mean_speed_rmse_m_s"] < 5e-4


@pytest.mark.slow
def test_errors_of_a_pose_do_not_depend_on_where_the_runs_head(
    case: Callable[..., Path], swimid: Callable[..., Ran]
) -> None:
    vacuous = case("p-compare-steady-vacuous")
    swimid("fit-graybox", "trials.yaml", "--start-state", "estimate", "-o", "dead_fit.yaml")
    folder = case("p-pooled-range")
    (folder / "dead_fit.yaml").write_text((vacuous / "dead_fit.yaml").read_text())
    channels = {}
    for name in ("same", "turned"):
        swimid("compare", f"{name}.yaml", "--params", "dead_fit.yaml", "-o", f"{name}_cmp.yaml")
        channels[name] = yaml.safe_load((folder / f"{name}_cmp.yaml").read_text())["channels"]
    for channel in ("x_m", "y_m", "yaw_rad"):
        same, turned = (channels[name][channel] for name in ("same", "turned"))
        assert turned["nrmse"] == pytest.approx(same["nrmse"], rel=0.02)
        assert turned["vaf"] == pytest.approx(same["vaf"], abs=0.01)
    assert channels["turned"]["yaw_rad"]["vaf"] < 0.95


@pytest.mark.slow
def test_a_coefficient_that_nothing_uses_has_no_share(
    case: Callable[..., Path], swimid: Callable[..., Ran]
) -> None:
    case("c-34-sobol-of-nothing")
    assert swimid("sensitivity", "tr.yaml", "--samples", "500", "-o", "s.yaml").status == 2
    ranges = ("--range", "c_n=1,3", "--range", "c_a=0.1,0.6", "--range", "c_x=0,4")
    chosen = ("--coefficients", "c_n,c_a,c_x", "--samples", "64")
    ran = swimid("sensitivity", "tr.yaml", *ranges, *chosen, "-o", "s.yaml")
    assert ran.status == 0
    outputs = yaml.safe_load(Path("s.yaml").read_text())["outputs"]
    shares = [o["shares"]["c_x"] for o in outputs if "c_x" in o.get("shares", {})]
    assert shares
    assert all(s["total"]["value"] == 0.0 for s in shares)


@pytest.mark.slow
def test_errors_do_not_depend_on_the_direction_or_on_a_wrapped_heading(
    case: Callable[..., Path], swimid: Callable[..., Ran]
) -> None:
    case("t4-o16-heading-invariance")
    ran = swimid("fit-graybox", "as/trials.yaml", "--share", "c_f", "-o", "new.yaml")
    assert "GOOD:" in ran.out
    errors = []
    for name in ("as", "r90", "r180wrap", "r217wrap"):
        ran = swimid("compare", f"{name}/trials.yaml", "--params", "new.yaml", "-o", f"new_{name}.yaml")
        assert "GOOD:" in ran.out
        assert "SWM002" not in ran.err
        channels = yaml.safe_load(Path(f"new_{name}.yaml").read_text())["channels"]
        errors.append([channels[c]["rmse"] for c in ("x_m", "y_m", "yaw_rad")])
    for turned in errors[1:]:
        assert turned == pytest.approx(errors[0], rel=1e-3)


def test_a_simulation_halves_its_step_until_it_does_not_break_down(
    case: Callable[..., Path], swimid: Callable[..., Ran]
) -> None:
    case("t4-simulate_step")
    words = ("simulate", "--robot", "robot.yaml", "--frequency-hz", "2", "--amplitude-deg", "20")
    ran = swimid(*words, "--duration-s", "5", "--json")
    assert ran.status == 0, ran.err
    (run,) = ran.json["result"]["runs"]
    assert run["quantities"]["mean_speed_m_s"]["value"] == pytest.approx(0.5458, abs=1e-4)
