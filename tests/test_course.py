"""Course against heading: mirrored tracks, reversed headings, and what must not be taken for one."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from swimid.kinematics.course import compare_course, is_in_degrees
from tests.conftest import ROOT, Ran

Run = Callable[..., Ran]
GAP = ROOT / "sample_logs" / "gap"


def swim(turn_rad_s: float, slip_rad: float, rng: np.random.Generator, heading: float) -> list[np.ndarray]:
    """20 s at 25 Hz: a turn with slip into it, recoil at 1.3 Hz, 1 mm and 0.5 degrees of noise."""
    t = np.arange(0.0, 20.0, 0.04)
    yaw = heading + turn_rad_s * t
    step = 0.15 * np.exp(1j * (yaw + slip_rad)) * 0.04
    path = np.cumsum(step) + 0.01 * 1j * np.exp(1j * yaw) * np.sin(2 * np.pi * 1.3 * t)
    yaw = yaw + 0.15 * np.cos(2 * np.pi * 1.3 * t) + rng.normal(0, 0.009, t.size)
    path = path + rng.normal(0, 0.001, t.size) + 1j * rng.normal(0, 0.001, t.size)
    return [t, path.real, path.imag, yaw]


def tracks(turns: tuple[float, ...], slip: float = 0.1, seed: int = 4) -> list[list[np.ndarray]]:
    rng = np.random.default_rng(seed)
    return [swim(turn, slip * np.sign(turn), rng, rng.uniform(-3, 3)) for turn in turns]


TURNS = (0.1, -0.15, 0.02, -0.3)


def test_a_true_track_is_not_mirrored_and_its_slip_is_small() -> None:
    seen = compare_course(tracks(TURNS), 1.0)
    assert seen is not None
    assert not seen.mirrored
    assert abs(seen.slip_rad) < 0.1


@pytest.mark.parametrize(("samples", "known"), [(3, True), (2, False)])
def test_three_samples_of_a_track_show_its_course(samples: int, known: bool) -> None:
    """Short straight tracks in several directions; the heading is 0.05 rad to port of each course."""
    time = np.linspace(0.0, 1.0, samples)
    courses = np.linspace(-3.0, 3.0, 30)
    seen = compare_course(
        [[time, time * np.cos(c), time * np.sin(c), np.full(samples, c + 0.05)] for c in courses], 1.5
    )
    assert (seen is not None) == known
    if seen is not None:
        assert seen.slip_rad == pytest.approx(-0.05, abs=1e-9)
        assert seen.spread_rad == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_one_axis_turned_round_is_mirrored(axis: int) -> None:
    wrong = [[*t[:axis], -t[axis], *t[axis + 1 :]] for t in tracks(TURNS)]
    seen = compare_course(wrong, 1.0)
    assert seen is not None
    assert seen.mirrored


def test_headings_in_degrees_are_told_from_courses_that_differ() -> None:
    """And no straight run, mirrored one, or one backwards is taken for that."""
    rng = np.random.default_rng(2)
    true, straight = tracks(TURNS), [swim(0.0, 0.0, rng, 0.0) for _ in range(4)]
    mirrored = [[t, x, -y, yaw] for t, x, y, yaw in true]
    backwards = [[t, -x, -y, yaw] for t, x, y, yaw in true]
    assert is_in_degrees([[t, x, y, np.degrees(yaw)] for t, x, y, yaw in true], 1.0)
    for others in (true, straight, mirrored, backwards):
        assert not is_in_degrees(others, 1.0)


def test_the_tail_for_the_head_is_half_a_turn() -> None:
    seen = compare_course([[t, x, y, yaw + math.pi] for t, x, y, yaw in tracks(TURNS)], 1.0)
    assert seen is not None
    assert not seen.mirrored
    assert abs(seen.slip_rad) == pytest.approx(math.pi, abs=0.15)


def test_nothing_is_said_of_straight_runs_of_rest_and_of_few_windows() -> None:
    rng = np.random.default_rng(2)
    straight = [swim(0.0, 0.0, rng, 0.0) for _ in range(4)]
    flipped = compare_course([[t, x, -y, yaw] for t, x, y, yaw in straight], 1.0)
    assert flipped is not None
    assert not flipped.mirrored  # a straight run along x looks the same in the mirror
    t = np.arange(0.0, 20.0, 0.04)
    rest = [t, *rng.normal(0, 0.001, (3, t.size))]
    assert compare_course([rest], 1.0) is None
    assert compare_course([[v[:100] for v in straight[0]]], 1.0) is None


def test_noise_seldom_mirrors_a_weaving_swim() -> None:
    """Slip of 23 degrees that changes every second, headings that hardly do: none of 300 is mirrored."""
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 40.0, 0.1)
    called = 0
    for _ in range(300):
        heading = np.repeat(rng.normal(0, 0.3, 40), 10)
        path = np.cumsum(0.01 * np.exp(1j * (heading + np.repeat(rng.normal(0, 0.4, 40), 10))))
        seen = compare_course([(t, path.real, path.imag, heading)], 1.0)
        assert seen is not None
        called += seen.mirrored
    assert called == 0


def test_a_real_fish_swims_where_it_points_and_its_mirror_image_does_not(real_data: Path) -> None:
    """54 runs at 30 Hz, turning either way, pooled by amplitude."""
    folder = real_data / "msu_tail_fish"
    for amplitude in ("Amp15", "Amp20", "Amp30"):
        runs = [np.loadtxt(f) for f in sorted(folder.glob(f"{amplitude}*/STATES*.txt"))]
        sides = [[(a[:, 0], a[:, 5], side * a[:, 6], a[:, 4]) for a in runs] for side in (1.0, -1.0)]
        found = [compare_course(side, 1.0) for side in sides]
        assert [bool(f and f.mirrored) for f in found] == [False, True]
        assert not any(is_in_degrees(side, 1.0) for side in sides)


@pytest.mark.parametrize(
    ("column", "factor", "code", "word"),
    [("y_m", -1.0, "SWM063", "mirrored"), ("yaw_rad", 180.0 / np.pi, "SWM034", "degrees")],
)
def test_logs_of_another_kind_are_told_before_they_are_fitted(
    column: str, factor: float, code: str, word: str, swimid: Run, tmp_path: Path
) -> None:
    for path in GAP.glob("run*.csv"):
        log = pd.read_csv(path, comment="#")
        log[column] *= factor
        log.to_csv(tmp_path / path.name, index=False)
    (tmp_path / "trials.yaml").write_text((GAP / "trials.yaml").read_text())
    told = []
    for folder in (GAP, tmp_path):
        args = (
            "--params",
            GAP / "params.yaml",
            "--no-refit-start",
            "-o",
            tmp_path / "c.yaml",
            "--force",
            "--json",
        )
        ran = swimid("compare", folder / "trials.yaml", *args)
        told.append([w["text"] for w in ran.json["warnings"] if w["code"] == code])
    assert told[0] == []
    assert word in told[1][0]
