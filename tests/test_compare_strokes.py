"""Motion profiles of a robot in space: per-cycle tables and means of repeats."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from swimid.kinematics.cycles import CYCLE_QUANTITIES, cycle_quantities, whole_cycles, world_velocity
from swimid.results import evidence
from swimid.results.parameters import Estimate, ParameterFile
from swimid.simulation.compare_series import ComparisonFile
from tests.conftest import SAMPLES, Ran

Run = Callable[..., Ran]
TRIALS = SAMPLES / "sealion" / "trials.yaml"


def _params(folder: Path) -> Path:
    values = {"water_volume": 0.0085, "com_offset": 0.016, "z_added_mass": 1.35, "z_drag": 1.65}
    estimates = {n: Estimate(value=v, unit="1", status="fixed") for n, v in values.items()}
    path = folder / "params.yaml"
    ParameterFile(model="multibody", robot="sealion", parameters=estimates).write(path)
    return path


def _log(name: str) -> pd.DataFrame:
    return pd.read_csv(SAMPLES / "sealion" / f"{name}.csv", comment="#")


@pytest.mark.kernels
def test_profiles_are_the_means_of_their_repeats(swimid: Run, tmp_path: Path) -> None:
    out = tmp_path / "c.yaml"
    ran = swimid("compare", TRIALS, "--params", _params(tmp_path), "--no-refit-start", "-o", out)
    assert ran.status == 0, ran.err
    file = ComparisonFile.read(out)
    profiles = {p.name: p for p in file.profiles}
    assert list(profiles) == ["characteristic", "characteristic-pelvis", "pitch"]
    # the joints that drive the manoeuvre are no prediction of it
    assert set(file.channels) == {"x_m", "z_m", "pitch_rad"}
    one = profiles["characteristic"]
    assert one.trials == ["characteristic-1", "characteristic-2"]
    assert len(one.cycles) == 3
    logs = [_log(f"characteristic-{k}") for k in (1, 2)]
    ways = [float(log["x_m"].iloc[-1] - log["x_m"].iloc[0]) for log in logs]
    assert one.surge_m["measured"] == pytest.approx(np.mean(ways), abs=1e-12)
    # the end of a stroke of 2.9 s is a sample of a film of 30 pictures a second
    for cycle in one.cycles:
        k = round(2.9 * cycle.cycle * 30)
        ends = [float(log["pitch_rad"].iloc[k]) for log in logs]
        assert cycle.measured["final_pitch_rad"] == pytest.approx(np.mean(ends), abs=1e-12)
        assert cycle.spread["final_pitch_rad"] == pytest.approx(np.std(ends, ddof=1), abs=1e-12)
        begin = round(2.9 * (cycle.cycle - 1) * 30)
        rates = [float(log["pitch_rad"].iloc[k] - log["pitch_rad"].iloc[begin]) / 2.9 for log in logs]
        assert cycle.measured["mean_pitch_rate_rad_s"] == pytest.approx(np.mean(rates), abs=1e-12)
        assert set(cycle.simulated) == set(CYCLE_QUANTITIES)
    assert profiles["pitch"].cycles == []
    assert profiles["pitch"].position_rmse_m is not None
    shown = evidence.read(evidence.sidecar(out))
    assert {"profiles", "strokes"} <= {t.id for t in shown.tables}
    drawn = {f.id: f for f in shown.figures}
    assert set(drawn) == {f"profile-{name}" for name in profiles}
    panels = drawn["profile-characteristic"].panels
    assert [t.label for t in panels[0].traces] == ["measured", "simulated"]


def test_speeds_of_a_cycle_by_hand() -> None:
    time = np.arange(88) / 30.0
    window = whole_cycles(time, 1 / 2.9)[0]
    x, z = 0.3 * time, 0.4 * time
    found = cycle_quantities(time, {"x_m": x, "z_m": z}, window)
    assert found["max_speed_m_s"] == pytest.approx(0.5)
    assert found["path_speed_m_s"] == pytest.approx(0.5)
    assert found["surge_m"] == pytest.approx(0.3 * 2.9)
    assert found["heave_m"] == pytest.approx(0.4 * 2.9)
    # the log's own speeds win, turned into the world where they are the body's: nose up 90 degrees
    own = {
        "x_m": x,
        "z_m": z,
        "u_m_s": np.full(88, 0.2),
        "w_m_s": np.zeros(88),
        "pitch_rad": np.full(88, math.pi / 2),
    }
    found = cycle_quantities(time, own, window)
    assert found["max_speed_m_s"] == pytest.approx(0.2)
    velocity = world_velocity(time, own)
    assert velocity is not None
    np.testing.assert_allclose(velocity[1], 0.2)
    # a gap in the speeds takes nothing from the way
    own["u_m_s"][:5] = math.nan
    assert cycle_quantities(time, own, window)["surge_m"] == pytest.approx(0.3 * 2.9)
