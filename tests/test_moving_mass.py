"""Masses that inputs move: conserved momenta without water, and the trim of a glider."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.fitting.model import SwimInput, Trial
from swimid.swimmer.trials import robot_model

HULL, SHARE = 3.0, 1.2
INERTIA = np.diag([0.15, 0.3, 0.4])
#: Place of the centre of the hull, and place and travel of the mass, in the axes of the hull.
CENTRE, PLACE, TRAVEL = (-0.4, 0.0, 0.0), (-0.3, 0.05, 0.0), (0.9, 0.2, 0.0)


def write(folder: Path, kind: str, **mass: Any) -> Path:
    """Write a hull with a moving mass as a robot in a plane or in space, and return its path."""
    slider = {"kind": "moving-mass", "link": "hull", "input": "battery", "mass_kg": SHARE, **mass}
    body: dict[str, Any] = {"inputs": {"battery": {"column": "battery_m"}}}
    if kind == "space":
        link = {"name": "hull", "mass_kg": HULL, "com_m": list(CENTRE)}
        body["links"] = [{**link, "inertia_kg_m2": np.diag(INERTIA).tolist()}]
        slider = {**slider, "at_m": list(PLACE), "travel_m": list(TRAVEL)}
    else:
        link = {"name": "hull", "length_m": 1.0, "mass_kg": HULL, "com_m": -CENTRE[0], "inertia_about": "com"}
        body |= {"plane": "horizontal", "links": [{**link, "inertia_kg_m2": float(INERTIA[2, 2])}]}
        slider = {**slider, "at_m": -PLACE[0], "offset_m": PLACE[1], "travel_m": list(TRAVEL[:2])}
    body["elements"] = [slider]
    part = "multibody" if kind == "space" else "multilink"
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump({"format": "swimid-robot/1", "name": "slider", part: body}))
    return path


@pytest.mark.parametrize("used", [True, False])
@pytest.mark.parametrize("kind", ["plane", "space"])
def test_momenta_are_conserved(kind, used, tmp_path):
    _, model = robot_model(str(write(tmp_path, kind)))
    model.kernels.used = used
    time = np.linspace(0.0, 6.0, 601)
    starts = {"initial_surge": 0.2, "initial_sway": -0.1, "initial_yaw_rate": 0.6}
    if kind == "space":
        starts |= {"initial_heave": 0.05, "initial_roll_rate": 0.8, "initial_pitch_rate": -0.5}
    values = np.array([starts.get(p.name, p.start) for p in model.parameters])
    pose = (0.0,) * (6 if kind == "space" else 3)
    swim = SwimInput(inputs={"battery": lambda t: 0.2 * np.sin(1.5 * t)}, pose=pose)

    found = model.simulate(values, Trial("run", "fit", time, {}, swim=swim))

    none = np.zeros(len(time))
    place = np.column_stack([found["x_m"], found["y_m"], found.get("z_m", none)])
    angles = [found.get(name, none) for name in ("yaw_rad", "pitch_rad", "roll_rad")]
    # pitch is positive nose up
    turn = Rotation.from_euler("ZYX", np.column_stack([angles[0], -angles[1], angles[2]]))
    sign = {"roll": 1.0, "pitch": -1.0, "yaw": 1.0}
    spin = np.column_stack([sign[n] * found.get(f"{n}_rate_rad_s", none) for n in ("roll", "pitch", "yaw")])
    velocity = np.column_stack([found["u_m_s"], found["v_m_s"], found.get("w_m_s", none)])
    position, speed = 0.2 * np.sin(1.5 * time)[:, None], 0.3 * np.cos(1.5 * time)[:, None]
    slid = np.array(PLACE) + position * TRAVEL
    momentum, turning = np.zeros((2, len(time), 3))
    for mass, at, own in ((HULL, np.array(CENTRE), 0.0), (SHARE, slid, speed * TRAVEL)):
        through = turn.apply(velocity + np.cross(spin, at) + own)
        momentum += mass * through
        turning += np.cross(place + turn.apply(at + none[:, None]), mass * through)
    turning += turn.apply(spin @ INERTIA)
    assert np.ptp(found["u_m_s"]) > 0.05
    # the spline through the samples of the input has no curvature at its ends, where its rate errs
    for conserved in (momentum, turning):
        assert conserved[2:-2] == pytest.approx(np.tile(conserved[2], (len(time) - 4, 1)), abs=2e-4)


def test_moved_battery_trims_a_glider(tmp_path):
    """The centre of both masses comes to rest below the centre of buoyancy."""
    low, moved = 0.02, 0.03
    body = {
        "plane": "vertical",
        "inputs": {"battery": {"column": "battery_m"}},
        "links": [
            {
                "name": "hull", "length_m": 1.0, "mass_kg": HULL, "com_m": 0.5, "com_offset_m": -low,
                "inertia_kg_m2": 0.2, "inertia_about": "com",
            }
        ],
        "elements": [
            {"kind": "hydrostatics", "link": "hull", "volume_m3": 1e-3 * (HULL + SHARE),
             "buoyancy_at_m": 0.5},
            {"kind": "moving-mass", "link": "hull", "input": "battery", "mass_kg": SHARE, "at_m": 0.5,
             "weighs": True},
            {"kind": "drag", "link": "hull", "axial_linear_N_s_m": 20.0, "normal_linear_N_s_m": 20.0},
            {"kind": "damping", "link": "hull", "linear_N_m_s_rad": 0.5},
        ],
    }  # fmt: skip
    told = {"format": "swimid-robot/1", "name": "glider", "fluid": {"density_kg_m3": 1000}, "multilink": body}
    (tmp_path / "glider.yaml").write_text(yaml.safe_dump(told))
    _, model = robot_model(str(tmp_path / "glider.yaml"))
    values = np.array([p.start for p in model.parameters])
    time = np.linspace(0.0, 60.0, 601)
    swim = SwimInput(inputs={"battery": lambda t: np.full(len(t), moved)}, pose=(0.0, 0.0, 0.0))

    found = model.simulate(values, Trial("run", "fit", time, {}, swim=swim))

    # a mass ahead lowers the nose
    assert found["pitch_rad"][-1] == pytest.approx(-np.arctan2(SHARE * moved, HULL * low), abs=1e-6)


def test_weight_in_a_horizontal_plane_is_refused(tmp_path):
    with pytest.raises(InputError, match="'weighs' is set, but weight does not act in a horizontal plane"):
        robot_model(str(write(tmp_path, "plane", weighs=True)))
