"""Functions that read, validate and write YAML files.

Comments are preserved, floating-point numbers are not rounded, and errors name the line of the file.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial, reduce
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, WrapValidator
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.constructor import DuplicateKeyError
from typing_extensions import TypedDict

from swimid.errors import InputError, file_errors, first_line, nearest, suggestion
from swimid.files import atomic
from swimid.options import BEYOND, describe_problem, is_beyond

#: Maximum size of a YAML file, bytes. A larger file is an error, and is not parsed.
MAX_BYTES = 20_000_000
#: Maximum number of nodes of a YAML document, where each alias counts as a copy of the node to which it
#: refers, and :data:`ROW` numbers of a long list of numbers count as one node. A document with more nodes is
#: an error. A node takes about 0.1 ms to parse, as do 5 words or 50 characters of a text.
MAX_NODES, ROW = 100_000, 100
#: Pattern of a long list of numbers on one line, and tag that marks it. Such a list is parsed as JSON, which
#: is a thousand times as fast.
_NUMBERS, _ROW_TAG = re.compile(r"(?<=[ [,])\[[-+.\deE, ]{200,}\](?=[],}\s])"), "!numbers"
#: Maximum number of characters of a YAML text on one line, such as a comment line of a log.
MAX_SCALAR = 100_000
#: Maximum number of characters of a value in a message.
MAX_VALUE_LETTERS = 80
#: Placeholder for an unknown value in a drafted file. The user must replace it by a value.
ASK = "ASK"

M = TypeVar("M", bound=BaseModel)


class Document(BaseModel):
    """Base class of the pydantic models of YAML files. Unknown keys and infinite numbers are errors."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, validate_default=False)

    def digest(self) -> str:
        """Return the SHA-256 of the keys and values of the document in hexadecimal digits.

        The digest does not depend on comments, on the order of the keys, or on keys that are empty or have
        their default value.
        """
        text = self.model_dump_json(exclude_defaults=True)
        data = json.loads(text, object_hook=lambda d: {k: v for k, v in d.items() if v is not None})
        return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


class ResultFile(Document):
    """Base class of the file formats that commands write.

    The default value of the field ``format`` is the name of the format, such as ``swimid-gap/1``.
    """

    #: Name of the file format in messages, such as ``"comparison file"``.
    kind: ClassVar[str]

    def write(self, path: str | Path) -> None:
        """Write the content to a YAML file, completely or not at all. Keys without a value are omitted."""
        write(path, self.model_dump(mode="python", exclude_none=True))

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a result file of this format from a YAML file.

        Raises
        ------
        InputError
            If the file has another format or is invalid.
        """
        data = of_format(path, cls.model_fields["format"].default, cls.kind)
        return validate(data, cls, Path(path))


def entries(name: str, **kinds: Any) -> Any:
    """Return the pydantic type of a block of a result file. ``kinds`` has the type of each known key.

    No key is required, and further keys are allowed. The block stays a dictionary with unchanged order.
    """
    known = TypedDict(name, kinds, total=False)  # type: ignore[misc]
    known.__pydantic_config__ = ConfigDict(extra="allow", strict=True)  # type: ignore[attr-defined]
    return Annotated[known, WrapValidator(lambda block, check: check(block) and block)]


if TYPE_CHECKING:
    Provenance = dict[str, Any]
else:
    #: Block ``provenance`` of a result file. ``inputs`` has the SHA-256 of the content of each input,
    #: ``simulated`` the names of the inputs whose data are simulated.
    Provenance = entries(
        "Provenance",
        command=str,
        version=str,
        created=str,
        inputs=dict[str, str],
        packages=dict[str, str],
        simulated=list[str],
        settings=dict[str, Any],
    )


def plain(value: Any, *, finite: bool = False) -> Any:
    """Convert nested data to plain Python dictionaries, lists, strings and numbers.

    With ``finite``, NaN and infinite numbers become None.
    """
    if isinstance(value, float):
        if finite and not math.isfinite(value):
            return None
        return float(value)
    for kind in (bool, int, str):
        if isinstance(value, kind):
            return kind(value)
    if isinstance(value, list | tuple):
        return [plain(one, finite=finite) for one in value]
    if isinstance(value, Mapping):
        return {str(name): plain(one, finite=finite) for name, one in value.items()}
    if isinstance(value, BaseModel):
        return plain(value.model_dump(mode="python"), finite=finite)
    if isinstance(value, Path):
        return value.as_posix()
    if hasattr(value, "tolist"):  # Convert scalars and arrays of numpy.
        return plain(value.tolist(), finite=finite)
    return value


_known = partial(plain, finite=True)
#: Field types of pydantic models for a number, a list, a table and a pair of numbers. NaN and infinite
#: numbers become None.
Number = Annotated[float | None, BeforeValidator(_known)]
Numbers = Annotated[list[float | None], BeforeValidator(_known)]
Rows = Annotated[list[list[float | None]], BeforeValidator(_known)]
Pair = Annotated[tuple[float | None, float | None], BeforeValidator(_known)]


def _yaml() -> YAML:
    # Use the round-trip loader of ruamel.yaml, which keeps comments and line numbers. Like the safe loader,
    # it constructs plain data only.
    yaml = YAML(typ="rt", pure=True)
    yaml.default_flow_style = False
    yaml.width = 4096
    yaml.allow_duplicate_keys = False
    yaml.constructor.add_constructor(_ROW_TAG, lambda _, node: tuple(json.loads(node.value)))
    yaml.representer.add_representer(float, _represent_float)
    return yaml


def _represent_float(representer: Any, value: float) -> Any:
    # Write the shortest text that is read back as the same floating-point number. Add a decimal point,
    # because YAML 1.1 readers read 1e-05 as a string.
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return representer.represent_scalar("tag:yaml.org,2002:float", text)


def load(path: str | Path) -> CommentedMap:
    """Read a YAML file whose top level is a mapping.

    Returns
    -------
    CommentedMap
        Content of the file, a ``dict`` with comments and line numbers.

    Raises
    ------
    InputError
        If the file cannot be read, is empty, is not a mapping, is not valid YAML, repeats a key, or is too
        large.
    """
    path = Path(path)
    with file_errors(path):
        raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, hint = raw[: error.start].count(b"\n") + 1, "save the file as UTF-8, or name another file"
        raise InputError("is not UTF-8 text", file=path, line=line, hint=hint) from error
    if len(raw) > MAX_BYTES:
        raise InputError(f"has {len(raw)} bytes; at most {MAX_BYTES} are allowed in YAML", file=path)
    try:
        data = _parse(_yaml(), text)
    except Exception as error:
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        place = mark and mark.line + 1
        problem = getattr(error, "problem", None) or getattr(error, "context", None) or first_line(error)
        if isinstance(error, DuplicateKeyError):
            twice = problem.split("with value")[0].strip()
            raise InputError(twice, file=path, line=place, hint="keep one of the two keys") from error
        hint = "check the indentation, colons, brackets and quotes at this line and above"
        raise InputError(f"is not valid YAML: {problem}", file=path, line=place, hint=hint) from error
    if data is None:
        raise InputError("is empty", file=path)
    if not isinstance(data, CommentedMap):
        hint = "name a YAML file whose top level has 'key: value' lines"
        raise InputError("has no 'key: value' lines at its top level", file=path, line=1, hint=hint)
    if found := _decimal_comma(data, text):
        raise InputError(found[0], file=path, line=line_of(data, found[1]))
    _refuse_open(data, path)
    return data


def _decimal_comma(data: Any, text: str) -> tuple[str, tuple[Any, ...]] | None:
    """Return the message on the first decimal comma in a flow mapping, and the path of its key; None if none.

    In ``{pulling_mass_kg: 0,010}`` the comma separates two items, of which the second is a key without value.
    """
    for *place, key in _places(data, (), lambda key, value: value is None and isinstance(key, int | float)):
        line = line_of(data, (*place, key))
        for match in re.finditer(r"[+-]?\d+,(\d[\d.eE+-]*)", text.splitlines()[line - 1] if line else text):
            if float(match[1].rstrip("+-.eE")) == key:
                point = match[0].replace(",", ".", 1)
                return f"'{match[0]}' is read as two values; write {point}", (*place, key)
    return None


def _refuse_open(data: Any, path: str | Path) -> None:
    """Raise an error that names the first value that is still the placeholder :data:`ASK`."""
    places = list(_places(data, (), lambda key, value: isinstance(value, str) and value == ASK))
    if places:
        key = [part for part in places[0] if isinstance(part, str)]
        text = f"is still {ASK}: state it, or delete the line"
        if len(places) > 1:
            text += f" (and {len(places) - 1} more)"
        raise InputError(text, file=path, line=line_of(data, places[0]), column=".".join(key) or None)


def _places(
    data: Any, place: tuple[Any, ...], is_bad: Callable[[Any, Any], bool]
) -> Iterator[tuple[Any, ...]]:
    """Yield the path (keys and indices) of each entry whose key and value make ``is_bad`` true."""
    parts: Any = ()
    if isinstance(data, Mapping):
        parts = data.items()
    elif isinstance(data, list | tuple):
        parts = enumerate(data)
    for key, value in parts:
        if is_bad(key, value):
            yield (*place, key)
        else:
            yield from _places(value, (*place, key), is_bad)


def of_format(path: str | Path, form: str, what: str) -> CommentedMap:
    """Read a YAML document, and check that its key ``format`` has the value ``form``.

    Raises
    ------
    InputError
        If the document states another format or no format. The message calls the document ``what``.
    """
    data = load(path)
    if data.get("format") != form:
        raise InputError(f"is no {what}: its 'format' must be {form}", file=path, line=1, column="format")
    return data


def _parse(yaml: YAML, text: str) -> Any:
    """Return the content of a YAML text; raise an error if it has more than :data:`MAX_NODES` nodes.

    Separators of nodes, words and characters are counted first, because parsing a large text takes long.
    """
    rest = _NUMBERS.sub("", text)
    known = max(rest.count(",") + rest.count("\n"), len(rest.split()) // 5, len(rest) // 50)
    text = _NUMBERS.sub(lambda row: f"{_ROW_TAG} '{row[0]}'", text)
    if known <= MAX_NODES:
        data = yaml.load(io.StringIO(text))
        known = _count_nodes(data, {})
    if known > MAX_NODES:
        raise ValueError(f"the document has more than {MAX_NODES} nodes with its anchors written out")
    return data


def _count_nodes(node: Any, known: dict[int, int]) -> int:
    """Return the number of nodes of a YAML document, where each alias counts as a copy of its node.

    The number is at most ``MAX_NODES + 1``. ``known`` has the numbers of nodes that are already counted.
    """
    if not isinstance(node, dict | list):
        return 1 + len(node) // ROW if isinstance(node, tuple) else 1
    if id(node) not in known:
        known[id(node)] = MAX_NODES + 1  # A node that contains itself counts as too large.
        inner = node.values() if isinstance(node, dict) else node
        known[id(node)] = min(1 + sum(_count_nodes(part, known) for part in inner), MAX_NODES + 1)
    return known[id(node)]


def read_document(path: str | Path, model: type[M]) -> M:
    """Read a YAML file and return its content as an object of a pydantic model.

    An error message names the line of the file and, for an unknown key, the most similar allowed key.
    """
    return validate(load(path), model, path)


def validate(data: Mapping[str, Any], model: type[M], path: str | Path) -> M:
    """Check data of a YAML file against a pydantic model, and return them as an object of this model.

    Raises
    ------
    InputError
        For the first error, with the line, the dotted key and the allowed values.
    """
    if not isinstance(data, CommentedMap):
        _refuse_open(data, path)
    if not issubclass(model, ResultFile):
        for place in _places(data, (), lambda key, value: is_beyond(value)):
            value = reduce(getitem, place, data)
            column = ".".join(map(str, place))
            raise InputError(
                f"{value!r:.20} is {BEYOND}", file=path, line=line_of(data, place), column=column
            )
    try:
        return model.model_validate(plain(data))
    except ValidationError as error:
        problems = error.errors()
        first = min(problems, key=lambda p: p["type"] != "extra_forbidden")
        message, hint = _explain(first, data, model)
        others = {tuple(_key(data, problem)) for problem in problems}
        if len(others) > 1:
            message += f" (and {len(others) - 1} more)"
        raise InputError(
            message,
            file=path,
            line=line_of(data, first["loc"]),
            column=".".join(map(str, _key(data, first))) or None,
            hint=hint,
        ) from error


def _follow(data: Any, location: Sequence[Any]) -> tuple[list[Any], Any, int | None]:
    """Follow the location of a pydantic error in YAML data as far as possible.

    Return the keys and indices that were found, the data at the end of this path, and the line of its last
    key. pydantic adds the names of the branches of a union to the location, which are not in the data.
    """
    parts: list[Any] = []
    line: int | None = None
    for part in location:
        in_list = isinstance(data, list) and isinstance(part, int) and part < len(data)
        if in_list or (isinstance(data, Mapping) and part in data):
            lines: dict[Any, Any] = getattr(getattr(data, "lc", None), "data", None) or {}
            if part in lines:
                line = lines[part][0] + 1
            parts.append(part)
            data = data[part]
    return parts, data, line


def line_of(data: Any, location: Sequence[Any]) -> int | None:
    """Return the line of the last key of a path that exists in a YAML document; None if no key exists."""
    return _follow(data, location)[2]


def _key(data: Any, problem: Any) -> list[Any]:
    """Return the path of the key to which a validation error of pydantic refers, even a missing key."""
    parts = _follow(data, problem["loc"])[0]
    if problem["type"] == "missing":
        parts.append(problem["loc"][-1])
    return parts


def _explain(problem: Any, data: Any, model: type[BaseModel]) -> tuple[str, str | None]:
    """Return the message and the hint for the user about a validation error of pydantic."""
    kind, location, value = problem["type"], problem["loc"], problem.get("input")
    hint = None
    if kind == "extra_forbidden":
        allowed = sorted(_keys_at(model, location[:-1]))
        if allowed:
            hint = suggestion(str(location[-1]), allowed, "allowed here")
        return f"unknown key '{location[-1]}'", hint
    if kind == "missing":
        place = _follow(data, location[:-1])[1]
        if isinstance(place, Mapping) and (wrote := nearest(str(location[-1]), [*map(str, place)])):
            hint = f"the file has '{wrote}' instead"
        return f"key '{location[-1]}' is missing", hint
    if kind == "value_error":
        return problem["msg"].removeprefix("Value error, "), None
    shown = type(value).__name__
    if value is None or isinstance(value, str | int | float):
        shown = textwrap.shorten(repr(value), MAX_VALUE_LETTERS, placeholder=" ...")
    return f"{shown} is not allowed: {describe_problem(problem)}", _hint_of_value(problem)


def _hint_of_value(problem: Any) -> str | None:
    """Return the hint about a value that is not allowed: a similar word, or a decimal point."""
    value = problem.get("input")
    if isinstance(value, str) and re.fullmatch(r"[+-]?\d+,\d+", value):
        return f"write the decimal point as a dot: {value.replace(',', '.')}"
    if problem["type"] == "too_long" and all(isinstance(one, int) for one in value):
        return "a decimal comma separates two items; write the decimal point as a dot"
    expected = str(problem.get("ctx", {}).get("expected", "")).replace(" or ", ",")
    close = nearest(str(value), [word.strip(" '") for word in expected.split(",")])
    return f"did you mean '{close}'?" if close else None


def _keys_at(model: Any, location: Sequence[Any]) -> set[str]:
    """Return the keys that a pydantic model allows at a location in a document, from its JSON Schema."""
    schema = model.model_json_schema()
    nodes = _branches(schema, schema)
    for part in location:
        following: list[dict[str, Any]] = []
        for node in nodes:
            inner = node.get("items")
            if not isinstance(part, int):
                inner = node.get("properties", {}).get(part, node.get("additionalProperties"))
            if isinstance(inner, dict):
                following += _branches(inner, schema)
        nodes = following or nodes
    return {name for node in nodes for name in node.get("properties", {})}


def _branches(node: dict[str, Any], schema: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the alternatives that a node of a JSON Schema allows, with references resolved."""
    if "$ref" in node:
        return _branches(schema["$defs"][node["$ref"].rsplit("/", 1)[-1]], schema)
    branches = [*node.get("anyOf", []), *node.get("oneOf", [])]
    if not branches:
        return [node]
    return [leaf for branch in branches for leaf in _branches(branch, schema)]


def dumps(data: Mapping[str, Any]) -> str:
    """Return the YAML text of a mapping, with short lists and mappings on one line."""
    return _text(_style(plain(data, finite=True), _is_short))


def dumps_flat(data: Mapping[str, Any]) -> str:
    """Return the YAML text of a mapping, with every value on the line of its key."""
    if not data:
        return ""
    return _text(_style(plain(data), lambda value, depth: depth > 0))


def _text(styled: Any) -> str:
    stream = io.StringIO()
    _yaml().dump(styled, stream)
    return stream.getvalue()


def _style(value: Any, on_one_line: Callable[[Any, int], bool], depth: int = 0) -> Any:
    """Return a copy of YAML data that marks the lists and mappings to write on one line.

    The function ``on_one_line`` decides from a list or mapping and its depth in the document.
    """
    styled: Any = value
    if isinstance(value, dict):
        styled = CommentedMap((k, _style(v, on_one_line, depth + 1)) for k, v in value.items())
    elif isinstance(value, list):
        styled = CommentedSeq(_style(v, on_one_line, depth + 1) for v in value)
    if styled is not value and on_one_line(value, depth):
        styled.fa.set_flow_style()
    return styled


def _is_short(value: Any, depth: int) -> bool:
    if len(str(value)) >= 150:
        return False
    if isinstance(value, list):
        return not any(isinstance(v, dict) for v in value)
    inner = [v for v in value.values() if isinstance(v, dict | list)]
    return depth > 1 and bool(value) and all(_short_list(v) for v in inner)


def _short_list(value: Any) -> bool:
    return isinstance(value, list) and not any(isinstance(v, dict | list) for v in value)


def write(path: str | Path, data: Mapping[str, Any]) -> None:
    """Write a mapping to a YAML file, completely or not at all."""
    atomic.write_text(path, dumps(data))


def parse_scalar(text: str) -> Any:
    """Return the Python value of a short YAML text, such as a number, a list or a mapping.

    Raises
    ------
    ValueError
        If the text is not YAML, or is too large.
    """
    if len(text) > MAX_SCALAR:
        raise ValueError(f"the text has {len(text)} characters; at most {MAX_SCALAR} are allowed")
    try:
        data = _parse(YAML(typ="safe", pure=True), text.strip())
    except Exception as error:
        raise ValueError(first_line(error)) from error
    if found := _decimal_comma(data, text):
        raise ValueError(found[0])
    return plain(data)


def limits(bounds: tuple[float | None, float | None]) -> tuple[float, float]:
    """Return lower and upper bound. A bound that a file omits is infinite."""
    low, high = bounds
    if low is None:
        low = -math.inf
    if high is None:
        high = math.inf
    return low, high
