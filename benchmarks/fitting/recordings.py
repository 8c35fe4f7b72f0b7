"""The recordings of these benchmarks, made by the tests' own oracle: nothing of `fitting` has a part in them."""

from __future__ import annotations

import sys
from functools import lru_cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "fitting"))

import twobody

from fitting.inference._record import Record, make_record

# three runs of one gyroscope on three surfaces: friction of the touch point, drag, start, length, noise
RUNS = {
    "glass": ({}, (900.0, 5.0), 200.0, 0.0),
    "steel": ({"b1": 2.4e-5, "b2": 8.1e-7}, (740.0, 12.0), 160.0, 0.0),
    "rubber": ({"b1": 4.5e-5, "b2": 9.5e-7}, (950.0, 8.0), 180.0, 1e-7),
}


def truth(name: str) -> dict[str, float]:
    """Return the true parameters of a run by the names of a fit."""
    par, start, _, _ = RUNS[name]
    return twobody.truth({**twobody.PAPER, **par}, start, name)


@lru_cache(maxsize=8)
def recording(name: str, seed: int = 0, rate: float = 260.0, hidden: twobody.Hidden | None = None) -> Record:
    """Return one run as arrays: angles with 1e-3 rad of noise, three rotor windows of 3 s at 1000 Hz."""
    par, start, span, ou = RUNS[name]
    motion = twobody.simulate({**twobody.PAPER, **par}, start, span, hidden=hidden, ou=ou, seed=seed)
    windows = tuple(round(share * span) for share in (0.025, 0.35, 0.75))
    cameras = twobody.Cameras(span=span, windows=windows, casing_rate=rate)
    return make_record(**twobody.film(motion, seed=seed, cameras=cameras, label=name))
