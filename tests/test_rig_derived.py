"""Quantities derived from the parameters of a rig, and the limits of what a body can have."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from swimid.rig import fit_drag as checks
from tests.conftest import Ran
from tests.generators import rig as generator
from tests.generators.files import write_log, write_trials

Run = Callable[..., Ran]


def _decay(folder: Path, *, linear: float, quadratic: float, rng: np.random.Generator) -> Path:
    """Roll decay of a hull of 0.7 kg m2 in all, 4 N m/rad, from 0.3 rad."""
    (folder / "hull.yaml").write_text(
        "format: swimid-robot/1\nname: hull\nbody: {roll_inertia_kg_m2: 0.5}\n"
        "rig: {roll_stiffness_N_m_rad: 4.0}\n"
    )
    time = np.arange(0, 20, 0.02)
    run = solve_ivp(
        lambda _, s: [s[1], (-4.0 * s[0] - linear * s[1] - quadratic * s[1] * abs(s[1])) / 0.7],
        (0, 20), [0.3, 0], t_eval=time, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    write_log(folder / "roll.csv", {"t_s": time, "roll_rad": run.y[0] + rng.normal(0, 1e-3, len(time))})
    return write_trials(folder / "decay.yaml", "free-decay", "hull.yaml", ["log: roll.csv"])


@pytest.mark.parametrize("linear, quadratic", [(0.04, 0.0), (0.0, 0.3), (0.04, 0.1)])
def test_the_damping_ratio_agrees_with_the_energy_of_a_swing(
    swimid: Run, tmp_path: Path, rng: np.random.Generator, linear: float, quadratic: float
) -> None:
    """Compare with the energy that a swing of the stated amplitude loses, by quadrature."""
    ran = swimid("fit-drag", _decay(tmp_path, linear=linear, quadratic=quadratic, rng=rng), "--json")
    found = ran.json["result"]["derived"]
    amplitude, rate = found["first_swing"]["value"], math.sqrt(4.0 / 0.7)
    speed = amplitude * rate * np.cos(np.linspace(0, 2 * np.pi, 4001))
    lost = np.trapezoid((linear * np.abs(speed) + quadratic * speed**2) * np.abs(speed), dx=2 * np.pi / 4000)
    expected = lost / rate / (4 * np.pi * 0.5 * 4.0 * amplitude**2)
    e = found["damping_ratio_first_swing"]
    assert abs(e["value"] - expected) < 4 * e["stderr"]
    small = found["damping_ratio_linear"]
    # without linear damping the estimate may lie at zero, where it has no error
    assert abs(small["value"] - linear / (2 * 0.7 * rate)) < 4 * (small["stderr"] or 1e-12)


def test_a_function_of_fixed_parameters_is_fixed(
    swimid: Run, tmp_path: Path, rng: np.random.Generator
) -> None:
    trials = _decay(tmp_path, linear=0.04, quadratic=0.1, rng=rng)
    ran = swimid("fit-drag", trials, "--fix", "added_inertia=0.2", "--json")
    period = ran.json["result"]["derived"]["natural_period_s"]
    assert period["status"] == "fixed"
    assert period["stderr"] is None
    for name, e in ran.json["result"]["derived"].items():
        assert e["status"] != "estimated" or e["stderr"] > 0, name


def test_a_function_of_a_parameter_at_its_bound_has_no_error(swimid: Run, tmp_path: Path) -> None:
    trials = generator.write_falls(tmp_path, np.random.default_rng(0))
    ran = swimid("fit-drag", trials, "--bounds", "drag_coefficient=0,0.69", "--json")
    derived = ran.json["result"]["derived"]
    assert derived["terminal_speed[w20]"]["status"] == "at-bound"
    assert derived["terminal_speed[w20]"]["stderr"] is None


def test_a_known_combination_is_a_sum_of_dimensionless_ratios(swimid: Run, tmp_path: Path) -> None:
    """No unit is added to another, and the terms add up to the stated value."""
    short = {"weights_g": (20, 23), "length_m": 0.08, "noise_m": 3e-3}
    trials = generator.write_falls(tmp_path, np.random.default_rng(0), **short)
    result = swimid("fit-drag", trials, "--json").json["result"]
    (words,) = [name for name in result["derived"] if "/(" in name]
    found = result["derived"][words]
    assert found["unit"] == "1"
    terms = re.findall(r"([+-]?) ?([\d.]*) ?(\w+)/\(([-+.\de]+) ?([^)]*)\)", words)
    assert {name for _, _, name, _, _ in terms} == {"drag_coefficient", "added_mass", "pulley_friction"}
    whole = 0.0
    for sign, factor, name, size, unit in terms:
        assert unit == result["parameters"][name]["unit"].removeprefix("1")
        part = float(factor or 1) * result["parameters"][name]["value"] / float(size)
        whole += -part if sign == "-" else part
    assert whole == pytest.approx(found["value"], rel=0.02)


class TestPossible:
    @pytest.mark.parametrize("stated, level", [(1.0, "GOOD"), (3.0, "CAUTION"), (10.0, "BAD"), (1e3, "BAD")])
    def test_added_mass_of_a_bead(self, swimid: Run, tmp_path: Path, stated: float, level: str) -> None:
        """The weight of a bead of 35 mg in water is right, too large by a factor, or in millinewtons."""
        mass, radius, density = 3.5e-5, 1e-3, 997.0
        displaced, area = density * 4 / 3 * np.pi * radius**3, np.pi * radius**2
        force = (mass - displaced) * 9.81
        rng = np.random.default_rng(1)
        (tmp_path / "bead.yaml").write_text(
            "format: swimid-robot/1\nname: bead\n"
            f"body: {{inertial_mass_kg: {mass}, frontal_area_m2: {area}}}\n"
        )
        lines = []
        time = np.arange(0, 0.5, 1 / 120)
        for k in range(3):
            run = solve_ivp(
                lambda _, s: [
                    s[1],
                    (force - 0.5 * density * 0.5 * area * s[1] ** 2) / (mass + 0.5 * displaced),
                ],
                (0, 0.5), [0, 0], t_eval=time, rtol=1e-10, atol=1e-14,
            )  # fmt: skip
            write_log(tmp_path / f"b{k}.csv", {"t_s": time, "x_m": run.y[0] + rng.normal(0, 2e-4, len(time))})
            lines.append(f"log: b{k}.csv, driving_force_N: {force * stated}")
        write_trials(tmp_path / "t.yaml", "falling-weight", "bead.yaml", lines)
        ran = swimid("fit-drag", tmp_path / "t.yaml")
        last = " ".join(ran.out.strip().split("\n\n")[-1].split())
        assert ("SWM072" in ran.err) is (stated > 1.0)
        assert ("the driving force of" in ran.err) is (stated > 1.0)
        reasons = last.partition(" checks failed")[2]
        assert ("added mass" in reasons) is (level == "BAD")
        if stated > 1.0:
            assert last.startswith(level)

    @pytest.mark.parametrize("factor", [1.0, 10.0])
    def test_every_pulling_weight_ten_times_too_large(
        self, swimid: Run, tmp_path: Path, factor: float
    ) -> None:
        """All trials agree with each other, but no body has the estimates."""
        weights = tuple(range(10, 41, 5))
        trials = generator.write_falls(
            tmp_path, np.random.default_rng(0), stated_g={weight: factor * weight for weight in weights}
        )
        ran = swimid("fit-drag", trials)
        last = " ".join(ran.out.strip().split("\n\n")[-1].split())
        reasons = last.partition(" checks failed")[2]
        assert ("drag coefficient" in reasons) is (factor > 1.0)
        assert ("SWM072" in ran.err) is (factor > 1.0)
        assert last.startswith("BAD") is (factor > 1.0)

    def test_a_body_that_rises(self, swimid: Run, tmp_path: Path) -> None:
        """A ball of 2.7 g and 40 mm in water is driven by twelve times its weight, which is its lift."""
        mass, radius, density = 2.7e-3, 0.02, 997.0
        displaced, area = density * 4 / 3 * np.pi * radius**3, np.pi * radius**2
        force = (displaced - mass) * 9.81
        rng = np.random.default_rng(2)
        (tmp_path / "ball.yaml").write_text(
            "format: swimid-robot/1\nname: ball\n"
            f"body: {{inertial_mass_kg: {mass}, frontal_area_m2: {area}}}\n"
        )
        lines = []
        time = np.arange(0, 0.8, 1 / 120)
        whole, drag = mass + 0.5 * displaced, 0.25 * density * area
        for k in range(3):
            run = solve_ivp(
                lambda _, s: [s[1], (force - drag * s[1] ** 2) / whole],
                (0, 0.8), [0, 0], t_eval=time, rtol=1e-10, atol=1e-14,
            )  # fmt: skip
            write_log(tmp_path / f"r{k}.csv", {"t_s": time, "x_m": run.y[0] + rng.normal(0, 2e-4, len(time))})
            lines.append(f"log: r{k}.csv, driving_force_N: {force}")
        write_trials(tmp_path / "t.yaml", "falling-weight", "ball.yaml", lines)
        ran = swimid("fit-drag", tmp_path / "t.yaml", "--json")
        assert "SWM072" not in ran.err
        assert ran.json["result"]["parameters"]["added_mass"]["value"] == pytest.approx(
            0.5 * displaced, rel=0.05
        )

    def test_discs_and_balls_have_less_drag_than_the_limit(self) -> None:
        """Clift, Grace and Weber (1978), tables 5.1 and 6.2: balls and discs across the flow."""
        for reynolds, ball, disc in (
            (0.1, 245.0, 207.0),
            (1.0, 27.2, 23.9),
            (10.0, 4.26, 4.1),
            (100.0, 1.09, 1.8),
        ):
            assert max(ball, disc) < checks.max_drag_coefficient(reynolds)
        assert checks.max_drag_coefficient(1e5) < 3.01
        # the viscosity of oil is unknown
        assert math.isnan(checks.max_drag_coefficient(checks.reynolds(1.0, 0.1, 880.0)))

    def test_known_bodies_have_less_added_mass_than_the_limit(self) -> None:
        density = 1000.0
        # a sphere of 1 m: half its water; discs of radius 1 m, 8/3 of it cubed, thicker than a tenth
        ball = density * np.pi / 6
        assert 0.5 * ball < checks.max_added_mass(ball, np.pi / 4, density)
        for thick in (0.1, 0.5, 2.0):
            water = density * np.pi * thick
            assert 8 / 3 * density < checks.max_added_mass(water, None, density)
            assert 8 / 3 * density < checks.max_added_mass(water, np.pi, density)
        for length in (1.0, 2.0, 5.0, 10.0):
            prism = checks.prism_added_mass(length, 1.0, 1.0, density)
            assert prism < checks.max_added_mass(density * length, 1.0, density)
            assert prism < checks.max_added_mass_in_box(length, 1.0, 1.0, density, along=True)
        # a cylinder across its axis has as much as its own water
        cylinder = density * np.pi / 4 * 3.0
        assert cylinder < checks.max_added_mass_in_box(3.0, 1.0, 1.0, density, along=False)
        # a spheroid of axes 2 and 1 turning end over end: 0.15 of its own water's (Lamb, section 115)
        spheroid = density * np.pi / 6 * 2.0 * (1.0 + 0.25) / 5.0
        assert 0.15 * spheroid < checks.max_added_inertia(2.0, 1.0, 1.0, density)
