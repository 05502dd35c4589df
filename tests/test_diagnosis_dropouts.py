"""Failed samples of a marker: which are detected, and what is left of the trials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from swimid.diagnosis import dropouts
from swimid.fitting.model import Trial

TIME = np.arange(0.0, 12.0, 0.04)
TRUE = 0.3 * TIME + 0.02 * np.sin(2 * np.pi * TIME)


def test_a_frame_that_failed_in_one_channel_is_blank_in_all_of_the_camera() -> None:
    """A wrong marker may be off by little along one axis, so all channels of the frame are blank."""
    mask = np.arange(6) == 2
    trial = Trial("t", "fit", np.arange(6.0), {"x_m": np.ones(6), "y_m": np.ones(6), "u_m_s": np.ones(6)})
    (left,) = dropouts.Dropouts({"t": {"x_m": mask}}, []).remove_from([trial])
    for channel, values in left.measured.items():
        np.testing.assert_array_equal(np.isnan(values), mask if channel in ("x_m", "y_m") else False)


def looked(values: np.ndarray, simulated: np.ndarray = TRUE) -> dropouts.Dropouts:
    """Return the failed samples of one trial."""
    return dropouts.detect_failures([Trial("t", "fit", TIME, {"x_m": values})], [{"x_m": simulated}])


@pytest.fixture
def tracked(rng: np.random.Generator) -> np.ndarray:
    """Return white noise and a slow motion as a wrong model leaves it."""
    walk = lfilter([1.0], [1.0, -0.95], rng.normal(size=len(TIME)))
    return TRUE + 0.002 * rng.normal(size=len(TIME)) + 0.0005 * walk


@pytest.mark.parametrize("seed", range(8))
def test_no_sample_fails_in_clean_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = 0.002 * lfilter([1.0], [1.0, -0.6], rng.normal(size=len(TIME)))
    assert looked(TRUE + noise).count == 0
    # nor if the model is wrong by a twentieth and drifts
    assert looked(TRUE + noise, 0.95 * TRUE + 0.02 * np.sin(TIME)).count == 0


def test_readings_that_are_rounded_do_not_fail_at_slow_motion() -> None:
    """A robot that hovers moves by less than the last digit of its position, and its model drifts away."""
    slow = 0.0005 * TIME + 0.0008 * np.sin(0.8 * TIME)
    for drift in (0.0, 0.01):
        assert looked(np.round(slow, 3), slow + drift * TIME + 1e-4 * np.sin(2.0 * TIME)).count == 0
    for end in (130, len(TIME)):
        stopped = np.round(TRUE, 3)
        stopped[100:end] = stopped[100]
        assert looked(stopped).count >= end - 105


def test_a_model_that_sticks_and_slips_is_no_failure_of_the_marker(tracked: np.ndarray) -> None:
    """A model with too much friction stands still for most of the time, and runs away in between."""
    slips = np.cumsum(np.where(np.arange(len(TIME)) % 20 == 10, 0.5, 0.0))
    assert looked(tracked, slips).count == 0


def test_a_frozen_marker_is_detected(tracked: np.ndarray) -> None:
    hit = (TIME >= 4.0) & (TIME < 5.0)
    tracked[hit] = tracked[np.argmax(hit)]
    found = looked(tracked)
    mask = found.masks["t"]["x_m"]
    assert mask[hit][1:].all()
    assert mask.sum() <= hit.sum() + 5
    assert {kind for *_, kind in found.stretches} == {"frozen"}
    ((_, _, begin, end, _),) = found.stretches
    assert begin == pytest.approx(4.0, abs=0.1)
    assert end == pytest.approx(4.96, abs=0.1)
    blank = found.remove_from([Trial("t", "fit", TIME, {"x_m": tracked})])[0].measured["x_m"]
    np.testing.assert_array_equal(np.isnan(blank), mask)
    np.testing.assert_array_equal(blank[~mask], tracked[~mask])


def test_single_spikes_are_detected(tracked: np.ndarray) -> None:
    at = [50, 51, 133, 240]
    tracked[at] += [0.1, -0.15, 0.08, 0.2]
    found = looked(tracked)
    np.testing.assert_array_equal(np.flatnonzero(found.masks["t"]["x_m"]), at)
    assert {kind for *_, kind in found.stretches} == {"spike"}


@pytest.mark.parametrize("begin, end", [(4.0, 5.5), (9.0, 12.0)])
def test_a_displaced_stretch_is_detected(tracked: np.ndarray, begin: float, end: float) -> None:
    """The tracker follows a reflection for a while, or to the end of the trial."""
    hit = (begin <= TIME) & (end > TIME)
    tracked[hit] += 0.2
    mask = looked(tracked).masks["t"]["x_m"]
    assert (mask != hit).sum() <= 4


def test_a_resting_body_is_not_frozen(rng: np.random.Generator) -> None:
    """Equal consecutive values are correct while the body does not move."""
    values = np.round(TRUE + 0.002 * rng.normal(size=len(TIME)), 3)
    rest = TIME < 1.0
    values[rest] = 0.0
    simulated = np.where(rest, 0.0, TRUE)
    assert not looked(values, simulated).masks.get("t", {"x_m": np.zeros(1, bool)})["x_m"][:25].any()


def test_failures_that_a_better_model_explains_are_none() -> None:
    """Two stretches are found at first, and one of them again."""
    masks = [np.isin(np.arange(20), at) for at in ([3, 4, 12], [12])]
    first, again = (
        dropouts.Dropouts(
            {"t": {"x_m": mask}},
            [dropouts.Stretch("t", "x_m", float(i), float(i), "spike") for i in np.flatnonzero(mask)],
        )
        for mask in masks
    )
    found = first.confirm(again)
    assert found.count == 1
    assert [s.begin for s in found.stretches] == [12.0]
    assert first.confirm(dropouts.Dropouts({}, [])).count == 0
