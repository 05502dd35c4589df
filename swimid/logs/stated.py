"""Base of the parts of a mapping: nothing in it may be left open."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, field_validator

from swimid.files import yamlio

#: Mark in a drafted mapping of what nobody has stated yet.
ASK = "ASK"
#: A column by its name in the file, or by its number from 1.
ColumnKey = Annotated[str | int, Field(union_mode="left_to_right")]


class Stated(yamlio.Document):
    """A part of a mapping in which no value is ``ASK``."""

    @field_validator("*", mode="before")
    @classmethod
    def _nothing_is_open(cls, value: Any) -> Any:
        inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else [value]
        if any(part == ASK for part in inner if isinstance(part, str)):
            raise ValueError(f"is still {ASK}: state it, or delete the line")
        return value
