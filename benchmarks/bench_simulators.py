"""Fit of a file of MuJoCo: swimid beside mujoco.sysid on the same file, data and parameters.

::

    python -m benchmarks.bench_simulators

An arm with two servos, three trials of 10 s at 50 Hz with white noise, four parameters from the same start.
CPU times are those of the process and its children, s. A whole fit of swimid also estimates the start of
each trial, the noise and the intervals, so its search alone is timed too. The arm was made with 0.15, 0.08,
25 and 12, by another integrator.
"""

from __future__ import annotations

import os
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.fitting import output_error
from swimid.fitting.fit_common import load_experiment
from swimid.fitting.problem import Problem
from tests.generators.mujoco_robots import ROBOTS, record, write

#: Parameters: path, start and upper bound.
PARAMETERS = {
    "d_shoulder": ("joint/shoulder/damping", 0.4, 2.0),
    "d_elbow": ("joint/elbow/damping", 0.3, 2.0),
    "k_shoulder": ("actuator/shoulder/kp", 15.0, 60.0),
    "k_elbow": ("actuator/elbow/kp", 20.0, 60.0),
}
SENSORS = (
    '<sensor><jointpos name="shoulder" joint="shoulder"/><jointpos name="elbow" joint="elbow"/></sensor>'
)


def by_sysid(text: str, logs: list[dict[str, np.ndarray]], optimizer: str) -> tuple[float, np.ndarray]:
    """Return CPU time and estimates of mujoco.sysid."""
    import mujoco
    from mujoco import sysid

    spec = mujoco.MjSpec.from_string(text.replace("</mujoco>", f"{SENSORS}</mujoco>"))
    model = spec.compile()

    def damping(name: str) -> Any:
        def write_damping(spec: Any, p: Any) -> None:
            spec.joint(name).damping = [p.value[0], 0.0, 0.0]

        return write_damping

    def gain(name: str) -> Any:
        def write_gain(spec: Any, p: Any) -> None:
            actuator = spec.actuator(name)
            gains, bias = np.array(actuator.gainprm), np.array(actuator.biasprm)
            gains[0], bias[1] = p.value[0], -p.value[0]
            actuator.gainprm, actuator.biasprm = gains, bias

        return write_gain

    found = sysid.ParameterDict()
    for name, (path, start, upper) in PARAMETERS.items():
        kind, element, _ = path.split("/")
        write_to = (damping if kind == "joint" else gain)(element)
        found.add(sysid.Parameter(name, start, 1e-6, upper, modifier=write_to))
    sequences = []
    for k, log in enumerate(logs):
        ticks = log["t_s"]
        start = sysid.create_initial_state(model, np.zeros(2), np.zeros(2))
        control = np.column_stack([log["cmd_shoulder_rad"], log["cmd_elbow_rad"]])
        measured = np.column_stack([log["shoulder_rad"], log["elbow_rad"]])
        sequences.append(
            sysid.ModelSequences(
                f"run{k}", spec, [f"run{k}"], [start],
                [sysid.TimeSeries.from_control_names(ticks, control, model)],
                [sysid.TimeSeries.from_names(ticks, measured, model)],
            )
        )  # fmt: skip
    residuals = sysid.build_residual_fn(models_sequences=sequences)
    begun = time.process_time(), sum(os.times()[2:4])
    result = sysid.optimize(found, residuals, optimizer=optimizer, verbose=False)[0]
    spent = time.process_time() - begun[0] + sum(os.times()[2:4]) - begun[1]
    return spent, np.array([float(result[name].value[0]) for name in PARAMETERS])


def main() -> None:
    """Print CPU times and estimates."""
    warnings.simplefilter("ignore")
    block = {
        name: {"path": path, "start": start, "bounds": [0.0, upper]}
        for name, (path, start, upper) in PARAMETERS.items()
    }
    arm = ROBOTS["arm"]
    robot = replace(arm, seconds=10.0, drives=arm.drives[:3], model={**arm.model, "parameters": block})
    logs = record(robot, "clean", 1.0, 1)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        trials = write(Path(folder), robot, logs)
        trials.write_text(trials.read_text().replace(", role: validate", ""))
        experiment = load_experiment(trials)
        model = experiment.model
        own = tuple(p.name for p in model.parameters if p.per_trial)
        begun = time.process_time()
        problem = Problem(model, model.parameters, [replace(t, held=own) for t in experiment.trials])
        found = problem.solve(problem.start, secant=True).x
        rows.append(("swimid, search", time.process_time() - begun, found))
        begun = time.process_time()
        result = output_error.fit_output_error(model, experiment.trials, parameters=model.parameters)
        found = result.values(experiment.trials[0].id)[: len(PARAMETERS)]
        rows.append(("swimid, whole fit", time.process_time() - begun, found))
        for name in ("mujoco", "scipy", "scipy_parallel_fd"):
            rows.append((f"mujoco.sysid, {name}", *by_sysid(robot.text, logs, name)))
    print(f"| program | CPU s | ratio | {' | '.join(PARAMETERS)} |")
    print("|---|---|---|" + "---|" * len(PARAMETERS))
    for name, spent, values in rows:
        print(
            f"| {name} | {spent:.2f} | {spent / rows[0][1]:.2f} | {' | '.join(f'{v:.5f}' for v in values)} |"
        )


if __name__ == "__main__":
    main()
