"""Laws near those of the library, and some far from it: which name, which form, which remainder.

    python benchmarks/discovery/near_library.py --seeds 3 --jobs 2

Each world is the reduced model, with constants drawn by lot, and one hidden law, made by `fitting.simulate` without
process noise; the base is fitted without the law and `diagnose` is asked. Whether the data show the difference from the
library's law is told by fits of both laws, started at the truth: a fall of BIC by more than 10. The error of the torque
is that of rotor and casing along the true motion, relative to the torque of the hidden law. Lines go to
``near_library.jsonl``, the table to ``NEAR_LIBRARY.md``. A world that has its line is not run again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import zlib
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
import numpy as np
from judge import Share
from reduced import INERTIA, REDUCED

import fitting
from fitting.dynamics._collocation import Path as Motion
from fitting.dynamics._collocation import Sampler
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.inference._fit import fit
from fitting.inference._simulation import simulate_path

HERE = Path(__file__).parent
LINES, TABLE = HERE / "near_library.jsonl", HERE / "NEAR_LIBRARY.md"
_TWINS = {"casing.windage", "bearing.load"}
# fall of BIC at which the true law is decidedly better than that of the library (Kass and Raftery 1995), if it is known
# and if a constant of it has to be fitted, which costs about ln(n) = 10
_DECIDED, _FITTED = 10.0, 20.0


@dataclass(frozen=True)
class World:
    """A hidden law: its formula with all numbers but `k`, the effects it is close to, and what is wrong with them."""

    group: str
    name: str
    law: str
    strength: float
    near: tuple[str, ...]
    exact: bool = False
    second: tuple[str, float] | None = None


def _power(body: str, speed: str, sign: str, n: float) -> str:
    return f"{body}: {sign}k*abs({speed})**{n:g}*sign({speed})"


def worlds() -> Iterator[World]:
    """Yield the plan."""
    for width in (0.02, 0.05, 0.1, 0.2, 1.0):
        for size in (4e-7, 2e-6):
            law = f"casing: -k*(0.5 + 0.5*tanh((t - {{t0}})/{width}))*sign(omega_c)"
            yield World("step width", f"step {width} s, {size:g} N m", law, size, ("touchpoint.step",))
    yield World(
        "exact",
        "step",
        "casing: -k*heaviside(t - {t0})*sign(omega_c)",
        2e-6,
        ("touchpoint.step",),
        exact=True,
    )
    for name, body, speed, sign, order, top in (
        ("casing.air.quadratic", "casing", "omega_c", "-", 2.0, 160.0),
        ("casing.air.laminar", "casing", "omega_c", "-", 1.5, 160.0),
        ("casing.windage", "casing", "omega_r", "", 2.0, 900.0),
        ("rotor.air.disk", "rotor", "omega_r", "-", 1.5, 900.0),
        ("bearing.quadratic", "bearing", "delta", "", 2.0, 900.0),
    ):
        near = tuple(_TWINS) if name in _TWINS else (name,)
        for shift in (-0.1, -0.05, 0.0, 0.05, 0.1):
            n = order + shift
            group = "exponent" if shift else "exact"
            yield World(
                group, f"{name} n = {n:g}", _power(body, speed, sign, n), 2e-6 / top**n, near, not shift
            )
    for size in (1.3e-5, 1.3e-4):
        for n in (1.9, 2.1):
            law = _power("casing", "omega_c", "-", n)
            near = ("casing.air.quadratic",)
            yield World(
                "exponent", f"casing.air.quadratic n = {n:g}, {size:g} N m", law, size / 160.0**n, near
            )
    for tau in (4.0, 12.0, 30.0):
        for size in (2e-6, 1.3e-5):
            law = f"casing: -k*(1 - exp(-t/({tau}*(1 + 0.0005*t))))*sign(omega_c)"
            name = f"casing.seal.cooling, {tau:g} s + 5 %, {size:g} N m"
            yield World("time constant", name, law, size, ("casing.seal.cooling",))
    for name, order, size in (
        ("casing.unbalance", 1, 6e-5),
        ("casing.unbalance", 1, 4e-6),
        ("casing.asymmetry", 2, 3e-5),
    ):
        law = f"casing: k*sin({order}*psi_c - 0.7)"
        group = "strong harmonic" if size > 1e-5 else "exact"
        yield World(group, f"{name} {size:g} N m", law, size, (name,), exact=size < 1e-5)
        third = (f"casing: q*sin({3 * order}*psi_c - 0.2)", 0.03 * size)
        yield World("third harmonic", f"{name} {size:g} N m, 3 % third", law, size, (name,), second=third)
    for name, law, size in (
        ("sqrt(omega_c)", "casing: -k*sqrt(abs(omega_c)/160)", 2e-6),
        ("tanh(omega_c/40)", "casing: -k*tanh(omega_c/40)", 2e-6),
        ("resonance at 110", "casing: -k*exp(-((omega_c - 110)/12)**2)", 2e-6),
        ("product of the speeds", "casing: -k*omega_r*omega_c/1e5", 2e-6),
        ("exp(-t/30)", "casing: -k*exp(-t/30)", 2e-6),
        ("t^2", "casing: -k*(t/100)**2", 2e-6),
        ("mixed friction of the bearing", "bearing: -2*k*exp(-delta/250)", 2e-6),
        ("exp(-t/14) of the bearing", "bearing: k*exp(-t/14)", 2e-6),
        ("tanh(omega_r/300)", "rotor: -k*tanh(omega_r/300)", 2e-6),
    ):
        yield World("outside", name, law, size, ())


def answer(world: World, seed: int) -> dict[str, Any]:
    """Simulate a world, fit the base, ask, and judge."""
    random = np.random.default_rng([seed, zlib.crc32(world.name.encode())])
    law = world.law.format(t0=round(float(random.uniform(30.0, 70.0)), 3))
    hidden = [(fitting.effect(law), "k", world.strength)]
    if world.second:
        hidden.append((fitting.effect(world.second[0]), "q", world.second[1]))
    reduced = fitting.Model.of("reduced")
    numbers = {
        k: v * float(random.uniform(0.9, 1.1)) if not k.endswith("g") else v for k, v in REDUCED.items()
    }
    model = reduced
    for effect, symbol, value in hidden:
        model = model.with_effect(effect)
        numbers[f"{effect.name}.{symbol}"] = value
    experiment = fitting.Experiment(duration=100.0, windows=(8.0, 50.0, 90.0))
    record = fitting.simulate(model, numbers, experiment, seed=seed, **INERTIA)
    began = time.process_time()
    base = fit(reduced, [record])
    found = fitting.diagnose(base)
    seconds = time.process_time() - began
    chosen = found.candidates[0] if found.verdict != "adequate" and found.candidates else None
    named = [chosen.effect.name, *chosen.indistinguishable_from] if chosen else []
    line = {
        "key": f"{world.name}|{seed}",
        "group": world.group,
        "exact": world.exact,
        "near": list(world.near),
        "verdict": found.verdict,
        "form": found.form,
        "explained": found.explained,
        "named": named,
        "share": found.remainder.share if found.remainder else 0.0,
        "remainder": found.remainder.sentence if found.remainder else None,
        "sentence": found.sentence,
        "seconds": seconds,
    }
    if world.second or (world.near and not world.exact and not model.angle_dependent):
        line["decided"] = _decided(world, base, model, numbers)
    if not world.near and not model.angle_dependent:
        errors = _torque_errors([f for f in (base, chosen and chosen.fit) if f], model, numbers, experiment)
        line |= {"base_error": errors[0], "torque_error": errors[-1]}
    return line


def _decided(world: World, base: fitting.Fit, model: fitting.Model, numbers: dict[str, float]) -> float:
    """Return by how much BIC falls from the best law of the library near the hidden one to the hidden one itself."""
    data, truth = base.problem.data, {k: v for k, v in numbers.items() if k in model.free}
    start = {k: v for k, v in truth.items() if k in base.model.free}
    fits = [fit(base.model.with_effect(fitting.LIBRARY[name]), data, start=start) for name in world.near]
    best = min(fits, key=lambda f: f.bic)
    if world.second:
        # the law of the library is the first harmonic, with a free phase
        model = best.model.with_effect(fitting.effect(world.second[0]))
        truth |= {k: e.value for k, e in best.estimates.items() if k in best.model.free}
    return best.bic - fit(model, data, start={k: v for k, v in truth.items() if k in model.free}).bic


def _torque_errors(
    fits: list[fitting.Fit], model: fitting.Model, numbers: dict[str, float], experiment: fitting.Experiment
) -> list[float]:
    """Return the rms error of each fit's torques along the true motion, relative to the torque of the hidden law."""
    inertia = {INERTIA_ROTOR: INERTIA["inertia_rotor"], INERTIA_CASING: INERTIA["inertia_casing"]}
    path = simulate_path(model, {**model.constants, **numbers, **inertia}, experiment)[1]
    t = path.mesh.times

    def torques(m: fitting.Model, values: dict[str, float], own: Motion) -> np.ndarray:
        law = Dynamics(m)
        y = Sampler(own.mesh, t.ravel()).value(own.y).reshape(*t.shape, -1)
        y[..., :2] = path.y[..., :2]
        return law.rates(t, y, values)[..., :2] * list(inertia.values())

    true = torques(model, {**model.constants, **numbers, **inertia}, path)
    without = fitting.Model.of("reduced")
    size = np.sqrt(np.mean((true - torques(without, {**without.constants, **numbers, **inertia}, path)) ** 2))
    return [
        float(
            np.sqrt(
                np.mean(
                    (
                        torques(f.model.smooth, f.problem.layout.numbers(f.theta, 0), f.predictions[0].path)
                        - true
                    )
                    ** 2
                )
            )
            / size
        )
        for f in fits
    ]


def _told(lines: list[dict[str, Any]], least: float) -> str:
    """Return in how many answers the significant remainder is told, and in how many the form is not called exact."""
    told = Share(x["form"] == "approximate" and bool(x["remainder"]) for x in lines)
    return (
        f"Where BIC prefers the true law to the library's by more than {least:g}: approximate, with its remainder, "
        f"{told}; not exact {Share(x['form'] != 'exact' for x in lines)}.\n"
    )


def table(lines: list[dict[str, Any]]) -> str:
    """Return the rates as a table."""
    rows = [
        "| worlds | right name or class | form exact | form approximate | unexplained | adequate |",
        "|---|---|---|---|---|---|",
    ]
    for group in dict.fromkeys(x["group"] for x in lines):
        own = [x for x in lines if x["group"] == group]
        right = Share(
            x["verdict"] == "missing_effect" and bool(set(x["near"]) & set(x["named"])) for x in own
        )
        forms = [
            Share(
                x["verdict"] == "missing_effect"
                and x["form"] == "exact"
                and (group != "outside" or len(x["named"]) == 1)
                for x in own
            ),
            Share(x["form"] == "approximate" for x in own),
            *(Share(x["verdict"] == v for x in own) for v in ("unexplained", "adequate")),
        ]
        rows.append(f"| {group} | {right if group != 'outside' else '-'} | {' | '.join(map(str, forms))} |")
    decided = [x for x in lines if x.get("decided") is not None and x["verdict"] == "missing_effect"]
    claimed = [
        x for x in lines if x["group"] == "outside" and x["form"] == "approximate" and "torque_error" in x
    ]
    near = Share(x["torque_error"] < 0.25 for x in claimed)
    rows += [
        "",
        "In the row `outside`, form exact counts answers of one name only.",
        "",
        *(_told([x for x in decided if x["decided"] > least], least) for least in (_DECIDED, _FITTED)),
        f"Approximate outside the library: torque within 25 % rms of the law's own {near}.",
        "",
        "| world | verdict | named | form | explained |",
        "|---|---|---|---|---|",
    ]
    for x in lines:
        share = "" if x["explained"] is None else f"{x['explained']:.4f}"
        rows.append(
            f"| {x['key'].replace('|', ', seed ')} | {x['verdict']} | {', '.join(x['named'][:3])} | {x['form']} "
            f"| {share} |"
        )
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--start", type=int, default=0, help="first seed (0)")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds (1)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (1)")
    parser.add_argument("--only", default="", help="part of the name or the group of a world")
    parser.add_argument("-o", "--output", type=Path, default=LINES)
    options = parser.parse_args()
    done = (
        {json.loads(x)["key"] for x in options.output.read_text().splitlines()}
        if options.output.exists()
        else set()
    )
    plan = [
        (w, s)
        for s in range(options.start, options.start + options.seeds)
        for w in worlds()
        if f"{w.name}|{s}" not in done and (options.only in w.name or options.only in w.group)
    ]
    with ProcessPoolExecutor(options.jobs) as pool, options.output.open("a", encoding="utf-8") as stream:
        for waiting in as_completed([pool.submit(answer, *p) for p in plan]):
            try:
                line = waiting.result()
            except Exception as fault:  # a world that fails has no line and is tried again
                print(f"failed: {type(fault).__name__}: {fault}", flush=True)
                continue
            stream.write(json.dumps(line) + "\n")
            stream.flush()
            print(
                f"{line['key']}: {line['verdict']} {line['form']} {line['named'][:3]} {line['explained']} "
                f"{line['seconds']:.0f} s",
                flush=True,
            )
    if options.output != LINES:
        return
    lines = sorted((json.loads(x) for x in options.output.read_text().splitlines()), key=lambda x: x["group"])
    made = f"{len(lines)} worlds, made by `python benchmarks/discovery/near_library.py`."
    TABLE.write_text(f"# Laws near the library\n\n{made}\n\n{table(lines)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
