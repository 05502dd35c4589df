"""Parameter files with effects: written by ``diagnose``, and used by every command that simulates."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import swimid as package
from swimid.diagnosis.gap_file import GapFile
from swimid.effects import catalogue as effect_catalogue
from swimid.errors import InputError, UsageError
from swimid.fitting.model import Model, SwimInput, Trial
from swimid.logs import log as log_format
from swimid.results.parameters import Correlation, Estimate, ParameterFile
from swimid.swimmer.planar.model import MultilinkModel
from tests.conftest import ROOT, SAMPLES, Ran
from tests.effect_cases import coasting, start, swim, swimmer
from tests.generators.rig import write_falls

Run = Callable[..., Ran]
BEAT: dict[str, Any] = {"frequency_hz": 1.0, "amplitude_deg": 20.0, "duration_s": 6.0}
DROOP = ROOT / "docs" / "examples" / "effect" / "my_effect.py"


def fish(*effects: str, settings: dict[str, Any] | None = None, **values: float | tuple[float, float]) -> Any:
    """The parameters of the sample fish with effects. A pair is a value with its standard error.

    A parameter ``servo_lag__time_constant_s`` is written as ``servo-lag/time_constant_s``.
    """
    file = ParameterFile.read(SAMPLES / "gap" / "params.yaml")
    for key, value in values.items():
        effect, _, name = key.partition("__")
        at, stderr = value if isinstance(value, tuple) else (value, None)
        label = f"{effect.replace('_', '-')}/{name}"
        file.parameters[label] = Estimate(value=at, stderr=stderr, unit="1", status="estimated")
    file.effects, file.settings = list(effects), settings or {}
    return file


def rig(*effects: str, **values: float) -> ParameterFile:
    """Parameters of the boxfish on the falling-weight rig with effects."""
    own = {"drag_coefficient": 0.705, "added_mass": 0.685, "pulley_friction": 0.0, "linear_drag": 0.0}
    estimates = {n: Estimate(value=v, unit="1", status="fixed") for n, v in (own | values).items()}
    return ParameterFile(model="falling-weight", robot="boxfish", parameters=estimates, effects=list(effects))


# ---------------------------------------------------------------- effects act in every command


def test_a_loss_of_amplitude_is_a_smaller_beat() -> None:
    lossy = package.simulate(params=fish("amplitude-loss", amplitude_loss__loss=0.2), **BEAT)
    small = package.simulate(params=fish(), **{**BEAT, "amplitude_deg": 16.0})
    for channel in ("x_m", "yaw_rad", "joint1_rad", "joint4_rad"):
        # the rate of a command is that of its samples, which is least certain at their end
        seen, wanted = (one.frame[channel].to_numpy()[:-1] for one in (lossy, small))
        assert np.abs(seen - wanted).max() < 2e-3 * np.ptp(wanted)
    # the log keeps the command
    assert lossy.frame["cmd1_rad"].max() == pytest.approx(small.frame["cmd1_rad"].max() / 0.8)
    for name in ("mean_speed_m_s", "mean_positive_power_W", "peak_torque_N_m"):
        assert lossy.quantities[name].value == pytest.approx(small.quantities[name].value, rel=5e-3)


def test_a_map_has_the_effects() -> None:
    about: dict[str, Any] = {
        "amplitude_deg": 20.0,
        "over": {"frequency_hz": (1.0, 1.4, 2)},
        "duration_s": 4.0,
    }
    lossy = package.performance_map(params=fish("amplitude-loss", amplitude_loss__loss=0.2), **about).frame
    small = package.performance_map(params=fish(), **{**about, "amplitude_deg": 16.0}).frame
    for name in ("mean_speed_m_s", "cost_of_transport_J_m"):
        assert lossy[name].to_numpy() == pytest.approx(small[name].to_numpy(), rel=5e-3)


@pytest.mark.slow
def test_sensitivity_varies_the_size_of_an_effect() -> None:
    file = fish("amplitude-loss", amplitude_loss__loss=(0.2, 0.05))
    found = package.sensitivity(
        SAMPLES / "gap" / "trials.yaml",
        params=file,
        samples=2,
        ranges=["stderr"],
        coefficients=["amplitude-loss/loss", "c_d4"],
    )
    assert set(found.indices["coefficient"]) == {"amplitude-loss/loss", "c_d4"}
    assert found.file.ranges["amplitude-loss/loss"].low == pytest.approx(0.1)


def test_uncertainty_contains_that_of_the_effect() -> None:
    """Against the difference of two simulations with the effect a standard error apart."""
    known = fish("amplitude-loss", amplitude_loss__loss=(0.2, 0.02))
    for name, one in known.parameters.items():
        if "/" not in name:
            one.stderr = None
    made = package.simulate(params=known, **BEAT).quantities["mean_speed_m_s"]
    ends = [
        package.simulate(params=known, chosen={"amplitude-loss/loss": at}, **BEAT).quantities[
            "mean_speed_m_s"
        ]
        for at in (0.18, 0.22)
    ]
    assert made.stderr == pytest.approx(0.5 * abs(ends[0].value - ends[1].value), rel=0.03)
    assert ends[0].stderr is None


def test_effects_and_coefficients_are_correlated() -> None:
    """A fully correlated pair of which one undoes the other."""
    known = fish("amplitude-loss", amplitude_loss__loss=(0.2, 0.02))
    for name, one in known.parameters.items():
        if "/" not in name and name != "c_d4":
            one.stderr = None
    spread = []
    for rho in (-0.99, 0.0, 0.99):
        names = ["c_d4", "amplitude-loss/loss"]
        known.correlation = Correlation(names=names, matrix=[[1.0, rho], [rho, 1.0]])
        spread.append(package.simulate(params=known, **BEAT).quantities["mean_speed_m_s"].stderr)
    assert spread[1] == pytest.approx(math.sqrt(0.5 * (spread[0] ** 2 + spread[2] ** 2)), rel=1e-6)
    assert abs(spread[0] - spread[2]) > 0.1 * spread[1]


def test_a_camera_changes_the_log_and_not_the_robot() -> None:
    seen = package.simulate(params=fish("camera-scale", camera_scale__scale_error=0.1), **BEAT)
    true = package.simulate(params=fish(), **BEAT)
    assert seen.frame["x_m"].to_numpy() == pytest.approx(1.1 * true.frame["x_m"].to_numpy())
    speeds = [one.quantities["mean_speed_m_s"].value for one in (seen, true)]
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-9)


@pytest.mark.parametrize(
    "effect, parameter, own",
    [
        ("pulley-friction", "pulley-friction/friction_N", "pulley_friction"),
        ("linear-drag", "linear-drag/linear_N_s_m", "linear_drag"),
    ],
)
def test_an_effect_of_the_rig_equals_the_parameter_of_the_model(
    effect: str, parameter: str, own: str
) -> None:
    affected, plain = rig(effect, **{parameter: 0.03}), rig(**{own: 0.03})
    drops = [package.simulate(params=p, pulling_mass_kg=0.02, duration_s=4.0) for p in (affected, plain)]
    assert drops[0].frame["x_m"].to_numpy() == pytest.approx(drops[1].frame["x_m"].to_numpy(), abs=1e-9)
    for name, quantity in drops[1].quantities.items():
        assert drops[0].quantities[name].value == pytest.approx(quantity.value, rel=1e-9)


def test_a_black_box_has_the_effects(tmp_path: Path) -> None:
    time = np.arange(0.0, 5.0, 0.02)
    log_format.write(tmp_path / "u.csv", {"t_s": time, "cmd1_rad": np.sin(3.0 * time)}, {})
    runs = []
    for gain, loss in ((0.5, 0.2), (0.4, 0.0)):
        values = {"a1": -0.9, "b1": gain, "amplitude-loss/loss": loss}
        estimates = {n: Estimate(value=v, unit="1", status="estimated") for n, v in values.items()}
        file = ParameterFile(
            model="arma", parameters=estimates, effects=["amplitude-loss"], delay=1, sample_time_s=0.02,
            settings={"input": "cmd1_rad", "output": "u_m_s"},
        )  # fmt: skip
        runs.append(package.simulate(params=file, input=tmp_path / "u.csv").frame["u_m_s"].to_numpy())
    assert runs[0] == pytest.approx(runs[1])


def test_an_effect_of_ones_own_needs_its_file(swimid: Run, tmp_path: Path) -> None:
    file = fish("drive-droop", drive_droop__rate_1_s=0.1)
    file.write(tmp_path / "p.yaml")
    words = ("simulate", "--params", tmp_path / "p.yaml", "--frequency-hz", "1", "--amplitude-deg", "20")
    ran = swimid(*words, "--duration-s", "6")
    assert ran.status == 3
    assert "'effects': there is no effect 'drive-droop'" in ran.err
    made = swimid(*words, "--duration-s", "6", "--effect", DROOP, "-o", tmp_path / "run.csv")
    assert made.status == 0, made.err
    angle = log_format.read(tmp_path / "run.csv", required=("joint1_rad", "cmd1_rad"))
    wanted = angle["cmd1_rad"] * np.exp(-0.1 * angle.time_s)
    assert angle["joint1_rad"] == pytest.approx(wanted, abs=2e-3)


# ---------------------------------------------------------------- forms and faults


@pytest.mark.slow
def test_a_form_is_restored_by_its_parameters_and_its_constants() -> None:
    """The wall on one side stands where the diagnosis saw it, whatever the trials of the command."""
    beside = {"side": "y_max", "extreme_m": 0.4}
    near = fish(
        "wall", settings={"effects": {"wall": beside}}, wall__y_max_push_N_s2_m2=20.0, wall__y_max_decay_m=0.2
    )
    far = fish(
        "wall",
        settings={"effects": {"wall": beside | {"extreme_m": 9.0}}},
        wall__y_max_push_N_s2_m2=20.0,
        wall__y_max_decay_m=0.2,
    )
    ways = [package.simulate(params=p, **BEAT).frame["y_m"].to_numpy()[-1] for p in (near, far, fish())]
    assert ways[0] < ways[2] - 1e-3
    assert ways[1] == pytest.approx(ways[2], abs=1e-6)


@pytest.mark.parametrize(
    "file, words",
    [
        (lambda: fish("servo-lagg"), ["'effects'", "no effect 'servo-lagg'", "did you mean 'servo-lag'"]),
        (lambda: fish("servo-lag"), ["'effects'", "'servo-lag'", "none"]),
        (lambda: fish("servo-lag", servo_lag__tau_s=0.1), ["'effects'", "tau_s"]),
        (lambda: fish("waves", waves__frequency_hz=1.0), ["'effects'", "'waves'", "frequency_hz"]),
        (
            lambda: fish("servo-lag", "servo-lag", servo_lag__time_constant_s=0.1),
            ["'effects'", "name each effect once"],
        ),
        (lambda: fish(servo_lag__time_constant_s=0.1), ["parameters.servo-lag/time_constant_s"]),
        (lambda: rig("wake-lift"), ["'effects'", "falling-weight"]),
        (
            lambda: fish("drag-reynolds", drag_reynolds__exponent=0.2),
            ["'settings.effects.drag-reynolds'", "needs reference_m_s"],
        ),
    ],
)
def test_a_file_with_wrong_effects_is_refused(
    tmp_path: Path, file: Callable[[], Any], words: list[str]
) -> None:
    file().write(tmp_path / "p.yaml")
    drive = BEAT if file().model == "multilink" else {"pulling_mass_kg": 0.02}
    with pytest.raises(InputError) as caught:
        package.simulate(params=tmp_path / "p.yaml", **drive)
    for word in ["p.yaml", *words]:
        assert word in str(caught.value)


@pytest.mark.slow
def test_an_effect_that_needs_the_measured_speed_says_so() -> None:
    constants = {"drag-reynolds": {"reference_m_s": 0.2, "whole": True}}
    file = fish("drag-reynolds", settings={"effects": constants}, drag_reynolds__trial_exponent=0.3)
    with pytest.raises(UsageError, match="needs the measured speed"):
        package.simulate(params=file, **BEAT)
    trials = SAMPLES / "gap" / "trials.yaml"
    assert len(package.compare(trials, params=file).scores) > 0


def test_a_drag_file_with_effects_is_taken_without_them() -> None:
    drag = rig("linear-drag", **{"linear-drag/linear_N_s_m": 0.1})
    with pytest.warns(package.SwimidWarning, match="SWM076"):
        fin = package.fit_propulsion(SAMPLES / "cruise" / "trials.yaml", drag=drag)
    assert 0.0 < fin["recoil_efficiency"].value < 1.0


# ---------------------------------------------------------------- effects upon effects


@pytest.mark.parametrize(
    "names", [("servo-lag", "linear-drag"), ("camera-scale", "current"), ("time-offset", "tether")]
)
def test_effects_act_on_an_affected_model_as_beside_its_effects(names: tuple[str, str]) -> None:
    """One after the other, as both at once: one run, many runs, finer and coarser steps."""
    model = swimmer("tfish")
    trials = [swim(model), coasting(model)]
    found = {e.name: e for e in effect_catalogue.applicable(effect_catalogue.list_effects(), model, trials)}
    first, second = (found[name] for name in names)
    both = model.with_effects([first, second], trials)
    nested = model.with_effects([first], trials).with_effects([second], trials)
    assert [p.name for p in nested.parameters] == [p.name for p in both.parameters]
    values = np.concatenate(
        [start(model), *(e.tries(e.parameters(model, trials))[0] for e in (first, second))]
    )
    for one, other in ((both, nested), (both.refine(), nested.refine()), (both.coarser(), nested.coarser())):
        wanted = [one.run(values, trial) for trial in trials]
        many = other.run_many([(values, trial) for trial in trials])
        for trial, expected, seen in zip(trials, wanted, many, strict=True):
            alone = other.run(values, trial)
            for channel, series in expected.items():
                assert np.array_equal(series, alone[channel]), channel
                assert np.array_equal(series, seen[channel]), channel


def test_copies_with_effects_or_another_step_keep_their_simulations_apart() -> None:
    """Simulated in turn with its copies, each model gives what it gives alone."""
    trial = swim(swimmer("tfish"))

    def models(model: MultilinkModel) -> list[Model]:
        known = effect_catalogue.applicable(effect_catalogue.list_effects(), model, [trial])
        affected = model.with_effects([e for e in known if e.name == "linear-drag"], [trial])
        return [model, affected, model.refine(), affected.refine(), affected.coarser()]

    def values(model: Model) -> np.ndarray:
        return np.array([p.start + p.scale * ("/" in p.name) for p in model.parameters])

    alone = [
        models(swimmer("tfish"))[k].run(values(m), trial) for k, m in enumerate(models(swimmer("tfish")))
    ]
    together = models(swimmer("tfish"))
    for _ in range(2):
        for model, expected in zip(together, alone, strict=True):
            np.testing.assert_array_equal(model.run(values(model), trial)["x_m"], expected["x_m"])
    plain, affected, fine = (one["x_m"] for one in alone[:3])
    assert np.abs(affected - plain).max() > 1e-4
    assert 0.0 < np.abs(fine - plain).max() < 1e-4


def test_the_torques_of_a_pulled_fish_balance() -> None:
    """The moment on a free base is zero by inverse dynamics, with the forces and masses of effects."""
    model = swimmer("tfish")
    trial = Trial("run", "fit", np.arange(0.0, 3.0, 0.01), {}, swim=SwimInput(swim(model).swim.beat))
    effects = {
        e.name: e for e in effect_catalogue.applicable(effect_catalogue.list_effects(), model, [trial])
    }
    acting = model.with_effects([effects["tether"], effects["water-ingress"]], [trial])
    values = np.concatenate([start(model), [2.0, 0.0, 5.0, 0.1, 0.05, 0.02]])
    hooks = acting.hooks(values, trial)
    run = model.request(start(model), trial, hooks)
    trajectory = model.trajectory(start(model), trial, hooks)
    torques, _ = model.torques(run, trajectory, 0)
    assert np.abs(torques[:, 0]).max() < 1e-9 * np.abs(torques).max()
    pulled = acting.with_energetics([(values, trial)], [1.0])[0][1]
    free = model.with_energetics([(start(model), trial)], [1.0])[0][1]
    assert pulled.mean_power_W() != pytest.approx(free.mean_power_W(), rel=1e-3)


# ---------------------------------------------------------------- what diagnose writes


@pytest.fixture(scope="module")
def friction(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with drops of the sample, two of them held out, and parameters without pulley friction."""
    folder = tmp_path_factory.mktemp("rig")
    shutil.copytree(SAMPLES / "rig", folder, dirs_exist_ok=True)
    text = (folder / "trials.yaml").read_text()
    for log in ("w15", "w35"):
        text = text.replace(f"log: {log}.csv", f"role: validate, log: {log}.csv")
    (folder / "trials.yaml").write_text(text)
    package.fit_drag(folder / "trials.yaml", fixed={"pulley_friction": 0.0}, output=folder / "ideal.yaml")
    return folder


@pytest.mark.slow
def test_diagnose_writes_the_model_with_the_cause(swimid: Run, friction: Path) -> None:
    out, trials = friction / "gap.yaml", friction / "trials.yaml"
    words = ("--params", friction / "ideal.yaml", "--effects", "pulley-friction,tether", "-o", out)
    ran = swimid("diagnose", trials, *words)
    assert ran.status == 0, ran.err
    assert (
        "The model with pulley-friction is in repaired.yaml: give it as --params to any command." in ran.out
    )
    assert f"wrote {friction / 'repaired.yaml'}" in ran.err
    gap, made = GapFile.read(out), ParameterFile.read(friction / "repaired.yaml")
    (cause,) = gap.causes
    entry = made.parameters["pulley-friction/friction_N"]
    stated = cause.parameters["friction_N"]
    assert (made.effects, entry.status, entry.stderr) == (["pulley-friction"], "estimated", stated.stderr)
    assert entry.value == pytest.approx(stated.value, abs=stated.stderr)
    assert made.parameters["pulley_friction"].status == "fixed"
    assert {"drag_coefficient", "added_mass", "pulley-friction/friction_N"} == set(made.correlation.names)
    assert not any("[" in name for name in made.parameters)
    assert made.provenance["inputs"] == gap.provenance["inputs"]
    # the held-out errors are those that the gap file states
    scores = package.compare(trials, params=friction / "repaired.yaml").scores
    errors = scores[(scores["role"] == "validate") & (scores["channel"] == "x_m")]
    noise = gap.waterfall[-1].rmse["x_m"]
    for _, row in errors.iterrows():
        held = gap.facts.held_out[row["trial"]]
        # the squared distance also has the uncertainty of the prediction
        assert row["rmse"] == pytest.approx(noise * math.sqrt(held.after / held.samples), rel=0.05)
    shown = package.load_result(friction / "repaired.yaml")
    assert shown["pulley-friction/friction_N"].value == entry.value
    report = swimid("report", friction / "repaired.yaml", "-o", friction / "r.html")
    assert report.status == 0, report.err
    assert "pulley-friction/friction_N" in (friction / "r.html").read_text()


@pytest.mark.slow
def test_the_repaired_model_has_no_gap(swimid: Run, friction: Path) -> None:
    """The cause is part of the model now, and no hypothesis; an earlier file stays, with a warning."""
    folder, trials = friction / "next", friction / "trials.yaml"
    folder.mkdir()
    known = package.diagnose(
        trials,
        params=friction / "ideal.yaml",
        effects=["pulley-friction", "tether"],
        repaired=folder / "a.yaml",
    )
    assert known.repaired is not None
    assert [path.name for path in known.outputs] == ["a.yaml", "a.evidence.json"]
    shutil.copy(folder / "a.yaml", folder / "repaired.yaml")
    before = (folder / "repaired.yaml").read_bytes()
    words = ("--params", folder / "a.yaml", "-o", folder / "gap.yaml", "--effects")
    ran = swimid("diagnose", trials, *words, "tether,pulley-viscous")
    assert ran.status == 0, ran.err
    assert GapFile.read(folder / "gap.yaml").verdict == "none"
    assert "SWM061" in ran.err
    assert (folder / "repaired.yaml").read_bytes() == before
    refused = swimid("diagnose", trials, *words, "pulley-friction")
    assert refused.status == 2
    assert "'pulley-friction' is part of the model" in refused.err


def test_a_diagnosis_writes_only_where_it_may(swimid: Run, friction: Path, tmp_path: Path) -> None:
    trials, params = friction / "trials.yaml", tmp_path / "repaired.yaml"
    shutil.copy(friction / "ideal.yaml", params)
    words = ("diagnose", trials, "--params", params, "-o", tmp_path / "gap.yaml")
    ran = swimid(*words)
    assert ran.status == 2
    assert "is an input of this diagnosis" in ran.err
    assert "--repaired FILE" in ran.err
    ran = swimid("diagnose", trials, "--params", friction / "ideal.yaml", "-o", friction / "repaired.yaml")
    assert ran.status == 2
    assert "two outputs would be written to" in ran.err
    (tmp_path / "own.yaml").write_text("mine: true\n")
    ran = swimid(*words, "--repaired", tmp_path / "own.yaml")
    assert ran.status == 2
    assert "own.yaml exists and was not written by swimid" in ran.err
    ran = swimid(*words, "--repaired", tmp_path / "b.yaml", "--power")
    assert ran.status == 2
    assert "--repaired and --power cannot be combined" in ran.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["own.yaml", "repaired.yaml"]


@pytest.mark.slow
def test_a_changed_parameter_has_its_new_value(swimid: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    first = write_falls(tmp_path / "first", rng, drag_coefficient=0.705)
    assert swimid("fit-drag", first, "-o", tmp_path / "drag.yaml", "-q").status == 0
    trials = write_falls(tmp_path / "second", rng, held_out=(25,), drag_coefficient=0.7755)
    found = package.diagnose(trials, params=tmp_path / "drag.yaml")
    made = found.repaired
    assert made is not None
    assert made.effects == []
    cause = found.file.causes[0].parameters["drag_coefficient"]
    entry = made.parameters["drag_coefficient"]
    assert (entry.stderr, entry.status) == (cause.stderr, "estimated")
    assert entry.value == pytest.approx(cause.value, abs=cause.stderr)
    found.save(tmp_path / "gap.yaml")
    scores = package.compare(trials, params=tmp_path / "repaired.yaml").scores
    held_out = scores[scores["role"] == "validate"]
    assert held_out["rmse"].iloc[0] == pytest.approx(found.file.waterfall[-2].rmse["x_m"], rel=0.02)
