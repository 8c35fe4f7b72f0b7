from pathlib import Path

import numpy as np
import pytest

from gyrotrack.plotting._frames import Film, colour_picture, find_film
from gyrotrack.tracking._extract import extract
from gyrotrack.video._decoder import Reader

CLIP = Path(__file__).parents[3] / "sample_clips" / "rotor_1.mp4"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    import av

    # the first 80 frames of a sample film, copied packet by packet
    path = tmp_path_factory.mktemp("film") / "piece.mp4"
    with av.open(str(CLIP)) as source, av.open(str(path), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for n, packet in enumerate(source.demux(video=0)):
            if n < 80 and packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    return path, extract(path, capture_fps=1000.0)


@pytest.mark.slow
def test_frames_in_any_order_are_those_of_the_film_in_order(recording):
    path, found = recording
    with Reader(path) as reader:
        expected = [colour_picture(frame) for frame in reader]
    order = np.random.default_rng(3).integers(0, len(expected), 80)
    with Film(path, found) as film:
        for index in [*order, *range(30)]:
            picture = film.picture(int(index), overlay=False)
            assert np.array_equal(picture, expected[index])


@pytest.mark.slow
def test_frames_far_apart_are_exact_though_what_no_later_frame_needs_is_not_decoded(recording):
    import dataclasses

    import av

    with Reader(CLIP) as reader:
        expected, stamps = [], []
        for frame in reader:
            stamps.append(frame.pts)
            if len(stamps) % 61 == 0:
                expected.append((frame.index, colour_picture(frame)))
    with av.open(str(CLIP)) as source:
        base = float(source.streams.video[0].time_base)
    whole = dataclasses.replace(recording[1], pts_time=base * np.array(stamps, float))
    with Film(CLIP, whole) as film:
        for at in np.random.default_rng(5).permutation(len(expected)):
            index, picture = expected[at]
            assert np.array_equal(film.picture(index, overlay=False), picture)
            after = film.picture(index + 1, overlay=False)
            assert after is not None
            assert not np.array_equal(after, picture)


@pytest.mark.slow
def test_frames_that_are_not_there_are_not_shown(recording):
    path, found = recording
    with Film(path, found) as film:
        assert film.picture(-1) is None
        assert film.picture(10**6) is None
        assert film.picture(5) is not None


def test_a_film_is_found_by_its_content(recording, tmp_path):
    path, found = recording
    assert find_film(found, [tmp_path, path.parent]) == path
    (tmp_path / path.name).write_bytes(path.read_bytes()[:-1] + b"x")
    assert find_film(found, [tmp_path]) is None
    assert find_film(found, []) is None


@pytest.mark.parametrize(("held", "back", "decoded"), [(2**26, 12, 1), (2**26, 13, 2), (0, 1, 1), (0, 2, 2)])
def test_steps_back_are_not_decoded_again_within_the_frames_that_are_held(
    recording, monkeypatch, held, back, decoded
):
    monkeypatch.setattr("gyrotrack.plotting._frames._HELD", held)
    path, found = recording
    calls = []
    with Film(path, found) as film:
        decode = film._decode
        film._decode = lambda *place: calls.append(place) or decode(*place)
        for index in (60, 60 - back):
            assert film.picture(index) is not None
    assert len(calls) == decoded
