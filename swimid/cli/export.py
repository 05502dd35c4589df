"""``swimid export``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options


@click.command("export", short_help="Identified coefficients for MuJoCo, Gazebo, Stonefish, or as JSON.")
@click.argument("params", metavar="PARAMS", type=click.Path(path_type=Path))
@click.option(
    "--to", required=True, type=click.Choice(["mjcf", "gazebo", "stonefish", "json"]), help="What to write."
)
@click.option(
    "--robot",
    "robot_name",
    metavar="R",
    help="Built-in name or path of a robot file. Default: the one PARAMS names.",
)
@click.option(
    "--added-mass",
    type=click.Choice(["native", "fold", "plugin", "none"]),
    default="native",
    show_default=True,
    help="native: as the simulator itself has it, if it does. fold: part of the bodies' masses. "
    "plugin: in Gazebo's Hydrodynamics plugin. none: left out.",
)
@click.option(
    "--servo-hz",
    type=float,
    default=20.0,
    show_default=True,
    help="Natural frequency of the servos of driven joints the robot file gives none for.",
)
@shared_options("The file to write. Without it, or with -o -, it goes to stdout.")
def command(
    params: Path, to: str, robot_name: str | None, added_mass: str, servo_hz: float, shared: Shared
) -> None:
    """Write identified coefficients as a simulator reads them.

    PARAMS is a parameter file of a multi-link robot, or of a falling weight or towed body (Gazebo
    and JSON). Each thing the simulator cannot carry is named in a warning.

    \b
    Examples:
      swimid export tfish.yaml --to mjcf --added-mass fold -o tfish.xml
      swimid export drag.yaml --to gazebo -o boxfish.sdf
      swimid export tfish.yaml --to json -o tfish.json
    """
    with running("export", shared) as run:
        from dataclasses import replace

        from swimid.exporters.export import export

        output = None if shared.output is None or str(shared.output) == "-" else shared.output
        protect(output, shared, inputs=(params,))
        outcome = export(
            params=params,
            to=to,
            output=output,
            robot_name=robot_name,
            added_mass=added_mass,  # type: ignore[arg-type]
            servo_hz=servo_hz,
        )
        if output is None and not shared.as_json:
            # The document is the result: --quiet must not swallow it.
            click.echo(outcome.text)
            outcome = replace(outcome, text="")
        run.finish(outcome)
