import numpy as np
import pytest

from gyrotrack import OutputError
from gyrotrack.plotting._discovery import story_picture


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_picture_is_drawn_and_stays_the_same(story, tmp_path, suffix):
    frame = np.full((48, 64, 3), 200, dtype=np.uint8)
    paths = [tmp_path / f"{i}{suffix}" for i in (1, 2)]
    images = [story_picture(story.rungs, story.diagnosis, p, frame=frame).read_bytes() for p in paths]
    assert images[0] == images[1]
    assert images[0].startswith(b"\x89PNG" if suffix == ".png" else b"<?xml")


@pytest.mark.slow
def test_other_names_and_existing_files_are_refused(story, tmp_path):
    with pytest.raises(OutputError, match="Unknown picture format"):
        story_picture(story.rungs, story.diagnosis, tmp_path / "story.gif")
    (tmp_path / "story.png").write_bytes(b"mine")
    with pytest.raises(OutputError, match="already exists"):
        story_picture(story.rungs, story.diagnosis, tmp_path / "story.png")
