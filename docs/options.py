"""Print docs/options.md: the options of all commands. ``make options`` writes the page."""

from __future__ import annotations

from swimid.cli.main import CommandSpec, found


def table(spec: CommandSpec) -> str:
    """Return each option as it is typed, its keyword in Python, its default and its help (Markdown)."""
    rows = ["| option | in Python | default | |", "|---|---|---|---|"]
    for entry in spec.model().declared().values():
        typed = f"{entry.flags} {entry.stands_for()}".strip().replace("|", "\\|")
        text = entry.help.replace("|", "\\|")
        rows.append(f"| `{typed}` | `{entry.name}` | {entry.default_text()} | {text} |")
    return "\n".join(rows)


def page() -> str:
    """Return the whole page."""
    parts = [
        "# Options of all commands",
        "`python docs/options.py` prints this page. All commands also take the options of `swimid --help`.",
    ]
    for name, spec in sorted(found().items()):
        parts.append(f"## `swimid {name}`\n\n{table(spec)}")
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    print(page(), end="")
