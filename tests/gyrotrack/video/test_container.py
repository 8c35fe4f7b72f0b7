from types import SimpleNamespace

import av
import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.video._container import Orientation, opened, orientation_of, planes_of, probe


def _film(path, size=(64, 48), frames=3, rate=30, codec="libx264", fmt="yuv420p"):
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt = *size, fmt
        for k in range(frames):
            picture = np.full((size[1], size[0], 3), 20 * k, dtype=np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return path


def test_what_a_film_declares(tmp_path):
    info = probe(_film(tmp_path / "a.mp4", size=(96, 64), frames=7, rate=25))
    assert (info.width, info.height, info.frames_declared) == (96, 64, 7)
    assert info.container_fps == 25.0
    assert info.tag_fps is None


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "no file"),
        (b"", "empty"),
        (b"this is a text, not a film" * 50, "not a film"),
        (b"\0" * 4096, "not a film"),
    ],
)
def test_what_is_not_a_film_is_refused_in_one_sentence(tmp_path, content, sentence):
    path = tmp_path / "x.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(VideoError, match=sentence) as caught:
        probe(path)
    assert "x.mp4" in caught.value.message
    assert caught.value.hint
    assert "\n" not in caught.value.message


def test_a_playlist_cannot_open_other_files(tmp_path):
    secret = _film(tmp_path / "secret.mp4")
    trick = tmp_path / "trick.mp4"
    trick.write_text(f"ffconcat version 1.0\nfile {secret.name}\n")
    with pytest.raises(VideoError):
        probe(trick)


def test_sound_alone_is_refused(tmp_path):
    path = tmp_path / "sound.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=44100)
        frame = av.AudioFrame.from_ndarray(
            np.zeros((1, 4096), dtype=np.float32), format="fltp", layout="mono"
        )
        frame.sample_rate = 44100
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with pytest.raises(VideoError, match="no video"):
        probe(path)


def test_too_small_a_picture_is_refused(tmp_path):
    with pytest.raises(VideoError, match="too small"):
        probe(_film(tmp_path / "dot.mp4", size=(16, 16)))


def test_a_huge_picture_is_not_decoded(tmp_path, monkeypatch):
    path = _film(tmp_path / "big.mp4", size=(256, 256))
    monkeypatch.setattr("gyrotrack.video._container.MAX_PIXELS", 1000)
    with pytest.raises(VideoError, match="too large"), opened(path):
        pass


@pytest.mark.parametrize(
    ("aspect", "luma", "chroma"),
    [
        (1.0, (20, 30), (10, 15)),
        (1.1, (20, 33), (10, 17)),
        (1.2, (20, 36), (10, 18)),
        (1 / 1.05, (21, 30), (11, 15)),
    ],
)
@pytest.mark.parametrize("quarters", [0, 1])
def test_planes_of_a_film_of_other_pixels_have_the_size_of_square_ones(aspect, luma, chroma, quarters):
    """Colours are sampled at every second pixel, the last one included."""
    frame = av.VideoFrame.from_ndarray(np.full((30, 30), 100, dtype=np.uint8), format="yuv420p")
    found = planes_of(frame, 7, Orientation(quarters=quarters, aspect=aspect))
    turned = slice(None, None, -1 if quarters else 1)
    assert found.y.shape == luma[turned]
    assert found.u.shape == found.v.shape == chroma[turned]
    assert (found.index, int(found.y.min()), int(found.u.max())) == (7, 100, 100)


@pytest.mark.parametrize(
    ("stated", "coded", "used"),
    [
        (4 / 3, 1, 4 / 3), (None, 0.75, 0.75), (0, 0, 1), (4.0, 1, 4.0), (4.1, 1, 1), (0.25, 1, 0.25), (0.24, 1, 1)
    ],
)  # fmt: skip
def test_pixels_are_at_most_four_times_as_wide_or_high(stated, coded, used):
    """The film's own statement comes before that of its coding; others are errors of the header."""
    stream = SimpleNamespace(
        sample_aspect_ratio=stated, codec_context=SimpleNamespace(sample_aspect_ratio=coded)
    )
    assert orientation_of(SimpleNamespace(side_data={}), stream) == Orientation(aspect=used)
