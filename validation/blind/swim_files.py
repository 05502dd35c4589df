"""The files of a case: trials, logs and a calibration of another day."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from validation.blind.swim_case import Channels, Trial

#: Held by the robots' files: name, value, unit.
FIXED = {
    "tfish": [("d_p", 0.030, "m")],
    "dolphin": [
        ("fluke_lift", 1.2, "1"),
        ("fluke_drag_0", 0.08, "1"),
        ("fluke_drag_1", 0.84, "1"),
        ("K_s", 0.31, "N m/rad"),
    ],
}


def write_case(folder: Path, robot: str, trials: Sequence[Trial], logs: dict[str, Channels]) -> None:
    """The trials file and one log per trial."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["format: swimid-trials/1", "experiment: free-swim", f"robot: {robot}", "trials:"]
    for trial in trials:
        log = logs[trial.id]
        rows = [",".join(log)]
        for row in np.column_stack(list(log.values())):
            rows.append(",".join("" if np.isnan(v) else f"{v:.5f}" for v in row))
        (folder / f"{trial.id}.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
        drive = ", ".join(f"{key}: {value:g}" for key, value in trial.drive.items())
        lines.append(f"  - id: {trial.id}\n    log: {trial.id}.csv\n    role: {trial.role}")
        lines.append(f"    drive: {{waveform: sine, {drive}}}")
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_prior(
    path: Path,
    robot: str,
    coefficients: dict[str, float],
    fitted: dict[str, tuple[float, float]],
    rng: np.random.Generator,
) -> None:
    """Coefficients 3 to 8 % off the truth, with standard errors that say so."""
    lines = ["format: swimid-parameters/1", "model: multilink", f"robot: {robot}", "parameters:"]
    for name, value in coefficients.items():
        share, bound = rng.uniform(0.03, 0.08), fitted[name][1]
        off = float(np.clip(value * (1.0 + share * rng.normal()), 1e-4, bound))
        lines.append(
            f'  {name}: {{value: {off!r}, stderr: {share * value!r}, unit: "1", bounds: [0, {bound:g}], '
            "status: estimated}"
        )
    for name, value, unit in FIXED[robot]:
        lines.append(
            f'  {name}: {{value: {value!r}, stderr: null, unit: "{unit}", bounds: [0, null], status: fixed}}'
        )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
