"""Rig identification: the model against an independent integrator, the estimator against truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

from swimid.fitting import output_error
from swimid.fitting.model import RigInput, Trial
from swimid.results import evidence, parameters
from swimid.rig import fit_drag as drag_module
from swimid.rig import model as equation
from swimid.rig import model as rig_model
from swimid.robots import file as robot_format
from tests.conftest import Ran
from tests.generators import rig as generator
from tests.generators.files import write_log, write_trials

TRUTH = {"drag_coefficient": 0.705, "added_mass": 0.685, "pulley_friction": 0.0308}
WEIGHTS = range(10, 41, 5)
AREA_FACTOR = 0.5 * 997 * 0.00698
STEP = 0.00785


def _known(weight: int) -> RigInput:
    mass = weight / 1000
    return RigInput(
        inertia=1.196 + mass + 0.02, force=mass * 9.8, pulley=True, area_factor=AREA_FACTOR, release_s=0.0
    )


def _model() -> rig_model.RigModel:
    return rig_model.falling_weight(mass_kg=1.2, force_N=0.25, area_known=True, pulley=True)


@pytest.fixture(scope="module")
def clicks() -> dict[int, np.ndarray]:
    """Exact click times of every pulling weight, s."""
    return {w: generator.click_times(float(w)) for w in WEIGHTS}


@pytest.mark.kernels
class TestModel:
    @pytest.mark.parametrize(
        "quadratic, linear, dry, stiffness",
        [(2.4, 0, 0, 0), (2.4, 0.5, 0.05, 0), (0, 0.3, 0, 8.0), (3.0, 0.1, 0, 20.0)],
    )
    def test_integration_against_an_adaptive_solver(
        self, quadratic: float, linear: float, dry: float, stiffness: float
    ) -> None:
        time = np.linspace(0, 5, 101)
        x, v = equation.integrate_rig(
            time,
            0.0,
            0.005,
            np.array([0.2]),
            0.1,
            0.3,
            (1.9, quadratic, linear, dry, stiffness, 0.0, 0.0, 0.0),
        )

        def rate(_: float, s: np.ndarray) -> list[float]:
            return [
                s[1],
                (0.2 - dry * np.sign(s[1]) - linear * s[1] - quadratic * s[1] * abs(s[1]) - stiffness * s[0])
                / 1.9,
            ]

        run = solve_ivp(rate, (0, 5), [0.1, 0.3], method="DOP853", rtol=1e-11, atol=1e-12, t_eval=time)
        # fourth order at this step; the dry case keeps moving forward, so its force is smooth
        assert np.max(np.abs(x - run.y[0])) < 1e-8
        assert np.max(np.abs(v - run.y[1])) < 1e-7

    def test_an_oscillator_with_dry_friction_loses_equal_amplitudes_and_sticks(self) -> None:
        """Each half swing loses 2 dry / stiffness, until the spring force is below the friction."""
        time = np.linspace(0, 30, 3001)
        coefficients = (1.0, 0.0, 0.0, 0.1, 4.0, 0.0, 0.0, 0.0)
        x, v = equation.integrate_rig(time, 0.0, 0.01, np.array([0.0]), 0.52, 0.0, coefficients)
        swing = np.pi / 2.0
        for k in range(1, 10):
            expected = (0.52 - 0.05 * k) * (-1) ** k
            assert np.interp(k * swing, time, x) == pytest.approx(expected, abs=2e-4)
        assert abs(x[-1]) <= 0.025
        assert v[-1] == 0.0

    def test_the_closed_form_agrees_with_the_integration(self) -> None:
        time = np.linspace(0, 12, 200)
        x, v = equation.falling_weight_closed_form(time, 0.0, 1.921, AREA_FACTOR * 0.705, 0.165)
        coefficients = (1.921, AREA_FACTOR * 0.705, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        xi, vi = equation.integrate_rig(time, 0.0, 0.005, np.array([0.165]), 0.0, 0.0, coefficients)
        assert np.max(np.abs(x - xi)) < 1e-10
        assert np.max(np.abs(v - vi)) < 1e-10

    def test_the_closed_form_is_exact_after_a_short_time_and_without_drag(self) -> None:
        """With drag it is ln(1 + 2 sinh(phi / 2)^2) / a1, which cancels no digits; without, a2 t^2 / 2."""
        time = np.geomspace(1e-6, 3e-4, 20)
        quadratic, force = 2.4, 0.165
        phi = time * math.sqrt(quadratic * force) / 1.9
        assert phi.max() < 1e-4
        x, v = equation.falling_weight_closed_form(0.5 + time, 0.5, 1.9, quadratic, force)
        np.testing.assert_allclose(x, np.log1p(2 * np.sinh(phi / 2) ** 2) * 1.9 / quadratic, rtol=2e-10)
        np.testing.assert_allclose(v, math.sqrt(force / quadratic) * np.tanh(phi), rtol=2e-10)
        time = np.array([-1.0, 0.0, 0.5, 20.0])
        x, v = equation.falling_weight_closed_form(time, 0.0, 1.9, 0.0, force)
        np.testing.assert_allclose(x, 0.5 * force / 1.9 * np.maximum(time, 0.0) ** 2, rtol=1e-14)
        np.testing.assert_allclose(v, force / 1.9 * np.maximum(time, 0.0), rtol=1e-14)

    def test_published_terminal_speeds_and_times(self) -> None:
        """The boxfish paper's parameters: 10 to 40 g reach 16.6 to 38.4 cm/s, 115 cm take 10.1 to 4.4 s."""
        for weight, speed, duration in (
            (10, 0.166, 10.1),
            (20, 0.260, 6.5),
            (30, 0.328, 5.1),
            (40, 0.384, 4.4),
        ):
            force = weight / 1000 * 9.8 - 0.0308
            inertia = 1.196 + 0.685 + 0.02 + weight / 1000
            x, v = equation.falling_weight_closed_form(
                np.linspace(0, 60, 60001), 0.0, inertia, AREA_FACTOR * 0.705, force
            )
            assert v[-1] == pytest.approx(speed, abs=6e-4)
            assert np.interp(1.15, x, np.linspace(0, 60, 60001)) == pytest.approx(duration, abs=0.06)

    def test_a_weight_below_the_friction_does_not_move_the_body(self) -> None:
        x, v = equation.falling_weight_closed_form(np.array([0.0, 5.0]), 0.0, 1.9, 2.4, -0.01)
        assert not x.any()
        assert not v.any()


class TestEncoder:
    def test_clicks_and_samples_are_distinguished(self, clicks: dict[int, np.ndarray]) -> None:
        times = clicks[20]
        assert rig_model.read_encoder(times, np.arange(len(times)) * STEP).kind == "clicks"
        t = np.arange(0, times[-1], 0.01)
        x = np.interp(t, times, np.arange(len(times)) * STEP)
        sampled = rig_model.read_encoder(t, np.floor(x / STEP) * STEP)
        assert sampled.kind == "sampled"
        assert sampled.shifts["ceil"] == pytest.approx(-STEP, rel=1e-6)
        assert rig_model.read_encoder(t, x).kind == "continuous"

    def test_a_noisy_rounded_record_is_no_encoder(self, rng: np.random.Generator) -> None:
        t = np.arange(0, 5, 0.01)
        x = np.round(0.05 * t**2 + rng.normal(0, 2e-3, len(t)), 3)
        assert rig_model.read_encoder(t, x).kind == "continuous"

    def test_the_time_error_of_a_step_follows_the_sampling_interval(self) -> None:
        """A log with irregular samples has long intervals at the start of a drop."""
        t = np.cumsum(np.r_[0.0, np.geomspace(0.4, 0.02, 120)])
        record = rig_model.read_encoder(t, np.floor(0.002 * t**2 / STEP) * STEP)
        assert record.kind == "sampled"
        gaps = np.diff(t)[np.searchsorted(t, record.time_s) - 1]
        np.testing.assert_allclose(record.time_sd_s, gaps / np.sqrt(12.0), rtol=1e-12)

    @pytest.mark.parametrize("way", [1, -1])
    def test_two_steps_within_an_interval_have_their_middle_in_its_middle(self, way: int) -> None:
        counts = np.array([0, 0, 1, 1, 2, 2, 2, 3, 3, 5, 5, 6, 6, 9, 9, 10])
        record = rig_model.read_encoder(0.1 * np.arange(len(counts)), way * STEP * counts)
        assert record.kind == "sampled"
        np.testing.assert_allclose(record.position, way * STEP * np.array([1, 2, 3, 4.5, 6, 8, 10]))
        np.testing.assert_allclose(record.time_s, [0.15, 0.35, 0.65, 0.85, 1.05, 1.25, 1.45])
        np.testing.assert_allclose(record.time_sd_s, 0.1 / np.sqrt(12.0))

    @pytest.mark.parametrize("rounding", rig_model.ROUNDINGS)
    def test_true_positions_from_rounded_counts(self, rounding: str) -> None:
        t = np.arange(0, 10, 0.001)
        x = 0.1 * t
        count = {"floor": np.floor, "nearest": np.round, "ceil": np.ceil}[rounding](x / STEP + 1e-9)
        record = rig_model.read_encoder(t, count * STEP)
        true = rig_model.true_position(record, rounding)
        assert np.max(np.abs(true - 0.1 * record.time_s)) < 0.1 * 0.001


def _measure(clicks: dict[int, np.ndarray], kind: str, rng: np.random.Generator) -> list[Trial]:
    """Return seven drops as an encoder or a camera records them, from the independent integrator."""
    trials = []
    for w, exact in clicks.items():
        x = np.arange(len(exact)) * STEP
        if kind == "clicks":
            speed = np.gradient(x, exact)
            late = rng.normal(0, 0.004, len(exact)) + rng.normal(0, 2e-4, len(exact)) / np.maximum(
                speed, 1e-3
            )
            t = np.sort(exact + np.r_[0, late[1:]])
        else:
            # a quintic through the exact clicks, mirrored at the start where the speed is zero
            path = make_interp_spline(np.r_[-exact[:0:-1], exact], np.r_[x[:0:-1], x], k=5)
            t = np.arange(0.02, exact[-1], 0.02)
            x = path(t)
            if kind == "white":
                x = x + rng.normal(0, 1e-3, len(t))
            elif kind == "coloured":
                x = x + lfilter([1], [1, -0.9], rng.normal(0, 5e-4, len(t) + 200))[200:]
            else:
                t = t + rng.uniform(0, 0.02)
                x = np.floor(path(np.minimum(t, exact[-1])) / STEP) * STEP
        record = rig_model.read_encoder(t, x, STEP)
        use = slice(1, None) if record.kind == "clicks" else slice(None)
        trials.append(
            Trial(
                f"w{w}",
                "fit",
                record.time_s[use],
                {"x_m": rig_model.true_position(record, "floor")[use]},
                rig=_known(w),
                time_sd_s=record.time_sd_s,
                stamps_uncertain=record.kind == "clicks",
            )
        )
    return trials


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["clicks", "white", "coloured", "sampled"])
def test_intervals_cover_the_truth(clicks: dict[int, np.ndarray], kind: str) -> None:
    """200 seeded repeats: 95 % intervals cover the truth in 92 to 98 %, for every kind of record.

    A sampled encoder's errors are uniform within a sample and repeat from drop to drop, so its
    interval may be wider than it need be; it must not be narrower.
    """
    model, hits = _model(), np.zeros(3)
    for seed in range(200):
        result = output_error.fit_output_error(
            model, _measure(clicks, kind, np.random.default_rng(5000 + seed))
        )
        for i, (name, true) in enumerate(TRUTH.items()):
            error = result.stderr(name)
            assert error is not None
            hits[i] += abs(result.value(name) - true) < 1.96 * error
    share = hits / 200
    assert np.all(share >= 0.92), share
    if kind != "sampled":
        # 200 draws at 95 % lie below 0.985 with 99 % probability
        assert np.all(share <= 0.985), share


def test_trials_that_disagree_enlarge_the_standard_errors(clicks: dict[int, np.ndarray]) -> None:
    trials = _measure(clicks, "white", np.random.default_rng(2))
    agreed = output_error.complete_fit(output_error.fit_output_error(_model(), trials))
    # the weight of the third drop is 5 % above the stated one
    odd = [replace(t, rig=replace(t.rig, force=t.rig.pull / 1.05)) if t.id == "w20" else t for t in trials]
    scattered = output_error.complete_fit(output_error.fit_output_error(_model(), odd))
    assert agreed.differences is not None
    assert agreed.differences.probability < 0.5
    assert scattered.differences is not None
    assert scattered.differences.are_likely
    assert scattered.stderr("added_mass") > 2 * agreed.stderr("added_mass")  # type: ignore[operator]


def test_added_mass_is_not_identifiable_at_terminal_speed(rng: np.random.Generator) -> None:
    t = np.arange(20.0, 30.0, 0.1)
    inertia, drag, force = 0.05, 400.0, 1.0
    x = force and np.sqrt(force / drag) * t + rng.normal(0, 1e-3, len(t))
    model = rig_model.falling_weight(mass_kg=0.04, force_N=1.0, area_known=False, pulley=False)
    rig = RigInput(inertia=inertia, force=force, pulley=False, release_s=0.0, x0=0.0)
    parameters_ = tuple(replace(p, free=True) if p.name == "start_offset" else p for p in model.parameters)
    result = output_error.fit_output_error(
        model, [Trial("a", "fit", t, {"x_m": x}, rig=rig)], parameters=parameters_
    )
    assert result.status["added_mass"] in ("unidentifiable", "at-bound")
    assert result.status["quadratic_drag"] == "estimated"


class TestTwoPoint:
    def test_errors_are_within_the_stated_ones(self, clicks: dict[int, np.ndarray]) -> None:
        inside = 0
        for seed in range(40):
            rng = np.random.default_rng(seed)
            drops = []
            for w, exact in clicks.items():
                t = np.sort(exact + np.r_[0, rng.normal(0, 2e-3, len(exact) - 1)])
                drops.append(Trial(f"w{w}", "fit", t, {"x_m": np.arange(len(exact)) * STEP}, rig=_known(w)))
            found = drag_module.two_point(drops, robot_format.read("boxfish"), (0.293, 0.584))
            inside += all(abs(found.values[n] - v) < 2 * found.stderr[n] for n, v in TRUTH.items())
        # three correlated 2-sigma intervals all contain the truth in about nine of ten cases
        assert inside >= 32

    def test_the_closed_form_for_twice_the_displacement(self) -> None:
        ratio = np.expm1(-2 * 1.3 * 0.3) / np.expm1(-2 * 1.3 * 0.6)
        assert drag_module.solve_a1(ratio, (0.3, 0.6)) == pytest.approx(1.3)
        assert drag_module.solve_a1(ratio, (0.3, 0.6 + 1e-7)) == pytest.approx(1.3, rel=1e-5)


def test_added_mass_of_a_prism() -> None:
    # DNV-RP-C205: a cube moving along an edge has the coefficient 0.68
    assert drag_module.prism_added_mass(0.1, 0.1, 0.1, 1000.0) == pytest.approx(0.68)


class TestCommand:
    def test_samples_give_the_published_values(
        self, swimid: Callable[..., Ran], samples: Path, tmp_path: Path
    ) -> None:
        out = tmp_path / "drag.yaml"
        ran = swimid("fit-drag", samples / "rig" / "trials.yaml", "-o", out, "--json")
        assert ran.status == 0, ran.err
        file = parameters.read(out, model="falling-weight")
        p = file.parameters
        assert p["drag_coefficient"].value == pytest.approx(0.705, abs=0.033)
        assert p["added_mass"].value == pytest.approx(0.685, abs=0.037)
        assert p["pulley_friction"].value == pytest.approx(0.0308, rel=0.05)
        for name in TRUTH:
            assert p[name].status == "estimated"
            # far tighter than the paper's: within four of its own standard errors
            assert abs(p[name].value - TRUTH[name]) < 4 * p[name].stderr  # type: ignore[operator]
        assert ran.json["ok"]
        assert ran.json["result"]["parameters"]["added_mass"]["value"] == p["added_mass"].value
        assert len(file.provenance["inputs"]) == 9
        page = evidence.read(evidence.sidecar(out))
        assert page.verdict.level == "good"
        assert {t.id for t in page.tables} == {"methods"}

    def test_two_point_method_of_the_paper(self, swimid: Callable[..., Ran], samples: Path) -> None:
        ran = swimid(
            "fit-drag",
            samples / "rig" / "trials.yaml",
            "--method",
            "two-point",
            "--points",
            "0.293,0.584",
            "--json",
        )
        for name, true in TRUTH.items():
            e = ran.json["result"]["parameters"][name]
            assert abs(e["value"] - true) < 2 * e["stderr"]

    @pytest.mark.parametrize("rounding", ["floor", "round"])
    def test_the_rounding_of_a_sampled_encoder_is_found(
        self, swimid: Callable[..., Ran], tmp_path: Path, clicks: dict[int, np.ndarray], rounding: str
    ) -> None:
        lines = []
        for w, exact in clicks.items():
            t = np.arange(0, exact[-1], 0.01)
            x = np.interp(t, exact, np.arange(len(exact)) * STEP)
            x[t < exact[1]] = STEP * (t[t < exact[1]] / exact[1]) ** 2
            counts = np.floor(x / STEP) if rounding == "floor" else np.round(x / STEP)
            write_log(tmp_path / f"w{w}.csv", {"t_s": t, "x_m": counts * STEP}, "%.6f")
            lines.append(f"log: w{w}.csv, pulling_mass_kg: {w / 1000}")
        write_trials(tmp_path / "trials.yaml", "falling-weight", "boxfish", lines)
        ran = swimid("fit-drag", tmp_path / "trials.yaml", "--json")
        result = ran.json["result"]
        assert result["settings"]["encoder_rounding"] == {"floor": "floor", "round": "nearest"}[rounding]
        # linear interpolation between clicks is good to a tenth of a step
        assert result["parameters"]["added_mass"]["value"] == pytest.approx(0.685, abs=0.005)

    def test_free_decay_and_towing(
        self, swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator
    ) -> None:
        (tmp_path / "hull.yaml").write_text(
            "format: swimid-robot/1\nname: hull\nbody: {inertial_mass_kg: 3.0, roll_inertia_kg_m2: 0.5}\n"
            "rig: {roll_stiffness_N_m_rad: 4.0}\n"
        )
        t = np.arange(0, 20, 0.02)
        run = solve_ivp(
            lambda _, s: [s[1], (-4.0 * s[0] - 0.04 * s[1] - 0.3 * s[1] * abs(s[1])) / 0.7],
            (0, 20),
            [0.3, 0],
            t_eval=t,
            rtol=1e-10,
            atol=1e-12,
        )
        write_log(tmp_path / "roll.csv", {"t_s": t, "roll_rad": run.y[0] + rng.normal(0, 1e-3, len(t))})
        write_trials(tmp_path / "decay.yaml", "free-decay", "hull.yaml", ["log: roll.csv"])
        p = swimid("fit-drag", tmp_path / "decay.yaml", "--json").json["result"]["parameters"]
        for name, true in (("added_inertia", 0.2), ("linear_damping", 0.04), ("quadratic_damping", 0.3)):
            assert abs(p[name]["value"] - true) < 4 * p[name]["stderr"], name
        force = 2.0 * np.sin(1.5 * t) + 1.0
        run = solve_ivp(
            lambda s, y: [y[1], (np.interp(s, t, force) - 5.0 * y[1] * abs(y[1])) / 4.0],
            (0, 20),
            [0, 0],
            t_eval=t,
            rtol=1e-9,
            atol=1e-11,
            max_step=0.02,
        )
        write_log(
            tmp_path / "tow.csv", {"t_s": t, "force_N": force, "x_m": run.y[0] + rng.normal(0, 1e-3, len(t))}
        )
        write_trials(tmp_path / "tow.yaml", "towed", "hull.yaml", ["log: tow.csv"])
        p = swimid("fit-drag", tmp_path / "tow.yaml", "--json").json["result"]["parameters"]
        for name, true in (("added_mass", 1.0), ("quadratic_drag", 5.0)):
            assert abs(p[name]["value"] - true) < 4 * p[name]["stderr"], name


def test_a_bifilar_swing_gives_an_inertia_that_is_far_from_the_known_one(
    swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator
) -> None:
    # 1.4 kg on two threads of 1 m at a distance of 0.3 m; the exact moment, not its linear part
    mass, distance, length, inertia = 1.4, 0.30, 1.0, 0.020
    time = np.arange(0.0, 20.0, 0.02)

    def rates(_: float, y: np.ndarray) -> list[float]:
        height = np.sqrt(length**2 - 0.5 * distance**2 * (1.0 - np.cos(y[0])))
        moment = mass * 9.81 * 0.25 * distance**2 * np.sin(y[0]) / height
        return [y[1], (-moment - 0.0008 * y[1]) / inertia]

    rows = []
    for k, start in enumerate((0.08, 0.06)):
        angle = solve_ivp(rates, (0.0, 20.0), [start, 0.0], t_eval=time, rtol=1e-9, atol=1e-12).y[0]
        noisy = angle + rng.normal(0.0, 0.001, len(time))
        write_log(tmp_path / f"{k}.csv", {"t_s": time, "yaw_rad": noisy}, "%.6f")
        rows.append(f"log: {k}.csv")
    write_trials(tmp_path / "trials.yaml", "free-decay", "hung.yaml", rows)
    stiffness = mass * 9.81 * distance**2 / (4.0 * length)
    (tmp_path / "hung.yaml").write_text(
        "format: swimid-robot/1\nname: hung\nbody: {yaw_inertia_kg_m2: 0.001}\n"
        f"rig: {{yaw_stiffness_N_m_rad: {stiffness}}}\n"
    )
    found = swimid("fit-drag", tmp_path / "trials.yaml", "--json").json["result"]["parameters"]
    added = found["added_inertia"]
    # the sine of the angle makes a swing of amplitude a longer by a^2 / 16, and the inertia larger by a^2 / 8
    softer = inertia * 0.08**2 / 8.0
    assert added["value"] == pytest.approx(inertia - 0.001, abs=3.0 * added["stderr"] + softer)
    assert added["stderr"] < 0.005 * inertia
