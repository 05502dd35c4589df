"""``swimid sensitivity``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, reading_option, running, shared_options, step_option
from swimid.cli.parsing import named_number, named_word, swept


@click.command("sensitivity", short_help="Which coefficient each output hangs on; sweeps of the drive.")
@click.argument("trials", type=click.Path(path_type=Path))
@click.option("--params", type=click.Path(path_type=Path), help="Parameter file of these trials' robot.")
@click.option("--robot", metavar="NAME|FILE", help="Accept the parameters for this robot.")
@click.option(
    "--method",
    type=click.Choice(["sobol", "morris", "none"]),
    default="sobol",
    show_default=True,
    help="Shares of variance, elementary effects, or a sweep alone.",
)
@click.option(
    "--samples",
    type=click.IntRange(2),
    help="Rows of the Sobol design, a power of two (256), or Morris trajectories (32).",
)
@click.option(
    "--range",
    "ranges",
    multiple=True,
    metavar="RULE|NAME=LOW,HIGH",
    help="bounds (default), stderr (two standard errors of --params), 20% of each value; or of one "
    "coefficient. Repeatable.",
)
@click.option("--coefficients", metavar="A,B", default="", help="Vary these only.")
@click.option(
    "--sweep",
    "axes",
    multiple=True,
    metavar="NAME=LOW:HIGH:COUNT",
    help="Vary the drive: frequency_hz, and scale of a stroke or amplitude_deg of a beat. At most two.",
)
@click.option("--trial", metavar="ID", help="Whose drive is swept. Default: the first that has one.")
@click.option(
    "--set", "chosen", multiple=True, metavar="NAME=VALUE", help="Hold a parameter at this value. Repeatable."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the design.")
@click.option("--jobs", type=click.IntRange(1), help="Threads; default one per processor.")
@reading_option
@step_option
@shared_options("Sensitivity file to write (YAML).")
def command(
    trials: Path,
    params: Path | None,
    robot: str | None,
    method: str,
    samples: int | None,
    ranges: tuple[str, ...],
    coefficients: str,
    axes: tuple[str, ...],
    trial: str | None,
    chosen: tuple[str, ...],
    seed: int,
    jobs: int | None,
    readings: tuple[str, ...],
    dt: float,
    shared: Shared,
) -> None:
    """Vary the coefficients of a robot with links, and its drive.

    TRIALS is a trials file of a free-swim or multibody experiment. Each output (speeds, rates, the misfit
    of each measured channel) is told which coefficients it hangs on, over ranges of all of them at once.
    A run that was stopped goes on where it was when it is started again.

    \b
    Examples:
      swimid sensitivity trials.yaml -o sens.yaml
      swimid sensitivity trials.yaml --params tfish.yaml --range stderr -o sens.yaml
      swimid sensitivity trials.yaml --range 20% --range c_d4=2,6 --samples 512 -o sens.yaml
      swimid sensitivity strokes.yaml --method morris -o screening.yaml
      swimid sensitivity strokes.yaml --params sealion.yaml --method none \\
          --sweep frequency_hz=0.2:0.6:5 --sweep scale=0.6:1.2:5 -o sweep.yaml
    """
    with running("sensitivity", shared) as run:
        protect(shared.output, shared, inputs=(trials, *([params] if params else [])))
        from swimid.sensitivity_analysis.sensitivity import sensitivity

        run.finish(
            sensitivity(
                trials,
                params=params,
                robot=robot,
                output=shared.output,
                method=method,  # type: ignore[arg-type]
                samples=samples,
                ranges=ranges,
                coefficients=[c.strip() for c in coefficients.split(",") if c.strip()],
                sweep=swept(axes, "--sweep"),
                trial=trial,
                chosen=named_number(chosen, "--set"),
                readings=named_word(readings, "--reading"),
                seed=seed,
                jobs=jobs,
                dt=dt,
                progress=run.progress,
            )
        )
