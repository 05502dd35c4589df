"""A model some of whose parameters share one value."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.errors import UsageError, suggestion
from swimid.fitting.body import Body
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Entry, Model, Parameter, Trial
from swimid.fitting.swimmer import Swimmer
from swimid.progress import Progress, silent


class Tied(Model):
    """A model in which each group of parameters is replaced by one they share.

    The shared parameter stands where the group's first member stood. It starts at the
    members' mean, its bounds are what all members' bounds allow, its scale is the largest.

    Parameters
    ----------
    model : Model
    groups : mapping of name to sequence of str
        The shared parameter's name, and the members it stands for.

    Raises
    ------
    UsageError
        For an unknown member, one in two groups, a group of one, a name already taken, and
        members of different unit or with no common value.
    """

    def __init__(self, model: Model, groups: Mapping[str, Sequence[str]]) -> None:
        self.model = model
        self.groups = {name: tuple(members) for name, members in groups.items()}
        self.name = model.name
        self.channels = model.channels
        self.abscissa = model.abscissa
        owner: dict[str, str] = {}
        for name, members in self.groups.items():
            if len(members) < 2:
                raise UsageError(f"{name} needs at least two parameters to be shared by")
            for member in members:
                model.index(member)
                if member in owner:
                    raise UsageError(f"{member} is shared twice: as {owner[member]} and as {name}")
                owner[member] = name
        parameters: list[Parameter] = []
        places: dict[str, int] = {}
        for parameter in model.parameters:
            name = owner.get(parameter.name, parameter.name)
            if parameter.name not in owner and name in self.groups:
                raise UsageError(f"the name {name} is taken by a parameter that does not share it")
            if name not in places:
                places[name] = len(parameters)
                parameters.append(self._shared(name) if name in self.groups else parameter)
        self.parameters = tuple(parameters)
        self._places = np.array([places[owner.get(p.name, p.name)] for p in model.parameters], dtype=int)

    @property
    def body(self) -> Body | None:
        """The links of the untied model."""
        return self.model.body

    @property
    def swimmer(self) -> Swimmer | None:
        """The untied model where it is a robot with links."""
        return self.model.swimmer

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Simulate with every member at its group's value (see :meth:`Model.simulate`)."""
        return self.model.simulate(self.members(values), trial)

    @property
    def together(self) -> int:
        """As of the untied model."""
        return self.model.together

    def hooked_many(self, runs: Sequence[tuple[Array, Trial, Hooks]]) -> list[dict[str, Array]]:
        """Several runs (see :meth:`Model.hooked_many`)."""
        return self.model.hooked_many([(self.members(values), trial, hooks) for values, trial, hooks in runs])

    def prepare(self, progress: Progress = silent, **how: Any) -> None:
        """As the untied model (see :meth:`Model.prepare`)."""
        self.model.prepare(progress, **how)

    def sensitivity_to_time(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Rate of change of each channel (see :meth:`Model.sensitivity_to_time`)."""
        return self.model.sensitivity_to_time(self.members(values), trial)

    def refined(self) -> Tied | None:
        """The same with half the integration step; None where nothing is integrated."""
        finer = self.model.refined()
        return None if finer is None else Tied(finer, self.groups)

    def members(self, values: Array) -> Array:
        """Values of the untied model's parameters, shape (len(self.model.parameters),)."""
        return np.asarray(values, dtype=float)[self._places]

    def expanded(self, entries: Mapping[str, Entry]) -> dict[str, Entry]:
        """What is known of each parameter, by the names of the untied model.

        A shared one is repeated for every member; its standard error is each member's, all of them fully
        correlated.
        """
        found: dict[str, Entry] = {}
        for label, entry in entries.items():
            name, bracket, rest = label.partition("[")
            for member in self.groups.get(name, (name,)):
                found[member + bracket + rest] = entry
        return found

    def _shared(self, name: str) -> Parameter:
        members = [self.model.parameters[self.model.index(m)] for m in self.groups[name]]
        first = members[0]
        for other in members[1:]:
            if (other.unit, other.per_trial) != (first.unit, first.per_trial):
                raise UsageError(
                    f"{first.name} ({first.unit}) and {other.name} ({other.unit}) cannot share a value"
                )
        lower, upper = max(m.lower for m in members), min(m.upper for m in members)
        if lower > upper:
            raise UsageError(f"no value lies within the bounds of all of {', '.join(self.groups[name])}")
        start = float(np.clip(np.mean([m.start for m in members]), lower, upper))
        return replace(
            first,
            name=name,
            lower=lower,
            upper=upper,
            start=start,
            scale=max(m.scale for m in members),
            free=any(m.free for m in members),
            meaning=f"one value for {', '.join(self.groups[name])}",
            source="",
        )


def groups_by_prefix(model: Model, prefix: str) -> dict[str, tuple[str, ...]]:
    """The group of all parameters whose name is the prefix followed by digits.

    Raises
    ------
    UsageError
        With the nearest prefix, when fewer than two parameters have it.
    """
    members = tuple(p.name for p in model.parameters if re.fullmatch(re.escape(prefix) + r"\d+", p.name))
    if len(members) < 2:
        stems = [re.sub(r"\d+$", "", p.name) for p in model.parameters if re.search(r"\d+$", p.name)]
        several = sorted({s for s in stems if stems.count(s) > 1})
        hint = suggestion(prefix, several)
        raise UsageError(f"the model {model.name} has no parameters to share as '{prefix}'", hint=hint)
    return {prefix: members}
