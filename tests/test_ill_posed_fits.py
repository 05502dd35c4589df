"""Small, noisy and impossible falling-weight experiments end with a fit or an error message."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from swimid.notices import SwimidWarning
from tests.conftest import Ran

GRAVITY = 9.8
FACTOR = int(os.environ.get("SWIMID_FUZZ", "1"))


def drop(time: np.ndarray, pulling_kg: float, moving_kg: float, drag: float) -> np.ndarray:
    """Return the displacement of a body pulled from rest against quadratic drag."""
    terminal = np.sqrt(pulling_kg * GRAVITY / drag)
    rate = np.sqrt(pulling_kg * GRAVITY * drag) / moving_kg
    # log cosh without overflow
    return terminal / rate * (rate * time + np.log1p(np.exp(-2 * rate * time)) - np.log(2))


trial = st.fixed_dictionaries(
    {
        "samples": st.integers(2, 40),
        "duration_s": st.sampled_from([1e-3, 0.1, 2.0, 10.0, 1e4]),
        "pulling_kg": st.sampled_from([1e-9, 0.001, 0.01, 0.04, 5.0, 1e6]),
        "stated_factor": st.sampled_from([1.0, 1.0, 1.0, 0.01, 1000.0]),
        "noise_m": st.sampled_from([0.0, 1e-12, 1e-4, 0.01, 1.0, 1e6]),
        "step_m": st.sampled_from([0.0, 0.00785, 0.1]),
        "offset_m": st.sampled_from([0.0, 0.0, -3.0, 1e5]),
        "holes": st.sampled_from([0.0, 0.0, 0.3, 0.9]),
        "uneven": st.booleans(),
        "role": st.sampled_from(["fit", "fit", "fit", "validate"]),
    }
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ill-posed")


@pytest.mark.slow
def test_any_small_rig_experiment_ends_in_order(swimid: Callable[..., Ran], folder: Path) -> None:
    @settings(
        max_examples=60 * FACTOR,
        deadline=timedelta(seconds=60),
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(
        chosen=st.lists(trial, min_size=1, max_size=3),
        mass_kg=st.sampled_from([0.0, 1e-6, 1.196, 1e6]),
        seed=st.integers(0, 1000),
        words=st.sampled_from(
            [
                [],
                [],
                ["--free", "linear_drag"],
                ["--start-state", "estimate"],
                ["--fix", "added_mass=0.7"],
                ["--bounds", "drag_coefficient=0.6,0.8"],
                ["--method", "two-point"],
            ]
        ),
    )
    def run(chosen: list[dict], mass_kg: float, seed: int, words: list[str]) -> None:
        rng = np.random.default_rng(seed)
        lines = ["format: swimid-trials/1", "experiment: falling-weight", "robot: boxfish", "trials:"]
        for k, t in enumerate(chosen):
            time = np.linspace(0, t["duration_s"], t["samples"])
            if t["uneven"]:
                time[1:-1] += rng.uniform(-0.4, 0.4, len(time) - 2) * time[1]
            x = drop(time, t["pulling_kg"], 1.9 + t["pulling_kg"], 2.45)
            x = x + rng.normal(0, 1, len(x)) * t["noise_m"] + t["offset_m"]
            if t["step_m"]:
                x = np.floor(x / t["step_m"]) * t["step_m"]
            x[rng.random(len(x)) < t["holes"]] = np.nan
            cells = ["" if np.isnan(v) else repr(float(v)) for v in x]
            rows = [f"{s!r},{cell}" for s, cell in zip(time.tolist(), cells, strict=True)]
            (folder / f"{k}.csv").write_text("\n".join(["t_s,x_m", *rows]) + "\n")
            stated = t["pulling_kg"] * t["stated_factor"]
            lines.append(
                f"  - {{log: {k}.csv, id: t{k}, pulling_mass_kg: {stated!r}, role: {t['role']}, "
                f"inertial_mass_kg: {mass_kg!r}}}"
            )
        (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
        with warnings.catch_warnings():
            # warnings of numpy must not reach the user
            warnings.simplefilter("error")
            warnings.simplefilter("always", SwimidWarning)
            ran = swimid("fit-drag", folder / "trials.yaml", "--json", "-o", folder / "drag.yaml", *words)
        assert ran.status in (0, 3, 4), ran.err
        assert "Traceback" not in ran.err
        document = json.loads(ran.out)
        assert document["ok"] is (ran.status == 0)
        if ran.status == 0:
            for name, e in document["result"]["parameters"].items():
                assert e["value"] is not None, name
                assert e["stderr"] is None or e["stderr"] >= 0, name

    run()
