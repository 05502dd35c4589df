"""What a robot's file leaves open, answered otherwise: hypotheses of a diagnosis."""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from swimid.diagnosis.words import READING
from swimid.effects.base import STAGES, Effect, Stage
from swimid.errors import InputError, UsageError, suggestion
from swimid.fitting.experiment import Experiment
from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.robots.file import RobotFile
from swimid.swimmer.model import Swimmer

#: Readings whose simulations differ by no more than this share of a channel's range differ in nothing.
ALIKE = 1e-9
#: The coefficients are compared this many typical sizes away from where they start: one at zero hides much.
AWAY = 0.1
#: What a place of the robot file belongs to by the words in it, along the chain; other places are structure.
PLACES: tuple[tuple[str, Stage], ...] = (
    (".driven", "actuation"),
    (".elements.", "fluid"),
    (".coefficients.", "fluid"),
    ("fluid.", "fluid"),
    (".reference", "sensing"),
    (".markers.", "sensing"),
)
#: Places of which the trials were made when they were read.
COMMANDS = (".strokes.",)


class Reread:
    """The models of a robot file in its several readings .

    Parameters
    ----------
    path : Path
        Of the robot file.
    nominal : Swimmer
        The model of the robot as it is read.
    """

    def __init__(self, path: Path, nominal: Swimmer) -> None:
        self._file, self._nominal = RobotFile(path), nominal
        self._models: dict[tuple[float, frozenset[tuple[str, str]]], Swimmer] = {}
        self._lock = threading.Lock()

    def model(self, model: Model, question: str, option: str) -> Model:
        """The model of the robot with one question answered so, and all others as in a model."""
        assert model.swimmer is not None
        chosen = {key: reading.chosen for key, reading in model.swimmer.robot.readings.items()}
        key = model.swimmer.max_step, frozenset({**chosen, question: option}.items())
        with self._lock:
            if key not in self._models:
                robot = self._file.read(dict(key[1]))
                self._models[key] = model.swimmer.read_otherwise(robot)
            return self._models[key]

    def stand(self, answers: Mapping[str, str]) -> bool:
        """Whether some answers can be had together."""
        model: Model = self._nominal
        try:
            for question, option in answers.items():
                model = self.model(model, question, option)
        except InputError:
            return False
        return _comparable(model, self._nominal)


class OtherReading(Effect):
    """A question that a robot's source leaves open, answered otherwise than the robot file does.

    The robot read so takes the place of the nominal one, and other effects act on it.

    Parameters
    ----------
    question, option : str
        Names of the reading and of its option in the robot file.
    meaning : str
        The question and this answer, in words.
    stage : str
        Where in the chain the robots differ.
    reread : Reread
        The models of the robot in its several readings.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    meaning: ClassVar[str]
    needs: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, question: str, option: str, *, meaning: str, stage: Stage, reread: Reread) -> None:
        # every robot file has its own: what of other effects belongs to the class belongs to each of these
        vars(self).update(name=f"{READING}{question}={option}", stage=stage, meaning=meaning)
        self.question, self.option = question, option
        self._reread = reread

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """None: it holds or it does not."""
        return ()

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Nothing acts on the chain; the robot is another."""
        return NONE

    def tries(self, parameters: Sequence[Parameter]) -> list[Array]:
        """Once, as a whole."""
        return [np.empty(0)]

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """One form."""
        return [self]

    def joins(self, effects: Sequence[Effect]) -> bool:
        """No question has two answers, and some answers leave no place for others."""
        answers = {e.question: e.option for e in effects if isinstance(e, OtherReading)}
        if self.question in answers:
            return False
        return not answers or self._reread.stand({**answers, self.question: self.option})

    def in_place_of(self, model: Model) -> Model:
        """The model of the robot read so."""
        return self._reread.model(model, self.question, self.option)

    def content(self) -> bytes:
        """Its name: it moves nothing by itself."""
        return self.name.encode()


def others(experiment: Experiment, trials: Sequence[Trial]) -> tuple[list[OtherReading], dict[str, str]]:
    """Every reading of the robot but one answer away from those chosen.

    Parameters
    ----------
    experiment : Experiment
        Its model with the parameters that are refitted.
    trials : sequence of Trial
        What they measure must depend on the answer.

    Returns
    -------
    list of OtherReading
    dict of name to reason
        Those that are no hypotheses here.
    """
    nominal, path = experiment.model.swimmer, experiment.robot_path
    if nominal is None or path is None or not experiment.robot.readings:
        return [], {}
    reread = Reread(path, nominal)
    values = _away(nominal)
    seen = [nominal.attempt(values, trial) for trial in trials]
    found, left_out = [], {}
    for key, reading in experiment.robot.readings.items():
        for option, answer in reading.options.items():
            if option == reading.chosen:
                continue
            places = [*reading.options[reading.chosen].set, *answer.set]
            question, says = reading.question.rstrip("."), answer.says.rstrip(".")
            other = OtherReading(
                key,
                option,
                meaning=f'Another answer to "{question}": {says}.',
                stage=_stage(places),
                reread=reread,
            )
            if any(word in place for word in COMMANDS for place in places):
                left_out[other.name] = "the trials tell the robot what it changes: choose it by --reading"
            elif not reread.stand({key: option}):
                left_out[other.name] = "its coefficients or channels are not those of the reading chosen"
            elif _alike(other.in_place_of(nominal), values, trials, seen):
                left_out[other.name] = "it changes nothing that was measured in these trials"
            else:
                found.append(other)
    return found, left_out


def asked(names: Collection[str], experiment: Experiment) -> tuple[list[str], set[str]]:
    """Names of effects to try, apart from those of readings.

    Raises
    ------
    UsageError
        For a reading, or an answer, that the robot file does not have.
    """
    robot = experiment.robot
    known = [f"{READING}{key}={option}" for key, r in robot.readings.items() for option in r.options]
    chosen = [f"{READING}{key}={r.chosen}" for key, r in robot.readings.items()]
    mine = [name for name in names if name.startswith(READING)]
    for name in mine:
        if name not in known:
            raise UsageError(f"the robot '{robot.name}' has no {name}", hint=suggestion(name, known))
        if name in chosen:
            raise UsageError(f"the robot '{robot.name}' is read so already: {name}")
    return [name for name in names if name not in mine], set(mine)


def _stage(places: Sequence[str]) -> Stage:
    """The part of the chain that a reading is about, of several the first."""
    stages: list[Stage] = [
        next((stage for word, stage in PLACES if word in place), "structure") for place in places
    ]
    return min(stages, key=STAGES.index, default="structure")


def _comparable(model: Model, nominal: Model) -> bool:
    """Whether two models have the same parameters and channels."""
    names = [[p.name for p in m.parameters] + [c.name for c in m.channels] for m in (model, nominal)]
    return names[0] == names[1]


def _away(model: Model) -> Array:
    """Values of the parameters a little away from where they start, within bounds."""
    return np.array(
        [
            p.start if p.per_trial else float(np.clip(p.start + AWAY * p.scale, p.lower, p.upper))
            for p in model.parameters
        ]
    )


def _alike(other: Model, values: Array, trials: Sequence[Trial], seen: Sequence[Mapping[str, Array]]) -> bool:
    """Whether another model simulates the same in all that was measured."""
    for trial, plain in zip(trials, seen, strict=True):
        found = other.attempt(values, trial)
        for channel in trial.measured:
            span = float(np.ptp(plain[channel]))
            # one that breaks down differs
            if not np.max(np.abs(found[channel] - plain[channel]), initial=0.0) <= ALIKE * span:
                return False
    return True
