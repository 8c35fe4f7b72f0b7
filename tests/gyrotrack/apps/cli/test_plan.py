"""`plan` as a user runs it."""

import tomllib
from pathlib import Path

import pytest

from fitting.discovery import _power
from fitting.planning import _plan
from gyrotrack.apps.cli._settings import own_effects

GUIDE = Path(__file__).parents[4] / "docs" / "how-to" / "plan-an-experiment.md"


@pytest.fixture
def described(tmp_path):
    """The description in the guide, with a shorter run of fewer frames."""
    text = GUIDE.read_text(encoding="utf-8").partition("```toml\n")[2].partition("```")[0]
    tomllib.loads(text)
    for old, new in (
        ("duration = 200.0 ", "duration = 60.0 "),
        ("[5.0, 70.0, 150.0]", "[2.0, 30.0, 50.0]"),
        ("casing_fps = 260.0 ", "casing_fps = 60.0 "),
        ("rotor_fps = 1000.0", "rotor_fps = 250.0"),
    ):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "plan.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.release
def test_the_guides_description_gives_limits_a_run_and_a_picture(gyrotrack, described, tmp_path, monkeypatch):
    # how good limits and run are, tests/fitting/discovery/test_plan.py tells
    monkeypatch.setattr(_plan, "_EVALUATIONS", 12)
    monkeypatch.setattr(_plan, "_ESTIMATES", 2)
    monkeypatch.setattr(_power, "_POWER_DRAWS", 60)
    picture = tmp_path / "plan.png"
    said = gyrotrack(
        "plan", described, "--size", "2e-6", "--bound", "inertia_casing=1,1", "--picture", picture, "--json"
    )
    assert said.code == 0
    assert said.err == ""
    keys = {"effect", "detection_limit", "upper_limit", "unit", "torque_Nm", "runs_needed", "power"}
    assert all(keys <= set(e) for e in said.json["effects"])
    drag = next(e for e in said.json["effects"] if e["effect"] == "casing.air.quadratic")
    assert drag["unit"] == "N m s2"
    assert drag["size_Nm"] == pytest.approx(2e-6)
    assert 0 < drag["upper_limit"] < drag["detection_limit"]
    assert 0 <= drag["power"] <= 1
    run = said.json["next_run"]
    # the file states that the rotor turns in one sense only
    assert 300 <= run["omega_rotor"] <= 900
    assert run["inertia_casing_ratio"] == 1
    assert run["bounds"]["reversible"] is False
    assert len(run["windows"]) == 3
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--size", "0"], "--size 0 is not a positive torque"),
        (["--bound", "speed=1,2"], "unknown quantity"),
        (["--bound", "duration=0,2"], "is not positive"),
        (["--bound", "omega_casing=5"], "not a pair of increasing numbers"),
        (["--bound", "omega_casing=9,5"], "not a pair of increasing numbers"),
        (["--from", "f1"], "a description of recordings has no fits"),
        (["--picture", "plan.gif"], "Unknown picture format"),
    ],
)
def test_wrong_usage(gyrotrack, described, words, message):
    said = gyrotrack("plan", described, *words, "--json")
    assert said.code == 2
    assert message in said.error["message"]


def test_a_description_stands_alone(gyrotrack, described):
    assert gyrotrack("plan", described, described, "--json").code == 2


def test_a_description_without_inertia_is_refused(gyrotrack, described):
    described.write_text(described.read_text().replace("casing = 2.06e-5", ""))
    said = gyrotrack("plan", described, "--json")
    assert said.code == 1
    assert said.error["message"].startswith("plan.toml: inertia.casing is missing")


def test_friction_adds_the_laws_that_a_search_leaves_out():
    names = [e.name for e in own_effects(None, friction=True)]
    assert names == ["casing.friction.starvation", "casing.friction.lugre", "casing.friction.gms"]
    assert own_effects(None) == []
