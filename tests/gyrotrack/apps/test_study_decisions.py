"""Which fit a study starts from, and what a simulated run contains: with ledgers and fits that are stubs."""

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import GENERAL, LIBRARY, LINEAR, REDUCED, Experiment, FittingError, LedgerError, Model
from gyrotrack import DatasetError, FitRequest, SimulatedRun, Study, UsageError
from gyrotrack.apps import _simulation, _study
from gyrotrack.apps._points import read_point, read_tilt
from gyrotrack.apps._simulation import OUTSIDE, Seal, answer_of, draw_effect, grade, hide_effect
from gyrotrack.apps._study import Recorder, checked_body_name, latest_fits, with_ledgers
from gyrotrack.io._records import Series

MECHANISM = Model.of(REDUCED).mechanism


def data(digest="d", is_chain=False):
    record = SimpleNamespace(
        digest=digest,
        mechanism=MECHANISM,
        parts=frozenset({"rotor", "casing", "ground"}),
        is_chain=is_chain,
        inputs=(),
        units=None,
    )
    return SimpleNamespace(record=record)


class StubEntry:
    def __init__(self, fit_id, digests=("d",), parent="", **options):
        self.fit_id, self.digests = fit_id, list(digests)
        self.document = {"parent": parent, "added": f"+{fit_id}"}
        self.model, self.choices, self.prior, self.estimates = Model.of(REDUCED), ((), ()), None, {}
        self.stored = None
        vars(self).update(options)

    def refit(self, data):
        return f"refit {self.fit_id}"

    def shown(self, data):
        return f"shown {self.fit_id}"

    def diagnosis(self, fit, extra):
        return self.stored

    def certificate(self, found):
        return f"certificate {self.fit_id} {found}"


class StubLedger:
    path = Path("l")

    def __init__(self, *entries):
        self.entries, self.added, self.kept = list(entries), [], []

    def find(self, fit_id):
        return next(e for e in self.entries if e.fit_id == fit_id)

    def of(self, data):
        return [e for e in self.entries if sorted(e.digests) == sorted(d.record.digest for d in data)]

    def add(self, fit, **options):
        self.added.append((fit, options))
        self.entries.append(StubEntry(f"n{len(self.added)}"))
        return self.entries[-1]

    def keep_diagnosis(self, *arguments):
        self.kept.append(arguments)


def study(*entries, **options):
    return Study((data(),), StubLedger(*entries), **options)


def chain():
    return study(
        StubEntry("f1"),
        StubEntry("f2", parent="f1"),
        StubEntry("g1", ["other"]),
        StubEntry("f3", parent="f2"),
        StubEntry("f4", parent="f1"),
    )


def test_latest_fit_of_the_cases_is_the_default():
    assert chain().entry(None).fit_id == "f4"
    assert chain().entry("f2").fit_id == "f2"
    assert study(StubEntry("g", ["other"])).entry(None) is None
    with pytest.raises(UsageError, match="other cases"):
        chain().entry("g1")
    both = Study((data("b"), data("a")), StubLedger(StubEntry("f", ["a", "b"])))
    assert both.entry("f").fit_id == both.entry(None).fit_id == "f"


def test_history_of_a_fit():
    steps = chain().steps_to("f3")
    assert [(s.change, s.fit) for s in steps] == [
        ("+f1", "shown f1"),
        ("+f2", "shown f2"),
        ("+f3", "shown f3"),
    ]
    assert [s.change for s in chain().steps_to(None)] == ["+f1", "+f4"]
    loop = study(StubEntry("a", parent="b"), StubEntry("b", parent="a"))
    assert [s.change for s in loop.steps_to("b")] == ["+a", "+b"]
    assert chain().certificate("f3", "x") == "certificate f1 x"


def test_diagnosis_is_made_once(monkeypatch):
    made = []
    monkeypatch.setattr(
        "fitting.discovery._verdict.diagnose", lambda fit, extra, workers: made.append(fit) or "found"
    )
    found = chain()
    assert found.diagnosis("f3", "fit") == "found"
    assert found.ledger.kept == [("f1", "found", ())]
    found.ledger.find("f1").stored = "stored"
    assert found.answered("f3") == ("stored", "f1")
    assert made == ["fit"]

    def refused(*_):
        raise LedgerError("full")

    found.ledger.keep_diagnosis = refused
    found.keep_diagnosis("f1", "found")


def test_base_is_the_latest_fit_or_a_new_one(monkeypatch):
    calls = []
    monkeypatch.setattr(
        "fitting.inference._fit.fit",
        lambda model, data, **options: calls.append((model, data, options)) or "new",
    )
    monkeypatch.setattr("fitting.inference._case_data.with_prior", lambda data, prior: (data, prior))
    assert chain().base("f2") == ("refit f2", "f2")
    assert calls == []
    empty = study()
    assert empty.base(None) == ("new", "n1")
    assert sorted(calls[0][0].names) == sorted(REDUCED)
    assert [s.fit for s in study().steps_to(None)] == ["new"]
    prior = SimpleNamespace(source="s")
    same = study(StubEntry("f1", prior=prior), prior=prior)
    assert same.base(None) == ("refit f1", "f1")
    estimates = {"a": SimpleNamespace(value=3.0)}
    other = study(StubEntry("f1", choices=(("a",), ("b",)), estimates=estimates), prior=prior)
    assert other.base(None) == ("new", "n1")
    assert calls[-1][2] == {"share": ("a",), "per_case": ("b",), "start": {"a": 3.0}}
    assert calls[-1][1][1] is prior
    assert other.ledger.added[0][1] == {"parent": "f1", "added": "prior s"}


def test_first_model_of_a_chain_is_linear():
    assert sorted(study().first_model.names) == sorted(REDUCED)
    of_chain = Study((data(is_chain=True),), StubLedger())
    assert set(of_chain.first_model.names) <= set(LINEAR)


def test_recorder_names_the_previous_fit():
    ledger = StubLedger(StubEntry("f1"))
    recorder = Recorder(ledger, [ledger.find("f1")], "first")
    for name in ("second", "third"):
        recorder(SimpleNamespace(fit=name, change=f"+{name}"))
    assert ledger.added == [
        ("second", {"parent": "f1", "added": "+second", "previous": "first"}),
        ("third", {"parent": "n1", "added": "+third", "previous": "second"}),
    ]


# ---- requests


def test_change_of_a_request():
    request = FitRequest(add=("a", "b"), drop=("c",), held={"k": 0.5}, loss="huber")
    assert request.change == "+a +b -c k=0.5 huber"
    assert FitRequest(model="general").change == "general"
    assert FitRequest().change == ""
    assert FitRequest(model="general", add=("a",)).change == "+a"


def test_model_of_a_request():
    found = chain()
    found.ledger.find("f4").model = Model.of(REDUCED).with_effect(LIBRARY["casing.air.quadratic"])

    def wanted(**options):
        return FitRequest(**options)._wanted(found, options.pop("start", None))

    model, entry = FitRequest(add=("bearing.drift",))._wanted(found, None)
    assert entry.fit_id == "f4"
    assert set(model.names) == {*REDUCED, "casing.air.quadratic", "bearing.drift"}
    model, entry = FitRequest(drop=("casing.air.quadratic",))._wanted(found, None)
    assert (set(model.names), entry.fit_id) == (set(REDUCED), "f4")
    model, entry = FitRequest()._wanted(found, "f2")
    assert (set(model.names), entry.fit_id) == (set(REDUCED), "f2")
    model, entry = wanted()
    assert (set(model.names), entry) == (set(REDUCED), None)
    for name, effects in (("general", GENERAL), ("linear", LINEAR), ("reduced", REDUCED)):
        model, entry = FitRequest(model=name, add=("bearing.drift",))._wanted(found, None)
        assert (set(model.names), entry) == ({*effects, "bearing.drift"}, None)
    with pytest.raises(UsageError, match="Unknown model"):
        wanted(model="none")
    key = next(iter(Model.of(REDUCED).free))
    held = FitRequest(held={key: 2.0}).model_for(found)
    assert key not in held.free


def test_effects_are_added_once():
    model = Model.of(REDUCED)
    name = REDUCED[0] if isinstance(REDUCED, tuple | list) else next(iter(REDUCED))
    assert _study.changed(model, [name], (), ()) is model
    own = SimpleNamespace(name=name)
    assert _study.changed(model, [name], (), [own]) is model
    more = _study.changed(model, ["bearing.drift"], (), ())
    assert set(_study.changed(more, (), ["bearing.drift"], ()).names) == set(model.names)


@pytest.mark.parametrize(
    ("law", "known"),
    [
        ("casing: -k*omega_c", "casing.air.linear"),
        ("casing: q * omega_c", "casing.air.linear"),
        ("casing: -k*omega_c**3", None),
        ("rotor: -k*omega_r", None),
        ("rotor: -k*omega_c", None),
    ],
)
def test_a_law_of_the_model_is_not_added_under_another_name(law, known):
    model = Model.of(("touchpoint.constant", "casing.air.linear"))
    if known is None:
        assert len(_study.changed(model, [law], (), ()).effects) == 3
        return
    with pytest.raises(UsageError, match=f"already in the model as '{known}'") as refused:
        _study.changed(model, [law], (), ())
    assert f"--drop '{known}'" in refused.value.hint
    assert _study.changed(model, [law], (known,), ()).names == ("touchpoint.constant", law)


def test_choices_follow_the_modified_fit():
    wanted = SimpleNamespace(free=("bearing.linear.k", "casing.air.linear.k"))
    entry = StubEntry("f", choices=(("bearing.linear.k", "other.k"), ("casing.air.linear.k",)))
    assert FitRequest(share=("x",))._choices(None, wanted) == (("x",), ())
    assert FitRequest()._choices(entry, wanted) == (("bearing.linear.k",), ("casing.air.linear.k",))
    swapped = FitRequest(share=("casing.air.linear.k",), per_case=("bearing.linear.k",))._choices(
        entry, wanted
    )
    assert swapped == (("casing.air.linear.k",), ("bearing.linear.k",))


@pytest.mark.parametrize(
    ("prior", "entry_prior", "known"),
    [(("a",), None, True), (("z",), None, False), (None, ("z",), False), (None, ("a",), True)],
)
def test_fit_of_a_request(monkeypatch, prior, entry_prior, known):
    def made(names):
        return None if names is None else SimpleNamespace(names=names, source="s")

    monkeypatch.setattr("fitting.inference._case_data.with_prior", lambda data, prior: (data, prior))
    monkeypatch.setattr(_study, "_starts", lambda previous, wanted: {"a": 1.0})
    calls = []
    monkeypatch.setattr(
        FitRequest,
        "_fitted",
        lambda self, data, wanted, start, options: calls.append((data, start, dict(options))) or "fit",
    )
    wanted = SimpleNamespace(free=("a", "b"))
    entry = StubEntry("f1", prior=made(entry_prior))
    monkeypatch.setattr(FitRequest, "_wanted", lambda self, study, start: (wanted, entry))
    found = study(entry, prior=made(prior))
    request = FitRequest(share=("a",), loss="huber", drop=("q",))
    if not known:
        with pytest.raises(UsageError, match="No parameter of the prior"):
            request.fit(found)
        return
    assert request.fit(found) == ("fit", "n1")
    assert calls[0][0][1].names == (prior or entry_prior)
    assert calls[0][1] == {"a": 1.0}
    assert calls[0][2] == {"share": ("a",), "per_case": (), "ranges": {}}
    options = found.ledger.added[0][1]
    assert (options["parent"], options["previous"], options["loss"], options["added"]) == (
        "f1",
        "refit f1",
        "huber",
        "-q huber",
    )


def test_first_request_that_adds_a_law_fits_the_base_before(monkeypatch):
    monkeypatch.setattr("fitting.inference._case_data.with_prior", lambda data, prior: data)
    monkeypatch.setattr("fitting.inference._fit.fit", lambda model, data: "base")
    monkeypatch.setattr(_study, "_starts", lambda previous, wanted: {})
    calls = []
    monkeypatch.setattr(
        FitRequest,
        "_fitted",
        lambda self, data, wanted, start, options: calls.append((start, dict(options))) or "fit",
    )
    found = study()
    assert FitRequest(add=("bearing.drift",)).fit(found) == ("fit", "n2")
    assert found.ledger.added[1][1]["parent"] == "n1"
    assert calls[0][0] is None
    found = study()
    for request in (FitRequest(), FitRequest(model="linear", add=("bearing.drift",))):
        found = study()
        request.fit(found)
        assert len(found.ledger.added) == 1
        assert found.ledger.added[0][1]["parent"] == ""
    monkeypatch.setattr(_study, "_paper_ranges", lambda *_: {"k": (0.0, 1.0)})
    FitRequest(model="general").fit(study())
    assert calls[-1][1]["ranges"] == {"k": (0.0, 1.0)}


def test_a_fit_with_a_drive_starts_from_defaults():
    previous = SimpleNamespace(
        model=SimpleNamespace(effects=[], names=()), estimates={"a": SimpleNamespace(value=2.0)}
    )
    driven = SimpleNamespace(effects=[SimpleNamespace(inputs=("u",), name="d")])
    assert _study._starts(previous, driven) == {}
    assert _study._starts(previous, SimpleNamespace(effects=[])) == {"a": 2.0}
    known = SimpleNamespace(
        model=SimpleNamespace(effects=driven.effects, names=("d",)), estimates=previous.estimates
    )
    assert _study._starts(known, driven) == {"a": 2.0}


@pytest.mark.parametrize(
    ("start", "driven", "fails", "other", "expected", "count"),
    [
        ({"a": 1.0}, True, True, 1.0, "second", 2), ({"a": 1.0}, True, True, 3.0, "first", 2),
        ({"a": 1.0}, True, False, 1.0, "first", 1),
        ({"a": 1.0}, False, True, 1.0, "first", 1), (None, True, True, 1.0, "first", 1),
    ],
)  # fmt: skip
def test_a_failing_fit_of_a_driven_body_is_compared_with_one_from_defaults(
    monkeypatch, start, driven, fails, other, expected, count
):
    results = [
        SimpleNamespace(name="first", deviance=2.0, fails=lambda: fails),
        SimpleNamespace(name="second", deviance=other),
    ]
    calls = []

    def fit(wanted, data, loss, start=None, **options):
        calls.append(start)
        return results[len(calls) - 1]

    monkeypatch.setattr("fitting.inference._fit.robust_fit", fit)
    wanted = SimpleNamespace(effects=[SimpleNamespace(inputs=("u",) if driven else ())])
    assert FitRequest()._fitted([], wanted, start, {}).name == expected
    assert calls == [start, None][:count]


def test_a_fit_that_cannot_start_is_repeated_from_defaults(monkeypatch):
    def fit(wanted, data, loss, start=None, **options):
        if start is not None:
            raise FittingError("no")
        return "found"

    monkeypatch.setattr("fitting.inference._fit.robust_fit", fit)
    assert FitRequest()._fitted([], SimpleNamespace(effects=[]), {"a": 1.0}, {}) == "found"

    def never(*_, **__):
        raise FittingError("no")

    monkeypatch.setattr("fitting.inference._fit.robust_fit", never)
    with pytest.raises(FittingError):
        FitRequest()._fitted([], SimpleNamespace(effects=[]), None, {})


def test_latest_fits_of_runs(tmp_path, monkeypatch):
    ledgers = {"a.fits.json": [StubEntry("f1"), StubEntry("f2", model=Model.of(LINEAR))], "b.fits.json": []}
    monkeypatch.setattr(
        "fitting.study._history.Ledger", lambda path: SimpleNamespace(entries=ledgers[path.name])
    )
    for name in ledgers:
        (tmp_path / name).write_text("")
    assert {k: e.fit_id for k, e in latest_fits([tmp_path / "a.fits.json"]).items()} == {"a": "f2"}
    assert latest_fits([tmp_path / "a.fits.json"], sorted(Model.of(REDUCED).names))["a"].fit_id == "f1"
    for path, match in (("none.json", "no file"), ("b.fits.json", "has no fit")):
        with pytest.raises(DatasetError, match=match):
            latest_fits([tmp_path / path])
    with pytest.raises(UsageError, match="twice"):
        latest_fits([tmp_path / "a.fits.json", tmp_path / "." / "a.fits.json"])
    other = tmp_path / "x"
    other.mkdir()
    (other / "a.fits.json").write_text("")
    assert list(latest_fits([tmp_path / "a.fits.json", other / "a.fits.json"])) == [
        "a",
        str(other.resolve() / "a"),
    ]
    case = tmp_path / "a.h5"
    case.write_text("")
    monkeypatch.setattr("fitting.inference._case_file.read_record", lambda path: SimpleNamespace(digest="e"))
    entries = [StubEntry("g1", ["e"]), StubEntry("g2", ["e", "d"]), StubEntry("g3", ["d"])]
    monkeypatch.setattr(
        "fitting.study._history.Ledger",
        SimpleNamespace(default_for=lambda path: SimpleNamespace(entries=entries)),
    )
    assert latest_fits([case])["a"].fit_id == "g1"


def test_priors_of_other_studies(monkeypatch):
    effect = LIBRARY["casing.air.linear"]
    key = f"casing.air.linear.{effect.parameters[0].symbol}"
    entry = StubEntry("f1", ["p"], estimates={key: SimpleNamespace(unit="N m s")})
    entry.model = SimpleNamespace(parameters={key: SimpleNamespace(unit="u")}, effects=[effect])
    prior = SimpleNamespace(names=(key,), renamed=dict)
    entry.as_prior = lambda name: prior
    monkeypatch.setattr(_study, "latest_fits", lambda paths: {"x": entry})
    unit = {"unit": "N m s"}
    monkeypatch.setattr(
        "fitting._numbers.Units.common", lambda units: SimpleNamespace(of=lambda _: unit["unit"])
    )
    assert _study._prior_of(Path("x"), [data()], rotor=False) is prior
    renamed = _study._prior_of(Path("x"), [data()], rotor=True)
    assert set(renamed) == {key}
    assert renamed[key].startswith("rotor.")
    with pytest.raises(UsageError, match="same data"):
        _study._prior_of(Path("x"), [data("p")], rotor=False)
    unit["unit"] = "s-1"
    with pytest.raises(UsageError, match="need s-1"):
        _study._prior_of(Path("x"), [data()], rotor=False)
    unit["unit"] = "N m s"
    entry.model.effects = []
    with pytest.raises(UsageError, match="No law"):
        _study._prior_of(Path("x"), [data()], rotor=True)
    with pytest.raises(UsageError, match="both bodies"):
        _study.open_study([Path("a.h5")], None, read=(data(),), prior=Path("p"), prior_rotor=Path("p"))


def test_names_and_options_are_checked():
    assert checked_body_name("wheel") == "wheel"
    assert checked_body_name("") == ""
    for name in ("two words", "1", "rotor"):
        with pytest.raises(UsageError):
            checked_body_name(name)
    for options in ({"data": "speed"}, {"rotor": "none"}):
        with pytest.raises(UsageError):
            _study.read_cases([], **options)
    found = with_ledgers([Path("x/a.h5")], None, Path("b"))
    assert found == [Path("x/a.h5"), Path("x/a.fits.json"), None, Path("b")]


@pytest.mark.parametrize(
    ("text", "angle", "azimuth"), [("30", 30, 90), ("30,45", 30, 45), ("0", 0, 90), ("75,-10", 75, -10)]
)
def test_tilts_are_read(text, angle, azimuth):
    found = read_tilt(text)
    assert (found.angle, found.azimuth) == (
        pytest.approx(math.radians(angle)),
        pytest.approx(math.radians(azimuth)),
    )


@pytest.mark.parametrize("text", ["75.1", "-1", "a", "30,inf", "nan", "1,2,3", ""])
def test_other_texts_for_a_tilt_are_refused(text):
    with pytest.raises(UsageError):
        read_tilt(text)
    with pytest.raises(UsageError):
        read_point(text)


def test_positions_are_read():
    assert read_point("320,240.5") == (320.0, 240.5)
    for text in ("1,inf", "nan,2"):
        with pytest.raises(UsageError):
            read_point(text)


# ---- simulations


def test_clips_of_an_experiment():
    experiment = Experiment(
        duration=10.0, casing_fps=260.0, rotor_fps=1000.0, windows=(2.0, 7.0), window_length=1.5
    )
    casing, first, second = _simulation._clips(experiment)
    assert [c.name for c in (casing, first, second)] == ["casing.mp4", "rotor_1.mp4", "rotor_2.mp4"]
    assert (casing.frames, first.frames) == (2598, 1498)
    assert (casing.camera.fps, casing.camera.container_fps, casing.camera.start) == (260.0, 260.0, 1 / 260)
    assert (second.camera.fps, second.camera.container_fps) == (1000.0, 25.0)
    assert second.camera.start == pytest.approx(7.001)
    assert second.camera.exposure == pytest.approx(4e-4)
    assert casing.camera.tilt == 0.06
    run = SimulatedRun(Model.of(REDUCED), {}, experiment, (1e-5, 2e-5), 3)
    assert run.film_files(Path("x")) == [Path("x/casing.mp4"), Path("x/rotor_1.mp4"), Path("x/rotor_2.mp4")]


def test_films_of_a_run(monkeypatch, tmp_path):
    rendered, reported = [], []
    monkeypatch.setattr(_simulation, "_motion", lambda model, values, experiment: values)

    def render(path, scene, motion, camera, light, *, frames, seed, force, progress):
        rendered.append((path.name, frames, seed, force, motion))
        progress(1, frames)

    monkeypatch.setattr(_simulation, "render_clip", render)
    experiment = Experiment(
        duration=1.0, casing_fps=100.0, rotor_fps=200.0, windows=(0.2,), window_length=0.5
    )
    run = SimulatedRun(Model.of(REDUCED), {"k": 5.0}, experiment, (1e-5, 2e-5), 3)
    run.films(tmp_path / "new", force=True, progress=lambda k, n: reported.append((k, n)))
    assert [r[:4] for r in rendered] == [("casing.mp4", 98, 3, True), ("rotor_1.mp4", 98, 101, True)]
    assert reported == [(1, 196), (99, 196)]
    values = rendered[0][4]
    assert (values[_simulation.INERTIA_ROTOR], values[_simulation.INERTIA_CASING], values["k"]) == (
        1e-5,
        2e-5,
        5.0,
    )


def test_parameters_of_a_run():
    run = SimulatedRun.of(Model.of(REDUCED), 1.0, Experiment(), (1e-5, 2e-5), 3)
    key = next(iter(run.numbers))
    given = SimulatedRun.of(Model.of(REDUCED), 1.0, Experiment(), (1e-5, 2e-5), 3, [f" {key} = 2.5"])
    assert given.numbers == run.numbers | {key: 2.5}
    for item in ("z=1", key, f"{key}=z"):
        with pytest.raises(UsageError):
            SimulatedRun.of(Model.of(REDUCED), 1.0, Experiment(), (1e-5, 2e-5), 3, [item])
    seen = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            _simulation,
            "typical_of_model",
            lambda effects, share, *, duration, speeds: seen.update(speeds, share=share, d=duration) or {},
        )
        SimulatedRun.of(Model.of(REDUCED), 1.5, Experiment(omega_rotor=500.0, duration=20.0), (1e-5, 2e-5), 3)
    assert seen == {"omega_r": 300.0, "omega_c": 100.0, "share": 1.5, "d": 20.0}
    measuring = next(n for n, e in LIBRARY.items() if e.kind != "physical")
    with pytest.raises(UsageError, match="Measurement"):
        SimulatedRun.of(Model.of([*REDUCED, measuring]), 1.0, Experiment(), (1e-5, 2e-5), 3)


def test_drawn_effects():
    class Chance:
        def __init__(self, share, index):
            self.share, self.index = share, index

        def random(self):
            return self.share

        def integers(self, count):
            self.count = count
            return self.index

    outside = Chance(0.199, 2)
    assert draw_effect((), outside).name == _simulation.resolve(OUTSIDE[2]).name
    assert outside.count == len(OUTSIDE)
    chance = Chance(0.2, 0)
    first = draw_effect((), chance)
    known = [n for n, e in LIBRARY.items() if e.kind == "physical" and e.searched and not e.restoring]
    known = [
        n for n in known if n not in {"external.constant", "bearing.power", "casing.friction.presliding"}
    ]
    assert (first.name, chance.count) == (known[0], len(known))
    assert draw_effect([known[0]], chance).name == known[1]
    for seed in range(20):
        hidden = hide_effect(Model.of(REDUCED), 3.0)
        assert 1.5 <= hidden.strength <= 6.0
        assert hidden.effect.name in hidden.model.names
        assert hidden.effect.name not in REDUCED
        assert seed < 20


def test_answers_of_a_history():
    def entry(verdict, model, parameters=None):
        return SimpleNamespace(document={"verdict": verdict, "model": model, "parameters": parameters or {}})

    last = {"b.k": {"value": 2.0, "stderr": 0.5}, "c.k": {"value": 1.0, "stderr": None}}
    for verdict, named in (("no_lack_of_fit", ["b"]), ("adequate", ["b"]), ("missing_effect", [])):
        assert answer_of([entry("x", ["a"]), entry(verdict, ["a", "b"], last)]) == (
            named,
            {"b.k": (2.0, 0.5)},
        )
    truth = Seal("bearing.drift", {"bearing.drift.k": 3.0}, "")
    score = grade(truth, ["bearing.drift"], {"bearing.drift.k": (2.0, 0.5), "z": (1.0, 1.0)})
    assert (score.grade, score.pulls) == ("right", {"bearing.drift.k": -2.0})
    assert grade(truth, [], {"bearing.drift.k": (2.0, 0.0)}).pulls == {}


def test_seal_holds_only_the_parameters_of_the_effect(tmp_path):
    hidden = _simulation.Hidden(None, LIBRARY["bearing.drift"], 1.0, 3)
    hidden.seal(tmp_path / "a", {"bearing.drift.k": 1.0, "bearing.drifting.k": 2.0, "casing.k": 3.0})
    opened = _simulation.unseal(tmp_path / "a")
    assert opened.parameters == {"bearing.drift.k": 1.0}
    document = json.loads((tmp_path / "a").read_text())
    document["salt"] = document["salt"][::-1]
    (tmp_path / "a").write_text(json.dumps(document))
    with pytest.raises(DatasetError):
        _simulation.unseal(tmp_path / "a")
    long = bytes(range(256))
    assert _simulation._xor_with_salt(_simulation._xor_with_salt(long, "s"), "s") == long
    coded = np.frombuffer(_simulation._xor_with_salt(bytes(200), "s"), np.uint8)
    assert len(coded) == 200
    assert not (coded[:32] == coded[32:64]).all()


def test_a_diagnosis_is_kept_with_the_effects_of_the_user():
    found = chain()
    found.keep_diagnosis("f1", "found", ("own",))
    found.keep_diagnosis("f2", "other")
    assert found.ledger.kept == [("f1", "found", ("own",)), ("f2", "other", ())]


@pytest.mark.parametrize(("starts", "stored"), [((), 0.0), ((0.001, 0.003, 0.002), 0.003)])
def test_a_simulated_case_has_the_largest_uncertainty_of_its_starts(monkeypatch, starts, stored):
    written = []
    monkeypatch.setattr(
        _simulation, "write_case", lambda path, case, **more: written.append((path, case, more)) or path
    )
    monkeypatch.setattr(
        _simulation, "_series", lambda runs: Series(*[np.arange(3.0)] * 6, window=np.zeros(3))
    )
    monkeypatch.setattr(_simulation, "Case", SimpleNamespace)
    record = SimpleNamespace(
        I_rotor=1.0, I_casing=2.0, I_rotor_u=0.1, I_casing_u=0.2, label="x", casing="c", rotor="r", quantity="angle",
        start_sigma=starts,
    )  # fmt: skip
    _simulation.write_record("a.h5", record, surface="PVC", command="c", settings={"a": 1}, force=True)
    ((path, case, more),) = written
    assert (path, more) == ("a.h5", {"command": "c", "settings": {"a": 1}, "force": True})
    assert (case.start_u, case.I_rotor, case.I_casing, case.I_rotor_u, case.I_casing_u) == (
        stored,
        1.0,
        2.0,
        0.1,
        0.2,
    )
    assert (case.casing.window, case.rotor.window is None, case.surface) == (None, False, "PVC")
