"""The laws of a single body in words, and values in the unit of the file beside SI."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Model, effect_name
from gyrotrack.apps.report._laws import laws_of_body
from gyrotrack.io.readers._reading import units_of_file


def fitted(values, inertia=2.0, joints=()):
    record = SimpleNamespace(joints=joints, I_casing=inertia, body="body")
    return SimpleNamespace(
        problem=SimpleNamespace(data=[SimpleNamespace(record=record)]),
        name=lambda key: effect_name(key, "body"),
        model=Model.of(dict.fromkeys(k.rpartition(".")[0] for k in values)),
        estimates={
            k: SimpleNamespace(value=v, stderr=u, unit="") for k, (v, u) in values.items()
        } | {"initial.omega_c@a": SimpleNamespace(value=1.0, stderr=0.1, unit="")},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("touchpoint.constant.b1", 0.5, "slows the body by 0.25 rad/s2"),
        ("casing.air.linear.b2", 0.5, "falls to 1/e in 4 s"),
        ("casing.air.quadratic.k", 2 * np.log(2) / (2 * np.pi * 10), "halves in 10 turns"),
        ("casing.spring.linear.k", 2 * (2 * np.pi / 3) ** 2, "a period of 3 s"),
        ("casing.gravity.k", 2 * (2 * np.pi / 3) ** 2, "a period of 3 s at small amplitude"),
    ],
)
def test_a_strength_is_recognised_by_what_it_does(key, value, words):
    (law,) = laws_of_body(fitted({key: (value, value / 3.1)}))
    assert words in law.meaning
    (weak,) = laws_of_body(fitted({key: (value, value / 2.9)}))
    assert words not in weak.meaning
    assert weak.meaning
    assert laws_of_body(fitted({key: (value, 0.0)}, joints=("bearing",))) == ()


@pytest.mark.parametrize(
    ("quantity", "unit", "expected"),
    [
        ("omega", "rpm", {"omega": ("rpm", np.pi / 30), "alpha": ("rpm/s", np.pi / 30)}),
        ("omega", "rad/s", {}),
        ("angle", "deg", {q: (f"deg{t}", np.pi / 180) for q, t in (("angle", ""), ("omega", "/s"), ("alpha", "/s2"))}),
        ("angle", "rad", {}),
        ("angle", "", {}),
        ("time", "ms", {}),
    ],
)  # fmt: skip
def test_units_of_a_file_that_are_not_si(quantity, unit, expected):
    found = units_of_file({"columns": [{"quantity": quantity, "unit": unit}]})
    assert {k: v[0] for k, v in found.items()} == {k: v[0] for k, v in expected.items()}
    for key, (_, scale) in found.items():
        assert scale == pytest.approx(expected[key][1])


def test_a_law_without_a_simple_motion_has_its_meaning_alone():
    (strength,) = Model.of(["casing.air.laminar"]).parameters
    (law,) = laws_of_body(fitted({strength: (0.5, 0.01)}))
    assert (law.parameter, law.value, law.stderr) == (strength, 0.5, 0.01)
    assert ";" not in law.meaning
