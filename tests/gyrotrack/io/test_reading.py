"""Files of others: each bad one is refused in one sentence, and nothing outside is read."""

import shutil

import h5py
import numpy as np
import pytest

from gyrotrack import DatasetError, read_case, read_recording, write_recording
from gyrotrack.io._hdf5 import read_kind
from tests.gyrotrack.io.conftest import make_recording


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "r.h5"
    return write_recording(path, make_recording(), command="", settings={})


@pytest.fixture
def path(written, tmp_path):
    return shutil.copy(written, tmp_path / "r.h5")


def refused(path, match, reader=read_recording):
    with pytest.raises(DatasetError, match=match) as caught:
        reader(path)
    assert caught.value.message.endswith(".")
    assert "\n" not in caught.value.message


def test_missing_file(tmp_path):
    refused(tmp_path / "no.h5", "does not exist")


def test_folder(tmp_path):
    refused(tmp_path, "is a folder")


@pytest.mark.parametrize("content", [b"t,angle\n0,1\n", b"\x00" * 600, b"\x89PNG\r\n\x1a\n"])
def test_not_hdf5(tmp_path, content):
    (tmp_path / "a.h5").write_bytes(content)
    refused(tmp_path / "a.h5", "not an HDF5 file", read_kind)


def test_empty_file(tmp_path):
    (tmp_path / "a.h5").write_bytes(b"")
    refused(tmp_path / "a.h5", "is empty")


@pytest.mark.parametrize("part", [0.02, 0.3, 0.6, 0.9, 0.999])
def test_cut_short(path, part):
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    refused(path, "damaged|cut short")


def test_other_hdf5(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = 1
    refused(tmp_path / "a.h5", "was not written by gyrotrack")


@pytest.mark.parametrize(
    ("attribute", "value", "match"),
    [
        ("format", "other", "was not written by gyrotrack"),
        ("format_version", "3.0", "newest supported"),
        ("format_version", "one", "no valid format version"),
        ("kind", "photo", "is a photo"),
        ("format_version", 1, "not a string"),
        ("width", "wide", "not an integer"),
        ("sense", np.arange(4), "not an integer"),
        ("warnings", "[", "not JSON"),
        ("extra", "[" * 100_000, "not JSON"),
        ("extra", "[]", "not a JSON object"),
    ],
)
def test_strange_attributes(path, attribute, value, match):
    with h5py.File(path, "r+") as file:
        file.attrs[attribute] = value
    refused(path, match)


def test_newer_minor_version_is_read(path):
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = "1.7"
    read_recording(path)


@pytest.mark.parametrize("name", ["frame/time", "frame", "marker", "body/casing/sigma"])
def test_missing_parts(path, name):
    with h5py.File(path, "r+") as file:
        del file[name]
    refused(path, "lacks")


def replace(path, name, **options):
    with h5py.File(path, "r+") as file:
        del file[name]
        file.create_dataset(name, **options)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"data": np.zeros(7)}, "shape"),
        ({"data": np.zeros((300, 2))}, "shape"),
        ({"data": 1.0}, "shape"),
        ({"data": [b"text"] * 300}, "plain numbers"),
        ({"data": np.zeros(300, dtype="c16")}, "plain numbers"),
        ({"data": np.zeros(300), "compression": "lzf"}, "unknown compression"),
        ({"shape": (2**40,), "dtype": "f8", "chunks": (1024,)}, "declares"),
        ({"shape": (300,), "dtype": "f8", "chunks": (300,), "maxshape": (None,)}, None),
    ],
)
def test_datasets_that_are_not_what_they_should_be(path, options, match):
    replace(path, "frame/pts_time", **options)
    if match is None:
        read_recording(path)
    else:
        refused(path, match)


def test_a_bomb_is_refused_before_it_is_unpacked(path):
    with h5py.File(path, "r+") as file:
        for name in ("frame/frame", "frame/index", "frame/time"):
            del file[name]
            file.create_dataset(name, shape=(10**10,), dtype="f8", chunks=(2**20,), compression="gzip")
    refused(path, "declares")


@pytest.mark.parametrize("link", [h5py.ExternalLink("other.h5", "/x"), h5py.SoftLink("/frame/index")])
def test_links_are_not_followed(path, link):
    with h5py.File(path.parent / "other.h5", "w") as other:
        other["x"] = np.zeros(300)
    with h5py.File(path, "r+") as file:
        del file["frame/time"]
        file["frame/time"] = link
    refused(path, "has a link")


def test_a_linked_group_is_not_followed(path):
    with h5py.File(path, "r+") as file:
        del file["body"]
        file["body"] = h5py.ExternalLink(str(path), "/body")
    refused(path, "has a link")


def test_numbers_of_other_files_are_not_read(path):
    secret = path.parent / "secret.txt"
    secret.write_bytes(b"s" * 2400)
    replace(path, "frame/pts_time", shape=(300,), dtype="f8", external=[(str(secret), 0, 2400)])
    refused(path, "another file")


def test_virtual_datasets_are_not_read(path):
    with h5py.File(path.parent / "other.h5", "w") as other:
        other["x"] = np.zeros(300)
    layout = h5py.VirtualLayout(shape=(300,), dtype="f8")
    layout[:] = h5py.VirtualSource(str(path.parent / "other.h5"), "x", shape=(300,))
    with h5py.File(path, "r+") as file:
        del file["frame/pts_time"]
        file["frame"].create_virtual_dataset("pts_time", layout)
    refused(path, "another file")


def message_of(path):
    try:
        read_recording(path)
    except DatasetError as error:
        return error.message
    return ""


def test_random_damage_never_escapes_as_another_error(path):
    rng = np.random.default_rng(3)
    good = path.read_bytes()
    for _ in range(60):
        bad = bytearray(good)
        for position in rng.integers(0, len(bad), size=rng.integers(1, 30)):
            bad[position] = rng.integers(256)
        path.write_bytes(bytes(bad))
        assert "\n" not in message_of(path)
    with pytest.raises(DatasetError):
        read_case(path)
