"""Record which tests execute which lines: ``python -m validation.mutants.recorder OUT [FILE ...]``.

The working folder is the root of the tree. Without files all tests run that are not marked slow.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
from coverage import Coverage

import swimid


class Recorder:
    """Plugin of pytest that switches the coverage context with each phase of each test.

    Attributes
    ----------
    tests : dict
        By test: its durations by phase in seconds, and whether it passed.
    """

    def __init__(self, coverage: Coverage) -> None:
        self.coverage = coverage
        self.tests: dict[str, dict[str, Any]] = {}

    def _enter(self, item: pytest.Item, phase: str) -> Generator[None, Any, Any]:
        self.coverage.switch_context(f"{item.nodeid}|{phase}")
        result = yield
        self.coverage.switch_context("")
        return result

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Generator[None, Any, Any]:
        return (yield from self._enter(item, "setup"))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, Any, Any]:
        return (yield from self._enter(item, "call"))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        test = self.tests.setdefault(report.nodeid, {"setup": 0.0, "call": 0.0, "passed": True})
        test[report.when or "call"] = round(report.duration, 3)
        test["passed"] &= report.passed


def record(out: Path, files: list[str]) -> None:
    """Run the tests of some files, or all, and write tests and lines as JSON."""
    coverage = Coverage(data_file=None, source=["swimid"], config_file=False)
    recorder = Recorder(coverage)
    # a module that the first test imports would be executed by that test alone
    for module in pkgutil.walk_packages(swimid.__path__, "swimid."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    coverage.start()
    pytest.main(["-q", "-p", "no:cacheprovider", *files], plugins=[recorder])
    coverage.stop()
    data = coverage.get_data()
    root, lines = Path.cwd(), {}
    for path in data.measured_files():
        by_line = {
            line: sorted(context for context in contexts if context)
            for line, contexts in data.contexts_by_lineno(path).items()
        }
        lines[Path(path).relative_to(root).as_posix()] = by_line
    number = {test: i for i, test in enumerate(recorder.tests)}
    for by_line in lines.values():
        for line, contexts in by_line.items():
            # twice the number of the test, and one more where its set-up executes the line
            found = [context.rsplit("|", 1) for context in contexts]
            by_line[line] = [number[test] * 2 + (phase == "setup") for test, phase in found if test in number]
    out.write_text(json.dumps({"tests": recorder.tests, "lines": lines}))


if __name__ == "__main__":
    record(Path(sys.argv[1]), sys.argv[2:])
