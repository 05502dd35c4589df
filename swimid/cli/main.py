"""The ``swimid`` command."""

from __future__ import annotations

import click

import swimid
from swimid.cli.optimise import optimise
from swimid.cli.track import track
from swimid.cli.verbs import HELPERS, SECTIONS, VERBS


class Sectioned(click.Group):
    """A group whose help lists its commands by purpose."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one list of commands per section."""
        for title, names in SECTIONS:
            rows = [(name, self.commands[name].get_short_help_str(limit=88)) for name in names]
            with formatter.section(title):
                formatter.write_dl(rows)


@click.group(
    cls=Sectioned, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.version_option(swimid.__version__, prog_name="swimid")
def main() -> None:
    """System identification for swimming robots.

    From overhead videos, rig recordings and IMU logs to published parameters: every number
    with its uncertainty, every result with the evidence it rests on.

    \b
    A first session, on the logs that ship with the source:
      swimid fit-drag sample_logs/rig/trials.yaml -o drag.yaml
      swimid report drag.yaml -o report.html
    """


main.add_command(track)
main.add_command(optimise)
for verb in (*VERBS, *HELPERS):
    if " " not in verb.name:
        main.add_command(verb.command())


def entry() -> None:
    """Console script."""
    main(prog_name="swimid")
