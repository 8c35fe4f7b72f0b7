"""How much figures and answers change when something changes that should not matter: a table.

    python benchmarks/robustness/perturbations.py --case CASE.h5 --jobs 2

Two simulated recordings, each with one hidden law, and every CASE given (the demo's: `gyrotrack demo -o FOLDER`), are
fitted with the reduced model and diagnosed, unchanged and with one thing changed: a moment of inertia, the sample, the
stated standard uncertainty of the angles, the number of blocks, the exponent or the width of the hidden law; and with a
stated uncertainty of the casing's moment of inertia and its error as a parameter. The lines go to
``perturbations.jsonl`` (one that is there is not computed again), the table to ``perturbations.md``.
"""

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
import numpy as np
from reduced import INERTIA, REDUCED

import fitting
from fitting.inference import _case_data
from fitting.inference._case_data import CaseData
from fitting.inference._record import Samples

HERE = Path(__file__).parent
LINES, TABLE = HERE / "perturbations.jsonl", HERE / "perturbations.md"
COLUMNS = (
    "| changed | chi2 / n | ratio | chi2 per fitted row | cross-validation error | ratio "
    "| process noise [nN m] | answer | form | explained |"
)
FREE = "u(I_casing) 3 % stated, setup.inertia added"
RIGHT = "hidden law in the model"
INHERENT = (
    "With the hidden law in the model, only the inertia is wrong: these factors are the effect of an error of the "
    "inertia in these data. A factor near 1 requires the inertia as a parameter."
)
STRENGTH, FASTEST = 2e-6, 160.0  # N m at rad/s


def drag(exponent=2.0):
    """Return a drag of the casing with this exponent."""
    return f"casing: -k*abs(omega_c)**{exponent:g}*sign(omega_c)", STRENGTH / FASTEST**exponent


def step(width=0.0):
    """Return a step of the touch point's friction at 47 s that takes this time [s]."""
    shape = f"(0.5 + 0.5*tanh((t - 47.0)/{width:g}))" if width else "heaviside(t - 47.0)"
    return f"casing: -k*{shape}*sign(omega_c)", STRENGTH


def laminar():
    """Return a laminar drag of the casing."""
    return drag(1.5)


def windage():
    """Return the drag of the rotor's air on the casing."""
    return "casing: k*omega_r**2", STRENGTH / 900.0**2


def heating():
    """Return a bearing torque that decays with time."""
    return "bearing: k*exp(-t/20)", STRENGTH


HIDDEN = {
    "casing.air.quadratic": drag,
    "touchpoint.step": step,
    "casing.air.laminar": laminar,
    "casing.windage": windage,
    "decaying bearing torque": heating,
}
SEEDS = {"casing.air.laminar": 21, "casing.windage": 22, "decaying bearing torque": 23}


def simulated(law, strength, seed=1):
    """Return a recording of 100 s with a hidden law."""
    effect = fitting.effect(law)
    model = fitting.Model.of("reduced").with_effect(effect)
    experiment = fitting.Experiment(duration=100.0, windows=(8.0, 50.0, 90.0))
    return fitting.simulate(model, REDUCED | {f"{effect.name}.k": strength}, experiment, seed=seed, **INERTIA)


@cache
def of_name(name):
    """Return the recording of a name: a file, or a simulated one."""
    return simulated(*HIDDEN[name](), SEEDS.get(name, 1)) if name in HIDDEN else fitting.load(name)


def inertia(body, share, record):
    """Change a moment of inertia by a share."""
    return replace(record, **{f"I_{body}": getattr(record, f"I_{body}") * (1 + share)})


def stated(share, record):
    """Change the casing's moment of inertia by a share, and state a standard uncertainty of 3 %."""
    changed = inertia("casing", share, record)
    return replace(changed, I_casing_u=0.03 * changed.I_casing, digest="")


def sample(first, last, record):
    """Keep what lies between two shares of the recording."""
    begin, end = record.span
    low, high = begin + first * (end - begin), begin + last * (end - begin)

    def cut(s):
        inside = (s.time >= low) & (s.time <= high)
        return Samples(s.time[inside], s.value[inside], s.sigma[inside])

    windows = [(cut(w), u) for w, u in zip(record.rotor, _starts(record), strict=True)]
    kept = [(w, u) for w, u in windows if len(w) > 20]
    return _changed(record, cut(record.casing), kept)


def thinned(record):
    """Leave out every tenth sample."""

    def cut(s):
        kept = np.arange(len(s)) % 10 != 5
        return Samples(s.time[kept], s.value[kept], s.sigma[kept])

    return _changed(
        record, cut(record.casing), [(cut(w), u) for w, u in zip(record.rotor, _starts(record), strict=True)]
    )


def sigma(share, record):
    """Change the stated standard uncertainty of all angles."""

    def scaled(s):
        return Samples(s.time, s.value, s.sigma * (1 + share))

    return _changed(
        record,
        scaled(record.casing),
        [(scaled(w), u) for w, u in zip(record.rotor, _starts(record), strict=True)],
    )


def _starts(record):
    return record.start_sigma or (0.0,) * len(record.rotor)


def _changed(record, casing, rotor):
    return replace(
        record,
        casing=casing,
        rotor=tuple(w for w, _ in rotor),
        start_sigma=tuple(u for _, u in rotor),
        digest="",
    )


def changes(name):
    """Yield what is changed, in words, with the function that does it and the number of blocks."""
    yield "nothing", lambda r: r, None
    for body in ("casing", "rotor"):
        for percent in (-3.0, -1.0, -0.3, 0.3, 1.0, 3.0):
            yield f"I_{body} {percent:+g} %", partial(inertia, body, percent / 100), None
    for percent in (0.0, -3.0, 3.0):
        yield f"{FREE}: I_casing {percent:+g} %", partial(stated, percent / 100), None
    if name == "casing.air.quadratic":
        for percent in (0.0, -3.0, 3.0):
            yield f"{RIGHT}: I_casing {percent:+g} %", partial(inertia, "casing", percent / 100), None
    for words, first, last in (
        ("first half", 0, 0.5),
        ("second half", 0.5, 1),
        ("without the first tenth", 0.1, 1),
        ("without the last tenth", 0, 0.9),
    ):
        yield words, partial(sample, first, last), None
    yield "without every tenth sample", thinned, None
    for percent in (-20.0, 20.0):
        yield f"sigma {percent:+g} %", partial(sigma, percent / 100), None
    for blocks in (48, 75):
        yield f"{blocks} blocks in place of 60", lambda r: r, blocks
    if name == "casing.air.quadratic":
        for n in (1.9, 1.95, 2.05, 2.1):
            yield f"exponent {n:g} of the hidden law", lambda _, n=n: simulated(*drag(n)), None
    if name == "touchpoint.step":
        for w in (0.02, 0.05, 0.2, 1.0):
            yield f"the hidden step takes {w:g} s", lambda _, w=w: simulated(*step(w)), None


def answer(name, words, ask):
    """Fit a recording with one thing changed and, if asked, diagnose it."""
    record = of_name(name)
    change, blocks = next((c, b) for w, c, b in changes(name) if w == words)
    if blocks:
        _case_data.BLOCKS = blocks
    began = time.process_time()
    model = fitting.Model.of("reduced")
    if words.startswith(FREE):
        model = model + "setup.inertia"
    if words.startswith(RIGHT):
        model = model + name
    base = fitting.fit(model, CaseData.of(change(record)))
    (case,), (noise,) = base.cases, base.noise
    said = {"verdict": None, "form": None, "named": [], "explained": None}
    if ask:
        found = fitting.diagnose(base)
        chosen = found.candidates[0] if found.verdict != "adequate" and found.candidates else None
        said = {
            "verdict": found.verdict,
            "form": found.form,
            "named": [chosen.effect.name, *chosen.indistinguishable_from] if chosen else [],
            "explained": found.explained,
        }
    _case_data.BLOCKS = 60
    return {
        "case": name,
        "change": words,
        "chi2": case.casing.reduced_chi2,
        "misfit": case.chi2_per_row,
        "held_out": case.casing.held_out,
        "noise": noise.pure,
        "noise_u": noise.pure_u,
        **said,
        "seconds": time.process_time() - began,
    }


def table(lines):
    """Return one table for each recording; ratios are those to the unchanged one, with the same model."""
    parts = []
    for name in dict.fromkeys(x["case"] for x in lines):
        own = {x["change"]: x for x in lines if x["case"] == name}
        order = [w for w, *_ in changes(name) if w in own]
        plain = own.get("nothing")
        parts += [
            f"## {Path(name).stem if name.endswith('.h5') else name}",
            "",
            COLUMNS,
            "|---|---|---|---|---|---|---|---|---|---|",
        ]
        for words in order:
            x = own[words]
            model = next((m for m in (FREE, RIGHT) if words.startswith(m)), None)
            reference = own.get(f"{model}: I_casing +0 %") if model else plain
            ratios = [x[k] / reference[k] if reference else float("nan") for k in ("chi2", "held_out")]
            share = "-" if x["explained"] is None else f"{x['explained']:.3f}"
            said = (x["verdict"] or "-") if not x["named"] else f"{x['verdict']}: {', '.join(x['named'][:3])}"
            level = f"{1e9 * x['noise']:.2g} +- {1e9 * x['noise_u']:.1g}"
            parts.append(
                f"| {words} | {x['chi2']:.4g} | {ratios[0]:.3f} | {x['misfit']:.4g} | {x['held_out']:.4g} "
                f"| {ratios[1]:.3f} | {level} | {said} | {x['form'] or '-'} | {share} |"
            )
        for kind, reference, where in (
            ("I_", plain, ""),
            (FREE, own.get(f"{FREE}: I_casing +0 %"), f", {FREE}"),
        ):
            near = [own[w] for w in order if w.startswith(kind)]
            for key, goal, what in (("chi2", 1.5, "chi2 / n"), ("held_out", 1.2, "cross-validation error")):
                if reference and near:
                    worst = max(max(x[key] / reference[key], reference[key] / x[key]) for x in near)
                    said = f"Largest factor of the {what} under changes of inertia{where}: {worst:.3f}"
                    parts += ["", f"{said} (goal {goal:g})."]
        if any(w.startswith(RIGHT) for w in order):
            parts += ["", INHERENT]
        parts.append("")
    return "\n".join(parts)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--case", action="append", default=[], help="a case file; may be repeated")
    parser.add_argument("--jobs", type=int, default=1, help="processes (1)")
    parser.add_argument("--only", default="", help="part of the name of a change")
    parser.add_argument("--fits-only", action="store_true", help="do not ask for the missing effect")
    parser.add_argument("--again", action="store_true", help="compute also what has its line")
    options = parser.parse_args()
    lines = [json.loads(x) for x in LINES.read_text().splitlines()] if LINES.exists() else []
    enough = [x for x in lines if x["verdict"] or options.fits_only]
    done = set() if options.again else {(x["case"], x["change"]) for x in enough}
    plan = [
        (name, words)
        for name in (*HIDDEN, *options.case)
        for words, *_ in changes(name)
        if (name, words) not in done and options.only in words
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        for waiting in as_completed([pool.submit(answer, *p, not options.fits_only) for p in plan]):
            line = waiting.result()
            lines = [x for x in lines if (x["case"], x["change"]) != (line["case"], line["change"])] + [line]
            LINES.write_text("".join(json.dumps(x) + "\n" for x in lines))
            print(
                f"{line['case']}: {line['change']}: {line['chi2']:.4g} {line['verdict']} {line['named'][:3]}",
                flush=True,
            )
    made = "Made by `python benchmarks/robustness/perturbations.py`."
    head = f"# Figures and answers under changes that should not matter\n\n{made}\n"
    TABLE.write_text(f"{head}\n{table(lines)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
