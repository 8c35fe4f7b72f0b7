"""The hash behind the end of a file: any byte that changes is noticed before HDF5 reads one."""

import hashlib
from io import BytesIO

import h5py
import numpy as np
import pytest

from fitting import RecordError
from fitting._hdf5 import CHECKSUM_LENGTH as LENGTH
from fitting._hdf5 import checksum_line, has_endless_heap
from fitting.inference._case_file import read_record
from gyrotrack import DatasetError, read_case, read_recording, write_recording
from gyrotrack.apps.cli._app import run


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "case.h5"
    assert run(["simulate", "-o", str(path), "--duration", "12", "--window-length", "1"]) == 0
    return path


def test_any_byte_that_changes_is_noticed(file):
    whole = file.read_bytes()
    rng = np.random.default_rng(1)
    for place in [0, 100, 3346, len(whole) - LENGTH, len(whole) - 2, *rng.integers(0, len(whole), 60)]:
        wrong = bytearray(whole)
        wrong[place] ^= 1 + rng.integers(255)
        file.write_bytes(bytes(wrong))
        for read, error in ((read_case, DatasetError), (read_record, RecordError)):
            if len(whole) - LENGTH <= place < len(whole) - 65:
                read(file)  # the seal's own word is gone, and the numbers are right
                continue
            with pytest.raises(error):
                read(file)


def test_the_seal_is_the_hash_of_what_stands_before_it(file):
    whole = file.read_bytes()
    assert (
        whole[-LENGTH:]
        == b"\ngyrotrack sha256 " + hashlib.sha256(whole[:-LENGTH]).hexdigest().encode() + b"\n"
    )


def test_others_read_on_and_may_change_the_file(tmp_path, recording):
    path = write_recording(tmp_path / "r.h5", recording, command="", settings={})
    with h5py.File(path, "r+") as changed:
        changed.attrs["note"] = "mine"
    assert read_recording(path).frames_decoded == recording.frames_decoded


@pytest.mark.parametrize("seal", ["broken", "none", "true"])
def test_a_heap_that_runs_in_circles_is_not_entered(file, seal):
    """Bytes in the heap of texts with which HDF5 2.0 never returns from reading an attribute."""
    whole = file.read_bytes()
    place = whole.index(b"GCOL") + 18
    wrong = whole[:place] + b"\x00" * 64 + whole[place + 64 :]
    if seal != "broken":
        wrong = wrong[:-LENGTH]
    file.write_bytes(wrong + (checksum_line(BytesIO(wrong)) if seal == "true" else b""))
    words = "checksum" if seal == "broken" else "string heap|run in circles"
    with pytest.raises(DatasetError, match=words):
        read_case(file)
    with pytest.raises(RecordError, match=words):
        read_record(file)


def test_a_heap_is_found_where_blocks_of_the_file_meet(tmp_path, monkeypatch):
    heap = b"GCOL\x01\x00\x00\x00" + (4096).to_bytes(8, "little") + bytes(4080)
    sound = heap[:24] + (4080).to_bytes(8, "little") + heap[32:]
    monkeypatch.setattr("fitting._hdf5._BLOCK", 64)
    for before in range(50, 70):
        (tmp_path / "f").write_bytes(bytes(before) + heap)
        assert has_endless_heap(tmp_path / "f")
        (tmp_path / "f").write_bytes(bytes(before) + sound)
        assert not has_endless_heap(tmp_path / "f")
