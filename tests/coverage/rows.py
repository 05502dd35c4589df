"""Rows of the table: entries of a result that a measurement counts."""

from __future__ import annotations

from typing import Any

ALARM = "alarm"


def inside(estimate: dict[str, Any], true: float) -> float:
    """Return 1 if the 95 % interval of an estimate holds the true value, and 0 otherwise."""
    return float(abs(estimate["value"] - true) <= 1.96 * estimate["stderr"])


def alarms(name: str, result: Any) -> dict[str, float]:
    """Return for each check of a result whether it warns or fails, and whether the verdict is not good."""
    found = {
        f"{name}: {ALARM} {c.name}": float(c.verdict in ("warn", "fail")) for c in result.evidence.checks
    }
    return {**found, f"{name}: {ALARM} verdict": float(result.verdict != "good")}
