"""The benchmark of discovery: physics against SciPy, oracle against differences, counting against known answers."""

import ast
import importlib
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting import REDUCED, Model, make_record
from fitting.effects._expression import Tape
from fitting.effects._user import resolve
from fitting.inference._case_data import CaseData
from fitting.inference._parameters import ParameterLayout
from fitting.inference._problem import Problem

HERE = Path(__file__).parents[1] / "benchmarks" / "discovery"
if not HERE.is_dir():
    pytest.skip("the benchmark is not part of a source package", allow_module_level=True)
sys.path.insert(0, str(HERE))

import experiment  # noqa: E402
import foreign  # noqa: E402
import hidden  # noqa: E402
import judge  # noqa: E402
import lines  # noqa: E402
import plan  # noqa: E402
import run  # noqa: E402
import table  # noqa: E402

LIBRARY_RUNS = [r for r in plan.plan(1, ("library",)) if r.strength == 0.01 and r.cases == 2]


@pytest.mark.parametrize(
    "name", ["bearing.heating", "touchpoint.step", "casing.asymmetry", "casing.precession", "bearing.drift"]
)
def test_the_integration_is_that_of_scipy(name):
    drawn = np.random.default_rng(1)
    case = experiment.CASES[1] | {"span": 4.0}
    world = hidden.LIBRARY[name](4e-6, hidden.Draw.of(4.0, drawn, drawn))
    torques = experiment.shake(4.0, 0.0, 1.0, drawn)
    motion = experiment.integrate(case, world, torques)
    times = np.arange(0, 4, 0.0137)
    y = [*case["start"], 0.0, 0.0] + [0.0] * (len(world.heating) + len(world.chirp))
    rates = experiment.equations(case, world, torques)
    exact = solve_ivp(rates, (0, 4), y, "DOP853", times, rtol=1e-12, atol=1e-12, max_step=0.01)
    for body in (0, 1):
        assert np.abs(motion.angle(times, body) - exact.y[2 + body]).max() < 1e-6


def test_a_casing_spun_against_the_rotor_reverses_where_scipy_finds_it():
    """Its dry friction jumps at the reversal: integrated in two parts, with the time of the reversal as an event."""
    case = experiment.CASES[1] | {"start": (759.0, -60.0), "span": 12.0}
    world, torques = experiment.Hidden(), experiment.shake(12.0, 0.0, 1.0, np.random.default_rng(1))
    motion = experiment.integrate(case, world, torques)
    rates = experiment.equations(case, world, torques)

    def against(t, y):
        """Return the rates with the friction of a casing that turns against the rotor, also after its reversal."""
        found = rates(t, y)
        return [found[0], found[1] + (2 * case["b1"] / case["I_casing"] if y[1] >= 0 else 0.0), *found[2:]]

    def reversal(t, y):
        return y[1]

    reversal.terminal = True
    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-9}
    first = solve_ivp(against, (0, 12), [759.0, -60.0, 0, 0], events=reversal, **options)
    begin = first.y[:, -1]
    begin[1] = 1e-300
    second = solve_ivp(rates, (first.t[-1], motion.time[-1]), begin, **options)
    assert 1 < first.t[-1] < 11
    assert np.abs(motion.time - first.t[-1]).min() < 1e-5
    assert motion.speed[-1] == pytest.approx(second.y[:2, -1], abs=1e-6)
    assert motion.turned[-1] == pytest.approx(second.y[2:, -1], abs=1e-5)


@pytest.mark.slow
def test_a_reversal_leaves_nothing_in_the_harmonics_of_the_angle():
    """With the true parameters all residuals are noise, also in the block in which dry friction jumps."""
    case = experiment.CASES[1] | {"start": (497.0, -165.0), "span": 120.0}
    made = experiment.record(
        case, experiment.Hidden(), torque_noise=0, rng=np.random.default_rng(3), label="a"
    )
    data = CaseData.of(make_record(**made))
    problem = Problem.of(ParameterLayout.of(Model.of(REDUCED), [data.record]), [data])
    known = {"omega_r": case["start"][0], "omega_c": case["start"][1]} | case
    theta = np.array([known[n.partition("@")[0].rpartition(".")[2]] for n in problem.layout.names])
    (prediction,) = problem.predict(theta)
    assert len(prediction.path.kinks) == 1
    residual = data.z - prediction.rows
    residual -= data.nuisance @ np.linalg.lstsq(data.nuisance, residual, rcond=None)[0]
    harmonic = residual[data.slices["harmonic"]]
    assert np.abs(harmonic).max() < 4.5
    assert np.mean(harmonic[harmonic != 0] ** 2) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("time", [1.0, 0.1])
def test_the_random_torque_has_its_size_and_its_memory(time):
    step, casing, _ = experiment.shake(5e3, 1e-7, time, np.random.default_rng(3))
    torque = np.array(casing)
    lag = round(time / step)
    assert np.std(torque) == pytest.approx(1e-7, rel=0.07)
    assert np.mean(torque[lag:] * torque[:-lag]) / np.var(torque) == pytest.approx(np.exp(-1), abs=0.05)


@pytest.mark.slow
def test_a_run_is_made_from_its_key_alone_and_no_two_are_alike():
    everything = plan.plan(10)
    assert len({r.key for r in everything}) == len(everything)
    assert {n for r in everything for n in r.hidden} >= {
        *hidden.LIBRARY, *hidden.BASE, *hidden.OUTSIDE, *foreign.FOREIGN
    }  # fmt: skip
    one, other = (
        r for r in plan.plan(2, ("library",)) if r.key.startswith("library|touchpoint.step|0.01|1|0|")
    )
    again = plan.Planned("library", ("touchpoint.step",), 0.01, 1, 0.0, 0)
    assert [w.truth for w in one.worlds()] == [w.truth for w in again.worlds()]
    assert one.worlds()[0].truth["t0"] != other.worlds()[0].truth["t0"]
    a, b = (r.records()[0]["casing"][1] for r in (one, again))
    assert np.array_equal(a, b)


@pytest.mark.parametrize("name", [*hidden.OUTSIDE, *foreign.FOREIGN])
def test_a_law_and_its_formula_are_the_same(name):
    draw = hidden.Draw.of(200.0, np.random.default_rng(1), np.random.default_rng(2))
    world = {**hidden.OUTSIDE, **foreign.FOREIGN}[name](2e-6, draw)
    effect = resolve(world.law)
    (torque,) = getattr(world, effect.joint)
    for t in np.linspace(1.0, 199.0, 23):
        wr, wc = 900.0 - 3 * t, 160.0 - 0.6 * t
        known = {"t": t, "omega_r": wr, "omega_c": wc, "delta": wr - wc, "k": world.truth["k"]}
        assert Tape([effect.expression])(known)[0] == pytest.approx(
            torque(t, wr, wc, 0.0), rel=1e-5, abs=1e-15
        )


def line(r, named, verdict="missing_effect", **more):
    return {
        "key": r.key,
        "part": r.part,
        "hidden": list(r.hidden),
        "strength": r.strength,
        "cases": r.cases,
        "noise": r.noise,
        "seed": r.seed,
        "commit": "abc",
        "date": "2026-01-01",
        "verdict": verdict,
        "named": named,
        "kinds": ["physical"] * len(named),
        "sigma": [[100.0, 50.0, 20.0]],
        "seconds": [1.0, 2.0],
        "added": None,
        **more,
    }


def known(r):
    """Answer wrongly for each effect of the bearing, by a class for the rotor's, and by the twin for windage."""
    name = r.hidden[0]
    if name.startswith("bearing."):
        return line(r, [], "adequate")
    if name.startswith("rotor."):
        return line(r, ["casing.air.laminar", name])
    parameters = [
        ["x.k@case1", 1.0, 0.1, 1.05, -0.5],
        ["x.k@case2", 1.0, 0.1, 1.5, -5.0],
        ["x.t0", 3.0, 1.0, 3.0, 0.0],
    ]
    good = {"chi2": [1.0, 1.05], "held": [1.0, 1.2], "parameters": parameters}
    return line(r, ["bearing.load" if name == "casing.windage" else name], added=good)


def measured(text, start):
    return next(row.split("|")[3].strip() for row in text.splitlines() if row.startswith(f"| {start}"))


def test_known_answers_give_known_rates(tmp_path):
    path = tmp_path / "lines.jsonl"
    runs = [r for r in LIBRARY_RUNS if r.noise == 0]
    for found in run.work(runs, 2, 60.0, known, ThreadPoolExecutor):
        lines.append(path, found)
    text = table.page(lines.read_lines(path), [], [])
    names = [r.hidden[0] for r in runs if r.hidden[0] != "external.constant"]
    bearing = sum(n.startswith("bearing.") for n in names)
    rotor = sum(n.startswith("rotor.") for n in names)
    first = len(names) - bearing - rotor
    assert f"({first} of {len(names)};" in measured(text, "right first, two recordings, 1 %, no torque")
    assert f"({len(names) - bearing} of {len(names) - bearing};" in measured(text, "in the class")
    assert f"({first} of {first};" in measured(text, "after adding it: reduced chi2")
    assert f"(0 of {first};" in measured(text, "after adding it: held-out")
    # external.constant is right, too, and has a strength
    assert f"({first + 1} of {2 * first + 2};" in measured(
        text, "95 % intervals of the added effect's strength"
    )
    assert "1, 1, 1; 100 %; 50" in text


def test_what_is_done_is_not_done_again_and_an_incomplete_line_is(tmp_path):
    path = tmp_path / "lines.jsonl"
    for r in LIBRARY_RUNS[:3]:
        lines.append(path, known(r))
    lines.append(path, {"key": LIBRARY_RUNS[3].key, "error": "ValueError: no"})
    with path.open("a") as stream:
        stream.write('{"key":"libr')
    lines.append(path, known(LIBRARY_RUNS[4]))
    done = {x["key"] for x in lines.read_lines(path) if "error" not in x}
    assert done == {r.key for r in (*LIBRARY_RUNS[:3], LIBRARY_RUNS[4])}
    assert run.guarded(lambda r: 1 / 0, LIBRARY_RUNS[0])["error"].startswith("ZeroDivisionError")


def test_other_parts_are_counted(tmp_path):
    def asked(part, **more):
        return [line(r, **more) for r in plan.plan(1, (part,)) if r.cases == 2 and r.noise == 0]

    pair = next(r for r in plan.plan(1, ("pair",)))
    a, b = pair.hidden
    sigma = {"sigma": [[9.0, 9.0, 9.0]] * 2}
    empty = asked("nothing", named=[], verdict="adequate")
    empty[0] |= {"verdict": "unexplained"}
    faults = asked("fault", named=["casing.windage"])
    faults[0] |= {"named": ["casing.windage", faults[0]["hidden"][0]]}
    outside = asked("outside", named=["casing.windage"])
    outside[0] |= {"named": ["casing.windage", "bearing.load"]}
    outside[1] |= {"verdict": "unexplained"}
    pairs = [
        line(pair, [b, a], **sigma) | {"key": "1"},
        line(pair, [a, "setup.inertia", b], **sigma) | {"key": "2"},
        line(pair, [a], **sigma) | {"key": "3"},
    ]
    text = table.page([*empty, *faults, *outside, *pairs], [], [])
    assert f"(1 of {len(empty)};" in measured(text, "false alarm, nothing hidden, no torque")
    assert f"({len(faults) - 1} of {len(faults)};" in measured(text, "a fault of measuring sold")
    assert f"(2 of {len(outside)};" in measured(text, "from outside the library")
    assert "(1 of 3;" in measured(text, "two effects at once")
    assert "(1 of 3;" in measured(text, "the same, in reach")


def test_other_gyroscopes_are_drawn_and_counted():
    runs = plan.plan(2, ("elsewhere",))
    drawn = [r.gyroscopes[0]["I_rotor"] for r in runs]
    assert len(set(drawn)) == len(runs)
    assert {r.cases for r in runs} == {1, 2}
    assert 0 < sum(r.noise > 0 for r in runs) < len(runs)
    found = [
        line(r, r.hidden, "missing_effect" if r.hidden else "adequate")
        for r in runs
        if not r.hidden or r.hidden[0] in hidden.LIBRARY
    ]
    text = table.page(found, [], []).partition("## Other gyroscopes")[2]
    library = [x for x in found if len(x["hidden"]) == 1 and x["hidden"][0] != "external.constant"]
    pairs = sum(len(x["hidden"]) == 2 for x in found)
    quiet = sum(not x["noise"] for x in library)

    def counted(start):
        return next(row.split("|")[2].strip() for row in text.splitlines() if row.startswith(f"| {start}"))

    assert f"({quiet} of {quiet};" in counted("right first, no torque noise")
    assert f"({len(library) - quiet} of {len(library) - quiet};" in counted("right first, torque noise")
    # the two that say "missing" where the rub has taken the constant torque up
    assert "(2 of 10;" in counted("nothing missing: a false alarm")
    assert pairs == 12
    assert f"({pairs} of {pairs};" in counted("two effects at once: both found")


def test_shares_have_their_intervals():
    none = judge.Share([False] * 30)
    assert none.interval == pytest.approx((0.0, 0.1157), abs=1e-4)
    assert str(judge.Share([True, False, True, True])) == "75 % (3 of 4; 19-99 %)"


@pytest.mark.slow
def test_the_oracle_sees_the_difference_that_the_effect_makes():
    """Whole size in sigma: angles with the effect minus angles without, over the noise, sample by sample."""
    from oracle import Oracle

    from fitting import REDUCED, Model, fit, make_record

    case, rng = experiment.CASES[0], np.random.default_rng
    drawn = hidden.Draw.of(case["span"], rng(1), rng(2))
    plain = experiment.record(case, experiment.Hidden(), torque_noise=0, rng=rng(5), label="case1")
    base = fit(Model.of(REDUCED), [make_record(**plain)])
    oracle = Oracle(base, 0.0, 1.0)
    without = experiment.run(case, experiment.Hidden(), torque_noise=0, rng=rng(5))
    for name in ("casing.air.quadratic", "touchpoint.step", "bearing.heating", "casing.precession"):
        world = hidden.LIBRARY[name](1e-10, drawn)
        made = experiment.run(case, world, torque_noise=0, rng=rng(5))
        difference = [made.casing - without.casing]
        difference += [p - q for p, q in zip(made.rotor, without.rotor, strict=True)]
        whole = np.linalg.norm(np.concatenate(difference)) / case["sigma"]
        seen = oracle.reach(name, [world])
        # rows are in units of the noise that was measured, which is right to a few hundredths; noise of the windows
        # that the data do not exclude reduces what the rotor shows
        assert seen.whole == pytest.approx(whole, rel=0.05), name
        assert seen.beside_rival <= seen.beside_base <= seen.whole
        same = oracle.default_for(name, [world]).reach(name, [world])
        assert same.beside_base < 1e-6 * seen.beside_base
    both = oracle.default_for("bearing.heating", [hidden.LIBRARY["bearing.heating"](1e-10, drawn)])
    alone, among = (
        o.reach("bearing.drift", [hidden.LIBRARY["bearing.drift"](1e-10, drawn)]) for o in (oracle, both)
    )
    assert among.beside_base < alone.beside_base
    assert among.whole == alone.whole


@pytest.mark.release
@pytest.mark.slow
def test_the_command_runs_a_part_of_the_plan_once(tmp_path):
    path = tmp_path / "lines.jsonl"
    words = ["--seeds", "1", "--only", "library|casing.air.quadratic|0.03|1|0|", "-o", str(path)]
    for printed in (1, 0):
        done = subprocess.run(
            [sys.executable, HERE / "run.py", *words], capture_output=True, text=True, check=True
        )
        assert len(done.stdout.splitlines()) == printed
    (found,) = [json.loads(row) for row in path.read_text().splitlines()]
    assert found["named"][0] == "casing.air.quadratic"
    assert judge.right_first(found)
    assert judge.in_reach(found)
    assert judge.chi2_good(found)
    assert judge.held_good(found)
    (pull,) = judge.pulls(found)
    assert abs(pull) < 4


@pytest.mark.release
@pytest.mark.slow
def test_the_score_is_what_the_oracle_foresaw():
    """With random torque: the root of the score of the hidden effect has its size in sigma as mean, and spread 1."""
    from answer import answer

    found = answer(plan.Planned("library", ("casing.windage",), 0.03, 2, plan.NOISE, 0))
    score = max(row[2] for row in found["ranked"] if row[0] in hidden.twins("casing.windage"))
    assert found["sigma"][0][1] > 8
    assert abs(np.sqrt(score) - found["sigma"][0][1]) < 4
    assert found["base"]["level"] == pytest.approx(plan.NOISE, rel=0.5)


BENCHMARKS = HERE.parent


@pytest.mark.parametrize("script", sorted(BENCHMARKS.rglob("*.py")), ids=lambda path: path.stem)
def test_what_a_benchmark_imports_exists(script):
    for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in {"fitting", "gyrotrack"}:
            module = importlib.import_module(node.module)
            for name in node.names:
                if not hasattr(module, name.name):
                    importlib.import_module(f"{node.module}.{name.name}")
