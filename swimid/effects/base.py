"""What an effect is: a name, a stage, parameters that vanish at their start value, and hooks."""

from __future__ import annotations

import itertools
import pickle
import weakref
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

import numpy as np

from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

Stage = Literal["actuation", "structure", "fluid", "environment", "sensing", "rig"]
STAGES: tuple[Stage, ...] = ("actuation", "structure", "fluid", "environment", "sensing", "rig")
#: What an effect is given and gives.
Trials = Sequence[Trial]
Parameters = tuple[Parameter, ...]
#: Bounds that parameters must not come near.
Inside = Mapping[str, Literal["lower", "upper"]]
#: Sizes at which an effect is tried, in units of its parameters' scales.
SIZES = (0.5, 1.2, 3.0)


#: Numbers of effects that hold what cannot be compared; none is given twice.
_NUMBERS: weakref.WeakKeyDictionary[Effect, int] = weakref.WeakKeyDictionary()
_COUNT = itertools.count()


class Effect(ABC):
    """Something a model may leave out.

    Attributes
    ----------
    name : str
        In the gap file, with hyphens.
    stage : str
        Where in the chain it acts; of an effect in the module of a stage, that.
    meaning : str
        One sentence for the report.
    sources : tuple of str
        Who named it: paper and section.
    needs : frozenset of str
        Hooks it uses; it applies to models that offer at least one of them.
    scatters : bool
        Whether it may differ by chance from trial to trial (a trim, a clock): its spread between
        trials then belongs to the noise.
    smooth : bool
        Whether what it changes grows in proportion to its parameters, so that one size tells all.
    inside : mapping of name to end
        Bounds, ``lower`` or ``upper``, from which parameters must end by their typical size at least: nearer
        the effect could stand for others, and is no hypothesis.
    adds_to : str or None
        Name of the model's parameter to which its only parameter is added; it has no hooks then.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    meaning: ClassVar[str]
    sources: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[frozenset[str]]
    scatters: ClassVar[bool] = False
    smooth: ClassVar[bool] = False
    inside: ClassVar[Inside] = {}
    adds_to: ClassVar[str | None] = None

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        package, _, module = cls.__module__.rpartition(".")
        if package == "swimid.effects" and module in STAGES:
            cls.stage = module

    @abstractmethod
    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Its parameters: ``start`` is the value at which it vanishes exactly, ``scale`` a typical size."""

    @abstractmethod
    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """The hooks at these parameter values, for one trial.

        Parameters
        ----------
        values : ndarray, shape (len(parameters),)
            Per-trial parameters hold this trial's value.
        """

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """The forms in which it is tried (which joint, which wall); empty where it does not apply."""
        return [self] if self.needs & model.offers else []

    def joins(self, effects: Sequence[Effect]) -> bool:
        """Whether it may act beside others; no effect acts twice."""
        return self.name not in {e.name for e in effects}

    def in_place_of(self, model: Model) -> Model:
        """The model on which it and all others act, in place of the nominal one: that one as a rule."""
        return model

    def tries(self, parameters: Parameters) -> list[Array]:
        """Points at which it is tried before anything is fitted, within the bounds.

        Where the change is smooth, small and large ones suffice, and of the small ones one sign.
        """
        null = np.array([p.start for p in parameters])
        points: list[Array] = []
        for k, p in enumerate(parameters):
            near = 0
            for size, sign in itertools.product(SIZES[::2] if self.smooth else SIZES, (1.0, -1.0)):
                value = p.start + sign * size * p.scale
                if not p.lower <= value <= p.upper or (self.smooth and size == SIZES[0] and near):
                    continue
                near += size == SIZES[0]
                point = null.copy()
                point[k] = value
                points.append(point)
        return points

    def content(self) -> bytes:
        """What tells it from others: two of one class and with the same attributes act alike."""
        kind = type(self)
        try:
            return pickle.dumps((kind.__module__, kind.__qualname__, sorted(vars(self).items())))
        except (pickle.PicklingError, AttributeError, TypeError):
            # it holds a function of its own: like none but itself
            if self not in _NUMBERS:
                _NUMBERS[self] = next(_COUNT)
            return f"{kind.__qualname__} {_NUMBERS[self]}".encode()

    def __repr__(self) -> str:
        return f"<effect {self.name}>"


#: The forms in which an effect is tried.
Effects = Sequence[Effect]
