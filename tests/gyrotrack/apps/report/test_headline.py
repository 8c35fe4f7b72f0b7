"""The headline of a report: what it calls physics, and what a fault of the measurement."""

from types import SimpleNamespace

import pytest

from fitting import effect_name
from gyrotrack.apps.report._page import _headline


def candidate(name, *, physical):
    return SimpleNamespace(
        effect=SimpleNamespace(name=name), significant=True, physical=physical, indistinguishable_from=()
    )


@pytest.mark.parametrize(
    ("name", "physical", "added", "words"),
    [
        ("bearing.drift", True, (), "Missing: drift of the bearing friction"),
        ("camera.slip", False, (), "Fault of the measurement: slipped turns"),
        ("camera.slip", False, ("bearing.drift",), "Missing: drift of the bearing friction"),
    ],
)
def test_a_fault_of_the_measurement_is_called_so(name, physical, added, words):
    found = candidate(name, physical=physical)
    view = SimpleNamespace(
        verdict="missing_effect", differs=None, candidates=(found,), added=added,
        name=lambda e: effect_name(getattr(e, "name", e)),
    )  # fmt: skip
    assert _headline(view)[2] == words


def test_an_undecided_answer_names_nothing():
    found = candidate("touchpoint.step", physical=True)
    view = SimpleNamespace(verdict="undecided", differs=None, candidates=(found,), added=("touchpoint.step",))
    assert _headline(view)[2] == "Undecided"
