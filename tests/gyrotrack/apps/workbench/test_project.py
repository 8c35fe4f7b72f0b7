"""The work folder of the start page: what is accepted, what is run, what is kept."""

import asyncio
import hashlib
import json
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from gyrotrack import ConfigurationError, GyrotrackError, UsageError
from gyrotrack.apps.workbench._processes import Jobs
from gyrotrack.apps.workbench._project import STATE_FILE, Project, State
from gyrotrack.apps.workbench._uploads import Sent

CLIPS = Path(__file__).parents[4] / "sample_clips"
_ELSEWHERE = ThreadPoolExecutor(max_workers=1)


@pytest.fixture
def project(tmp_path):
    found = Project(tmp_path)
    yield found
    found.close()


def _send(project, name, content, declared=None, offset=0):
    async def pieces():
        for k in range(0, len(content), 1000):
            yield content[k : k + 1000]

    size = len(content) if declared is None else declared
    # the driver of the browser tests may keep a loop running in this thread
    sent = Sent(name, size, 0)
    return _ELSEWHERE.submit(lambda: asyncio.run(project.receive(sent, offset, pieces()))).result()


TABLE = b"t,angle\n" + b"".join(b"%g,%g\n" % (k, k) for k in range(20))


def test_what_is_sent_stays_in_the_work_folder(project, tmp_path):
    for name in ("../../evil.csv", "/etc/evil.csv", "..\\evil.csv", "evil.csv"):
        _send(project, name, TABLE)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        ".workbench.lock",
        "evil.csv",
        "evil_2.csv",
        "evil_3.csv",
        "evil_4.csv",
        STATE_FILE,
    ]
    assert {x.file for x in project.state.sources} <= {p.name for p in tmp_path.iterdir()}


def test_an_interrupted_upload_continues_where_it_stopped_also_after_a_restart(project, tmp_path):
    file = Sent("big.csv", len(TABLE), 0)
    assert project.upload_state(file)["received"] == 0
    assert not _send(project, "big.csv", TABLE[:50], declared=len(TABLE))
    (listed,) = project.document()["uploads"]
    assert listed["name"] == "big.csv"
    assert listed["share"] == pytest.approx(50 / len(TABLE))
    assert not (tmp_path / "big.csv").exists()
    project.close()
    again = Project(tmp_path)
    try:
        known = again.upload_state(file)
        assert known["received"] == 50
        assert known["sha256"] == hashlib.sha256(TABLE[:50][-known["tail"] :]).hexdigest()
        assert again.upload_state(Sent("big.csv", len(TABLE), 1))["received"] == 0  # another file
        with pytest.raises(UsageError, match="fewer bytes have arrived"):
            _send(again, "big.csv", TABLE[60:], declared=len(TABLE), offset=60)
        # from an earlier byte, if the last ones differ
        assert _send(again, "big.csv", TABLE[40:], declared=len(TABLE), offset=40)
        assert (tmp_path / "big.csv").read_bytes() == TABLE
        assert [x.file for x in again.state.sources] == ["big.csv"]
        assert again.document()["uploads"] == []
        assert not list(tmp_path.glob(".upload-*"))
    finally:
        again.close()


def test_an_unfinished_upload_is_discarded_and_one_that_is_too_long_refused(project, tmp_path):
    _send(project, "a.csv", TABLE[:50], declared=len(TABLE))
    ((key,),) = ([u["key"] for u in project.document()["uploads"]],)
    with pytest.raises(UsageError, match="no such upload"):
        project.discard_upload("../x")
    project.discard_upload(key)
    assert not list(tmp_path.glob(".upload-*"))
    with pytest.raises(UsageError, match="not as declared"):
        _send(project, "a.csv", TABLE, declared=len(TABLE) - 1)
    assert not list(tmp_path.glob(".upload-*"))
    assert project.document()["uploads"] == []


@pytest.mark.parametrize(
    ("name", "declared"),
    [
        ("a.sh", None),
        ("", None),
        ("-o.csv", None),
        (".csv", None),
        ("a.toml", None),
        ("a.csv", 10),
        ("a.csv", 0),
        ("a.csv", 10**15),
        ("a.csv", -1),
    ],
)
def test_what_is_not_accepted_leaves_nothing(project, tmp_path, name, declared):
    with pytest.raises(GyrotrackError):
        _send(project, name, TABLE, declared)
    assert [p.name for p in tmp_path.iterdir()] == [".workbench.lock"]


def test_notes_that_are_sent_cannot_name_films_elsewhere(project, tmp_path):
    text = (CLIPS / "study.toml").read_text().replace('"casing.mp4"', json.dumps(str(CLIPS / "casing.mp4")))
    with pytest.raises(GyrotrackError, match="not in the work folder"):
        _send(project, "study.toml", text.encode())
    assert project.state.sources == []
    assert [p.name for p in tmp_path.iterdir()] == [".workbench.lock"]


@pytest.mark.parametrize("output", ["../x.h5", "/absolute/x.h5", "-x.h5", "x.txt", ".h5"])
def test_a_state_that_writes_elsewhere_is_set_aside(tmp_path, output):
    source = {"key": "1", "file": "a.mp4", "kind": "film", "output": output}
    _set_aside(tmp_path, json.dumps({"sources": [source]}))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[",
        "[" * 100_000,
        '{"version": 2}',
        '{"label": "\\ud800"}',
        '{"label": "a\\nb"}',
        '{"label": "' + 121 * "x" + '"}',
        '{"sources": [{"key": "abc", "file": "a.mp4", "kind": "film"}]}',
        '{"sources": [{"key": "' + 5000 * "1" + '", "file": "a.mp4", "kind": "film"}]}',
        '{"sources": [{"key": "1", "file": "a.mp4", "kind": "film", "capture_fps": 1e400}]}',
        '{"sources": [{"key": "1", "file": "a.mp4", "kind": "film", "capture_fps": 1' + 400 * "0" + "}]}",
    ],
)
def test_a_state_that_cannot_be_read_is_set_aside(tmp_path, text):
    _set_aside(tmp_path, text)


def _set_aside(folder, text):
    for number in (1, 2):  # none that was set aside is replaced
        (folder / STATE_FILE).write_text(f"{text}{' ' * number}")
        project = Project(folder)
        assert project.state == State()
        assert f"workbench.unreadable-{number}.json" in project.notes[0]
        project.set("", "label", "new")
        project.close()
    kept = [(folder / f"workbench.unreadable-{number}.json").read_text() for number in (1, 2)]
    assert kept == [f"{text} ", f"{text}  "]


ENTRIES = {
    "surrogate": "\udce9",
    "long": "x" * 121,
    "line feed": "a\nb",
    "null": "a\0b",
}


@pytest.mark.parametrize("field", ["label", "surface", "inertia_rotor", "inertia_casing", "inertia"])
def test_what_could_not_be_read_again_is_not_stored(project, tmp_path, field):
    project.set("", field, "x" * 120)
    before = (tmp_path / STATE_FILE).read_bytes()
    for entry in ENTRIES.values():
        with pytest.raises(UsageError, match="too long, or has characters"):
            project.set("", field, entry)
        assert getattr(project.state, field) == "x" * 120
        assert (tmp_path / STATE_FILE).read_bytes() == before


@pytest.mark.parametrize("hub", [[10**400, 1], [1e999, 1], [float("nan"), 1], ["a", 1], {}, [1], 5])
def test_positions_that_are_not_numbers_are_refused(project, hub):
    project.add(CLIPS / "rotor_1.mp4")
    before = project.state.model_copy(deep=True)
    with pytest.raises(UsageError):
        project.mark("1", hub, [], "")
    assert project.state.sources[0].hub is None
    assert project.state == before


def test_names_that_are_not_text_are_not_listed(project, tmp_path):
    for name in (b"caf\xe9.mp4", b"a\nb.mp4", b"good.mp4"):
        (tmp_path / os.fsdecode(name)).write_bytes(b"")
    assert project.document()["available"] == ["good.mp4"]


def test_a_second_workbench_on_one_folder_is_refused(project, tmp_path):
    with pytest.raises(ConfigurationError, match="Another workbench is open in"):
        Project(tmp_path)
    project.close()
    Project(tmp_path).close()


def test_rates_are_stated_never_taken_from_the_container(project, tmp_path):
    for name in ("casing.mp4", "rotor_1000fps.mp4"):
        shutil.copy(CLIPS / "rotor_1.mp4", tmp_path / name)
        project.add_named(name)
    casing, rotor = project.state.sources
    assert (casing.body, casing.capture_fps) == ("casing", None)
    assert (rotor.body, rotor.capture_fps, rotor.rate_from) == ("rotor", 1000.0, "name of the file")
    missing = project.document()["missing"]["track"]
    assert missing == ["Enter the capture rate of casing.mp4."]
    with pytest.raises(GyrotrackError, match=r"capture rate of casing\.mp4"):
        project.track()
    for wrong in ("fast", "-1", "0", "nan"):
        with pytest.raises(GyrotrackError, match="not a positive number"):
            project.set(casing.key, "capture_fps", wrong)
    project.set(casing.key, "capture_fps", "259,5")
    assert project.document()["missing"]["track"] == []
    assert State.model_validate_json((tmp_path / STATE_FILE).read_bytes()) == project.state


def test_commands_are_those_of_the_command_line(project):
    project.add_samples()
    document = project.document()
    assert document["commands"]["track"][0].endswith("casing.mp4 --capture-fps 260 -o casing.h5")
    assert [x["body"] for x in document["sources"]] == ["casing", "rotor", "rotor", "rotor"]
    assert document["missing"]["match"] == [
        "Not tracked yet: casing.mp4, rotor_1.mp4, rotor_2.mp4, rotor_3.mp4."
    ]
    assert document["fields"]["surface"] == "grey cardstock"
    assert document["inertias"]["inertia_rotor"]["value"] == "4.200 × 10⁻⁶ kg m², no uncertainty given"
    project.set("", "inertia_rotor", "5.54e-5 +- 0.06e-5")
    assert project.document()["inertias"]["inertia_rotor"]["value"] == "(5.54 ± 0.06) × 10⁻⁵ kg m²"
    project.set("", "inertia_rotor", "5 ells")
    assert "not a moment of inertia" in project.document()["inertias"]["inertia_rotor"]["error"]


@pytest.mark.slow
def test_tables_become_a_case_in_a_separate_process(project, tmp_path):
    for name, speed in (("casing.csv", 5.0), ("rotor.csv", 50.0)):
        rows = "".join(f"{0.01 * k},{speed * (0.01 * k - 0.01 * (0.01 * k) ** 2)}\n" for k in range(300))
        (tmp_path / name).write_text("t,angle\n" + rows)
        project.add_named(name)
    project.set("", "inertia_rotor", "4.2e-6")
    project.set("", "inertia_casing", "(1.6 +- 0.1) g cm2")
    project.set("", "label", "--force")
    assert project.document()["commands"]["match"] == (
        "gyrotrack import --casing casing.csv --rotor rotor.csv -o case.h5 --inertia-rotor=4.2e-6 "
        "'--inertia-casing=(1.6 +- 0.1) g cm2' --label=--force"
    )
    project.match()
    _wait(project, "match")
    assert project.document()["is_matched"], project.jobs.get("match")
    assert (tmp_path / "case.h5").exists()
    project.set("", "inertia_rotor", "4.3e-6")
    assert not project.document()["is_matched"]


@pytest.mark.slow
def test_a_table_is_read_for_the_page_before_it_becomes_a_case(project, tmp_path):
    rows = "".join(f"{0.01 * k},{5 * (0.01 * k - 0.01 * (0.01 * k) ** 2)},7\n" for k in range(300))
    (tmp_path / "wheel.csv").write_text("t [s],angle [rad],note\n" + rows)
    (tmp_path / "other.csv").write_text("a,b\n" + rows.replace(",7\n", "\n"))
    before = set(tmp_path.iterdir())
    for name in ("wheel.csv", "other.csv"):
        project.add_named(name)
    good, bad = (x.key for x in project.state.sources)
    assert project.document()["sources"][0]["reading"] == {}
    for key in (good, bad):
        project.read(key)
        _wait(project, f"read:{key}")
    wheel, other = project.document()["sources"]
    (reading,) = wheel["reading"]["reading"]
    assert [c["quantity"] for c in reading["columns"]] == ["time", "angle"]
    assert reading["left_out"] == ["'note'"]
    (plot,) = wheel["reading"]["plot"]
    assert 100 <= len(plot["time"]) == len(plot["omega"]) <= 400
    assert other["jobs"]["read"]["state"] == "failed"
    assert "there is no column for the time" in other["jobs"]["read"]["message"]
    assert set(tmp_path.iterdir()) - before == {tmp_path / STATE_FILE}
    with pytest.raises(UsageError, match="no such film or table"):
        project.read("99")


def test_every_format_that_import_reads_can_be_added(project, tmp_path):
    from gyrotrack.io.readers._format_names import ALL, SUFFIXES

    assert set(SUFFIXES) == set(ALL)
    for suffix in (".trz", ".wav", ".parquet", ".mat", ".xls"):
        (tmp_path / f"a{suffix}").write_bytes(b"x")
        project.add_named(f"a{suffix}")
    assert {x.kind for x in project.state.sources} == {"table"}


def _wait(project, key):
    for thread in list(project.jobs._threads):
        thread.join(60)
    assert not project.jobs.get(key).is_active


@pytest.mark.slow
def test_jobs_wait_for_a_slot_are_cancelled_and_report_their_error(tmp_path):
    jobs, ended = Jobs(tmp_path, 1), []
    first = jobs.start("a", ["extract", "absent.mp4"], ended.append)
    second = jobs.start("b", ["extract", "absent.mp4"], ended.append)
    jobs.cancel("b")
    with pytest.raises(GyrotrackError, match="already running"):
        jobs.start("a", ["extract", "absent.mp4"], ended.append)
    for thread in list(jobs._threads):
        thread.join(60)
    assert first.state == "failed"
    assert "absent.mp4" in first.summary()["message"]
    assert second.state == "cancelled"
    jobs.close()
    assert {id(j) for j in ended} == {id(first), id(second)}
