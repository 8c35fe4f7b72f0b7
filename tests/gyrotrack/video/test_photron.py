"""Films of Photron cameras: a header beside raw frames."""

import re
import tracemalloc

import cv2
import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.apps.cli._app import run
from gyrotrack.video._container import file_sha256, is_film, probe, read_packets
from gyrotrack.video._decoder import Part, Reader, frames_at
from gyrotrack.video._photron import grey_of, without_mosaic
from gyrotrack.video._time_base import capture_rate

COUNT, WIDTH, HEIGHT = 12, 64, 48


def pictures(depth):
    """A disc that moves by 3 px from frame to frame, in values of `depth` bits."""
    found = np.full((COUNT, HEIGHT, WIDTH), 40, np.uint16)
    for k, picture in enumerate(found):
        cv2.circle(picture, (12 + 3 * k, 24), 6, 220, -1)
    return found << (depth - 8)


def packed(values, bits):
    """Pixels of `bits` bits one after the other, the most significant bit first."""
    text = "".join(f"{int(v):0{bits}b}" for v in values.ravel())
    return bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))


def write(folder, *, bits=8, depth=None, side="Lower", colour="Mono", frames=None, **changed):
    depth = depth or bits
    if frames is None:
        values = pictures(depth) << (bits - depth if side == "Higher" else 0)
        frames = values.astype("<u2").tobytes() if bits == 16 else packed(values, bits)
    entries = {
        "Date": "2024/5/17",
        "Record Rate(fps)": "6400",
        "Shutter Speed(s)": "1/20000",
        "Total Frame": COUNT,
        "Image Width": WIDTH,
        "Image Height": HEIGHT,
        "Color Type": colour,
        "Color Bit": bits,
        "File Format": "MRaw",
        "EffectiveBit Depth": depth,
        "EffectiveBit Side": side,
    }
    entries |= {key.replace("_", " "): value for key, value in changed.items()}
    text = "\r\n".join(f"{key} : {value}" for key, value in entries.items() if value is not None)
    (folder / "film.mraw").write_bytes(frames)
    (folder / "film.cih").write_bytes(f"#Camera Information Header\r\n{text}\r\nEND\r\n".encode())
    return folder / "film.cih"


def places(path, **how):
    """Column of the centre of the disc in each frame."""
    with Reader(path, **how) as reader:
        return np.array([np.average(np.arange(WIDTH), weights=(f.y > 130).sum(axis=0)) for f in reader])


@pytest.mark.parametrize(
    "pixels",
    [
        {"bits": 8},
        {"bits": 10},
        {"bits": 12},
        {"bits": 12, "depth": 10},
        {"bits": 16},
        {"bits": 16, "depth": 12},
        {"bits": 16, "depth": 12, "side": "Higher"},
        {"bits": 8, "colour": "Bayer"},
    ],
)
def test_pixels(tmp_path, pixels):
    path = write(tmp_path, **pixels)
    assert is_film(path)
    np.testing.assert_allclose(places(path, threads=2), 12 + 3 * np.arange(COUNT), atol=0.2)
    some = read_packets(path).stamps[:3].tolist()
    assert [frame.y.shape for frame in frames_at(path, some).values()] == 3 * [(HEIGHT, WIDTH)]
    np.testing.assert_allclose(places(path, part=Part(5, 5, 9)), 27 + 3 * np.arange(4), atol=0.2)


def test_bits_of_a_pixel():
    values = np.array([0, 1, 2047, 4095], np.uint16)
    raw = np.frombuffer(packed(values, 12), np.uint8)
    np.testing.assert_array_equal(grey_of(raw, 12, 0), [0, 0, 127, 255])
    np.testing.assert_array_equal(grey_of(raw, 12, 4), [0, 1, 255, 255])
    np.testing.assert_array_equal(grey_of(values.view(np.uint8), 16, 4), [0, 0, 127, 255])


@pytest.mark.parametrize("start", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_the_mosaic_of_an_even_surface_becomes_even(start):
    mosaic = np.roll(np.tile(np.array([[200, 100], [100, 40]], np.uint8), (4, 5)), start, (0, 1))
    assert set(without_mosaic(mosaic).ravel()) == {110}


def test_the_capture_rate_and_the_number_of_frames_are_those_of_the_header(tmp_path):
    info = probe(write(tmp_path))
    assert (info.width, info.height, info.frames_declared) == (WIDTH, HEIGHT, COUNT)
    rate = capture_rate(info)
    assert (rate.fps, rate.warnings) == (6400.0, ())
    assert capture_rate(probe(write(tmp_path, **{"Record_Rate(fps)": "50.5"}))).fps == 50.5


def test_the_digest_is_that_of_both_files(tmp_path):
    path = write(tmp_path)
    before = file_sha256(path)
    frames = bytearray(path.with_suffix(".mraw").read_bytes())
    frames[-1] ^= 1
    path.with_suffix(".mraw").write_bytes(frames)
    assert file_sha256(path) != before


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"frames": bytes(COUNT * WIDTH * HEIGHT - 1)},
            "film.mraw has 36863 bytes, but 12 frames of 64x48 px",
        ),
        (
            {"frames": bytes(COUNT * WIDTH * HEIGHT + 1)},
            "film.mraw has 36865 bytes, but 12 frames of 64x48 px",
        ),
        ({"Total_Frame": 10**12}, "but 1000000000000 frames"),
        ({"Total_Frame": 0}, "'Total Frame' is '0', not a whole number"),
        ({"Image_Width": "9" * 5000}, "'Image Width' is '9999"),
        ({"Image_Width": None}, "no entry 'Image Width'"),
        ({"Record_Rate(fps)": "fast"}, "'Record Rate(fps)' is 'fast'"),
        ({"Record_Rate(fps)": "nan"}, "'Record Rate(fps)' is 'nan'"),
        ({"Color_Bit": 24, "EffectiveBit_Depth": 8}, "mono pixels of 24 bits"),
        ({"colour": "Color"}, "color pixels of 8 bits"),
        ({"Comment": "x" * 2**16}, "more than 64 kB"),
        ({"frames": bytes(16 * 48), "Image_Width": 16, "Total_Frame": 1}, "16x48 px, too small"),
    ],
)
def test_headers_that_are_refused(tmp_path, changed, message):
    with pytest.raises(VideoError, match=re.escape(message)):
        probe(write(tmp_path, **changed))


def test_missing_frames(tmp_path):
    path = write(tmp_path)
    path.with_suffix(".mraw").rename(tmp_path / "film.MRAW")
    assert probe(path).frames_declared == COUNT
    (tmp_path / "film.MRAW").unlink()
    with pytest.raises(VideoError, match=r"there is no file film\.mraw beside"):
        probe(path)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_film(tmp_path):
    one = pictures(8).astype(np.uint8).tobytes()
    path = write(tmp_path, frames=60 * one, Total_Frame=60 * COUNT)
    tracemalloc.start()
    try:
        with Reader(path) as reader:
            assert sum(1 for _ in reader) == 60 * COUNT
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 300_000 < path.with_suffix(".mraw").stat().st_size


@pytest.mark.slow
def test_spindown_measures_a_film_at_the_rate_of_its_header(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    side, count, fps, omega, alpha = 96, 70, 1000.0, 40.0, -20.0
    t = np.arange(count) / fps
    angle = omega * t + 0.5 * alpha * t**2
    rng = np.random.default_rng(1)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (side, side)).astype(np.float32), (0, 0), 3)
    texture = cv2.normalize(texture, None, 20, 235, cv2.NORM_MINMAX)
    outside = np.hypot(*(np.indices((side, side)) - 47.5)) > 40
    film = []
    for a in angle:
        turn = cv2.getRotationMatrix2D((47.5, 47.5), -np.degrees(a), 1.0)
        picture = cv2.warpAffine(texture, turn, (side, side), flags=cv2.INTER_CUBIC)
        picture[outside] = 128
        film.append(np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint16) << 4)
    rate = {"Record_Rate(fps)": fps, "Image_Width": side, "Image_Height": side, "Total_Frame": count}
    frames = np.array(film, dtype="<u2").tobytes()
    path = write(tmp_path, bits=16, depth=12, frames=frames, **rate)
    run(["spindown", str(path), "--hub", "47.5,47.5"])
    said = capsys.readouterr().out
    mean = re.search(r"mean +(\S+) \+- (\S+) rad/s", said)
    assert mean is not None, said
    assert abs(float(mean[1]) - (omega + alpha * t[-1] / 2)) < max(5 * float(mean[2]), 0.02)
