"""The chart of a torque that repeats with the turn, in the report."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.inference._angle_harmonics import AngleHarmonics
from gyrotrack.apps.report import _page


def fitted(*sizes):
    """Return what the chart needs of a fit: an amplitude twice a turn in each case [N m]."""
    found = [
        AngleHarmonics(label, np.array([0.0, 0.0, size, 0.0]), 1e-14 * np.eye(4))
        for label, size in zip("ab", sizes, strict=True)
    ]
    return SimpleNamespace(angle_harmonics=found, torque_unit="N m")


def charts_of(label, kind, *, improved=True):
    study = SimpleNamespace(base=fitted(1e-6, 3e-6), final=fitted(2e-6, 4e-6), improved=improved)
    case = SimpleNamespace(label=label, body="casing", failures=[SimpleNamespace(kind=kind)])
    return _page._torque_of_the_angle(study, case)


@pytest.mark.parametrize(("label", "sizes"), [("a", (1.0, 2.0)), ("b", (3.0, 4.0))])
def test_each_case_shows_its_own_torque_before_and_after(label, sizes):
    (chart,) = charts_of(label, "ripple")
    assert chart.name == "torque-angle"
    assert [t.label for t in chart.traces] == ["base model", "final model"]
    for trace, size in zip(chart.traces, sizes, strict=True):
        assert np.abs(trace.value).max() == pytest.approx(size, rel=0.01)


def test_without_an_added_effect_the_base_model_is_shown_alone():
    (chart,) = charts_of("a", "ripple", improved=False)
    assert [t.label for t in chart.traces] == ["base model"]


def test_a_torque_that_changes_slowly_has_no_such_chart():
    assert charts_of("a", "slow") == []
