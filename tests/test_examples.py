"""The recipes in docs/examples: a fin by the recoil law, a PI controller, a scenario of Stonefish."""

from __future__ import annotations

import importlib.util
import json
import math
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

import control
import numpy as np
import pytest

import swimid
from swimid.blackbox.model import load_published, to_control
from tests.conftest import ROOT

EXAMPLES = ROOT / "docs" / "examples"


def recipe(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def at_root(monkeypatch: pytest.MonkeyPatch) -> None:
    """The recipes read the sample logs from the folder of the project."""
    monkeypatch.chdir(ROOT)


@pytest.fixture(scope="module")
def fitted(samples: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[swimid.Fitted, swimid.Fitted]:
    """Drag and propulsion of the sample boxfish."""
    drag = tmp_path_factory.mktemp("boxfish") / "drag.yaml"
    return (
        swimid.fit_drag(samples / "rig" / "trials.yaml", output=drag),
        swimid.fit_propulsion(
            samples / "cruise" / "trials.yaml", drag=drag, output=drag.with_name("propulsion.yaml")
        ),
    )


@pytest.mark.filterwarnings("ignore::swimid.SwimidWarning")
class TestFins:
    def test_the_speed_is_reached(self, fitted: tuple[swimid.Fitted, swimid.Fitted]) -> None:
        """``simulate`` with the gait of each fin swims at the speed that was asked for."""
        drag, propulsion = fitted
        table = recipe("fins").choose(drag, propulsion)
        assert table.index[0] == "3825Rect"
        assert len(table) == 4
        for name, gait in table.iterrows():
            made = swimid.simulate(
                params=propulsion.outputs[0], fin=name,
                frequency_hz=gait["frequency_hz"], amplitude_deg=gait["amplitude_deg"],
            )  # fmt: skip
            assert made.quantities["terminal_speed_m_s"].value == pytest.approx(0.1, rel=1e-9)
            assert gait["low_hz"] < gait["frequency_hz"] < gait["high_hz"]

    def test_the_least_power_by_hand(self, fitted: tuple[swimid.Fitted, swimid.Fitted]) -> None:
        """``k v^3 / eta (theta / (theta - theta_off))^2`` at the largest amplitude, of any fin."""
        drag, propulsion = fitted
        fins = recipe("fins")
        offset, most = propulsion["amplitude_offset_deg"].value, fins.AMPLITUDE_DEG[1]
        k = 0.5 * 997 * 0.00698 * drag["drag_coefficient"].value
        least = k * 0.1**3 / propulsion["recoil_efficiency"].value * (most / (most - offset)) ** 2
        table = fins.choose(drag, propulsion)
        assert table["amplitude_deg"].to_numpy() == pytest.approx(most)
        assert table["power_mW"].to_numpy() == pytest.approx(1e3 * least, rel=1e-9)

    def test_a_slow_servo_leaves_fins_out(
        self, fitted: tuple[swimid.Fitted, swimid.Fitted], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        fins = recipe("fins")
        monkeypatch.setattr(fins, "MAX_RATE_DEG_S", 300.0)
        assert list(fins.choose(*fitted).index) == ["3825Rect"]

    def test_it_runs(self, at_root: None, capsys: pytest.CaptureFixture[str]) -> None:
        recipe("fins").main()
        assert capsys.readouterr().out.count("simulated at 0.1000 m/s") == 4


class TestController:
    def test_tuned_first_order(self) -> None:
        """Of ``b / (z - a)``: the sensitivity is at its limit, and no neighbour with it integrates faster."""
        recipe_of = recipe("controller")
        plant = control.TransferFunction([0.05], [1.0, -0.95], 0.1)
        gain, integral = recipe_of.tune(plant)
        loop = plant * recipe_of.pi(gain, integral, 0.1)
        z = np.exp(1j * 0.1 * np.geomspace(1e-4, math.pi / 0.1, 20_000))
        limit = recipe_of.MAX_SENSITIVITY
        assert np.max(1.0 / np.abs(1.0 + loop(z))) == pytest.approx(limit, rel=1e-3)
        assert np.abs(control.feedback(loop, 1).poles()).max() < 1.0
        for factor in (0.9, 1.1):
            other = plant * recipe_of.pi(factor * gain, 1.03 * integral, 0.1)
            assert np.max(1.0 / np.abs(1.0 + other(z))) > limit * 0.999

    def test_the_published_vehicle(self) -> None:
        """The closed loop by the difference equations, one sample after the other, comes to its set point."""
        recipe_of = recipe("controller")
        file = load_published("long-fin-marching-3-2")
        plant = to_control(file)
        gain, integral = recipe_of.tune(plant)
        a = [file.value(f"a{k}") for k in (1, 2, 3) if f"a{k}" in file.parameters]
        b = [file.value(f"b{k}") for k in (1, 2, 3) if f"b{k}" in file.parameters]
        past_y, past_u, total, y = np.zeros(len(a)), np.zeros(len(b) + file.delay), 0.0, []
        for _ in range(6000):
            now = -np.dot(a, past_y) + np.dot(b, past_u[file.delay - 1 : file.delay - 1 + len(b)])
            total += 1.0 - now
            u = gain * (1.0 - now) + integral * plant.dt * total
            past_y, past_u = np.r_[now, past_y[:-1]], np.r_[u, past_u[:-1]]
            y.append(now)
        assert y[-1] == pytest.approx(1.0, abs=1e-3)
        assert control.stability_margins(plant * recipe_of.pi(gain, integral, plant.dt))[1] > 40.0

    def test_an_unstable_model_has_none(self) -> None:
        with pytest.raises(ValueError, match=r"unstable \(a pole of 1\.0013\)"):
            recipe("controller").tune(to_control(load_published("long-fin-rotating-4-3")))

    @pytest.mark.filterwarnings("ignore::swimid.SwimidWarning")
    def test_it_runs(self, at_root: None, capsys: pytest.CaptureFixture[str]) -> None:
        recipe("controller").main()
        assert "integral time 0.164 s" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore::swimid.SwimidWarning")
def test_stonefish_boxes_float_and_resist(samples: Path) -> None:
    """Each box displaces its link's mass, and drags as the link does at 1 m/s."""
    params = samples / "gap" / "params.yaml"
    robot_node = ET.fromstring(recipe("stonefish").scenario(params)).find("robot")
    assert robot_node is not None
    told = json.loads(swimid.export(params, to="json").document)
    nodes = [*robot_node.findall("base_link"), *robot_node.findall("link")]
    assert [node.get("name") for node in nodes] == [link["name"] for link in told["links"]]
    for node, link in zip(nodes, told["links"], strict=True):

        def numbers(tag: str, key: str, node: ET.Element = node) -> list[float]:
            found = node.find(tag)
            assert found is not None
            return [float(w) for w in (found.get(key) or "").split()]

        x, y, z = numbers("dimensions", "xyz")
        assert x == link["length_m"]
        assert 1000 * x * y * z == pytest.approx(link["mass_kg"], rel=1e-12)
        drag = numbers("hydrodynamics", "quadratic_drag")
        point = next(p for p in told["drag_points"] if p["link"] == link["name"])
        assert 500 * drag[0] * y * z == pytest.approx(point["quadratic_x"], rel=1e-12)
        assert 500 * drag[1] * x * z == pytest.approx(point["quadratic_y"], rel=1e-12)
    assert len(robot_node.findall("joint")) == len(told["joints"]) == 4
    assert len(robot_node.findall("actuator")) == 3
