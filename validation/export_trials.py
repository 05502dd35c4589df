"""Trials with a known cause, and what MuJoCo makes of the exported model with and without it.

The trials are those of an engine of their own (``validation.blind``). The program
prints the table of docs/export.md.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lsim

import swimid
from swimid.exporters.mjcf import water
from swimid.results.parameters import Estimate, ParameterFile
from tests.generators.swimmer import TFISH
from validation.blind import swim_actuation, swim_body, swimmers
from validation.blind.swim_case import Act, Trial

DRIVE = {"frequency_hz": 1.4, "amplitude_deg": 25.0, "bias_deg": 6.0}
#: Duration of a trial, s, and natural frequency of the exported servos, Hz.
DURATION_S, SERVO_HZ = 8.0, 60.0
COEFFICIENTS = {name: TFISH[name] for name in swimmers.FITTED["tfish"]}
Values = dict[str, float]


def lag(time_constant_s: float) -> Act:
    """Joints that follow their commands with a first-order lag."""

    def joints(trial: Trial, t: np.ndarray, q: np.ndarray) -> np.ndarray:
        out = np.empty_like(q)
        system = ([[-1.0 / time_constant_s]], [[1.0 / time_constant_s]], [[1.0]], [[0.0]])
        for j in range(q.shape[1]):
            out[0, j] = lsim(system, q[0, j], t, X0=[q[0, j, 0]])[1]
        out[1] = (q[0] - out[0]) / time_constant_s
        out[2] = (q[1] - out[1]) / time_constant_s
        return out

    return Act(joints=joints)


def ingress(mass_kg: float, behind_m: float) -> Act:
    """Water in the head at a distance behind its front end."""

    def body(trial: Trial, b: swim_body.Body) -> None:
        b.add_mass(0, np.array([behind_m], dtype=complex), np.array([mass_kg]))

    return Act(body=body)


class Case(NamedTuple):
    """A cause of the trial, and the effect of the parameter file that describes it."""

    act: Act
    values: Values


#: The head's centre of mass is 0.192 m behind its front end.
CASES: dict[str, Callable[[], Case]] = {
    "servo-lag": lambda: Case(lag(0.055), {"time_constant_s": 0.055}),
    "servo-backlash": lambda: Case(
        swim_actuation.play(np.radians([1.3, 1.3, 1.3]).tolist()), {"backlash_rad": float(np.radians(2.6))}
    ),
    "linear-drag": lambda: Case(
        Act(water=lambda trial: {"low": 0.4, "low_power": 1.0}), {"linear_N_s_m": 0.4}
    ),
    "water-ingress": lambda: Case(ingress(0.74, 0.22), {"mass_kg": 0.74, "along_m": -0.028}),
}


def write_parameters(path: Path, causes: dict[str, Values]) -> Path:
    """Write the coefficients of the trials, with causes."""
    values = COEFFICIENTS | {f"{name}/{key}": v for name, own in causes.items() for key, v in own.items()}
    held = {
        name: Estimate(value=value, stderr=0.05 * abs(value), unit="1", status="estimated")
        for name, value in values.items()
    }
    ParameterFile(model="multilink", robot="tfish", effects=list(causes), parameters=held).write(path)
    return path


def swum(*acts: Act) -> dict[str, np.ndarray]:
    """The channels of the trial, without noise."""
    return swimmers.swim(
        Trial("trial", 0, "tfish", DRIVE, DURATION_S, 50.0, (0.0, 0.0, 0.0), 1), COEFFICIENTS, acts
    )


def exported(path: Path) -> np.ndarray:
    """Time and position (s, m, m) of the exported model in MuJoCo with the commands of the trial."""
    import mujoco

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        text = swimid.export(path, to="mjcf", added_mass="fold", servo_hz=SERVO_HZ).document
    mujoco.set_mjcb_passive(None)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    time = np.arange(0.0, DURATION_S, model.opt.timestep)
    command = swim_actuation.command(DRIVE, swim_body.of("tfish", COEFFICIENTS).gain, time)[0]
    found = np.empty((3, len(time)))
    mujoco.set_mjcb_passive(water(model))
    try:
        for i in range(len(time)):
            found[:, i] = data.time, *data.qpos[:2]
            data.ctrl[:] = command[: model.nu, i]
            mujoco.mj_step(model, data)
    finally:
        mujoco.set_mjcb_passive(None)
    return found


def error_mm(log: Any, path: np.ndarray) -> float:
    """Root mean square distance of a path from a log, mm."""
    inside = np.asarray(log["t_s"]) <= path[0, -1]
    x, y = (np.interp(np.asarray(log["t_s"])[inside], path[0], p) for p in path[1:])
    off = np.hypot(x - np.asarray(log["x_m"])[inside], y - np.asarray(log["y_m"])[inside])
    return float(1e3 * np.sqrt(np.mean(off**2)))


class Errors(NamedTuple):
    """Errors of a path in MuJoCo, mm: the model as given and with the cause, against the trial."""

    given: float
    repaired: float


@functools.cache
def given(folder: Path) -> np.ndarray:
    """Path of the model as given."""
    return exported(write_parameters(folder / "given.yaml", {}))


def own_loss_mm(folder: Path) -> float:
    """Error of the export itself: MuJoCo against swimid, without a cause."""
    path = given(folder)
    beat = DRIVE | {"duration_s": DURATION_S}
    return error_mm(swimid.simulate(params=folder / "given.yaml", **beat).frame, path)


def errors(name: str, folder: Path) -> Errors:
    """Errors of the export as given and of the repaired one for one cause."""
    case = CASES[name]()
    log = swum(case.act)
    repaired = exported(write_parameters(folder / f"{name}.yaml", {name: case.values}))
    return Errors(error_mm(log, given(folder)), error_mm(log, repaired))


def main() -> None:
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        print("| cause | as given | repaired | ratio |\n|---|---|---|---|")
        for name in CASES:
            found = errors(name, folder)
            ratio = found.repaired / found.given
            print(f"| `{name}` | {found.given:.0f} mm | {found.repaired:.1f} mm | {ratio:.2f} |")
        print(f"\nexport itself, MuJoCo against swimid without a cause: {own_loss_mm(folder):.1f} mm")


if __name__ == "__main__":
    main()
