"""`gyrotrack laws`: what it refuses before it begins, and one whole search."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting import read_effects
from fitting.law_search._laws import Laws


def test_a_picture_needs_a_known_suffix(gyrotrack, simulated):
    said = gyrotrack("laws", simulated / "plain.h5", "--picture", "laws.jpg", "--json")
    assert said.code == 2
    assert ".png" in said.error["hint"]


def test_a_number_of_a_law_without_a_file_is_refused(gyrotrack, simulated):
    said = gyrotrack("laws", simulated / "plain.h5", "--law", "2", "--json")
    assert said.code == 2
    assert "--save-law" in said.error["message"]


@pytest.mark.parametrize("name", ["casing.windage", "9lives"])
def test_a_law_needs_a_separate_name(gyrotrack, simulated, tmp_path, name):
    file = tmp_path / "lab.toml"
    said = gyrotrack("laws", simulated / "plain.h5", "--save-law", name, file, "--json")
    assert said.code in {1, 2}
    assert name in said.error["message"]
    assert not file.exists()


@pytest.mark.slow
def test_the_result_is_printed_where_there_is_no_law_to_save(gyrotrack, simulated, tmp_path, monkeypatch):
    def nothing(base, extra, **options):
        return Laws(base, "none", "No law is significant.", (), None, (), "", 7)

    monkeypatch.setattr("fitting.law_search._laws.laws", nothing)
    file = tmp_path / "lab.toml"
    said = gyrotrack("laws", simulated / "plain.h5", "--save-law", "lab.found", file, "--json")
    assert said.code == 1
    assert (said.json["verdict"], said.json["trials"]) == ("none", 7)
    assert "no law was found" in said.err
    assert not file.exists()


@pytest.mark.slow
@pytest.mark.release
def test_a_search_of_one_case(gyrotrack, tmp_path):
    """A body whose drag saturates: -0.15 tanh(omega / 5) rad/s2 beside friction that the model has."""
    case, picture, file = tmp_path / "case.h5", tmp_path / "laws.svg", tmp_path / "lab.toml"
    t = np.arange(0, 120, 0.05)
    motion = solve_ivp(
        lambda _, y: [y[1], -0.02 - 0.012 * y[1] - 0.15 * np.tanh(y[1] / 5)],
        (0, 120), [0.0, 40.0], t_eval=t, rtol=1e-10, atol=1e-10,
    )  # fmt: skip
    angle = motion.y[0] + 4e-4 * np.random.default_rng(0).standard_normal(len(t))
    table = np.stack([t, angle, np.full(len(t), 4e-4)], axis=1)
    np.savetxt(tmp_path / "t.csv", table, delimiter=",", header="t,angle,sigma", comments="")
    assert gyrotrack("import", "--body", tmp_path / "t.csv", "--inertia", "1", "-o", case).code == 0
    words = ["--beyond-library", "--save-law", "lab.found", file]
    said = gyrotrack("laws", case, "--picture", picture, *words, "--json", "-q")
    assert said.code == 0
    document = said.json
    assert document["verdict"] in {"law", "library"}
    assert {"variable", "p_value", "explained"} <= set(document["depends_on"][0])
    assert any("tanh(omega_c/w)" in law["formula"] for law in document["laws"])
    assert all(json.dumps(law) for law in document["laws"])
    assert picture.read_text(encoding="utf-8").count("<svg") == 1
    (effect, *_) = read_effects(file)
    assert effect.name == "lab.found"
    # a second one of this name is refused before the search begins
    assert gyrotrack("laws", case, "--save-law", "lab.found", file, "--json").code == 1
