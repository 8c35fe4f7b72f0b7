"""The film as a file: rates, tags, colours, chroma places, and memory."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from gyrotrack import OutputError
from gyrotrack.synthetic._film import Film, render_clip, to_planes, write_film
from gyrotrack.synthetic._scene import Camera, Light, Motion, Scene, Wobble

Frame = NDArray[np.uint8]
SMALL = Camera(width=128, height=96, scale=1.3, fps=1000.0, container_fps=25.0)
MOTION = Motion.constant(400.0, 60.0)


def plain(count: int, value: int = 90) -> Iterator[Frame]:
    for _ in range(count):
        yield np.full((48, 64, 3), value, dtype=np.uint8)


def test_slow_motion_container(tmp_path: Path) -> None:
    path = tmp_path / "slow.mp4"
    film = Film(tag_capture_fps=True, bframes=2)
    truth = render_clip(path, Scene(), MOTION, SMALL, frames=40, film=film)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        assert stream.average_rate == 25
        assert float(container.metadata["com.android.capture.fps"]) == 1000.0
        times = [frame.pts * stream.time_base for frame in frames]
    assert times == [Fraction(k, 25) for k in range(40)]
    assert truth.clip_time[-1] == pytest.approx(39e-3)


def test_odd_rates_are_exact(tmp_path: Path) -> None:
    for fps in (260.0, 240.0, 29.97):
        path = tmp_path / f"{fps}.mp4"
        write_film(path, plain(5), width=64, height=48, fps=fps)
        with av.open(str(path)) as container:
            times = [float(f.pts * container.streams.video[0].time_base) for f in container.decode(video=0)]
        assert np.allclose(times, np.arange(5) / fps, atol=1e-4 / fps)


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    light, scene = Light(flicker=0.05, shadow=0.3, glint=0.1), Scene(table="wood", wobble=Wobble(0.1))
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        render_clip(tmp_path / name, scene, MOTION, SMALL, light, frames=6, seed=seed)
    a, b, c = ((tmp_path / name).read_bytes() for name in "abc")
    assert a == b
    assert a != c


def test_lossless_film_holds_the_planes(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 256, (48, 60, 3)).astype(np.uint8) for _ in range(3)]
    path = tmp_path / "exact.mp4"
    write_film(path, iter(pictures), width=60, height=48, fps=30.0, film=Film(crf=0))
    with av.open(str(path)) as container:
        for frame, picture in zip(container.decode(video=0), pictures, strict=True):
            assert (frame.colorspace, frame.color_range) == (1, 1)
            for plane, expected in zip(frame.planes, to_planes(picture), strict=True):
                rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
                assert np.array_equal(rows[: expected.shape[0], : expected.shape[1]], expected)


def test_primary_colours_become_the_planes_of_bt709() -> None:
    colours = np.array([[0, 0, 0], [255, 255, 255], [255, 0, 0], [0, 255, 0], [0, 0, 255]], dtype=np.uint8)
    expected = [(16, 128, 128), (235, 128, 128), (63, 102, 240), (173, 42, 26), (32, 240, 118)]
    for colour, planes in zip(colours, expected, strict=True):
        found = tuple(int(p[3, 3]) for p in to_planes(np.broadcast_to(colour, (16, 16, 3)).copy()))
        assert np.abs(np.array(found) - planes).max() <= 1


def test_chroma_is_sited_left() -> None:
    """A ramp in x has at chroma column i the value of luma column 2 i; in y that of line 2 j + 1/2."""
    ramp = np.zeros((64, 64, 3), dtype=np.uint8)
    for axis, place in ((1, 0.0), (0, 0.5)):
        steps = 3 * np.arange(64, dtype=np.uint8)
        ramp[:, :, 2] = steps if axis == 1 else steps[:, None]
        blue = to_planes(ramp)[1].astype(float)
        expected = 128.0 + 3.0 * (2.0 * np.arange(32) + place) * 112.0 / 255.0
        profile = blue.mean(axis=1 - axis)
        assert np.abs(profile[2:-2] - expected[2:-2]).max() < 1.0
        assert abs((profile - expected)[2:-2].mean()) < 0.25  # half a column would be 1.3


def test_frames_are_not_kept(tmp_path: Path) -> None:
    drawn: list[weakref.ref[Frame]] = []
    most = 0

    def watched() -> Iterator[Frame]:
        nonlocal most
        for frame in plain(120):
            drawn.append(weakref.ref(frame))
            most = max(most, sum(known() is not None for known in drawn))
            yield frame

    write_film(tmp_path / "long.mp4", watched(), width=64, height=48, fps=30.0)
    assert most <= 3


def test_a_broken_film_leaves_nothing(tmp_path: Path) -> None:
    def failing() -> Iterator[Frame]:
        yield from plain(3)
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError):
        write_film(tmp_path / "x.mp4", failing(), width=64, height=48, fps=30.0)
    assert list(tmp_path.iterdir()) == []


def test_existing_films_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "x.mp4"
    path.write_bytes(b"precious")
    with pytest.raises(OutputError, match="already exists"):
        write_film(path, plain(2), width=64, height=48, fps=30.0)
    assert path.read_bytes() == b"precious"
    assert write_film(path, plain(2), width=64, height=48, fps=30.0, force=True) == 2


def test_a_missing_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not exist"):
        write_film(tmp_path / "none" / "x.mp4", plain(2), width=64, height=48, fps=30.0)


def test_progress_and_the_clock_of_the_truth(tmp_path: Path) -> None:
    seen: list[tuple[int, int | None]] = []
    camera = replace(SMALL, start=1.7, rate=1.001, sense=1)
    truth = render_clip(
        tmp_path / "a.mp4",
        Scene(),
        MOTION,
        camera,
        frames=4,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert seen == list(zip(range(1, 5), itertools.repeat(4), strict=False))
    assert (truth.clock_offset, truth.clock_rate, truth.sense) == (1.7, 1.001, 1)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]
