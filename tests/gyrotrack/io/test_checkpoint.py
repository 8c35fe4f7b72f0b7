"""The log of an unfinished run: whole records survive, torn ones are dropped, two writers never meet."""

import json
import zlib

import numpy as np
import pytest

from fitting import LedgerError
from fitting._schema import locked as ledger_locked
from gyrotrack import OutputError, TrackingError
from gyrotrack.io._atomic import CheckpointFile, checkpoint_path

FACTS = {"film": "abc", "profile": {"name": "paper", "marker": [1, 2]}, "body": None}


def fill(output, count=3):
    with CheckpointFile(output, FACTS) as journal:
        for k in range(count):
            journal.append({"k": k}, {"a": np.arange(k + 1.0), "b": np.zeros((2, 0), dtype=np.int64)})


def content_of(journal):
    return [(r.facts["k"], r.arrays["a"].tolist(), r.arrays["b"].shape) for r in journal.records()]


WHOLE = [(0, [0.0], (2, 0)), (1, [0.0, 1.0], (2, 0)), (2, [0.0, 1.0, 2.0], (2, 0))]


def test_what_was_written_is_read_again_and_goes_on(tmp_path):
    fill(tmp_path / "o.h5")
    with CheckpointFile(tmp_path / "o.h5", FACTS, resume=True) as journal:
        assert len(journal) == len(WHOLE)
        assert content_of(journal) == WHOLE
        journal.append({"k": 9}, {"a": np.ones(1), "b": np.zeros((2, 0))})
        assert len(content_of(journal)) == 4
        journal.discard()
    assert list(tmp_path.iterdir()) == []


def test_without_resume_it_starts_anew(tmp_path):
    fill(tmp_path / "o.h5")
    with CheckpointFile(tmp_path / "o.h5", FACTS) as journal:
        assert len(journal) == 0
        assert content_of(journal) == []


def test_a_journal_of_another_run_is_not_taken_up(tmp_path):
    fill(tmp_path / "o.h5")
    with CheckpointFile(tmp_path / "o.h5", {**FACTS, "film": "other"}, resume=True) as journal:
        assert journal.other
        assert len(journal) == 0


def test_an_empty_one_is_removed_and_one_with_records_stays(tmp_path):
    path = checkpoint_path(tmp_path / "o.h5")
    fill(tmp_path / "o.h5", 0)
    assert not path.exists()
    fill(tmp_path / "o.h5", 1)
    assert path.exists()


@pytest.mark.parametrize("error", [KeyboardInterrupt, OutputError, MemoryError])
def test_it_stays_when_a_run_could_go_on(tmp_path, error):
    _fail(tmp_path, error("x"))
    assert checkpoint_path(tmp_path / "o.h5").exists()


def test_it_goes_when_the_input_is_at_fault(tmp_path):
    _fail(tmp_path, TrackingError("no markers"))
    assert not checkpoint_path(tmp_path / "o.h5").exists()


def _fail(folder, error):
    with pytest.raises(type(error)):
        _one_record_then(folder / "o.h5", error)


def _one_record_then(output, error):
    with CheckpointFile(output, FACTS) as journal:
        journal.append({"k": 0}, {})
        raise error


@pytest.mark.slow
def test_cut_at_every_byte_it_holds_the_whole_records_before(tmp_path):
    output = tmp_path / "o.h5"
    fill(output)
    path = checkpoint_path(output)
    whole = path.read_bytes()
    held = []
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        with CheckpointFile(output, FACTS, resume=True) as journal:
            found = content_of(journal)
        assert found == WHOLE[: len(found)]
        held.append(len(found))
    assert held == sorted(held)
    assert set(held) == {0, 1, 2}


def test_a_changed_byte_drops_its_record_and_what_follows(tmp_path):
    output = tmp_path / "o.h5"
    fill(output)
    path = checkpoint_path(output)
    whole = path.read_bytes()
    for place in range(whole.index(b"\n") + 1, len(whole), 3):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        with CheckpointFile(output, FACTS, resume=True) as journal:
            found = content_of(journal)
        assert found == WHOLE[: len(found)]
        assert len(found) < 3


def test_two_runs_of_one_output_do_not_mix(tmp_path, monkeypatch):
    monkeypatch.setattr("gyrotrack.io._atomic.LOCK_TIMEOUT", 0.2)
    with CheckpointFile(tmp_path / "o.h5", FACTS) as journal:
        journal.append({"k": 0}, {"a": np.zeros(1), "b": np.zeros((2, 0))})
        for resume in (False, True):
            with pytest.raises(OutputError, match="another program"):
                CheckpointFile(tmp_path / "o.h5", FACTS, resume=resume)
        assert len(content_of(journal)) == 1


def test_a_folder_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(OutputError, match="cannot be written"):
        CheckpointFile(tmp_path / "no" / "o.h5", FACTS)
    with pytest.raises(LedgerError, match="cannot be written"), ledger_locked(tmp_path / "no" / "o.json"):
        pass
    assert not (tmp_path / "no").exists()


# what a file with valid checksums may hold that this program did not write
CRAFTED = [
    b"",
    b"\x05\x00\x00\x00[1,2]",
    b"\xff\xff\xff\xff{}",
    *(
        len(m := json.dumps(manifest).encode()).to_bytes(4, "little") + m
        for manifest in (
            {},
            {"facts": 1, "arrays": []},
            {"facts": FACTS},
            {"facts": FACTS, "arrays": [["a", "|O", [1]]]},
            {"facts": FACTS, "arrays": [["a", "<f8", [10**30]]]},
            {"facts": FACTS, "arrays": [["a", "<f8", [-1]]]},
            {"facts": FACTS, "arrays": [["a", "<f8", ["x"]]]},
            {"facts": FACTS, "arrays": [["a", "<f8", [2**62, 2**62, 16]]]},
            {"facts": FACTS, "arrays": {"a": 1}},
            {"facts": [["a", []]], "arrays": []},
        )
    ),
]


@pytest.mark.parametrize("content", CRAFTED)
@pytest.mark.parametrize("kept", [0, 2])
def test_a_crafted_record_is_dropped_with_all_that_follow(tmp_path, content, kept):
    output = tmp_path / "o.h5"
    fill(output, kept + 1)
    path = checkpoint_path(output)
    with CheckpointFile(output, FACTS, resume=True) as journal:
        end = journal._ends[kept]
    crafted = len(content).to_bytes(8, "little") + zlib.crc32(content).to_bytes(4, "little") + content
    path.write_bytes(path.read_bytes()[:end] + crafted)
    with CheckpointFile(output, FACTS, resume=True) as journal:
        assert content_of(journal) == WHOLE[:kept]
