"""Options of the command ``swimid rwls``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import model_validator

from swimid.errors import UsageError
from swimid.options import Options, option


class RwlsOptions(Options, argument="LOG...", output_flags=("-o", "--result"), makes="parameters"):
    r"""Identify an ARX or ARMAX model by recursive weighted least squares.

    A(z^-1) y = B(z^-1) u + C(z^-1) e with A = 1 + a1 z^-1 + ..., B = b1 z^-nk + ..., with one-step
    and free-run errors on fitted and held-out data, residual tests, poles and stability. LOG may also be a
    trials file of the experiment arma. Without --na and --nb the orders are searched.

    Example:
      swimid rwls run.csv --input cmd1_rad --output u_m_s --na 4 --nb 3 --weight 0.95 \
          --validate 0.25 -o arma.yaml
    """

    input_column: str | None = option(None, flag="--input", metavar="COLUMN", help="Input column u.")
    output_column: str | None = option(
        None, flag="--output", metavar="COLUMN", help="Output column y (the result file is -o)."
    )
    input_sine: tuple[float, float, float] | None = option(
        None,
        metavar="A F PHASE",
        help="Compute the input: A sin(2 pi F t + PHASE), A in any unit, F in Hz, PHASE in rad.",
    )
    na: int | None = option(None, ge=0, le=50, help="Number of output coefficients a1, ...")
    nb: int | None = option(None, ge=1, le=50, help="Number of input coefficients b1, ...")
    nk: int | None = option(
        None, ge=0, le=1000, help="Delay of b1, samples  [default: 1, or searched with the orders]."
    )
    nc: int = option(0, ge=0, le=20, help="Number of noise coefficients c1, ...")
    max_order: int = option(6, ge=1, le=20, help="Largest na and nb of an order search.")
    max_nk: int = option(4, ge=0, le=100, help="Largest delay of an order search, samples.")
    weight: float = option(
        1.0,
        gt=0,
        help="Lambda of the paper: weight of a sample against P(0). Being constant, it only rescales P(0).",
    )
    forgetting: float = option(
        1.0, gt=0, le=1, help="Exponential forgetting: P is divided by this at every sample."
    )
    prior_scale: float = option(1e6, gt=0, flag="--p0", help="a of P(0) = a^2 I.")
    centre: Literal["auto", "none", "mean"] = option(
        "auto", help="Subtract the means of the fitted part: where the data need it, never, or always."
    )
    held_out: tuple[float | Path | str | Any, ...] = option(
        (),
        flag="--validate",
        metavar="SHARE|LOG",
        help="Held-out data: a share such as 0.25 (the last quarter of every log), or another log. "
        "Repeatable.",
    )

    @property
    def delay(self) -> int:
        """Delay of the first input coefficient b1, samples; 1 if the option is not given."""
        return self.nk if self.nk is not None else 1

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        if (self.na is None) != (self.nb is None):
            hint = "give both --na and --nb, or neither to search the orders"
            raise UsageError("only one of --na and --nb is given", hint=hint)
        if self.input_sine is not None:
            amplitude, frequency_hz, _ = self.input_sine
            if amplitude == 0 or frequency_hz <= 0 or not all(map(math.isfinite, self.input_sine)):
                text = f"--input-sine {' '.join(f'{value:g}' for value in self.input_sine)}: "
                raise UsageError(f"{text}the amplitude must not be 0, the frequency must be above 0 Hz")
        return self
