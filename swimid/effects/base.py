"""The base class of effects, and a model on which effects act.

An effect has a name, parameters without influence at their start values, and hooks. Hooks are functions that
change a simulation (:class:`~swimid.fitting.model.Hooks`). The ``stage`` of an effect is the part of the
simulated system on which the effect acts.
"""

from __future__ import annotations

import itertools
import pickle
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np

from swimid.fitting.model import NONE, Array, Hooks, Model, Parameter, Trial, unless_broken

Stage = Literal["actuation", "structure", "fluid", "environment", "sensing", "rig"]
STAGES: tuple[Stage, ...] = ("actuation", "structure", "fluid", "environment", "sensing", "rig")
Trials = Sequence[Trial]
Parameters = tuple[Parameter, ...]
#: For each parameter name, the bound from which an estimate must keep a distance.
Inside = Mapping[str, Literal["lower", "upper"]]
#: Sizes at which an effect is tried, in the scales of its parameters.
SIZES = (0.5, 1.2, 3.0)

#: Effects whose attributes cannot be compared. They are kept, so that no other object gets the same id.
_KEPT: dict[int, Effect] = {}


class Effect(ABC):
    """A cause of differences between model and trials that the model may lack.

    Attributes
    ----------
    name : str
        Name in the gap file, with hyphens.
    stage : str
        Part of the simulated system on which the effect acts. For an effect of this package it is the name of
        the module.
    meaning : str
        One sentence for the report.
    sources : tuple of str
        Papers and sections that describe the effect.
    needs : frozenset of str
        Hooks that the effect uses. The effect applies to models that offer at least one of them.
    scatters : bool
        Whether the effect may differ at random between trials (a trim, a clock). It is then a random effect
        as well.
    smooth : bool
        Whether the change of the simulation is nearly proportional to the parameters. One size is then enough
        to try the effect.
    inside : mapping of name to end
        Bounds, ``lower`` or ``upper``, from which an estimate must keep at least the parameter's scale.
        Closer to the bound the effect could imitate others, and is not accepted as a hypothesis.
    adds_to : str or None
        Name of the model parameter to which the only parameter of the effect is added. Such an effect has no
        hooks.
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
        """Return the parameters of the effect: no influence at ``start``, typical scale ``scale``."""

    @abstractmethod
    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hooks for one trial at these parameter values.

        Parameters
        ----------
        values : ndarray, shape (len(parameters),)
            Values of the effect's parameters. A per-trial parameter has the value of this trial.
        """

    def applies(self, model: Model, trials: Sequence[Trial]) -> bool:
        """Return whether the effect can act on a model in these trials."""
        return bool(self.needs & model.offers)

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Return the forms in which the effect is tried (which joint, which wall); none if the effect does
        not apply.
        """
        return [self] if self.applies(model, trials) else []

    def joins(self, effects: Sequence[Effect]) -> bool:
        """Return whether the effect may act together with other effects. No effect acts twice."""
        return self.name not in {e.name for e in effects}

    def in_place_of(self, model: Model) -> Model:
        """Return the model on which all effects act: the given model, unless the effect replaces it."""
        return model

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the points within the bounds at which the effect is tried before a fit.

        For a smooth effect these are a small and a large size of each parameter. The small size has one sign
        only.
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
        """Return the identity of the effect. Effects of one class with equal attributes have the same
        identity.
        """
        kind = type(self)
        try:
            return pickle.dumps((kind.__module__, kind.__qualname__, sorted(vars(self).items())))
        except (pickle.PicklingError, AttributeError, TypeError):
            # An effect that contains a function is identical only to itself.
            _KEPT[id(self)] = self
            return f"{kind.__qualname__} {id(self)}".encode()

    def __repr__(self) -> str:
        return f"<effect {self.name}>"


#: Forms in which an effect is tried.
Effects = Sequence[Effect]


class Affected(Model):
    """A model on which effects act.

    The parameters are those of the model, followed by those of each effect as ``effect/parameter``. With the
    effect parameters at their start values, the simulation is that of the model. An effect may replace this
    model by another one (:meth:`Effect.in_place_of`).

    Parameters
    ----------
    model : Model
    effects : sequence of Effect
    trials : sequence of Trial
        Trials from which the effects take the scales of their parameters.
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
        """Return the hooks of all effects for one trial at these parameter values."""
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
        # Hooks that change model coefficients may store the values that they read. They are created anew for
        # each run.
        if not (hooks.tables or hooks.coefficients):
            self._latest[trial.id] = trial, point, hooks
        return hooks

    def shifted(self, values: Array) -> Array:
        """Return the model parameters after the additions by effects, limited to the bounds.

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
        """Return the number of runs that the model simulates in the time of one run."""
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
        """Return the model and its effects with half the integration step; None if the model integrates
        nothing.
        """
        finer = self.nominal.refined()
        return None if finer is None else Affected(finer, self.effects, self._trials)
