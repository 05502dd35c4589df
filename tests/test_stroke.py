"""The stroke of a log: its frequency and interval, and when there is none to be told."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from swimid.kinematics.frequency import find_beat, find_beats
from swimid.kinematics.stroke import find_stroke

Array = NDArray[np.float64]
Generator = np.random.Generator
RATE, SECONDS = 25.0, 20.0
T = np.arange(int(RATE * SECONDS)) / RATE


def _filtered(rng: Generator, *weights: float) -> Array:
    """Autoregressive noise, sample by sample."""
    x = rng.normal(size=len(T))
    for k in range(len(weights), len(x)):
        x[k] += sum(w * x[k - 1 - j] for j, w in enumerate(weights))
    return x


NOISES: dict[str, Callable[[Generator], Array]] = {
    "white": lambda rng: rng.normal(size=len(T)),
    "red": lambda rng: _filtered(rng, 0.95),
    "random walk": lambda rng: _filtered(rng, 1.0),
    "a bend": lambda rng: np.polyval(rng.normal(size=5), T / 10 - 1) + 0.02 * rng.normal(size=len(T)),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", NOISES)
def test_noise_of_any_colour_has_no_beat(kind: str) -> None:
    # one false alarm in a hundred: of 60 records four or more come by chance once in 300 times
    found = [find_beat(T, NOISES[kind](np.random.default_rng(seed))) for seed in range(60)]
    assert sum(beat is not None for beat in found) <= 3


def _stroke(rng: Generator, f: float, kind: str) -> tuple[Array, float]:
    phase = 2 * np.pi * f * T + rng.uniform(0, 2 * np.pi)
    noise = 0.1 * rng.normal(size=len(T))
    if kind == "drift and turns":
        slow = 5 * np.polyval(rng.normal(size=4), T / 10 - 1) + 3 * np.sin(0.4 * T + rng.uniform(0, 6))
        return np.cos(phase) + slow + noise, f
    if kind == "harmonics":
        return np.cos(phase) + 0.4 * np.cos(2 * phase + 1) + 0.3 * np.cos(3 * phase + 2) + noise, f
    if kind == "second harmonic larger":
        return 0.6 * np.cos(phase) + np.cos(2 * phase + rng.uniform(0, 6)) + noise, f
    if kind == "red noise":
        return np.cos(phase) + 0.2 * _filtered(rng, 0.95), f
    if kind == "wandering phase":
        phase = phase + np.cumsum(rng.normal(size=len(T))) * 0.3 / np.sqrt(RATE)
        return np.cos(phase) + noise, float((phase[-1] - phase[0]) / (2 * np.pi * T[-1]))
    assert kind == "plain"
    return np.cos(phase) + noise, f


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    ["plain", "drift and turns", "harmonics", "second harmonic larger", "red noise", "wandering phase"],
)
def test_the_interval_contains_the_true_frequency(kind: str) -> None:
    inside = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        values, truth = _stroke(rng, rng.uniform(0.7, 2.0), kind)
        beat = find_beat(T, values)
        assert beat is not None
        assert abs(beat.frequency_hz / truth - 1) < 0.05
        low, high = beat.interval_hz
        inside += low <= truth <= high
    # of 60 records 95 % hold it: 51 or fewer once in 400 times
    assert inside >= 52


def test_two_cycles_of_a_curved_path_are_no_stroke() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(660) / 30
    slow = 0.4 * np.sin(2 * np.pi * 0.091 * t)
    assert find_beat(t, slow + 0.002 * rng.normal(size=len(t))) is None
    beat = find_beat(t, slow + 0.02 * np.sin(2 * np.pi * 1.3 * t) + 0.002 * rng.normal(size=len(t)))
    assert beat is not None
    assert beat.frequency_hz == pytest.approx(1.3, rel=0.01)


def test_too_few_cycles_give_no_frequency() -> None:
    for cycles in (1.0, 2.0, 3.5):
        f = cycles / T[-1]
        values = np.sin(2 * np.pi * f * T) + 0.01 * np.random.default_rng(1).normal(size=len(T))
        assert find_beat(T, values) is None
        assert find_beat(T, values, lowest_hz=0.5 * f, highest_hz=2 * f) is None


def test_the_interval_holds_the_stroke_of_a_short_record() -> None:
    """A line of few cycles is told from the noise about it; its frequency has a wide interval."""
    inside = found = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        truth = rng.uniform(0.7, 2.0)
        t = np.arange(0.0, 4.6 / truth, 1 / RATE)
        values = np.cos(2 * np.pi * truth * t + rng.uniform(0, 6)) + 0.1 * rng.normal(size=len(t))
        beat = find_beat(t, values)
        if beat is not None:
            found += 1
            low, high = beat.interval_hz
            inside += low <= truth <= high
            assert abs(beat.frequency_hz - truth) < 1 / t[-1]
    assert found >= 50
    # 95 % of them, but for once in 400 times
    assert inside >= 0.87 * found


def _track(path: str, rng: Generator) -> dict[str, Array]:
    """One marker of a fish: sways at 1.3 Hz, surges at twice of it."""
    t = np.arange(600) / 30
    turn = {"straight": 0.0, "curved": 0.05, "circle": 0.4}.get(path, 0.0)
    heading = turn * t
    speed = 0.0 if path == "in its place" else 0.2
    x, y = (np.cumsum(speed * part(heading)) / 30 for part in (np.cos, np.sin))
    sway, surge = 0.004 * np.sin(2 * np.pi * 1.3 * t + 1), 0.0015 * np.sin(4 * np.pi * 1.3 * t)
    if path == "no stroke":
        sway = surge = np.zeros_like(t)
    x = x - sway * np.sin(heading) + surge * np.cos(heading) + 0.0005 * rng.normal(size=len(t))
    y = y + sway * np.cos(heading) + surge * np.sin(heading) + 0.0005 * rng.normal(size=len(t))
    return {"x_m": x, "y_m": y}


@pytest.mark.parametrize("path", ["straight", "curved", "circle", "in its place"])
def test_one_marker_shows_the_stroke(path: str) -> None:
    for seed in range(5):
        columns = _track(path, np.random.default_rng(seed))
        found = find_stroke(np.arange(600) / 30, columns)
        assert found.beat.frequency_hz == pytest.approx(1.3, rel=0.01)
        # where there is no path, which of two axes is the sway is not known
        assert found.maybe_double == (path == "in its place")


def test_one_marker_without_a_stroke() -> None:
    time = np.arange(600) / 30
    columns = _track("no stroke", np.random.default_rng(0))
    for channels in (columns, {"depth_m": time}):
        found = find_stroke(time, channels)
        assert found.beat is None
        assert "4 cycles" in found.unknown


def test_a_stated_frequency_helps_to_find_a_weak_stroke() -> None:
    rng = np.random.default_rng(4)
    freely = driven = 0
    for _ in range(20):
        t = T[:200]
        columns = {"yaw_rad": 0.8 * np.sin(2 * np.pi * 1.1 * t) + rng.normal(size=len(t))}
        freely += find_stroke(t, columns).beat is not None
        found = find_stroke(t, columns, stated_hz=1.1)
        driven += abs((found.frequency_hz or np.inf) - 1.1) < 0.05
    assert driven > freely


def test_a_heading_that_goes_round_is_unwrapped() -> None:
    angle = 0.8 * T + 0.2 * np.sin(2 * np.pi * 1.1 * T) + 0.01 * np.random.default_rng(0).normal(size=len(T))
    found = find_stroke(T, {"yaw_rad": np.mod(angle, 2 * np.pi)})
    assert found.beat is not None
    assert found.beat.frequency_hz == pytest.approx(1.1, rel=0.005)


def _hummed(hum_rad: float, seed: int = 0, hum_hz: float = 10.0) -> tuple[Array, dict[str, Array]]:
    """A robot that beats at 1.3 Hz, 0.05 rad and 4 mm of sway, with a hum in its heading."""
    rng, t = np.random.default_rng(seed), np.arange(1200) / 60
    beat = 2 * np.pi * 1.3 * t
    yaw = 0.05 * np.sin(beat + 0.3) + hum_rad * np.sin(2 * np.pi * hum_hz * t) + 0.005 * rng.normal(size=1200)
    x = 0.2 * t + 0.0005 * rng.normal(size=1200)
    return t, {"x_m": x, "y_m": 0.004 * np.sin(beat) + 0.0005 * rng.normal(size=1200), "yaw_rad": yaw}


@pytest.mark.parametrize("hum_rad", [0.0, 0.01, 0.02, 0.03, 0.05, 0.06, 0.07, 0.1, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("hum_hz", [4.7, 10.0])
def test_vibration_in_the_heading_is_no_stroke(hum_rad: float, hum_hz: float) -> None:
    found = find_stroke(*_hummed(hum_rad, hum_hz=hum_hz))
    assert found.beat is not None
    assert found.beat.frequency_hz == pytest.approx(1.3, rel=2e-3)
    # from a tenth of the stroke's power on it is told
    if hum_rad >= 0.02:
        assert found.rivals["yaw_rad"].frequency_hz == pytest.approx(hum_hz, rel=1e-3)
    if hum_rad == 0.0:
        assert not found.doubt


@pytest.mark.parametrize("hum_rad", [0.0, 0.02, 0.05, 0.1, 0.2])
def test_two_beats_in_a_heading_alone_raise_a_doubt(hum_rad: float) -> None:
    time, columns = _hummed(hum_rad)
    found = find_stroke(time, {"yaw_rad": columns["yaw_rad"]})
    assert found.beat is not None
    told = {round(found.beat.frequency_hz, 1), *(round(b.frequency_hz, 1) for b in found.rivals.values())}
    assert told == ({1.3, 10.0} if hum_rad else {1.3})


def test_the_frequency_of_the_drive_is_that_of_the_stroke() -> None:
    """A roll and a heading that hum together are two motions, and yet no stroke."""
    time, columns = _hummed(0.3)
    rng = np.random.default_rng(1)
    hum = 0.2 * np.sin(2 * np.pi * 10 * time) + 0.01 * rng.normal(size=len(time))
    joint = 0.3 * np.sin(2 * np.pi * 1.3 * time) + 0.01 * rng.normal(size=len(time))
    found = find_stroke(time, {"yaw_rad": columns["yaw_rad"], "roll_rad": hum, "joint1_rad": joint})
    assert found.beat is not None
    assert found.beat.frequency_hz == pytest.approx(1.3, rel=1e-3)
    assert set(found.rivals) == {"yaw_rad", "roll_rad"}


def test_a_stated_or_given_frequency_ends_the_doubt() -> None:
    time, columns = _hummed(0.1)
    for options in ({"stated_hz": 1.3}, {"range_hz": (0.5, 3.0)}):
        found = find_stroke(time, columns, **options)  # type: ignore[arg-type]
        assert found.beat.frequency_hz == pytest.approx(1.3, rel=1e-3)
        assert not found.doubt


def test_a_beat_faster_than_any_swimmer_raises_a_doubt() -> None:
    time = np.arange(2000) / 100
    shaking = np.sin(2 * np.pi * 24 * time) + 0.1 * np.random.default_rng(0).normal(size=len(time))
    found = find_stroke(time, {"yaw_rad": shaking})
    assert found.beat is not None
    assert "faster than" in found.doubt


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    ["plain", "drift and turns", "harmonics", "second harmonic larger", "red noise", "wandering phase"],
)
def test_a_single_stroke_has_no_rival(kind: str) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        values, _ = _stroke(rng, rng.uniform(0.7, 2.0), kind)
        found = find_stroke(T, {"yaw_rad": values})
        assert found.beat is not None
        assert not found.doubt


def test_further_beats_are_no_multiples_of_the_first() -> None:
    """A second motion is found beside the first; harmonics of the first are none."""
    rng = np.random.default_rng(1)

    def found(*parts: tuple[float, float]) -> list[float]:
        channel = sum(size * np.sin(2 * np.pi * f * T + f) for f, size in parts)
        return [b.frequency_hz for b in find_beats(T, channel + 0.05 * rng.normal(size=len(T)))]

    assert found((1.0, 1.0), (2.4, 0.6)) == pytest.approx([1.0, 2.4], rel=5e-3)
    assert found((1.0, 1.0), (2.0, 0.6), (3.0, 0.4)) == pytest.approx([1.0], rel=5e-3)
    assert found((1.0, 0.5), (2.0, 1.0)) == pytest.approx([1.0], rel=5e-3)


@pytest.mark.parametrize(("cycles", "seeds"), [(4.6, 12), (12.0, 2)])
def test_a_beat_does_not_depend_on_units(cycles: float, seeds: int) -> None:
    """Records of few and of many cycles, in other units of length and time."""
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        t = np.arange(0.0, cycles, 1 / RATE)
        values = np.cos(2 * np.pi * t + rng.uniform(0, 6)) + 0.4 * rng.normal(size=len(t))
        plain = find_beats(t, values)
        for length, time in ((1e4, 1.0), (1e-4, 1.0), (1.0, 32.0)):
            found = find_beats(time * t, length * values)
            assert [b.frequency_hz * time for b in found] == pytest.approx([b.frequency_hz for b in plain])
            assert [b.amplitude / length for b in found] == pytest.approx([b.amplitude for b in plain])
            assert [b.share for b in found] == pytest.approx([b.share for b in plain])
