from pathlib import Path

import numpy as np
import pytest

from gyrotrack.pipeline import extract
from gyrotrack.pipeline.drawing import colour_picture
from gyrotrack.pipeline.film import Film, find_film
from gyrotrack.video import Reader

CLIP = Path(__file__).parents[3] / "sample_clips" / "rotor_1.mp4"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    import av

    # the first 120 frames of a sample film, copied packet by packet
    path = tmp_path_factory.mktemp("film") / "piece.mp4"
    with av.open(str(CLIP)) as source, av.open(str(path), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for n, packet in enumerate(source.demux(video=0)):
            if n < 120 and packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    return path, extract(path, capture_fps=1000.0)


def test_frames_in_any_order_are_those_of_the_film_in_order(recording):
    path, found = recording
    with Reader(path) as reader:
        expected = [colour_picture(frame) for frame in reader]
    order = np.random.default_rng(3).integers(0, len(expected), 80)
    with Film(path, found) as film:
        for index in [*order, *range(30)]:
            picture = film.picture(int(index), overlay=False)
            assert np.array_equal(picture, expected[index])


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
