import colorsys

import pytest

from gyrotrack import ProfileError
from gyrotrack.apps.workbench._films import profile_text
from gyrotrack.tracking._profile import colour_name, load


@pytest.mark.parametrize(
    ("hue", "name"),
    [
        (0, "red"),
        (30, "orange"),
        (60, "yellow"),
        (120, "green"),
        (180, "cyan"),
        (240, "blue"),
        (300, "magenta"),
    ],
)
@pytest.mark.parametrize("value", [0.4, 0.7, 1.0])
def test_pure_hues_have_their_names_at_any_brightness(hue, name, value):
    assert colour_name(*(255 * c for c in colorsys.hsv_to_rgb(hue / 360, 0.9, value))) == name


def test_grey_has_no_hue():
    assert colour_name(230, 228, 225) == "white"
    assert colour_name(40, 42, 41) == ""


def test_picks_become_a_profile_that_loads(tmp_path):
    markers = [
        {"name": "red", "colour": "red", "body": "casing"},
        {"name": "tape", "colour": "green", "body": "rotor"},
    ]
    text = profile_text({"name": "mine", "marker": markers, "capture_fps": 1, "sense": "evil"})
    (tmp_path / "p.toml").write_text(text)
    assert [m.name for m in load(tmp_path / "p.toml").marker] == ["red", "tape"]
    for bad in (
        {},
        [],
        "x",
        {"marker": []},
        {"marker": [{"name": '"\n[[x]]', "colour": "red", "body": "rotor"}]},
    ):
        with pytest.raises(ProfileError):
            profile_text(bad)
