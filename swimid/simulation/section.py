"""Comparison files (``swimid-comparison/1``)."""

from __future__ import annotations

from pathlib import Path

from swimid.results import numbers
from swimid.results.evidence import Evidence, Verdict
from swimid.results.reader import reader
from swimid.results.sections import Cell, Grid, Section
from swimid.simulation.compare_evidence import settled
from swimid.simulation.comparison_file import FORMAT, ComparisonFile


@reader(format=FORMAT, read=ComparisonFile.read)
def section(path: Path, file: ComparisonFile, evidence: Evidence | None) -> Section:
    """The section of a comparison file."""
    return Section(
        path=path,
        kind="Comparison",
        title=f"Measured against simulated: {file.robot}",
        verdict=Verdict(level=file.verdict, text="No evidence file, so its checks cannot be shown."),
        facts=_facts(file),
        blocks=[_pooled(file)],
        provenance=file.provenance,
        data=file.model_dump(mode="json"),
    )


def _facts(file: ComparisonFile) -> list[tuple[str, str]]:
    facts = [
        ("Robot", file.robot),
        ("Model", file.model),
        ("Experiment", file.experiment),
        ("Parameters", file.params),
        ("Trials", str(len(file.trials))),
    ]
    estimated = sum(t.start == "estimated" for t in file.trials)
    if estimated:
        facts.append(("Start states", f"estimated for {estimated} trials"))
    if file.mean_speed_rmse_m_s is not None:
        facts.append(("Mean speeds", f"RMSE {numbers.number(file.mean_speed_rmse_m_s, 3, 'm/s')}"))
    return facts


def _pooled(file: ComparisonFile) -> Grid:
    rows = [
        [
            Cell(name, "code"),
            Cell("from pose" if s.source == "pose" else "logged"),
            *(
                Cell(text, numeric=True)
                for text in (
                    numbers.number(s.rmse, 3, s.unit),
                    numbers.percent(s.nrmse),
                    numbers.percent(s.vaf),
                    numbers.number(s.fit_percent, 3, "percent"),
                    numbers.number(settled(s), 3, s.unit),
                    numbers.number(s.samples),
                )
            ),
        ]
        for name, s in file.channels.items()
    ]
    columns = ["Channel", "Source", "RMSE", "NRMSE", "VAF", "Fit", "Bias", "Samples"]
    caption = (
        "All trials together. NRMSE is over the measured range; bias is measured minus simulated. Good: VAF "
        "near 100 % and a bias small against the RMSE."
    )
    return Grid("All trials together", columns, rows, caption)
