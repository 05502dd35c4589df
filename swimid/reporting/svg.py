"""Matplotlib's SVG made fit to stand with others in one HTML page."""

from __future__ import annotations

import re
from html import escape

from swimid.formats.evidence import Figure, Panel
from swimid.reporting.looks import GRID, INK, PAPER, SERIES, SHADE

_ROLES = {INK: "currentColor", GRID: "var(--grid)", PAPER: "var(--paper)", SHADE: "var(--shade)"}
_ROLES |= {colour: f"var(--s{i})" for i, colour in enumerate(SERIES, start=1)}
_ROLE = re.compile("|".join(_ROLES))
_PATH = re.compile(r'\bd="([^"]+)"')
_NUMBER = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")


def for_page(text: str, prefix: str, figure: Figure, panel: Panel) -> str:
    """Turn a whole SVG file into an element of a page.

    Its style sheet and metadata go (they would act on the whole page), ids get ``prefix``,
    colours become roles, fonts the page's own, and coordinates a tenth of a pixel. Only
    tags are touched, never the text between them.
    """
    text = text[text.index("<svg") :]
    text = re.sub(r"<(metadata|style)\b.*?</\1>|<!--.*?-->", "", text, flags=re.DOTALL)
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    text = re.sub(r"<[^>]*>", lambda m: _tag(m[0], prefix, used), text)
    text = re.sub(r"<defs>\s*</defs>", "", text)
    text = re.sub(r">\s+<", "><", text)
    box = re.search(r'viewBox="[^"]+"', text)
    inside = text[text.index(">") + 1 :].strip()
    title = f"{figure.title}: {panel.title}" if panel.title else figure.title
    names = ", ".join(trace.label for trace in panel.traces if trace.label)
    description = f"{panel.y_label} over {panel.x_label}" + (f"; {names}" if names else "")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {box[0] if box else ""} role="img" '
        f'aria-labelledby="{prefix}title {prefix}desc">'
        f'<title id="{prefix}title">{escape(title)}</title>'
        f'<desc id="{prefix}desc">{escape(description)}</desc>{inside}'
    )


def _tag(tag: str, prefix: str, used: set[str]) -> str:
    tag = re.sub(r' id="([^"]+)"', lambda m: f' id="{prefix}{m[1]}"' if m[1] in used else "", tag)
    tag = re.sub(r' transform="rotate\(-?0 [^"]*"', "", tag)
    tag = re.sub(r'(?:xlink:)?href="#([^"]+)"', rf'href="#{prefix}\1"', tag)
    tag = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}\1)", tag)
    tag = _ROLE.sub(lambda m: _ROLES[m[0]], tag)
    tag = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font-size: \1px", tag)
    tag = re.sub(r"font-family: [^;\"]*;? ?", "", tag)
    tag = _PATH.sub(lambda m: f'd="{_short(m[1])}"', tag)
    return re.sub(r"(\d\.\d{2})\d+", r"\1", tag)


def _short(path: str) -> str:
    path = _NUMBER.sub(lambda m: f"{float(m[0]):.1f}".removesuffix(".0"), path)
    path = re.sub(r"\s*([MLCQz])\s*", r"\1", re.sub(r"\s+", " ", path)).strip()
    # Dots: matplotlib drops the stroke of no length, without which nothing is drawn.
    return re.sub(r"M(-?[\d.]+ -?[\d.]+)(?:L\1)?(?=M|$)", r"M\1h0", path)
