"""Option values that are more than one word."""

from __future__ import annotations

import math

from swimid.errors import UsageError


def number(text: str, option: str) -> float:
    """One finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option}: '{text}' is not a number")
    return value


def number_pair(text: str | None, option: str) -> tuple[float, float] | None:
    """Two numbers with a comma between them."""
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 2:
        raise UsageError(f"{option}: '{text}' should be two numbers with a comma between them")
    return number(parts[0], option), number(parts[1], option)


def named_number(texts: tuple[str, ...], option: str) -> dict[str, float]:
    """``NAME=VALUE`` items."""
    return {name: number(value, option) for name, value in _named(texts, option)}


def named_word(texts: tuple[str, ...], option: str) -> dict[str, str]:
    """``NAME=OPTION`` items."""
    return {name: value.strip() for name, value in _named(texts, option)}


def bounded(texts: tuple[str, ...], option: str) -> dict[str, tuple[float, float]]:
    """``NAME=LOW,HIGH`` items."""
    found = {}
    for name, value in _named(texts, option):
        pair = number_pair(value, option)
        assert pair is not None
        found[name] = pair
    return found


def swept(texts: tuple[str, ...], option: str) -> dict[str, tuple[float, float, int]]:
    """``NAME=LOW:HIGH:COUNT`` items."""
    found = {}
    for name, value in _named(texts, option):
        parts = value.split(":")
        if len(parts) != 3 or not parts[2].strip().isdigit():
            raise UsageError(f"{option}: '{name}={value}' should be NAME=LOW:HIGH:COUNT")
        if name in found:
            raise UsageError(f"{option}: {name} is given twice")
        found[name] = (number(parts[0], option), number(parts[1], option), int(parts[2]))
    return found


def _named(texts: tuple[str, ...], option: str) -> list[tuple[str, str]]:
    pairs = []
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise UsageError(f"{option}: '{text}' should be NAME=VALUE")
        pairs.append((name.strip(), value))
    return pairs
