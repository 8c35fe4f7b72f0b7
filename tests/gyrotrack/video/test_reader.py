import av
import numpy as np
import pytest

from gyrotrack.video._container import Orientation, read_packets
from gyrotrack.video._decoder import Reader, frames_at

BITS = 8


def _picture(k, size=(128, 96)):
    """A frame that carries its number as a bar code, and a mark in its upper left corner."""
    picture = np.full((size[1], size[0], 3), 90, dtype=np.uint8)
    for bit in range(BITS):
        picture[40:60, 8 * bit + 8 : 8 * bit + 16] = 255 if k >> bit & 1 else 0
    picture[:16, :16] = (255, 0, 0)
    return picture


def _number(frame):
    return sum(1 << bit for bit in range(BITS) if frame.y[50, 8 * bit + 12] > 128)


def _film(path, frames=120, size=(128, 96), fmt="yuv420p", codec="libx264", gop=30, rotation=None):
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=260)
        stream.width, stream.height, stream.pix_fmt = *size, fmt
        if codec == "libx264":
            stream.options = {"g": str(gop), "bf": "2", "crf": "12", "sc_threshold": "0"}
        if rotation is not None:
            stream.set_display_rotation(rotation)
        for k in range(frames):
            frame = av.VideoFrame.from_ndarray(_picture(k, size), format="rgb24")
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("threads", [1, 2])
def test_every_frame_comes_once_and_in_order(tmp_path, threads):
    with Reader(_film(tmp_path / "a.mp4"), threads) as reader:
        numbers = [_number(frame) for frame in reader]
    assert numbers == list(range(120))
    assert reader.decoded == 120
    assert reader.warnings == ()
    np.testing.assert_allclose(np.diff(reader.pts_seconds()), 1 / 260, atol=1e-5)


@pytest.mark.parametrize(
    ("fmt", "codec", "name"),
    [
        ("yuv444p", "libx264", "a.mp4"),
        ("yuv420p10le", "libx264", "a.mp4"),
        ("gray", "libx264", "a.mp4"),
        ("yuvj420p", "mjpeg", "a.avi"),
    ],
)
def test_other_pixel_formats_give_the_same_planes(tmp_path, fmt, codec, name):
    with Reader(_film(tmp_path / name, 12, fmt=fmt, codec=codec)) as reader:
        frames = [frame.copy() for frame in reader]
    assert [_number(frame) for frame in frames] == list(range(12))
    assert frames[0].u.shape == frames[0].v.shape == (48, 64)
    assert (frames[0].v[2, 2] > 180) == (fmt != "gray")


def test_odd_sizes_round_the_chroma_up(tmp_path):
    path = tmp_path / "odd.avi"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=260)
        stream.width, stream.height, stream.pix_fmt = 97, 75, "yuv420p"
        frame = av.VideoFrame.from_ndarray(np.zeros((75, 97, 3), dtype=np.uint8), format="rgb24")
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with Reader(path) as reader:
        (frame,) = list(reader)
    assert frame.y.shape == (75, 97)
    assert frame.u.shape == (38, 49)


@pytest.mark.skipif(
    not hasattr(av.video.stream.VideoStream, "set_display_rotation"),
    reason="needs PyAV 17.1 to write a rotation",
)
@pytest.mark.parametrize("rotation", [0, 90, 180, -90])
def test_rotation_is_applied(tmp_path, rotation):
    path = _film(tmp_path / "r.mp4", 3, size=(128, 96), rotation=rotation)
    with Reader(path) as reader:
        frame = next(iter(reader))
    shape, corner = {
        0: ((96, 128), (8, 8)),
        90: ((128, 96), (120, 8)),  # counter-clockwise: upper left goes to lower left
        180: ((96, 128), (88, 120)),
        -90: ((128, 96), (8, 88)),
    }[rotation]
    assert frame.y.shape == shape
    assert frame.v[corner[0] // 2, corner[1] // 2] > 180


def test_a_mirror_swaps_left_and_right():
    plane = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(Orientation(mirrored=True).apply(plane), plane[:, ::-1])


def test_a_cut_off_film_gives_what_is_sound(tmp_path):
    path = _film(tmp_path / "cut.mp4")
    whole = path.read_bytes()
    moov_last = whole.rfind(b"moov")
    # Cut the picture data but keep the index, as a copy that stopped early with its index in front.
    index = whole[moov_last - 4 :]
    start = whole.find(b"mdat") + 4
    keep = start + (moov_last - start) // 2
    path.write_bytes(whole[:keep] + b"\0" * (moov_last - 4 - keep) + index)
    with Reader(path) as reader:
        numbers = [_number(frame) for frame in reader]
    assert 20 < len(numbers) < 120
    assert numbers[:20] == list(range(20))
    assert any("declares 120 frames" in text or "damaged" in text for text in reader.warnings)


def test_key_frames_are_decoded_without_their_neighbours(tmp_path):
    path = _film(tmp_path / "k.mp4", 120, gop=10)
    packets = read_packets(path)
    found = frames_at(path, packets.stamps[packets.key][[0, 3, 7, 11]].tolist())
    assert [_number(found[stamp]) for stamp in sorted(found)] == [0, 30, 70, 110]
