"""The tree of fits: show, compare, annotate, delete, undo."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Ledger
from gyrotrack import GyrotrackError, open_study
from gyrotrack.apps.cli._app import run
from gyrotrack.apps.workbench._session import Session, Step


@pytest.fixture
def session(monkeypatch):
    """A base with two successors, the second of which has one of its own."""

    def state(self, **_options):
        places = [i for i, s in self._tree() if not s.is_deleted]
        return {
            "current": self.current,
            "places": places,
            "compared": self._compared(self.steps[self.current]),
        }

    monkeypatch.setattr(Session, "state", state)
    found = Session(None, SimpleNamespace(), "f1", None)
    found.steps += [Step("+a", 0, SimpleNamespace()), Step("+b", 0, SimpleNamespace())]
    found.steps += [Step("+c", 1, SimpleNamespace())]
    return found


def test_steps_follow_their_predecessors(session):
    assert session.go(3) == {"current": 3, "places": [0, 1, 3, 2], "compared": 1}


def test_another_fit_is_compared_until_another_is_shown(session):
    session.go(3)
    assert session.compare(2)["compared"] == 2
    assert session.compare(-1)["compared"] == 1
    session.compare(2)
    assert session.go(2)["compared"] == 0


def test_what_is_deleted_comes_back_with_undo(session):
    session.go(3)
    assert session.delete(3) == {"current": 1, "places": [0, 1, 2], "compared": 0}
    with pytest.raises(GyrotrackError, match="no such fit"):
        session.go(3)
    assert session.undo() == {"current": 3, "places": [0, 1, 3, 2], "compared": 1}
    assert session.undo()["current"] == 0
    with pytest.raises(GyrotrackError, match="nothing to undo"):
        session.undo()


def test_predecessors_and_the_only_fit_are_not_deleted(session):
    with pytest.raises(GyrotrackError, match="has successors"):
        session.delete(1)
    with pytest.raises(GyrotrackError, match="no such fit"):
        session.delete(-1)
    for place in (3, 2, 1):
        session.delete(place)
    with pytest.raises(GyrotrackError, match="only fit"):
        session.delete(0)


def test_a_note_is_short_and_undone(session):
    session.annotate(1, name="n" * 100, note="  x" * 1000)
    assert 0 < len(session.steps[1].note) <= 500
    assert len(session.steps[1].name) == 60
    session.undo()
    assert (session.steps[1].name, session.steps[1].note) == ("", "")
    session.redo()
    assert len(session.steps[1].name) == 60


def test_every_change_of_the_tree_is_undone_and_redone(session):
    session.go(3)
    session.delete(3)
    session.go(2)
    for expected in (1, 3, 0):
        assert session.undo()["current"] == expected
    for expected in (3, 1, 2):
        assert session.redo()["current"] == expected
    assert session.steps[3].is_deleted
    with pytest.raises(GyrotrackError, match="nothing to redo"):
        session.redo()
    session.undo()
    session.go(0)  # a new change ends the redo
    with pytest.raises(GyrotrackError, match="nothing to redo"):
        session.redo()


def test_a_fit_that_is_undone_leaves_the_tree_and_comes_back(session):
    revision = session.revision
    session.steps.append(Step("+d", 2, SimpleNamespace()))
    session._added(4)
    assert session.undo()["places"] == [0, 1, 3, 2]
    assert session.current == 0
    assert session.redo()["places"] == [0, 1, 3, 2, 4]
    assert session.current == 4
    assert session.revision == revision + 3  # all pages are told


def test_a_cancelled_fit_changes_nothing_and_blocks_nothing(session, monkeypatch):
    from threading import Event, Thread

    begun, go, errors = Event(), Event(), []
    effect = SimpleNamespace(name="d")
    session.steps[0].found = SimpleNamespace(
        model=SimpleNamespace(names=("a",), without=lambda n: "less"), estimates={}
    )

    def slow(self, model, start, old):
        begun.set()
        go.wait(10)
        return effect

    monkeypatch.setattr(Session, "_fitted", slow)

    def change():
        try:
            session.change(drop="a")
        except GyrotrackError as error:
            errors.append(error.message)

    thread = Thread(target=change)
    thread.start()
    assert begun.wait(10)
    assert session.progress()["label"] == "-a"
    assert session.go(2)["current"] == 2  # other requests are answered meanwhile
    with pytest.raises(GyrotrackError, match="A fit is running"):
        session.change(drop="a")
    assert session.cancel() == {}
    go.set()
    thread.join(10)
    assert errors == ["The fit was cancelled."]
    assert len(session.steps) == 4


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A case whose ledger has a fit and two that were made from it."""
    folder = tmp_path_factory.mktemp("kept")
    case = folder / "case.h5"
    words = "--duration 12 --casing-fps 30 --rotor-fps 200 --window 2 --window-length 1 --seed 1 --json -q"
    assert run(["simulate", "-o", str(case), *words.split()]) == 0
    assert run(["fit", str(case), "-q"]) == 0
    for effect in ("casing.air.quadratic", "casing.air.laminar"):
        run(["fit", str(case), "--from", "f1", "--add", effect, "-q"])
    return case


@pytest.mark.slow
def test_the_ledger_is_the_tree_and_keeps_names_notes_and_deletions(kept):
    study = open_study([kept], None)
    base, fit_id = study.base("f1")
    session = Session(study.data[0], base, fit_id, study.ledger)
    assert [(s.fit_id, s.parent) for s in session.steps] == [("f1", -1), ("f2", 0), ("f3", 0)]
    assert [r["place"] for r in session.state()["ladder"]] == [0, 1, 2]
    assert session.steps[2].found is None  # restored only when it is shown
    session.annotate(1, name="drag", note="by hand")
    session.delete(2)
    stored = {e.fit_id: e.stored for e in Ledger.default_for(kept).entries}
    assert set(stored) == {"f1", "f2"}
    assert (stored["f2"].name, stored["f2"].note) == ("drag", "by hand")
    session.undo()
    assert [e.fit_id for e in Ledger.default_for(kept).entries] == ["f1", "f2", "f3"]
    assert session.go(2)["effects"][-1]["name"] == "casing.air.laminar"


def test_the_command_names_annotates_and_deletes(kept, capsys):
    assert run(["ladder", str(kept), "--name", "f3=laminar", "--note", "f3=a = b", "-q"]) == 0
    assert "laminar: a = b" in capsys.readouterr().out
    for words in (["--delete", "f1"], ["--delete", "f9"], ["--note", "f9=x"], ["--name", "f3"]):
        before = kept.with_suffix(".fits.json").read_text()
        assert run(["ladder", str(kept), *words]) in (1, 2)
        assert kept.with_suffix(".fits.json").read_text() == before
    assert run(["ladder", str(kept), "--delete", "f3"]) == 0
    assert [e.fit_id for e in Ledger.default_for(kept).entries] == ["f1", "f2"]


def test_two_fits_are_compared_by_their_parameters_and_their_difference(kept):
    study = open_study([kept], None)
    base, fit_id = study.base("f1")
    session = Session(study.data[0], base, fit_id, study.ledger)
    assert "other" not in session.state()["parameters"][0]
    found = session.go(1)
    later = session.fit.estimates
    for row in found["parameters"]:
        if row["name"] in base.estimates:
            shift = later[row["name"]].value - base.estimates[row["name"]].value
            u = np.hypot(*(np.nan_to_num(e[row["name"]].stderr) for e in (later, base.estimates)))
            if u > 0:
                assert row["difference_u"] == pytest.approx(shift / u)
        else:
            assert row["name"].startswith("casing.air.quadratic")
            assert "other" not in row
    (chart,) = (c for c in found["board"]["charts"] if c["name"] == "difference")
    assert "fit 2 minus fit 1" in chart["title"]
