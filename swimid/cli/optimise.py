"""``swimid optimise``: one command for each kind of optimum."""

from __future__ import annotations

import click

from swimid.cli.verbs import VERBS


@click.group()
def optimise() -> None:
    """Find the best stiffness, as a rule for a controller, or the best gait."""


for verb in VERBS:
    if verb.name.startswith("optimise "):
        optimise.add_command(verb.command())
