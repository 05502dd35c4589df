"""``swimid fit-propulsion``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options
from swimid.cli.parsing import named_number


@click.command("fit-propulsion")
@click.argument("trials", type=click.Path(path_type=Path))
@click.option(
    "--drag", type=click.Path(path_type=Path), help="Drag file of the rig (fit-drag); needed for a cruise."
)
@click.option(
    "--wake",
    type=click.Choice(["fin", "axle"]),
    default="fin",
    show_default=True,
    help="Lever of the wake width in the Strouhal number: fin length, or axle to trailing edge.",
)
@click.option("--keep-departures", is_flag=True, help="Fit frequencies that depart from the law too.")
@click.option(
    "--start-state",
    type=click.Choice(["auto", "rest", "estimate"]),
    default="auto",
    show_default=True,
    help="Do straight free-swim trials start at rest? auto: their speed at the first beat is estimated.",
)
@click.option("--fix", "fixed", multiple=True, metavar="NAME=VALUE", help="Hold a parameter at a value.")
@click.option(
    "--free", "freed", multiple=True, metavar="NAME", help="Estimate a parameter that is fixed by default."
)
@shared_options("Parameter file to write (YAML).")
def command(
    trials: Path,
    drag: Path | None,
    wake: str,
    keep_departures: bool,
    start_state: str,
    fixed: tuple[str, ...],
    freed: tuple[str, ...],
    shared: Shared,
) -> None:
    """Identify the propulsion of a caudal fin.

    TRIALS is a trials file of a cruise experiment (energy recoil law: efficiency and amplitude
    offset), or of straight free-swim trials (beat-averaged thrust and surge drag).

    \b
    Examples:
      swimid fit-propulsion cruise.yaml --drag drag.yaml -o propulsion.yaml
      swimid fit-propulsion straight_runs.yaml -o surge.yaml
    """
    with running("fit-propulsion", shared) as run:
        protect(shared.output, shared, inputs=(trials, *([drag] if drag else [])))
        from swimid.propulsion.fit_propulsion import fit_propulsion

        run.finish(
            fit_propulsion(
                trials,
                drag=drag,
                output=shared.output,
                wake=wake,
                keep_departures=keep_departures,
                start_state=start_state,
                fixed=named_number(fixed, "--fix"),
                freed=freed,
                progress=run.progress,
            )
        )
