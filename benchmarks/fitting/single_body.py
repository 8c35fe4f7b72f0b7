"""Coverage of 95 % intervals, and naming at 1 % strength, for the effects of a single body.

    python benchmarks/fitting/single_body.py --recordings 40 [--naming 4] [--only casing.gravity]

Motions are integrated by scipy, independently of the program, and recorded with white angle noise. Coverage: the true
model is fitted from nothing given; the share of physical parameters whose truth is inside value +- 1.96 stderr. Naming:
the model without the effect is fitted, the effect has 1 % of the rms of all other torques, and the ranking is made
without process noise; "first" counts the effect itself or a class that contains it.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "fitting"))

import numpy as np
import oscillators
from scipy.integrate import solve_ivp

from fitting._criteria import DEFAULT
from fitting.discovery._select import rank
from fitting.dynamics._model import Model
from fitting.inference._fit import fit

_NORMAL_95 = 1.959964
SIGMA = 1e-3


@dataclass(frozen=True)
class World:
    """A body of unit inertia: laws of the base, their strengths, the tested effect with all of its parameters."""

    base: dict[str, float]
    effect: str
    values: dict[str, float]
    start: tuple[float, float]
    span: float
    rate: float = 100.0


SPIN = {"touchpoint.constant.b1": 0.05, "casing.air.linear.b2": 0.03}
SWING = {"casing.air.linear.b2": 0.06}
WORLDS = (
    World(SWING, "casing.spring.linear", {"k": 12.0}, (1.0, 0.0), 20.0),
    World(SWING | {"casing.spring.linear.k": 10.0}, "casing.spring.cubic", {"k": 1.5}, (1.0, 0.0), 20.0),
    World(SWING, "casing.gravity", {"k": 12.0}, (1.5, 0.0), 20.0),
    World(SPIN, "casing.brake.eddy", {"k": 0.4, "w": 15.0}, (0.0, 60.0), 12.0),
    World(SPIN, "casing.seal.cooling", {"k": 0.3, "tau_T": 8.0}, (0.0, 60.0), 30.0),
    World(
        SWING | {"casing.spring.linear.k": 12.0},
        "casing.friction.presliding",
        {"k": 0.15, "s": 0.03},
        (1.0, 0.0),
        20.0,
    ),
    World(SWING, "casing.gravity", {"k": 12.0}, (2.6, 0.0), 20.0),
    World(
        SWING | {"casing.spring.linear.k": 10.0, "casing.spring.cubic.k": 1.0},
        "touchpoint.constant",
        {"b1": 0.1},
        (1.0, 0.0),
        20.0,
    ),
    # driven through zero: friction and drive are distinguishable only where the sense of rotation changes
    World(
        {"touchpoint.constant.b1": 0.3, "casing.air.linear.b2": 0.1},
        "external.constant",
        {"k": 2.0},
        (0.0, -15.0),
        20.0,
    ),
    World(SPIN, "casing.unbalance", {"k": 2.0, "phi": 0.7}, (0.0, 40.0), 60.0),
    World(SWING | {"casing.spring.linear.k": 10.0}, "casing.gravity", {"k": 2.0}, (1.0, 0.0), 20.0),
)


def rates(world: World, t, angle, omega, strain=0.0, scale: float = 1.0):
    """Return the angular acceleration without dry friction, and the dry friction."""
    values = {f"{world.effect}.{name}": value for name, value in world.values.items()}
    values[f"{world.effect}.{next(iter(world.values))}"] *= scale
    v = defaultdict(float, world.base | values)
    free = -v["casing.air.linear.b2"] * omega + v["external.constant.k"]
    free -= v["casing.spring.linear.k"] * angle + v["casing.spring.cubic.k"] * angle**3
    free -= v["casing.gravity.k"] * np.sin(angle)
    if world.effect == "casing.brake.eddy":
        free -= v["casing.brake.eddy.k"] * omega / (1 + (omega / v["casing.brake.eddy.w"]) ** 2)
    if world.effect == "casing.seal.cooling":  # the body keeps its sense
        cold = 1 - np.exp(-t / v["casing.seal.cooling.tau_T"])
        free -= v["casing.seal.cooling.k"] * cold * np.sign(omega)
    free += v["casing.unbalance.k"] * np.sin(angle - v["casing.unbalance.phi"])
    return free - v["casing.friction.presliding.k"] * strain, v["touchpoint.constant.b1"]


def motion(world: World, scale: float = 1.0):
    """Return times, angles, angular velocities and, for the torque, the strain of a contact."""
    if world.effect != "casing.friction.presliding":
        t, angle, omega = oscillators.motion(
            lambda t, angle, omega: rates(world, t, angle, omega, 0.0, scale)[0],
            world.start,
            world.span,
            world.rate,
            dry=rates(world, 0.0, 0.0, 0.0, 0.0, scale)[1],
        )
        return t, angle, omega, np.zeros_like(t)

    def slopes(t, y):
        _, omega, strain = y
        return [omega, rates(world, t, *y, scale)[0], (omega - abs(omega) * strain) / world.values["s"]]

    t = np.arange(0.0, world.span, 1 / world.rate)
    run = solve_ivp(
        slopes, (0, world.span), [*world.start, 0.0], t_eval=t, rtol=1e-10, atol=1e-12, method="LSODA"
    )
    return t, *run.y


def record(world: World, seed: int, scale: float = 1.0):
    """Return a recording of the angle."""
    t, angle, _, _ = motion(world, scale)
    return oscillators.record(t, angle, SIGMA, seed)


def key(name: str) -> str:
    """Return the effect to which a parameter belongs."""
    return name.rpartition(".")[0]


def coverage(world: World, recordings: int) -> tuple[int, int, float, float]:
    """Return how many intervals hold the truth, of how many; the rms and largest distance in standard uncertainties."""
    truth = world.base | {f"{world.effect}.{k}": v for k, v in world.values.items()}
    model = Model.of([*dict.fromkeys(map(key, world.base)), world.effect])
    pulls = []
    for seed in range(recordings):
        found = fit(model, [record(world, seed)]).estimates
        pulls += [(found[name].value - value) / found[name].stderr for name, value in truth.items()]
    size = np.abs(pulls)
    return int((size < _NORMAL_95).sum()), len(size), float(np.sqrt(np.mean(size**2))), float(size.max())


def strength(world: World) -> float:
    """Return the factor of the effect's strength at which its rms torque is 1 % of that of all other torques."""
    t, *state = motion(world, 0.01)

    def torque(scale):
        free, dry = rates(world, t, *state, scale)
        return free - dry * np.sign(state[1])

    without = torque(0.0)
    return float(0.01 * np.sqrt(np.mean(without**2) / np.mean((torque(1.0) - without) ** 2)))


def naming(world: World, recordings: int) -> tuple[int, int, int]:
    """Return how often the effect, or a class that contains it, is first at 1 % strength; how often it is in reach.

    In reach: with the true model, fitted from the true values, the BIC falls by `Criteria.evidence`. No method that
    does not know the law can name it where this fails.
    """
    right, in_reach, scale = 0, 0, strength(world)
    truth = world.base | {f"{world.effect}.{k}": v for k, v in world.values.items()}
    truth[f"{world.effect}.{next(iter(world.values))}"] *= scale
    names = [*dict.fromkeys(map(key, world.base))]
    for seed in range(recordings):
        data = record(world, 1000 + seed, scale)
        base = fit(Model.of(names), [data])
        oracle = fit(Model.of([*names, world.effect]), [data], start=truth)
        first = rank(base)[0]
        named = first.significant and world.effect in (first.effect.name, *first.indistinguishable_from)
        right, in_reach = right + named, in_reach + (oracle.bic < base.bic - DEFAULT.evidence)
        print(
            f"  {world.effect} {seed}: oracle {oracle.bic - base.bic:.1f}, first {first.effect.name}",
            file=sys.stderr,
        )
    return right, in_reach, recordings


def main() -> None:
    """Print a table of coverage and naming."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recordings", type=int, default=20)
    parser.add_argument("--naming", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[])
    options = parser.parse_args()
    print(
        "| effect | recordings | intervals that hold the truth | rms [u] | largest [u] | named first at 1 % |"
    )
    print("|---|---|---|---|---|---|")
    for world in WORLDS:
        if options.only and world.effect not in options.only:
            continue
        inside, count, rms, largest = coverage(world, options.recordings)
        # without the only restoring torque there is nothing of which 1 % would be missing
        restores = not any(k.startswith("casing.spring") for k in world.base) and world.start[1] == 0
        named = (
            "-"
            if restores or not options.naming
            else "{0} of {2}, in reach {1}".format(*naming(world, options.naming))
        )
        share = f"{inside} of {count} ({100 * inside / max(count, 1):.0f} %)"
        print(
            f"| {world.effect} | {options.recordings} | {share} | {rms:.2f} | {largest:.1f} | {named} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
