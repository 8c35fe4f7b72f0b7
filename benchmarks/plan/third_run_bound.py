"""What a third run can add to two recordings with two effects at once, for an ideal method.

    python benchmarks/plan/third_run_bound.py [--runs 64]

The ideal method knows the noise, the shape constants and strengths of both effects, and compares them with one rival at
a time. It names both effects with a probability of at most

    prod_i P(chi2(1, D_i) > threshold) Phi(sqrt(R_i) / 2),

with the noncentrality D_i of effect i beside the base and the other effect, and the smallest R_i that remains beside
any further effect of the library at any of its shapes (`benchmarks/discovery/judge.py`: two recordings). The Fisher
information of the two recordings and of many possible third runs is that of `fitting.discovery._information`, about a
base without hidden effects. Effects of the casing's angle are not in it: they keep the numbers of the two recordings.

Printed for several bounds of the runs: the mean over all pairs for the best run of each pair, for the single run
that is best on average, and for the run of the largest mean gain in information, which `plan` proposes without rivals.
"""

from __future__ import annotations

import argparse
import gzip
import itertools
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import ncx2, norm, qmc

_DISCOVERY = Path(__file__).resolve().parents[1] / "discovery"
sys.path.insert(0, str(_DISCOVERY))

from hidden import twins
from judge import _IDEAL_ALARMS, _IDEAL_CANDIDATES, bound, power
from oracle import _shape, _strength
from plan import NOISE, Planned
from plan import plan as runs_of_discovery

from fitting import Model, fit, make_record
from fitting._criteria import DEFAULT
from fitting._errors import FittingError
from fitting.discovery._information import Information, Run, schur
from fitting.discovery._next_run import Bounds, _Criterion
from fitting.effects._library import LIBRARY, REDUCED

_MOST_SHAPES = 6
_THRESHOLD = float(norm.isf(_IDEAL_ALARMS / _IDEAL_CANDIDATES / 2)) ** 2
_SMALLEST = 1e-9


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=64)
    count = parser.parse_args().runs
    nothing = Planned("pair", (), 0.03, 2, NOISE, 0)
    base = fit(Model.of(REDUCED), [make_record(**r) for r in nothing.records()])
    candidates = _candidates(base.problem.data[0].record.span[1])
    information = Information(base, candidates)
    runs, added = _possible(information, count)
    with gzip.open(_DISCOVERY / "results.jsonl.gz", "rt") as stream:
        known = {x["key"]: x for x in map(json.loads, stream)}
    pairs = [r for r in runs_of_discovery(4, ("pair",)) if r.noise == NOISE]
    reach = _Reach(information, candidates)
    pairs = [r for r in pairs if r.key in known or reach.knows(r)]
    two = [reach(information.present, r, known.get(r.key)) for r in pairs]
    repeated = [reach(1.5 * information.present, r, known.get(r.key)) for r in pairs]
    after = np.array([[reach(information.present + a, r, known.get(r.key)) for a in added] for r in pairs])
    measured = [bound(known[r.key]) for r in pairs if r.key in known]
    print(f"{len(pairs)} pairs, {len(runs)} runs; two recordings {np.mean(two):.0%}", end=" ")
    print(f"(of the recordings themselves {np.mean(measured):.0%}), one repeated {np.mean(repeated):.0%}")
    criterion = _Criterion(information, [], DEFAULT)
    gain = np.array([criterion(information.present + a) for a in added])
    print(
        "| third run | best of each pair | best on average | largest gain in information |\n|---|---|---|---|"
    )
    for words, allowed in _BOUNDS.items():
        places = np.flatnonzero([allowed(r) for r in runs])
        mean = after[:, places].mean(axis=0)
        chosen = places[np.argmax(gain[places])]
        average = f"{mean.max():.0%} ({_named(runs[places[mean.argmax()]])})"
        most = f"{after[:, chosen].mean():.0%} ({_named(runs[chosen])})"
        print(f"| {words} | {after[:, places].max(axis=1).mean():.0%} | {average} | {most} |")


_BOUNDS: dict[str, Callable[[Run], bool]] = {
    "casing spun with the rotor": lambda r: r.omega_casing > 0,
    "casing spun in either sense": lambda r: True,
}


def _named(run: Run) -> str:
    return f"rotor {run.omega_rotor:.0f}, casing {run.omega_casing:.0f} rad/s, {run.duration:.0f} s"


def _candidates(span: float) -> list[tuple[Any, dict[str, float]]]:
    """Return all effects of the library that a smooth torque has, each at some of its shapes."""
    found = []
    for e in LIBRARY.values():
        if e.name in REDUCED or not e.searched or e.depends_on_angle or e.restoring or not e.mechanical:
            continue
        shapes = [p for p in e.parameters if p.role == "shape"]
        grids = [[g * (span if p.relative else 1) for g in (p.grid or (p.start,))] for p in shapes]
        choices = list(itertools.product(*grids))
        tried = choices[:: max(1, len(choices) // (_MOST_SHAPES - 1))]
        found += [(e, dict(zip([p.symbol for p in shapes], choice, strict=True))) for choice in tried]
    return found


def _possible(information: Information, count: int) -> tuple[list[Run], list[np.ndarray]]:
    """Return quasi-random runs within the usual bounds, of the present apparatus, and the information of each."""
    usual, record = Bounds.of(information.fit), information.fit.problem.data[0].record
    length = float(np.median([w.time[-1] - w.time[0] for w in record.rotor]))
    windows = len(record.rotor)
    runs, added = [], []
    for x in qmc.Sobol(3 + windows, seed=1).random(count):
        rotor, casing, duration = (
            low + u * (high - low)
            for u, (low, high) in zip(
                x, (usual.omega_rotor, usual.omega_casing, usual.duration), strict=False
            )
        )
        starts = np.sort(x[3:]) * (duration - windows * length) + np.arange(windows) * length
        run = Run(rotor, casing, duration, tuple(starts.tolist()), length)
        try:
            found, _ = information.of_run(run)
        except FittingError:
            continue
        if np.isfinite(found).all():
            runs.append(run)
            added.append(found)
    return runs, added


class _Reach:
    """Probability at which an ideal method names both effects of a pair."""

    def __init__(self, information: Information, candidates: list[tuple[Any, dict[str, float]]]) -> None:
        self._information, self._candidates = information, candidates
        self._where: dict[str, list[int]] = {}
        for i, (e, _) in enumerate(candidates):
            self._where.setdefault(e.name, []).append(i)

    def knows(self, pair: Planned) -> bool:
        """Return whether both effects are smooth torques."""
        return all(n in self._where for n in pair.hidden)

    def __call__(self, total: np.ndarray, pair: Planned, measured: dict[str, Any] | None) -> float:
        """Return the probability for some information; `measured` has the numbers of the two recordings."""
        result = 1.0
        for i, name in enumerate(pair.hidden):
            if name not in self._where and measured is not None:
                result *= power(measured, i) * float(norm.cdf(measured["sigma"][i][2] / 2))
                continue
            whole, apart = self._distances(total, pair, i)
            result *= float(ncx2.sf(_THRESHOLD, 1, max(whole, _SMALLEST)))
            result *= float(norm.cdf(math.sqrt(max(apart, 0.0)) / 2))
        return result

    def _distances(self, total: np.ndarray, pair: Planned, i: int) -> tuple[float, float]:
        """Return the noncentrality of an effect beside the other one, and beside the nearest rival as well."""
        name, other = pair.hidden[i], pair.hidden[1 - i]
        effect, world = LIBRARY[name], pair.worlds_of(name)[0]
        strength, own = np.array(_strength(effect, world)), self._columns(name, _shape(effect, world))
        free = list(range(self._information.parameters))
        if other in self._where:
            free += self._columns(other, _shape(LIBRARY[other], pair.worlds_of(other)[0]))
        whole = float(strength @ schur(total, own, free) @ strength)
        apart = whole
        for rival, places in self._where.items():
            if rival in twins(name) or rival == other:
                continue
            for k in places:
                left = schur(total, own, [*free, *self._information.places(k)])
                apart = min(apart, float(strength @ left @ strength))
        return whole, apart

    def _columns(self, name: str, shape: dict[str, float]) -> list[int]:
        """Return the columns of an effect at the shape of the grid that is nearest."""

        def distance(i: int) -> float:
            tried = self._candidates[i][1]
            return sum(abs(math.log((tried[k] + _SMALLEST) / (v + _SMALLEST))) for k, v in shape.items())

        return self._information.places(min(self._where[name], key=distance))


if __name__ == "__main__":
    main()
