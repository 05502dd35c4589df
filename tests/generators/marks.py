"""The first line of the logs and setups of the samples, which says that their data are simulated."""

from __future__ import annotations

from pathlib import Path

from swimid.files.provenance import says_simulated

SOURCE = "# source: simulated (tests/generators)\n"


def mark(folder: Path) -> None:
    """State in every log and every setup of a folder that its data are simulated, if it does not say so."""
    for path in [*folder.glob("*.csv"), *folder.glob("*_setup.yaml")]:
        if not says_simulated(path):
            path.write_text(SOURCE + path.read_text(encoding="utf-8"), encoding="utf-8")
