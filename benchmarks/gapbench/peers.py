"""``python -m benchmarks.gapbench.peers NAME diagnose ...``: a peer in the place of ``swimid diagnose``.

It writes the part of a gap file that answers are read from. Any other command goes to swimid.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swimid.diagnosis import nominal
from swimid.diagnosis.options import DiagnoseOptions
from swimid.fitting.model import Model, Trial
from swimid.simulation import catalogue as experiments

#: Strong evidence against what has a BIC larger by this (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995).
STRONG = 6.0


class Case(NamedTuple):
    """A case as the peers see it: a model whose coefficients are free, what is known of them, and trials.

    Attributes
    ----------
    model : Model
    trials : list of Trial
        Those of role ``fit``; the peers hold nothing out.
    prior : dict of name to (mean, sd)
    """

    model: Model
    trials: list[Trial]
    prior: dict[str, tuple[float, float]]


def case(trials: Path, params: Path) -> Case:
    """What files tell, as ``swimid diagnose`` takes them."""
    loaded = experiments.load(trials, DiagnoseOptions(params=params))
    begun = nominal.prepare_diagnosis(loaded)
    return Case(loaded.experiment.model, [t for t in begun.trials if t.role == "fit"], begun.prior)


def verdict(rounds: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """The answer that the BIC of hypotheses gives.

    Parameters
    ----------
    rounds : sequence of mapping of str to float
        BIC of the model with each effect added; under ``""`` that of the model as it was. The effect of the
        least BIC stays for the next round; in the last one nothing is better than nothing.

    Returns
    -------
    dict
        Of a gap file: ``verdict`` and ``causes``.
    """
    causes = []
    for bic in rounds:
        best = min(bic, key=bic.__getitem__)
        if best == "":
            break
        weights = {name: float(np.exp(-0.5 * (value - bic[best]))) for name, value in bic.items()}
        near = [n for n in sorted(bic, key=bic.__getitem__) if n and bic[n] - bic[best] < STRONG]
        probability = sum(weights[n] for n in near) / sum(weights.values())
        causes.append({"effect": near[0], "equivalent": near[1:], "probability": probability})
    return gap(causes)


def gap(causes: Sequence[Mapping[str, Any]], *, otherwise: str = "none") -> dict[str, Any]:
    """Return the part of a gap file that states causes, or the verdict ``otherwise`` without any."""
    told = otherwise
    if causes:
        told = "ambiguous" if causes[0]["equivalent"] else "explained"
    return {"verdict": told, "causes": list(causes), "where": {"channels": []}}


def main(argv: Sequence[str]) -> None:
    """Diagnose a case, or hand the command on."""
    name, verb, *words = argv
    if verb != "diagnose":
        from swimid.cli.main import entry

        sys.argv = ["swimid", verb, *words]
        entry()
        return
    parser = argparse.ArgumentParser(prog=f"peers {name} diagnose")
    parser.add_argument("trials", type=Path)
    parser.add_argument("--params", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--no-progress", action="store_true", help="ignored: peers show no progress")
    parser.add_argument("--jobs", help="ignored: peers use one process")
    chosen = parser.parse_args(words)
    peer = import_module(f"benchmarks.gapbench.{name}")
    found = peer.diagnose(case(chosen.trials, chosen.params))
    chosen.output.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
