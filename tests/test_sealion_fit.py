"""The sea lion tuned on trials of another simulator: coefficients found again, a manoeuvre predicted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from swimid.results import evidence
from swimid.results import parameters as parameters_format
from swimid.results.parameters import Estimate, ParameterFile
from swimid.simulation.compare_series import ComparisonFile
from tests.conftest import Ran
from tests.generators import sealion

Run = Callable[..., Ran]
#: How near a fit has to come, as a share of the truth.
CLOSE = {"water_volume": 0.05, "com_offset": 0.10, "z_added_mass": 0.10, "z_drag": 0.10}


def _position_rmse(swimid: Run, folder: Path, params: Path) -> float:
    """Of the held-out manoeuvre, nothing of the robot taken from it: trim and clock stay neutral."""
    whole = yaml.safe_load((folder / "trials.yaml").read_text())
    whole["trials"] = [t for t in whole["trials"] if t["role"] == "validate"]
    (folder / "held-out.yaml").write_text(yaml.safe_dump(whole, sort_keys=False))
    out = params.with_suffix(".compared.yaml")
    neutral = ("--set", "buoyancy=1", "--set", "clock_offset=0")
    ran = swimid("compare", folder / "held-out.yaml", "--params", params, *neutral, "-o", out)
    assert ran.status == 0, ran.err
    (profile,) = ComparisonFile.read(out).profiles
    assert profile.position_rmse_m is not None
    return profile.position_rmse_m


@pytest.mark.slow
def test_a_hybrid_fit_finds_the_truth_and_predicts_a_manoeuvre(swimid: Run, tmp_path: Path) -> None:
    folder, out = tmp_path / "trials", tmp_path / "p.yaml"
    trials = sealion.write(folder, 21)
    ran = swimid(
        "fit-graybox", trials, "--method", "hybrid", "--population", "16", "--generations", "6",
        "--free", "buoyancy", "--free", "clock_offset", "--start-state", "estimate",
        "-o", out, "--no-progress",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    print(ran.out)
    for table in evidence.read(evidence.sidecar(out)).tables:
        if table.id == "stages":
            print(table.title, table.columns, *table.rows, sep="\n")
    true = sealion.Coefficients().values()
    file = parameters_format.read(out)
    for name, share in CLOSE.items():
        found = file.parameters[name]
        print(f"{name}: {found.value:.5g} ± {found.stderr:.2g}, true {true[name]:g}")
        assert found.status == "estimated"
        assert found.value == pytest.approx(true[name], rel=share)
    untuned = tmp_path / "untuned.yaml"
    starts = {n: c["value"] for n, c in sealion.read_robot()["coefficients"].items() if n in CLOSE}
    estimates = {n: Estimate(value=v, unit="1", status="fixed") for n, v in starts.items()}
    ParameterFile(model="multibody", robot="sealion", parameters=estimates).write(untuned)
    before, after = (_position_rmse(swimid, folder, p) for p in (untuned, out))
    print(
        f"held-out pitch manoeuvre: position RMSE {1e3 * before:.1f} mm untuned, {1e3 * after:.1f} mm tuned"
    )
    assert after <= before / 3.0
