"""``swimid compare``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, reading_option, running, shared_options, step_option
from swimid.cli.parsing import named_number, named_word


@click.command("compare", short_help="Measured trials against their simulation.")
@click.argument("trials", type=click.Path(path_type=Path))
@click.option(
    "--params", type=click.Path(path_type=Path), required=True, help="Parameter file, of any model."
)
@click.option("--robot", metavar="NAME|FILE", help="Accept the parameters for this robot.")
@click.option("--channels", metavar="A,B", default="", help="Compare these columns only.")
@click.option(
    "--refit-start/--no-refit-start",
    default=True,
    show_default=True,
    help="Estimate the start state of trials the parameter file does not know.",
)
@click.option(
    "--set", "chosen", multiple=True, metavar="NAME=VALUE", help="Use this value of a parameter. Repeatable."
)
@click.option(
    "--buoyancy-band",
    type=click.FloatRange(0, 50),
    default=2.0,
    show_default=True,
    metavar="PERCENT",
    help="Shade what so much less and more buoyancy changes (robots in space). 0 for none.",
)
@reading_option
@step_option
@shared_options("Comparison file to write (YAML).")
def command(
    trials: Path,
    params: Path,
    robot: str | None,
    channels: str,
    refit_start: bool,
    chosen: tuple[str, ...],
    buoyancy_band: float,
    readings: tuple[str, ...],
    dt: float,
    shared: Shared,
) -> None:
    """Compare recorded trials with their simulation.

    TRIALS is a trials file of any experiment; the parameter file says which model is to describe it.
    Errors by channel and trial, stroke by stroke and over the stroke's phase; the report draws them. Of a
    robot in space, trials that repeat a motion are averaged and shown beside the paper's tables.

    \b
    Examples:
      swimid compare trials.yaml --params tfish.yaml -o comparison.yaml
      swimid compare trials.yaml --params drag.yaml
      swimid report comparison.yaml -o comparison.html
    """
    with running("compare", shared) as run:
        protect(shared.output, shared, inputs=(trials, params))
        from swimid.simulation.compare import compare

        run.finish(
            compare(
                trials,
                params=params,
                robot=robot,
                output=shared.output,
                channels=[c.strip() for c in channels.split(",") if c.strip()],
                refit_start=refit_start,
                chosen=named_number(chosen, "--set"),
                readings=named_word(readings, "--reading"),
                dt=dt,
                buoyancy=buoyancy_band / 100.0,
                progress=run.progress,
            )
        )
