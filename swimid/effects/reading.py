"""Another reading of what the source of a robot leaves open: a hypothesis like an effect, without numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Protocol

import numpy as np

from swimid.effects.base import Effect, Stage
from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

#: What the names of readings begin with; the rest is as the option ``--reading`` takes it.
PREFIX = "reading:"


class Readings(Protocol):
    """What a robot's file leaves open."""

    def model(self, model: Model, question: str, option: str) -> Model:
        """The model of the robot with one question answered so, and all others as in a model."""

    def stand(self, answers: Mapping[str, str]) -> bool:
        """Whether some answers can be had together."""


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
    readings : Readings
        Which reads the robot.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    meaning: ClassVar[str]
    needs: ClassVar[frozenset[str]] = frozenset()

    def __init__(
        self,
        question: str,
        option: str,
        *,
        meaning: str,
        stage: Stage,
        readings: Readings,
    ) -> None:
        # every robot file has its own: what of other effects belongs to the class belongs to each of these
        vars(self).update(name=f"{PREFIX}{question}={option}", stage=stage, meaning=meaning)
        self.question, self.option = question, option
        self._readings = readings

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
        return not answers or self._readings.stand({**answers, self.question: self.option})

    def in_place_of(self, model: Model) -> Model:
        """The model of the robot read so."""
        return self._readings.model(model, self.question, self.option)

    def content(self) -> bytes:
        """Its name: it moves nothing by itself."""
        return self.name.encode()
