"""Sealed challenges: the answer is hidden, cannot be changed, and answers are graded fairly."""

import json

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.apps._simulation import OUTSIDE, Seal, draw_effect, grade, seal, unseal
from gyrotrack.apps.cli._app import run


def test_a_seal_gives_back_what_was_sealed_and_shows_nothing(tmp_path):
    path = tmp_path / "x.seal.json"
    commitment = seal(path, "casing.air.quadratic", {"casing.air.quadratic.k": 1e-10})
    assert "quadratic" not in path.read_text()
    opened = unseal(path)
    assert opened == Seal("casing.air.quadratic", {"casing.air.quadratic.k": 1e-10}, commitment)


def test_the_same_answer_never_looks_the_same(tmp_path):
    texts = [
        (seal(tmp_path / f"{i}.json", "bearing.drift", {}), (tmp_path / f"{i}.json").read_text())
        for i in (0, 1)
    ]
    assert texts[0][0] != texts[1][0]
    assert json.loads(texts[0][1])["sealed"] != json.loads(texts[1][1])["sealed"]


def test_a_changed_commitment_is_noticed(tmp_path):
    path = tmp_path / "x.json"
    seal(path, "bearing.drift", {"bearing.drift.k": 1e-4})
    document = json.loads(path.read_text())
    document["commitment"] = "0" * 64
    path.write_text(json.dumps(document))
    with pytest.raises(DatasetError, match="does not match its commitment"):
        unseal(path)


@pytest.mark.parametrize("text", ["", "hello", "{}", '{"sealed": "!!", "salt": "", "commitment": ""}', "[1]"])
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(DatasetError, match="not a seal"):
        unseal(path)


@pytest.mark.parametrize(
    ("effect", "named", "word"),
    [
        ("bearing.drift", ["bearing.drift"], "right"),
        ("bearing.drift", ["bearing.heating", "bearing.drift"], "right class"),
        ("bearing.drift", ["bearing.heating"], "wrong"),
        ("bearing.drift", [], "wrong"),
        ("casing.windage", ["bearing.load"], "right"),
        (OUTSIDE[0], [], "right class"),
        (OUTSIDE[0], ["casing.air.quadratic"], "wrong"),
    ],
)
def test_grades(effect, named, word):
    assert grade(Seal(effect, {}, ""), named, {}).grade == word


def test_pulls_are_in_standard_errors():
    score = grade(Seal("e", {"e.k": 2.0}, ""), ["e"], {"e.k": (2.3, 0.1), "other": (1.0, 1.0)})
    assert score.pulls == {"e.k": pytest.approx(3.0)}


def test_drawn_effects_are_new_and_of_all_kinds():
    random = np.random.default_rng(1)
    drawn = {draw_effect(["bearing.linear"], random).name for _ in range(300)}
    assert "bearing.linear" not in drawn
    assert len(drawn) > 15
    assert drawn & set(OUTSIDE)
    assert not any(name.startswith(("camera.", "setup.")) for name in drawn)


def test_a_challenge_from_the_command_line(tmp_path, capsys):
    case = tmp_path / "c.h5"
    short = ["--duration", "40", "--window", "1", "--window", "15", "--window", "30"]
    assert run(["simulate", "-o", str(case), "--hide", *short, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert set(made) >= {"output", "seal", "commitment"}
    assert "parameters" not in made
    assert made["commitment"] == unseal(tmp_path / "c.seal.json").commitment
    truth = unseal(tmp_path / "c.seal.json").effect
    assert run(["info", str(case), "--json"]) == 0
    told = capsys.readouterr().out
    assert truth not in told
    assert made["commitment"] in told
    assert run(["reveal", str(tmp_path / "c.seal.json"), "--answer", truth, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["grade"] == "right"
    assert run(["reveal", str(tmp_path / "c.seal.json")]) == 2
    assert "only with exactly one answer" in capsys.readouterr().err
