"""Interlaced film: fields at their own times, their order, and films that are only declared as interlaced."""

from fractions import Fraction

import av
import numpy as np
import pytest

from gyrotrack.tracking._film import Film
from gyrotrack.video._fields import field, first_field

HEIGHT, WIDTH = 64, 96


def picture(k, step=3.0):
    """A smooth bright spot that moves by `step` px from field to field."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    spot = np.exp(-((x - 20 - step * k) ** 2 + (y - 30) ** 2) / (2 * 5.0**2))
    return (40 + 180 * spot).round().astype(np.uint8)


def woven(frames, first):
    """Frames of which each has two successive pictures in its fields, the earlier one in the field `first`."""
    found = []
    for k in range(frames):
        fields = picture(2 * k), picture(2 * k + 1)
        frame = np.empty((HEIGHT, WIDTH), np.uint8)
        for parity in (0, 1):
            frame[parity::2] = fields[parity != first][parity::2]
        found.append(frame)
    return found


def test_a_field_has_its_lines_where_they_were():
    ramp = np.repeat(np.arange(10, 74, dtype=np.uint8)[:, None], 20, axis=1)
    for odd in (False, True):
        shown = field(ramp, odd=odd).astype(int)
        assert shown.shape == ramp.shape
        assert np.abs(shown - ramp)[2:-2].max() == 0  # linear interpolation of a ramp is exact


@pytest.mark.parametrize("first", [0, 1])
def test_the_order_of_the_fields_is_found(first):
    assert first_field(woven(8, first)) == first


def test_a_progressive_or_still_film_has_no_fields():
    assert first_field([picture(2 * k) for k in range(8)]) is None
    assert first_field([picture(0)] * 8) is None
    assert first_field(woven(2, 0)) is None  # too few


@pytest.mark.parametrize(("declared", "interlaced"), [(True, True), (False, False)])
def test_an_interlaced_film_is_read_as_its_fields(tmp_path, declared, interlaced):
    path = tmp_path / "film.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.height, stream.width, stream.pix_fmt = HEIGHT, WIDTH, "yuv420p"
        stream.options = {"crf": "5", "x264-params": "tff=1" if declared else "interlaced=0"}
        for k, luma in enumerate(woven(14, 0)):
            planes = np.concatenate([luma, np.full((HEIGHT // 2, WIDTH), 128, np.uint8)])
            frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            frame.pts, frame.time_base = k, Fraction(1, 25)
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    film = Film(path)
    assert len(film) == (28 if interlaced else 14)
    assert film.info.container_fps == (50 if interlaced else 25)
    assert any("interlaced" in w for w in film.warnings) == interlaced
    if interlaced:
        assert film.stamps == pytest.approx(np.arange(28) / 50)
        x = [np.average(np.arange(WIDTH), weights=np.clip(f.astype(float).sum(axis=0) - 64 * 41, 0, None))
             for f in film.frames()]  # fmt: skip
        assert np.diff(x)[2:20] == pytest.approx(3.0, abs=0.25)
