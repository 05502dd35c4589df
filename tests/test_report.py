"""The report: what it shows, that it stands alone, and what it refuses."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import time
import warnings
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from swimid.cli.main import main
from swimid.diagnosis.evidence import Diagnosis
from swimid.diagnosis.gap_file import GapFile
from swimid.errors import InputError, UsageError
from swimid.files.provenance import collect
from swimid.logs import log
from swimid.notices import SwimidWarning, record_warnings
from swimid.results import drawing, evidence, parameters
from swimid.results.evidence import MAX_TRACE_POINTS, Check, Evidence, Figure, Panel, Table, Trace, Verdict
from swimid.results.parameters import Fitted
from swimid.results.report import report
from swimid.results.result import Result, cell_text, load_result
from tests import gap_cases
from tests import report_cases as cases

VOID = {"meta", "link", "img", "br", "hr", "input", "path", "use", "rect", "circle"}


class Outline(HTMLParser):
    """Every tag, attribute and visible word of a page; checks that tags are balanced."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open, f"</{tag}> closes nothing"
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] != "style":
            self.text.append(data)

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.text).split())


def outline(path: Path) -> Outline:
    parsed = Outline()
    parsed.feed(path.read_text(encoding="utf-8"))
    assert parsed.open == []
    return parsed


def quietly(**options: object) -> Any:
    with record_warnings():
        return report(**options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def mixture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of four results of different kinds."""
    folder = tmp_path_factory.mktemp("mixture")
    inputs = [
        cases.drag(folder),
        cases.arma(folder),
        cases.track(folder),
        cases.track(folder, proof=False, name="bare.csv"),
    ]
    quietly(inputs=inputs, output=folder / "report.html", title="Boxfish, four results")
    return folder / "report.html"


# ---------------------------------------------------------------- the page


def test_page_stands_alone(mixture: Path) -> None:
    """No script, no external resource, every id once, every anchor and clip path has its target."""
    parsed = outline(mixture)
    text = mixture.read_text(encoding="utf-8")
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in parsed.tags}
    for tag, attributes in parsed.tags:
        for name, value in attributes.items():
            assert not name.startswith("on")
            if name in {"src", "href", "xlink:href"}:
                assert value is not None
                assert value.startswith(("#", "data:image/")), (tag, value)
    assert not re.search(r"@import|url\((?!#)", text)
    ids = [attributes["id"] for _, attributes in parsed.tags if attributes.get("id")]
    assert len(ids) == len(set(ids))
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    used |= {name for _, a in parsed.tags for name in (a.get("aria-labelledby") or "").split()}
    assert used <= set(ids)


def test_page_has_its_parts_in_order(mixture: Path) -> None:
    """Verdict, cards, results with their doubts in the open, methods, references, warnings, provenance."""
    parsed = outline(mixture)
    anchors = [attributes.get("id") for tag, attributes in parsed.tags if tag == "section"]
    order = ["verdict", "r1", "r2", "r3", "r4", "references", "warnings", "provenance"]
    assert [name for name in anchors if name in order] == order
    words = parsed.words
    assert "1 of 4 results should not be used." in words
    for verdict in ("✓ Good", "! Caution", "✕ Bad", "✓ pass", "! warn", "✕ fail", "i info"):
        assert verdict in words, verdict
    assert "Fisher information" in words
    assert words.count("Gauss, C. F. (1809)") == 1
    assert "SWM011 parameters strongly correlated" in words
    assert "swimid fit-drag trials.yaml -o drag.yaml" in words
    assert "SHA-256" in words


def test_parameters_are_shown_as_the_standard_error_supports(mixture: Path) -> None:
    """Rounded estimates with intervals; words for what is not identifiable; fixed without interval."""
    words = outline(mixture).words
    assert "drag_coefficient 0.705 ± 0.033 0.640 … 0.770 estimated drag coefficient C_d 0 … 5" in words
    assert "added_mass 0.685 ± 0.037 kg 0.612 … 0.758 estimated – ≥ 0" in words
    assert "pulley_inertia (4.51 ± 0.12) × 10⁻⁵ kg·m² (4.28 … 4.75) × 10⁻⁵ estimated – free" in words
    assert "string_stiffness – – not identifiable – ≥ 0" in words
    assert "water_density 997 kg/m³ – fixed – free" in words
    assert "linear_drag 0 N·s/m – at its bound – ≥ 0" in words
    assert "187654" not in words
    assert "x_m fit 0.00213 m 0.0021 m 1.01 0.185 %" in words
    assert "x_m validation 0.00291 m 0.0021 m 1.39 0.26 %" in words


def test_figures_follow_the_page(mixture: Path) -> None:
    """Every SVG has a description, no colour or font of its own, and a legend in text."""
    text = mixture.read_text(encoding="utf-8")
    svgs = re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL)
    assert len(svgs) >= 14
    for svg in svgs:
        assert 'role="img" aria-label="' in svg
        assert not re.search(r"#[0-9a-f]{6}\b", svg)
        assert "font-family" not in svg
        assert "<style" not in svg
        assert "currentColor" in svg
        assert "nan" not in svg.lower()
    words = outline(mixture).words
    for label in ("10 g measured", "40 g model", "95 % of white noise", "gap", "without recoil"):
        assert label in words
    assert "forked tail <wide>" in words
    assert "prefers-color-scheme: dark" in text
    assert "@page" in text


@pytest.mark.slow
def test_bare_log_shows_its_gaps(mixture: Path) -> None:
    """A log without evidence: channels over time with each gap shaded, and SWM050."""
    figure = load_result(mixture.parent / "bare.csv").content().figures[0]
    spans = {panel.y_label: [(s.start, s.end) for s in panel.spans] for panel in figure.panels}
    # Samples 500..559 of x and 1500..1699 of yaw are missing, 0.02 s apart.
    assert spans["x (m)"] == [pytest.approx((9.98, 11.2))]
    assert spans["yaw (rad)"] == [pytest.approx((29.98, 34.0))]
    assert "so the checks of bare.csv are not shown" in outline(mixture).words


def test_same_input_same_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rendering is deterministic."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767323045")
    path = cases.drag(tmp_path)
    pages = [report([path], format="html").document for _ in range(2)]
    assert pages[0] == pages[1]


def test_hostile_texts_are_escaped(tmp_path: Path) -> None:
    """Markup in titles, labels, file names, checks and notices stays text."""
    evil = "</title></svg><script>alert('x')</script><img src=x onerror=alert(1)>\"'&"
    name = "a\"b'<i>.yaml"
    path = cases.drag(tmp_path, name)
    record = evidence.read(evidence.sidecar(path))
    figure = Figure(
        id=evil,
        title=evil,
        caption=evil,
        panels=[
            Panel(
                title=evil,
                x_label=evil,
                y_label="$\\frac{a}{b}$ " + evil,
                x_categories=[evil, "b"],
                traces=[Trace(x=[0.0, 1.0], y=[1.0, 2.0], label=evil, style="points")],
                marks=[evidence.Mark(at=1.0, label=evil)],
                spans=[evidence.Span(start=0, end=1, label=evil)],
            )
        ],
    )
    record = record.model_copy(
        update={
            "title": evil,
            "verdict": Verdict(level="good", text=evil),
            "checks": [Check(name=evil, value=evil, limit=evil, verdict="pass", text=evil)],
            "figures": [figure],
            "tables": [Table(id=evil, title=evil, columns=[evil], rows=[[evil]], caption=evil)],
            "notices": [evidence.NoticeRecord(code=evil, text=evil)],
            "methods": [evil],
            "references": [evil],
        }
    )
    evidence.write(evidence.sidecar(path), record)
    quietly(inputs=[path], output=tmp_path / "r.html", title=evil)
    parsed = outline(tmp_path / "r.html")
    assert not {"script", "i"} & {tag for tag, _ in parsed.tags}
    assert [a for tag, a in parsed.tags if tag == "img"] == []
    assert "alert('x')" in parsed.words
    markdown = quietly(inputs=[path], format="md", title=evil).text  # type: ignore[attr-defined]
    markdown = re.sub(r"(`+).*?\1", "", markdown)
    assert "<script" not in markdown
    assert "<img" not in markdown


# ---------------------------------------------------------------- evidence and result


def test_missing_evidence_is_said(tmp_path: Path) -> None:
    """The parameters are still shown, with a caution and SWM050."""
    path = cases.drag(tmp_path, proof=False)
    with pytest.warns(SwimidWarning, match=r"SWM050 the evidence file drag\.evidence\.json is missing"):
        report(inputs=[path], output=tmp_path / "r.html")
    words = outline(tmp_path / "r.html").words
    assert "0.705 ± 0.033" in words
    assert "Not identifiable: string_stiffness. No evidence file." in words


def _good(path: Path) -> None:
    """Give the evidence of a result a good verdict."""
    record = evidence.read(evidence.sidecar(path))
    good = record.model_copy(update={"verdict": Verdict(level="good", text="All well.", word="Explained")})
    evidence.write(evidence.sidecar(path), good)


@pytest.mark.parametrize(
    ("before", "after"), [("0.70512", "0.9"), ("2026-03-02T10:15:00", "2026-03-03T00:00:00")]
)
def test_a_file_that_was_edited_is_no_longer_good(before: str, after: str, tmp_path: Path) -> None:
    """A value that was changed by hand, or a file of another run, lowers the verdict and warns."""
    path = cases.drag(tmp_path)
    _good(path)
    path.write_text(path.read_text().replace(before, after))
    with pytest.warns(SwimidWarning, match=r"SWM052 drag\.yaml was edited or replaced after the evidence"):
        result = load_result(path)
    assert result.verdict == "caution"
    assert result.evidence is not None
    assert result.evidence.verdict.word == "Explained"
    quietly(inputs=[path], output=tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text()
    assert 'class="badge good"><span class="symbol" aria-hidden="true">✓</span>Good' not in text
    assert "The file was changed after this verdict" in text


def test_a_log_that_was_edited_is_no_longer_good(tmp_path: Path) -> None:
    path = cases.track(tmp_path)
    assert load_result(path).verdict == "good"
    path.write_text(path.read_text().replace("0.02,", "0.021,", 1))
    with pytest.warns(SwimidWarning, match="SWM052"):
        assert load_result(path).verdict == "caution"


def test_a_reformatted_file_keeps_its_evidence(tmp_path: Path) -> None:
    """Comments, the order of keys and line ends do not change the content of a file."""
    path = cases.drag(tmp_path)
    _good(path)
    blocks = re.split(r"(?m)^(?=\w)", path.read_text())
    text = "# fitted on Monday\n" + "".join([blocks[0], *reversed(blocks[1:])])
    path.write_bytes(text.replace("\n", "\r\n").encode())
    with warnings.catch_warnings():
        warnings.simplefilter("error", SwimidWarning)
        assert load_result(path).verdict == "good"


def test_equal_reasons_count_once_in_a_verdict() -> None:
    reasons = ["a", "a", "b", "c", "d"]
    checks = [evidence.make_check("n", "v", False, reason=reason) for reason in reasons]
    assert evidence.make_verdict("Answer.", checks).text == "Answer. 5 of 5 checks warn: a; b; c; d."


def test_simulated_data_are_named_at_the_top_of_a_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log says in its comments, or in its metadata, that it is simulated."""
    monkeypatch.chdir(tmp_path)
    time_s = np.arange(0, 1, 0.1)
    for name in ("a.csv", "a.parquet"):
        log.write(tmp_path / name, {"t_s": time_s, "x_m": time_s}, {"source": "simulated, with noise"})
    log.write(tmp_path / "b.csv", {"t_s": time_s, "x_m": time_s}, {"source": "pool"})
    held = log.read(tmp_path / "a.csv")
    block = collect([tmp_path / "a.csv", tmp_path / "a.parquet", tmp_path / "b.csv", held])
    assert block["simulated"] == ["a.csv", "a.parquet", "a.csv"]
    path = cases.drag(tmp_path)
    fitted = Fitted.load(path)
    assert fitted.evidence is not None
    shown = fitted.evidence.model_copy(update={"provenance": block})
    Fitted.of(fitted.file, shown).save(path)
    quietly(inputs=[path], output=tmp_path / "r.html")
    assert "Data simulated Model falling-weight" in outline(tmp_path / "r.html").words


def test_matching_evidence_survives_the_yaml(tmp_path: Path) -> None:
    """The provenance that went through YAML and through JSON counts as the same."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", SwimidWarning)
        result = load_result(cases.drag(tmp_path))
    assert result.verdict == "caution"
    assert result.content().title == "Drag and added mass of the boxfish"


def test_unconverged_without_evidence_is_bad(tmp_path: Path) -> None:
    """What the result alone says is enough for a verdict."""
    path = cases.drag(tmp_path, proof=False)
    file = parameters.read(path)
    assert file.fit is not None
    changed = file.model_copy(update={"fit": file.fit.model_copy(update={"converged": False})})
    changed.write(path)
    with record_warnings():
        assert load_result(path).content().verdict.level == "bad"


# ---------------------------------------------------------------- other kinds and errors


def _write(name: str, text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_text(text)
        return folder / name

    return make


def _broken_sidecar(folder: Path) -> Path:
    path = cases.drag(folder)
    evidence.sidecar(path).write_text('{"format": "swimid-evidence/1"')
    return path


def _uneven_trace(folder: Path) -> Path:
    path = cases.drag(folder)
    record = json.loads(evidence.sidecar(path).read_text())
    panel = {"x_label": "x", "y_label": "y", "traces": [{"x": [1.0, 2.0], "y": [1.0]}]}
    record["figures"] = [{"id": "odd", "title": "t", "caption": "c", "panels": [panel]}]
    evidence.sidecar(path).write_text(json.dumps(record))
    return path


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda folder: folder / "none.yaml", "cannot be read"),
        (_write("a.yaml", "format: swimid-parameter/1\n"), r"did you mean 'swimid-parameters/1'"),
        (_write("a.yaml", "model: x\n"), "has no 'format'"),
        (_write("a.yaml", "format: swimid-parameters/1\nmodel: x\n"), "parameters"),
        (_write("a.txt", "hello\n"), "the name must end in one of"),
        (_write("a.evidence.json", "{}"), "name the result: a.yaml"),
        (_write("a.csv", "x_m,y_m\n1,2\n"), "t_s"),
        (_broken_sidecar, r"drag\.evidence\.json"),
        (_uneven_trace, r"drag\.evidence\.json.*figures\.0\.panels\.0.*1 numbers of 'y' for 2 of 'x'"),
    ],
)
def test_broken_results_are_one_input_error(make: Callable[[Path], Path], text: str, tmp_path: Path) -> None:
    """Each names the file and what is wrong, and writes nothing."""
    with pytest.raises(InputError, match=text), record_warnings():
        report(inputs=[make(tmp_path)], output=tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_output_that_is_an_input_is_refused(tmp_path: Path) -> None:
    path = cases.drag(tmp_path)
    with pytest.raises(UsageError, match="also an input"):
        report(inputs=[path], output=path)


# ---------------------------------------------------------------- Markdown, command line


def test_markdown_tables_are_sound(tmp_path: Path) -> None:
    """Every row of a table has as many cells; pipes in texts are escaped."""
    path = cases.drag(tmp_path)
    record = evidence.read(evidence.sidecar(path))
    checks = [*record.checks, Check(name="|r| < 1", value="a|b", verdict="pass")]
    evidence.write(evidence.sidecar(path), record.model_copy(update={"checks": checks}))
    text = report(inputs=[path], format="md").text
    assert "| drag_coefficient | 0.705 ± 0.033 |" in text
    assert "**Figure: Residuals.**" in text
    tables = re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE)
    assert len(tables) >= 5
    for table in tables:
        widths = {len(re.findall(r"(?<!\\)\|", row)) for row in table.splitlines()}
        assert len(widths) == 1, table


def test_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The table of calls: arguments, exit status, what is said."""
    monkeypatch.chdir(tmp_path)
    cases.drag(tmp_path)
    run = CliRunner()
    table: list[tuple[list[str], int, str]] = [
        (["drag.yaml", "-o", "r.html"], 0, "caution"),
        (["drag.yaml", "--format", "md"], 0, "| Check |"),
        (["drag.yaml", "--format", "md", "-q"], 0, "| Check |"),
        (["drag.yaml", "-o", "r.md"], 0, "caution"),
        (["none.yaml", "-o", "r.html"], 3, "none.yaml: cannot be read"),
        ([], 2, "RESULT"),
    ]
    for arguments, code, text in table:
        result = run.invoke(main, ["report", *arguments])
        assert result.exit_code == code, (arguments, result.output)
        assert text in result.output, (arguments, result.output)
    assert (tmp_path / "r.md").read_text().startswith("# Drag and added mass")
    machine = json.loads(run.invoke(main, ["report", "drag.yaml", "--json"]).stdout)
    assert machine["ok"] is True
    assert machine["result"]["results"][0]["file"] == "drag.yaml"
    (tmp_path / "mine.html").write_text("<p>my own page</p>")
    assert run.invoke(main, ["report", "drag.yaml", "-o", "mine.html"]).exit_code == 2
    assert run.invoke(main, ["report", "drag.yaml", "-o", "mine.html", "--force"]).exit_code == 0


# ---------------------------------------------------------------- size and odd figures


@pytest.mark.slow
def test_twenty_full_figures_stay_small_and_quick(tmp_path: Path) -> None:
    """Twenty figures of four traces with the most points allowed: below 3 MB, in seconds."""
    rng = np.random.default_rng(5)
    time_s = np.linspace(0, 60, MAX_TRACE_POINTS)
    figures = []
    for number in range(20):
        wave = np.sin(2 * np.pi * (0.2 + 0.1 * number) * time_s)
        traces = [
            Trace(
                x=time_s,
                y=wave + rng.normal(0, 0.1, MAX_TRACE_POINTS),
                style="points",
                label="measured",
                group=0,
            ),
            Trace(x=time_s, y=wave, label="model", group=0),
            Trace(x=time_s, y=0.9 * wave, style="dashed", label="rival", group=1),
            Trace(x=time_s, y=0.1 * wave, label="difference", group=2),
        ]
        panel = Panel(x_label="time (s)", y_label="speed (m/s)", traces=traces)
        figures.append(Figure(id=f"f{number}", title=f"Trial {number}", caption="Good.", panels=[panel]))
    path = cases.drag(tmp_path)
    record = evidence.read(evidence.sidecar(path))
    evidence.write(evidence.sidecar(path), record.model_copy(update={"figures": figures}))
    start = time.perf_counter()
    report(inputs=[path], output=tmp_path / "r.html")
    seconds = time.perf_counter() - start
    size = (tmp_path / "r.html").stat().st_size
    assert size < 3_000_000, size
    # About 4 s on one core; the limit leaves room for a loaded machine.
    assert seconds < 60, seconds


def test_ordinary_page_is_below_three_megabytes(mixture: Path) -> None:
    assert mixture.stat().st_size < 3_000_000


def _panel(**options: object) -> Panel:
    return Panel(x_label="x", y_label="y", **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "panel",
    [
        _panel(traces=[]),
        _panel(traces=[Trace(x=[], y=[])]),
        _panel(traces=[Trace(x=[1.0], y=[2.0], style="points")]),
        _panel(traces=[Trace(x=[1.0, 2.0], y=[None, None])]),
        _panel(traces=[Trace(x=[1.0, 2.0], y=[0.0, -1.0])], y_scale="log"),
        _panel(traces=[Trace(x=[1.0, 2.0], y=[3e-9, 4e-9])], x_scale="log", y_scale="log"),
        _panel(traces=[Trace(x=[0.0, 0.0], y=[0.0, 0.0], style="points")], equal_aspect=True),
        _panel(traces=[Trace(x=[0.0, 1e-3], y=[0.0, 9.0])], equal_aspect=True, invert_y=True),
        _panel(traces=[Trace(x=[0.0, 1.0], y=[1e12, 1e12 + 1])]),
        _panel(traces=[Trace(x=[0.0, 1.0], y=[1.0, 2.0], style="stems")], x_categories=["a", "b" * 60]),
        _panel(
            traces=[Trace(x=[0.0, 1.0], y=[1.0, 2.0])],
            spans=[cases.Span(start=0.0, end=0.5, label=n) for n in "ab"],
        ),
    ],
)
def test_odd_panels_are_drawn(panel: Panel) -> None:
    """Empty, constant, missing, tiny and huge data give an SVG and no warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (svg,) = drawing.for_page(Figure(id="f", title="t", caption="c", panels=[panel]), "p")
    assert svg.endswith("</svg>")
    assert "NaN" not in svg


def test_long_traces_are_reduced_and_said(tmp_path: Path) -> None:
    """Evidence with more points than allowed is drawn as its envelope, and the caption says so."""
    path = cases.drag(tmp_path)
    x = np.arange(5000.0)
    y = np.sin(x / 50)
    y[2500] = 7.5
    figure = Figure(id="f", title="t", caption="c", panels=[_panel(traces=[Trace(x=x, y=y)])])
    record = evidence.read(evidence.sidecar(path))
    evidence.write(evidence.sidecar(path), record.model_copy(update={"figures": [figure]}))
    quietly(inputs=[path], output=tmp_path / "r.html")
    assert "Long traces are drawn as their envelope" in outline(tmp_path / "r.html").words


def test_every_point_of_a_cloud_is_drawn() -> None:
    """A cloud of dots has one dot per sample that is there."""
    rng = np.random.default_rng(7)
    y = rng.normal(size=400)
    y[10:20] = math.nan
    panel = _panel(traces=[Trace(x=np.arange(400.0), y=y, style="points")])
    (svg,) = drawing.for_page(Figure(id="f", title="t", caption="c", panels=[panel]), "p")
    cloud = max(re.findall(r' d="([^"]+)"', svg), key=len)
    assert cloud.count("M") == 390


def test_parquet_logs_are_read(tmp_path: Path) -> None:
    time_s = np.arange(0, 1, 0.1)
    log.write(tmp_path / "a.parquet", {"t_s": time_s, "x_m": time_s**2}, {"source": "rig"})
    with record_warnings():
        assert load_result(tmp_path / "a.parquet").content().facts["Samples"] == "10"


#: Machado, Oliveira and Fernandes (2009), severity 1.0, on linear RGB. doi:10.1109/TVCG.2009.113
VISION = {
    "normal": np.eye(3),
    "protan": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deutan": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritan": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def _linear(colour: str) -> np.ndarray:
    value = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def _lab(rgb: np.ndarray) -> np.ndarray:
    ratio = TO_XYZ @ np.clip(rgb, 0, 1) / np.array([0.9505, 1.0, 1.089])
    f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_palette_is_told_apart(scheme: str) -> None:
    """Every pair differs by 10 in CIELAB for each kind of vision; 3 to 1 against the page (WCAG 1.4.11)."""
    css = (Path(drawing.__file__).parent / "templates" / "report.css").read_text()
    block = css.split("@media")[["light", "dark"].index(scheme)]
    colours = [_linear(colour) for colour in re.findall(r"--s\d: (#\w{6})", block)]
    assert len(colours) == 6
    paper = _linear(re.search(r"--paper: (#\w{6})", block)[1])  # type: ignore[index]
    for index, colour in enumerate(colours):
        bright = sorted([TO_XYZ[1] @ colour, TO_XYZ[1] @ paper])
        assert (bright[1] + 0.05) / (bright[0] + 0.05) > 3.0
        for matrix in VISION.values():
            for other in colours[:index]:
                assert np.linalg.norm(_lab(matrix @ colour) - _lab(matrix @ other)) > 10


def test_a_null_or_an_empty_list_is_a_dash() -> None:
    """No cell of a table of details is empty; records within a list are numbered."""
    entries = {"a": None, "b": [], "c": "", "d": {"e": [1.0, 2.5]}, "f": 0.0, "g": [{"h": 1}, {"h": 2}]}
    found = {name: cell_text(value) for name, value in evidence.leaves(entries)}
    expected = {"a": "–", "b": "–", "c": "–", "d.e": "1.0, 2.5", "f": "0", "g[1].h": "1", "g[2].h": "2"}
    assert found == expected


def test_fits_of_one_model_stand_side_by_side(tmp_path: Path) -> None:
    """One table and one figure with the estimates of each file; the fits themselves are folded."""
    days = [cases.drag(tmp_path, f"day{k}.yaml") for k in (1, 2)]
    quietly(inputs=days, output=tmp_path / "r.html")
    words = outline(tmp_path / "r.html").words
    assert "2 fits of" in words
    assert "parameter day1 day2 drag_coefficient 0.705 ± 0.033 0.705 ± 0.033" in words
    text = (tmp_path / "r.html").read_text()
    assert text.index("side by side</h2>") < text.index("<summary>Drag and added mass")


def test_a_parameter_that_is_not_identified_is_no_number_side_by_side(tmp_path: Path) -> None:
    first, second = (cases.drag(tmp_path, f"day{k}.yaml") for k in (1, 2))
    file = parameters.read(second)
    unknown = file.parameters["added_mass"].model_copy(update={"status": "unidentifiable"})
    file.model_copy(update={"parameters": {**file.parameters, "added_mass": unknown}}).write(second)
    quietly(inputs=[first, second], output=tmp_path / "r.html")
    assert "added_mass 0.685 ± 0.037 kg – pulley" in outline(tmp_path / "r.html").words


def test_fits_with_other_parameters_or_units_are_not_compared(tmp_path: Path) -> None:
    """A result that has no place in the table would be hidden, and an axis would have two units."""
    path = cases.drag(tmp_path)
    file = parameters.read(path)
    other = {**file.parameters, "added_mass": file.parameters["added_mass"].model_copy(update={"unit": "g"})}
    file.model_copy(update={"parameters": other}).write(tmp_path / "grams.yaml")
    fewer = {name: e for name, e in file.parameters.items() if name != "added_mass"}
    without = {"parameters": fewer, "correlation": parameters.Correlation(names=[], matrix=[])}
    file.model_copy(update=without).write(tmp_path / "fewer.yaml")
    inputs = [path, tmp_path / "grams.yaml", tmp_path / "fewer.yaml"]
    quietly(inputs=inputs, output=tmp_path / "r.html")
    assert "fits of" not in outline(tmp_path / "r.html").words


def test_a_terminal_line_has_at_most_100_characters(tmp_path: Path) -> None:
    for path in (cases.drag(tmp_path), cases.arma(tmp_path)):
        assert max(map(len, load_result(path).summary().splitlines())) <= 100


# ---------------------------------------------------------------- what the head of a page says


def _of_model(name: str, level: str, params: str, *inputs: str) -> Result:
    """A comparison of trials with the model of a parameter file."""
    proof = Evidence(
        command="compare",
        title="Measured against simulated: tfish, free-swim",
        verdict=Verdict(level=level, text=f"The error of {name}."),  # type: ignore[arg-type]
        provenance={"inputs": {one: f"sha of {one}" for one in (params, *inputs)}},
    )
    document = SimpleNamespace(params=params)
    return Result("compare", "", {}, [Path(name)], evidence=proof, document=document)


def _diagnosis(gap: GapFile, *inputs: str) -> Diagnosis:
    made = Diagnosis.of(gap, gap_cases.evidence(gap))
    origin = {"inputs": {one: f"sha of {one}" for one in inputs}}
    assert made.evidence is not None
    proof = made.evidence.model_copy(update={"provenance": origin})
    return dataclasses.replace(made, evidence=proof, outputs=[Path("gap.yaml")])


class TestHead:
    """The head of a page says what a diagnosis found, and cards of several models differ."""

    OLD = _of_model("comparison.yaml", "bad", "march.yaml", "trials.yaml")
    NEW = _of_model("repaired-comparison.yaml", "good", "repaired.yaml", "trials.yaml")

    def test_a_gap_that_is_explained_is_no_bad_page(self) -> None:
        found = _diagnosis(gap_cases.EXPLAINED, "march.yaml", "trials.yaml")
        page = quietly(inputs=[found, self.NEW, self.OLD])
        verdict = page.data["verdict"]
        assert (verdict["level"], verdict["word"]) == ("good", "Explained")
        assert verdict["text"].startswith("servo-backlash")
        assert verdict["text"].endswith("Before the repair: comparison.yaml.")

    def test_other_bad_results_still_count(self) -> None:
        found = _diagnosis(gap_cases.EXPLAINED, "march.yaml", "trials.yaml")
        other = _of_model("tuesday.yaml", "bad", "march.yaml", "tuesday-trials.yaml")
        verdict = quietly(inputs=[found, self.NEW, self.OLD, other]).data["verdict"]
        assert (verdict["level"], verdict["word"]) == ("bad", "")
        assert "1 of 3 results should not be used. Bad: tuesday.yaml." in verdict["text"]

    def test_a_gap_that_is_not_explained_excuses_nothing(self) -> None:
        found = _diagnosis(gap_cases.UNEXPLAINED, "march.yaml", "trials.yaml")
        verdict = quietly(inputs=[found, self.OLD]).data["verdict"]
        assert verdict["level"] == "bad"
        assert "Bad: gap.yaml, comparison.yaml." in verdict["text"]

    def test_without_a_diagnosis_the_doubtful_results_are_named(self) -> None:
        verdict = quietly(inputs=[self.NEW, self.OLD]).data["verdict"]
        assert verdict["text"] == "1 of 2 results should not be used. Bad: comparison.yaml."

    def test_titles_name_the_parameter_file_or_else_the_result(self) -> None:
        again = _of_model("again.yaml", "good", "march.yaml", "tuesday-trials.yaml")
        page = quietly(inputs=[self.OLD, self.NEW, again]).document
        titles = re.findall(r'<a href="#r\d+">(Measured.*?)</a></p>', page)
        start = "Measured against simulated: tfish, free-swim"
        ends = ("march.yaml, comparison.yaml", "repaired.yaml", "march.yaml, again.yaml")
        assert titles == [f"{start}, {end}" for end in ends]


@pytest.mark.parametrize(
    "heights, said",
    [
        ((1.0,), "Both axes have the same scale."),
        ((0.05,), "The vertical axis is magnified"),
        ((1.0, 0.05), "unless the title says that one is magnified"),
    ],
)
def test_the_caption_of_a_path_says_how_it_is_drawn(heights: tuple[float, ...], said: str) -> None:
    panels = [_panel(traces=[Trace(x=[0.0, 1.0], y=[0.0, high])], equal_aspect=True) for high in heights]
    figure = Figure(id="path", title="Path", caption="The path.", panels=panels)
    proof = Evidence(command="import", title="t", verdict=Verdict(level="good", text="x"), figures=[figure])
    page = quietly(inputs=[Result("import", evidence=proof)]).document
    assert said in page.partition("<figcaption")[2]
    assert ("magnified</text>" in page) == (min(heights) < 0.1)
