"""``swimid optimise gait`` of robots without links: the recoil law in closed form, PI loops by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import control
import numpy as np
import pytest

import swimid as package
from swimid.blackbox.model import published
from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.optimisation import controller
from swimid.optimisation.controller import SpeedController
from swimid.optimisation.fins import FinChoice
from tests.conftest import Ran


@pytest.fixture(scope="module")
def propulsion(tmp_path_factory: pytest.TempPathFactory, samples: Path) -> Path:
    """The sample boxfish, identified."""
    folder = tmp_path_factory.mktemp("boxfish")
    package.fit_drag(samples / "rig" / "trials.yaml", output=folder / "drag.yaml")
    package.fit_propulsion(
        samples / "cruise" / "trials.yaml", drag=folder / "drag.yaml", output=folder / "propulsion.yaml"
    )
    return folder / "propulsion.yaml"


#: Frequencies up to those at which runs depart from the law.
BEYOND = {"frequency_hz": (1.0, 4.0)}


class TestFins:
    def test_the_speed_is_reached(self, propulsion: Path) -> None:
        """``simulate`` with the gait of each fin swims at the speed that was asked for.

        The smallest needs more than 3 Hz: beyond the runs that the law was fitted to.
        """
        within = package.optimise_gait(params=propulsion, reach_speed_m_s=0.1)
        assert isinstance(within, FinChoice)
        assert sum(one.power_W is None for one in within.file.fins) == 1
        found = package.optimise_gait(params=propulsion, reach_speed_m_s=0.1, vary=BEYOND)
        assert isinstance(found, FinChoice)
        for one in found.file.fins:
            made = package.simulate(
                params=propulsion, fin=one.fin, frequency_hz=one.frequency_hz, amplitude_deg=one.amplitude_deg
            )
            assert made.quantities["terminal_speed_m_s"].value == pytest.approx(0.1, rel=1e-9)
            assert one.rate_rad_s == pytest.approx(
                2 * math.pi * one.frequency_hz * math.radians(one.amplitude_deg)
            )
            low, high = one.frequency_ci95
            assert low < one.frequency_hz < high

    def test_the_least_power_by_hand(self, propulsion: Path) -> None:
        """``k v^3 / eta (theta / (theta - theta_off))^2``: the largest amplitude, the slowest servo."""
        found = package.optimise_gait(params=propulsion, reach_speed_m_s=0.1, vary=BEYOND)
        assert isinstance(found, FinChoice)
        values = package.load_result(propulsion).file.parameters
        offset, most = values["amplitude_offset_deg"].value, found.file.amplitude_deg[1]
        lost = (most / (most - offset)) ** 2
        for one in found.file.fins:
            assert one.amplitude_deg == pytest.approx(most)
            assert one.power_W == pytest.approx(found.file.least_power_W * lost, rel=1e-9)
        assert found.best.fin == "3825Rect"
        assert found.best.rate_rad_s == min(one.rate_rad_s for one in found.file.fins)
        assert found.verdict == "caution"

    def test_limits_leave_fins_out(self, propulsion: Path) -> None:
        """A servo too slow for the small fins; a slower one for any."""
        found = package.optimise_gait(
            params=propulsion, reach_speed_m_s=0.1, limits={"joint_rate_deg_s": 300.0}
        )
        assert isinstance(found, FinChoice)
        assert [one.fin for one in found.file.fins if one.power_W is not None] == ["3825Rect"]
        with pytest.raises(NoTrustworthyResult, match="no fin reaches"):
            package.optimise_gait(params=propulsion, reach_speed_m_s=0.1, limits={"joint_rate_deg_s": 100.0})

    @pytest.mark.parametrize(
        ("changed", "says"),
        [
            ({"reach_speed_m_s": None}, "reach_speed"),
            ({"vary": {"K_s": (0.1, 1.0)}}, "no 'K_s'"),
            ({"vary": {"frequency_hz": (2.0, 1.0)}}, "below"),
            ({"limits": {"torque_N_m": 1.0}}, "not for fins"),
        ],
    )
    def test_what_is_refused(self, propulsion: Path, changed: dict[str, object], says: str) -> None:
        given = {"params": propulsion, "reach_speed_m_s": 0.1, **changed}
        with pytest.raises((UsageError, InputError), match=says):
            package.optimise_gait(**{k: v for k, v in given.items() if v is not None})


class TestController:
    def test_tuned_first_order(self) -> None:
        """Of ``b / (z - a)``: the sensitivity is at its limit, and no neighbour with it integrates faster."""
        plant = control.TransferFunction([0.05], [1.0, -0.95], 0.1)
        gain, integral = controller.tuned(plant)
        loop = plant * control.TransferFunction([gain + 0.1 * integral, -gain], [1.0, -1.0], 0.1)
        omega = np.geomspace(1e-4, math.pi / 0.1, 20_000)
        response = loop(np.exp(1j * 0.1 * omega))
        assert np.max(1.0 / np.abs(1.0 + response)) == pytest.approx(controller.SENSITIVITY, rel=1e-3)
        assert np.abs(control.feedback(loop, 1).poles()).max() < 1.0
        for factor in (0.9, 1.1):
            other = plant * control.TransferFunction(
                [factor * gain + 0.1 * 1.03 * integral, -factor * gain], [1.0, -1.0], 0.1
            )
            assert (
                np.max(1.0 / np.abs(1.0 + other(np.exp(1j * 0.1 * omega)))) > controller.SENSITIVITY * 0.999
            )

    def test_the_published_vehicle(self) -> None:
        """Its table by the sum of coefficients; margins by the frequency response; the loop in time."""
        file = published("long-fin-marching-3-2")
        found = package.optimise_gait(params=file, vary={"cmd1_rad": (0.0, 0.4)})
        assert isinstance(found, SpeedController)
        a = [file.value(f"a{k}") for k in (1, 2, 3) if f"a{k}" in file.parameters]
        b = [file.value(f"b{k}") for k in (1, 2, 3) if f"b{k}" in file.parameters]
        assert found.file.steady_gain == pytest.approx(sum(b) / (1.0 + sum(a)))
        assert found.file.steps[-1].output == pytest.approx(0.4 * found.file.steady_gain)
        # the closed loop by the difference equations, one sample after the other
        gain, time, step = found.file.gain, found.file.integral_time_s, found.file.sample_time_s
        past_y, past_u, total, y = np.zeros(len(a)), np.zeros(len(b) + file.delay), 0.0, []
        for _ in range(6000):
            now = -np.dot(a, past_y) + np.dot(b, past_u[file.delay - 1 : file.delay - 1 + len(b)])
            total += 1.0 - now
            u = gain * ((1.0 - now) + step / time * total)
            past_y, past_u = np.r_[now, past_y[:-1]], np.r_[u, past_u[:-1]]
            y.append(now)
        assert y[-1] == pytest.approx(1.0, abs=1e-3)
        assert max(y) - 1.0 == pytest.approx(found.file.overshoot, abs=0.01)
        assert found.file.phase_margin_deg > controller.PHASE_DEG
        assert found.verdict == "good"

    def test_an_unstable_model_has_none(self) -> None:
        with pytest.raises(NoTrustworthyResult, match=r"unstable \(a pole of 1\.0013\)"):
            package.optimise_gait(params=published("long-fin-rotating-4-3"), vary={"cmd1_rad": (0.0, 0.4)})

    def test_another_input(self) -> None:
        with pytest.raises(UsageError, match="cmd1_rad=LOW,HIGH"):
            package.optimise_gait(
                params=published("long-fin-marching-3-2"), vary={"frequency_hz": (1.0, 2.0)}
            )

    def test_the_commands_and_their_report(
        self, swimid: Callable[..., Ran], tmp_path: Path, samples: Path, propulsion: Path
    ) -> None:
        arma, loop, fin = (tmp_path / f"{name}.yaml" for name in ("arma", "loop", "fin"))
        log = samples / "longfin" / "longfin_marching.csv"
        words = ("--input", "cmd1_rad", "--output", "u_m_s", "--na", "4", "--nb", "3")
        assert swimid("rwls", log, *words, "-o", arma).status == 0
        ran = swimid("optimise", "gait", "--params", arma, "--vary", "cmd1_rad=0,0.5", "-o", loop)
        assert ran.status == 0
        assert "PI controller" in ran.out
        found = package.load_result(loop)
        assert isinstance(found, SpeedController)
        assert found.file.stable_draws is not None
        low, high = found.file.steady_gain_ci95
        assert low < found.file.steady_gain < high
        ran = swimid("optimise", "gait", "--params", propulsion, "--reach-speed-m-s", "0.1", "-o", fin)
        assert ran.status == 0
        page = tmp_path / "page.html"
        assert swimid("report", loop, fin, "-o", page).status == 0
        assert "From steps to speeds" in page.read_text()
        assert "What reaches the speed" in page.read_text()
