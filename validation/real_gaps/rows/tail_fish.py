"""Tail-actuated fish under a camera: the authors' scripts state a beat of 1 Hz, the runs beat at 2 Hz."""

from __future__ import annotations

import os
from pathlib import Path

import yaml

from tests.generators import real_logs
from validation.real_gaps.row import Known, Row, Sources, size_of

ROBOT = Path(__file__).parents[3] / "docs" / "examples" / "msu-fish.yaml"
#: Beat in the scripts of the authors, and that of the straight runs, Hz.
STATED_HZ, MEASURED_HZ = 1.0, 2.0
#: Tail amplitudes that are fitted with the measured beat; the others are diagnosed with the stated one.
FITTED_DEG = (15, 30)
OPTIONS = "--start-state estimate --free drive_phase --dt 0.012"


def write(sources: Sources, folder: Path) -> None:
    """Logs and trials files of the straight runs, with the measured and with the stated beat."""
    sources.recording("msu_tail_fish")
    runs = [run for run in real_logs.read_fish(sources.data) if run.bias_deg == 0]
    robot = Path(os.path.relpath(ROBOT, folder))
    for name, chosen in (
        ("measured", [run for run in runs if run.amplitude_deg in FITTED_DEG]),
        ("stated", [run for run in runs if run.amplitude_deg not in FITTED_DEG]),
    ):
        trials = real_logs.write_fish(folder, chosen, robot, lag_rad=real_logs.LAG_RAD, rates_only=True)
        content = yaml.safe_load(trials.read_text())
        for number, trial in enumerate(content["trials"]):
            trial["role"] = "validate" if name == "stated" and number else "fit"
            if name == "stated":
                trial["drive"]["frequency_hz"] = STATED_HZ
        trials.unlink()
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content, sort_keys=False))


ROWS = (
    Row(
        name="tail-fish-beat",
        model="fish that beats at the stated 1 Hz",
        lacks="a beat twice as fast",
        source="giorgosmamakoukas/DerivativeBasedKoopman",
        licence="MIT",
        steps=(
            write,
            f"fit-graybox measured.yaml {OPTIONS} -o fish.yaml",
            "diagnose stated.yaml --params fish.yaml --dt 0.012 -o gap.yaml",
        ),
        causes=frozenset({"clock-rate"}),
        known=Known(STATED_HZ / MEASURED_HZ - 1, "1", "yaw rate of the straight runs", size_of("rate")),
    ),
)
