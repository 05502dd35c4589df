"""A parameter file applied to a model: the values of each trial and their covariance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from swimid.errors import InputError, UsageError, suggestion
from swimid.fitting.model import Array, Model
from swimid.notices import warn
from swimid.results.parameters import Estimate, Fit, ParameterFile

#: Derivatives are taken over this share of a standard error, and of a parameter's size at most.
STEP, SMALLEST = 0.05, 1e-3


@dataclass(frozen=True)
class Quantity:
    """A number computed from a simulation.

    Attributes
    ----------
    value : float
    unit : str
    stderr : float or None
        From the parameters' covariance; None where no uncertainty is known.
    """

    value: float
    unit: str
    stderr: float | None = None


@dataclass
class Applied:
    """Parameter values for a model, with what is known of their uncertainty.

    Attributes
    ----------
    model : Model
    file : ParameterFile or None
        None for the values of a robot file.
    path : Path or None
        Of ``file``.
    chosen : dict of str to float
        Values set by the user; they are exact and win over the file's.
    """

    model: Model
    file: ParameterFile | None = None
    path: Path | None = None
    chosen: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [p.name for p in self.model.parameters]
        #: What a robot file says of its coefficients; a fit starts elsewhere.
        self.stated = self.model.stated()
        #: The file's estimates by parameter, or ``name[trial]``.
        self.known = {} if self.file is None else self.file.parameters
        for name, value in self.chosen.items():
            if name not in names:
                hint = suggestion(name, names)
                raise UsageError(f"there is no parameter '{name}'", hint=hint)
            p = self.model.parameters[names.index(name)]
            if not p.lower <= value <= p.upper:
                warn("SWM053", f"{name} = {value:g} lies outside its bounds, {p.lower:g} to {p.upper:g}")
        if self.file is not None:
            self._check(names)
            self._warn_doubtful(self.file.fit)

    def _check(self, names: list[str]) -> None:
        """Refuse a file of another robot: parameters too many, or too few."""
        known = {label.split("[")[0] for label in self.known}
        strange = sorted(known - set(names))
        missing = [
            p.name
            for p in self.model.parameters
            if p.free and not p.per_trial and p.name not in known and p.name not in self.chosen
        ]
        for wrong, text in (
            (strange, "the model of this robot has no such parameter"),
            (missing, "this parameter is missing"),
        ):
            if wrong:
                raise InputError(
                    text,
                    file=self.path,
                    column=f"parameters.{wrong[0]}",
                    hint=f"are these the parameters of another robot? This one has: {', '.join(names)}",
                )

    def _warn_doubtful(self, fit: Fit | None) -> None:
        """Tell which values the fit that wrote them does not vouch for."""
        name = self.path.name if self.path else "the parameter file"
        if fit is not None and not fit.converged:
            warn(
                "SWM062", f"{name}: the fit did not converge; these are the values at which its search ended"
            )
        unknown = [n for n, e in self.known.items() if e.status == "unidentifiable" and n not in self.chosen]
        if unknown:
            warn(
                "SWM062",
                f"{name}: not identifiable from the trials of the fit: {', '.join(unknown)}; what depends on "
                "them alone is not known",
            )

    def values(self, trial: str | None = None) -> Array:
        """Full parameter vector, shape (len(model.parameters),).

        Parameters
        ----------
        trial : str, optional
            Whose own values to take; without it, and for a trial the file does not know, per-trial
            parameters have their neutral start value.
        """
        return np.array([self._value(p.name, p.start, p.per_trial, trial) for p in self.model.parameters])

    def _value(self, name: str, start: float, per_trial: bool, trial: str | None) -> float:
        if name in self.chosen:
            return float(self.chosen[name])
        label = f"{name}[{trial}]" if per_trial else name
        return self.known[label].value if label in self.known else self.stated.get(name, start)

    def fitted_per_trial(self) -> set[str]:
        """Names of parameters the file holds for some trial."""
        return {n.split("[")[0] for n in self.known if "[" in n}

    def noise(self) -> dict[str, float]:
        """Standard deviation of the noise of each channel the parameters were fitted to."""
        fit = self.file.fit if self.file is not None else None
        return {
            name: float(known["value_sd"])
            for name, known in (fit.noise if fit is not None else {}).items()
            if isinstance(known, dict) and known.get("value_sd")
        }

    # -------------------------------------------------------- uncertainty

    def _carried(self) -> dict[str, Estimate]:
        """What the file says of the shared parameters, but for those set by the user."""
        names = [p.name for p in self.model.parameters]
        return {n: self.known[n] for n in names if n in self.known and n not in self.chosen}

    def uncertain(self) -> tuple[list[str], Array]:
        """Shared parameters with a standard error, and their covariance."""
        if self.file is None:
            return [], np.empty((0, 0))
        errors = {n: e.stderr for n, e in self._carried().items() if e.stderr and math.isfinite(e.stderr)}
        names, sd = list(errors), np.array(list(errors.values()), dtype=float)
        groups = self.file.settings.get("shared", {})
        owner = {member: group for group, members in groups.items() for member in members}
        labels = [owner.get(name, name) for name in names]
        stated = self.file.correlation
        listed = stated.names if stated else []
        correlation = np.eye(len(names))
        for i, first in enumerate(labels):
            for j, second in enumerate(labels):
                if first == second:
                    correlation[i, j] = 1.0
                elif stated and first in listed and second in listed:
                    correlation[i, j] = stated.matrix[listed.index(first)][listed.index(second)]
        return names, correlation * np.outer(sd, sd)

    def warn_without_error(self, where: str) -> None:
        """Name the shared parameters that were not identified and have no standard error to carry along."""
        lost = [
            name
            for name, e in self._carried().items()
            if e.status in ("unidentifiable", "at-bound") and not e.stderr
        ]
        if lost:
            warn(
                "SWM055",
                f"{', '.join(lost)} {'has' if len(lost) == 1 else 'have'} no standard error in the parameter "
                f"file: what is not known of them is not in {where}",
            )

    def with_errors(
        self, values: Array, compute: Callable[[Array], Mapping[str, Quantity]]
    ) -> dict[str, Quantity]:
        """Quantities with standard errors, by the delta method from the parameters' covariance.

        Parameters
        ----------
        values : ndarray, shape (len(model.parameters),)
        compute : callable
            From a parameter vector to quantities by name.
        """
        sides = [tuple(compute(end) for end in ends) for ends in self.neighbours(values)]
        return self.carried(values, compute(values), sides)

    def neighbours(self, values: Array) -> list[tuple[Array, Array]]:
        """Parameter vectors to either side of each uncertain parameter, for central differences."""
        names, covariance = self.uncertain()
        found = []
        for k, name in enumerate(names):
            index = self.model.index(name)
            p = self.model.parameters[index]
            size = max(abs(values[index]), p.scale)
            step = min(STEP * math.sqrt(covariance[k, k]), SMALLEST * size)
            low, high = np.clip([values[index] - step, values[index] + step], p.lower, p.upper)
            found.append((_with(values, index, float(low)), _with(values, index, float(high))))
        return found

    def carried(
        self,
        values: Array,
        centre: Mapping[str, Quantity],
        sides: Sequence[tuple[Mapping[str, Quantity], ...]],
    ) -> dict[str, Quantity]:
        """Quantities with standard errors from those at the :meth:`neighbours`.

        There is none where a neighbour lacks the quantity: its run breaks down, or never settles.
        """
        names, covariance = self.uncertain()
        if not names:
            return dict(centre)
        slopes = np.zeros((len(centre), len(names)))
        lost = {key for pair in sides for end in pair for key in centre if key not in end}
        ends = self.neighbours(values)
        for k, ((before, after), (low, high)) in enumerate(zip(sides, ends, strict=True)):
            index = self.model.index(names[k])
            width = float(high[index] - low[index])
            for row, key in enumerate(centre):
                if key in before and key in after and width > 0:
                    slopes[row, k] = (after[key].value - before[key].value) / width
        result = {}
        for (key, quantity), slope in zip(centre.items(), slopes, strict=True):
            variance = float(slope @ covariance @ slope)
            known = key not in lost and math.isfinite(variance)
            result[key] = replace(quantity, stderr=math.sqrt(max(variance, 0.0)) if known else None)
        return result


def _with(values: Array, index: int, value: float) -> Array:
    moved = values.copy()
    moved[index] = value
    return moved
