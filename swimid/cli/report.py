"""``swimid report``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options


@click.command("report", short_help="One page from result files: figures, checks, methods, provenance.")
@click.argument("results", nargs=-1, required=True, metavar="RESULT...", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "kind",
    type=click.Choice(["html", "md", "json"]),
    help="What to write. Default: by the ending of -o, else html.",
)
@click.option("--title", help="Title of the page.")
@shared_options("The report. Without it, or with -o -, md and json go to stdout.")
def command(results: tuple[Path, ...], kind: str | None, title: str | None, shared: Shared) -> None:
    """Make one self-contained page from any mixture of results.

    RESULT is a parameter file, a gap file or a log. The evidence that swimid wrote beside it
    (drag.yaml: drag.evidence.json) brings its figures, checks and methods. Nothing is
    computed again.

    \b
    Examples:
      swimid report drag.yaml propulsion.yaml -o report.html
      swimid report drag.yaml --format md
    """
    with running("report", shared) as run:
        from dataclasses import replace

        from swimid.errors import UsageError
        from swimid.results.report import report

        output = None if shared.output is None or str(shared.output) == "-" else shared.output
        if output is None and shared.output is None and kind in (None, "html") and not shared.as_json:
            raise UsageError("an HTML page needs a file", hint="add -o report.html")
        if output is None and shared.as_json:
            kind = "json"
        protect(output, shared, inputs=results)
        outcome = report(inputs=results, output=output, format=kind, title=title, progress=run.progress)  # type: ignore[arg-type]
        if output is None and not shared.as_json:
            # The document is the result: --quiet must not swallow it.
            click.echo(outcome.text)
            outcome = replace(outcome, text="")
        run.finish(outcome)
