"""Test other interpretations of a robot's source (``--reading``) as hypotheses of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from swimid.diagnosis.gap_file import READING
from swimid.effects.base import STAGES, Effect, Stage
from swimid.errors import InputError
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import NONE, Array, Hooks, Model, Parameter, Trial
from swimid.robots.file import RobotFile

if TYPE_CHECKING:
    from swimid.swimmer.model import Swimmer

#: Difference between two simulations, divided by the range of the channel, below which two interpretations of
#: the robot's source are equivalent.
SAME_SIMULATION_RTOL = 1e-9
#: Offset of the coefficients from their initial values, in typical scales, when two interpretations of the
#: robot are compared. Without this offset, coefficients that start at zero would hide differences.
COEFFICIENT_SHIFT = 0.1
#: Pairs of a text and a stage (part of the simulated system). An entry of the robot file belongs to the stage
#: if the path of the entry contains the text. All other entries belong to the stage "structure".
ENTRY_STAGES: tuple[tuple[str, Stage], ...] = (
    (".driven", "actuation"),
    (".actuators.", "actuation"),
    (".elements.", "fluid"),
    (".coefficients.", "fluid"),
    ("fluid.", "fluid"),
    (".reference", "sensing"),
    (".markers.", "sensing"),
)
#: Texts in the paths of those entries of the robot file that are already part of the loaded trials. An answer
#: that changes such an entry cannot be tested.
COMMANDS = (".strokes.",)


class Reread:
    """Cache of the models of a robot file for all interpretations of its source.

    Parameters
    ----------
    path : Path
        Robot file.
    nominal : Swimmer
        Model of the robot with the chosen interpretation.
    """

    def __init__(self, path: Path, nominal: Swimmer) -> None:
        self._file, self._nominal = RobotFile(path), nominal
        self._models: dict[tuple[float, frozenset[tuple[str, str]]], Swimmer] = {}

    def model(self, model: Model, question: str, option: str) -> Model:
        """Return the model of the robot if one question about its source has another answer."""
        assert model.swimmer is not None
        chosen = {key: reading.chosen for key, reading in model.swimmer.robot.readings.items()}
        key = model.swimmer.max_step, frozenset({**chosen, question: option}.items())
        if key not in self._models:
            self._models[key] = model.swimmer.read_otherwise(self._file.read(dict(key[1])))
        return self._models[key]

    def stand(self, answers: Mapping[str, str]) -> bool:
        """Return whether the answers can be combined into a model that is comparable with the nominal one.

        A comparable model has the same parameters and channels. The answers belong to questions about the
        robot's source.
        """
        model: Model = self._nominal
        try:
            for question, option in answers.items():
                model = self.model(model, question, option)
        except InputError:
            return False

        def list_names(m: Model) -> list[str]:
            return [p.name for p in m.parameters] + [c.name for c in m.channels]

        return list_names(model) == list_names(self._nominal)


class OtherReading(Effect):
    """Other interpretation of a robot's source: one question gets another answer than in the robot file.

    The robot with this answer replaces the nominal robot, and other effects act on the replacement.

    Parameters
    ----------
    question, option : str
        Names of the question and of the answer in the robot file.
    meaning : str
        The question and this answer, in words.
    stage : str
        Part of the simulated system in which the two robots differ.
    reread : Reread
        The models of the robot for all interpretations of its source.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    meaning: ClassVar[str]

    def __init__(self, question: str, option: str, *, meaning: str, stage: Stage, reread: Reread) -> None:
        # Set name, stage and meaning on the instance. Other effects have them on the class, but the questions
        # differ between robot files.
        vars(self).update(name=f"{READING}{question}={option}", stage=stage, meaning=meaning)
        self.question, self.option = question, option
        self._reread = reread

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return no parameters, because another interpretation of the robot has none."""
        return ()

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return no hooks, because the robot itself is replaced."""
        return NONE

    def tries(self, parameters: Sequence[Parameter]) -> list[Array]:
        """Return one empty parameter vector, because the effect has no parameters."""
        return [np.empty(0)]

    def joins(self, effects: Sequence[Effect]) -> bool:
        """Return whether this interpretation of the robot can be combined with the given effects.

        Two answers to the same question cannot be combined.
        """
        answers = {e.question: e.option for e in effects if isinstance(e, OtherReading)}
        if self.question in answers:
            return False
        return not answers or self._reread.stand({**answers, self.question: self.option})

    def in_place_of(self, model: Model) -> Model:
        """Return the model of the robot with the answer ``option``, which replaces the nominal model."""
        return self._reread.model(model, self.question, self.option)

    def content(self) -> bytes:
        """Return the name of the effect as bytes. The name identifies the effect."""
        return self.name.encode()


def list_readings(
    experiment: Experiment, trials: Sequence[Trial]
) -> tuple[list[OtherReading], dict[str, str]]:
    """Return every interpretation of the robot that differs from the chosen one by a single answer.

    Parameters
    ----------
    experiment : Experiment
        Experiment whose model has the refitted parameters.
    trials : sequence of Trial
        Trials whose measured channels must depend on the answer.

    Returns
    -------
    list of OtherReading
    dict of name to reason
        Interpretations that cannot be tested as hypotheses.
    """
    nominal, path = experiment.model.swimmer, experiment.robot_path
    if nominal is None or path is None or not experiment.robot.readings:
        return [], {}
    reread = Reread(path, nominal)
    values = _shift_values(nominal)
    seen = [nominal.run(values, trial) for trial in trials]
    found, left_out = [], {}
    for key, reading in experiment.robot.readings.items():
        for option, answer in reading.options.items():
            if option == reading.chosen:
                continue
            places = [*reading.options[reading.chosen].set, *answer.set]
            meaning = f'Another answer to "{reading.question.rstrip(".")}": {answer.says.rstrip(".")}.'
            other = OtherReading(key, option, meaning=meaning, stage=_stage(places), reread=reread)
            if any(word in place for word in COMMANDS for place in places):
                left_out[other.name] = "the reading changes commands of the trials: choose it by --reading"
            elif not reread.stand({key: option}):
                left_out[other.name] = "the reading has other coefficients or channels than the model"
            elif _is_same(other.in_place_of(nominal), values, trials, seen):
                left_out[other.name] = "the reading changes no channel that was measured in these trials"
            else:
                found.append(other)
    return found, left_out


def list_names(experiment: Experiment) -> list[str]:
    """Return the names of all interpretations of the robot except the chosen ones."""
    questions = experiment.robot.readings.items()
    return [f"{READING}{key}={option}" for key, r in questions for option in r.options if option != r.chosen]


def _stage(places: Sequence[str]) -> Stage:
    """Return the part of the simulated system (stage) that the given entries of the robot file concern.

    If there are several stages, the first one is returned.
    """
    stages: list[Stage] = [
        next((stage for word, stage in ENTRY_STAGES if word in place), "structure") for place in places
    ]
    return min(stages, key=STAGES.index, default="structure")


def _shift_values(model: Model) -> Array:
    """Return values of the model parameters slightly off their start values, within their bounds."""
    values = [p.start + COEFFICIENT_SHIFT * p.scale * (not p.per_trial) for p in model.parameters]
    return np.clip(values, [p.lower for p in model.parameters], [p.upper for p in model.parameters])


def _is_same(
    other: Model, values: Array, trials: Sequence[Trial], seen: Sequence[Mapping[str, Array]]
) -> bool:
    """Return whether another model gives the same simulation of all measured channels."""
    for trial, plain in zip(trials, seen, strict=True):
        found = other.run(values, trial)
        for channel in trial.measured:
            span = float(np.ptp(plain[channel]))
            largest = np.max(np.abs(found[channel] - plain[channel]), initial=0.0)
            # A simulation that diverges counts as different.
            if not largest <= SAME_SIMULATION_RTOL * span:
                return False
    return True
