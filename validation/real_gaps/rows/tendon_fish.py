"""Tendon-driven fish from tracked films, whose measured beat is three quarters of the stated one."""

from __future__ import annotations

import shutil
from pathlib import Path

from validation.real_gaps.row import Known, Row, Sources, size_of, write_trials

SAMPLE = Path(__file__).parents[3] / "sample_logs" / "fishsim"
#: Films by stated beat in Hz: fitted with the measured beat, and diagnosed with the stated one.
FITTED, DIAGNOSED = ("1_00", "1_75"), ("0_50", "2_00")
#: Measured over stated beat, by the films of more than four cycles; amplitude of the tail in the fitted
#: films.
RATIO, AMPLITUDE_DEG = 0.7497, 28.8


def take(sources: Sources, folder: Path) -> None:
    """Copy the sample of the fish, and the films."""
    shutil.copytree(SAMPLE, folder / "fish", dirs_exist_ok=True)
    for film in (*FITTED, *DIAGNOSED):
        shutil.copy(sources.recording(f"fishsim/markers_f{film}.csv"), folder / "fish")


def write(_sources: Sources, folder: Path) -> None:
    """Trials files with the measured and with the stated beat."""
    for name, films, ratio in (("measured", FITTED, RATIO), ("stated", DIAGNOSED, 1.0)):
        trials = []
        for film in films:
            beat = ratio * float(film.replace("_", "."))
            drive = {"frequency_hz": beat, "amplitude_deg": AMPLITUDE_DEG, "ramp_s": 0}
            trials.append({"log": f"f{film}.csv", "start_state": "steady", "drive": drive})
        write_trials(folder / f"{name}.yaml", "free-swim", "fish/robot.yaml", trials)


ROWS = (
    Row(
        name="tendon-fish-beat",
        model="fish that beats as stated",
        lacks="a motor that is a quarter slower",
        source="srl-ethz/fishsim",
        licence="MIT",
        steps=(
            take,
            *(
                f"import fish/markers_f{film}.csv --map fish/map.yaml --robot fish/robot.yaml"
                f" --points fish/points.yaml --calibrate-points -o f{film}.csv"
                for film in (*FITTED, *DIAGNOSED)
            ),
            write,
            "fit-graybox measured.yaml --free camera_rotation -o fish.yaml",
            "diagnose stated.yaml --params fish.yaml -o gap.yaml",
        ),
        causes=frozenset({"clock-rate"}),
        known=Known(1 / RATIO - 1, "1", "joint angles of the films", size_of("rate")),
    ),
)
