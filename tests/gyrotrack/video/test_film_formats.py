"""Films of other formats: streams, GIF, folders of pictures, and pixels that are not square."""

from fractions import Fraction

import av
import cv2
import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.video._container import file_sha256, is_film, probe, read_packets
from gyrotrack.video._decoder import Reader, frames_at

COUNT, SIDE = 20, 64


def picture(k):
    grey = np.full((SIDE, SIDE), 40, np.uint8)
    cv2.circle(grey, (12 + 2 * k, 32), 6, 220, -1)
    return grey


def write(path, codec, *, form=None, aspect=None):
    with av.open(str(path), "w", format=form) as container:
        stream = container.add_stream(codec, rate=50)
        stream.width = stream.height = SIDE
        stream.pix_fmt = "rgb8" if codec == "gif" else "yuv420p"
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        for k in range(COUNT):
            frame = av.VideoFrame.from_ndarray(np.dstack([picture(k)] * 3), format="rgb24")
            container.mux(stream.encode(frame.reformat(format=stream.pix_fmt)))
        container.mux(stream.encode())
    return path


def places(path):
    """Column of the centre of the disc in each frame."""
    with Reader(path) as reader:
        return np.array(
            [np.average(np.arange(f.y.shape[1]), weights=(f.y > 130).sum(axis=0)) for f in reader]
        )


@pytest.mark.parametrize(
    ("name", "codec", "form"),
    [
        ("a.mts", "h264", "mpegts"),
        ("a.ts", "mpeg2video", "mpegts"),
        ("a.mpg", "mpeg1video", "mpeg"),
        ("a.wmv", "wmv2", "asf"),
        ("a.flv", "flv1", "flv"),
        ("a.gif", "gif", "gif"),
        ("a.h264", "h264", "h264"),
    ],
)
def test_formats(tmp_path, name, codec, form):
    if codec not in av.codecs_available:
        pytest.skip(f"no encoder {codec}")
    path = write(tmp_path / name, codec, form=form)
    assert is_film(path)
    np.testing.assert_allclose(places(path), 12 + 2 * np.arange(COUNT), atol=0.7)
    rate = probe(path).container_fps
    assert np.isnan(rate) if form == "h264" else rate == pytest.approx(50, rel=0.01)


@pytest.mark.parametrize(
    ("aspect", "size"), [(2, (64, 128)), (Fraction(1, 2), (128, 64)), (1, (64, 64)), (9, (64, 64))]
)
def test_pixels_that_are_not_square(tmp_path, aspect, size):
    path = write(tmp_path / "a.mp4", "h264", aspect=aspect)
    with Reader(path) as reader:
        shapes = {frame.y.shape for frame in reader}
    assert shapes == {size}
    first = int(read_packets(path).stamps[0])
    assert frames_at(path, [first])[first].y.shape == size
    assert (probe(path).height, probe(path).width) == size
    stretch = size[1] / SIDE
    np.testing.assert_allclose(places(path), stretch * (12.5 + 2 * np.arange(COUNT)) - 0.5, atol=1.0)


def test_numbered_pictures_in_a_folder(tmp_path):
    for k in range(COUNT):
        cv2.imwrite(str(tmp_path / f"img%_{k + 7:04d}.png"), picture(k))
    assert is_film(tmp_path)
    np.testing.assert_allclose(places(tmp_path), 12 + 2 * np.arange(COUNT), atol=0.5)
    assert np.isnan(probe(tmp_path).container_fps)
    before = file_sha256(tmp_path)
    (tmp_path / "img%_0010.png").unlink()
    assert file_sha256(tmp_path) != before
    with pytest.raises(VideoError, match="1 pictures are missing; the first missing number is 10"):
        probe(tmp_path)
    cv2.imwrite(str(tmp_path / "other_0010.png"), picture(0))
    with pytest.raises(VideoError, match="several series"):
        probe(tmp_path)


def test_a_folder_without_pictures_is_not_a_film(tmp_path):
    assert not is_film(tmp_path)
    with pytest.raises(VideoError, match="no numbered pictures"):
        probe(tmp_path)


XML = b'<NonRealTimeMeta><VideoFrame videoCodec="AVC" captureFps="239.76p" formatFps="29.97p"/></NonRealTimeMeta>'


@pytest.mark.parametrize("where", ["inside", "beside", "nowhere"])
def test_the_capture_rate_in_the_xml_of_a_camera(tmp_path, where):
    path = write(tmp_path / "C0001.MP4", "h264", form="mp4")
    if where == "inside":
        body = bytes(4) + XML
        path.write_bytes(path.read_bytes() + (8 + len(body)).to_bytes(4, "big") + b"meta" + body)
    elif where == "beside":
        (tmp_path / "C0001M01.XML").write_bytes(XML)
    assert probe(path).tag_fps == (None if where == "nowhere" else 239.76)
