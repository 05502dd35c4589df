"""Other readings of a robot's source as hypotheses: how they act, which are tried, that they are found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from swimid.diagnosis import readings, search
from swimid.diagnosis.gap_file import GapFile
from swimid.diagnosis.readings import OtherReading
from swimid.diagnosis.search import HypothesisSearch, SearchResult
from swimid.diagnosis.study import GapStudy
from swimid.effects import catalogue
from swimid.effects.base import Effect
from swimid.fitting.drives import TailBeat
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array, Model, RigInput, SwimInput, Trial
from swimid.results import evidence
from swimid.results.parameters import ParameterFile
from swimid.robots import file as robot_format
from swimid.simulation.compare_series import ComparisonFile
from swimid.swimmer import trials as swimmer_trials
from swimid.swimmer.model import Swimmer
from tests.conftest import Ran, command
from tests.diagnosis_models import PLAIN, Hooked, Seen, plainly, ring, rise
from tests.generators import gap_trials, swimmer
from tests.test_diagnose import diagnosed, held_responsible
from validation.blind import swim_effects

Run = Callable[..., Ran]
STAGES = {
    "reading:head_inertia=com": "structure",
    "reading:tail_inertia=table": "structure",
    "reading:areas=as-printed": "fluid",
    "reading:drag_point=strips": "fluid",
    "reading:drag_point=com": "fluid",
    "reading:amplitude=per-joint": "actuation",
    "reading:added_mass=lateral": "fluid",
}
#: Questions whose answers are no hypotheses.
OPEN = """\
  gravity:
    question: On which planet?
    chosen: earth
    options: {earth: {says: Earth.}, moon: {says: Moon., set: {fluid.gravity_m_s2: 1.62}}}
  play:
    question: Is there a spare?
    chosen: one
    options: {one: {says: One.}, none: {says: None., set: {multilink.coefficients.spare: null}}}
"""


def swim(frequency_hz: float = 1.4) -> Trial:
    """A trial of which pose and heading are measured."""
    time = np.arange(51) / 25.0
    measured = {name: np.zeros(len(time)) for name in ("x_m", "y_m", "yaw_rad")}
    return Trial("swim", "fit", time, measured, swim=SwimInput(TailBeat("sine", frequency_hz, 0.4)))


def experiment(robot: str | Path = "tfish", trials: list[Trial] | None = None) -> Experiment:
    read, model = swimmer_trials.robot_model(str(robot))
    path = robot_format.locate(str(robot))
    return Experiment("free-swim", read, model, trials or [swim()], [], robot_path=path)


@pytest.fixture(scope="module")
def fish() -> Experiment:
    return experiment()


@pytest.fixture(scope="module")
def others(fish: Experiment) -> dict[str, OtherReading]:
    found, left_out = readings.list_readings(fish, fish.trials)
    assert not left_out
    return {r.name: r for r in found}


def starts(model: Model) -> Array:
    return np.array([p.start for p in model.parameters])


# ---------------------------------------------------------------- how they act


def test_every_reading_that_was_not_chosen_is_tried(others: dict[str, OtherReading]) -> None:
    assert {name: other.stage for name, other in others.items()} == STAGES
    meaning = others["reading:drag_point=strips"].meaning
    assert meaning == (
        'Another answer to "Eq 7 does not say where on a link v_i is taken": Spread evenly along each link.'
    )


@pytest.mark.parametrize(
    "answers",
    [{"drag_point": "strips"}, {"areas": "as-printed"}, {"head_inertia": "com", "drag_point": "com"}],
    ids=lambda a: "+".join(a.values()),
)
def test_another_reading_replaces_the_nominal_robot(
    fish: Experiment, others: dict[str, OtherReading], answers: dict[str, str]
) -> None:
    """As a model of the robot file read so from the start, to the last bit, with the nominal parameters."""
    effects = [others[f"reading:{key}={option}"] for key, option in answers.items()]
    acting = fish.model.with_effects(effects, fish.trials)
    assert acting.parameters == fish.model.parameters
    _, model = swimmer_trials.robot_model("tfish", readings=answers)
    values = starts(fish.model)
    wanted, plain = model.simulate(values, swim()), fish.model.simulate(values, swim())
    for found in (acting.run(values, swim()), acting.run_many([(values, swim())])[0]):
        for channel in swim().measured:
            assert np.array_equal(found[channel], wanted[channel])
            assert not np.allclose(found[channel], plain[channel], rtol=1e-3)


def test_effects_act_on_a_robot_in_another_reading(fish: Experiment, others: dict[str, OtherReading]) -> None:
    ingress = next(
        e
        for e in catalogue.applicable(catalogue.list_effects(), fish.model, fish.trials)
        if e.name == "current"
    )
    reading = others["reading:drag_point=strips"]
    _, model = swimmer_trials.robot_model("tfish", readings={"drag_point": "strips"})
    acting = fish.model.with_effects([ingress, reading], fish.trials)
    wanted = model.with_effects([ingress], fish.trials)
    values = np.concatenate((starts(fish.model), [0.05] * len(wanted.acting[0].parameters)))
    found, expected = acting.run(values, swim()), wanted.run(values, swim())
    assert all(np.array_equal(found[c], expected[c]) for c in expected)


def test_a_finer_step_keeps_the_reading(fish: Experiment, others: dict[str, OtherReading]) -> None:
    acting = fish.model.with_effects([others["reading:areas=as-printed"]], fish.trials)
    finer = acting.refine()
    assert finer is not None
    assert isinstance(finer, Swimmer)
    assert isinstance(fish.model, Swimmer)
    assert finer.max_step == 0.5 * fish.model.max_step
    assert finer.robot.readings["areas"].chosen == "as-printed"


def test_two_answers_of_one_question_cannot_be_combined(others: dict[str, OtherReading]) -> None:
    strips, com, head = (
        others[f"reading:{n}"] for n in ("drag_point=strips", "drag_point=com", "head_inertia=com")
    )
    assert strips.joins([])
    assert strips.joins([head])
    assert not strips.joins([com])
    assert not strips.joins([strips])
    assert strips.joins(catalogue.list_effects())


def test_the_compiled_form_serves_readings_that_differ_in_numbers(fish: Experiment) -> None:
    """Drag at other points is other numbers in the same tables; in strips it is more rows."""
    _, model = swimmer_trials.robot_model("tfish")
    for answers, shared in (({"areas": "as-printed"}, True), ({"drag_point": "strips"}, False)):
        other = model.read_otherwise(robot_format.read("tfish", readings=answers))
        assert (other.kernels is model.kernels) == shared


# ---------------------------------------------------------------- which are tried


def test_a_reading_that_changes_no_measured_channel_is_no_hypothesis(tmp_path: Path) -> None:
    """Gravity in a horizontal plane; an answer that takes a coefficient away; one already chosen."""
    spare = "coefficients:\n    spare: {value: 1.0, meaning: none, source: none}\n#"
    text = robot_format.locate("tfish").read_text().replace("coefficients:", spare, 1)
    path = tmp_path / "fish.yaml"
    path.write_text(text.replace("readings:\n", f"readings:\n{OPEN}", 1))
    found, left_out = readings.list_readings(experiment(path), [swim()])
    assert {r.name for r in found} == set(STAGES)
    assert left_out == {
        "reading:gravity=moon": "the reading changes no channel that was measured in these trials",
        "reading:play=none": "the reading has other coefficients or channels than the model",
    }


def test_a_robot_without_readings_has_no_such_hypothesis() -> None:
    sealion = experiment("sealion", [])
    assert readings.list_readings(sealion, []) == ([], {})


@pytest.mark.parametrize(
    "name, status, says",
    [
        ("reading:drag_point=strip", 2, "did you mean 'reading:drag_point=strips'"),
        ("reading:drag_point=mid-link", 2, "there is no effect 'reading:drag_point=mid-link'"),
    ],
)
def test_readings_are_requested_by_name(
    swimid: Run, tmp_path: Path, name: str, status: int, says: str
) -> None:
    gap_trials.write(tmp_path, "tfish", settings=((1.0, 25, 0),), duration_s=2.0)
    ran = swimid("diagnose", tmp_path / "trials.yaml", "--effects", f"current,{name}")
    assert ran.status == status
    assert says in ran.err


# ---------------------------------------------------------------- how they are weighed


def test_priors_are_wider_under_another_reading(fish: Experiment, others: dict[str, OtherReading]) -> None:
    """Under another reading a coefficient is known to 60 % of its size at best, and counts as a parameter."""
    model = fish.model
    prior = {"c_d0": (4.9, 0.1), "c_d4": (5.8, 4.0)}
    study = GapStudy(model, model.parameters, fish.trials, prior)
    reading = others["reading:areas=as-printed"]
    plain, read = (study.problem(e) for e in ((), (reading,)))
    assert study.widen_priors(plain) == {}
    size = next(p.start for p in model.parameters if p.name == "c_d0")
    assert study.widen_priors(read) == {"c_d0": (4.9, pytest.approx(0.6 * size))}
    at = plain.labels.index("c_d0")
    assert study.compute_prior(plain)[1][at] == pytest.approx(1 / 0.1)
    assert study.compute_prior(read)[1][at] == pytest.approx(1 / (0.6 * size))
    searched = HypothesisSearch(study, (), (), rng=np.random.default_rng(0))
    own, other = study.at((), np.array(plain.start)), study.at((reading,), np.array(read.start))
    searched.null = own
    searched.pool = {h.key: h for h in (own, other)}
    candidates = searched.compute_posterior().candidates
    assert [c.numbers for c in candidates] == [0, 0]
    assert [c.widening for c in candidates] == pytest.approx([0.0, np.log(0.6 * size / 0.1)])


class Quicker:
    """Of a decay ``a exp(-t)`` the reading ``a exp(-2 t)``."""

    def __init__(self) -> None:
        self.other = Hooked(lambda values, t: {"y": values[0] * np.exp(-2.0 * t)}, PLAIN, ("y",))

    def model(self, model: Model, question: str, option: str) -> Model:
        return self.other

    def stand(self, answers: Mapping[str, str]) -> bool:
        return True


def decays(rng: np.random.Generator, rate_1_s: float, rising: float) -> list[Trial]:
    """Six trials of a decay, beside something that rises."""
    trials = []
    for k in range(6):
        t = np.linspace(0.0, 5.0 + 0.3 * k, 200)
        y = np.exp(-rate_1_s * t) + rising * rise(t) + 0.02 * rng.normal(size=len(t))
        trials.append(Trial(f"t{k}", "fit", t, {"y": y}, rig=RigInput(force=1.0 + k)))
    return trials


def sought(trials: list[Trial], *, reading: bool = True) -> SearchResult:
    effects: list[Effect] = [Seen("rise", rise), Seen("ring", ring)]
    if reading:
        said = 'Another answer to "How fast does it decay?": twice as fast.'
        effects.append(OtherReading("rate", "quick", meaning=said, stage="fluid", reread=Quicker()))
    return search.search_causes(
        GapStudy(Hooked(plainly, PLAIN, ("y",)), PLAIN, trials, {"a": (1.0, 0.1)}), effects
    )


@pytest.mark.parametrize(
    "rate, rising, causes",
    [(2.0, 0.0, {"reading:rate=quick"}), (2.0, 0.3, {"reading:rate=quick", "rise"}), (1.0, 0.3, {"rise"})],
)
def test_a_reading_is_a_cause_alone_and_in_a_set(
    rng: np.random.Generator, rate: float, rising: float, causes: set[str]
) -> None:
    state = sought(decays(rng, rate, rising))
    assert {e.name for e in state.base.effects} == causes
    assert state.posterior.sets[frozenset(causes)] > 0.8


def test_readings_do_not_change_the_fits_of_effects(rng: np.random.Generator) -> None:
    """To the last bit, where it does not lead and so does not tell the noise."""
    trials = decays(rng, 1.0, 0.3)
    found, without = sought(trials), sought(trials, reading=False)
    np.testing.assert_array_equal(found.base.theta, without.base.theta)
    gains = [{r.last_screening.effect.name: r.gains for r in state.singles} for state in (found, without)]
    assert set(gains[0]) == {*gains[1], "reading:rate=quick"}
    for name, own in gains[1].items():
        np.testing.assert_array_equal(gains[0][name], own)


# ---------------------------------------------------------------- that they are found


def answered(option: str) -> swimmer.Swimmer:
    """The tendon fish of the oracle, one question answered otherwise than the robot file does."""
    fish = swimmer.tfish(swimmer.SAMPLE)
    if option == "drag_point=com":
        # the first five points of water are the drag of a link each
        fish.water.behind[[0, 4]] = 0.192, 0.027
    elif option == "head_inertia=com":
        fish.inertia[0] = 91.6e-3 * (1.0 + swimmer.SAMPLE["c_Ia"])
    return fish


@pytest.mark.slow
@pytest.mark.parametrize("option", ["drag_point=com", "head_inertia=com"])
def test_trials_of_a_robot_in_another_reading_name_that_reading(tmp_path: Path, option: str) -> None:
    """Without a parameter file: the coefficients are free to stand in for the reading, and one ends at its
    bound where they cannot.
    """
    fish, runs = answered(option), []
    for k, (frequency, amplitude, bias) in enumerate(gap_trials.SETTINGS):
        drive = {"frequency_hz": frequency, "amplitude_deg": amplitude, "bias_deg": bias}
        runs.append(swimmer.Run(f"run{k}", drive, swimmer.swim(fish, drive, 8.0, rate_hz=25.0)))
    noise = {"x_m": 0.0015, "y_m": 0.0015, "yaw_rad": 0.008}
    swimmer.write_trials(tmp_path, "tfish", runs, noise, 7, columns=list(noise))
    out = tmp_path / "gap.yaml"
    assert command("diagnose", tmp_path / "trials.yaml", "-o", out).status == 0
    file = GapFile.read(out)
    assert file.verdict == "explained"
    assert f"reading:{option}" in held_responsible(file)[0]
    assert [c.effect for c in file.causes] == [f"reading:{option}"]
    checks = evidence.read(evidence.sidecar(out)).checks
    refitted = {c.coefficient: c.without.value for c in file.causes[0].absorbed}
    for name, bound in file.at_bound.items():
        assert any(name in check.value + check.text + check.reason for check in checks)
        assert refitted[name] == pytest.approx(bound)
    repaired = ParameterFile.read(tmp_path / "repaired.yaml")
    assert (repaired.effects, repaired.settings["readings"]) == ([], dict([option.split("=")]))
    assert (
        command("compare", tmp_path / "trials.yaml", "--params", tmp_path / "repaired.yaml", "-o", out).status
        == 0
    )
    assert ComparisonFile.read(out).channels["yaw_rad"].rmse == pytest.approx(noise["yaw_rad"], rel=0.2)


@pytest.mark.slow
def test_drag_on_strips_is_found_as_another_reading(tmp_path: Path) -> None:
    spread = swim_effects.spread_drag(np.random.default_rng(5), 1.0, "tfish")
    gap_trials.write(tmp_path, "tfish", [spread])
    file = diagnosed(tmp_path)
    assert file.verdict == "explained"
    assert held_responsible(file) == [{"reading:drag_point=strips"}]
    assert file.causes[0].parameters == {}
    closed = file.causes[0].shrinkage[0].closed
    assert closed is not None
    assert closed > 0.7


@pytest.mark.slow
def test_a_current_is_not_reported_as_a_reading(tmp_path: Path) -> None:
    current = swim_effects.current(np.random.default_rng(5), 2.0, "tfish")
    gap_trials.write(tmp_path, "tfish", [current])
    file = diagnosed(tmp_path)
    assert file.causes[0].effect == "current"
    assert not any(name.startswith("reading:") for names in held_responsible(file) for name in names)
