"""Parameters of a fit, and the values that they give to a model in each trial.

The values of the model's parameters in trial k are ``A_k theta + b`` with the unknowns theta of a fit. A
fixed parameter is an entry of b. An estimated one is an unknown that all trials share, or one unknown for
each trial. Several parameters of the model may share one unknown (:attr:`Parameter.members`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from swimid.errors import UsageError, suggestion
from swimid.fitting.model import Array, Model, Parameter, Trial

Entry = TypeVar("Entry")


class ParameterMap:
    """Map from the unknowns of a fit to the values of the model's parameters in each trial.

    Parameters
    ----------
    names : sequence of str
        Names of the parameters of the model, in its order.
    parameters : sequence of Parameter
        Parameters of the fit: those of the model, or shared ones in place of their members.
    trials : sequence of Trial

    Attributes
    ----------
    labels : list of str, length p
        One label for each unknown: the name of its parameter, or ``name[trial]`` if each trial has its own
        value.
    slots : list of (int, int or None), length p
        Index of the parameter of each unknown, and index of its trial (None if all trials share it).
    start : ndarray, shape (p,)
        Start values. Those that the log of a trial suggests are preferred to those of the parameter.
    taken : list of ndarray
        For each trial the indices of the unknowns that affect it.
    """

    def __init__(
        self, names: Sequence[str], parameters: Sequence[Parameter], trials: Sequence[Trial]
    ) -> None:
        index = {name: i for i, name in enumerate(names)}
        rows = [np.array([index[n] for n in p.members or (p.name,)], dtype=int) for p in parameters]
        self._offset = np.zeros(len(names))
        for p, own in zip(parameters, rows, strict=True):
            self._offset[own] = p.start
        unknowns: list[tuple[int, int | None, str, float]] = []
        for i, p in enumerate(parameters):
            if p.free and not p.per_trial:
                unknowns.append((i, None, p.name, p.start))
            for k, t in enumerate(trials):
                if p.free and p.per_trial and p.name not in t.held:
                    unknowns.append((i, k, f"{p.name}[{t.id}]", t.starts.get(p.name, p.start)))
        self.slots = [(i, k) for i, k, _, _ in unknowns]
        self.labels = [label for _, _, label, _ in unknowns]
        self.start = np.array([start for _, _, _, start in unknowns], dtype=float)
        self.taken: list[NDArray[np.intp]] = []
        self._entries: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
        for k in range(len(trials)):
            owned = [j for j, (_, owner) in enumerate(self.slots) if owner in (None, k)]
            places = [rows[self.slots[j][0]] for j in owned]
            sizes = [len(part) for part in places]
            self.taken.append(np.array(owned, dtype=int))
            whole = np.concatenate([np.empty(0, dtype=int), *places])
            self._entries.append((whole, np.repeat(self.taken[k], sizes)))

    def values(self, theta: Array, trial: int) -> Array:
        """Return the values of the model's parameters in one trial."""
        values = self._offset.copy()
        rows, unknowns = self._entries[trial]
        values[rows] = theta[unknowns]
        return values


def share(parameters: Sequence[Parameter], groups: Mapping[str, Sequence[str]]) -> tuple[Parameter, ...]:
    """Return parameters in which each group is replaced by one shared parameter.

    The shared parameter has the index of the first member of its group. Its start value is the mean of the
    members' start values. Its bounds are the intersection of the members' bounds. Its scale is the largest
    scale of the members.

    Parameters
    ----------
    groups : mapping of name to sequence of str
        Name of each shared parameter, and the names of its members.

    Raises
    ------
    UsageError
        If a member is unknown or belongs to two groups, if the name is already used, or if members differ in
        unit or have no common value within their bounds.
    """
    known = {p.name: p for p in parameters}
    owner: dict[str, str] = {}
    for name, members in groups.items():
        for member in members:
            if member not in known:
                raise UsageError(f"there is no parameter '{member}'", hint=suggestion(member, list(known)))
            if member in owner:
                raise UsageError(f"{member} is shared twice: as {owner[member]} and as {name}")
            owner[member] = name
        if name in known and name not in members:
            raise UsageError(f"the name {name} is taken by a parameter that does not share it")
    found: dict[str, Parameter] = {}
    for p in parameters:
        name = owner.get(p.name, p.name)
        if name not in found:
            found[name] = _shared(name, [known[m] for m in groups[name]]) if p.name in owner else p
    return tuple(found.values())


def _shared(name: str, members: Sequence[Parameter]) -> Parameter:
    """Return the parameter that its members share."""
    first = members[0]
    for other in members[1:]:
        if (other.unit, other.per_trial) != (first.unit, first.per_trial):
            both = f"{first.name} ({first.unit}) and {other.name} ({other.unit})"
            raise UsageError(f"{both} cannot share a value")
    names = tuple(m.name for m in members)
    lower, upper = max(m.lower for m in members), min(m.upper for m in members)
    if lower > upper:
        raise UsageError(f"no value lies within the bounds of all of {', '.join(names)}")
    return replace(
        first,
        name=name,
        lower=lower,
        upper=upper,
        start=float(np.clip(np.mean([m.start for m in members]), lower, upper)),
        scale=max(m.scale for m in members),
        free=any(m.free for m in members),
        meaning=f"one value for {', '.join(names)}",
        source="",
        members=names,
    )


def groups_by_prefix(parameters: Sequence[Parameter], prefix: str) -> dict[str, tuple[str, ...]]:
    """Return one group with all parameters whose name is the prefix followed by digits.

    Raises
    ------
    UsageError
        If fewer than two parameters match. The hint has the nearest prefix.
    """
    members = tuple(p.name for p in parameters if re.fullmatch(re.escape(prefix) + r"\d+", p.name))
    if len(members) < 2:
        stems = [re.sub(r"\d+$", "", p.name) for p in parameters if re.search(r"\d+$", p.name)]
        several = sorted({s for s in stems if stems.count(s) > 1})
        hint = suggestion(prefix, several)
        raise UsageError(f"there are no parameters to share as '{prefix}'", hint=hint)
    return {prefix: members}


def values_of(model: Model, parameters: Sequence[Parameter], known: Mapping[str, float]) -> Array:
    """Return the values of a model's parameters from the value of each parameter of a fit."""
    expanded = expand(parameters, known)
    return np.array([expanded[p.name] for p in model.parameters])


def expand(parameters: Sequence[Parameter], entries: Mapping[str, Entry]) -> dict[str, Entry]:
    """Return entries by parameter, with each shared parameter replaced by its members.

    The keys are parameter names or ``name[trial]``. Each member has the entry of the shared parameter, and so
    its standard error. The members are fully correlated.
    """
    groups = {p.name: p.members for p in parameters if p.members}
    found: dict[str, Entry] = {}
    for label, entry in entries.items():
        name, bracket, rest = label.partition("[")
        for member in groups.get(name, (name,)):
            found[member + bracket + rest] = entry
    return found
