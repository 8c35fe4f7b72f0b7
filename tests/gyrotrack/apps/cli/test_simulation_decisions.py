"""The demo from films to the final fit, and answers to a sealed challenge."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from gyrotrack import DatasetError, UsageError
from gyrotrack.apps.cli import _simulation as module


def printing():
    """Return an output that stores texts and documents."""
    shown, documents = [], []
    return SimpleNamespace(
        shown=shown,
        documents=documents,
        show=lambda *lines: shown.extend(lines),
        result=documents.append,
        progress=lambda what: nullcontext(lambda *_: None),
    )


def step(name):
    return SimpleNamespace(fit=f"fit of {name}", name=name)


def test_the_demo_states_the_last_fit_and_every_step(monkeypatch):
    kept = SimpleNamespace(
        entries=[SimpleNamespace(document={"rung": f"step {n}"}, fit_id=f"f{n}") for n in range(1, 4)]
    )
    study = SimpleNamespace(
        data=[SimpleNamespace(record="the record")],
        ledger=SimpleNamespace(add=lambda base, added: SimpleNamespace(fit_id=f"{added} {base}")),
        recorder=lambda fit_id, base: kept,
    )
    asked = {}
    steps = [step("first"), step("second"), step("third")]

    def improved(base, first, keep):
        asked.update(base=base, first=first, keep=keep)
        return steps

    monkeypatch.setattr(module, "open_study", lambda cases, ledger: study)
    monkeypatch.setattr("fitting.inference._fit.fit", lambda model, data: f"{len(model.names)} laws")
    diagnosis = SimpleNamespace(candidates=("a candidate",))
    monkeypatch.setattr("fitting.discovery._verdict.diagnose", lambda base: diagnosis)
    monkeypatch.setattr("fitting.discovery._select.improve", improved)
    for name in ("fit_document", "diagnosis_document"):
        monkeypatch.setattr(f"fitting.study._serialisation.{name}", lambda found, fit_id: (found, fit_id))
    monkeypatch.setattr("fitting.study._serialisation.history_verdict", lambda found: found[-1].name)
    monkeypatch.setattr(module, "fit_tables", lambda base, fit_id: [f"table of {base}"])
    monkeypatch.setattr(module, "diagnosis_tables", lambda found, fit_id: ["table of effects"])
    monkeypatch.setattr(module, "ladder_tables", lambda found, record: [f"{len(found)} steps of {record}"])
    out = printing()
    found, same, document = module._fit_and_diagnose(out, Path("case.h5"))
    assert (found, same) == (steps, diagnosis)
    assert document == {
        "diagnosis": (diagnosis, "reduced 5 laws"),
        "ladder": ["step 1", "step 2", "step 3"],
        "final": ("fit of third", "f3"),
        "verdict": "third",
    }
    assert asked == {"base": "5 laws", "first": ("a candidate",), "keep": kept}
    assert "table of 5 laws" in out.shown
    assert "3 steps of the record" in out.shown


@pytest.mark.parametrize("force", [False, True])
def test_the_demo_tracks_and_joins_the_clips_of_its_study(monkeypatch, tmp_path, force):
    jobs = []
    monkeypatch.setattr(
        module, "_run", lambda out, lines, targets, *rest, force: jobs.append((lines, targets, force))
    )
    monkeypatch.setattr(module, "_study", lambda out, case, film, *, force: {"case": case, "film": film})
    clips = [
        {"file": "top.mp4", "body": "rotor", "capture_fps": 960},
        {"file": "side.mp4", "body": "casing", "capture_fps": 240},
    ]
    study = {
        "clip": clips, "inertia_rotor": "1e-4", "inertia_casing": "2e-4", "label": "run", "surface": "PVC",
    }  # fmt: skip
    recordings, case = [tmp_path / "top.h5", tmp_path / "side.h5"], tmp_path / "case.h5"
    found = module._analyse(printing(), Path("clips"), study, recordings, case, force=force)
    assert found == {"case": case, "film": Path("clips/side.mp4")}
    (tracked, targets, forced), (joined, made, also) = jobs
    assert (targets, made, forced, also) == (recordings, [case], force, force)
    assert tracked == [
        ["extract", Path("clips/top.mp4"), "--capture-fps", "960", "-o", recordings[0]],
        ["extract", Path("clips/side.mp4"), "--capture-fps", "240", "-o", recordings[1]],
    ]
    # the recording of the casing is the first one
    assert joined == [
        ["sync", recordings[1], recordings[0], "-o", case, "--inertia-rotor", "1e-4", "--inertia-casing", "2e-4",
         "--label", "run", "--surface", "PVC"]
    ]  # fmt: skip


def test_steps_of_the_demo_are_summarised():
    tracked = {
        "frames": 1200,
        "fps": 239.7,
        "body": {"casing": {"samples": 1150, "median_sigma": 4.2e-4}},
    }
    assert module._step_summary("extract", tracked) == (
        "  1200 frames at 240/s: casing 1150 angles +- 0.42 mrad"
    )
    clips = [
        {"source": "a/top.h5", "offset_s": 3.5, "offset_sigma_s": 1e-3, "ambiguous": False},
        {"source": "a/late.h5", "offset_s": 70.25, "offset_sigma_s": 2e-3, "ambiguous": True},
    ]
    assert module._step_summary("sync", {"clips": clips}).split("\n") == [
        "  top.h5 starts at 3.5000 +- 0.0010 s",
        "  late.h5 starts at 70.2500 +- 0.0020 s (ambiguous)",
    ]
    assert module._step_summary("sync", {}) == ""


def test_clips_are_those_of_the_folder_given_or_installed(monkeypatch, tmp_path):
    given, installed = tmp_path / "given", tmp_path / "installed"
    for folder in (given, installed):
        folder.mkdir()
    (installed / "study.toml").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gyrotrack.apps._sample.sample_folder", lambda: installed)
    assert module._find(None) == installed
    with pytest.raises(DatasetError, match=r"no sample clips in .*given"):
        module._find(given)
    (given / "study.toml").touch()
    assert module._find(given) == given
    monkeypatch.setattr("gyrotrack.apps._sample.sample_folder", lambda: None)
    with pytest.raises(DatasetError, match="no sample clips in sample_clips"):
        module._find(None)


@pytest.mark.parametrize(
    ("answer", "named"),
    [
        ("none", []),
        (" none ", []),
        ("", []),
        ("a, b", ["a", "b"]),
        ("casing.air.quadratic", ["casing.air.quadratic"]),
    ],
)
def test_answers_to_a_challenge_are_separated_by_commas(answer, named):
    assert module._stated(answer) == (named, {})


@pytest.mark.parametrize(
    ("case", "answer", "valid"),
    [(True, None, True), (False, "a", True), (True, "a", False), (False, None, False)],
)
def test_a_challenge_has_exactly_one_answer(monkeypatch, tmp_path, case, answer, valid):
    truth = SimpleNamespace(effect="a", parameters={"a.k": 2e-6}, commitment="0123")
    graded = []

    def grade(found, named, values):
        graded.append((named, values))
        return SimpleNamespace(grade="correct", pulls={"a.k": -1.25}, sentence="Found.")

    monkeypatch.setattr("gyrotrack.apps._simulation.unseal", lambda seal: truth)
    monkeypatch.setattr("gyrotrack.apps._simulation.grade", grade)
    monkeypatch.setattr(module, "_fitted", lambda path, ledger: (["of the fit"], {"a.k": (1.0, 0.1)}))
    out = printing()
    given = {"case": tmp_path / "case.h5" if case else None, "answer": answer, "out": out}
    if not valid:
        with pytest.raises(UsageError, match="exactly one answer"):
            module.reveal_command(tmp_path / "case.seal.json", **given)
        return
    module.reveal_command(tmp_path / "case.seal.json", **given)
    named = ["of the fit"] if case else ["a"]
    assert graded == [(named, {"a.k": (1.0, 0.1)} if case else {})]
    assert out.documents == [
        {"effect": "a", "parameters": {"a.k": 2e-6}, "answer": named, "grade": "correct", "pulls": {"a.k": -1.25},
         "commitment": "0123"}
    ]  # fmt: skip
    assert out.shown == ["Found.\n  a.k = 2e-06\n  a.k: -1.2 standard errors from the true value"]
