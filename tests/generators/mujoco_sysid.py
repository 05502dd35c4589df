"""Fit of the tendon-driven fish by mujoco.sysid with MuJoCo's own fluid model, beside the fit of swimid.

``python -m tests.generators.mujoco_sysid fish`` fits the films of ``fish/trials.yaml`` with both programs,
simulates the drive of these films and of ``fish/unseen.yaml`` from rest with both, and prints speeds and
times. ``fish`` is the sample ``fishsim`` after ``swimid batch fish/plan.yaml -o fish/run``. MuJoCo has the
masses, lengths and hinges of the robot file. Its water is the ellipsoid model with five coefficients, common
to the links. The stiffness of the fin is the sixth parameter.
"""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import yaml
from mujoco import sysid
from scipy.signal import savgol_filter

import swimid
from swimid.robots import file as robot_file
from tests.generators.mujoco_speeds import run, simulated

#: Duration of the segments that are predicted from their measured first state, s.
SEGMENT_S = 2.5
#: Number of starting points of a fit, and standard deviation of the logarithm of their values.
STARTS, SPREAD = 4, 0.7
#: Width and height of each link, m. The heights are published, the widths are guesses.
SIZES = {"body": (0.04, 0.105), "tail": (0.02, 0.09), "fin": (0.002, 0.112)}
#: Coefficients of MuJoCo's ellipsoid model, with default and upper bound.
FLUID = {
    "blunt": (0.5, 5.0),
    "slender": (0.25, 5.0),
    "angular": (1.5, 15.0),
    "kutta": (1.0, 10.0),
    "magnus": (1.0, 10.0),
}
JOINTS = ("base_x", "base_y", "base_yaw", "hinge", "root")


def xml(robot: Path) -> str:
    """Return the fish of a robot file as a MuJoCo model, with the coefficients at their defaults."""
    body = robot_file.read(robot).multilink
    assert body is not None
    text, places = "", {"body": 0.0, "tail": -0.376, "fin": -0.117}
    for link in body.links:
        wide, high = SIZES[link.name]
        joints = '<joint name="root" type="hinge" axis="0 0 1" stiffness="0.1"/>'
        if link.name == "body":
            joints = "".join(
                f'<joint name="base_{c}" type="slide" axis="{a}"/>'
                for c, a in (("x", "1 0 0"), ("y", "0 1 0"))
            )
            joints += '<joint name="base_yaw" type="hinge" axis="0 0 1"/>'
        if link.name == "tail":
            joints = '<joint name="hinge" type="hinge" axis="0 0 1"/>'
        turn, middle = float(link.inertia_kg_m2), -link.length_m / 2
        text += (
            f'<body name="{link.name}" pos="{places[link.name]} 0 0">{joints}'
            f'<inertial pos="{-float(link.com_m)} 0 0" mass="{link.mass_kg}" '
            f'diaginertia="{turn} {turn} {turn}"/>'
            f'<geom name="{link.name}" type="ellipsoid" pos="{middle} 0 0" fluidshape="ellipsoid" '
            f'size="{-middle} {wide / 2} {high / 2}" contype="0" conaffinity="0"/>'
        )
    sensors = "".join(f'<jointpos name="{name}" joint="{name}"/>' for name in JOINTS)
    return (
        '<mujoco><compiler angle="radian"/><option timestep="0.002" gravity="0 0 0" density="1000" '
        f'viscosity="0.001" integrator="implicitfast"/><worldbody>{text}{"</body>" * 3}</worldbody>'
        '<actuator><position name="hinge" joint="hinge" kp="200" kv="2"/></actuator>'
        f"<sensor>{sensors}</sensor></mujoco>"
    )


def parameters() -> sysid.ParameterDict:
    """Return the six parameters, which the optimiser writes into the model."""
    found = sysid.ParameterDict()

    def fluid(place: int) -> Any:
        def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
            for geom in spec.geoms:
                values = np.array(geom.fluid_coefs)
                values[place] = parameter.value[0]
                geom.fluid_coefs = values

        return write

    def stiffness(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        spec.joint("root").stiffness = [parameter.value[0], 0.0, 0.0]

    for place, (name, (start, upper)) in enumerate(FLUID.items()):
        found.add(sysid.Parameter(name, start, 0.0, upper, modifier=fluid(place)))
    found.add(sysid.Parameter("k_fin", 0.1, 0.001, 5.0, modifier=stiffness))
    return found


def segments(name: str, log: pd.DataFrame, spec: mujoco.MjSpec) -> sysid.ModelSequences:
    """Return the segments of a log, each in the axes of its first pose and with its measured first state."""
    model = spec.compile()
    clock = log["t_s"].to_numpy()
    rows = int(SEGMENT_S / np.median(np.diff(clock)))
    pose = log[["x_m", "y_m", "yaw_rad", "joint1_rad", "joint2_rad"]].to_numpy()
    rate = savgol_filter(pose, 9, 3, deriv=1, delta=float(np.median(np.diff(clock))), axis=0)
    names, states, controls, measured = [], [], [], []
    for first in range(0, len(clock) - rows, rows):
        part = pose[first : first + rows + 1].copy()
        yaw = part[0, 2]
        turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        part[:, :3] -= part[0, :3]
        part[:, :2] = part[:, :2] @ turn.T
        speed = rate[first].copy()
        speed[:2] = turn @ speed[:2]
        ticks = clock[first : first + rows + 1] - clock[first]
        names.append(f"{name}_{first}")
        states.append(sysid.create_initial_state(model, part[0], speed))
        controls.append(sysid.TimeSeries.from_control_names(ticks, part[:, 3:4], model))
        measured.append(sysid.TimeSeries.from_names(ticks, part, model))
    return sysid.ModelSequences(name, spec, names, states, controls, measured)


def main(folder: Path) -> None:
    """Print the speeds of all trials by both programs, and the durations of the fits."""
    warnings.simplefilter("ignore")
    files = [yaml.safe_load((folder / name).read_text()) for name in ("trials.yaml", "unseen.yaml")]
    entries = [{"role": "fit", **entry} for file in files for entry in file["trials"]]
    spec = mujoco.MjSpec.from_string(xml(folder / files[0]["robot"]))
    logs = {}
    for entry in entries:
        log = pd.read_csv(folder / entry["log"], comment="#")
        logs[entry["id"]] = log.interpolate(limit_direction="both")
    fitted = [entry["id"] for entry in entries if entry["role"] == "fit"]
    begin = time.perf_counter()
    residuals = sysid.build_residual_fn(models_sequences=[segments(n, logs[n], spec) for n in fitted])
    rng, fits = np.random.default_rng(0), []
    for start in range(STARTS):
        begun = parameters()
        for one in begun.values() if start else ():
            one.value[:] = np.clip(
                one.nominal * np.exp(rng.normal(0.0, SPREAD, 1)), one.min_value, one.max_value
            )
        try:
            fits.append(sysid.optimize(begun, residuals, optimizer="mujoco", verbose=False))
        except ValueError as error:  # a simulation diverged
            print(f"start {start}: {error}")
    found = min(fits, key=lambda one: float(np.sum(residuals(one[1].x, one[0])[0][0] ** 2)))[0]
    middle = time.perf_counter()
    swimid.fit_graybox(folder / "trials.yaml", freed=["camera_rotation"], output=folder / "own.yaml")
    end = time.perf_counter()
    print({name: round(float(p.value[0]), 4) for name, p in found.items()})
    print(f"mujoco.sysid {middle - begin:.0f} s, swimid {end - middle:.0f} s")
    model = sysid.apply_param_modifiers(found, spec)
    print("trial   role      measured m/s   mujoco.sysid   swimid")
    for entry in entries:
        hertz, degrees = entry["drive"]["frequency_hz"], entry["drive"]["amplitude_deg"]
        log = logs[entry["id"]]
        rows = round(int(log["t_s"].iloc[-1] * hertz) / hertz / np.median(np.diff(log["t_s"])))
        moved = log[["x_m", "y_m"]].iloc[[0, rows]].to_numpy()
        measured = float(np.hypot(*(moved[1] - moved[0])) / log["t_s"].iloc[rows])
        ours = simulated(folder / "own.yaml", hertz, degrees)
        theirs = run(model, hertz, np.radians(degrees))
        print(f"{entry['id']:7s} {entry['role']:9s} {measured:12.4f} {theirs:14.4f} {ours:8.4f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
