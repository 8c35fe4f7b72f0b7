"""The whole story through the real program: film, recordings, case, fit, hidden effect, the error falls, report."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

CLIPS = Path(__file__).parents[1] / "sample_clips"


@pytest.mark.slow
def test_story(demo):
    truth = json.loads((CLIPS / "truth.json").read_text(encoding="utf-8"))  # no command reads it
    document, folder = demo
    the_hidden_effect_is_named(document, truth)
    strength_and_friction_are_right(document, truth)
    the_error_falls_to_the_noise(document)
    the_clocks_are_found(folder, truth)
    the_speeds_are_those_of_the_film(folder, truth)
    a_report_is_written(document, folder)


def the_hidden_effect_is_named(document, truth):
    diagnosis = document["diagnosis"]
    assert diagnosis["verdict"] == "missing_effect"
    first = diagnosis["candidates"][0]
    assert first["effect"] == truth["hidden_effect"]
    assert first["kind"] == "physical"
    assert first["indistinguishable_from"] == []
    assert truth["hidden_effect"] in diagnosis["sentence"]


def strength_and_friction_are_right(document, truth):
    """Every parameter of the final model within 4 standard errors, which are small."""
    found = document["final"]["parameters"]
    expected = {
        "casing.air.quadratic.k": truth["hidden_parameters"]["k"],
        "rotor.air.quadratic.a2": truth["friction"]["a2"],
        "touchpoint.constant.b1": truth["friction"]["b1"],
        "casing.air.linear.b2": truth["friction"]["b2"],
        "bearing.linear.d": truth["friction"]["d"],
        "bearing.power.f": truth["friction"]["f"],
        "bearing.power.g": truth["friction"]["g"],
    }
    z = {k: (found[k]["value"] - v) / found[k]["stderr"] for k, v in expected.items()}
    assert max(map(abs, z.values())) < 4, z
    assert found["casing.air.quadratic.k"]["stderr"] < 0.02 * expected["casing.air.quadratic.k"]


def the_error_falls_to_the_noise(document):
    first, *_, last = document["ladder"]
    assert first["verdict"] == "lack_of_fit"
    assert last["verdict"] == "no_lack_of_fit"
    assert last["rmse_casing"] < 0.5 * first["rmse_casing"]
    assert last["held_out"] < 0.5 * first["held_out"]
    assert last["reduced_chi2"] < 0.2 * first["reduced_chi2"]
    assert 0.9 < last["reduced_chi2"] < 1.2
    assert document["verdict"] == "missing_effect"


def the_clocks_are_found(folder, truth):
    """Each rotor clip starts where its truth says, within 5 of its standard errors (three clips)."""
    with h5py.File(folder / "case.h5") as file:
        found = {
            Path(clip.attrs["source"]).stem: (clip.attrs["clock_offset"], clip.attrs["clock_offset_sigma"])
            for clip in file["recording"].values()
        }
    assert set(found) == set(truth["clips"])
    for name in ("rotor_1", "rotor_2", "rotor_3"):
        start, sigma = found[name]
        assert abs(start - truth["clips"][name]["clock_offset_s"]) < 5 * sigma, name
        assert sigma < 1e-4


def the_speeds_are_those_of_the_film(folder, truth):
    clips = truth["clips"]
    with h5py.File(folder / "case.h5") as file:
        omega = np.asarray(file["rotor/omega"])
        window = np.asarray(file["rotor/window"])
    for i in range(3):
        speeds = omega[(window == i) & np.isfinite(omega)]
        first, last = clips[f"rotor_{i + 1}"]["omega_rotor_first_last"]
        assert first + 1 > speeds.max() > speeds.min() > last - 1


def a_report_is_written(document, folder):
    page = Path(document["report"])
    assert page.parent == folder
    text = page.read_text(encoding="utf-8")
    assert "casing.air.quadratic" in text
    assert len(text) > 20_000
    assert not list(folder.glob("*.part"))
