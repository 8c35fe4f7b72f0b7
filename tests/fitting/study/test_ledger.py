"""Ledgers: entries, several processes that add fits at the same time, and stored effects that the library lacks."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Ledger, LedgerError
from fitting._schema import as_text, effects_of, locked, write_text
from fitting.study import _history
from fitting.study._history import Entry
from fitting.study._serialisation import fingerprint

ROOT = Path(__file__).parents[3]

WRITER = """
import sys
from pathlib import Path
import numpy as np
from fitting.study._history import Ledger
import fitting.study._history as module

class Found:
    covariance = np.zeros((0, 0))
    class problem:
        class data:
            class record:
                quantity, generated, digest, source = "angle", False, "0" * 64, ""
        class layout: choices, names = ((), ()), ()
    class model: effects = ()

Found.problem.data = (Found.problem.data,)
module.fit_document = lambda found, fit_id: {"fit_id": fit_id, "model": [], "parameters": {}, "verdict": "x"}
module.step_document = module.stored_fit = lambda *a: None
module.as_json = lambda document: None
ledger = Ledger(Path(sys.argv[1]))
for _ in range(15):
    ledger.add(Found(), added=sys.argv[2])
"""


@pytest.mark.slow
def test_concurrent_writers_lose_no_fit(tmp_path):
    path = tmp_path / "x.fits.json"
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITER, str(path), name], cwd=ROOT)
        for name in ("a", "b", "c")
    ]
    assert [w.wait() for w in writers] == [0, 0, 0]
    fits = json.loads(path.read_text())["fits"]
    assert [f["fit_id"] for f in fits] == [f"f{i + 1}" for i in range(45)]
    assert sorted(f["added"] for f in fits) == sorted("abc" * 15)
    assert [p.name for p in tmp_path.iterdir()] == ["x.fits.json"]


def test_a_stored_fit_with_an_unknown_effect_is_refused():
    with pytest.raises(LedgerError, match=r"'casing\.air\.septic', which is not in the library"):
        effects_of(["casing.air.linear", "casing.air.septic"], ())


def _entry(fit_id="f1", **changed):
    return {"fit_id": fit_id, "model": [], "parameters": {}, "digests": ["0" * 64], "verdict": "x"} | changed


def _written(path, *entries):
    path.write_text(json.dumps({"format": "gyrotrack ledger", "version": 1, "fits": list(entries)}))
    return path.read_bytes()


@pytest.mark.parametrize("text", ["caf\udce9", "\ud800"])
def test_a_note_that_could_not_be_read_again_is_not_written(tmp_path, text):
    path = tmp_path / "x.fits.json"
    before = _written(path, _entry(), _entry("f2"))
    ledger = Ledger(path)
    for change in ({"note": text}, {"name": text}, {"name": "good", "note": text}):
        with pytest.raises(LedgerError, match=r"would make .* unreadable"):
            ledger.annotate("f2", **change)
        assert path.read_bytes() == before
        assert [e.document for e in ledger.entries] == [e.document for e in Ledger(path).entries]
    ledger.annotate("f2", note="caf\u00e9 \U0001f600 a\nb")
    assert Ledger(path).find("f2").stored.note == "caf\u00e9 \U0001f600 a\nb"


@pytest.mark.parametrize(
    "fit_id", ["", "f", "fabc", "f0", "f01", "f-1", "1", "f" + 5000 * "1", "f\u0661", "f1\n"]
)
def test_a_fit_without_a_proper_name_is_damage(tmp_path, fit_id):
    path = tmp_path / "x.fits.json"
    before = _written(path, _entry(fit_id))
    with pytest.raises(LedgerError, match="is not a name of a fit"):
        Ledger(path)
    assert path.read_bytes() == before
    _written(path, _entry("f123456789"))
    assert Ledger(path).find("f123456789").digests == ["0" * 64]


def test_a_ledger_that_changes_in_spite_of_the_lock_is_not_replaced(tmp_path, monkeypatch):
    """As on a network drive whose locks do not reach other hosts."""
    path = tmp_path / "x.fits.json"
    _written(path, _entry())
    here, elsewhere = Ledger(path), Ledger(path)
    written = as_text

    def meanwhile(document):
        monkeypatch.setattr(_history, "as_text", written)
        with monkeypatch.context() as without:
            without.setattr(_history, "locked", lambda path: nullcontext())
            elsewhere.annotate("f1", note="theirs")
        return written(document)

    monkeypatch.setattr(_history, "as_text", meanwhile)
    with pytest.raises(LedgerError, match="changed by another program at the same time"):
        here.annotate("f1", note="ours")
    assert Ledger(path).find("f1").stored.note == "theirs"
    here.annotate("f1", note="ours")
    assert Ledger(path).find("f1").stored.note == "ours"
    assert [p.name for p in tmp_path.iterdir()] == ["x.fits.json"]


_NOTES = """
import os, sys
from pathlib import Path
from fitting.study._history import Entry, Ledger
ledger = Ledger(Path(sys.argv[1]))
os.setgid(int(sys.argv[2]))
os.setuid(int(sys.argv[2]))
for k in range(int(sys.argv[3])):
    document = dict(ledger.find("f1").document)
    with ledger._locked():
        highest = max(int(e.fit_id[1:]) for e in ledger.entries)
        ledger.entries.append(Entry(document | {"fit_id": f"f{highest + 1}", "name": sys.argv[2]}))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may become two users")
def test_two_users_with_folders_for_temporary_files_of_their_own_lose_no_fit(tmp_path):
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(0o777)
    # both users pass through the folders of the run, of which there is one more in a worker of pytest-xdist
    for above in (tmp_path, *tmp_path.parents):
        if above == Path(tempfile.gettempdir()):
            break
        above.chmod(0o755)
    path = folder / "x.fits.json"
    _written(path, _entry())
    path.chmod(0o666)
    each, writers = 25, []
    for user in (1001, 1002, 1001, 1002):
        own = folder / f"tmp{len(writers)}"
        own.mkdir()
        command = [sys.executable, "-c", _NOTES, str(path), str(user), str(each)]
        writers.append(subprocess.Popen(command, cwd=ROOT, env={**os.environ, "TMPDIR": str(own)}))
    assert [w.wait() for w in writers] == [0] * len(writers)
    fits = Ledger(path).entries
    assert [e.fit_id for e in fits] == [f"f{k + 1}" for k in range(len(writers) * each + 1)]
    assert (
        sum(e.stored.name == "1001" for e in fits) == sum(e.stored.name == "1002" for e in fits) == 2 * each
    )
    assert sorted(p.name for p in folder.iterdir() if p.is_file()) == ["x.fits.json"]


KILLED = """
import os, signal, sys
from pathlib import Path
from fitting._schema import locked, write_text
path = Path(sys.argv[1])
with locked(path):
    write_text(path, "new", unchanged=lambda: os.kill(os.getpid(), signal.SIGKILL))
"""


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
def test_the_next_writer_removes_what_a_killed_one_has_left_and_nothing_else(tmp_path):
    path, foreign = tmp_path / "x.fits.json", tmp_path / "x.fits.json.0123abcd.part"
    path.write_text("old")
    foreign.write_text("precious")
    killed = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False, cwd=ROOT)
    assert killed.returncode == -signal.SIGKILL
    assert path.read_text() == "old"
    assert len(list(tmp_path.glob("*.part"))) == 2
    with locked(path):
        write_text(path, "new")
    assert path.read_text() == "new"
    assert sorted(p.name for p in tmp_path.iterdir()) == [path.name, foreign.name]


@pytest.mark.parametrize("name", ["../x.fits.json.0123abcd.part", "y.fits.json.0123abcd.part", "x.fits.json"])
def test_a_lock_names_no_file_but_its_own_temporary_one(tmp_path, name):
    folder = tmp_path / "case"
    folder.mkdir()
    path, other = folder / "x.fits.json", folder / name
    path.write_text("old")
    other.write_text("precious")
    (folder / f".{path.name}.lock").write_bytes(b"gyrotrack lock\n" + name.encode())
    with locked(path):
        assert other.read_text() == "precious"


def ledger(tmp_path, *entries):
    path = tmp_path / "x.fits.json"
    documents = [
        {"model": [], "parameters": {}, "digests": ["0" * 64], "verdict": "x", "fit_id": f"f{i + 1}"} | e
        for i, e in enumerate(entries)
    ]
    path.write_text(json.dumps({"format": "gyrotrack ledger", "version": 1, "fits": documents}))
    return Ledger(path)


class TestLedger:
    def test_only_a_fit_without_successors_is_deleted(self, tmp_path):
        book = ledger(tmp_path, {}, {"parent": "f1"}, {"parent": "f2"})
        for name in ("f1", "f2"):
            with pytest.raises(LedgerError, match="has successors"):
                book.delete(name)
        removed = book.delete("f3")
        assert [e.fit_id for e in Ledger(book.path).entries] == ["f1", "f2"]
        with pytest.raises(LedgerError, match="has no fit 'f3'"):
            book.find("f3")
        with pytest.raises(LedgerError, match="has another fit f1"):
            book.restore(book.find("f1"))
        book.restore(removed)
        assert [e.fit_id for e in Ledger(book.path).entries] == ["f1", "f2", "f3"]

    def test_a_restored_fit_takes_its_place_by_number(self, tmp_path):
        book = ledger(tmp_path, {"fit_id": "f2"}, {"fit_id": "f10"})
        removed = book.delete("f2")
        book.restore(removed)
        assert [e.fit_id for e in Ledger(book.path).entries] == ["f2", "f10"]

    def test_fits_belong_to_exactly_their_cases(self, tmp_path):
        book = ledger(tmp_path, {"digests": ["b", "a"]}, {"digests": ["a"]}, {"digests": ["a", "b", "c"]})

        def found(*digests):
            cases = [SimpleNamespace(record=SimpleNamespace(digest=d)) for d in digests]
            return [e.fit_id for e in book.of(cases)]

        assert found("a", "b") == ["f1"]
        assert found("a") == ["f2"]
        assert found("c", "b", "a") == ["f3"]
        assert found("b") == []

    def test_texts_are_cut_at_200_and_2000_characters(self, tmp_path):
        book = ledger(tmp_path, {})
        book.annotate("f1", name="  " + 300 * "n", note=" " + 3000 * "m")
        stored = book.find("f1").stored
        assert (stored.name, stored.note) == (200 * "n", 2000 * "m")
        book.annotate("f1", name=" short ")
        assert (book.find("f1").stored.name, len(book.find("f1").stored.note)) == ("short", 2000)
        book.annotate("f1", note="")
        assert (book.find("f1").stored.name, book.find("f1").stored.note) == ("short", "")

    def test_the_ledger_is_next_to_its_case(self, tmp_path):
        book = Ledger.default_for(tmp_path / "case1.h5")
        assert book.path == tmp_path / "case1.fits.json"
        assert book.entries == []

    def test_a_prior_needs_a_covariance(self):
        known = {"fit_id": "f1", "model": [], "parameters": {}, "digests": [], "verdict": "x"}
        with pytest.raises(LedgerError, match="without a covariance"):
            Entry(known).as_prior("a study")
        assert Entry(known).prior is None

    def test_a_certificate_belongs_to_its_answer_seed_and_kind(self):
        def stored(**changed):
            return {"code": fingerprint(), "n": 9, "seed": 4, "verdict": "adequate"} | changed

        found = SimpleNamespace(
            verdict="adequate",
            candidates=(),
            fit=SimpleNamespace(
                problem=SimpleNamespace(data=[SimpleNamespace(record=SimpleNamespace(body="disc"))])
            ),
        )
        of_data = stored(score=1.0)
        of_films = stored(seed=5, film=True, score=2.0)
        both = Entry({"certificate": of_data, "certificate_of_films": of_films})
        none = None
        for seed, film, score in (
            (none, none, 2.0),
            (none, True, 2.0),
            (none, False, 1.0),
            (4, none, 1.0),
            (5, none, 2.0),
            (5, False, none),
            (4, True, none),
            (6, none, none),
        ):
            known = both.certificate(found, seed, film=film)
            assert (known.score if known else none) == score
        assert both.latest_certificate().score == 2.0
        assert Entry({"certificate": of_data}).latest_certificate().score == 1.0
        assert Entry({}).latest_certificate() is None
        for change in ({"verdict": "unexplained"}, {"named": ["a"]}, {"code": "x"}):
            assert Entry({"certificate": stored(**change)}).certificate(found) is None
        assert Entry({"certificate": stored(code="x")}).latest_certificate() is None


@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
def test_only_a_fit_of_least_squares_is_stored_for_display(tmp_path, monkeypatch, loss):
    book = ledger(tmp_path, {"fit_id": "f3"}, {"fit_id": "f9"})
    record = SimpleNamespace(digest="d", source="file", quantity="omega", generated=True)
    layout = SimpleNamespace(choices=(("a",), ("b",)), names=("n",))
    found = SimpleNamespace(
        problem=SimpleNamespace(layout=layout, data=[SimpleNamespace(record=record)]),
        model=SimpleNamespace(effects=()),
        covariance=np.array([[4.0]]),
    )
    monkeypatch.setattr(
        _history, "fit_document", lambda f, i: {"fit_id": i, "model": [], "parameters": {}, "verdict": "x"}
    )
    monkeypatch.setattr(_history, "step_document", lambda *given: None)
    monkeypatch.setattr(_history, "stored_fit", lambda f: "stored")
    monkeypatch.setattr(_history, "as_json", lambda x: {"kept": x})
    entry = book.add(found, parent="f9", added="+x", loss=loss, ranges={"k": (0.0, 1.0)})
    stored = Ledger(book.path).find("f10").stored
    assert entry.fit_id == "f10"
    assert stored.restored_from == ({"kept": "stored"} if loss == "linear" else None)
    assert (stored.share, stored.per_case, stored.parent, stored.added) == (["a"], ["b"], "f9", "+x")
    assert (stored.data, stored.rotor, stored.loss, stored.ranges) == (
        "omega",
        "generated",
        loss,
        {"k": (0.0, 1.0)},
    )
    assert (stored.digests, stored.sources, stored.covariance) == (["d"], ["file"], [[4.0]])
    other = book.add(found, share=["s"])
    assert other.choices == (("s",), ())
