"""The options of a command as a table of its docs page: ``python -m swimid.cli.table fit-drag``."""

from __future__ import annotations

import sys

from swimid.cli.builder import CommandSpec, found


def table(spec: CommandSpec) -> str:
    """Return every option as it is typed, its keyword in Python, its default and what it does (Markdown)."""
    rows = ["| option | in Python | default | |", "|---|---|---|---|"]
    for entry in spec.model().declared().values():
        typed = f"{entry.flags} {entry.stands_for()}".strip().replace("|", "\\|")
        help = entry.help.replace("|", "\\|")
        rows.append(f"| `{typed}` | `{entry.name}` | {entry.default_text()} | {help} |")
    return "\n".join(rows)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(table(found()[name]))
