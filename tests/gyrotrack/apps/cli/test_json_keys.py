"""docs/reference/json.md lists every key of every document that a command prints, and no other key."""

import importlib.util
import types
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[4]
CLIPS = ROOT / "sample_clips"
INERTIAS = ["--inertia-rotor", "4.2e-6 +- 1e-8", "--inertia-casing", "1.6e-6"]


def _page():
    spec = importlib.util.spec_from_file_location("make_json", ROOT / "docs/make_json.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PAGE = _page()
SIMPLE = {
    float: (int, float, types.NoneType),
    int: int,
    bool: bool,
    str: str,
    Path: str,
    types.NoneType: types.NoneType,
}


def of_keys(value, kinds, where):
    """Return the faults of an object that has the keys of some classes."""
    listed = {name: key for kind in kinds for name, key in PAGE.keys(kind).items()}
    if not isinstance(value, dict):
        return [f"{where} is not an object: {value!r:.60}"]
    found = [f"{where}.{name} is not on the page" for name in value.keys() - listed.keys()]
    found += [
        f"{where}.{k.name} is missing" for k in listed.values() if not k.optional and k.name not in value
    ]
    shared = [listed[name] for name in value if name in listed]
    return found + [f for k in shared for f in faults(value[k.name], k.type, f"{where}.{k.name}")]


def faults(value, hint, where):
    """Return the differences of a value from its type on the page."""
    origin, arguments = PAGE._parts(hint)
    if PAGE.is_document(origin):
        return of_keys(value, [origin], where)
    if origin in (typing.Union, types.UnionType):
        return min((faults(value, a, where) for a in arguments), key=len)
    if origin in SIMPLE:
        right = isinstance(value, SIMPLE[origin]) and (origin is bool) == isinstance(value, bool)
        right |= origin is float and value in ("inf", "-inf")
        return [] if right else [f"{where} is not a {origin.__name__}: {value!r:.60}"]
    if origin is typing.Literal:
        return [] if value in arguments else [f"{where} is {value!r:.60}"]
    if isinstance(origin, type) and issubclass(origin, Mapping | Sequence | np.ndarray):
        kind = dict if issubclass(origin, Mapping) else list
        if not isinstance(value, kind):
            return [f"{where} is not of type {kind.__name__}: {value!r:.60}"]
        if origin is tuple and ... not in arguments and len(value) != len(arguments):
            return [f"{where} has {len(value)} elements"]
        parts = value.items() if kind is dict else enumerate(value)
        of_part = typing.Any if origin is np.ndarray or not arguments else arguments[kind is dict]
        return [f for k, x in parts for f in faults(x, of_part, f"{where}.{k}")]
    assert hint is typing.Any or isinstance(hint, typing.ForwardRef)  # the latter is a type within itself
    return []


@pytest.fixture
def printed(gyrotrack):
    """Run a command, compare its document with the page, and return it."""

    def run(command, *words):
        said = gyrotrack(command, *words, "--json")
        assert said.code in {0, 3}, said.out
        document = said.json
        cases = PAGE.classes(command).values()
        assert min((of_keys(document, kinds, command) for kinds in cases), key=len) == []
        return document

    return run


@pytest.fixture
def wheel(tmp_path):
    """A table of a wheel that slows down."""
    t = np.arange(0, 20, 0.05)
    angle = 30 * (1 - np.exp(-t / 12)) + 1e-3 * np.random.default_rng(1).standard_normal(len(t))
    np.savetxt(tmp_path / "wheel.csv", np.stack([t, angle], 1), delimiter=",", header="t,angle", comments="")
    return tmp_path / "wheel.csv"


@pytest.mark.parametrize(
    "words",
    [
        ["effects"],
        ["effects", "casing.air.quadratic"],
        ["config", "--all"],
        ["batch", CLIPS, "--dry-run", "--casing-fps", 260, "--rotor-fps", 1000, *INERTIAS],
    ],
    ids=lambda words: " ".join(map(str, words[:2])),
)
def test_keys_of_lists(printed, words):
    printed(*words)


def test_keys_of_files(printed, case, wheel, tmp_path):
    printed("info", case("plain"), "--verify")
    printed("export", case("plain"), "-o", tmp_path / "plain.csv")
    printed("import", "--body", wheel, "-o", tmp_path / "wheel.h5")
    assert printed("import", "--body", wheel, "--dry-run")["plot"]


def test_keys_of_simulations(printed, tmp_path):
    short = ["--duration", "12", "--window-length", "1"]
    printed("simulate", "-o", tmp_path / "case.h5", *short)
    printed("simulate", "-o", tmp_path / "sealed.h5", *short, "--hide")
    printed("reveal", tmp_path / "sealed.seal.json", "--answer", "casing.air.quadratic")


@pytest.mark.slow
def test_keys_of_fits(printed, study):
    assert len(printed("ladder", study)["ladder"]) == 2
    printed("fit", study, "--from", "f1")


def test_keys_of_the_workbench(printed, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "gyrotrack.apps.workbench._server.serve", lambda bench, port, announce, window: announce("u")
    )
    printed("view", "--folder", tmp_path, "--no-browser")


def test_keys_of_an_error(gyrotrack):
    assert gyrotrack("info", "absent.h5", "--json").error.keys() == {"code", "message", "hint"}


@pytest.mark.slow
@pytest.mark.parametrize("words", [["--tracking"], ["--fitting"]], ids=" ".join)
def test_keys_of_numbers(printed, words):
    printed("config", *words)


@pytest.mark.slow
@pytest.mark.release
def test_keys_of_studies(printed, study, tmp_path):
    fit = printed("fit", study, "--from", "f1", "--profile", "b1")
    assert fit["parameters"]["touchpoint.constant.b1"]["interval"]
    printed("budget", study)
    printed("diagnose", study, "--from", "f1")
    printed("report", study, "-o", tmp_path / "report.html")
    printed("plan", study, "--friction", "--picture", tmp_path / "plan.png")
    printed("improve", study, "--from", "f1")
    printed("laws", study, "--from", "f1")


@pytest.mark.release
@pytest.mark.slow
def test_keys_of_a_certificate(printed, study):
    printed("certify", study, "-n", 1, "--workers", 1)


@pytest.mark.slow
def test_keys_of_several_cases(printed, case, tmp_path):
    cases = [case("plain"), case("other")]
    assert len(printed("fit", *cases)["fits"]) == 2
    ledger = ["--ledger", tmp_path / "joint.json"]
    assert printed("fit", *cases, "--joint", "--hold-out", *ledger)["predicted"]
    assert printed("fit", cases[0], "--rotor", "generated", *ledger)["generated_rotor"]
    printed("compare", *cases)
    printed("scan", cases[0])
    printed("figures", cases[0], "-o", tmp_path / "figures")


@pytest.mark.slow
def test_keys_of_a_population(printed, tmp_path):
    for i in range(8):
        words = ["--duration", 20, "--casing-fps", 20, "--rotor-fps", 100, "--window-length", 2, "--seed", i]
        printed("simulate", "-o", tmp_path / f"run{i}.h5", *words)
    assert printed("compare", tmp_path, "--model", "reduced", "--workers", 1)["population"]["parameters"]


@pytest.mark.release
@pytest.mark.slow
def test_keys_of_one_body(printed, wheel, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert printed("spindown", wheel)["diagnosis"]
    t = np.arange(0, 20, 0.05)
    noise = np.random.default_rng(1).standard_normal(len(t))
    tables = {
        "pendulum": ("t,angle", 0.5 * np.exp(-t / 30) * np.cos(3 * t) + 1e-3 * noise),
        "motor": ("t,omega,current [A]", np.where(t > 2, 30 * (1 - np.exp(-(t - 2) / 3)), 0) + 0.05 * noise),
    }
    for name, (header, value) in tables.items():
        columns = [t, value, 3.0 * (t > 2)][: header.count(",") + 1]
        np.savetxt(f"{name}.csv", np.stack(columns, 1), delimiter=",", header=header, comments="")
    assert printed("spindown", "pendulum.csv")["oscillator"]
    assert printed("spindown", "motor.csv")["response"]
    assert printed("spindown", "motor.csv", "--input", "current=3 [A]", "-o", "driven.h5")["first_order"]
    assert printed("info", "driven.h5")["inputs"]


@pytest.mark.release
@pytest.mark.slow
def test_keys_of_films(printed, demo, tmp_path):
    document, folder = demo
    assert of_keys(document, *PAGE.classes("demo").values(), "demo") == []
    printed("profile", CLIPS / "rotor_1.mp4", "-o", tmp_path / "profile.toml")
    clips = [folder / "casing.h5", folder / "rotor_1.h5"]
    printed("info", clips[0])
    printed("sync", *clips, "-o", tmp_path / "case.h5", *INERTIAS)
    assert printed("info", tmp_path / "case.h5")["recordings"]
    batch = ["--until", "extract", "--casing-fps", 260, "--rotor-fps", 1000, "-o", tmp_path / "batch"]
    printed("batch", CLIPS, *batch)
    printed("extract", CLIPS / "rotor_2.mp4", "--capture-fps", 1000, "-o", tmp_path / "rotor.h5")


@pytest.mark.slow
def test_keys_of_points(printed, bob, tmp_path):
    film = tmp_path / "bob.mp4"
    bob(frames=60, period=0.6, colour=True).write(film)
    words = ["--colour", "blue", "--capture-fps", 50, "-o", tmp_path / "bob.h5"]
    assert printed("extract", film, *words)["points"]
