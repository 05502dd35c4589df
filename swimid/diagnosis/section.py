"""Gap files (``swimid-gap/1``) and power files (``swimid-power/1``)."""

from __future__ import annotations

from pathlib import Path

from swimid.diagnosis import gap_file as gap
from swimid.diagnosis import power_file as power
from swimid.diagnosis import summary as words
from swimid.diagnosis.gap_file import Cause, GapFile, Value
from swimid.results import numbers
from swimid.results.evidence import Evidence, Verdict
from swimid.results.reader import reader, status_cell
from swimid.results.sections import Block, Cell, Grid, Note, Section


@reader(format=gap.FORMAT, read=GapFile.read)
def section(path: Path, file: GapFile, evidence: Evidence | None) -> Section:
    """The section of a gap file."""
    return Section(
        path=path,
        kind="Gap",
        title=f"Gap between trials and model: {file.robot or file.model}",
        verdict=Verdict(
            level=file.level,
            word=gap.WORDS[file.verdict],
            text=f"{file.verdict}. No evidence file, so its checks and figures cannot be shown.",
        ),
        facts=_facts(file),
        blocks=_blocks(file),
        provenance=file.provenance,
        data=file.model_dump(mode="json"),
    )


@reader(format=power.FORMAT, read=power.PowerFile.read)
def power_section(path: Path, file: power.PowerFile, evidence: Evidence | None) -> Section:
    """The section of a power file."""
    return Section(
        path=path,
        kind="Power",
        title=f"What trials could show: {file.robot}",
        verdict=Verdict(level="good", text=power.answer(file)),
        facts=_about(file),
        blocks=[_seen(file)],
        provenance=file.provenance,
        data=file.model_dump(mode="json"),
    )


def _seen(file: power.PowerFile) -> Grid:
    rows = [
        [
            Cell(r.effect, "code"),
            Cell(r.parameter, "code"),
            Cell("not within its bounds" if r.size is None else numbers.number(r.size, 2), numeric=True),
            Cell(numbers.unit_text(r.unit)),
            _percent(r.absorbed),
            Cell(", ".join(r.alike) or "none"),
        ]
        for r in file.effects
    ]
    columns = ["Effect", "Parameter", "Smallest size", "Unit", "Imitated", "Never told from"]
    return Grid(
        "What would be seen",
        columns,
        rows,
        "Seen with 90 % power. Imitated: the share of its squared change that coefficients take up.",
    )


def _facts(file: GapFile) -> list[tuple[str, str]]:
    facts: list[tuple[str, str]] = [("Verdict", file.verdict)]
    if file.causes:
        facts.append(("Cause", " + ".join(" or ".join([c.effect, *c.equivalent]) for c in file.causes)))
    facts += _about(file)
    if file.scores:
        facts.append(("Effects tried", str(len({s.effect for s in file.scores}))))
    return facts


def _about(file: GapFile | power.PowerFile) -> list[tuple[str, str]]:
    """What was diagnosed, as far as it is named."""
    named = (("Robot", file.robot), ("Model", file.model), ("Experiment", file.experiment))
    trials = ("Trials", str(len(file.trials) or ""))
    return [(name, value) for name, value in (*named, ("Parameters", file.params), trials) if value]


def _number(value: float | None, unit: str = "") -> Cell:
    return Cell(numbers.number(value, 3, unit), numeric=True)


def _percent(value: float | None, digits: int = 3) -> Cell:
    return Cell(numbers.percent(value, digits), numeric=True)


def _blocks(file: GapFile) -> list[Block]:
    blocks: list[Block] = []
    if file.causes:
        blocks.append(_causes(file))
        if any(c.parameters for c in file.causes):
            blocks.append(_sizes(file.causes))
        if file.closing:
            blocks.append(_shrinkage(file))
    if file.advice:
        blocks.append(Note([_sentence(a.text) for a in file.advice], title="Next experiment"))
    if file.reasons or file.rounds:
        blocks.append(Note([_sentence(t) for t in (*file.reasons, *file.rounds)], title="How it was decided"))
    blocks.append(_channels(file))
    if any(file.where.stage.values()):
        blocks.append(_stages(file))
    if words.parts(file):
        blocks.append(_parts(file))
    if any(file.forces.values()):
        blocks.append(_forces(file))
    return blocks


def _sentence(text: str) -> str:
    text = text.strip()
    text = text[:1].upper() + text[1:]
    return text if not text or text[-1] in ".!?" else f"{text}."


def _causes(file: GapFile) -> Grid:
    rows = [
        [
            Cell(c.effect, "code"),
            Cell(c.stage or numbers.NOTHING),
            Cell(_sentence(c.meaning) or numbers.NOTHING),
            _percent(c.probability, 2),
            Cell(", ".join(c.equivalent) or "none"),
            Cell("; ".join(c.sources) or numbers.NOTHING, "muted"),
        ]
        for c in file.causes
    ]
    together = " The effects of this table act together." if len(rows) > 1 else ""
    caption = (
        "Probability: that it, or one of those not to be told from it, is among what the model lacks; "
        f"{words.otherwise_text(file)}. Good: near 100 %, and nothing that the trials cannot tell from "
        f"it.{together}"
    )
    columns = ["Effect", "Stage", "What it is", "Probability", "Not to be told from it", "Sources"]
    return Grid("Cause", columns, rows, caption)


def _sizes(causes: list[Cause]) -> Grid:
    rows = [
        [
            Cell(c.effect, "code"),
            Cell(name, "code"),
            Cell(numbers.measured(v.value, v.stderr), numeric=True),
            _interval(v),
            Cell(numbers.unit_text(v.unit)),
            status_cell(v.status),
        ]
        for c in causes
        for name, v in c.parameters.items()
    ]
    columns = ["Effect", "Parameter", "Value ± std. error", "95 % interval", "Unit", "Status"]
    caption = (
        "Fitted together with the model's coefficients. Good: an interval that stays clear of no effect."
    )
    return Grid("Size of the cause", columns, rows, caption)


def _interval(v: Value) -> Cell:
    ends = numbers.confidence95(v.value, v.stderr) if v.status == "estimated" else None
    return Cell(numbers.interval(*ends, v.stderr) if ends else numbers.NOTHING, numeric=True)


def _shrinkage(file: GapFile) -> Grid:
    rows = [
        [
            Cell(s.channel, "code"),
            *(_percent(v) for v in (s.shipped, s.before, s.after, s.floor)),
            _percent(s.closed, 2),
            Cell(words.interval_text(s), numeric=True),
        ]
        for s in file.closing
    ]
    columns = ["Channel", "As given", "Without", "With the causes", "Noise floor", "Closed", "95 % interval"]
    caption = (
        f"Errors over the measured range {words.held_out_text(file)}: parameters as given, "
        "the model refitted without the causes, and with them. Closed is the share of the root-mean-square "
        "error above the noise floor that the causes take away. Good: near 100 %."
    )
    return Grid("Errors on held-out data", columns, rows, caption)


def _channels(file: GapFile) -> Grid:
    rows = [
        [
            Cell(c.channel, "code"),
            _number(c.rmse, c.unit),
            _percent(file.as_given[c.channel].nrmse if c.channel in file.as_given else None),
            *(_percent(v) for v in (c.nrmse, c.floor)),
            _percent(c.share, 2),
        ]
        for c in file.where.channels
    ]
    columns = ["Channel", "RMSE", "As given", "Refitted", "Noise floor", "Of the gap"]
    floor = f" The floor: {file.floor_from.rstrip('.')}." if file.floor_from else ""
    caption = (
        "Errors over the measured range without any effect, all trials together. With the parameters as "
        "given they are those of compare, validation trials included; refitted they are of the fitted trials."
        f"{floor} Good: both as small as the floor."
    )
    return Grid("The gap by channel", columns, rows, caption)


def _stages(file: GapFile) -> Grid:
    rows = [[Cell(stage), _percent(share, 2)] for stage, share in file.where.stage.items()]
    caption = "How the evidence is shared between the stages of the chain, over all effects tried."
    return Grid("The gap by stage of the chain", ["Stage", "Of the evidence"], rows, caption)


def _parts(file: GapFile) -> Grid:
    rows = [[Cell(c.kind), Cell(c.label), _number(c.ratio), _percent(c.share, 2)] for c in words.parts(file)]
    caption = "Root-mean-square residual over the noise: 1 is noise alone. Good: all near 1."
    columns = ["Over", "Part", "Residual over noise", "Of the gap"]
    return Grid("The gap by part of the data", columns, rows, caption, folded=True)


def _forces(file: GapFile) -> Grid:
    ranked = sorted(file.forces.items(), key=lambda item: -(item[1] or 0.0))
    rows = [[Cell(name), _number(gain)] for name, gain in ranked]
    caption = (
        "What a smooth force, moment or sensor term without any physics gains in cross-validation, by where "
        "it acts. A large one says where the model lacks something, also when no effect of the catalogue "
        "fits."
    )
    return Grid("Generic terms", ["Term", "Held-out gain"], rows, caption)
