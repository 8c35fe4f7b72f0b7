"""Decisions of the readers of films: packets, parts, rates, orientations, repeats and raw formats."""

import struct
from fractions import Fraction
from types import SimpleNamespace

import av
import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.video import _container as container
from gyrotrack.video import _decoder as decoder
from gyrotrack.video import _tiff as tiff
from gyrotrack.video._container import Frame, Orientation, Packets
from gyrotrack.video._fields import field, first_field
from gyrotrack.video._frame_stream import FrameStream
from gyrotrack.video._photron import grey_of, read_header, without_mosaic

DAMAGED = av.error.InvalidDataError(1094995529, "damaged")


class Opened:
    """A film of given packets, to be opened repeatedly."""

    def __init__(self, packets, name="mov,mp4,m4a", **stream):
        self.packets, self.seeks = packets, []
        codec = SimpleNamespace(decode=lambda _: [], flush_buffers=lambda: None, skip_frame="")
        self.stream = SimpleNamespace(codec_context=codec, sample_aspect_ratio=1, **stream)
        self.format = SimpleNamespace(name=name)
        self.at = 0

    def __call__(self, *_):
        return self

    def __enter__(self):
        self.at = 0
        return self, self.stream

    def __exit__(self, *_):
        return None

    def demux(self, _):
        yield from self.packets[self.at :]
        yield SimpleNamespace(size=0, pts=None, is_keyframe=False, decode=list)

    def seek(self, stamp, *, stream, backward):
        assert stream is self.stream
        assert backward
        keys = [n for n, p in enumerate(self.packets) if p.is_keyframe and p.pts <= stamp]
        self.at = keys[-1] if keys else 0


def _raw(pts, width=64, height=48, **side):
    frame = av.VideoFrame.from_ndarray(np.full((height * 3 // 2, width), 90, np.uint8), format="yuv420p")
    frame.pts = pts
    return frame


def _packet(pts, *, key=False, size=100, frames=None, fails=False):
    def decode():
        if fails:
            raise DAMAGED
        return [_raw(pts)] if frames is None else frames

    return SimpleNamespace(pts=pts, is_keyframe=key, size=size, decode=decode)


def _film(count=24, every=6):
    return [_packet(10 * k, key=k % every == 0) for k in range(count)]


def test_packets_end_at_the_end_or_at_the_first_damage():
    def damaged():
        yield _packet(1)
        raise DAMAGED

    assert [p.pts for p in container.packets_of(damaged())] == [1]
    assert [p.pts for p in container.packets_of(iter([_packet(1), _packet(2, size=0), _packet(3)]))] == [1]


def test_damaged_packets_are_skipped_and_counted():
    packets = iter([_packet(1), _packet(2, fails=True), _packet(3), _packet(4, fails=True)])
    found = list(container.decode_past_damage(packets, 5))
    assert [(f and f.pts, bad) for f, bad in found] == [(1, 0), (3, 1), (None, 2)]


@pytest.mark.parametrize(("good", "most", "left"), [(0, 3, 4), (2, 3, 8), (2, 0, 5)])
def test_decoding_stops_after_too_many_damaged_packets(good, most, left):
    """`most` and twice the number of decoded frames may be damaged; the next one ends the film."""
    packets = iter([*[_packet(k) for k in range(good)], *[_packet(9, fails=True)] * 20])
    *_, (end, bad) = container.decode_past_damage(packets, most)
    assert end is None
    assert bad == left


def test_packets_are_sorted_by_their_timestamps(monkeypatch):
    packets = [_packet(0, key=True, size=9), _packet(30, size=3), _packet(20, size=4), _packet(None, size=5)]
    monkeypatch.setattr(container, "opened", Opened(packets))
    found = container.read_packets("film")
    assert (found.stamps.tolist(), found.size.tolist(), found.key.tolist()) == (
        [0, 20, 30], [9, 4, 3], [True, False, False],
    )  # fmt: skip
    assert (found.complete, found.exact) == (False, True)
    monkeypatch.setattr(container, "opened", Opened(packets[:2], "avi"))
    found = container.read_packets("film")
    assert (found.complete, found.exact) == (True, False)
    monkeypatch.setattr(container, "opened", Opened([], "matroska,webm"))
    assert len(container.read_packets("film").stamps) == 0


@pytest.fixture
def opens(monkeypatch):
    """Let a film consist of given packets."""

    def film(packets):
        for module in (container, decoder):
            monkeypatch.setattr(module, "opened", Opened(packets))
        monkeypatch.setattr(decoder, "probe", lambda _: SimpleNamespace(path="film", frames_declared=24))

    return film


def test_damaged_frames_are_omitted(opens):
    film = _film()
    film[6] = _packet(60, key=True, fails=True)
    opens(film)
    assert set(decoder.frames_at("film", {0, 60, 120, 180})) == {0, 120, 180}
    opens([_packet(0)])
    assert decoder.frames_at("film", {0}) == {}


@pytest.mark.parametrize("wanted", [{0}, {50}, {10, 130, 230}, {60, 65}, {500, 230}, {-1}])
def test_frames_are_decoded_from_their_key_frames(wanted, opens):
    film = _film()
    decoded = []
    for packet in film:
        packet.decode = lambda p=packet: decoded.append(p.pts) or [_raw(p.pts)]
    opens(film)
    found = decoder.frames_at("film", wanted)
    assert set(found) == wanted & {p.pts for p in film}
    assert all(frame.pts == stamp for stamp, frame in found.items())
    # of each run, the frames from its key frame to the frame after the last wanted one
    runs = {}
    for stamp in wanted - {-1}:
        start = min(stamp // 60 * 60, 180)
        runs[start] = max(runs.get(start, 0), stamp)
    assert decoded == [
        stamp
        for start, last in sorted(runs.items())
        for stamp in range(start, min(last + 20, 240), 10)
        if stamp - 10 <= last
    ]


@pytest.mark.parametrize(
    ("seek", "stamp", "first"),
    [(True, 60, 60), (False, 60, 60), (True, 65, None), (False, 65, None), (True, None, 0)],
)
def test_a_part_begins_at_its_key_frame(seek, stamp, first):
    film = Opened(_film())
    found = decoder._from_key(film, film.stream, stamp, seek=seek)
    if first is None:
        assert found is None
    else:
        stamps = [p.pts for p in found if p.size]
        assert stamps == list(range(first, 240, 10))


def test_a_film_that_cannot_seek_is_read_from_its_start():
    film = Opened(_film())

    def fail(*_, **__):
        raise DAMAGED

    film.seek = fail
    assert decoder._from_key(film, film.stream, 60, seek=True) is None
    # a container may seek to an earlier key frame
    film.seek = lambda *_, **__: setattr(film, "at", 0)
    assert [p.pts for p in decoder._from_key(film, film.stream, 60, seek=True) if p.size][:2] == [60, 70]
    # a container that seeks to a later key frame does not have the wanted one
    film.seek = lambda *_, **__: setattr(film, "at", 12)
    assert decoder._from_key(film, film.stream, 60, seek=True) is None


def _read(film, monkeypatch, **part):
    monkeypatch.setattr(decoder, "opened", film)
    info = SimpleNamespace(path="film", frames_declared=0, width=64, height=48, time_base=Fraction(1, 100))
    with decoder.Reader("film", part=decoder.Part(**part), info=info) as reader:
        return reader, list(reader)


def test_a_part_of_a_film_is_read_between_two_key_frames(monkeypatch):
    reader, found = _read(Opened(_film()), monkeypatch, first=6, start=60, stop=120)
    assert [f.pts for f in found] == list(range(60, 120, 10))
    assert [f.index for f in found] == list(range(6, 12))
    assert reader.decoded == 6
    np.testing.assert_array_equal(reader.stamps, np.arange(60, 120, 10))
    np.testing.assert_allclose(reader.pts_seconds(), np.arange(0.6, 1.2, 0.1))


def test_frames_before_the_key_frame_or_of_another_size_are_not_read(monkeypatch):
    film = _film(12)
    film[6] = _packet(60, key=True, frames=[_raw(50), _raw(None), _raw(60)])
    film[8] = _packet(80, frames=[_raw(80, 96)])
    film[9] = _packet(90, fails=True)
    reader, found = _read(Opened(film), monkeypatch, start=60)
    assert [f.pts for f in found] == [60, 70, 100, 110]
    assert reader.bad_packets == 2
    reader, found = _read(Opened([_packet(0, key=True, frames=[_raw(None), _raw(10)])]), monkeypatch)
    assert np.isnan(reader.pts_seconds()).tolist() == [True, False]
    assert reader.stamps[0] == -(2**63)


@pytest.mark.parametrize(
    ("matrix", "expected"),
    [
        ((1, 0, 0, 1), [[1, 2, 3], [4, 5, 6]]),
        ((0, 1, -1, 0), [[4, 1], [5, 2], [6, 3]]),
        ((-1, 0, 0, -1), [[6, 5, 4], [3, 2, 1]]),
        ((0, -1, 1, 0), [[3, 6], [2, 5], [1, 4]]),
        ((-1, 0, 0, 1), [[3, 2, 1], [6, 5, 4]]),
        ((1, 0, 0, -1), [[4, 5, 6], [1, 2, 3]]),
        ((0, 1, 1, 0), [[1, 4], [2, 5], [3, 6]]),
        ((0, -1, -1, 0), [[6, 3], [5, 2], [4, 1]]),
        ((1, 1, 0, 1), [[1, 2, 3], [4, 5, 6]]),  # a shear is ignored
    ],
)
def test_the_display_matrix_maps_coded_to_shown_pixels(matrix, expected):
    """(x, y) is shown at (a x + c y, b x + d y), y downwards; the corner of the picture stays the corner."""
    a, b, c, d = (round(65536 * v) for v in matrix)
    data = struct.pack("<9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    stream = SimpleNamespace(sample_aspect_ratio=1, codec_context=SimpleNamespace(sample_aspect_ratio=1))
    found = container.orientation_of(SimpleNamespace(side_data={"DISPLAYMATRIX": data}), stream)
    shown = found.apply(np.array([[1, 2, 3], [4, 5, 6]], np.uint8))
    assert shown.tolist() == expected
    assert shown.flags.c_contiguous


@pytest.mark.parametrize(("aspect", "size"), [(1.0, (40, 30)), (1.5, (60, 30)), (0.5, (40, 60))])
def test_no_side_of_a_picture_with_square_pixels_becomes_smaller(aspect, size):
    assert Orientation(aspect=aspect).size(40, 30) == size


@pytest.mark.parametrize(
    ("average", "nominal", "rate"),
    [
        (50.0, 50.0, 50.0),
        (45.0, 50.0, 50.0),
        (41.0, 50.0, 41.0),
        (50.0, 45.0, 50.0),
        (None, 50.0, 7.0),
        (50.0, None, 50.0),
    ],
)
def test_missing_frames_explain_a_nominal_rate_up_to_a_fifth_higher(average, nominal, rate):
    fraction = lambda v: v and Fraction(v)  # noqa: E731
    stream = SimpleNamespace(
        average_rate=fraction(average), base_rate=fraction(nominal), guessed_rate=Fraction(7)
    )
    assert float(container._nominal_rate(stream)) == rate


@pytest.mark.parametrize(
    ("frames", "duration", "streams", "found"),
    [(0, 2_500_000, 1, 2.5), (9, 2_500_000, 1, None), (0, 2_500_000, 2, None), (0, 0, 1, None)],
)
def test_a_duration_counts_only_without_frames_and_without_sound(frames, duration, streams, found):
    film = SimpleNamespace(duration=duration, streams=[None] * streams)
    value = container._declared_duration(film, SimpleNamespace(frames=frames))
    assert np.isnan(value) if found is None else value == found


@pytest.mark.parametrize(
    ("text", "rate"), [("0.9", None), ("1", 1.0), ("1e6", 1e6), ("1.1e6", None), ("abc", None)]
)
def test_a_tag_states_a_plausible_rate(text, rate):
    assert container._tagged_rate({"capture_fps": text}) == rate
    assert container._tagged_rate({"capture_fps": text, "CAPTURE_FPS": "240"}) == (rate or 240.0)
    assert container._tagged_rate({}) is None


def _box(kind, body, *, long=False):
    size = len(body) + (16 if long else 8)
    return (1 if long else size).to_bytes(4, "big") + kind + (size.to_bytes(8, "big") if long else b"") + body


def test_boxes_of_metadata_are_found_at_the_top_level(tmp_path):
    path = tmp_path / "a.mp4"
    inner = _box(b"meta", b"inside" * 4)
    path.write_bytes(
        _box(b"ftyp", b"x" * 12)
        + _box(b"moov", inner)
        + _box(b"meta", b"first" * 4, long=True)
        + _box(b"meta", b"last" * 4)
    )
    found = container._meta_boxes(path)
    assert [b"first" in f for f in found] == [True, False]
    assert found[1] == _box(b"meta", b"last" * 4)
    # a box of the length 0 extends to the end of the file; one of the length 4 is damaged
    path.write_bytes(_box(b"ftyp", b"x" * 12) + bytes(4) + b"meta" + b"to the end")
    assert len(container._meta_boxes(path)) == 1
    path.write_bytes((4).to_bytes(4, "big") + b"ftyp" + b"x" * 20 + _box(b"meta", b"y" * 20))
    assert container._meta_boxes(path) == []
    path.write_bytes(_box(b"meta", b"y" * 20) * 10)
    assert len(container._meta_boxes(path)) == 8


@pytest.mark.parametrize(("rate", "found"), [("0.5", None), ("239.76", 239.76), ("2000000", None)])
def test_the_rate_of_a_sony_camera_is_in_its_xml(tmp_path, rate, found):
    path = tmp_path / "C0001.mp4"
    path.write_bytes(_box(b"ftyp", b"x" * 12))
    (tmp_path / "C0001M01.xml").write_text(f'<VideoFrame captureFps="{rate}p"/>')
    assert container._sony_rate(path) == found
    assert container._sony_rate(tmp_path) is None


def _folder(tmp_path, names):
    for name in names:
        (tmp_path / name).write_bytes(b"x")
    return container._numbered_pictures(tmp_path)


@pytest.mark.parametrize(
    ("names", "pattern", "first"),
    [
        (["a_007.png", "a_008.png"], "a_%03d.png", "7"),
        (["a_9.png", "a_10.png"], "a_%d.png", "9"),
        (["099.jpg", "100.jpg"], "%03d.jpg", "99"),
        (["5%2_1.tif", "5%2_2.tif", "notes.txt"], "5%%2_%d.tif", "1"),
    ],
)
def test_numbered_pictures_have_a_pattern(tmp_path, names, pattern, first):
    found, options = _folder(tmp_path, names)
    assert found.endswith("/" + pattern)
    assert options == {"start_number": first}


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            ["a_1.png", "a_2.png", "a_4.png", "a_6.png"],
            "2 pictures are missing; the first missing number is 3",
        ),
        (["a_1.png", "b_2.png"], "several series"),
        (["a_1.png", "a_2.jpg"], "several series"),
        (["a_01.png", "a_002.png"], "several series"),
        (["a.png"], "no numbered pictures"),
    ],
)
def test_incomplete_series_of_pictures_are_refused(tmp_path, names, message):
    with pytest.raises(VideoError, match=message):
        _folder(tmp_path, names)


@pytest.mark.parametrize(
    ("width", "height", "message"),
    [
        (32, 32, None),
        (31, 90, "too small"),
        (90, 31, "too small"),
        (8000, 8000, None),
        (8001, 8000, "too large"),
    ],
)
def test_pictures_have_between_32_px_per_side_and_64_million(width, height, message):
    if message is None:
        container._check_sides("film", width, height)
    else:
        with pytest.raises(VideoError, match=message):
            container._check_sides("film", width, height)


def _frame(y, index=0):
    return Frame(index, index, np.asarray(y, np.uint8), None, None)


def test_rows_of_the_middle_are_compared():
    rows = decoder._rows(_frame(np.arange(240)[:, None] * np.ones((1, 9))))
    np.testing.assert_array_equal(rows[:, 0], np.arange(30, 210, 20))
    assert len(decoder._rows(_frame(np.zeros((8, 9))))) == 6
    assert decoder._rows(_frame(np.arange(14)[:, None] * np.ones((1, 9))))[:, 0].tolist() == list(
        range(1, 13)
    )


def test_the_difference_of_rows_ignores_the_brightness():
    one = np.array([[100, 50], [80, 10]], np.uint8)
    assert decoder._difference(np.clip(2 * one, 0, 255).astype(np.uint8), one) == pytest.approx(0.0, abs=1e-4)
    # the sum is 240 of both: the gain is 1
    assert decoder._difference(one, one[::-1].copy()) == pytest.approx(20 + 40 + 20 + 40)
    assert decoder._difference(one, np.zeros((2, 2), np.uint8)) == pytest.approx(240.0)


@pytest.mark.parametrize(
    ("values", "usual"),
    [
        ((1.0, 9.0), 1.0),
        (tuple(map(float, range(10))), 8.0),
        ((5.0, 1.0, 2.0, 3.0, 4.0), 4.0),
        ((3.0, 1.0, 2.0), 2.0),
    ],
)
def test_the_usual_difference_is_a_high_quantile_below_the_largest(values, usual):
    assert decoder._usual(values) == usual


def test_a_frame_repeats_another_below_three_tenths_of_the_usual_difference():
    rng = np.random.default_rng(0)
    base = rng.integers(60, 200, (24, 40))
    step = rng.permuted(np.repeat([10, -10], 480)).reshape(24, 40)
    for share, again in ((0.27, True), (0.36, False)):
        detector = decoder.RepeatDetector(Packets(*[np.zeros(0, np.int64)] * 2, np.zeros(0, bool), True))
        frames = [base + (k % 2) * step for k in range(8)]
        frames.append(frames[-1] - np.rint(share * step))
        assert [detector.same(_frame(f, k)) for k, f in enumerate(frames)] == [False] * 8 + [again]


@pytest.mark.parametrize(
    ("size", "key", "place"),
    [
        ([100] * 30, [False] * 30, []),
        ([100] * 20 + [34] + [100] * 20, [False] * 41, [20]),
        ([100] * 20 + [36] + [100] * 20, [False] * 41, []),
        ([100] * 20 + [34] + [100] * 20, [False] * 20 + [True] + [False] * 20, []),
        ([100] * 15 + [34] + [100] * 15, [False] * 31, [15]),
        ([100 + k for k in range(20)] + [119] + [90 + k for k in range(20)], [True] * 41, [20]),
    ],
)
def test_small_packets_contain_little_information(size, key, place):
    found = decoder._uninformative(Packets(np.arange(len(size)), np.array(size), np.array(key), True))
    assert found.tolist() == place


def test_repeats_are_small_packets_also_where_three_of_four_frames_are_repeated():
    size = np.array([100, 9, 9, 9] * 20)
    found = decoder._uninformative(Packets(np.arange(80), size, np.zeros(80, bool), True))
    inner = found[(found >= 16) & (found < 64)]
    assert inner.tolist() == [k for k in range(16, 64) if k % 4]


def test_runs_begin_after_a_gap():
    assert decoder._starts(np.array([0, 1, 2, 5, 7, 8])).tolist() == [0, 5, 7]
    assert decoder._starts(np.array([3])).tolist() == [3]


@pytest.mark.parametrize(
    ("starts", "regular"),
    [
        ([0, 10, 20, 30], False),
        ([0, 10, 20, 30, 40], True),
        ([0, 11, 21, 31, 41], True),
        ([0, 12, 20, 32, 40], False),
        ([0, 10, 20, 30, 40, 50, 57], True),  # 5 of 6
        ([0, 10, 20, 30, 40, 47], False),  # 4 of 5
    ],
)
def test_runs_are_periodic_within_one_frame(starts, regular):
    assert decoder._regular(np.array(starts)) == regular


@pytest.mark.parametrize("odd", [False, True])
def test_the_lines_of_a_field_are_interpolated_where_they_were(odd):
    plane = np.tile((4 * np.arange(40))[:, None], (1, 9)).astype(np.uint8)
    plane[int(not odd) :: 2] = 255  # the other field
    inner = slice(2, -2)
    np.testing.assert_array_equal(field(plane, odd=odd)[inner, 0], (4 * np.arange(40))[inner])


@pytest.mark.parametrize("first", [0, 1])
def test_the_earlier_field_is_found_from_a_moving_edge(first):
    def lines(place):
        x = np.arange(60)
        return np.tile(np.clip(40 * (place - x) + 128, 0, 255), (40, 1)).astype(np.uint8)

    frames = []
    for k in range(4):
        early, late = lines(10 + 8 * k), lines(14 + 8 * k)
        frame = early.copy()
        frame[1 - first :: 2] = late[1 - first :: 2]
        frames.append(frame)
    assert first_field(frames) == first
    assert first_field(frames[:2]) is None
    assert first_field([lines(10 + 8 * k) for k in range(4)]) is None
    assert first_field([f // 40 for f in frames]) is None  # changes below 8 grey levels


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("finterval=0.004", 250.0),
        ('TimeIncrement="4" TimeIncrementUnit="ms"', 250.0),
        ('TimeIncrement="4"', 0.25),
        ('TimeIncrement="4" TimeIncrementUnit="µs"', 250e3),
        ('TimeIncrement="0.5" TimeIncrementUnit="min"', 1 / 30),
        ('TimeIncrement="4" TimeIncrementUnit="weeks"', None),
        ("finterval=0", None),
        ("finterval=1-2", None),
        ("finterval=9e-9", None),
        ("finterval=1.1e-8", 1 / 1.1e-8),
        ("", None),
    ],
)
def test_the_rate_of_a_stack_is_the_inverse_of_its_interval(text, rate):
    assert tiff._rate(text) == (None if rate is None else pytest.approx(rate))


def test_a_stack_is_scaled_by_its_smallest_and_largest_value():
    frames = object.__new__(tiff.TiffFrames)
    frames._stack = SimpleNamespace(colour=False, frames=3)
    pictures = [
        np.array([[100, 300]], np.uint16),
        np.array([[200, 610]], np.uint16),
        np.array([[110, 120]], np.uint16),
    ]
    frames._file = SimpleNamespace(
        pages=[SimpleNamespace(dtype=np.uint16, asarray=lambda p=p: p) for p in pictures]
    )
    frames._low, frames._high = frames._range()
    assert (frames._low, frames._high) == (100.0, 610.0)
    assert list(frames.frame(0)) == [0, 100]
    assert list(frames.frame(1)) == [50, 255]


class Letters(FrameStream):
    """Frames of four bytes."""

    def __init__(self):
        super().__init__(3, 4)
        self.read_frames = []

    def frame(self, number):
        self.read_frames.append(number)
        return b"abcdefghijkl"[4 * number : 4 * number + 4]

    def close(self):
        pass


def test_frames_are_a_stream_of_bytes():
    stream = Letters()
    assert [stream.read(3) for _ in range(6)] == [b"abc", b"d", b"efg", b"h", b"ijk", b"l"]
    assert stream.read(3) == b""
    assert stream.read_frames == [0, 1, 2]
    assert (stream.seek(5), stream.read(9), stream.tell()) == (5, b"fgh", 8)
    assert (stream.seek(-2, 1), stream.read(1)) == (6, b"g")
    assert (stream.seek(-3, 2), stream.read(9)) == (9, b"jkl")
    assert stream.seek(-5) == 0


@pytest.mark.parametrize(
    ("bits", "first", "values", "grey"),
    [
        (8, 0, [7, 250], [7, 250]),
        (10, 0, [1023, 512, 4, 3], [255, 128, 1, 0]),
        (10, 2, [255, 3, 128, 0], [255, 3, 128, 0]),
        (12, 0, [4095, 16], [255, 1]),
        (12, 4, [255, 17], [255, 17]),
        (16, 0, [0xFF00, 0x0180], [255, 1]),
        (16, 4, [0x0FF0, 0x0018], [255, 1]),
    ],
)
def test_eight_bits_of_a_pixel_are_used(bits, first, values, grey):
    if bits == 16:
        raw = np.array(values, "<u2").view(np.uint8)
    else:
        text = "".join(f"{v:0{bits}b}" for v in values)
        raw = np.array([int(text[k : k + 8], 2) for k in range(0, len(text), 8)], np.uint8)
    assert grey_of(raw, bits, first).tolist() == grey


HEADER = {
    "Image Width": "64", "Image Height": "40", "Total Frame": "3", "Color Bit": "12", "Record Rate(fps)": "5000",
    "EffectiveBit Depth": "12",
}  # fmt: skip


def _header(tmp_path, **change):
    entries = HEADER | {k.replace("_", " "): v for k, v in change.items()}
    path = tmp_path / "a.cih"
    path.write_text("\n".join(f"{k} : {v}" for k, v in entries.items()))
    size = int(entries["Image Width"]) * 40 * 3 * int(entries["Color Bit"]) // 8
    (tmp_path / "a.mraw").write_bytes(bytes(size))
    return read_header(path)


@pytest.mark.parametrize(
    ("bits", "depth", "side", "first"),
    [
        ("12", "12", "Lower", 0),
        ("16", "12", "Lower", 4),
        ("16", "12", "Higher", 0),
        ("16", "5", "Lower", 8),
        ("12", "8", "Lower", 4),
    ],
)
def test_the_header_states_which_bits_are_measured(tmp_path, bits, depth, side, first):
    header = _header(tmp_path, Color_Bit=bits, EffectiveBit_Depth=depth, EffectiveBit_Side=side)
    assert (header.first_bit, header.bits, header.width, header.height, header.frames) == (
        first,
        int(bits),
        64,
        40,
        3,
    )
    assert (header.fps, header.mosaic) == (5000.0, False)


@pytest.mark.parametrize(
    ("rate", "accepted"), [("1", True), ("0.9", False), ("1e8", True), ("1.1e8", False), ("fast", False)]
)
def test_the_header_states_a_plausible_rate(tmp_path, rate, accepted):
    if accepted:
        assert _header(tmp_path, **{"Record Rate(fps)": rate}).fps == float(rate)
    else:
        with pytest.raises(VideoError, match="not a rate"):
            _header(tmp_path, **{"Record Rate(fps)": rate})


@pytest.mark.parametrize(("width", "accepted"), [("32768", True), ("32776", False)])
def test_a_picture_of_a_camera_has_sides_below_32_thousand_pixels(tmp_path, width, accepted):
    if accepted:
        assert _header(tmp_path, Image_Width=width).width == int(width)
    else:
        with pytest.raises(VideoError, match="not a whole number from 1"):
            _header(tmp_path, Image_Width=width)


def test_a_mosaic_becomes_grey_with_the_weights_of_its_neighbours():
    grey = np.zeros((5, 5), np.uint8)
    grey[2, 2] = 160
    expected = np.outer([0, 1, 2, 1, 0], [0, 1, 2, 1, 0]) * 10
    assert without_mosaic(grey).tolist() == expected.tolist()


@pytest.mark.parametrize(("length", "regular"), [(1, True), (2, True)])
def test_runs_of_repeats_that_begin_periodically_are_regular(length, regular):
    rng = np.random.default_rng(0)
    detector = decoder.RepeatDetector(Packets(*[np.zeros(0, np.int64)] * 2, np.zeros(0, bool), True))
    rows = rng.integers(60, 200, (24, 40))
    found = []
    for k in range(60):
        if k % 6 >= length or k < 6:
            rows = np.clip(rows + rng.integers(-20, 20, rows.shape), 30, 230)
        found.append(detector.same(_frame(rows, k)))
        # the fifth run begins in frame 30
        assert detector.regular == (k >= 30) or k > 30
    assert np.flatnonzero(found).tolist() == [k for k in range(6, 60) if k % 6 < length]
    assert detector.regular == regular


def test_runs_of_repeats_without_a_period_are_not_regular():
    rng = np.random.default_rng(0)
    detector = decoder.RepeatDetector(Packets(*[np.zeros(0, np.int64)] * 2, np.zeros(0, bool), True))
    rows, repeats = rng.integers(60, 200, (24, 40)), {8, 11, 19, 22, 35, 41, 44, 57}
    for k in range(60):
        if k not in repeats:
            rows = np.clip(rows + rng.integers(-20, 20, rows.shape), 30, 230)
        assert detector.same(_frame(rows, k)) == (k in repeats)
    assert not detector.regular


@pytest.mark.parametrize(
    ("film", "stream", "camera", "rate"),
    [
        ("240", "120", 960.0, 240.0),
        (None, "120", 960.0, 120.0),
        (None, None, 960.0, 960.0),
        (None, None, None, None),
    ],
)
def test_a_tag_of_the_film_comes_before_that_of_the_stream_and_of_the_camera(
    film, stream, camera, rate, monkeypatch
):
    monkeypatch.setattr(container, "_sony_rate", lambda _: camera)
    tags = [SimpleNamespace(metadata={"capture_fps": text} if text else {}) for text in (film, stream)]
    assert container._stated_rate("film", *tags) == rate
