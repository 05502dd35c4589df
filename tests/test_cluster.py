"""Fits and maps on a local cluster of two worker processes give what one process gives."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import swimid
from tests.conftest import ROOT, SAMPLES

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a cluster."""
    from distributed import LocalCluster

    os.environ["PYTHONPATH"] = str(ROOT)
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as found:
        yield found.scheduler_address


def test_cells_of_a_map(cluster: str) -> None:
    grid = {"frequency_hz": (2.0, 3.0, 2), "K_s": (0.2, 1.0, 3)}
    here = swimid.performance_map(robot="dolphin", amplitude_deg=27, over=grid)
    there = swimid.performance_map(robot="dolphin", amplitude_deg=27, over=grid, cluster=cluster)
    np.testing.assert_array_equal(there.frame, here.frame)


def test_starts_of_a_fit(cluster: str) -> None:
    """The end points agree to the tolerance of the search, far below the standard errors."""
    given = {"starts": 3, "fixed": {"c_f0": 0.014, "c_f13": 0.014}}
    here = swimid.fit_graybox(SAMPLES / "tfish/trials.yaml", **given)
    there = swimid.fit_graybox(SAMPLES / "tfish/trials.yaml", **given, cluster=cluster)
    for name, estimate in here.file.parameters.items():
        if estimate.status == "estimated":
            assert abs(there[name].value - estimate.value) < 0.05 * estimate.stderr, name


def test_generations_of_a_front(cluster: str, tmp_path: Path) -> None:
    given = {"method": "nsga2", "population": 8, "generations": 2}
    trials = SAMPLES / "sealion/trials.yaml"
    swimid.fit_graybox(trials, output=tmp_path / "here.yaml", **given)
    swimid.fit_graybox(trials, output=tmp_path / "there.yaml", **given, cluster=cluster)
    here, there = ((tmp_path / f"{name}.front.csv").read_text() for name in ("here", "there"))
    assert here == there
