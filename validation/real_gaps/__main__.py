"""Diagnose real recordings in which one known thing differs from the model, and print a table.

``python -m validation.real_gaps --data FOLDER --out FOLDER [NAME ...]`` runs the rows of these names,
by default all of them. A row that has a ``result.json`` in its folder is not run again. With
``--table FILE`` the table is written as CSV.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from validation.real_gaps import program
from validation.real_gaps.row import Sources


def main() -> None:
    """Read the command line, run the rows and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME")
    data = os.environ.get("SWIMID_DATA")
    parser.add_argument("--data", type=Path, default=data, required=data is None)
    help_text = "default: SWIMID_REPOSITORIES, else the folder 'repositories' in --data"
    repositories = os.environ.get("SWIMID_REPOSITORIES")
    parser.add_argument("--repositories", type=Path, default=repositories, help=help_text)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--table", type=Path)
    words = parser.parse_args()
    sources = Sources(words.data, words.repositories or words.data / "repositories")
    results = program.run_rows(words.names, sources, words.out)
    print(program.text_table(results))
    if words.table is not None:
        program.write_table(words.table, results)


if __name__ == "__main__":
    main()
