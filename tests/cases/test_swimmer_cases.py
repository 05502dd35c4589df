"""Steady swimming, errors of a pose, and coefficients that nothing uses, on recorded inputs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from tests.conftest import Ran


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
