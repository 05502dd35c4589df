"""A result that is one text: a report, a model for a simulator."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path

from swimid.files import atomic
from swimid.results.result import Result


@dataclass(frozen=True, eq=False)
class Text(Result):
    """A text, as ``report`` and ``export`` give it; ``document`` is the text itself."""

    def _write(self, path: Path) -> list[Path]:
        atomic.write_text(path, self.document)
        return [path]

    def _repr_html_(self) -> str:
        text = str(self.document)
        if text.startswith("<!DOCTYPE html>"):
            frame = "width:100%;height:40em;border:0"
            return f'<iframe srcdoc="{html.escape(text)}" style="{frame}"></iframe>'
        return f"<pre>{html.escape(text)}</pre>"
