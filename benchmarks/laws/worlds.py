"""Gyroscopes drawn by lot with laws that no library has: integrated in plain Python, not one line of `fitting`.

The gyroscopes are those of benchmarks/discovery/elsewhere.py (bodies, friction, speeds, cameras and noise drawn), the
integration is that of benchmarks/discovery/experiment.py. The largest torque of a law along the motion is 1-5 % of the
bearing's. Shape constants are drawn, too, and some forms are deliberately not those of the grammar.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "discovery"))

from elsewhere import budget, gyroscopes
from experiment import Hidden, Motion, integrate, shake
from experiment import record as film
from hidden import BASE, LIBRARY, Draw

Shape = Callable[[float, float, float], float]  # of t, omega_r, omega_c


@dataclass(frozen=True)
class World:
    """A gyroscope, what is hidden in it, and what counts as the true form.

    Attributes
    ----------
    name : str
        The hidden law in words; empty if nothing is hidden.
    body : str
        Where it acts.
    forms : tuple of str
        Forms of the grammar that count as the true one.
    variables : tuple of str
        What the law depends on.
    runs : tuple of dict
        Two recordings to search, and a third one at another speed to predict.
    hidden : Hidden
        The law.
    """

    name: str
    body: str
    forms: tuple[str, ...]
    variables: tuple[str, ...]
    runs: tuple[dict[str, Any], ...]
    hidden: Hidden

    def records(self, noise: float, seed: int, count: int = 3) -> list[dict[str, Any]]:
        """Return what `make_record` takes, one for each of the first runs."""
        return [
            film(
                run,
                self.hidden,
                torque_noise=noise,
                rng=np.random.default_rng([seed, i]),
                label=f"case{i + 1}",
            )
            for i, run in enumerate(self.runs[:count])
        ]

    def motion(self, index: int) -> Motion:
        """Return the true motion of a run without process noise."""
        run = self.runs[index]
        return integrate(run, self.hidden, shake(run["span"], 0.0, 1.0, np.random.default_rng(0)))


Law = tuple[
    str, str, tuple[str, ...], tuple[str, ...], Callable[[np.random.Generator, dict[str, float]], Shape]
]


def _laws() -> tuple[Law, ...]:
    """Return name, body, accepted forms, variables, and a maker of the shape for given typical values."""

    def of(body: str, x: str) -> Callable[[float, float, float], float]:
        return {
            "omega_c": lambda t, wr, wc: wc,
            "omega_r": lambda t, wr, wc: wr,
            "delta": lambda t, wr, wc: wr - wc,
        }[x]

    def speed(
        name: str, body: str, forms: tuple[str, ...], x: str, make: Callable[..., Callable[[float], float]]
    ) -> Law:
        get = of(body, x)

        def shape(rng: np.random.Generator, typical: dict[str, float]) -> Shape:
            law = make(rng, typical[x])
            return lambda t, wr, wc: law(get(t, wr, wc))

        return name, body, forms, (x,), shape

    def timed(
        name: str, body: str, forms: tuple[str, ...], make: Callable[..., Callable[[float], float]]
    ) -> Law:
        def shape(rng: np.random.Generator, typical: dict[str, float]) -> Shape:
            law = make(rng, typical["t"])
            return lambda t, wr, wc: law(t)

        return name, body, forms, ("t",), shape

    def tanh(rng: Any, top: float) -> Callable[[float], float]:
        w = rng.uniform(0.15, 0.5) * top
        return lambda x: -math.tanh(x / w)

    def arctan(rng: Any, top: float) -> Callable[[float], float]:
        w = rng.uniform(0.1, 0.3) * top
        return lambda x: -math.atan(x / w)

    def power(low: float, high: float, sign: float = -1.0) -> Callable[..., Callable[[float], float]]:
        def make(rng: Any, top: float) -> Callable[[float], float]:
            n = rng.uniform(low, high)
            return lambda x: sign * (max(x, 0.0) / top) ** n

        return make

    def hinge(rng: Any, top: float) -> Callable[[float], float]:
        w = rng.uniform(0.3, 0.7) * top
        return lambda x: -max(x - w, 0.0) / top

    def lorentz(rng: Any, top: float) -> Callable[[float], float]:
        w, u = rng.uniform(0.4, 0.8) * top, rng.uniform(0.06, 0.2) * top
        return lambda x: -1 / (1 + ((x - w) / u) ** 2)

    def gauss(rng: Any, top: float) -> Callable[[float], float]:
        w, u = rng.uniform(0.4, 0.8) * top, rng.uniform(0.08, 0.2) * top
        return lambda x: -math.exp(-(((x - w) / u) ** 2))

    def brake(rng: Any, top: float) -> Callable[[float], float]:
        w = rng.uniform(0.2, 0.6) * top
        return lambda x: -(x / w) / (1 + (x / w) ** 2)

    def logarithm(rng: Any, top: float) -> Callable[[float], float]:
        w = rng.uniform(0.03, 0.2) * top
        return lambda x: -math.log1p(max(x, 0.0) / w)

    def falling(rng: Any, top: float) -> Callable[[float], float]:
        w = rng.uniform(0.2, 0.5) * top
        return lambda x: math.exp(-x / w)

    def decay(rng: Any, span: float) -> Callable[[float], float]:
        w = rng.uniform(0.08, 0.4) * span
        return lambda t: math.exp(-t / w)

    def creep(rng: Any, span: float) -> Callable[[float], float]:
        w = rng.uniform(0.01, 0.1) * span
        return lambda t: -math.log1p(t / w)

    def wave(rng: Any, span: float) -> Callable[[float], float]:
        w, phi = 2 * math.pi * rng.uniform(3, 40) / span, rng.uniform(0, 2 * math.pi)
        return lambda t: math.sin(w * t - phi)

    def ringing(rng: Any, span: float) -> Callable[[float], float]:
        w, phi, u = (
            2 * math.pi * rng.uniform(4, 12) / span,
            rng.uniform(0, 2 * math.pi),
            rng.uniform(0.15, 0.5) * span,
        )
        return lambda t: math.exp(-t / u) * math.sin(w * t - phi)

    def product(rng: Any, typical: dict[str, float]) -> Shape:
        return lambda t, wr, wc: -wr * wc

    def wearing_in(rng: Any, typical: dict[str, float]) -> Shape:
        w = rng.uniform(0.1, 0.4) * typical["t"]
        return lambda t, wr, wc: math.exp(-t / w) * (wr - wc)

    def warming(rng: Any, typical: dict[str, float]) -> Shape:
        w = rng.uniform(0.15, 0.5) * typical["t"]
        return lambda t, wr, wc: -math.exp(-t / w) * wc

    return (
        speed("saturating drag", "casing", ("saturation",), "omega_c", tanh),
        speed("drag as an arctangent", "casing", ("saturation",), "omega_c", arctan),
        speed("drag of a low power", "casing", ("power",), "omega_c", power(0.3, 0.8)),
        speed("drag of a high power", "casing", ("power",), "omega_c", power(2.4, 3.6)),
        speed("drag beyond a threshold", "casing", ("threshold",), "omega_c", hinge),
        speed("resonance (Lorentz)", "casing", ("resonance",), "omega_c", lorentz),
        speed("resonance (Gauss)", "casing", ("resonance",), "omega_c", gauss),
        speed("eddy-current brake", "casing", ("peak",), "omega_c", brake),
        speed("logarithmic drag", "casing", ("logarithm",), "omega_c", logarithm),
        timed("draught that dies away", "casing", ("decay in time",), decay),
        timed("creep", "casing", ("logarithm of time",), creep),
        timed("oscillating draught", "casing", ("oscillation",), wave),
        timed("ringing table", "casing", ("decaying oscillation",), ringing),
        ("product of the speeds", "casing", ("product",), ("omega_r", "omega_c"), product),
        ("drag that warms away", "casing", ("product",), ("omega_c", "t"), warming),
        speed("mixed friction", "bearing", ("exponential",), "delta", falling),
        speed("resonance of the bearing", "bearing", ("resonance",), "delta", gauss),
        ("bearing that runs in", "bearing", ("product",), ("delta", "t"), wearing_in),
        speed("critical speed of the rotor", "rotor", ("resonance",), "omega_r", lorentz),
        speed("steep drag of the rotor", "rotor", ("power",), "omega_r", power(2.5, 3.5)),
    )  # fmt: skip


LAWS = _laws()


def world(index: int | None, seed: int) -> World:
    """Draw a gyroscope, and hide the law of this number in it; nothing without a number."""
    rng = np.random.default_rng([20261122, seed, 0 if index is None else index + 1])
    first, second = gyroscopes(rng)
    start = first["start"]
    third = second | {"start": (start[0] * rng.uniform(0.6, 0.8), start[1] * 1.5), "b1": first["b1"]}
    runs = (first, second, third)
    if index is None:
        return World("", "", (), (), runs, Hidden())
    name, body, forms, variables, make = LAWS[index]
    plain = integrate(first, Hidden(), shake(first["span"], 0.0, 1.0, np.random.default_rng(0)))
    typical = {
        "t": float(plain.time[-1]),
        "omega_r": float(plain.speed[:, 0].max()),
        "omega_c": float(plain.speed[:, 1].max()),
        "delta": float((plain.speed[:, 0] - plain.speed[:, 1]).max()),
    }
    shape = make(rng, typical)
    size = max(abs(shape(float(t), *map(float, v))) for t, v in zip(plain.time, plain.speed, strict=True))
    k = rng.uniform(0.01, 0.05) * budget(first) / size
    return World(
        name, body, forms, variables, runs, Hidden(**{body: (lambda t, wr, wc, psi: k * shape(t, wr, wc),)})
    )


# effects of the library: all but one that no recording separates from the touch point's friction
EFFECTS = tuple(n for n in (*LIBRARY, *BASE) if n != "external.constant")
_SHORT = (40.0, 80.0)  # s
_STRENGTH = 0.03


def of_library(name: str, noise: float, seed: int) -> list[dict[str, Any]]:
    """Return two short recordings, as `make_record` takes them, with an effect of the library of 3 % of the budget."""
    rng = np.random.default_rng([20261123, seed, EFFECTS.index(name)])
    runs = [run | {"span": rng.uniform(*_SHORT)} for run in gyroscopes(rng)]
    common = int(rng.integers(2**31))
    found = []
    for i, run in enumerate(runs):
        # what belongs to an event is drawn for each recording
        draw = Draw.of(run["span"], np.random.default_rng(common), np.random.default_rng([common, i]))
        hidden = {**LIBRARY, **BASE}[name](_STRENGTH * budget(runs[0]), draw)
        found.append(
            film(
                run,
                hidden,
                torque_noise=noise,
                rng=np.random.default_rng([seed, i, common]),
                label=f"case{i + 1}",
            )
        )
    return found
