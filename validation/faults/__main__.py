"""``python -m validation.faults``: run every attack, and print the table of counts."""

from __future__ import annotations

import argparse
import importlib
import os
import pkgutil
import sys
import time

from validation import faults
from validation.faults import runner


def main() -> int:
    """Run the attacks; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m validation.faults", description=__doc__)
    parser.add_argument("--inputs", type=int, default=1000, help="number of inputs of each reader")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="run the attacks whose names contain this text")
    chosen = parser.parse_args()
    os.environ["SWIMID_LANES"] = "never"
    attacks: list[runner.Attack] = []
    for module in pkgutil.iter_modules(faults.__path__, "validation.faults."):
        if not module.name.endswith("__main__"):
            attacks += getattr(importlib.import_module(module.name), "ATTACKS", [])
    attacks = [attack for attack in attacks if chosen.only in attack.name]
    began = time.monotonic()
    found = runner.run(attacks, chosen.inputs, chosen.seed, chosen.jobs)
    print("| attack | inputs | refused | accepted | findings |\n|---|---:|---:|---:|---:|")
    for counts in found:
        print(counts.row())
    findings = [text for counts in found for text in counts.findings]
    print(f"\n{sum(c.outcomes.total() for c in found)} inputs in {time.monotonic() - began:.0f} s, ", end="")
    print(f"{len(findings)} findings, seed {chosen.seed}")
    return min(len(findings), 1)


if __name__ == "__main__":
    sys.exit(main())
