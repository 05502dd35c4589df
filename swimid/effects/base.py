"""Effects, and a model with effects.

An effect has a name, a stage, parameters that have no influence at their start values, and hooks.
"""

from __future__ import annotations

import itertools
import pickle
import weakref
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np

from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial, unless_broken

Stage = Literal["actuation", "structure", "fluid", "environment", "sensing", "rig"]
STAGES: tuple[Stage, ...] = ("actuation", "structure", "fluid", "environment", "sensing", "rig")
Trials = Sequence[Trial]
Parameters = tuple[Parameter, ...]
#: Bounds, by parameter name, that an estimate must not come near.
Inside = Mapping[str, Literal["lower", "upper"]]
#: Sizes at which an effect is tried, in the scales of its parameters.
SIZES = (0.5, 1.2, 3.0)

#: Numbers that identify effects with attributes that cannot be compared.
_NUMBERS: weakref.WeakKeyDictionary[Effect, int] = weakref.WeakKeyDictionary()
_COUNT = itertools.count()


class Effect(ABC):
    """A cause of differences between model and trials that the model may lack.

    Attributes
    ----------
    name : str
        Name in the gap file, with hyphens.
    stage : str
        Stage of the simulation at which it acts; for an effect of this package, the name of its module.
    meaning : str
        One sentence for the report.
    sources : tuple of str
        Papers and sections that describe it.
    needs : frozenset of str
        Hooks it uses. It applies to models that offer at least one of them.
    scatters : bool
        It may differ at random between trials (a trim, a clock), and is then a random effect.
    smooth : bool
        Its influence grows in proportion to its parameters, so that one size is enough to try it.
    inside : mapping of name to end
        Bounds, ``lower`` or ``upper``, from which an estimate must keep its typical size. Nearer to them the
        effect could imitate others, and is no hypothesis.
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
        """Return its parameters: without influence at ``start``, typically as large as ``scale``."""

    @abstractmethod
    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hooks at these parameter values, for one trial.

        Parameters
        ----------
        values : ndarray, shape (len(parameters),)
            Per-trial parameters have the value of this trial.
        """

    def applies(self, model: Model, trials: Sequence[Trial]) -> bool:
        """Whether it can act on a model in these trials."""
        return bool(self.needs & model.offers)

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Return the forms in which it is tried (which joint, which wall); none if it does not apply."""
        return [self] if self.applies(model, trials) else []

    def joins(self, effects: Sequence[Effect]) -> bool:
        """Whether it may act beside others; no effect acts twice."""
        return self.name not in {e.name for e in effects}

    def in_place_of(self, model: Model) -> Model:
        """Return the model on which all effects act: as a rule the nominal one."""
        return model

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return points within the bounds at which it is tried before a fit.

        For a smooth effect these are a small and a large size of each parameter, the small one of one sign.
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
        """Return its identity: effects of one class with the same attributes act alike."""
        kind = type(self)
        try:
            return pickle.dumps((kind.__module__, kind.__qualname__, sorted(vars(self).items())))
        except (pickle.PicklingError, AttributeError, TypeError):
            # an effect that holds a function is identical only to itself
            if self not in _NUMBERS:
                _NUMBERS[self] = next(_COUNT)
            return f"{kind.__qualname__} {_NUMBERS[self]}".encode()

    def __repr__(self) -> str:
        return f"<effect {self.name}>"


#: Forms in which an effect is tried.
Effects = Sequence[Effect]


class Affected(Model):
    """A model on which effects act.

    Its parameters are those of the model, then those of each effect as ``effect/parameter``. With the latter
    at their start values it is the model, or the one that an effect puts in its place
    (:meth:`Effect.in_place_of`).

    Parameters
    ----------
    model : Model
    effects : sequence of Effect
    trials : sequence of Trial
        The effects take their scales from them.
    """

    def __init__(self, model: Model, effects: Sequence[Effect], trials: Sequence[Trial]) -> None:
        self.nominal = self.model = model
        self.effects = tuple(effects)
        for effect in self.effects:
            self.model = effect.in_place_of(self.model)
        self.name = model.name
        self.channels = model.channels
        self.abscissa = model.abscissa
        self.offers = model.offers
        self._trials = tuple(trials)
        self.own = [effect.parameters(model, trials) for effect in self.effects]
        self._contents = [effect.content() for effect in self.effects]
        self._null = [np.array([p.start for p in parameters]) for parameters in self.own]
        self._latest: dict[str, tuple[Trial, bytes, Hooks]] = {}
        renamed: list[Parameter] = []
        self._added = []
        for effect, parameters in zip(self.effects, self.own, strict=True):
            if effect.adds_to is not None:
                self._added.append((model.index(effect.adds_to), len(model.parameters) + len(renamed)))
            renamed += [replace(p, name=f"{effect.name}/{p.name}") for p in parameters]
        self.parameters = (*model.parameters, *renamed)

    def hooks(self, values: Array, trial: Trial) -> Hooks:
        """Return the hooks of all effects at these values, for one trial."""
        at = len(self.model.parameters)
        point = values[at:].tobytes()
        known = self._latest.get(trial.id)
        if known is not None and known[0] is trial and known[1] == point:
            return known[2]
        hooks = NONE
        for effect, null, content in zip(self.effects, self._null, self._contents, strict=True):
            own = values[at : at + len(null)]
            at += len(null)
            if effect.adds_to is not None or np.array_equal(own, null):
                continue
            acting = effect.hooks(own, trial, self.model)
            if acting.moves:
                key = content + own.tobytes()
                acting = replace(acting, key=key, command_key=key if acting.command else b"")
            hooks = acting if hooks is NONE else hooks + acting
        # hooks of tables and coefficients may store what they read, and are made anew for each run
        if not (hooks.tables or hooks.coefficients):
            self._latest[trial.id] = trial, point, hooks
        return hooks

    def shifted(self, values: Array) -> Array:
        """Return the parameters of the model with the changes that effects add to them, within bounds.

        Parameters
        ----------
        values : ndarray, shape (len(parameters),)

        Returns
        -------
        ndarray, shape (len(model.parameters),)
        """
        own = values[: len(self.model.parameters)].copy()
        for index, at in self._added:
            p = self.model.parameters[index]
            own[index] = np.clip(own[index] + values[at], p.lower, p.upper)
        return own

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Simulate one trial (see :meth:`Model.simulate`)."""
        own = self.shifted(values)
        hooks = self.hooks(values, trial)
        if hooks is NONE:
            return self.model.simulate(own, trial)
        return self.model.hooked(own, trial, hooks)

    @property
    def together(self) -> int:
        """Number of runs that the model simulates in the time of one."""
        return self.model.together

    def simulate_many(self, runs: Sequence[tuple[Array, Trial]]) -> list[dict[str, Array]]:
        """Simulate several runs (see :meth:`Model.simulate_many`)."""
        hooks = unless_broken(self.hooks, runs)
        asked = zip(runs, hooks, strict=True)
        sound = [(self.shifted(values), trial, h) for (values, trial), h in asked if h is not None]
        simulated = iter(self.model.hooked_many(sound))
        return [
            self.broken_down(trial) if h is None else next(simulated)
            for (_, trial), h in zip(runs, hooks, strict=True)
        ]

    def refined(self) -> Affected | None:
        """Return the same with half the integration step; None if nothing is integrated."""
        finer = self.nominal.refined()
        return None if finer is None else Affected(finer, self.effects, self._trials)
