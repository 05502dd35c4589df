"""``swimid track``: logs from videos and IMU recordings."""

from __future__ import annotations

import click

from swimid.cli.verbs import VERBS


@click.group()
def track() -> None:
    """Make logs: from videos with coloured markers, and from IMU recordings."""


for verb in VERBS:
    if verb.name.startswith("track "):
        track.add_command(verb.command())
