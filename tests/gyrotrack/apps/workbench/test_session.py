"""The tree of fits: show, compare, annotate, delete, undo."""

from types import SimpleNamespace

import pytest

from gyrotrack._errors import GyrotrackError
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


def test_predecessors_and_kept_fits_are_not_deleted(session):
    with pytest.raises(GyrotrackError, match="has successors"):
        session.delete(1)
    with pytest.raises(GyrotrackError, match="kept in the ledger"):
        session.delete(0)
    session.steps[2].fit_id = "f2"
    with pytest.raises(GyrotrackError, match="kept in the ledger"):
        session.delete(2)
    with pytest.raises(GyrotrackError, match="no such fit"):
        session.delete(-1)


def test_a_note_is_short_and_undone(session):
    session.annotate(1, "  x" * 1000)
    assert 0 < len(session.steps[1].note) <= 500
    session.undo()
    assert session.steps[1].note == ""
