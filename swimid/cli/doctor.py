"""``swimid doctor``."""

from __future__ import annotations

import click

from swimid.cli.common import Shared, running, shared_options


@click.command("doctor")
@click.option(
    "--warm-up", is_flag=True, help="Compile the numerical kernels now, so that no later run waits."
)
@shared_options("Write the findings as JSON to this file.")
def command(warm_up: bool, shared: Shared) -> None:
    """Check the installation: versions, video codecs, compiled kernels.

    \b
    Example:
      swimid doctor --warm-up
    """
    with running("doctor", shared) as run:
        from swimid.cli.doctor_verb import doctor

        run.finish(doctor(warm_up=warm_up, output=shared.output, progress=run.progress))
