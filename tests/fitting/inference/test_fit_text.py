"""What a fit says of a random torque that its model needs."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Criteria, Fit, Model, fit, load_fit, make_record
from fitting._criteria import DEFAULT
from fitting._numbers import rounded
from fitting.inference import _params, _result
from fitting.inference._params import report
from fitting.inference._result import estimate_text, merit_lines

TOLD = "the recording does not establish this random torque"


@pytest.fixture(scope="module")
def found():
    t = np.arange(0.0, 20.0, 0.01)
    angle = 120.0 * t - 0.5 * t**2 + 1e-3 * np.random.default_rng(2).standard_normal(len(t))
    run = t, angle, np.full(len(t), 1e-3)
    return fit(
        Model.of(["touchpoint.constant"]), [make_record(casing=run, rotor=[], I_rotor=1.0, I_casing=1.0)]
    )


@pytest.mark.parametrize(("excess", "told"), [(10.1, True), (9.9, False)])
def test_fit_reports_a_random_torque_beyond_the_recording(found, excess, told):
    noise = replace(found.noise[0].at(2 * found.noise[0].least), excess=excess)
    changed = replace(found, noise=(noise,))
    assert changed.verdict == "no_lack_of_fit"
    assert (TOLD in "\n".join(merit_lines(changed))) is told


def test_a_lack_of_fit_says_enough(found, monkeypatch):
    noise = replace(found.noise[0].at(2 * found.noise[0].least), excess=50.0)
    changed = replace(found, noise=(noise,))
    monkeypatch.setattr(type(changed), "has_torque_of_the_angle", lambda *_: True)
    assert changed.verdict == "lack_of_fit"
    assert TOLD not in "\n".join(merit_lines(changed))


QUIET = {
    "fails": False, "needs_random_torque": False, "has_torque_of_the_angle": False, "has_smooth_torque": False,
    "has_smooth_law": False, "periodogram_peak": 0.0011,
}  # fmt: skip


@pytest.mark.parametrize(
    ("test", "lacks"),
    [
        ({}, False),
        ({"fails": True}, True),
        ({"needs_random_torque": True}, True),
        ({"has_torque_of_the_angle": True}, True),
        ({"has_smooth_torque": True}, True),
        ({"has_smooth_law": True}, True),
        ({"periodogram_peak": 0.0009}, True),
        ({"periodogram_peak": None}, False),
    ],
)
def test_each_test_shows_a_lack_of_fit(found, monkeypatch, test, lacks):
    given, asked = QUIET | test, []

    def answer(value):
        return lambda fit, criteria: asked.append(criteria) or value

    for name, value in given.items():
        p_value = None if value is None else SimpleNamespace(p_value=value)
        of_fit = answer(value) if isinstance(value, bool) else property(lambda _, p=p_value: p)
        monkeypatch.setattr(type(found), name, of_fit)
    changed = replace(found)
    assert changed.has_lack_of_fit() is lacks
    assert changed.verdict == ("lack_of_fit" if lacks else "no_lack_of_fit")
    # looser limits are those of every test
    loose = Criteria(doubt_adequate=1e-4)
    assert changed.has_lack_of_fit(loose) is (lacks and True in test.values())
    assert set(asked) == {changed.criteria, loose}


@pytest.mark.parametrize(
    ("p_value", "oscillates", "raised", "describes", "beside", "law"),
    [
        (0.0011, False, False, True, 0.0, False),
        (0.0009, True, True, True, 0.5, True),
        (0.0009, False, False, True, 0.5, True),
        (0.0009, False, True, False, 0.5, True),
        (0.0009, False, True, True, 0.0009, True),
        (0.0009, False, True, True, 0.0011, False),  # a random torque explains it
    ],
)
def test_a_random_torque_may_explain_that_the_residual_torque_depends_on_a_speed(
    monkeypatch, p_value, oscillates, raised, describes, beside, law
):
    likely = SimpleNamespace(
        is_raised=raised, describes=lambda rows, criteria: rows == 50 and describes, noise="raised"
    )
    problem = SimpleNamespace(data=[SimpleNamespace(motion=SimpleNamespace(is_smooth=not oscillates))])
    base = SimpleNamespace(
        smooth_test=SimpleNamespace(p_value=p_value), problem=problem, predictions="predictions", rows=50,
        most_likely_noise=lambda criteria: likely,
    )  # fmt: skip

    def smooth_test(*given):
        assert given == (problem, "predictions", "raised")
        return SimpleNamespace(p_value=beside)

    monkeypatch.setattr(_result, "smooth_test", smooth_test)
    assert Fit.has_smooth_law(base, DEFAULT) is law


@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        (["one"], ("slipped", "late")),
        (["one", "two"], ("one: slipped", "one: late", "two: slipped", "two: late")),
    ],
)
def test_a_finding_names_its_recording_where_there_are_several(found, labels, expected):
    data = [SimpleNamespace(record=SimpleNamespace(label=x), findings=("slipped", "late")) for x in labels]
    assert type(found).findings.fget(SimpleNamespace(problem=SimpleNamespace(data=data))) == expected


def test_a_report_has_correlations_of_either_sign(found, monkeypatch):
    pairs = [("a", "b", -0.9), ("a", "cc", 0.1), ("b", "cc", -0.09)]
    monkeypatch.setattr(type(found), "correlations", lambda _: pairs)
    lines = found.fit_report().splitlines()
    at = lines.index("[[Correlations]] (unreported correlations are < 0.100)")
    assert lines[at + 1 :] == ["    C(a, b ) = -0.9000", "    C(a, cc) = +0.1000"]
    assert "    C(b, cc) = -0.0900" in found.fit_report(0.05).splitlines()
    assert "[[Correlations]]" not in found.fit_report(0.95)


def test_a_report_counts_the_parameters_that_were_fitted(found):
    held = replace(found.params["b1"], vary=False, value=-4.0, stderr=0.1)
    free = replace(held, vary=True)
    given = {
        name: getattr(found, name) for name in ("verdict", "shown_model", "samples", "n_eff", "chi2", "aic")
    }
    shown = SimpleNamespace(
        **given, bic=5.0, cases=found.cases, correlations=list, params={"k": free, "held": held, "c": free}
    )
    lines = report(shown).splitlines()
    assert lines[3:5] == [
        f"    verdict              = {found.verdict}",
        f"    data points          = {found.samples}",
    ]
    assert "    variables            = 2" in lines
    assert f"    k:    {rounded(-4.0, 0.1, held.unit)} (2.50%)" in lines
    assert lines[-2] == f"    held: {rounded(-4.0, 0.1, held.unit)} (2.50%) (held)"


@pytest.mark.parametrize(
    ("expr", "vary", "expected"),
    [
        (None, True, {"expr": None}),
        (None, False, {"expr": None, "vary": False}),
        ("8*b2", False, {"expr": "8*b2"}),
    ],
)
def test_settings_of_an_estimate_hold_it_if_it_was_held_and_not_tied(expr, vary, expected):
    given = SimpleNamespace(value=2.0, expr=expr, vary=vary, min=0.0, max=3.0)
    assert _params._of_estimate(given, changed=False) == {"value": 2.0, **expected}
    assert _params._of_estimate(given, changed=True) == {"value": 2.0, **expected, "min": 0.0, "max": 3.0}


@pytest.mark.parametrize(
    ("verdict", "at_bound", "held", "text"),
    [
        ("lack_of_fit", False, (), rounded(2.0, 0.1, "N m")),
        ("not_converged", False, (), "2 N m"),
        ("no_lack_of_fit", True, (), f"{rounded(2.0, 0.1, 'N m')} (at its bound)"),
        ("no_lack_of_fit", False, ("k",), f"{rounded(2.0, 0.1, 'N m')} (held)"),
    ],
)
def test_a_value_has_an_uncertainty_if_the_search_converged(verdict, at_bound, held, text):
    estimate = SimpleNamespace(value=2.0, stderr=0.1, unit="N m", at_bound=at_bound)
    model = SimpleNamespace(constants=dict.fromkeys(held, 2.0))
    shown = SimpleNamespace(estimates={"k": estimate}, model=model, verdict=verdict)
    assert estimate_text(shown, "k") == text


def test_the_body_of_a_curve_is_the_casing_unless_another_is_named(found):
    t = np.linspace(0.0, 1.0, 40)
    runs = [(t, speed * t, np.full(40, 1e-3)) for speed in (3.0, 50.0)]
    both = make_record(casing=runs[0], rotor=[runs[1]], I_rotor=1.0, I_casing=1.0)
    given = SimpleNamespace(
        problem=SimpleNamespace(data=[SimpleNamespace(record=both)]), _index=lambda case: case
    )
    assert [type(found)._place(given, body, 0) for body in (None, "casing", "rotor")] == [1, 1, 0]


def test_a_saved_fit_has_the_laws_that_the_library_does_not_contain(found, tmp_path):
    model = found.model + "casing: -q*omega_c**3"
    replace(found, model=model).save(tmp_path / "fit.json")
    assert load_fit(tmp_path / "fit.json").model == model


def test_the_shown_figures_of_merit_are_r2_the_residual_and_the_prediction_error(found):
    body = replace(found.cases[0].casing, r2=0.75, rmse=0.125, held_out=2.5)
    shown = replace(found)
    vars(shown)["cases"] = (replace(found.cases[0], casing=body),)
    row = shown._repr_html_().split("<tbody>")[1].split("</tbody>")[0]
    assert re.findall(r">([^<>]+)</td>", row) == ["case", "body", "0.750000", "0.125", "2.50"]
