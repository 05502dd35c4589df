"""Propellers, rudders and hydrodynamic derivatives in the plane and in space, against the MMG method."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from swimid.errors import InputError
from swimid.fitting.model import SwimInput, Trial
from swimid.results import parameters
from swimid.swimmer.trials import robot_model
from tests.conftest import ROOT
from tests.generators import real_logs, ship

EXAMPLE = ROOT / "docs" / "examples" / "kvlcc2.yaml"


def rudder(now: float) -> float:
    return float(0.35 * np.sin(0.17 * now) * np.tanh(now))


def rate(now: float) -> float:
    return float(9.0 + 1.5 * np.sin(0.11 * now + 1.0))


SWIM = SwimInput(
    inputs={
        "screw": lambda time_s: np.array([rate(float(t)) for t in time_s]),
        "helm": lambda time_s: np.array([rudder(float(t)) for t in time_s]),
    },
    pose=(0.0, 0.0, 0.0),
)


def in_space(path: Path) -> Path:
    """Write the ship as a robot in space, whose forces all act in its plane, and return the path."""
    told = yaml.safe_load(EXAMPLE.read_text())
    flat = told.pop("multilink")
    hull = flat["links"][0]
    inertia = hull["inertia_kg_m2"]

    def at(station: float) -> list[float]:
        return [3.5 - station, 0.0, 0.0]

    elements: list[dict[str, Any]] = []
    for element in flat["elements"]:
        own = {
            key: value for key, value in element.items() if not key.startswith(("surge", "sway", "inertia"))
        }
        own |= {key: at(value) for key, value in element.items() if key.endswith("at_m")}
        if element["kind"] == "added-mass":
            own["mass_kg"] = [element["surge_kg"], element["sway_kg"], element["sway_kg"]]
            own["inertia_kg_m2"] = [0.0, 0.0, element["inertia_kg_m2"]]
        elements.append(own)
    told["multibody"] = {
        "coefficients": flat["coefficients"],
        "inputs": flat["inputs"],
        "links": [
            {
                "name": "hull",
                "mass_kg": hull["mass_kg"],
                "com_m": at(hull["com_m"]),
                "inertia_kg_m2": [0.1 * inertia, inertia, inertia],
            }
        ],
        "elements": elements,
    }
    path.write_text(yaml.safe_dump(told))
    return path


@pytest.mark.parametrize("kind", ["plane", "space"])
def test_ship_moves_as_by_the_mmg_method(kind, tmp_path):
    path = EXAMPLE if kind == "plane" else in_space(tmp_path / "ship.yaml")
    _, model = robot_model(str(path))
    time = np.arange(0.0, 60.01, 0.1)
    # a positive rudder angle turns the ship to port here, and to starboard in the source
    expected = ship.simulate(ship.Ship(), time, lambda now: -rudder(now), rate)
    values = np.array([{"initial_surge": 1.1}.get(p.name, p.start) for p in model.parameters])
    swim = SWIM if kind == "plane" else replace(SWIM, pose=(0.0,) * 6)

    found = model.simulate(values, Trial("run", "fit", time, {}, swim=swim))

    assert np.ptp(expected["yaw_rad"]) > 1.0
    for name in ("x_m", "y_m", "yaw_rad", "u_m_s", "v_m_s", "yaw_rate_rad_s"):
        assert found[name] == pytest.approx(expected[name], abs=2e-5 * np.ptp(expected[name])), name


@pytest.mark.parametrize("kind", ["plane", "space"])
def test_compiled_kernel_moves_the_ship_as_the_scalar_engine(kind, tmp_path):
    path = EXAMPLE if kind == "plane" else in_space(tmp_path / "ship.yaml")
    _, model = robot_model(str(path))
    time = np.arange(0.0, 20.01, 0.1)
    start = {"initial_surge": 1.1, "initial_sway": -0.1, "initial_yaw_rate": 0.02}
    values = np.array([start.get(p.name, p.start) for p in model.parameters])
    trial = Trial("run", "fit", time, {}, swim=replace(SWIM, pose=(0.0,) * (3 if kind == "plane" else 6)))
    found = []
    for used in (True, False):
        _, model = robot_model(str(path))
        model.kernels.used = used
        found.append(model.simulate(values, trial))

    for name in ("x_m", "y_m", "yaw_rad"):
        assert found[0][name] == pytest.approx(found[1][name], abs=1e-10)


def thruster(folder: Path, **changed: object) -> Path:
    """Write a robot whose only force is that of a propeller, and return its path."""
    screw = {
        "kind": "propeller", "link": "body", "input": "screw", "at_m": 0.0, "diameter_m": 0.2,
        "thrust_coefficients": [0.4, -0.3, -0.1], **changed,
    }  # fmt: skip
    link = {"name": "body", "length_m": 1.0, "mass_kg": 20.0, "com_m": 0.5, "inertia_kg_m2": 2.0}
    told = {
        "format": "swimid-robot/1",
        "name": "thruster",
        "fluid": {"density_kg_m3": 1000},
        "multilink": {
            "plane": "horizontal",
            "inputs": {"screw": {"column": "screw_rate_1_s"}},
            "links": [{**link, "inertia_about": "com"}],
            "elements": [screw],
        },
    }
    path = folder / "thruster.yaml"
    path.write_text(yaml.safe_dump(told))
    return path


@pytest.mark.parametrize(("n", "u"), [(5.0, 0.4), (5.0, -0.3), (-5.0, -0.4), (-5.0, 0.3), (0.0, 0.5)])
def test_thrust_of_a_propeller(n, u, tmp_path):
    _, model = robot_model(str(thruster(tmp_path, wake_fraction=0.2, thrust_deduction=0.1)))
    time = np.array([0.0, 1e-3, 2e-3])
    values = np.array([{"initial_surge": u}.get(p.name, p.start) for p in model.parameters])
    swim = SwimInput(inputs={"screw": lambda t: np.full(len(t), n)}, pose=(0.0, 0.0, 0.0))

    found = model.simulate(values, Trial("run", "fit", time, {}, swim=swim))

    thrust = 0.0
    if n:
        # a propeller that turns backwards is the mirror image of one that turns forwards
        side = np.sign(n)
        advance = side * 0.8 * u / (abs(n) * 0.2)
        thrust = side * 1000.0 * n**2 * 0.2**4 * (0.4 - 0.3 * advance - 0.1 * advance**2)
    gained = (found["u_m_s"][-1] - found["u_m_s"][0]) / 2e-3
    assert gained == pytest.approx(0.9 * thrust / 20.0, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("Y_Uv:", "Y_Uw:", "the derivative 'Y_Uw' is not in the horizontal plane"),
        ("Y_Uv:", "Yv:", "'Yv' is no hydrodynamic derivative"),
        ("Y_Uv:", "Y_vvvrrrr:", "'Y_vvvrrrr' has 7 velocities; at most 6"),
        ("propeller: screw,", "propeller: scew,", "did you mean 'screw'"),
        ("input: helm,", "input: hlem,", "did you mean 'helm'"),
        ("1610 * y_v\n", "1610 * y_w\n", "the robot has no coefficient 'y_w'"),
    ],
)
def test_faults_of_steered_robots(old, new, said, tmp_path):
    text = EXAMPLE.read_text()
    assert old in text
    (tmp_path / "ship.yaml").write_text(text.replace(old, new, 1))

    with pytest.raises(InputError) as caught:
        robot_model(str(tmp_path / "ship.yaml"))

    assert said in str(caught.value) + str(caught.value.hint)


@pytest.mark.parametrize("target", ["json", "mjcf", "gazebo"])
@pytest.mark.parametrize("kind", ["plane", "space"])
def test_export_names_the_elements_that_it_leaves_out(kind, target, swimid, tmp_path):
    path = tmp_path / "ship.yaml"
    if kind == "plane":
        path.write_text(EXAMPLE.read_text())
    elif target != "gazebo":
        pytest.skip("robots in space are exported for Gazebo only")
    else:
        in_space(path)
    name = "multilink" if kind == "plane" else "multibody"
    (tmp_path / "params.yaml").write_text(
        f"format: swimid-parameters/1\nmodel: {name}\nrobot: ship.yaml\n"
        "parameters:\n  y_v: {value: -0.3, stderr: 0.001, unit: '1', status: estimated}\n"
    )

    ran = swimid("export", "-v", tmp_path / "params.yaml", "--to", target, "-o", tmp_path / "out.xml")

    assert ran.status == 0, ran.err
    said = " ".join(ran.err.split())
    assert "hydrodynamic derivatives (kind: derivatives) are left out" in said
    assert "screw" in said
    assert "helm" in said


def test_load_along_the_axes_of_the_world_is_a_variable_buoyancy():
    """A displaced volume as an input moves a tilted vehicle as a larger volume in the robot file."""
    robot, model = robot_model("bluerov2")
    body = robot.multibody
    assert body is not None
    at, more = (0.0, 0.0, 0.01), 2e-4
    lift = {"input": "thruster1", "at_m": at, "force_N": (0.0, 0.0, 1000.0 * 9.82), "frame": "world"}
    load = body.elements[-1].model_copy(update=lift)
    quiet = [e for e in body.elements if e.kind != "load"]
    larger = [
        e.model_copy(update={"volume_m3": 0.0134 + more}) if e.kind == "hydrostatics" else e for e in quiet
    ]
    time = np.linspace(0.0, 4.0, 81)
    inputs = {name: (lambda t: np.zeros(len(t))) for name in body.inputs}
    swim = SwimInput(
        inputs={**inputs, "thruster1": lambda t: np.full(len(t), more)}, pose=(0.0, 0.0, 0.0, 0.3, 0.9, 0.5)
    )
    found = []
    for elements in ([*quiet, load], larger):
        own = body.model_copy(update={"elements": elements})
        lifted = type(model)(robot.model_copy(update={"multibody": own}))
        values = np.array([p.start for p in lifted.parameters])
        found.append(lifted.simulate(values, Trial("run", "fit", time, {}, swim=swim)))

    assert np.ptp(found[1]["z_m"]) > 0.05
    for name in ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad"):
        assert found[0][name] == pytest.approx(found[1][name], abs=1e-9)


@pytest.mark.slow
def test_zigzags_of_a_tanker(real_data, swimid, tmp_path):
    """A fit to one side of each angle predicts the other sides (MARIN's free-running model of the KVLCC2)."""
    if not (real_data / "kvlcc2_zigzag").is_dir():
        pytest.skip("SWIMID_DATA has no folder kvlcc2_zigzag with MARIN's .dat files")
    trials = real_logs.write_zigzags(tmp_path, real_data)

    ran = swimid("fit-graybox", trials, "-o", tmp_path / "ship.yaml")

    assert ran.status == 0, ran.err
    fit = parameters.read(tmp_path / "ship.yaml").fit
    assert fit is not None
    held_out = fit.validation["channels"]
    for name in ("u_m_s", "v_m_s", "yaw_rate_rad_s"):
        assert held_out[name]["nrmse"] < 0.05, name
