import tomllib
from pathlib import Path

import pytest

from gyrotrack import Profile, ProfileError
from gyrotrack.tracking._profile import PAPER, load, parse, to_toml

ROOT = Path(__file__).parents[3]


def test_the_default_is_the_papers_gyroscope():
    assert [(m.name, m.body) for m in PAPER.marker] == [
        ("red", "casing"),
        ("blue", "rotor"),
        ("white", "rotor"),
        ("green", "rotor"),
    ]
    assert PAPER.centre == "circle"


def test_the_bicycle_profile_says_one_green_marker_and_the_orbit():
    profile = load(ROOT / "docs" / "bicycle.toml")
    assert [m.colour for m in profile.marker] == ["green"]
    assert profile.centre == "orbit"
    assert profile.capture_fps == 300


def test_a_profile_survives_toml(tmp_path):
    profile = Profile.model_validate(
        {
            "name": 'a "quoted" name',
            "centre": "orbit",
            "capture_fps": 960.0,
            "sense": 1,
            "wander": False,
            "tilt_correction": False,
            "marker": [
                {"name": "one", "colour": "cyan", "body": "rotor", "mount_angle": 0.25},
                {"name": "two", "colour": "white", "body": "rotor"},
            ],
        }
    )
    path = tmp_path / "p.toml"
    path.write_text(to_toml(profile), encoding="utf-8")
    assert load(path) == profile


@pytest.mark.parametrize(
    "given",
    [
        {"circle_colour": "blue"},
        {"circle_hue": 12.5},
        {"hub": (320.5, 239.25)},
        {"capture_fps": 959.5},
        {"sense": -1},
        {"sense": 1},
        {"wander": True},
        {"wander": False},
        {"tilt_correction": False},
        {"centre": "orbit"},
        {"name": "back\\slash"},
    ],
)
def test_each_setting_is_written_and_read(given):
    markers = [
        {"name": "one", "colour": "cyan", "body": "rotor", "hue": 281.5, "mount_angle": -0.25},
        {"name": "two", "colour": "red", "body": "casing"},
    ]
    profile = Profile.model_validate({"marker": markers} | given)
    text = to_toml(profile)
    assert parse(tomllib.loads(text), "text") == profile
    # settings with their default values are not written
    settings = set(tomllib.loads(text)) - {"name", "centre", "marker"}
    assert settings == set(given) - {"name", "centre"}
    assert [m.name for m in profile.of("casing")] == ["two"]
    assert [m.name for m in profile.of("rotor")] == ["one"]


@pytest.mark.parametrize(
    ("colours", "accepted"),
    [
        ((("red", "casing"), ("red", "rotor")), True),
        ((("red", "casing"), ("red", "casing")), False),
        ((("white", "casing"), ("red", "rotor")), False),
        ((("red", "casing"), ("white", "rotor")), False),
        ((("white", "rotor"), ("blue", "rotor")), True),
    ],
)
def test_markers_of_a_body_have_different_colours_and_one_that_is_not_white(colours, accepted):
    markers = [{"name": f"m{k}", "colour": c, "body": b} for k, (c, b) in enumerate(colours)]
    if accepted:
        assert len(parse({"marker": markers}, "text").marker) == 2
    else:
        with pytest.raises(ProfileError):
            parse({"marker": markers}, "text")


def test_a_mount_angle_and_a_hue_of_zero_are_not_unknown():
    marker = {"name": "one", "colour": "red", "body": "rotor", "mount_angle": 0.0, "hue": 0.0}
    profile = Profile.model_validate({"name": "a", "centre": "orbit", "circle_hue": 0.0, "marker": [marker]})
    assert parse(tomllib.loads(to_toml(profile)), "text") == profile


@pytest.mark.parametrize(
    ("change", "place", "words"),
    [
        ({"marker": []}, "marker", "at least 1"),
        ({"marker": [{"name": "a", "colour": "pink", "body": "rotor"}]}, "marker[1].colour", "red"),
        ({"marker": [{"name": "a", "colour": "red", "body": "wheel"}]}, "marker[1].body", "casing"),
        ({"marker": [{"name": "a", "color": "red", "body": "rotor"}]}, "marker[1].color", "not permitted"),
        (
            {"marker": [{"name": "a", "colour": "red", "body": "rotor"}] * 2},
            "marker",
            "two markers are named",
        ),
        ({"marker": [{"name": "a", "colour": "white", "body": "rotor"}]}, "profile", "only a white marker"),
        (
            {"marker": [{"name": n, "colour": "white", "body": "casing"} for n in "ab"]},
            "profile",
            "gyrotrack spindown FILM --hub",
        ),
        ({"capture_fps": -1}, "capture_fps", "greater than 0"),
        ({"sense": 2}, "sense", "1"),
        ({"hue": 3}, "hue", "not permitted"),
    ],
)
def test_every_fault_names_its_key(change, place, words):
    good = {"marker": [{"name": "a", "colour": "red", "body": "rotor"}]}
    with pytest.raises(ProfileError) as caught:
        parse({**good, **change}, "mine.toml")
    assert caught.value.message.startswith("mine.toml: ")
    assert place in caught.value.message
    assert words in caught.value.message


def test_all_faults_are_reported_at_once():
    with pytest.raises(ProfileError) as caught:
        parse({"sense": 5, "capture_fps": 0, "marker": [{"name": "", "colour": "red", "body": "rotor"}]}, "p")
    assert all(key in caught.value.message for key in ("sense", "capture_fps", "marker[1].name"))


def test_two_markers_of_one_colour_on_one_body_cannot_be_distinguished():
    markers = [{"name": n, "colour": "red", "body": "rotor"} for n in "ab"]
    with pytest.raises(ProfileError, match="same colour"):
        parse({"marker": markers}, "p")


@pytest.mark.parametrize(
    ("content", "words"), [(b"a = = 1", "not valid TOML"), (b"\xff\xfe", "text file"), (None, "no profile")]
)
def test_files_that_are_not_profiles(tmp_path, content, words):
    path = tmp_path / "p.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ProfileError, match=words) as caught:
        load(path)
    assert "p.toml" in caught.value.message


def test_a_hub_given_by_hand_is_kept(tmp_path):
    path = tmp_path / "p.toml"
    profile = PAPER.model_copy(update={"hub": (304.5, 174.25), "centre": "orbit"})
    path.write_text(to_toml(profile), encoding="utf-8")
    assert load(path) == profile
