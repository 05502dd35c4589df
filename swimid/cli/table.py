"""The options of a verb as a table of its docs page: ``python -m swimid.cli.table fit-drag``."""

from __future__ import annotations

import sys

from swimid.cli.builder import Verb
from swimid.cli.verbs import VERBS
from swimid.errors import UsageError, suggestion

#: The page of each verb.
PAGES = {verb.name: f"{verb.name}.md" for verb in VERBS} | {
    "plot": "import.md",
    "map": "optimise.md",
    "optimise stiffness": "optimise.md",
    "optimise gait": "optimise.md",
    "track video": "tracking.md",
    "track setup": "tracking.md",
    "track imu": "imu.md",
}


def table(verb: Verb) -> str:
    """Every option as it is typed, its keyword in Python, its default and what it does (Markdown)."""
    rows = ["| option | in Python | default | |", "|---|---|---|---|"]
    for entry in verb.model().declared().values():
        typed = f"{entry.flags} {entry.stands_for()}".strip().replace("|", "\\|")
        help = entry.help.replace("|", "\\|")
        rows.append(f"| `{typed}` | `{entry.name}` | {entry.default_text()} | {help} |")
    return "\n".join(rows)


def main(words: list[str]) -> None:
    """Print the table of each verb named.

    Raises
    ------
    UsageError
        For a verb that does not exist.
    """
    known = {verb.name: verb for verb in VERBS}
    for name in words:
        if name not in known:
            raise UsageError(f"there is no verb '{name}'", hint=suggestion(name, list(known)))
        print(table(known[name]))


if __name__ == "__main__":
    main(sys.argv[1:])
