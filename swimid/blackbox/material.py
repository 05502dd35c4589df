"""What the evidence of ``swimid rwls`` is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swimid.blackbox import difference
from swimid.blackbox.arx import Estimate
from swimid.blackbox.difference import Record
from swimid.blackbox.order import Candidate
from swimid.results.parameters import ParameterFile

if TYPE_CHECKING:
    from swimid.blackbox.scores import Scores, Tests


@dataclass(frozen=True)
class Material:
    """Everything the evidence is made of; the fields are those of :func:`swimid.blackbox.rwls.rwls`."""

    columns: tuple[str, str]
    units: tuple[str, str]
    sample_time_s: float
    fit: list[Record]
    held_out: Mapping[str, list[Record]]
    level: float
    centred: bool
    found: Estimate
    poles: list[difference.Pole]
    weight: float
    forgetting: float
    fit_scores: Scores
    scores: Mapping[str, Scores]
    horizon: int
    candidates: Sequence[Candidate]
    criterion: str
    tests: Tests
    file: ParameterFile
