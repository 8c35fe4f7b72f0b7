"""A film that is to be shown turned is tracked as it is shown, and keeps both counts of its frames."""

import av
import numpy as np
import pytest

from gyrotrack.tracking._extract import extract


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(av.video.stream.VideoStream, "set_display_rotation"),
    reason="needs PyAV 17.1 to write a rotation",
)
@pytest.mark.parametrize("quarter", [90, 180])
def test_a_turned_film_turns_the_angles(casing_clip, tmp_path, quarter):
    path = tmp_path / "turned.mp4"
    with av.open(str(casing_clip[0])) as film, av.open(str(path), "w") as copy:
        source = film.streams.video[0]
        out = copy.add_stream_from_template(source)
        out.set_display_rotation(quarter)
        for packet in film.demux(source):
            if packet.size:
                packet.stream = out
                copy.mux(packet)
    plain, turned = extract(casing_clip[0], body="casing"), extract(path, body="casing")
    size = (plain.width, plain.height)
    assert (turned.width, turned.height) == (size if quarter == 180 else size[::-1])
    step = np.angle(np.exp(1j * (turned.markers["red"].angle_fine - plain.markers["red"].angle_fine)))
    assert np.nanmedian(np.abs(np.abs(step) - np.deg2rad(quarter))) < 2e-3  # counter-clockwise as shown
    assert (turned.frames_declared, turned.frames_decoded) == (100, 100)
