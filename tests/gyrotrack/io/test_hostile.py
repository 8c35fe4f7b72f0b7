"""Files made to mislead: refused before anything of them is read, whatever reads them."""

import shutil
import time

import h5py
import numpy as np
import pytest

from fitting import RecordError
from fitting.inference._case_file import read_record
from gyrotrack import DatasetError, export_file, read_case
from gyrotrack.io._contents import inspect_file

SECRET = b"the secret of the neighbour's file " * 400


@pytest.fixture(scope="module")
def folder(tmp_path_factory, case_file):
    folder = tmp_path_factory.mktemp("hostile")
    (folder / "secret.txt").write_bytes(SECRET)
    with h5py.File(folder / "other.h5", "w") as other:
        other["x"] = np.full(400, 42.0)
        other["group/x"] = np.full(400, 42.0)
    shutil.copy(case_file, folder)
    return folder


@pytest.fixture
def path(folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    return tmp_path / "case.h5"


def virtual(file, name):
    layout = h5py.VirtualLayout(shape=(400,), dtype="f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", shape=(400,))
    file.create_virtual_dataset(name, layout)


ATTACKS = {
    "external link": lambda f, n: f.__setitem__(n, h5py.ExternalLink("other.h5", "/x")),
    "external link, absolute": lambda f, n: f.__setitem__(n, h5py.ExternalLink("/etc/passwd", "/")),
    "external group": lambda f, n: f.__setitem__(n, h5py.ExternalLink("other.h5", "/group")),
    "external link to itself": lambda f, n: f.__setitem__(n, h5py.ExternalLink("case.h5", "/")),
    "soft link": lambda f, n: f.__setitem__(n, h5py.SoftLink("/casing/time")),
    "soft link nowhere": lambda f, n: f.__setitem__(n, h5py.SoftLink("/nowhere/at/all")),
    "soft loop": lambda f, n: f.__setitem__(n, h5py.SoftLink("/" + n)),
    "external storage": lambda f, n: f.create_dataset(n, (400,), "f8", external=[("secret.txt", 0, 3200)]),
    "external bytes": lambda f, n: f.create_dataset(n, (100,), "u1", external=[("/etc/passwd", 0, 100)]),
    "virtual": virtual,
    "plugin filter": lambda f, n: f.create_dataset(n, data=np.zeros(400), compression="lzf"),
    "bomb of 8 TB": lambda f, n: f.create_dataset(n, (2**40,), "f8", chunks=(2**20,), compression="gzip"),
    "bomb of 8 GB": lambda f, n: f.create_dataset(n, (2**30,), "f8", chunks=(2**20,)),
    "huge chunk": lambda f, n: f.create_dataset(n, (400,), "f8", chunks=(2**28,), maxshape=(None,)),
    "bomb of 4 GB": lambda f, n: f.create_dataset(n, (2**29,), "f8", chunks=(2**22,), compression="gzip"),
}  # fmt: skip
PLACES = ("casing/angle", "casing/mine", "notes", "a/b/c/d")
# the rule is that of the attack, wherever it is: one place of a known name and one of another
OTHER_PLACES = {"casing/mine", "notes"}


@pytest.mark.parametrize(
    "place", [pytest.param(p, marks=pytest.mark.slow) if p in OTHER_PLACES else p for p in PLACES]
)
@pytest.mark.parametrize("attack", ATTACKS)
def test_nothing_from_outside_is_read_and_nothing_fills_the_memory(path, attack, place, tmp_path):
    with h5py.File(path, "r+") as file:
        if place in file:
            del file[place]
        ATTACKS[attack](file, place)
    start = time.perf_counter()
    for read in (read_case, inspect_file, lambda p: inspect_file(p, verify=True)):
        with pytest.raises(DatasetError) as caught:
            read(path)
        assert "damaged: " not in caught.value.message  # refused by rule, not by an accident on the way
    with pytest.raises(DatasetError):
        export_file(path, tmp_path / "out.nc")
    assert not (tmp_path / "out.nc").exists()
    with pytest.raises(RecordError):
        read_record(path)
    assert time.perf_counter() - start < 5


@pytest.mark.slow
def test_too_deep_and_too_many(path):
    with h5py.File(path, "r+") as file:
        file.create_group("/".join("abcdefghij" * 4))
    with pytest.raises(DatasetError, match="too deep"):
        read_case(path)
    with h5py.File(path, "r+") as file:
        del file["a"]
        for i in range(20_001):
            file.create_group(f"g/{i}")
    with pytest.raises(DatasetError, match="too many"):
        read_case(path)


def test_a_loop_of_hard_links_ends(path):
    with h5py.File(path, "r+") as file:
        file["casing/again"] = file["/"]
    read_case(path)


@pytest.mark.parametrize(
    ("version", "words"),
    [
        ("0.9", "oldest supported"),
        ("3.0", "newest supported"),
        ("99", "newest supported"),
        ("-1", "no valid"),
        ("1.9", None),
    ],
)
def test_other_layouts_by_rule(path, version, words):
    """A minor version adds and never changes: it is read. A major one is refused, older or newer."""
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = version
        file["casing/something_new"] = np.zeros(3)
    if words is None:
        read_case(path)
    else:
        with pytest.raises(DatasetError, match=words):
            read_case(path)


def test_a_name_is_shown_and_not_obeyed(path, capsys, program):

    with h5py.File(path, "r+") as file:
        file.attrs["label"] = "\x1b]0;owned\x07\u202egnp.exe"
        file.attrs["command"] = "rm -rf /\x1b[2J"
    assert program(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert not {"\x1b", "\x07", "\u202e"} & set(out)
    assert "\\x1b]0;owned" in out
