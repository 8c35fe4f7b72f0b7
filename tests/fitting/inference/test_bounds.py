"""Held, bounded and undetermined parameters; models with missing and with superfluous effects."""

from types import SimpleNamespace

import numpy as np
import pytest
import twobody
from cases import case, data, fitted, pulls

from fitting import GENERAL, LINEAR, REDUCED, Model, fit
from fitting.inference._problem import surely_at_bound

TRUTH = twobody.truth()


@pytest.mark.slow
@pytest.mark.parametrize(
    "held",
    [{"bearing.power.g": 1.32}, {"bearing.linear.d": 1.57e-7}, {"f": 1.26e-8, "b1": 2.88e-6}],
    ids=["g", "d", "f and b1"],
)
def test_holding_parameters_at_the_truth_reduces_other_uncertainties(held):
    base = fitted(seed=0)
    result = fit(Model.of(REDUCED).with_fixed(held), [data(seed=0)])
    assert result.verdict == "no_lack_of_fit"
    assert base.chi2 <= result.chi2 + 0.01 < base.chi2 + 12
    assert result.bic < base.bic
    constants = result.model.constants
    assert len(constants) == len(held)
    for key, e in result.estimates.items():
        if key in constants:
            assert e.value == constants[key]
            assert np.isnan(e.stderr)
        else:
            assert e.stderr < 1.02 * base.estimates[key].stderr
            assert abs(e.value - TRUTH[key]) < 4 * e.stderr


@pytest.mark.slow
def test_a_parameter_held_far_off_is_a_misfit():
    assert fit(Model.of(REDUCED).with_fixed({"g": 0.7}), [data(seed=0)]).verdict == "lack_of_fit"


@pytest.mark.slow
def test_a_superfluous_power_law_has_strength_zero():
    measured = case({"f": 0.0, "d": 2.5e-7}, 41, "case1")
    full, linear = fit(Model.of(REDUCED), [measured]), fit(Model.of(LINEAR), [measured])
    assert linear.verdict == "no_lack_of_fit"
    # a power law of strength 0 has an exponent that no data determine
    assert full.verdict in {"no_lack_of_fit", "not_determined"}
    assert full.chi2 <= linear.chi2 + 0.01
    assert linear.bic < full.bic
    assert max(map(abs, pulls(linear, TRUTH | {"bearing.linear.d": 2.5e-7}).values())) < 4
    for key in ("bearing.linear.d", "bearing.power.f"):
        assert full.estimates[key].value >= 0
    values = {k: e.value for k, e in full.estimates.items()}
    torque = values["bearing.linear.d"] * 600 + values["bearing.power.f"] * 600 ** values["bearing.power.g"]
    assert torque == pytest.approx(2.5e-7 * 600, rel=1e-3)


def test_friction_is_not_negative_and_its_bound_is_marked():
    result = fit(Model.of((*REDUCED, "casing.air.quadratic")), [data(seed=0, hidden="nothing")])
    e = result.estimates["casing.air.quadratic.k"]
    assert e.value >= 0
    if e.at_bound:
        assert np.isnan(e.stderr)


@pytest.mark.slow
def test_general_model_in_the_ranges_of_the_paper():
    """Twenty percent on a2, b2, g and fifty on d, f about the reduced fit: a box in d and f themselves."""
    base = fitted(seed=0)
    widths = {
        "rotor.air.quadratic.a2": 0.2,
        "casing.air.linear.b2": 0.2,
        "bearing.power.g": 0.2,
        "bearing.linear.d": 0.5,
        "bearing.power.f": 0.5,
    }
    ranges = {
        k: ((1 - w) * base.estimates[k].value, (1 + w) * base.estimates[k].value) for k, w in widths.items()
    }
    result = fit(Model.of(GENERAL), [data(seed=0)], ranges=ranges)
    for key, (low, high) in ranges.items():
        assert low <= result.estimates[key].value <= high
    assert result.chi2 <= base.chi2 + 0.01
    assert result.verdict in {"no_lack_of_fit", "not_determined"}


@pytest.mark.slow
def test_a_range_that_excludes_the_truth_is_an_active_bound():
    low, high = 1.7e-7, 2.2e-7
    result = fit(Model.of(REDUCED), [data(seed=0)], ranges={"bearing.linear.d": (low, high)})
    d = result.estimates["bearing.linear.d"]
    assert d.value == pytest.approx(low, rel=1e-9)
    assert d.at_bound
    assert np.isnan(d.stderr)
    # the noise level takes up the misfit of chi-square, the likelihood does not
    assert result.deviance > fitted(seed=0).deviance + 4


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_uncertainties_are_valid_with_an_active_bound_of_another_parameter(seed):
    """With a strong random torque d, f or g is at a bound. Held, f would have a 20 times too small uncertainty."""
    result = fitted(seed=seed, ou=1e-6, ou_time=3.0, few=True)
    found = {k: z for k, z in pulls(result, TRUTH).items() if not result.estimates[k].at_bound}
    assert max(map(abs, found.values())) < 4, found
    if seed == 2:
        assert result.estimates["bearing.linear.d"].at_bound


@pytest.mark.slow
def test_nine_parameters_of_one_recording_are_not_determined():
    """The general model fits as well, with uncertainties of d, f and g that are hundreds of times larger."""
    general, reduced = fit(Model.of(GENERAL), [data(seed=0)]), fitted(seed=0)
    assert general.verdict == "not_determined"
    assert general.chi2 == pytest.approx(reduced.chi2, abs=6)
    for key in ("bearing.linear.d", "bearing.power.f", "bearing.power.g"):
        assert general.estimates[key].stderr > 30 * reduced.estimates[key].stderr
        assert abs(general.estimates[key].value - TRUTH[key]) < 4 * general.estimates[key].stderr


@pytest.mark.parametrize(("beyond", "sure"), [(2.9, False), (3.1, True), (-3.1, True)])
@pytest.mark.parametrize("size", [0.1, 5.0])
def test_a_strength_three_standard_errors_beyond_its_bound_is_at_the_bound(beyond, sure, size):
    """Of four variables the first is not at a bound, the second has other bounds, the third is not influential."""
    layout = SimpleNamespace(names=("a.k", "a.g", "a.b", "a.d"), is_physical_bound=lambda name: name != "a.g")
    j = size * np.eye(5)[:, :4] * [1.0, 1.0, 0.0, 1.0]
    at_bound = np.array([False, True, False, True])
    found = surely_at_bound(layout, at_bound, np.full(5, beyond), j)
    assert found.tolist() == [False, False, True, sure]
