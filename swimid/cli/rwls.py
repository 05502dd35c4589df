"""``swimid rwls``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options


@click.command("rwls", short_help="ARX/ARMAX model by recursive weighted least squares.")
@click.argument("logs", nargs=-1, required=True, metavar="LOG...", type=click.Path(path_type=Path))
@click.option("--input", "input_column", metavar="COLUMN", help="Input column u.")
@click.option("--output", "output_column", metavar="COLUMN", help="Output column y (the result file is -o).")
@click.option(
    "--input-model",
    metavar="sine:A,F[,PHASE]",
    help="Compute the input: A sin(2 pi F t + PHASE), A in any unit, F in Hz, PHASE in rad.",
)
@click.option("--na", type=click.IntRange(0, 50), help="Number of output coefficients a1..")
@click.option("--nb", type=click.IntRange(1, 50), help="Number of input coefficients b1..")
@click.option(
    "--nk", type=click.IntRange(0, 1000), default=1, show_default=True, help="Delay of b1, samples."
)
@click.option(
    "--nc", type=click.IntRange(0, 20), default=0, show_default=True, help="Noise coefficients c1.."
)
@click.option(
    "--order",
    type=click.Choice(["given", "auto"]),
    default="given",
    show_default=True,
    help="auto: choose na, nb and nk over a grid (--na, --nb and --nk are then ignored).",
)
@click.option(
    "--max-na", type=click.IntRange(0, 20), default=6, show_default=True, help="Grid of --order auto."
)
@click.option(
    "--max-nb", type=click.IntRange(1, 20), default=6, show_default=True, help="Grid of --order auto."
)
@click.option(
    "--max-nk",
    type=click.IntRange(0, 100),
    default=4,
    show_default=True,
    help="Grid of --order auto, from 0.",
)
@click.option(
    "--criterion",
    type=click.Choice(["bic", "aic", "free-run"]),
    default="bic",
    show_default=True,
    help="What --order auto minimises; free-run is the simulation error on the held-out part.",
)
@click.option(
    "--weight",
    type=click.FloatRange(0, min_open=True),
    default=1.0,
    show_default=True,
    help="The paper's Lambda: weight of a sample against P(0). Constant, so it only rescales P(0).",
)
@click.option(
    "--forgetting",
    type=click.FloatRange(0, 1, min_open=True),
    default=1.0,
    show_default=True,
    help="Exponential forgetting: P is divided by this at every sample.",
)
@click.option(
    "--p0",
    "prior_scale",
    type=click.FloatRange(0, min_open=True),
    default=1e6,
    show_default=True,
    help="a of P(0) = a^2 I.",
)
@click.option(
    "--centre",
    type=click.Choice(["auto", "none", "mean"]),
    default="auto",
    show_default=True,
    help="Remove the means of the fit part: where a constant is needed, never, or always.",
)
@click.option(
    "--validate",
    multiple=True,
    metavar="SHARE|LOG",
    help="Held-out data: a share such as 0.25 (the last quarter of every log), or another log. Repeatable.",
)
@click.option(
    "--horizon",
    type=click.IntRange(2, 1000),
    default=10,
    show_default=True,
    help="Steps of the k-step prediction error.",
)
@click.option(
    "--stride", type=click.IntRange(1), help="Keep every n-th row of the trajectories [default: 1000 kept]."
)
@shared_options("Parameter file to write.", output_flags=("-o", "--result"))
def command(logs: tuple[Path, ...], validate: tuple[str, ...], shared: Shared, **options: object) -> None:
    """Identify a discrete-time model from input and output columns.

    A(z^-1) y = B(z^-1) u + C(z^-1) e with A = 1 + a1 z^-1 + ..., B = b1 z^-nk + ..., by recursive
    weighted least squares, with one-step, k-step and free-run errors on fitted and held-out data,
    residual tests, poles and stability. LOG may also be a trials file of the experiment arma.

    \b
    Example:
      swimid rwls run.csv --input cmd1_rad --output u_m_s --na 4 --nb 3 --weight 0.95 \\
          --validate 0.25 -o arma.yaml
    """
    with running("rwls", shared) as run:
        from swimid.blackbox.rwls import rwls

        protect(shared.output, shared, inputs=(*logs, *validate))
        run.finish(
            rwls(
                list(logs),
                validate=list(validate),
                output=shared.output,
                progress=run.progress,
                **options,  # type: ignore[arg-type]
            )
        )
