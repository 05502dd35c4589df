"""A model with effects: the same interface, more parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from swimid.effects.base import Effect
from swimid.fitting import hooks as hook_places
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Trial, unless_broken


class Affected(Model):
    """A model on which effects act.

    Its parameters are the model's, then those of each effect as ``effect/parameter``; with all of
    the latter at their start values it is the model, or what an effect has put in its place
    (:meth:`Effect.in_place_of`).

    Parameters
    ----------
    model : Model
    effects : sequence of Effect
    trials : sequence of Trial
        From which the effects take their scales.
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
        at, self._added = len(model.parameters), []
        for effect, parameters in zip(self.effects, self.own, strict=True):
            if effect.adds_to is not None:
                self._added.append((model.index(effect.adds_to), at))
            at += len(parameters)
        self.parameters = (
            *model.parameters,
            *(
                replace(p, name=f"{effect.name}/{p.name}")
                for effect, parameters in zip(self.effects, self.own, strict=True)
                for p in parameters
            ),
        )

    def hooks(self, values: Array, trial: Trial) -> Hooks:
        """What acts at these values, for one trial."""
        at = len(self.model.parameters)
        point = values[at:].tobytes()
        known = self._latest.get(trial.id)
        if known is not None and known[0] is trial and known[1] == point:
            return known[2]
        hooks = hook_places.NONE
        for effect, null, content in zip(self.effects, self._null, self._contents, strict=True):
            own = values[at : at + len(null)]
            at += len(null)
            if effect.adds_to is not None or np.array_equal(own, null):
                continue
            acting = effect.hooks(own, trial, self.model)
            key = content + own.tobytes() if acting.moves else b""
            acting = replace(acting, key=key, command_key=key if acting.command else b"")
            hooks = acting if hooks is hook_places.NONE else hooks + acting
        # else made for each run: an effect may keep in them what it reads off the run's tables
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
        if hooks is hook_places.NONE:
            return self.model.simulate(own, trial)
        return self.model.hooked(own, trial, hooks)

    @property
    def together(self) -> int:
        """As of the model without effects."""
        return self.model.together

    def simulate_many(self, runs: Sequence[tuple[Array, Trial]]) -> list[dict[str, Array]]:
        """Simulate several runs (see :meth:`Model.simulate_many`)."""
        acting = unless_broken(self.hooks, runs)
        asked = zip(runs, acting, strict=True)
        simulated = iter(
            self.model.hooked_many(
                [(self.shifted(values), trial, h) for (values, trial), h in asked if h is not None]
            )
        )
        return [
            self.broken_down(trial) if h is None else next(simulated)
            for (_, trial), h in zip(runs, acting, strict=True)
        ]

    def refined(self) -> Affected | None:
        """The same with half the integration step."""
        finer = self.nominal.refined()
        return None if finer is None else Affected(finer, self.effects, self._trials)
