"""TIFF stacks: depths, rates, colours, and files that are no film."""

import numpy as np
import pytest
import tifffile

from gyrotrack import VideoError
from gyrotrack.apps.cli._app import run
from gyrotrack.video._container import is_film, probe
from gyrotrack.video._decoder import Reader
from gyrotrack.video._tiff import read_stack


def stack(kind=np.uint8, count=8):
    """A bright column that moves by 5 px from picture to picture."""
    found = np.full((count, 48, 64), 30, dtype=kind)
    for k, picture in enumerate(found):
        picture[:, 8 + 5 * k : 14 + 5 * k] = 200
    return found


def columns(path):
    """First bright column of each picture."""
    with Reader(path) as reader:
        return [int(np.argmax(frame.y[20] > 120)) for frame in reader]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int16, np.float32])
def test_pictures_of_every_depth_are_read(tmp_path, kind):
    path = tmp_path / "film.tif"
    tifffile.imwrite(path, stack(kind))
    assert is_film(path)
    assert columns(path) == [8 + 5 * k for k in range(8)]


def test_sixteen_bits_are_scaled_by_the_whole_film(tmp_path):
    path = tmp_path / "film.tiff"
    tifffile.imwrite(path, stack(np.uint16) * 20)
    with Reader(path) as reader:
        grey = np.stack([frame.y.copy() for frame in reader])
    assert grey.min() < 20  # limited range of the decoder: 16
    assert grey.max() > 230


def test_colours_are_kept(tmp_path):
    path = tmp_path / "film.tif"
    pictures = np.zeros((6, 40, 40, 3), np.uint8)
    pictures[..., 0] = 220
    tifffile.imwrite(path, pictures, photometric="rgb")
    with Reader(path) as reader:
        v = [float(frame.v.mean()) for frame in reader]
    assert min(v) > 200


@pytest.mark.parametrize(
    ("interval", "rate"), [({"finterval": 0.02}, 50.0), ({"finterval": 0.0}, None), ({}, None)]
)
def test_the_rate_is_that_of_imagej(tmp_path, interval, rate):
    path = tmp_path / "film.tif"
    tifffile.imwrite(path, stack(), imagej=True, metadata={"axes": "TYX", **interval})
    info = probe(path)
    assert info.frames_declared == 8
    assert info.tag_fps == (None if rate is None else pytest.approx(rate))
    assert np.isfinite(info.container_fps) == (rate is not None)


def test_the_rate_is_that_of_ome(tmp_path):
    path = tmp_path / "film.ome.tif"
    metadata = {"axes": "TYX", "TimeIncrement": 4.0, "TimeIncrementUnit": "ms"}
    tifffile.imwrite(path, stack(), ome=True, metadata=metadata)
    assert read_stack(path).fps == pytest.approx(250.0)


def test_what_is_not_a_film_is_one_sentence(tmp_path, capsys):
    path = tmp_path / "film.tif"
    for content, text in ((stack()[:1], "one picture"), (stack(np.complex64), "type complex64")):
        tifffile.imwrite(path, content)
        with pytest.raises(VideoError, match=text):
            probe(path)
    path.write_bytes(b"II*\0no tiff")
    assert run(["spindown", str(path), "-o", str(tmp_path / "o.h5")]) == 1
    assert "is not a TIFF file" in capsys.readouterr().err


def test_a_film_without_a_rate_is_refused_before_it_is_tracked(tmp_path, capsys):
    path = tmp_path / "film.tif"
    tifffile.imwrite(path, stack())
    assert run(["spindown", str(path), "-o", str(tmp_path / "o.h5")]) == 1
    assert "--capture-fps" in capsys.readouterr().err
