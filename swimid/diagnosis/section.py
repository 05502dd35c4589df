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

_LEVELS = {"none": "good", "explained": "good", "ambiguous": "caution", "unexplained": "caution"}


@reader(format=gap.FORMAT, read=gap.read)
def section(path: Path, file: GapFile, evidence: Evidence | None) -> Section:
    """The section of a gap file."""
    return Section(
        path=path,
        kind="Gap",
        title=f"Gap between trials and model: {file.robot or file.model}",
        verdict=Verdict(
            level=_LEVELS[file.verdict],  # type: ignore[arg-type]
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
        facts=[
            ("Robot", file.robot),
            ("Model", file.model),
            ("Experiment", file.experiment),
            ("Parameters", file.params),
            ("Trials", str(len(file.trials))),
        ],
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
            Cell(numbers.percent(r.absorbed, 3), numeric=True),
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
    named = (("Robot", file.robot), ("Model", file.model), ("Experiment", file.experiment))
    facts += [(name, value) for name, value in (*named, ("Parameters", file.params)) if value]
    if file.trials:
        facts.append(("Trials", str(len(file.trials))))
    if file.scores:
        facts.append(("Effects tried", str(len({s.effect for s in file.scores}))))
    return facts


def _blocks(file: GapFile) -> list[Block]:
    blocks: list[Block] = []
    if file.causes:
        blocks.append(_causes(file))
        if any(c.parameters for c in file.causes):
            blocks.append(_sizes(file.causes))
        if any(c.shrinkage for c in file.causes[:1]):
            blocks.append(_shrinkage(file.causes[0], file.held_out))
    if file.advice:
        blocks.append(Note([_sentence(a.text) for a in file.advice], title="Next experiment"))
    if file.reasons or file.rounds:
        blocks.append(Note([_sentence(t) for t in (*file.reasons, *file.rounds)], title="How it was decided"))
    blocks.append(_channels(file))
    if any(file.where.stage.values()):
        blocks.append(_stages(file))
    if file.where.phase or file.where.regime or file.where.time:
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
            Cell(numbers.percent(c.probability, 2), numeric=True),
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
    ends = numbers.confidence95(v.value, v.stderr)
    if ends is None or v.status != "estimated":
        return Cell(numbers.NOTHING, numeric=True)
    return Cell(numbers.interval(*ends, v.stderr), numeric=True)


def _shrinkage(cause: Cause, held_out: gap.HeldOut | None) -> Grid:
    rows = [
        [
            Cell(s.channel, "code"),
            *(Cell(numbers.percent(v), numeric=True) for v in (s.shipped, s.before, s.after, s.floor)),
            Cell(numbers.percent(s.closed, 2), numeric=True),
            Cell(
                numbers.NOTHING
                if None in s.ci95
                else f"{numbers.number(100 * (s.ci95[0] or 0.0), 2)} … {numbers.percent(s.ci95[1], 2)}",
                numeric=True,
            ),
        ]
        for s in cause.shrinkage
    ]
    columns = ["Channel", "As given", "Without", "With the causes", "Noise floor", "Closed", "95 % interval"]
    caption = (
        f"Errors over the measured range {gap.HELD_OUT[held_out]}: parameters as given, "
        "the model refitted without the causes, and with them. Closed is the share of the root-mean-square "
        "error above the noise floor that the causes take away. Good: near 100 %."
    )
    return Grid("Errors on held-out data", columns, rows, caption)


def _channels(file: GapFile) -> Grid:
    rows = [
        [
            Cell(c.channel, "code"),
            Cell(numbers.number(c.rmse, 3, c.unit), numeric=True),
            *(Cell(numbers.percent(v), numeric=True) for v in (c.shipped, c.nrmse, c.floor)),
            Cell(numbers.percent(c.share, 2), numeric=True),
        ]
        for c in file.where.channels
    ]
    columns = ["Channel", "RMSE", "As given", "Refitted", "Noise floor", "Of the gap"]
    floor = f" The floor: {file.floor_from.rstrip('.')}." if file.floor_from else ""
    caption = (
        "Errors over the measured range without any effect, all trials together, with the parameters as "
        f"given and refitted.{floor} Good: refitted as small as the floor."
    )
    return Grid("The gap by channel", columns, rows, caption)


def _stages(file: GapFile) -> Grid:
    rows = [
        [Cell(stage), Cell(numbers.percent(share, 2), numeric=True)]
        for stage, share in file.where.stage.items()
    ]
    caption = "How the evidence is shared between the stages of the chain, over all effects tried."
    return Grid("The gap by stage of the chain", ["Stage", "Of the evidence"], rows, caption)


def _parts(file: GapFile) -> Grid:
    cells = [*file.where.regime, *file.where.phase, *file.where.time]
    rows = [
        [
            Cell(c.kind),
            Cell(c.label),
            Cell(numbers.number(c.ratio, 3), numeric=True),
            Cell(numbers.percent(c.share, 2), numeric=True),
        ]
        for c in cells
    ]
    caption = "Root-mean-square residual over the noise: 1 is noise alone. Good: all near 1."
    columns = ["Over", "Part", "Residual over noise", "Of the gap"]
    return Grid("The gap by part of the data", columns, rows, caption, folded=True)


def _forces(file: GapFile) -> Grid:
    rows = [
        [Cell(name), Cell(numbers.number(gain, 3), numeric=True)]
        for name, gain in sorted(file.forces.items(), key=lambda item: -(item[1] or 0.0))
    ]
    caption = (
        "What a smooth force, moment or sensor term without any physics gains in cross-validation, by where "
        "it acts. A large one says where the model lacks something, also when no effect of the catalogue "
        "fits."
    )
    return Grid("Generic terms", ["Term", "Held-out gain"], rows, caption)
