"""Steps are done once, again when anything that they come from changes, and fail alone."""

import json
import shutil
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import pytest

from gyrotrack import OutputError
from gyrotrack.apps.batch._experiments import Clip, Experiment, with_folders
from gyrotrack.apps.batch._runner import Run, lines, summarise, write_summary
from gyrotrack.apps.batch._steps import Journal, Request, locked_folder, plan


class Pretend:
    """Writes what the commands would write, and counts; `spoil` says what goes wrong, by a word in the arguments."""

    def __init__(self, spoil=None):
        self.ran, self.spoil = [], dict(spoil or {})

    def submit(self, words, timeout):
        future = Future()
        try:
            future.set_result(self._answer(words))
        except BaseException as error:
            future.set_exception(error)
        return future

    def _answer(self, words):
        self.ran.append(" ".join([words[0], Path(words[1]).name]))
        for word, wrong in self.spoil.items():
            if any(word in w for w in words):
                if isinstance(wrong, list):
                    if wrong and wrong.pop(0):
                        return {
                            "code": 1,
                            "document": {"error": {"code": "crash", "message": "Gone.", "hint": ""}},
                        }
                elif isinstance(wrong, BaseException):
                    raise wrong
                else:
                    return wrong
        document = {"words": [Path(w).name for w in words]}
        if words[0] in {"fit", "improve"}:
            ledger = Path(next(w for w in words if w.startswith("--ledger=")).removeprefix("--ledger="))
            fits = json.loads(ledger.read_text())["fits"] if ledger.exists() else []
            fits.append({"fit_id": f"f{len(fits) + 1}", "number": len(fits)})
            ledger.write_text(json.dumps({"fits": fits}))
            document = {"fit_id": fits[-1]["fit_id"], "verdict": "adequate"}
        elif "-o" in words:
            Path(words[words.index("-o") + 1]).write_text(json.dumps([document, len(self.ran)]))
        return {"code": 0, "document": document, "version": "0.1.0", "seconds": 0.5}

    def close(self):
        pass


@pytest.fixture
def lab(tmp_path):
    """Two cases of three films and a film alone, and a function that runs them: lab() -> (states, what ran)."""
    films = tmp_path / "films"
    films.mkdir()
    made = []
    for case in ("a", "b"):
        clips = [Clip(films / f"{case}_casing.mp4", "casing")]
        clips += [Clip(films / f"{case}_r{i}.mp4", "rotor", 1000.0) for i in (1, 2)]
        made.append(Experiment(case, tuple(clips)))
    made.append(Experiment("alone", (Clip(films / "alone.mp4"),)))
    for e in made:
        for clip in e.clips:
            clip.file.write_text(f"film {clip.file.name}")
    cases = with_folders(made, tmp_path)

    def run(wishes=None, spoil=None, results=None):
        results = results or tmp_path / "results"
        steps = plan(cases, results, wishes or Request())
        workers = Pretend(spoil)
        with locked_folder(results):
            ended = Run(steps, results, Journal(results / "batch.jsonl")).work(workers)
        run.rows = summarise(cases, steps, ended)
        return {name: o.state for name, o in ended.items()}, workers.ran

    run.films, run.results, run.cases = films, tmp_path / "results", cases
    return run


def test_all_is_done_once(lab):
    states, ran = lab()
    assert set(states.values()) == {"done"}
    assert len(ran) == 2 * 7 + 1
    states, ran = lab()
    assert set(states.values()) == {"kept"}
    assert ran == []


def test_a_step_comes_after_those_it_needs(lab):
    _, ran = lab()
    for case in "ab":
        films = [ran.index(f"extract {case}_{f}.mp4") for f in ("casing", "r1", "r2")]
        assert max(films) < ran.index(f"sync {case}_casing.h5")
    assert ran.count("fit case.h5") == 2
    assert ran.index("fit case.h5") < ran.index("diagnose case.h5") < ran.index("report case.h5")


@pytest.mark.parametrize(
    ("change", "again"),
    [
        (lambda lab: (lab.films / "a_r1.mp4").write_text("b"), ["extract", "sync", "fit", "diagnose", "report"]),
        (lambda lab: (lab.results / "a" / "a_r1.h5").unlink(), ["extract", "sync", "fit", "diagnose", "report"]),
        (lambda lab: (lab.results / "a" / "case.h5").write_text("x"), ["sync", "fit", "diagnose", "report"]),
        (lambda lab: (lab.results / "a" / "diagnosis.json").write_text("{}"), ["diagnose"]),
        (lambda lab: (lab.results / "a" / "report.html").write_text("x"), ["report"]),
        (lambda lab: (lab.results / "a" / "case.fits.json").unlink(), ["fit"]),
    ],
)  # fmt: skip
def test_what_has_changed_is_done_again_and_no_more(lab, change, again):
    # what comes out as it was before changes nothing further on
    lab()
    change(lab)
    states, ran = lab()
    assert [line.split()[0] for line in ran] == again
    assert {name.split("/")[0] for name, state in states.items() if state == "done"} == {"a"}
    assert lab()[1] == []


def test_settings_are_part_of_what_was_done(lab):
    lab()
    _, ran = lab(Request(model="general"))
    assert {line.split()[0] for line in ran} == {"fit", "diagnose", "report"}
    assert len(ran) == 6


def test_a_fit_by_hand_spoils_nothing(lab):
    lab()
    ledger = lab.results / "a" / "case.fits.json"
    fits = json.loads(ledger.read_text())["fits"]
    ledger.write_text(json.dumps({"fits": [*fits, {"fit_id": "f9"}]}))
    assert lab()[1] == []


def test_another_version_does_all_again(lab, monkeypatch):
    lab()
    monkeypatch.setattr("gyrotrack.apps.batch._steps.__version__", "9.9")
    assert len(lab()[1]) == 15


def test_results_may_be_moved(lab, tmp_path):
    lab()
    lab.results.rename(tmp_path / "elsewhere")
    assert lab(results=tmp_path / "elsewhere")[1] == []


FAULT = {"code": 1, "document": {"error": {"code": "video", "message": "It is no film.", "hint": "Film."}}}


def test_a_bad_film_of_the_rotor_is_left_out(lab):
    states, ran = lab(spoil={"a_r1.mp4": FAULT})
    assert [n for n, s in states.items() if s != "done"] == ["a/extract a_r1"]
    row = lab.rows[0]
    assert (row.state, row.films, row.tracked, row.problem) == (
        "partly",
        3,
        2,
        "extract a_r1: It is no film.",
    )
    assert [r.state for r in lab.rows[1:]] == ["done", "done"]
    states, ran = lab()  # it is tried again, and the case is made anew with it
    assert [line.split()[0] for line in ran] == ["extract", "sync", "fit", "diagnose", "report"]


def test_a_bad_film_of_the_casing_stops_its_own_case_only(lab):
    states, _ = lab(spoil={"b_casing.mp4": FAULT})
    assert {n for n, s in states.items() if s == "blocked"} == {
        f"b/{v}" for v in ("sync", "fit", "diagnose", "report")
    }
    assert [r.state for r in lab.rows] == ["done", "failed", "done"]
    assert "failures:" in lines(lab.rows)
    assert max(len(line) for line in lines(lab.rows)) <= 80


def test_no_rotor_at_all(lab):
    states, _ = lab(spoil={"a_r": FAULT})
    assert states["a/sync"] == "blocked"


def test_a_worker_that_is_lost_is_tried_once_more(lab):
    states, ran = lab(spoil={"alone.mp4": [True]})
    assert set(states.values()) == {"done"}
    assert ran.count("extract alone.mp4") == 2


@pytest.mark.parametrize("wrong", [[True] * 5, RuntimeError("KilledWorker")])
def test_a_worker_that_is_lost_again_fails_alone(lab, wrong):
    states, ran = lab(spoil={"alone.mp4": wrong})
    assert [n for n, s in states.items() if s != "done"] == ["alone/extract alone"]
    assert ran.count("extract alone.mp4") == 2


@pytest.mark.parametrize(
    "wrong",
    [
        {"code": 1, "document": {}},
        {"code": 1, "document": {"error": "odd"}},
        {"code": 0, "document": {}, "version": "0.1.0"},
    ],
)
def test_an_odd_answer_is_a_failure(lab, wrong):
    states, _ = lab(spoil={"alone.mp4": wrong})
    assert states["alone/extract alone"] == "failed"
    assert lab.rows[2].problem.startswith("extract alone: ")


def test_not_to_be_trusted_is_kept_in_mind(lab):
    wrong = {"code": 3, "document": {"fit_id": "f1", "verdict": "not_converged"}, "version": "0.1.0"}
    (lab.results / "a").mkdir(parents=True)
    (lab.results / "batch.lock").touch()
    (lab.results / "a" / "case.fits.json").write_text('{"fits": [{"fit_id": "f1"}]}')
    for _ in range(2):
        lab(spoil={"results/a/case.fits.json": wrong}, wishes=Request("fit"))
        assert not lab.rows[0].trusted
        assert lab.rows[1].trusted


def test_a_journal_cut_anywhere_costs_only_what_was_cut_off(lab, tmp_path):
    lab()
    shutil.copytree(lab.results, tmp_path / "whole")
    whole = (lab.results / "batch.jsonl").read_bytes()
    ends = [i + 1 for i, byte in enumerate(whole) if byte == ord("\n")]
    for cut in sorted(
        {0, 5, ends[0] - 1, ends[0], ends[3] + 7, ends[-2] - 1, len(whole) - 1, *range(0, len(whole), 2999)}
    ):
        shutil.rmtree(lab.results)
        shutil.copytree(tmp_path / "whole", lab.results)
        (lab.results / "batch.jsonl").write_bytes(whole[:cut])
        states, ran = lab()
        assert set(states.values()) <= {"done", "kept"}
        lost = 15 - max(0, sum(e <= cut for e in ends) - 1)
        assert lost - 1 <= len(ran) <= lost  # of the last line only the line feed may be cut off
        assert lab()[1] == []


def test_what_is_not_a_journal_is_left_alone(lab):
    lab.results.mkdir()
    (lab.results / "batch.lock").touch()
    (lab.results / "batch.jsonl").write_text('{"format": "other"}\n{"a": 1}\n')
    with pytest.raises(OutputError, match="is not the journal"):
        lab()
    assert (lab.results / "batch.jsonl").read_text().startswith('{"format": "other"}')


def test_a_folder_with_other_things_is_refused(lab):
    lab.results.mkdir()
    (lab.results / "thesis.doc").write_text("mine")
    with pytest.raises(OutputError, match="do not belong to a batch"):
        lab()


def test_one_batch_at_a_time(lab, monkeypatch):
    monkeypatch.setattr("gyrotrack.io._atomic.LOCK_TIMEOUT", 0.1)
    with locked_folder(lab.results), pytest.raises(OutputError, match="another program"):
        lab()


def test_the_summary_is_safe_for_spreadsheets(lab, tmp_path):
    lab()
    rows = [replace(lab.rows[0], label="=cmd()", problem="@x")]
    table, document = write_summary(tmp_path, rows, {"command": "gyrotrack batch"})
    head, row = table.read_text().splitlines()
    assert row.startswith("'=cmd(),")
    assert head.startswith("label,folder,state,")
    assert json.loads(document.read_text())["cases"][0]["label"] == "=cmd()"
