"""The options of ``rwls``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from swimid.options import Options, option


class RwlsOptions(
    Options,
    command="rwls",
    section="Identify",
    argument="LOG...",
    output="Parameter file to write.",
    output_flags=("-o", "--result"),
):
    r"""Identify an ARX or ARMAX model by recursive weighted least squares.

    A(z^-1) y = B(z^-1) u + C(z^-1) e with A = 1 + a1 z^-1 + ..., B = b1 z^-nk + ..., with one-step, k-step
    and free-run errors on fitted and held-out data, residual tests, poles and stability. LOG may also be a
    trials file of the experiment arma.

    Example:
      swimid rwls run.csv --input cmd1_rad --output u_m_s --na 4 --nb 3 --weight 0.95 \
          --validate 0.25 -o arma.yaml
    """

    input_column: str | None = option(None, flag="--input", metavar="COLUMN", help="Input column u.")
    output_column: str | None = option(
        None, flag="--output", metavar="COLUMN", help="Output column y (the result file is -o)."
    )
    input_model: str | None = option(
        None,
        metavar="sine:A,F[,PHASE]",
        help="Compute the input: A sin(2 pi F t + PHASE), A in any unit, F in Hz, PHASE in rad.",
    )
    na: int | None = option(None, ge=0, le=50, help="Number of output coefficients a1..")
    nb: int | None = option(None, ge=1, le=50, help="Number of input coefficients b1..")
    nk: int = option(1, ge=0, le=1000, help="Delay of b1, samples.")
    nc: int = option(0, ge=0, le=20, help="Noise coefficients c1..")
    order: Literal["given", "auto"] = option(
        "given", help="auto: choose na, nb and nk over a grid (--na, --nb and --nk are then ignored)."
    )
    max_na: int = option(6, ge=0, le=20, help="Grid of --order auto.")
    max_nb: int = option(6, ge=1, le=20, help="Grid of --order auto.")
    max_nk: int = option(4, ge=0, le=100, help="Grid of --order auto, from 0.")
    criterion: Literal["bic", "aic", "free-run"] = option(
        "bic",
        help="What --order auto minimises; free-run is the simulation error on the held-out part.",
    )
    weight: float = option(
        1.0,
        gt=0,
        help="The paper's Lambda: weight of a sample against P(0). Constant, so it only rescales P(0).",
    )
    forgetting: float = option(
        1.0, gt=0, le=1, help="Exponential forgetting: P is divided by this at every sample."
    )
    prior_scale: float = option(1e6, gt=0, flag="--p0", help="a of P(0) = a^2 I.")
    centre: Literal["auto", "none", "mean"] = option(
        "auto", help="Remove the means of the fit part: where a constant is needed, never, or always."
    )
    held_out: tuple[float | Path | str | Any, ...] = option(
        (),
        flag="--validate",
        metavar="SHARE|LOG",
        help="Held-out data: a share such as 0.25 (the last quarter of every log), or another log. "
        "Repeatable.",
    )
    horizon: int = option(10, ge=2, le=1000, help="Steps of the k-step prediction error.")
