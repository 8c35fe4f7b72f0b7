"""Films as cameras and copies leave them: containers, gaps, cut tails, damage; each frame carries its number."""

import math
from types import SimpleNamespace

import av
import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.video._container import probe, read_packets
from gyrotrack.video._decoder import Part, Reader, film_warnings, frames_at
from gyrotrack.video._time_base import capture_rate, frame_numbers, gap_warnings

BITS = 9


def picture(k):
    """Return a frame whose number stands in it as bars that survive compression."""
    image = np.full((96, 160, 3), 90, dtype=np.uint8)
    for bit in range(BITS):
        image[40:60, 16 * bit + 8 : 16 * bit + 20] = 255 if k >> bit & 1 else 0
    return image


def number(frame):
    return sum(1 << bit for bit in range(BITS) if frame.y[50, 16 * bit + 14] > 128)


def film(
    path, keep=range(150), rate=260, codec="libx264", fmt="yuv420p", metadata=None, movflags=None, gop=25
):
    options = {k: v for k, v in (("movflags", movflags),) if v}
    with av.open(str(path), "w", options=options) as container:
        container.metadata.update(metadata or {})
        stream = container.add_stream(codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt = 160, 96, fmt
        if codec == "libx264":
            stream.options = {"g": str(gop), "bf": "2", "crf": "12", "sc_threshold": "0"}
        for k in keep:
            frame = av.VideoFrame.from_ndarray(picture(k), format="rgb24")
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def read(path, threads=1):
    with Reader(path, threads) as reader:
        return [number(frame) for frame in reader], reader


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", ["a.mp4", "a.mov", "a.mkv", "a.avi"])
def test_every_container_gives_every_frame_at_its_time(tmp_path, name, threads):
    numbers, reader = read(film(tmp_path / name), threads)
    assert numbers == list(range(150))
    stamps = reader.pts_seconds()
    np.testing.assert_array_equal(frame_numbers(stamps), np.arange(150))
    if name == "a.avi":  # which says when a frame is decoded, not when it is shown
        assert any("do not increase" in text for text in reader.warnings)
    else:
        assert reader.warnings == ()
        step = 1e-3 if name == "a.mkv" else 1e-5
        np.testing.assert_allclose(stamps - stamps[0], np.arange(150) / 260, atol=step)


@pytest.mark.parametrize(
    ("codec", "fmt"), [("libvpx-vp9", "yuv420p"), ("libx264", "yuv422p10le"), ("ffv1", "gray16le")]
)
def test_other_codecs_and_depths(tmp_path, codec, fmt):
    numbers, reader = read(film(tmp_path / "a.mkv", range(20), codec=codec, fmt=fmt))
    assert numbers == list(range(20))
    assert reader.warnings == ()


def test_a_variable_rate_keeps_the_cameras_grid(tmp_path):
    rng = np.random.default_rng(1)
    keep = np.sort(np.concatenate([[0, 1, 2, 3], 4 + rng.choice(295, 230, replace=False)]))
    numbers, reader = read(film(tmp_path / "a.mp4", keep.tolist()))
    assert numbers == keep.tolist()
    np.testing.assert_array_equal(frame_numbers(reader.pts_seconds()), keep - keep[0])
    assert reader.warnings == ()
    (warning,) = gap_warnings(frame_numbers(reader.pts_seconds()))
    missing = keep[-1] + 1 - len(keep)
    assert f"{missing} missing frames" in warning


def test_slow_motion_is_timed_by_the_cameras_tag_and_never_by_the_container(tmp_path):
    tag = {"com.android.capture.fps": "1000"}
    tagged = probe(film(tmp_path / "t.mp4", range(30), 25, metadata=tag, movflags="use_metadata_tags"))
    rate = capture_rate(tagged)
    assert (rate.fps, rate.source) == (1000.0, "tag of the camera")
    assert any("25 fps" in text for text in rate.warnings)
    with pytest.raises(VideoError, match="does not state at what rate"):
        capture_rate(probe(film(tmp_path / "p.mp4", range(30), 25)))
    assert capture_rate(probe(film(tmp_path / "f.mp4", range(30), 260))).source == "container"


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_copy_that_stopped_early_gives_its_frames_and_reports_it(tmp_path, share):
    path = film(tmp_path / "a.mp4", movflags="faststart")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    numbers, reader = read(path)
    assert reader.info.frames_declared == 150
    assert reader.decoded == len(numbers) < 150
    assert numbers == list(range(len(numbers)))
    assert any(f"declares 150 frames and {len(numbers)}" in text for text in reader.warnings)


def test_a_copy_without_its_index_is_refused(tmp_path):
    path = film(tmp_path / "a.mp4")
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.rfind(b"moov") - 4])
    with pytest.raises(VideoError, match="not a film") as caught:
        probe(path)
    assert "index" in caught.value.hint


def test_damage_in_the_middle_costs_no_frame_before_it_and_none_of_the_later_groups(tmp_path):
    path = film(tmp_path / "a.mp4")
    with av.open(str(path)) as container:
        spots = [(p.pos, p.size, p.pts, p.is_keyframe) for p in container.demux(video=0) if p.size]
    base = min(pts for _, _, pts, _ in spots)
    tick = sorted(pts for _, _, pts, _ in spots)[1] - base
    position, size = next((pos, size) for pos, size, pts, _ in spots if (pts - base) // tick == 60)
    data = bytearray(path.read_bytes())
    data[position : position + size] = b"\xa5" * size
    path.write_bytes(bytes(data))
    numbers, reader = read(path)
    assert numbers[:50] == list(range(50))
    assert numbers[-75:] == list(range(75, 150))  # the group after the damaged one, and all that follow
    assert reader.warnings != () or len(numbers) == 150


@pytest.mark.parametrize(
    ("name", "threads"),
    [
        *((name, 1) for name in ("a.mp4", "a.mkv", "a.avi")), ("a.mp4", 2),
        *(pytest.param(name, 2, marks=pytest.mark.slow) for name in ("a.mkv", "a.avi")),
    ],
)  # fmt: skip
def test_parts_are_read_from_their_key_frames(tmp_path, name, threads):
    path = film(tmp_path / name)
    packets = read_packets(path)
    assert packets.exact == (name != "a.avi")
    if not packets.exact:
        return
    keys = np.flatnonzero(packets.key)[1:]
    assert len(keys) > 2
    for key in keys:
        stop = int(packets.stamps[key + 7]) if key + 7 < 150 else None
        with Reader(path, threads, Part(int(key), int(packets.stamps[key]), stop)) as reader:
            frames = list(reader)
        assert [number(frame) for frame in frames] == list(range(key, key + 7 if stop else 150))
        assert frames[0].index == key
    with Reader(path, threads, Part(0, None, int(packets.stamps[31]))) as reader:
        assert [number(frame) for frame in reader] == list(range(31))


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
def test_frames_are_picked_by_their_stamps(tmp_path, name):
    path = film(tmp_path / name)
    stamps = read_packets(path).stamps
    wanted = [0, 24, 25, 74, 76, 149]
    found = frames_at(path, [int(stamps[k]) for k in wanted])
    assert [number(found[int(stamps[k])]) for k in wanted] == wanted
    assert frames_at(path, [-12345]) == {}


@pytest.mark.parametrize("share", [0.4, 0.9])
def test_a_tail_that_is_missing_is_reported_though_no_frames_are_counted(tmp_path, share):
    """Matroska counts no frames; it says how long the film is."""
    path = film(tmp_path / "a.mkv")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    numbers, reader = read(path)
    assert len(numbers) < 150
    assert any("its last frame ends at" in text for text in reader.warnings)


def test_an_unknown_codec_is_reported(tmp_path):
    path = film(tmp_path / "a.mkv")
    path.write_bytes(path.read_bytes().replace(b"V_MPEG4/ISO/AVC", b"V_MPEG9/ISO/AVC"))
    with pytest.raises(VideoError, match="no decoder for the codec"):
        probe(path)


class TestWarnings:
    """Ten frames that are shown for a period each; the last one ends at ten periods."""

    @staticmethod
    def warnings(declared=math.nan, *, frames=10, period=1 / 30, bad=0, corrupt=0, missing=()):
        seconds = np.arange(10) * period
        seconds[list(missing)] = np.nan
        info = SimpleNamespace(frames_declared=frames, duration_declared=declared)
        return film_warnings(info, seconds, bad, corrupt)

    @pytest.mark.parametrize(("frames", "cut"), [(0, False), (10, False), (11, True)])
    def test_of_a_film_that_declares_more_frames(self, frames, cut):
        assert any("frames and 10 could be" in text for text in self.warnings(frames=frames)) is cut

    @pytest.mark.parametrize(
        ("beyond", "period", "cut"),
        [
            (0.45 / 30, 1 / 30, False),  # half a period is not a frame
            (0.55 / 30, 1 / 30, True),
            (1.9e-3, 1e-3, False),  # the duration is rounded to milliseconds
            (2.1e-3, 1e-3, True),
            (-0.2, 1 / 30, False),
        ],
    )
    @pytest.mark.parametrize("missing", [(), (4,)])
    def test_of_a_film_that_declares_a_longer_duration(self, beyond, period, cut, missing):
        found = self.warnings(10 * period + beyond, period=period, missing=missing)
        expected = f"declares {10 * period + beyond:.3f} s and its last frame ends at {10 * period:.3f} s"
        assert any(expected in text for text in found) is cut

    def test_of_a_film_without_timestamps(self):
        assert any("ends at 0.000 s" in text for text in self.warnings(0.003, missing=range(10)))
        assert not any("ends at" in text for text in self.warnings(0.001, missing=range(10)))

    def test_of_damage(self):
        assert self.warnings() == ()
        assert self.warnings(bad=3) == ("3 damaged packets were skipped.",)
        assert self.warnings(corrupt=2) == ("The decoder marks 2 frames as damaged.",)
