"""``swimid schema``."""

from __future__ import annotations

import click

from swimid.cli.common import Shared, running, shared_options


@click.command("schema")
@click.argument("name", required=False)
@shared_options("Write the schema to this file instead of stdout.")
def command(name: str | None, shared: Shared) -> None:
    """Print the JSON Schema of a file format.

    Without NAME, list the formats.

    \b
    Example:
      swimid schema trials > trials.schema.json
    """
    with running("schema", shared) as run:
        from swimid.cli.schema_verb import schema

        run.finish(schema(name, output=shared.output))
