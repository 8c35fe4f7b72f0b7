"""The headline of a report, and its chart of a torque that repeats with the turn."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Fit, effect_name
from fitting.inference._angle_harmonics import AngleHarmonics
from gyrotrack.apps.report import _page
from gyrotrack.plotting._study_data import StudyView


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
    assert _page._headline(view)[2] == words


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["touchpoint.constant.b1"], " in b₁ of the dry friction at the touch point"),
        (
            ["touchpoint.constant.b1", "casing.air.linear.b2"],
            ", for example in b₁ of the dry friction at the touch point, b₂ of the linear air drag of the casing",
        ),
    ],
)
def test_parameters_that_differ_are_named(names, words):
    differs = SimpleNamespace(names=names, others=names[1:])
    view = SimpleNamespace(verdict="unexplained", differs=differs, name=effect_name)
    assert _page._headline(view)[2] == f"The recordings differ{words}"


def test_an_undecided_answer_names_nothing():
    found = candidate("touchpoint.step", physical=True)
    view = SimpleNamespace(verdict="undecided", differs=None, candidates=(found,), added=("touchpoint.step",))
    assert _page._headline(view)[2] == "Undecided"


@pytest.mark.parametrize(
    ("verdict", "rows"),
    [
        (
            "undecided",
            [("Why", "A sentence."), ("Significance", "step of the friction at the touch point: ")],
        ),
        ("missing_effect", [("Significance", "")]),
    ],
)
def test_an_undecided_answer_gives_its_reason(verdict, rows):
    found = candidate("touchpoint.step", physical=True)
    found.p_value, found.delta_bic = 0.004, -8.0
    view = SimpleNamespace(
        verdict=verdict, sentence="A sentence.", differs=None, candidates=(found,), cases=(),
        name=lambda e: effect_name(getattr(e, "name", e)),
    )  # fmt: skip
    *others, (title, text) = rows
    shown = "ΔBIC −8.00, false-alarm probability = 0.0040; no indistinguishable candidate"
    assert _page._facts(view) == [*others, (title, text + shown)]
    found.significant = False
    none = "1 candidate effects tested, none significant"
    assert _page._facts(view) == [*others, (title, none)]


@pytest.mark.parametrize(
    ("added", "words"),
    [
        ((), "Unexplained torque"),
        (("casing.unbalance",), "Unexplained torque; closest law: unbalance of the casing"),
    ],
)
def test_an_unexplained_torque_is_said_with_the_law_that_comes_closest(added, words):
    found = candidate("casing.unbalance", physical=True)
    view = SimpleNamespace(
        verdict="unexplained", differs=None, candidates=(found,), added=added,
        name=lambda e: effect_name(getattr(e, "name", e)),
    )  # fmt: skip
    assert _page._headline(view)[2] == words


@pytest.mark.parametrize(("count", "shown"), [(1, ("6.43",)), (2, ("6.43", "0.975"))])
def test_the_misfit_is_the_root_of_chi_square_per_row_of_each_model(count, shown):
    """Two recordings, of 100 and 300 rows: 11.4 and 51.4 give 41.4, 0.8 and 1 give 0.95."""
    fits = []
    for few, many in ((11.4, 51.4), (0.8, 1.0)):
        cases = [SimpleNamespace(rows=n, chi2_per_row=x) for n, x in ((100, few), (300, many))]
        fits.append(SimpleNamespace(misfit=Fit.misfit.fget(SimpleNamespace(cases=cases))))
    view = SimpleNamespace(base=fits[0], final=fits[1], cases=(SimpleNamespace(models=[None] * count),))
    assert StudyView.misfit.fget(view) == pytest.approx([float(x) for x in shown], rel=1e-3)


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
