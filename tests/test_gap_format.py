"""The gap file: what is pinned of it, what a diagnosis becomes in it, and what its reader refuses."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from swimid.diagnosis.gap_file import GapFile
from swimid.errors import InputError
from swimid.files import yamlio
from tests import gap_cases as cases

#: The pinned keys alone, as another program may write them.
PINNED = """
format: swimid-gap/1
verdict: explained
where:
  channels: [{channel: u_m_s, nrmse: 0.142, floor: 0.021, share: 0.71}]
  stage: {actuation: 0.9, structure: 0.1, fluid: 0.0, environment: 0.0, sensing: 0.0}
  phase: []
  regime: []
  time: []
causes:
  - effect: servo-backlash
    probability: 0.94
    equivalent: [amplitude-loss]
    parameters: {backlash_rad: {value: 0.035, stderr: 0.002, unit: rad}}
    shrinkage:
      - {channel: u_m_s, before: 0.142, after: 0.034, floor: 0.021, closed: 0.89}
remaining: {share: 0.1, where: start-up, white: true}
advice: []
"""


def test_the_pinned_keys_are_enough(tmp_path: Path) -> None:
    path = tmp_path / "gap.yaml"
    path.write_text(PINNED)
    file = GapFile.read(path)
    assert file.causes[0].effect == "servo-backlash"
    assert file.causes[0].shrinkage[0].closed == 0.89
    assert file.where.stage["actuation"] == 0.9


@pytest.mark.parametrize("name", sorted(cases.ALL))
def test_written_and_read_back(tmp_path: Path, name: str) -> None:
    """To the last bit, with every pinned key there whatever the verdict."""
    file = cases.ALL[name]
    path = tmp_path / "gap.yaml"
    file.write(path)
    assert GapFile.read(path) == file
    data = yamlio.plain(yamlio.load(path))
    assert {"format", "verdict", "where", "causes", "remaining", "advice"} <= set(data)
    assert set(data["where"]) == {"channels", "stage", "phase", "regime", "time"}
    assert set(data["where"]["stage"]) >= {"actuation", "structure", "fluid", "environment", "sensing"}
    assert ("rig" in data["where"]["stage"]) == ("rig" in cases.ALL[name].where.stage)
    assert {"share", "where", "white"} <= set(data["remaining"])
    for cause in data["causes"]:
        assert {"effect", "probability", "equivalent", "parameters", "shrinkage"} <= set(cause)
        for s in cause["shrinkage"]:
            assert {"channel", "before", "after", "floor", "closed"} <= set(s)


def test_everything_in_where_is_ranked() -> None:
    where = cases.EXPLAINED.where
    assert [c.channel for c in where.channels] == ["u_m_s", "yaw_rate_rad_s", "joint4_rad"]
    assert next(iter(where.stage)) == "actuation"
    for cells in (where.phase, where.regime, where.time):
        ratios = [c.ratio for c in cells]
        assert ratios == sorted(ratios, reverse=True)


def test_unknown_values_are_null() -> None:
    file = cases.EXPLAINED
    still = file.causes[0].shrinkage[-1]
    assert (still.channel, still.closed) == ("joint4_rad", None)
    assert cases.PARTIAL.closed is not None
    assert cases.PARTIAL.closed.ci95 == (None, None)
    text = yamlio.dumps(file.model_dump())
    assert "nan" not in text.lower().split()
    assert not any(isinstance(v, float) and not math.isfinite(v) for v in _leaves(file.model_dump()))


def _leaves(value: object) -> list[object]:
    if isinstance(value, dict):
        return [leaf for v in value.values() for leaf in _leaves(v)]
    if isinstance(value, list | tuple):
        return [leaf for v in value for leaf in _leaves(v)]
    return [value]


@pytest.mark.parametrize(
    "change, place, text",
    [
        (("swimid-gap/1", "swimid-gap/9"), "line 1", "is no gap file"),
        (("verdict: explained", "verdict: explaned"), "line 3", "did you mean 'explained'"),
        (("remaining:", "remaning:"), "line", "did you mean 'remaining'"),
        (("probability: 0.94", "probability: high"), "line 12", "'high' is not allowed"),
        (("actuation: 0.9", "acuation: 0.9"), "line", "'acuation' is not allowed"),
    ],
)
def test_invalid_files_are_refused(tmp_path: Path, change: tuple[str, str], place: str, text: str) -> None:
    path = tmp_path / "gap.yaml"
    path.write_text(PINNED.replace(*change))
    with pytest.raises(InputError) as caught:
        GapFile.read(path)
    assert str(path) in str(caught.value)
    assert place in str(caught.value)
    assert text in str(caught.value)
