"""Values of options: the click type of an option, and its value from the text that was typed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

from swimid.errors import UsageError

if TYPE_CHECKING:
    from swimid.options import Declared


def word_of(entry: Declared) -> dict[str, Any]:
    """Return the arguments of a click option of this type: ``type``, and ``multiple`` or ``nargs``."""
    kind, args = entry.kind, get_args(entry.kind)
    if _is_mapping(kind):
        return {"type": str, "multiple": True}
    if get_origin(kind) is not tuple:
        return {"type": _simple(kind, entry.limits)}
    if args[-1] is not Ellipsis:
        return {"type": str} if _by_commas(entry) else {"type": args[0], "nargs": len(args)}
    one = get_args(args[0]) if get_origin(args[0]) is tuple else ()
    if one:
        return {"type": one[0], "multiple": True, "nargs": len(one)}
    return {"type": str if entry.separated else _simple(args[0], {}), "multiple": True}


def value_of(entry: Declared, typed: Any) -> Any:
    """Return the value of an option from the text that was typed; None if nothing was.

    Raises
    ------
    UsageError
        When the text is not a value of the option.
    """
    if typed is None or typed == ():
        return None
    kind = entry.kind
    if _is_mapping(kind):
        items, value = _named(typed, entry.flag), get_args(kind)[1]
        if value not in _READERS:
            return swept(items, entry.flag)
        return {name: _READERS[value](text, entry.flag) for name, text in items}
    if reads := getattr(next(iter(get_args(kind)), None), "of_text", None):
        return tuple(reads(text, entry.flag) for text in typed)
    if entry.separated:
        return tuple(part.strip() for text in typed for part in text.split(",") if part.strip())
    return number_pair(typed, entry.flag) if _by_commas(entry) else typed


def _simple(kind: Any, limits: Mapping[str, float]) -> Any:
    """Return the click type of a single word."""
    if get_origin(kind) is Literal:
        return click.Choice(list(get_args(kind)))
    if Path in (kind, *get_args(kind)) and str not in get_args(kind):
        return click.Path(path_type=Path)
    if kind in (int, float):
        if not limits:
            return kind
        low, high = (limits.get(near, limits.get(open_)) for near, open_ in (("ge", "gt"), ("le", "lt")))
        number_range: Any = click.IntRange if kind is int else click.FloatRange
        return number_range(low, high, min_open="gt" in limits, max_open="lt" in limits)
    return str


def _is_mapping(kind: Any) -> bool:
    origin = get_origin(kind)
    return isinstance(origin, type) and issubclass(origin, Mapping)


def _by_commas(entry: Declared) -> bool:
    """Whether an option of several numbers is one word with commas in it."""
    pair = get_origin(entry.kind) is tuple and Ellipsis not in get_args(entry.kind)
    return pair and "," in (entry.metavar or "")


def number(text: str, option: str) -> float:
    """Read one finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option}: '{text}' is not a number")
    return value


def number_pair(text: str, option: str) -> tuple[float, float]:
    """Read two numbers with a comma between them."""
    parts = text.split(",")
    if len(parts) != 2:
        raise UsageError(f"{option}: '{text}' should be two numbers with a comma between them")
    return number(parts[0], option), number(parts[1], option)


def swept(items: list[tuple[str, str]], option: str) -> dict[str, tuple[float, float, int]]:
    """Read ``NAME=LOW:HIGH:COUNT`` items."""
    sweeps = {}
    for name, value in items:
        parts = value.split(":")
        if len(parts) != 3 or not parts[2].strip().isdigit():
            raise UsageError(f"{option}: '{name}={value}' should be NAME=LOW:HIGH:COUNT")
        if name in sweeps:
            raise UsageError(f"{option}: {name} is given twice")
        sweeps[name] = (number(parts[0], option), number(parts[1], option), int(parts[2]))
    return sweeps


def _named(texts: tuple[str, ...], option: str) -> list[tuple[str, str]]:
    """Read ``NAME=VALUE`` items."""
    pairs = []
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise UsageError(f"{option}: '{text}' should be NAME=VALUE")
        pairs.append((name.strip(), value))
    return pairs


#: Reader of a value of a mapping, by its type.
_READERS: dict[Any, Callable[[str, str], Any]] = {
    float: number,
    str: lambda text, option: text.strip(),
    tuple[float, float]: number_pair,
}
