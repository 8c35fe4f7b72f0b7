"""Torques of other kinds on the wheel of `test_small_case`: a step, a wave in time, one in the angle, another friction.

Amplitudes, frequencies, phases and times are those of the torque that SciPy integrated.
"""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting import LIBRARY, Model, make_record
from fitting._criteria import DEFAULT
from fitting.discovery import _difference as difference
from fitting.discovery._difference import different_parameter, improves_on_difference
from fitting.discovery._grammar import description_length
from fitting.discovery._lack_of_fit import (
    UNKNOWN_IN_TIME,
    UNKNOWN_LAWS,
    contradiction,
    harmonic_test,
    nonparametric_law,
    nonparametric_rivals,
)
from fitting.discovery._refine import refit
from fitting.discovery._score import CaseColumns, score
from fitting.discovery._select import separate_values
from fitting.inference import _periodogram
from fitting.inference._angle_harmonics import angle_harmonics
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit

INERTIA, SIGMA, B1, B2 = 2e-3, 7e-4, 1e-3, 2e-5
TIME = np.linspace(0.0, 30.0, 600)
STEP, ONSET = -3e-4, 12.0
WAVE, RATE = 2e-4, 3.0
HARMONIC, ORDER = 1.2e-3, 3
HIDDEN = {
    "nothing": lambda t, w, psi: 0.0,
    "step": lambda t, w, psi: STEP * (t > ONSET),
    "wave": lambda t, w, psi: WAVE * np.cos(RATE * t + 0.4),
    "harmonic": lambda t, w, psi: HARMONIC * np.sin(ORDER * psi - 0.7),
    "drag": lambda t, w, psi: -4e-7 * w**2,
    "more friction": lambda t, w, psi: -2e-4,
    "another wheel": lambda t, w, psi: -2e-4 + 1e-5 * w,
}


@cache
def record(hidden, label="case", seed=0, speed=60.0, every=1):
    torque = HIDDEN[hidden]
    done = solve_ivp(
        lambda t, y: [y[1], (torque(t, y[1], y[0]) - B1 - B2 * y[1]) / INERTIA], (0, 30), [0.0, speed],
        t_eval=TIME, rtol=1e-10, atol=1e-10, max_step=0.05,
    )  # fmt: skip
    noise = SIGMA * np.random.default_rng(seed).standard_normal(len(TIME))
    samples = (TIME, done.y[0] + noise, np.full(len(TIME), SIGMA))
    return make_record(
        casing=tuple(x[::every] for x in samples), rotor=[], I_rotor=1.0, I_casing=INERTIA,
        single=True, label=label,
    )  # fmt: skip


@cache
def projected(*which):
    return CaseData.of(record(*which))


@cache
def fitted(*hidden, speed=60.0, more=()):
    data = [projected(h, f"run {i}", i, speed, len(hidden)) for i, h in enumerate(hidden)]
    shared = ["touchpoint.constant.b1", "casing.air.linear.b2"] if len(data) > 1 else []
    return fit(Model.of(("touchpoint.constant", "casing.air.linear", *more)), data, share=shared)


class TestStep:
    @pytest.mark.slow
    def test_onset_and_size_are_those_of_the_torque(self):
        base = fitted("step")
        (screened,) = score(base, [LIBRARY["touchpoint.step"]], [CaseColumns(base, 0)], DEFAULT)
        assert screened.score > DEFAULT.changepoint_score
        found = refit(base, screened, DEFAULT)
        onset, size = (found.estimates[f"touchpoint.step.{s}"] for s in ("t0", "k"))
        assert abs(onset.value - ONSET) < max(4 * onset.stderr, 0.05)
        # friction of the library is counted positive
        assert abs(size.value + STEP) < 4 * size.stderr
        assert 0 < size.stderr < 0.1 * abs(STEP)
        assert found.bic < base.bic - DEFAULT.evidence


class TestWave:
    def test_frequency_and_amplitude_are_those_of_the_torque(self):
        peak = fitted("wave").significant_peak(DEFAULT)
        assert peak.rate == pytest.approx(RATE, abs=0.02)
        assert peak.torque == pytest.approx(WAVE, rel=0.1)
        assert peak.angle == pytest.approx(peak.torque / (INERTIA * peak.rate**2), rel=1e-6)
        assert peak.p_value < 1e-10
        assert peak.law.startswith("casing: k*cos(")
        assert contradiction(None, fitted("wave"), DEFAULT) == peak

    def test_noise_has_no_significant_peak(self):
        peak = fitted("nothing").periodogram_peak
        assert peak.p_value > DEFAULT.doubt_adequate
        assert fitted("nothing").significant_peak(DEFAULT) is None
        lowest, highest, step = self.periodogram("nothing").band
        assert lowest == pytest.approx(2 * np.pi * 10 / 30.0, rel=0.02)
        assert highest > 2 * RATE
        assert step == pytest.approx(np.pi / 30.0, rel=0.02)

    def periodogram(self, hidden):
        found = fitted(hidden)
        return _periodogram._Periodogram(found.problem.data[0], found.predictions[0], found.noise[0])

    @pytest.mark.parametrize(("share", "believed"), [(0.5, False), (2.0, True)])
    def test_on_film_it_has_to_exceed_the_noise_of_one_angle(self, share, believed):
        found = fitted("wave")
        data = found.problem.data[0]
        angle = found.periodogram_peak.angle
        sigma = replace(data.record.casing, sigma=np.full(len(TIME), angle / share))
        film = SimpleNamespace(
            **{n: getattr(data.record, n) for n in ("I_casing", "label", "body", "torque_unit")}
        )
        film.tracked, film.casing = True, sigma
        monkey = _With(data, record=film)
        peak = _periodogram._highest_peak(monkey, found.predictions[0], found.noise[0], 1)
        assert (peak.p_value < 1e-6) is believed


class _With:
    """An object with some attributes replaced; the rest of the computation is that of the original."""

    def __init__(self, original, **replaced):
        self._original, self._replaced = original, replaced
        self._asked = {}

    def __getattr__(self, name):
        if name == "record":
            return _Merged(self._replaced["record"], self._original.record)
        return getattr(self._original, name)


class _Merged:
    def __init__(self, first, second):
        self._both = first, second

    def __getattr__(self, name):
        first, second = self._both
        return getattr(first, name) if hasattr(first, name) else getattr(second, name)


class TestHarmonic:
    """Slow turns respond to a torque of the angle: the wheel has about one turn a second."""

    def test_order_and_amplitude_are_those_of_the_torque(self):
        base = fitted("harmonic", speed=22.0)
        test = harmonic_test(base, DEFAULT)
        assert test.order == ORDER
        assert test.p_value < DEFAULT.doubt_adequate
        assert test.fit is not None
        k, phi = (test.fit.estimates[f"harmonic.{s}"] for s in ("k", "phi"))
        assert abs(k.value) == pytest.approx(HARMONIC, rel=0.15)
        turned = phi.value if k.value > 0 else phi.value + np.pi
        assert np.cos(turned - 0.7) > 0.95

    def test_noise_has_no_harmonic(self):
        assert harmonic_test(fitted("nothing"), DEFAULT).p_value > DEFAULT.doubt_adequate
        assert angle_harmonics(fitted("nothing")) is not None


class TestSpeed:
    @pytest.mark.slow
    def test_a_drag_depends_on_the_speed(self):
        test = fitted("drag").smooth_test
        assert test.body == "body"
        assert test.p_value < 1e-6
        assert contradiction(None, fitted("drag"), DEFAULT) is not None

    def test_any_law_of_the_speed_explains_as_much_as_the_drag(self):
        base = fitted("drag")
        (drag,) = score(base, [LIBRARY["casing.air.quadratic"]], [CaseColumns(base, 0)], DEFAULT)
        whole = nonparametric_law(base, "casing", "omega_c")
        assert drag.score - 3.0 < whole < drag.score + 30.0
        chosen = SimpleNamespace(
            physical=True, score=drag.score, screened=drag, effect=LIBRARY["touchpoint.drift"]
        )

        def named(score):
            return nonparametric_rivals(
                base, SimpleNamespace(**{**vars(chosen), "score": score}), None, DEFAULT
            )

        assert named(drag.score) == (UNKNOWN_LAWS["omega_c"],)
        assert named(whole + 11.0) == ()
        assert named(whole + 9.0) == (UNKNOWN_LAWS["omega_c"],)
        in_time = SimpleNamespace(any_in_time=True)
        chosen.score = whole + 11.0
        assert nonparametric_rivals(base, chosen, in_time, DEFAULT) == (UNKNOWN_IN_TIME,)
        # a law of this speed alone is no rival of one of its own kind
        chosen.score, chosen.effect = drag.score, LIBRARY["casing.air.quadratic"]
        assert nonparametric_rivals(base, chosen, None, DEFAULT) == ()
        assert nonparametric_rivals(base, None, in_time, DEFAULT) == ()


class TestDifference:
    """Two runs, the second one with more dry friction by 0.2 mN m."""

    def test_the_parameter_that_differs_and_by_how_much(self):
        base = fitted("nothing", "more friction")
        found = different_parameter(base, DEFAULT)
        assert found.parameter.name == "touchpoint.constant.b1"
        difference = found.parameter.differences["run 1"]
        assert abs(difference.value - 2e-4) < 4 * difference.stderr
        # of two independent values
        both = [e.stderr for e in found.parameter.estimates.values()]
        assert 0.1 * min(both) < difference.stderr < 3.0 * max(both)
        assert found.parameter.delta_bic == pytest.approx(found.fit.bic - base.bic)
        assert found.parameter.p_value < 1e-10
        assert found.penalised_bic > found.fit.bic
        assert "--per-case touchpoint.constant.b1" in found.parameter.sentence
        assert different_parameter(base, DEFAULT, least=1e12) is None
        # an explanation that is as good has to be beaten within the width
        fitted_rival = (base, found.penalised_bic - DEFAULT.equivalence_width + 1.0)
        assert different_parameter(base, DEFAULT, rival=fitted_rival) is not None
        fitted_rival = (base, found.penalised_bic - DEFAULT.equivalence_width - 1.0)
        assert different_parameter(base, DEFAULT, rival=fitted_rival) is None

    def test_equal_runs_do_not_differ(self):
        assert different_parameter(fitted("nothing", "nothing"), DEFAULT) is None
        assert different_parameter(fitted("nothing"), DEFAULT) is None

    def test_an_effect_that_describes_the_data_as_well_is_preferred(self):
        base = fitted("nothing", "more friction")
        found = different_parameter(base, DEFAULT)
        drag = LIBRARY["casing.air.quadratic"]
        assert not improves_on_difference(found, [drag], [0.0], DEFAULT)
        kept = separate_values(base, [], [], DEFAULT)
        assert kept is not None
        assert kept.parameter.name == found.parameter.name
        candidate = lambda bic: SimpleNamespace(physical=True, score=1.0, fit=SimpleNamespace(bic=bic))  # noqa: E731
        assert separate_values(base, [candidate(kept.penalised_bic - 1.0)], [], DEFAULT) is None
        assert separate_values(base, [candidate(kept.penalised_bic + 1.0)], [], DEFAULT) is not None
        assert separate_values(fitted("nothing", "nothing"), [], [], DEFAULT) is None

    @pytest.mark.slow
    @pytest.mark.parametrize("more", [(), ("casing.air.quadratic",)])
    def test_of_several_that_differ_each_is_named(self, more):
        """Friction and linear drag of the second wheel are others; a third law is common to both."""
        base = fitted("nothing", "another wheel", more=more)
        found = different_parameter(base, DEFAULT)
        true = {"touchpoint.constant.b1": 2e-4, "casing.air.linear.b2": -1e-5}
        assert set(found.parameter.names) == set(true)
        assert not found.fit.fails(DEFAULT)
        for values in (found.parameter, *found.parameter.others):
            difference = values.differences["run 1"]
            assert abs(difference.value - true[values.name]) < 4 * difference.stderr
            assert difference.stderr < 0.1 * abs(difference.value)
            assert values.largest == abs(difference.value) / difference.stderr
        first, second = found.parameter, *found.parameter.others
        assert first.largest > second.largest
        assert found.parameter.p_value < 1e-10
        assert found.penalised_bic == pytest.approx(found.fit.bic + description_length(2))
        assert found.parameter.delta_bic == pytest.approx(found.fit.bic - base.bic)
        for name in true:
            assert f"--per-case {name}" in found.parameter.sentence
        drag = LIBRARY["casing.air.quadratic" if not more else "casing.brake.eddy"]
        assert not improves_on_difference(found, [drag], [0.0], DEFAULT)
        assert different_parameter(base, DEFAULT, least=1e12) is None

    @pytest.mark.slow
    def test_a_step_in_both_recordings_does_not_differ(self):
        found = different_parameter(fitted("step", "step"), DEFAULT)
        assert found is None or found.fit.fails(DEFAULT)
        assert separate_values(fitted("step", "step"), [], [], DEFAULT) is None


class TestSeveral:
    """Three parameters with separate values in two recordings; the third one may be shared."""

    KEYS = ("a.k", "b.k", "c.k")

    def found(self, monkeypatch, gain=60.0, bic=60.0, fails=False, shared=("c.k",)):
        """Separate values lower the deviance by `gain` and the BIC by `bic`."""

        def fitted_with(base, keys, *, start=None, noise=None):
            needed = any(k not in keys and k not in shared for k in self.KEYS)
            values = {f"{k}@{x}": 1.0 for k in keys for x in "pq"}
            return SimpleNamespace(
                keys=keys, bic=100.0 - bic + len(keys) + 50.0 * needed, deviance=100.0 - gain, noise=noise,
                values=values, fails=lambda criteria: fails or needed,
            )  # fmt: skip

        def values(fit, name):
            size = {"a.k": 9.0, "b.k": 5.0, "c.k": 1.0}[name]
            estimates = {x: SimpleNamespace(value=2.0, stderr=0.1, unit="1") for x in "pq"}
            return difference.ValuesPerRecording(
                name, estimates, {"q": SimpleNamespace(value=size, stderr=1.0)}
            )

        monkeypatch.setattr(difference, "_fit_per_recording", fitted_with)
        monkeypatch.setattr(difference, "_values", values)
        layout = SimpleNamespace(records=("p", "q"))
        base = SimpleNamespace(bic=100.0, deviance=100.0, problem=SimpleNamespace(layout=layout))
        return difference._several_that_differ(base, self.KEYS, DEFAULT)

    @pytest.mark.parametrize(
        ("shared", "names"),
        [
            (("c.k",), ("a.k", "b.k")),
            ((), ("a.k", "b.k", "c.k")),
            (("b.k",), ("a.k", "c.k")),
            (("b.k", "c.k"), ("a.k",)),
        ],
    )
    def test_parameters_that_may_be_equal_are_shared_again(self, monkeypatch, shared, names):
        assert self.found(monkeypatch, shared=shared).parameter.names == names

    def test_a_lack_of_fit_with_all_values_separate(self, monkeypatch):
        assert self.found(monkeypatch, fails=True) is None

    def test_the_probability_counts_the_choices_of_two_of_three(self, monkeypatch):
        found = self.found(monkeypatch).parameter
        assert found.p_value == pytest.approx(3 * np.exp(-60.0 / 2))  # chi-square with two degrees of freedom

    @pytest.mark.parametrize(("share", "significant"), [(0.9, True), (1.1, False)])
    def test_it_is_significant(self, monkeypatch, share, significant):
        gain = -2 * np.log(share * DEFAULT.significance / 3)
        assert (self.found(monkeypatch, gain=gain) is not None) == significant

    @pytest.mark.parametrize(("more", "better"), [(0.1, True), (-0.1, False)])
    def test_the_bic_is_lower_by_the_evidence(self, monkeypatch, more, better):
        bic = DEFAULT.evidence + 2 + description_length(2) + more
        assert (self.found(monkeypatch, bic=bic) is not None) == better

    def test_the_largest_difference_is_that_in_standard_uncertainties(self):
        sizes = {"q": (3.0, 1.0), "r": (-8.0, 2.0), "s": (90.0, float("nan"))}
        differences = {x: SimpleNamespace(value=v, stderr=u) for x, (v, u) in sizes.items()}
        assert difference.ValuesPerRecording("a.k", {}, differences).largest == 4.0
        assert difference.ValuesPerRecording("a.k", {}, {"s": differences["s"]}).largest == 0.0
