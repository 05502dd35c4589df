"""The first line of the logs and setups of the samples, which says that their data are simulated."""

from __future__ import annotations

import re
from pathlib import Path

SOURCE = "# source: simulated (tests/generators)\n"


def mark(folder: Path) -> None:
    """State in every log and every setup of a folder that its data are simulated, if it does not say so."""
    for path in [*folder.glob("*.csv"), *folder.glob("*_setup.yaml")]:
        text = path.read_text(encoding="utf-8")
        if not re.search(r"(?m)^#.*(simulated|synthetic)", text[:2000]):
            path.write_text(SOURCE + text, encoding="utf-8")
