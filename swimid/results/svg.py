"""Matplotlib's SVG made fit to stand with others in one HTML page."""

from __future__ import annotations

import re
from html import escape

from swimid.results.evidence import Figure, Panel
from swimid.results.looks import GRID, INK, PAPER, SERIES, SHADE

_ROLES = {INK: "currentColor", GRID: "var(--grid)", PAPER: "var(--paper)", SHADE: "var(--shade)"}
_ROLES |= {colour: f"var(--s{i})" for i, colour in enumerate(SERIES, start=1)}
_ROLE = re.compile("|".join(_ROLES))
_PATH = re.compile(r'\bd="([^"]+)"')
_MOVE = re.compile(r"([ML]) ?(-?[\d.]+) (-?[\d.]+)")
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
    """A path to a tenth of a pixel; one of straight lines in relative steps, half as long.

    The steps are differences of rounded coordinates, so that nothing drifts. A point alone
    becomes a stroke of no length, which matplotlib drops and without which no dot is drawn.
    """
    path = re.sub(r"\s+", " ", path).strip()
    moves = _MOVE.findall(path)
    if re.sub(_MOVE, "", path).strip():
        path = _NUMBER.sub(lambda m: f"{float(m[0]):.1f}".removesuffix(".0"), path)
        return re.sub(r"\s*([MLCQz])\s*", r"\1", path)
    points = [(letter, round(10 * float(x)), round(10 * float(y))) for letter, x, y in moves]
    parts: list[str] = []
    x = y = 0
    before = ""
    for index, (letter, x_new, y_new) in enumerate(points):
        alone = letter == "M" and (index + 1 == len(points) or points[index + 1][0] == "M")
        step = _tenths(x_new - x) + _after(_tenths(y_new - y))
        if letter == "M":
            parts.append(f"m{step}{'h0' if alone else ''}")
        elif (x_new, y_new) == (x, y) and before == "M":
            parts.append("h0")
        elif (x_new, y_new) != (x, y):
            parts.append(_after(step) if before == "L" and parts[-1] != "h0" else f"l{step}")
        x, y, before = x_new, y_new, letter
    return "".join(parts)


def _tenths(value: int) -> str:
    sign = "-" if value < 0 else ""
    whole, tenth = divmod(abs(value), 10)
    return f"{sign}{whole or ''}.{tenth}" if tenth else f"{sign}{whole}"


def _after(number: str) -> str:
    return number if number.startswith("-") else f" {number}"
