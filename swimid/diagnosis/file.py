"""The gap file of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, get_args

from swimid.diagnosis import gap_file as gap_format
from swimid.diagnosis import result
from swimid.diagnosis.gap_file import (
    Absorbed,
    Advice,
    Cause,
    Cell,
    ChannelGap,
    Extrapolation,
    GapFile,
    Hypothesis,
    Remaining,
    Score,
    Shrinkage,
    Value,
    Where,
)
from swimid.diagnosis.result import Gap


def gap_file(
    gap: Gap,
    *,
    model: str,
    robot: str,
    experiment: str,
    params: str,
    trials: Sequence[str],
    settings: Mapping[str, Any] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> GapFile:
    """The file of a diagnosis, every list of ``where`` ranked.

    Parameters
    ----------
    model, robot, experiment, params : str
        What was diagnosed; ``params`` names the parameter file.
    trials : sequence of str
        Ids of the trials used.
    """
    where = _where(gap)
    order = [c.channel for c in where.channels]
    return GapFile(
        verdict=gap.verdict,
        where=where,
        causes=[_cause(c, order) for c in gap.causes],
        remaining=Remaining(
            share=gap.remaining.share,
            where=gap.remaining.where,
            white=gap.remaining.white,
            gain=gap.remaining.gain,
        ),
        advice=[
            Advice(text=a.text, separates=list(a.separates), difference=a.difference, now=a.now)
            for a in gap.advice
        ],
        model=model,
        robot=robot,
        experiment=experiment,
        params=params,
        trials=list(trials),
        no_gap=gap.no_gap,
        outside=gap.outside,
        hypotheses=[
            Hypothesis(
                effects=sorted(c.names),
                numbers=c.numbers,
                score=c.score,
                slow=c.slow,
                folds=c.folds.tolist(),
                probability=p,
            )
            for c, p in gap.hypotheses
        ],
        samples=gap.samples or None,
        tried=gap.tried or None,
        held_out=gap.held_out,
        floor_from=gap.floor_from,
        scores=[_score(s) for s in ranked_scores(gap.scores)],
        forces=dict(gap.forces),
        at_bound=dict(gap.at_bound),
        rounds=list(gap.rounds),
        reasons=list(gap.reasons),
        settings=dict(settings or {}),
        provenance=dict(provenance or {}),
    )


def ranked_scores(scores: Iterable[result.Score]) -> list[result.Score]:
    """Best first: the refitted by their gain, then the others by the gain the screen predicted."""
    return sorted(
        scores,
        key=lambda s: (not s.refitted, -_size(s.gain if s.refitted else s.screened)),
    )


def _size(value: float) -> float:
    """Nothing known ranks last."""
    return value if math.isfinite(value) else -math.inf


def _where(gap: Gap) -> Where:
    channels = sorted(gap.channels, key=lambda c: -_size(c.share))
    stages = {stage: gap.stages.get(stage, 0.0) for stage in get_args(gap_format.Stage)}
    if "rig" not in gap.stages:
        del stages["rig"]
    return Where(
        channels=[
            ChannelGap(
                channel=c.channel,
                nrmse=c.nrmse,
                floor=c.floor,
                share=c.share,
                rmse=c.rmse,
                unit=c.unit,
                shipped=c.shipped,
            )
            for c in channels
        ],
        stage=dict(sorted(stages.items(), key=lambda item: -_size(item[1]))),
        phase=_cells(gap.phase),
        regime=_cells(gap.regime),
        time=_cells(gap.time),
    )


def _cells(cells: Iterable[result.Cell]) -> list[Cell]:
    found = [Cell(kind=c.kind, label=c.label, ratio=c.ratio, share=c.share) for c in cells]
    return sorted(found, key=lambda c: -math.inf if c.ratio is None else c.ratio, reverse=True)


def _cause(cause: result.Cause, order: Sequence[str]) -> Cause:
    ranked = sorted(
        cause.shrinkage, key=lambda s: order.index(s.channel) if s.channel in order else len(order)
    )
    return Cause(
        effect=cause.effect,
        probability=cause.probability,
        equivalent=list(cause.equivalent),
        parameters={name: _value(n) for name, n in cause.parameters.items()},
        shrinkage=[
            Shrinkage(
                channel=s.channel,
                before=s.before,
                after=s.after,
                floor=s.floor,
                closed=s.closed,
                ci95=s.ci95,
                shipped=s.shipped,
            )
            for s in ranked
        ],
        stage=cause.stage,  # type: ignore[arg-type]
        meaning=cause.meaning,
        sources=list(cause.sources),
        gain=cause.gain,
        gain_stderr=cause.gain_stderr,
        absorbed=[
            Absorbed(
                coefficient=a.name,
                given=None if a.given is None else _value(a.given),
                without=_value(a.without),
                with_effect=_value(a.with_effect),
                bounds=a.bounds,
            )
            for a in cause.absorbed
        ],
        extrapolation=[
            Extrapolation(left_out=e.left_out, before=e.before, after=e.after) for e in cause.extrapolations
        ],
    )


def _value(n: result.Number) -> Value:
    return Value(value=n.value, stderr=n.stderr, unit=n.unit, status=n.status)  # type: ignore[arg-type]


def _score(s: result.Score) -> Score:
    return Score(
        effect=s.effect,
        stage=s.stage,  # type: ignore[arg-type]
        variant=s.variant,
        gain=s.gain,
        stderr=s.stderr,
        won=s.won,
        absorbed=s.absorbed,
        screened=s.screened,
        refitted=s.refitted,
        probability=s.probability,
    )
