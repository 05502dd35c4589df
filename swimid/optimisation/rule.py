"""The rule file (``swimid-rule/2``): the stiffness a controller sets at a frequency and an amplitude."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable
from typing import Any, ClassVar, Literal

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import Field, model_validator

from swimid.errors import UsageError
from swimid.files import yamlio
from swimid.files.yamlio import Number, Pair, Rows
from swimid.fitting.model import Array
from swimid.optimisation.study import StudyFile

#: Highest power of the frequency in a curve.
DEGREE = 2

Outside = Literal["refuse", "hold"]


class Curve(yamlio.Document):
    """The rule at one amplitude: ``c0 + c1 f + c2 f^2`` (tendon fish, Algorithm 1: ``d_p = g_A(f)``)."""

    amplitude_deg: float
    #: c0, c1, c2, with f in Hz; of two frequencies a straight line, of one a constant.
    coefficients: tuple[float, float, float]
    #: Of each coefficient; missing where there are no more frequencies than coefficients.
    stderr: tuple[float, float, float] | None = None
    #: Root-mean-square of the residuals of the optima.
    rms: float
    #: c0, c1, c2 in draws of the robot's coefficients, a row each; none where these have no errors.
    drawn: Rows = []


class Optimum(yamlio.Document):
    """The stiffness found at one frequency and amplitude."""

    frequency_hz: float
    amplitude_deg: float
    stiffness: float
    #: 95 % interval: where it lies in draws of the robot's coefficients.
    stiffness_ci95: Pair = (None, None)
    #: What the rule loses of the objective in nine of ten draws at most, as a share.
    loss_90: Number = None
    #: It lies at an end of the range that was searched: the optimum may lie beyond.
    at_bound: bool = False
    #: Mean speed at the end of the run (m/s) and cost of transport (J/m) at this stiffness, with the rule's,
    #: and with the reference stiffness.
    speed_m_s: Number = None
    rule_speed_m_s: Number = None
    reference_speed_m_s: Number = None
    cost_of_transport_J_m: Number = None
    rule_cost_of_transport_J_m: Number = None
    reference_cost_of_transport_J_m: Number = None
    #: Range of the turning rate (rad/s) with the stiffness found and with the reference; settling time (s).
    turn_rate_range_rad_s: Number = None
    reference_turn_rate_range_rad_s: Number = None
    settling_time_s: Number = None
    #: The Pareto front: stiffness and the two objectives, in the order of ``objectives``.
    front: Rows = []


class Swept(yamlio.Document):
    """A frequency sweep at one amplitude: the way made with the rule, and with every fixed stiffness."""

    amplitude_deg: float
    #: Way made with the rule, m, and with each fixed stiffness.
    rule_m: float
    fixed: list[float]
    fixed_m: list[float]


def fit_curve(amplitude_deg: float, frequency_hz: Array, stiffness: Array) -> Curve:
    """Fit the quadratic function of the frequency by least squares (tendon fish, Algorithm 1).

    >>> made = fit_curve(20.0, np.array([1.0, 2.0, 3.0]), np.array([3.0, 9.0, 19.0]))
    >>> [round(c, 6) for c in made.coefficients]
    [1.0, 0.0, 2.0]
    """
    degree = min(DEGREE, len(frequency_hz) - 1)
    design = np.vander(frequency_hz, degree + 1, increasing=True)
    found, *_ = np.linalg.lstsq(design, stiffness)
    left = stiffness - design @ found
    spare = len(frequency_hz) - DEGREE - 1
    errors = None
    if spare > 0:
        errors = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * float(left @ left) / spare).tolist()
    return Curve(
        amplitude_deg=amplitude_deg,
        coefficients=(*found.tolist(), *[0.0] * (DEGREE - degree)),  # type: ignore[arg-type]
        stderr=errors,
        rms=float(np.sqrt(np.mean(left**2))),
    )


class RuleFile(StudyFile):
    """A rule file."""

    kind: ClassVar[str] = "rule file"
    format: Literal["swimid-rule/2"] = "swimid-rule/2"
    #: The coefficient that is set, its unit, and between which values.
    coefficient: str
    unit: str
    between: tuple[float, float]
    objective: Literal["speed", "cost-of-transport"]
    objectives: tuple[str, str]
    #: The parameters' own stiffness, which gains are told against.
    reference: float
    #: Outside it the rule says nothing.
    frequency_hz: tuple[float, float]
    amplitude_deg: tuple[float, float]
    curves: list[Curve]
    optima: list[Optimum]
    sweeps: list[Swept] = []
    #: Number of draws of the coefficients, and the share of draws within the coefficients' bounds.
    draws: int = 0
    inside: Number = None
    provenance: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _rising(self) -> RuleFile:
        places = [curve.amplitude_deg for curve in self.curves]
        if not places or places != sorted(set(places)):
            raise ValueError("'curves' need rising amplitudes, and at least one")
        return self

    def stiffness_for(
        self, frequency_hz: float, amplitude_deg: float | None = None, *, outside: Outside = "refuse"
    ) -> float:
        """Return the stiffness at a frequency and an amplitude, between the curves by straight lines.

        Parameters
        ----------
        frequency_hz, amplitude_deg : float
            The amplitude may be left out where the rule has one only.
        outside : {"refuse", "hold"}
            Beyond the range of the rule: refuse, or take its nearest end, as the C header does.

        Returns
        -------
        float
            In :attr:`unit`, within :attr:`between`.

        Raises
        ------
        UsageError
            Outside the range of the rule, unless it is to be held there.
        """
        return float(self._blend(frequency_hz, amplitude_deg, outside, lambda curve: curve.coefficients))

    def interval_for(
        self, frequency_hz: float, amplitude_deg: float | None = None, *, outside: Outside = "refuse"
    ) -> tuple[float, float] | None:
        """Return the 95 % interval of the rule, from the covariance of the robot's coefficients.

        It is where the rule would lie with other draws of these. It says nothing about what the model lacks.

        Parameters
        ----------
        frequency_hz, amplitude_deg, outside
            As for :meth:`stiffness_for`.

        Returns
        -------
        tuple of float, or None
            In :attr:`unit`; None where the coefficients had no errors, or were not drawn.
        """
        if not self.draws:
            return None
        values = self._blend(
            frequency_hz, amplitude_deg, outside, lambda curve: np.array(curve.drawn, dtype=float).T
        )
        low, high = np.nanquantile(values, [0.025, 0.975], method="weibull")
        return float(low), float(high)

    def _blend(
        self, frequency_hz: float, amplitude_deg: float | None, outside: Outside, of: Callable[[Curve], Any]
    ) -> Any:
        """What the curves' coefficients come to, between the curves by straight lines."""
        places = [curve.amplitude_deg for curve in self.curves]
        if amplitude_deg is None:
            if len(places) > 1:
                raise UsageError("this rule depends on the amplitude: give amplitude_deg")
            amplitude_deg = places[0]
        f = _within(frequency_hz, self.frequency_hz, "frequency_hz", outside)
        a = _within(amplitude_deg, self.amplitude_deg, "amplitude_deg", outside)

        def value(k: int) -> Any:
            c0, c1, c2 = of(self.curves[k])
            return np.clip(c0 + f * (c1 + f * c2), *self.between)

        if len(places) == 1:
            return value(0)
        after = min(max(bisect.bisect_left(places, a), 1), len(places) - 1)
        share = (a - places[after - 1]) / (places[after] - places[after - 1])
        return (1.0 - share) * value(after - 1) + share * value(after)

    def header(self) -> str:
        """Return the rule as a C header: a function of single precision without a library."""
        environment = Environment(
            loader=PackageLoader("swimid.optimisation"),
            autoescape=False,
            undefined=StrictUndefined,
            trim_blocks=True,
            keep_trailing_newline=True,
        )
        environment.filters["single"] = _single
        return environment.get_template("rule.h").render(rule=self)


def _within(value: float, ends: tuple[float, float], name: str, outside: Outside) -> float:
    low, high = ends
    slack = 1e-9 * max(abs(low), abs(high))
    if not math.isfinite(value) or (outside == "refuse" and not low - slack <= value <= high + slack):
        raise UsageError(f"{name} {value:g} is outside the rule, {low:g} to {high:g}")
    return min(max(value, low), high)


def _single(value: float) -> str:
    """A number as C reads it in single precision."""
    text = f"{value:.9g}"
    if not any(mark in text for mark in ".e"):
        text += ".0"
    return f"{text}f"
