"""Other readings of a robot's source as hypotheses of a diagnosis."""

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

#: Relative difference over a channel's range below which simulations of two readings are equal.
ALIKE = 1e-9
#: Distance from the start values, in typical sizes, at which coefficients are compared: a zero coefficient
#: hides differences.
AWAY = 0.1
#: Stage of a place in the robot file, by the words in it; other places belong to the structure.
PLACES: tuple[tuple[str, Stage], ...] = (
    (".driven", "actuation"),
    (".elements.", "fluid"),
    (".coefficients.", "fluid"),
    ("fluid.", "fluid"),
    (".reference", "sensing"),
    (".markers.", "sensing"),
)
#: Places that the trials already contain when they are read.
COMMANDS = (".strokes.",)


class Reread:
    """The models of a robot file in its several readings.

    Parameters
    ----------
    path : Path
        Robot file.
    nominal : Swimmer
        Model of the robot as it is read.
    """

    def __init__(self, path: Path, nominal: Swimmer) -> None:
        self._file, self._nominal = RobotFile(path), nominal
        self._models: dict[tuple[float, frozenset[tuple[str, str]]], Swimmer] = {}
        self._lock = threading.Lock()

    def model(self, model: Model, question: str, option: str) -> Model:
        """Return the model with one question answered differently."""
        assert model.swimmer is not None
        chosen = {key: reading.chosen for key, reading in model.swimmer.robot.readings.items()}
        key = model.swimmer.max_step, frozenset({**chosen, question: option}.items())
        with self._lock:
            if key not in self._models:
                robot = self._file.read(dict(key[1]))
                self._models[key] = model.swimmer.read_otherwise(robot)
            return self._models[key]

    def stand(self, answers: Mapping[str, str]) -> bool:
        """Return whether some answers can be combined."""
        model: Model = self._nominal
        try:
            for question, option in answers.items():
                model = self.model(model, question, option)
        except InputError:
            return False
        return _comparable(model, self._nominal)


class OtherReading(Effect):
    """A question of a robot's source, answered differently than in the robot file.

    The robot in this reading takes the place of the nominal one, and other effects act on it.

    Parameters
    ----------
    question, option : str
        Names of the reading and of its option in the robot file.
    meaning : str
        The question and this answer, in words.
    stage : str
        Stage in which the robots differ.
    reread : Reread
        The models of the robot in its several readings.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    meaning: ClassVar[str]
    needs: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, question: str, option: str, *, meaning: str, stage: Stage, reread: Reread) -> None:
        # Class attributes of other effects are instance attributes here, because each robot file has its own
        # readings.
        vars(self).update(name=f"{READING}{question}={option}", stage=stage, meaning=meaning)
        self.question, self.option = question, option
        self._reread = reread

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return no parameters."""
        return ()

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return no hooks: the robot is another."""
        return NONE

    def tries(self, parameters: Sequence[Parameter]) -> list[Array]:
        """Return one try."""
        return [np.empty(0)]

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Return its only form."""
        return [self]

    def joins(self, effects: Sequence[Effect]) -> bool:
        """Return whether other effects can be combined with it: no question has two answers."""
        answers = {e.question: e.option for e in effects if isinstance(e, OtherReading)}
        if self.question in answers:
            return False
        return not answers or self._reread.stand({**answers, self.question: self.option})

    def in_place_of(self, model: Model) -> Model:
        """Return the model of the robot in this reading."""
        return self._reread.model(model, self.question, self.option)

    def content(self) -> bytes:
        """Return its name, which identifies it."""
        return self.name.encode()


def others(experiment: Experiment, trials: Sequence[Trial]) -> tuple[list[OtherReading], dict[str, str]]:
    """Return every reading of the robot that differs by one answer from the chosen ones.

    Parameters
    ----------
    experiment : Experiment
        Its model with the refitted parameters.
    trials : sequence of Trial
        Their measured channels must depend on the answer.

    Returns
    -------
    list of OtherReading
    dict of name to reason
        Readings that are no hypotheses here.
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
    """Return the names of requested effects, without those of readings.

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
    """Return the stage of a reading; of several the first."""
    stages: list[Stage] = [
        next((stage for word, stage in PLACES if word in place), "structure") for place in places
    ]
    return min(stages, key=STAGES.index, default="structure")


def _comparable(model: Model, nominal: Model) -> bool:
    """Return whether two models have the same parameters and channels."""
    names = [[p.name for p in m.parameters] + [c.name for c in m.channels] for m in (model, nominal)]
    return names[0] == names[1]


def _away(model: Model) -> Array:
    """Return parameter values a little away from their start, within bounds."""
    return np.array(
        [
            p.start if p.per_trial else float(np.clip(p.start + AWAY * p.scale, p.lower, p.upper))
            for p in model.parameters
        ]
    )


def _alike(other: Model, values: Array, trials: Sequence[Trial], seen: Sequence[Mapping[str, Array]]) -> bool:
    """Return whether another model simulates the same measured channels."""
    for trial, plain in zip(trials, seen, strict=True):
        found = other.attempt(values, trial)
        for channel in trial.measured:
            span = float(np.ptp(plain[channel]))
            # A simulation that diverges differs.
            if not np.max(np.abs(found[channel] - plain[channel]), initial=0.0) <= ALIKE * span:
                return False
    return True
