"""How long ``swimid --help`` takes over a bare interpreter.

python benchmarks/bench_startup.py
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time


def seconds(*words: str, repeats: int = 9) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        subprocess.run([sys.executable, *words], check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def main() -> None:
    bare = seconds("-c", "pass")
    print(f"{'command':<28}{'wall s':>9}{'over bare':>11}")
    for name, words in (
        ("python -c pass", ["-c", "pass"]),
        ("swimid --help", ["-m", "swimid", "--help"]),
        ("swimid fit-drag --help", ["-m", "swimid", "fit-drag", "--help"]),
        ("swimid --version", ["-m", "swimid", "--version"]),
    ):
        wall = seconds(*words)
        print(f"{name:<28}{wall:9.3f}{wall - bare:11.3f}")


if __name__ == "__main__":
    main()
