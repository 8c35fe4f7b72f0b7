"""Which runs there are, in the order in which they are worth having, and how each is made from its key alone."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from elsewhere import budget, gyroscopes
from experiment import BUDGET, CASES, Hidden, record, together
from foreign import FOREIGN
from hidden import BASE, FAULTS, LIBRARY, OUTSIDE, Draw, Maker

PARTS = ("library", "nothing", "fault", "outside", "pair", "brief", "elsewhere", "strong", "foreign")
# parts with gyroscopes, strength, recordings and random torque by lot
BY_LOT = ("elsewhere", "strong")
STRENGTHS = (0.01, 0.03, 0.003)
NOISE = 1e-7  # N m
# how long a random torque remembers itself; in the runs called brief it is over sooner
_NOISE_TIME, _BRIEF = 1.0, 0.1  # s
CENTRE = (2e-3, 1.1)  # rad, phase: in every noisy recording
_PAIRS_A_SEED = 12
_EMPTY_A_SEED = 4
_PAIRS_ELSEWHERE = 6
# by lot: strengths and random torques as shares of the budget, and correlation times [s]
_DRAWN = {"elsewhere": (0.003, 0.03), "strong": (0.03, 0.3)}
_UNREST, _MEMORIES = (1e-4, 2e-3), (0.05, 5.0)
_MAKERS: dict[str, Maker] = {**LIBRARY, **BASE, **OUTSIDE, **FOREIGN, **FAULTS}


@dataclass(frozen=True)
class Planned:
    """One run: what is hidden, how strong, in how many recordings, with which random torque [N m]."""

    part: str
    hidden: tuple[str, ...]
    strength: float
    cases: int
    noise: float
    seed: int

    @property
    def key(self) -> str:
        """Return the name of the run, from which all its random numbers come."""
        what = " & ".join(self.hidden) or "nothing"
        return f"{self.part}|{what}|{self.strength:g}|{self.cases}|{self.noise:g}|{self.seed}"

    def worlds(self) -> list[Hidden]:
        """Return what is hidden in each recording, with the camera's fault of a noisy one."""
        camera = [Hidden(centre=CENTRE)] if self.noise else []
        alone = [self.worlds_of(name) for name in self.hidden]
        return [together([*camera, *(w[i] for w in alone)]) for i in range(self.cases)]

    def worlds_of(self, name: str) -> list[Hidden]:
        """Return one effect alone, in each recording."""
        name_seed = zlib.crc32(name.encode())
        found = []
        for i, case in enumerate(self.gyroscopes[: self.cases]):
            shared = np.random.default_rng([self._seed, 0, name_seed])
            own = np.random.default_rng([self._seed, 1, name_seed, i])
            draw = Draw.of(case["span"], shared, own)
            found.append(_MAKERS[name](self.strength * budget(self.gyroscopes[0]), draw))
        return found

    @property
    def noise_time(self) -> float:
        """Return the correlation time of the random torque [s]."""
        if self.part in BY_LOT:
            return float(np.exp(np.random.default_rng([self._seed, 4]).uniform(*np.log(_MEMORIES))))
        return _BRIEF if self.part == "brief" else _NOISE_TIME

    @cached_property
    def gyroscopes(self) -> tuple[dict[str, Any], ...]:
        """Return what is filmed, and how."""
        return gyroscopes(np.random.default_rng([self._seed, 3])) if self.part in BY_LOT else CASES

    @property
    def seed_of_plan(self) -> int:
        """Return the seed of the plan that the run belongs to: each has several empty runs."""
        return self.seed // _EMPTY_A_SEED if self.part == "nothing" else self.seed

    def records(self) -> list[dict[str, Any]]:
        """Return the recordings, as `make_record` takes them."""
        return [
            record(
                case,
                world,
                torque_noise=self.noise,
                torque_time=self.noise_time,
                rng=np.random.default_rng([self._seed, 2, i]),
                label=f"case{i + 1}",
            )
            for i, (case, world) in enumerate(zip(self.gyroscopes, self.worlds(), strict=False))
        ]

    @property
    def _seed(self) -> int:
        return zlib.crc32(self.key.encode())


def plan(seeds: int, parts: tuple[str, ...] = PARTS) -> list[Planned]:
    """Return the plan: seed by seed, so that it can be stopped anywhere, and what the figures need first."""
    runs = [r for part in PARTS if part in parts for s in range(seeds) for r in _PLANS[part](s)]
    return sorted(runs, key=lambda r: (r.seed_of_plan, -r.cases, _turn(r.strength), PARTS.index(r.part)))


def _turn(strength: float) -> int:
    return STRENGTHS.index(strength) if strength in STRENGTHS else len(STRENGTHS)


def _library(seed: int) -> Iterator[Planned]:
    for x, cases, noise, name in itertools.product(STRENGTHS, (2, 1), (0.0, NOISE), (*LIBRARY, *BASE)):
        yield Planned("library", (name,), x, cases, noise, seed)


def _nothing(seed: int) -> Iterator[Planned]:
    for cases, noise, i in itertools.product((2, 1), (0.0, NOISE), range(_EMPTY_A_SEED)):
        yield Planned("nothing", (), STRENGTHS[0], cases, noise, _EMPTY_A_SEED * seed + i)


def _fault(seed: int) -> Iterator[Planned]:
    for cases, noise, name in itertools.product((2, 1), (0.0, NOISE), FAULTS):
        yield Planned("fault", (name,), STRENGTHS[0], cases, noise, seed)


def _outside(seed: int) -> Iterator[Planned]:
    for x, cases, noise, name in itertools.product(STRENGTHS[:2], (2, 1), (0.0, NOISE), OUTSIDE):
        yield Planned("outside", (name,), x, cases, noise, seed)


def _pair(seed: int) -> Iterator[Planned]:
    for noise, pair in itertools.product((0.0, NOISE), _two_at_once(seed, 77)[:_PAIRS_A_SEED]):
        yield Planned("pair", pair, STRENGTHS[1], 2, noise, seed)


def _two_at_once(*seed: int) -> list[tuple[str, str]]:
    """Return all pairs of effects, shuffled."""
    everything = list(itertools.combinations(sorted(set(LIBRARY) - {"external.constant"}), 2))
    return [everything[i] for i in np.random.default_rng(seed).permutation(len(everything))]


def _brief(seed: int) -> Iterator[Planned]:
    for name in (*LIBRARY, *BASE):
        yield Planned("brief", (name,), STRENGTHS[0], 2, NOISE, seed)


def _elsewhere(seed: int) -> Iterator[Planned]:
    for name in (*LIBRARY, *BASE, *OUTSIDE, "", *FAULTS):
        yield _drawn("elsewhere", seed, (name,) if name else ())
    for i in range(1, _EMPTY_A_SEED):
        yield _drawn("elsewhere", seed, (), i)
    for pair in _two_at_once(seed, 79)[:_PAIRS_ELSEWHERE]:
        yield _drawn("elsewhere", seed, pair)


def _strong(seed: int) -> Iterator[Planned]:
    for name in (*LIBRARY, *BASE):
        if name != "external.constant":
            yield _drawn("strong", seed, (name,))


def _foreign(seed: int) -> Iterator[Planned]:
    for cases, noise, name in itertools.product((2, 1), (0.0, NOISE), FOREIGN):
        yield Planned("foreign", (name,), STRENGTHS[0], cases, noise, seed)


def _drawn(part: str, seed: int, hidden: tuple[str, ...], *more: int) -> Planned:
    """Return a run whose strength, number of recordings and random torque are drawn by lot."""
    lot = np.random.default_rng([seed, zlib.crc32(" & ".join(hidden).encode()), 78, *more])
    strength = float(f"{np.exp(lot.uniform(*np.log(_DRAWN[part]))):.2g}")
    noise = float(f"{BUDGET * np.exp(lot.uniform(*np.log(_UNREST))):.2g}") if lot.random() < 0.5 else 0.0
    return Planned(part, hidden, strength, int(lot.integers(1, 3)), noise, seed)


_PLANS = {
    "library": _library,
    "nothing": _nothing,
    "fault": _fault,
    "outside": _outside,
    "pair": _pair,
    "brief": _brief,
    "elsewhere": _elsewhere,
    "strong": _strong,
    "foreign": _foreign,
}
