"""The rule file (``swimid-rule/1``): the stiffness a controller sets at a frequency and an amplitude."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from swimid.errors import UsageError
from swimid.files import yamlio
from swimid.files.yamlio import Number, Pair, Rows
from swimid.fitting.model import Array

FORMAT: Literal["swimid-rule/1"] = "swimid-rule/1"
#: Steps of the frequency in an exported table.
TABLE_STEPS = 40
#: Highest power of the frequency in a curve.
DEGREE = 2


@dataclass(frozen=True)
class Fitted:
    """A quadratic function of the frequency.

    Attributes
    ----------
    coefficients : tuple of float
        c0, c1, c2; of two frequencies a straight line, of one a constant.
    stderr : tuple of float or None
        By the scatter about it.
    rms : float
        Root-mean-square of what it leaves.
    """

    coefficients: tuple[float, float, float]
    stderr: tuple[float, float, float] | None
    rms: float


def fitted(frequency_hz: Array, stiffness: Array) -> Fitted:
    """The quadratic function of the frequency by least squares (tendon fish, Algorithm 1).

    >>> made = fitted(np.array([1.0, 2.0, 3.0]), np.array([3.0, 9.0, 19.0]))
    >>> [round(c, 6) for c in made.coefficients]
    [1.0, 0.0, 2.0]
    """
    degree = min(DEGREE, len(frequency_hz) - 1)
    design = np.vander(frequency_hz, degree + 1, increasing=True)
    found, *_ = np.linalg.lstsq(design, stiffness)
    left = stiffness - design @ found
    spare = len(frequency_hz) - degree - 1
    errors = None
    if spare > 0 and degree == DEGREE:
        inverse = np.linalg.inv(design.T @ design)
        errors = tuple(np.sqrt(np.diag(inverse) * float(left @ left) / spare).tolist())
    padded = (*found.tolist(), *[0.0] * (DEGREE - degree))
    return Fitted(padded, errors, float(np.sqrt(np.mean(left**2))))  # type: ignore[arg-type]


class Curve(yamlio.Document):
    """The rule at one amplitude: ``c0 + c1 f + c2 f^2`` (tendon fish, Algorithm 1: ``d_p = g_A(f)``)."""

    amplitude_deg: float
    #: c0, c1, c2, with f in Hz.
    coefficients: tuple[float, float, float]
    #: Of each coefficient; missing where there are no more frequencies than coefficients.
    stderr: tuple[float, float, float] | None = None
    #: Root-mean-square of what the curve leaves of the optima.
    rms: float
    #: c0, c1, c2 in draws of the robot's coefficients, a row each; none where these have no errors.
    drawn: Rows = []


class Optimum(yamlio.Document):
    """The stiffness found at one frequency and amplitude."""

    frequency_hz: float
    amplitude_deg: float
    #: Missing where no stiffness reaches the speed that was asked for.
    stiffness: Number = None
    #: 95 % interval: where it lies in draws of the robot's coefficients.
    stiffness_ci95: Pair = (None, None)
    #: What the rule loses of the objective in nine of ten draws at most, as a share; where a speed is asked
    #: for, the share of draws in which the rule reaches it.
    loss_90: Number = None
    reached_in_draws: Number = None
    #: It lies at an end of the range that was searched: the optimum may lie beyond.
    at_bound: bool = False
    #: The point nearest to the best of both objectives.
    knee: Number = None
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
    power_W: Number = None
    #: The Pareto front: stiffness and the two objectives, in the order of ``objectives``.
    front: Rows = []


class Swept(yamlio.Document):
    """A frequency sweep at one amplitude: the way made with the rule, and with every fixed stiffness."""

    amplitude_deg: float
    frequencies_hz: list[float]
    #: Mean speed at each frequency with the rule, m/s, and the way made in all, m.
    rule_m_s: list[float]
    rule_m: float
    #: One row for each fixed stiffness.
    fixed: list[float]
    fixed_m_s: list[list[float]]
    fixed_m: list[float]


class RuleFile(yamlio.ResultFile):
    """A rule file."""

    kind: ClassVar[str] = "rule file"
    format: Literal["swimid-rule/1"] = FORMAT
    verdict: Literal["good", "caution", "bad"]
    robot: str
    model: str
    params: str | None = None
    drive: dict[str, Any]
    duration_s: float
    #: Range of the drives that the coefficients were identified from; outside it is extrapolation.
    identified: dict[str, tuple[float, float]] = {}
    #: The coefficient that is set, its unit, and between which values.
    coefficient: str
    unit: str
    between: tuple[float, float]
    objective: Literal["speed", "cost-of-transport", "effort"]
    objectives: tuple[str, str]
    reach_speed_m_s: Number = None
    pick: Literal["best", "knee"]
    reference: float
    #: Outside it the rule says nothing.
    frequency_hz: tuple[float, float]
    amplitude_deg: tuple[float, float]
    curves: list[Curve]
    optima: list[Optimum]
    #: The frequency and stiffness of least power that reach the speed asked for.
    least_effort: Optimum | None = None
    sweeps: list[Swept] = []
    #: Draws of the coefficients from their covariance; independent ones outside the coefficients' bounds,
    #: replaced by others; and those within, where they were fewer than ``draws``: these a Gibbs sampler drew.
    draws: int = 0
    refused: int = 0
    inside: int | None = None
    provenance: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _rising(self) -> RuleFile:
        places = [curve.amplitude_deg for curve in self.curves]
        if not places or places != sorted(set(places)):
            raise ValueError("'curves' need rising amplitudes, and at least one")
        return self

    def stiffness_for(
        self,
        frequency_hz: float,
        amplitude_deg: float | None = None,
        *,
        outside: Literal["refuse", "hold"] = "refuse",
    ) -> float:
        """The stiffness at a frequency and an amplitude, between the curves by straight lines.

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
        f, after, share = self._place(frequency_hz, amplitude_deg, outside)
        value = self._curve(after, f)
        return (1.0 - share) * self._curve(after - 1, f) + share * value if after else value

    def interval_for(
        self,
        frequency_hz: float,
        amplitude_deg: float | None = None,
        *,
        outside: Literal["refuse", "hold"] = "refuse",
    ) -> tuple[float, float] | None:
        """The 95 % interval of what the rule says, from the covariance of the robot's coefficients.

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
        f, after, share = self._place(frequency_hz, amplitude_deg, outside)
        if not self.draws:
            return None
        values = self._drawn(after, f)
        if after:
            values = (1.0 - share) * self._drawn(after - 1, f) + share * values
        values = values[np.isfinite(values)]
        if not len(values):
            return None
        low, high = np.quantile(values, [0.025, 0.975], method="weibull")
        return float(low), float(high)

    def _place(
        self, frequency_hz: float, amplitude_deg: float | None, outside: Literal["refuse", "hold"]
    ) -> tuple[float, int, float]:
        """The frequency, the curve at or above the amplitude, and how far it is from the one below."""
        if amplitude_deg is None:
            if len(self.curves) > 1:
                raise UsageError("this rule depends on the amplitude: give amplitude_deg")
            amplitude_deg = self.curves[0].amplitude_deg
        f = _within(frequency_hz, self.frequency_hz, "frequency_hz", outside)
        a = _within(amplitude_deg, self.amplitude_deg, "amplitude_deg", outside)
        places = [curve.amplitude_deg for curve in self.curves]
        if len(places) == 1:
            return f, 0, 1.0
        after = min(max(bisect.bisect_left(places, a), 1), len(places) - 1)
        return f, after, (a - places[after - 1]) / (places[after] - places[after - 1])

    def _drawn(self, k: int, f: float) -> Array:
        """What a curve says in every draw, shape (draws,)."""
        c0, c1, c2 = np.array(self.curves[k].drawn, dtype=float).T
        return np.clip(c0 + f * (c1 + f * c2), *self.between)

    def _curve(self, k: int, f: float) -> float:
        c0, c1, c2 = self.curves[k].coefficients
        low, high = self.between
        return min(max(c0 + f * (c1 + f * c2), low), high)

    def header(self) -> str:
        """The rule as a C header: a function of single precision without a library; held at its ends."""
        amplitudes = ", ".join(_c(curve.amplitude_deg) for curve in self.curves)
        rows = ",\n".join(f"    {{{', '.join(_c(c) for c in curve.coefficients)}}}" for curve in self.curves)
        count = len(self.curves)
        (f0, f1), (a0, a1), (low, high) = self.frequency_hz, self.amplitude_deg, self.between
        return f"""/* Stiffness rule of the robot {self.robot}: {self.coefficient} in {self.unit}.
 * Objective: {self.objective}.
 * Frequency {f0:g} to {f1:g} Hz, amplitude {a0:g} to {a1:g} deg; held at its ends outside. */
#ifndef SWIMID_STIFFNESS_RULE_H
#define SWIMID_STIFFNESS_RULE_H

#define SWIMID_RULE_CURVES {count}

static const float swimid_rule_amplitude_deg[SWIMID_RULE_CURVES] = {{{amplitudes}}};

/* {self.coefficient} = c0 + c1 f + c2 f^2 at each amplitude */
static const float swimid_rule_coefficients[SWIMID_RULE_CURVES][3] = {{
{rows}
}};

static float swimid_rule_within(float value, float low, float high)
{{
    return value < low ? low : (value > high ? high : value);
}}

static float swimid_rule_curve(int k, float f)
{{
    const float *c = swimid_rule_coefficients[k];
    return swimid_rule_within(c[0] + f * (c[1] + f * c[2]), {_c(low)}, {_c(high)});
}}

/* {self.coefficient} ({self.unit}) at a frequency (Hz) and an amplitude (deg) */
static float swimid_stiffness_for(float frequency_hz, float amplitude_deg)
{{
    const float f = swimid_rule_within(frequency_hz, {_c(f0)}, {_c(f1)});
    const float a = swimid_rule_within(amplitude_deg, {_c(a0)}, {_c(a1)});
    int k = 0;
    float share;
    if (SWIMID_RULE_CURVES == 1)
        return swimid_rule_curve(0, f);
    while (k < SWIMID_RULE_CURVES - 2 && a > swimid_rule_amplitude_deg[k + 1])
        k++;
    share = (a - swimid_rule_amplitude_deg[k])
        / (swimid_rule_amplitude_deg[k + 1] - swimid_rule_amplitude_deg[k]);
    return (1.0f - share) * swimid_rule_curve(k, f) + share * swimid_rule_curve(k + 1, f);
}}

#endif
"""

    def table(self) -> str:
        """The rule as CSV: a row for each of evenly spaced frequencies, a column for each amplitude."""
        low, high = self.frequency_hz
        columns = [f"{self.coefficient}_at_{curve.amplitude_deg:g}_deg" for curve in self.curves]
        lines = [",".join(["frequency_hz", *columns])]
        for k in range(TABLE_STEPS + 1):
            f = low + (high - low) * k / TABLE_STEPS
            values = [self._curve(n, f) for n in range(len(self.curves))]
            lines.append(",".join(f"{value:.7g}" for value in (f, *values)))
        return "\n".join(lines) + "\n"


def _within(value: float, ends: tuple[float, float], name: str, outside: str) -> float:
    low, high = ends
    slack = 1e-9 * max(abs(low), abs(high))
    if not math.isfinite(value) or (outside == "refuse" and not low - slack <= value <= high + slack):
        raise UsageError(f"{name} {value:g} is outside the rule, {low:g} to {high:g}")
    return min(max(value, low), high)


def _c(value: float) -> str:
    """A number as C reads it in single precision."""
    text = f"{value:.9g}"
    return f"{text if any(mark in text for mark in '.e') else text + '.0'}f"
