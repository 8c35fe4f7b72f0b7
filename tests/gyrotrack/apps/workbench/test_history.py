"""Undo and redo of the start page, removed films, and what runs by itself."""

import json
import shutil

import pytest

from gyrotrack import UsageError
from gyrotrack.apps.workbench._history import History, apply, difference
from gyrotrack.apps.workbench._project import STATE_FILE, Project, State

from .test_project import CLIPS


@pytest.fixture
def project(tmp_path):
    shutil.copy(CLIPS / "rotor_1.mp4", tmp_path / "rotor_1000fps.mp4")
    found = Project(tmp_path)
    found.add_named("rotor_1000fps.mp4")
    yield found
    found.close()


def test_a_removed_film_keeps_its_entries_also_when_the_folder_is_opened_again(project, tmp_path):
    project.set("1", "capture_fps", "999")
    project.remove("1")
    assert project.state.sources == []
    assert project.document()["removed"] == [{"key": "1", "name": "rotor_1000fps.mp4"}]
    assert (tmp_path / "rotor_1000fps.mp4").exists()
    project.close()
    again = Project(tmp_path)
    again.restore("1")
    assert again.source("1").capture_fps == 999
    with pytest.raises(UsageError, match="no such removed film"):
        again.restore("1")
    again.remove("1")
    again.add(tmp_path / "rotor_1000fps.mp4")  # the same film, added again, is the one that was removed
    assert [x.key for x in again.state.sources] == ["1"]
    assert again.source("1").capture_fps == 999
    again.close()


def test_entries_markers_and_removals_are_undone_and_redone(project, tmp_path):
    pick = {"x": 1.0, "y": 2.0, "name": "red", "colour": "red", "body": "rotor"}
    project.set("1", "body", "casing")
    project.mark("1", [5, 5], [pick], "red")
    project.mark("1", [5, 5], [pick, pick | {"name": "blue", "colour": "blue"}], "red")
    project.jobs.cancel("preview:1")
    project.remove("1")
    profile = tmp_path / project.state.removed[0].profile
    project.undo()
    assert len(project.source("1").picks) == 2
    project.undo()
    assert [p.name for p in project.source("1").picks] == ["red"]
    assert profile.read_text().count("[[marker]]") == 1  # the file is that of the entries
    project.undo()
    assert (project.source("1").picks, project.source("1").hub, project.source("1").disc) == ([], None, "")
    project.undo()
    assert project.source("1").body == "rotor"
    project.redo()
    assert project.source("1").body == "casing"
    for _ in range(3):
        project.redo()
    assert project.state.sources == []
    with pytest.raises(UsageError, match="nothing to redo"):
        project.redo()
    stored = State.model_validate_json((tmp_path / STATE_FILE).read_bytes())
    assert stored == project.state


def test_undoing_an_entry_keeps_what_a_step_has_found_since():
    before = {"label": "", "case": "", "sources": [{"key": "1", "body": "", "result": {}}], "removed": []}
    after = json.loads(json.dumps(before)) | {"label": "x"}
    after["sources"][0]["body"] = "rotor"
    changes = difference(before, after)
    now = json.loads(json.dumps(after)) | {"case": "case.h5"}
    now["sources"][0]["result"] = {"frames": 3}
    apply(now, changes, 0)
    assert now["label"] == ""
    assert now["case"] == "case.h5"
    assert now["sources"] == [{"key": "1", "body": "", "result": {"frames": 3}}]
    apply(now, changes, 1)
    assert (now["label"], now["sources"][0]["body"]) == ("x", "rotor")


def test_a_new_change_ends_the_redo_and_a_failed_undo_keeps_the_change():
    from threading import RLock

    history, lock, done = History(), RLock(), []

    def fail():
        raise UsageError("no", "no")

    history.add("a", lambda: done.append("undo a"), lambda: done.append("redo a"))
    history.undo(lock)
    assert (history.undo_label, history.redo_label) == ("", "a")
    history.redo(lock)
    history.add("b", fail, fail)
    assert (history.undo_label, history.redo_label) == ("b", "")
    with pytest.raises(UsageError):
        history.undo(lock)
    assert history.undo_label == "b"
    assert done == ["undo a", "redo a"]


def test_all_steps_follow_each_other_and_stop_where_an_entry_is_missing(project, monkeypatch):
    started = []
    monkeypatch.setattr(project.jobs, "start", lambda key, words, done, **_: started.append((key, done)))
    project.analyse()
    assert [k for k, _ in started] == ["track:1"]
    assert project.document()["analysing"]

    class Job:
        state, document, began = "done", {"frames": 3, "body": {}}, 0.0

    started[0][1](Job)  # there is no film of the casing: nothing can be synchronised
    assert [k for k, _ in started] == ["track:1"]
    assert not project.document()["analysing"]
    project.analyse()
    assert len(started) == 1
    Job.state = "cancelled"
    project.state.sources[0].words = []
    project.analyse()
    started[1][1](Job)
    assert not project.document()["analysing"]
