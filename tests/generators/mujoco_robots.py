"""Recordings of four robots in MuJoCo with a hidden cause: a fish, an arm, a pendulum on a cart, a leg.

The recordings are made with another integrator (RK4) and a quarter of the time step of the file. The causes
have other forms than the effects of swimid: friction is a smooth function of speed with a torque of its own,
a lag is of second order, damping has a power of 1.15, play is that of the command in each small step.

``python -m tests.generators.mujoco_robots FOLDER`` writes the sample ``simulator``.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

#: Sampling interval of a log, and time step of the recording, s.
SAMPLE_S, STEP_S = 0.02, 0.0005
HEAD = """<mujoco model="{}">
  <option timestep="0.002" integrator="implicitfast" gravity="{}" density="{}" viscosity="{}"/>
"""

FISH = (
    HEAD.format("fish", "0 0 0", 1000, 0.001)
    + """\
  <!-- A fish with a servo in the peduncle and a passive fin. Lengths in m, masses from the density. -->
  <default>
    <geom type="ellipsoid" fluidshape="ellipsoid" contype="0" conaffinity="0" density="1000"/>
    <joint type="hinge" axis="0 0 1" damping="0.001"/>
  </default>
  <worldbody>
    <body name="head">
      <joint name="x" type="slide" axis="1 0 0" damping="0"/>
      <joint name="y" type="slide" axis="0 1 0" damping="0"/>
      <joint name="turn" damping="0"/>
      <geom name="head" size="0.11 0.035 0.05" pos="-0.10 0 0"/>
      <site name="led" pos="0 0 0.05"/>
      <body name="peduncle" pos="-0.21 0 0">
        <joint name="servo"/>
        <geom name="peduncle" size="0.05 0.015 0.04" pos="-0.045 0 0"/>
        <body name="fin" pos="-0.09 0 0">
          <joint name="fin" stiffness="0.06" damping="0.0015"/>
          <geom name="fin" size="0.05 0.004 0.055" pos="-0.05 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="servo" kp="6" kv="0.05"/>
  </actuator>
</mujoco>
"""
)

ARM = (
    HEAD.format("arm", "0 0 -9.81", 0, 0)
    + """\
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.15"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" density="900" contype="0" conaffinity="0"/>
      <body name="fore" pos="0 0 -0.3">
        <joint name="elbow" type="hinge" axis="0 1 0" damping="0.08"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.025" density="900" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="25" kv="1.0"/>
    <position name="elbow" joint="elbow" kp="12" kv="0.5"/>
  </actuator>
</mujoco>
"""
)

CART = (
    HEAD.format("cart", "0 0 -9.81", 0, 0)
    + """\
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="1.5"/>
      <geom type="box" size="0.1 0.05 0.04" mass="1.2" contype="0" conaffinity="0"/>
      <body name="rod">
        <joint name="swing" type="hinge" axis="0 1 0" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.012" mass="0.3" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="push" joint="slide"/>
  </actuator>
</mujoco>
"""
)

LEG = (
    HEAD.format("leg", "0 0 -9.81", 0, 0)
    + """\
  <worldbody>
    <body name="thigh" pos="0 0 1">
      <joint name="hip" type="hinge" axis="0 1 0" damping="0.1" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.03" mass="1.0" contype="0" conaffinity="0"/>
      <body name="shank" pos="0 0 -0.25">
        <joint name="knee" type="hinge" axis="0 1 0" damping="0.05" stiffness="3"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
        <site name="foot" pos="0 0 -0.25"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hip" joint="hip" kp="40" kv="1.5"/>
  </actuator>
</mujoco>
"""
)


@dataclass(frozen=True)
class Robot:
    """Robot with its model block, the sizes of its noise, and its drives."""

    name: str
    text: str
    model: dict[str, Any]
    noise: dict[str, float]
    #: Frequency (Hz) and size of each actuator's command in each trial.
    drives: Sequence[tuple[float, Sequence[float]]]
    seconds: float = 5.0
    #: Joint on which friction and damping act, torque of the friction and damping at a factor of one, and
    #: mass of a payload with the body that carries it.
    joint: str = ""
    torque: float = 0.0
    damping: float = 0.0
    payload: tuple[str, float, str] = ("", 0.0, "0 0 0")
    #: Play, gain loss, delay, lag at a factor of one; zero if the cause does not act on this robot.
    play: float = 0.0
    scale_channel: Sequence[str] = field(default_factory=tuple)


def _block(
    name: str, parameters: dict[str, Any], inputs: dict[str, str], outputs: dict[str, str]
) -> dict[str, Any]:
    return {"mjcf": f"{name}.xml", "parameters": parameters, "inputs": inputs, "outputs": outputs}


ROBOTS = {
    "fish": Robot(
        "fish", FISH,
        _block(
            "fish",
            {
                "k_fin": {"path": "joint/fin/stiffness", "bounds": [0.005, 1.0]},
                "c_fin": {"path": "geom/fin/fluidcoef[0]", "bounds": [0.0, 4.0]},
                "c_head": {"path": "geom/head/fluidcoef[0]", "bounds": [0.0, 4.0]},
            },
            {"servo": "cmd_servo_rad"},
            {"x_m": "site/led/x", "y_m": "site/led/y", "yaw_rad": "body/head/yaw"},
        ),
        {"x_m": 0.001, "y_m": 0.001, "yaw_rad": 0.005},
        [(1.0, [0.44]), (1.4, [0.35]), (1.8, [0.26]), (1.2, [0.52])],
        joint="fin", torque=0.004, damping=0.004, payload=("head", 0.25, "-0.05 0 0"), play=0.08,
        scale_channel=("x_m", "y_m"),
    ),
    "arm": Robot(
        "arm", ARM,
        _block(
            "arm",
            {
                "d_shoulder": {"path": "joint/shoulder/damping", "bounds": [0.0, 2.0]},
            },
            {"shoulder": "cmd_shoulder_rad", "elbow": "cmd_elbow_rad"},
            {"shoulder_rad": "joint/shoulder", "elbow_rad": "joint/elbow"},
        ),
        {"shoulder_rad": 0.002, "elbow_rad": 0.002},
        [(0.5, [0.5, 0.6]), (0.9, [0.4, -0.5]), (1.4, [0.3, 0.4]), (0.7, [0.6, 0.3])],
        joint="elbow", torque=0.15, damping=0.12, payload=("fore", 0.15, "0 0 -0.25"), play=0.06,
    ),
    "cart": Robot(
        "cart", CART,
        _block(
            "cart",
            {
                "d_swing": {"path": "joint/swing/damping", "bounds": [0.0, 1.0]},
            },
            {"push": "cmd_push_N"},
            {"x_m": "joint/slide", "swing_rad": "joint/swing"},
        ),
        {"x_m": 0.001, "swing_rad": 0.003},
        [(0.4, [2.5]), (0.7, [3.5]), (1.0, [4.0]), (0.55, [3.0])],
        joint="slide", torque=0.5, damping=1.0, payload=("cart", 0.4, "0 0 0"),
    ),
    "leg": Robot(
        "leg", LEG,
        _block(
            "leg",
            {
                "k_knee": {"path": "joint/knee/stiffness", "bounds": [0.1, 30.0]},
                "d_hip": {"path": "joint/hip/damping", "bounds": [0.0, 2.0]},
            },
            {"hip": "cmd_hip_rad"},
            {"hip_rad": "joint/hip", "knee_rad": "joint/knee"},
        ),
        {"hip_rad": 0.002, "knee_rad": 0.003},
        [(0.6, [0.4]), (1.0, [0.35]), (1.5, [0.3]), (0.8, [0.5])],
        joint="knee", torque=0.06, damping=0.05, payload=("shank", 0.15, "0 0 -0.25"), play=0.06,
    ),
}  # fmt: skip

#: Effects of swimid that are right for each hidden cause, with the size of it at a factor of one as swimid
#: states it; None if the forms differ too much for a size.
CAUSES: dict[str, tuple[str, ...]] = {
    "clean": (),
    "friction": ("joint-friction",),
    "damping": ("joint-damping",),
    "play": ("servo-backlash",),
    "lag": ("servo-lag",),
    "delay": ("servo-delay",),
    "loss": ("amplitude-loss",),
    "payload": ("water-ingress",),
    "scale": ("camera-scale",),
    "clock": ("time-offset",),
}
#: Causes that each robot may have.
POSSIBLE = {
    "fish": ("clean", "friction", "damping", "play", "lag", "delay", "loss", "payload", "scale", "clock"),
    "arm": ("clean", "friction", "damping", "play", "lag", "delay", "loss"),
    "cart": ("clean", "friction", "damping", "lag", "delay", "loss"),
    "leg": ("clean", "friction", "damping", "play", "lag", "delay", "loss"),
}


def _filtered(cause: str, size: float, robot: Robot, command: np.ndarray) -> np.ndarray:
    """Return what the actuator gets of a command, shape (steps,)."""
    if cause == "play":
        held = command.copy()
        for k in range(1, len(command)):
            held[k] = min(
                max(held[k - 1], command[k] - 0.5 * size * robot.play), command[k] + 0.5 * size * robot.play
            )
        return held
    if cause == "lag":
        tau, first, second = 0.02 * size, 0.0, 0.0
        found = np.empty_like(command)
        for k, told in enumerate(command):
            first += STEP_S / tau * (told - first)
            second += STEP_S / tau * (first - second)
            found[k] = second
        return found
    if cause == "delay":
        late = round(0.04 * size / STEP_S)
        return np.concatenate([np.zeros(late), command[: len(command) - late]])
    if cause == "loss":
        return (1.0 - 0.12 * size) * command
    return command


def record(robot: Robot, cause: str, size: float, seed: int) -> list[dict[str, np.ndarray]]:
    """Return the logs of a robot with a hidden cause."""
    import mujoco

    text = robot.text.replace(
        'timestep="0.002" integrator="implicitfast"', f'timestep="{STEP_S}" integrator="RK4"'
    )
    if cause == "payload":
        body, mass, at = robot.payload
        geom = f'<geom type="sphere" size="0.005" mass="{mass * size}" fluidshape="none" contype="0"/>'
        load = f'<body name="load" pos="{at}">{geom}</body>'
        text = re.sub(rf'(<body name="{body}"[^>]*>)', rf"\1{load}", text)
    model = mujoco.MjModel.from_xml_string(text)
    rng, logs = np.random.default_rng(seed), []
    dof = int(model.jnt_dofadr[model.joint(robot.joint).id])
    stride = round(SAMPLE_S / STEP_S)
    for frequency, sizes in robot.drives:
        data = mujoco.MjData(model)
        time = STEP_S * np.arange(round(robot.seconds / STEP_S))
        ramp = np.clip(time, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(time, 0.0, 1.0))
        commands = [
            ramp * one * np.sin(2.0 * math.pi * frequency * (1.0 + 0.17 * k) * time + 0.4 * k * ramp)
            for k, one in enumerate(sizes)
        ]
        told = [_filtered(cause, size, robot, one) for one in commands]
        pose = rng.uniform(-1.0, 1.0, 3) * [1.0, 1.0, 2.5] if robot.name == "fish" else None
        if pose is not None:
            data.qpos[:3] = pose
        rows = []
        for k in range(len(time)):
            if k % stride == 0:
                mujoco.mj_forward(model, data)
                rows.append([_output(model, data, source) for source in robot.model["outputs"].values()])
            data.ctrl[:] = [one[k] for one in told]
            speed = float(data.qvel[dof])
            if cause == "friction":
                data.qfrc_applied[dof] = -size * robot.torque * math.tanh(speed / 0.05)
            elif cause == "damping":
                data.qfrc_applied[dof] = -size * robot.damping * math.copysign(abs(speed) ** 1.15, speed)
            mujoco.mj_step(model, data)
        log = {"t_s": time[::stride]}
        for name, series in zip(robot.model["outputs"], np.array(rows).T, strict=True):
            values = np.unwrap(series) if name == "yaw_rad" else series
            if cause == "scale" and name in robot.scale_channel:
                values = values[0] + (1.0 + 0.06 * size) * (values - values[0])
            if cause == "clock":
                values = np.interp(log["t_s"] - 0.04 * size, log["t_s"], values)
            log[name] = values + rng.normal(0.0, robot.noise[name], len(values))
        for column, one in zip(robot.model["inputs"].values(), commands, strict=True):
            log[column] = one[::stride]
        logs.append(log)
    return logs


def _output(model: Any, data: Any, source: str) -> float:
    kind, name, *rest = source.split("/")
    if kind == "joint":
        return float(data.joint(name).qpos[0])
    if rest == ["yaw"]:
        return math.atan2(data.body(name).xmat[3], data.body(name).xmat[0])
    return float(data.site(name).xpos["xyz".index(rest[0])])


def write(folder: Path, robot: Robot, logs: Sequence[dict[str, np.ndarray]]) -> Path:
    """Write file, logs and trials file of a robot, and return the path of the trials file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{robot.name}.xml").write_text(robot.text)
    rows = []
    for k, log in enumerate(logs):
        table = np.column_stack(list(log.values()))
        header = f"# source: simulated (tests/generators/mujoco_robots.py)\n{','.join(log)}"
        np.savetxt(folder / f"run{k}.csv", table, "%.6g", ",", header=header, comments="")
        rows.append({"log": f"run{k}.csv"} | ({"role": "validate"} if k == len(logs) - 1 else {}))
    document = {"format": "swimid-trials/1", "experiment": "mjcf", "model": robot.model, "trials": rows}
    path = folder / "trials.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110))
    return path


def write_sample(folder: Path, made: Callable[..., Any] = record) -> None:
    """Write the sample ``simulator``: a fish whose servo has play."""
    robot = ROBOTS["fish"]
    write(folder, robot, made(robot, "play", 1.0, 4))


if __name__ == "__main__":
    write_sample(Path(sys.argv[1]))
