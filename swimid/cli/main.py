"""The ``swimid`` command."""

from __future__ import annotations

import click

import swimid
from swimid.cli.builder import Command, found

#: Headings of the list of commands, in the usual order of work.
SECTIONS = (
    "Make logs",
    "Identify",
    "Simulate and compare",
    "Diagnose",
    "Put to work",
    "Publish",
    "Help yourself",
)


class Sectioned(click.Group):
    """Command group whose help lists the commands by purpose."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one list of commands for each section."""
        sections: dict[str, set[str]] = {title: set() for title in SECTIONS}
        for spec in found().values():
            sections.setdefault(spec.section, set()).add(spec.command.split()[0])
        for title, names in sections.items():
            rows = [(name, self.commands[name].get_short_help_str(limit=88)) for name in sorted(names)]
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


@main.group()
def track() -> None:
    """Make logs: from videos with coloured markers, and from IMU recordings."""


@main.group()
def optimise() -> None:
    """Find the best stiffness, as a rule for a controller, or the best gait."""


for spec in found().values():
    {"track": track, "optimise": optimise}.get(spec.command.split()[0], main).add_command(Command(spec))


def entry() -> None:
    """Run the command line; entry point of the console script."""
    main(prog_name="swimid")
