import av
import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.video._container import opened, probe


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
