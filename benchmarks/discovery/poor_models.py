"""Search from a model that lacks one or two of the friction laws of a body.

    python benchmarks/discovery/poor_models.py --runs 40
    python benchmarks/discovery/poor_models.py --table

A body of 2e-3 kg m2 is slowed down by two or three of dry friction, linear and quadratic drag, drawn by lot with their
shares, the duration, the initial speed, the number of samples and the measured quantity. SciPy integrates the motion.
The first model has some of these laws. `improve` continues from it; its last model is compared with the true one.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from answer import commit
from judge import Share
from lines import run_each
from scipy.integrate import solve_ivp
from tabular import table

from fitting import Case, fit, improve

RESULTS = Path(__file__).parent / "poor_models.jsonl"
INERTIA = 2e-3
# the torque is -k omega^power
POWERS = {"touchpoint.constant": 0, "casing.air.linear": 1, "casing.air.quadratic": 2}
ENDS = ("the true laws", "other laws, BIC not higher", "other laws, BIC higher", "a lack of fit")
EQUAL = 2.0  # difference of BIC that is not worth more than a bare mention (Kass & Raftery 1995)


def recorded(number: int) -> tuple[Case, list[str], list[str]]:
    """Return a recording, its laws, and those of the first model."""
    draw = np.random.default_rng(number)
    speed, span = (float(np.exp(draw.uniform(*np.log(ends)))) for ends in ((10.0, 600.0), (5.0, 300.0)))
    laws = [str(x) for x in draw.choice(list(POWERS), int(draw.integers(2, 4)), replace=False)]
    shares = draw.dirichlet(np.full(len(laws), 2.0)) + 0.05
    total = INERTIA * speed / span * draw.uniform(0.7, 2.5)
    strengths = [share * total / speed ** POWERS[law] for law, share in zip(laws, shares, strict=True)]

    def rates(_t: float, y: np.ndarray) -> list[float]:
        torque = sum(k * y[0] ** POWERS[law] for law, k in zip(laws, strengths, strict=True))
        return [-torque / INERTIA if y[0] > 1e-3 * speed else 0.0, y[0]]

    def slow(_t: float, y: np.ndarray) -> float:
        return float(y[0] - 1e-2 * speed)

    slow.terminal = True  # type: ignore[attr-defined]
    quantity, u = ("angle", 3e-3) if draw.random() < 0.6 else ("omega", 3e-3 * speed)
    motion = solve_ivp(
        rates, (0.0, span), [speed, 0.0], events=slow, rtol=1e-10, atol=1e-9, dense_output=True
    )
    time = np.linspace(0.0, motion.t[-1], int(draw.integers(300, 6000)))
    exact = motion.sol(time)[1 if quantity == "angle" else 0]
    first = [str(x) for x in draw.choice(laws, int(draw.integers(1, len(laws))), replace=False)]
    series = {"t": time, quantity: exact + u * draw.standard_normal(len(time)), "u": u, "inertia": INERTIA}
    return Case.from_arrays(wheel=series), laws, first


def answer(kind: str, number: int, folder: Path) -> dict[str, Any]:
    """Return the laws of the last model, its verdict, and its BIC minus that of the true model."""
    case, laws, first = recorded(number)
    last = improve(fit(first, case))[-1].fit
    excess = last.bic - fit(laws, case).bic
    if set(last.model.names) == set(laws):
        end = ENDS[0]
    elif last.verdict == "lack_of_fit":
        end = ENDS[3]
    else:
        end = ENDS[1] if excess < EQUAL else ENDS[2]
    found = {"laws": laws, "first": first, "last": [*last.model.names], "end": end, "excess": excess}
    return found | {"sentence": f"{end}: {', '.join(last.model.names)}", "commit": commit()}


def report(lines: list[dict[str, Any]]) -> str:
    """Return the table: how the searches end, by the number of missing laws."""
    rows = []
    for missing in (1, 2):
        some = [x for x in lines if len(x["laws"]) - len(x["first"]) == missing]
        rows.append([missing, len(some), *(Share(x["end"] == end for x in some) for end in ENDS)])
    return table(["missing laws", "runs", *ENDS], rows)


if __name__ == "__main__":
    run_each(__doc__, RESULTS, ("one body",), answer, report)
