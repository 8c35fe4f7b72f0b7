"""The whole search on one small recording: a wheel of 2 g m2 at 60 rad/s for 30 s, with a quadratic drag or without.

The truth is the equation of motion integrated by SciPy; uncertainties are compared with those of a linear least-squares
fit of the same samples.
"""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from cases import searched
from scipy.integrate import solve_ivp

from fitting import LIBRARY, Criteria, Model, diagnose, improve
from fitting._criteria import DEFAULT
from fitting.discovery import _remainder as remainder
from fitting.discovery import _select
from fitting.discovery import _verdict as verdict
from fitting.discovery._lack_of_fit import contradiction
from fitting.discovery._refine import with_shape_parameter
from fitting.discovery._remainder import Grade, Nuisance, Remainder, Torques, nuisance_parameters
from fitting.discovery._residuals import find_failures, residual_torques, whiteness
from fitting.discovery._select import Selection, best, needed_evidence, ordered
from fitting.effects._expression import Tape, symbols
from fitting.inference._fit import fit
from fitting.study._serialisation import restored_diagnosis, stored_diagnosis

INERTIA, SIGMA, DRAG = 2e-3, 1e-3, 4e-7
FRICTION = (1e-3, 2e-5, DRAG)
TIME = np.linspace(0.0, 30.0, 1200)
BASE = ("touchpoint.constant", "casing.air.linear")
NAME = "casing.air.quadratic"


def motion(parameters, speed=60.0):
    """Return angle and angular rate at the samples."""
    b1, b2, k = parameters
    done = solve_ivp(
        lambda _, y: [y[1], -(b1 + b2 * y[1] + k * y[1] ** 2) / INERTIA], (0, 30), [0.0, speed],
        t_eval=TIME, rtol=1e-11, atol=1e-11, method="DOP853",
    )  # fmt: skip
    return done.y


def base(drag=DRAG):
    return searched(drag)[0]


def ranked(drag=DRAG):
    return searched(drag)[1]


def answer(drag=DRAG):
    return searched(drag)[2]


@cache
def standard_errors():
    """Standard errors of (b1, b2, k) by linear least squares, with the start and the white noise free."""
    centre = np.array([*FRICTION, 60.0])
    columns = [np.ones_like(TIME)]
    for i, value in enumerate(centre):
        step = 1e-4 * value
        up, down = centre.copy(), centre.copy()
        up[i], down[i] = value + step, value - step
        columns.append((motion(up[:3], up[3])[0] - motion(down[:3], down[3])[0]) / (2 * step))
    design = np.stack(columns, axis=1)
    scale = np.linalg.norm(design, axis=0)
    covariance = np.linalg.inv((design / scale).T @ (design / scale)) * SIGMA**2
    return (np.sqrt(np.diag(covariance)) / scale)[1:4]


class TestRanking:
    def test_the_hidden_drag_is_first_with_its_strength(self):
        first = ranked()[0]
        assert (first.effect.name, first.significant, first.physical) == (NAME, True, True)
        found = first.estimates[f"{NAME}.k"]
        assert abs(found.value - DRAG) < 4 * found.stderr
        assert first.p_value < 1e-30
        refitted = first.fit.estimates
        for name, true in zip(("touchpoint.constant.b1", "casing.air.linear.b2"), FRICTION[:2], strict=True):
            assert abs(refitted[name].value - true) < 4 * refitted[name].stderr

    def test_the_standard_error_is_that_of_least_squares(self):
        """The camera's nuisance functions and process noise may enlarge it, by less than its size."""
        full = fit(Model.of((*BASE, NAME)), base(), noise=base(0.0).noise)
        for name, expected in zip(
            ("touchpoint.constant.b1", "casing.air.linear.b2", f"{NAME}.k"), standard_errors(), strict=True
        ):
            assert 0.9 * expected < full.estimates[name].stderr < 3.0 * expected

    def test_score_and_bic_are_differences_of_fits(self):
        for c in ranked():
            if c.fit is None or not c.significant:
                continue
            assert c.score == pytest.approx(base().deviance - c.fit.deviance)
            assert c.delta_bic == pytest.approx(c.fit.bic - base().bic)
            more = len(c.fit.theta) - len(base().theta)
            assert c.delta_bic + c.score == pytest.approx(
                more * np.log(len(base().problem.data[0].z)), rel=0.15
            )

    def test_the_score_test_predicts_the_refit(self):
        """It is linear in the effect: a quarter of the gain of a strong effect is missing at most."""
        first = ranked()[0]
        assert 0.5 * first.score < first.screened.score < 1.1 * first.score

    def test_what_the_base_contains_has_no_score(self):
        constant = next(c for c in ranked() if c.effect.name == "external.constant")
        assert constant.screened.absorbed
        assert constant.p_value == pytest.approx(1.0)
        assert not constant.significant

    def test_without_a_hidden_effect_nothing_is_significant(self):
        assert not any(c.significant for c in ranked(0.0))
        assert best(ranked(0.0)) is None
        assert min(c.p_value for c in ranked(0.0)) > DEFAULT.significance
        # the deviance of one wrong parameter is a chi-square of one degree of freedom
        assert all(c.score < 16.0 for c in ranked(0.0))


class TestOrder:
    def test_evidence_decides_which_effect_is_added(self):
        first = ranked()[0]
        assert best(ranked()) is first
        assert best(ranked(), Criteria(evidence=-first.delta_bic + 1, evidence_periodic=1e9)) is None
        assert best(ranked(), Criteria(evidence=-first.delta_bic - 1)) is first
        assert best([replace(first, significant=False)]) is None

    @pytest.mark.parametrize(
        ("converged", "strength", "alike", "takes_the_other"),
        [
            (True, 3.1, True, False),
            (True, 2.9, True, True),
            (False, 3.1, True, True),
            (True, 2.9, False, False),  # another candidate, not a rival
        ],
    )
    def test_an_undetermined_strength_leaves_the_name_to_its_class(
        self, converged, strength, alike, takes_the_other
    ):
        first, second = ranked()[:2]
        key = f"{NAME}.k"
        weak = replace(first.fit.estimates[key], stderr=first.fit.estimates[key].value / strength)
        poor = replace(first.fit, converged=converged, estimates=first.fit.estimates | {key: weak})
        names = (second.effect.name,) if alike else ()
        better = replace(second, significant=True, delta_bic=-50.0, fit=replace(first.fit))
        doubtful = replace(first, fit=poor, indistinguishable_from=names)
        found = best([doubtful, better])
        assert found is (better if takes_the_other else doubtful)
        assert best([doubtful]) is doubtful
        assert best([replace(first, fit=None)]) is None

    @pytest.mark.parametrize(
        ("tracked", "effect", "needed"),
        [
            (True, "casing.unbalance", DEFAULT.evidence_periodic),
            (False, "casing.unbalance", DEFAULT.evidence),
            (True, NAME, DEFAULT.evidence),
            (True, "camera.centre", DEFAULT.evidence),
        ],
    )
    def test_periodic_laws_need_more_evidence_on_film(self, tracked, effect, needed):
        data = base().problem.data[0]
        film = replace(data, record=replace(data.record, tracked=tracked))
        seen = replace(base(), problem=replace(base().problem, data=(film,)))
        assert needed_evidence(LIBRARY[effect], seen, DEFAULT) == needed
        of_film = replace(
            ranked()[0], effect=LIBRARY[effect], fit=replace(ranked()[0].fit, problem=seen.problem)
        )
        assert best([replace(of_film, delta_bic=-0.9 * needed)]) is None
        assert best([replace(of_film, delta_bic=-1.1 * needed)]) is not None

    def test_candidates_within_the_width_are_indistinguishable(self):
        first = ranked()[0]
        for apart, score, alike in (
            (9.0, 9.0, True),
            (11.0, 11.0, False),
            (11.0, 9.0, True),
            (9.0, 11.0, True),
        ):
            rival = replace(
                first, effect=LIBRARY["casing.air.laminar"],
                delta_bic=first.delta_bic + apart, score=first.score - score,
            )  # fmt: skip
            one, other = ordered([rival, first], DEFAULT)
            assert (one.effect.name, other.effect.name) == (NAME, "casing.air.laminar")
            assert bool(one.indistinguishable_from) is bool(other.indistinguishable_from) is alike
        insignificant = replace(rival, score=first.score, delta_bic=first.delta_bic, significant=False)
        assert not any(c.indistinguishable_from for c in ordered([insignificant, first], DEFAULT))

    def test_without_refits_only_equal_responses_are_indistinguishable(self):
        first = ranked()[0]
        direction = np.zeros(3)
        direction[0] = 1.0
        for cosine, alike in ((0.99995, True), (0.9998, False), (-0.99995, True)):
            other = np.array([cosine, np.sqrt(1 - cosine**2), 0.0])
            pair = [
                replace(first, fit=None, effect=LIBRARY[n], screened=replace(first.screened, direction=d))
                for n, d in ((NAME, direction), ("casing.air.laminar", other))
            ]
            assert bool(ordered(pair, DEFAULT)[0].indistinguishable_from) is alike

    @pytest.mark.parametrize(("ahead", "first"), [(3.0, NAME), (3.5, "setup.inertia")])
    def test_physics_is_preferred_to_an_error_of_measurement(self, ahead, first):
        drag = ranked()[0]
        setup = replace(drag, effect=LIBRARY["setup.inertia"], delta_bic=drag.delta_bic - ahead)
        assert ordered([drag, setup], DEFAULT)[0].effect.name == first

    def test_which_candidates_are_refitted(self):
        """The four best at any score, up to fourteen with a tenth of the best score and p below a half."""
        first = ranked()[0]
        absorbed = replace(first, score=2.0 * first.score, screened=replace(first.screened, absorbed=True))
        made = lambda share, p: replace(first, score=share * first.score, p_value=p)  # noqa: E731
        assert _select._to_refit([absorbed, first, made(0.05, 0.9), made(0.04, 0.9), made(0.03, 0.9)], DEFAULT) == [
            False, True, True, True, True,
        ]  # fmt: skip
        more = [made(0.5, 0.1)] * 4 + [made(0.051, 0.4), made(0.051, 0.6), made(0.049, 0.4)]
        assert _select._to_refit(more, DEFAULT) == [True] * 4 + [True, False, False]
        assert sum(_select._to_refit([made(0.5, 0.1)] * 20, DEFAULT)) == DEFAULT.refit_most

    def test_an_essential_effect_is_far_from_zero(self):
        full = ranked()[0].fit
        e = full.estimates[f"{NAME}.k"]
        for sigma, essential in ((3.2, False), (3.4, True), (-3.4, True), (np.inf, False)):
            stderr = np.nan if np.isinf(sigma) else abs(e.value / sigma)
            value = -e.value if sigma < 0 else e.value
            changed = replace(e, stderr=stderr, value=value)
            seen = replace(full, estimates={**full.estimates, f"{NAME}.k": changed})
            assert _select._is_essential(seen, LIBRARY[NAME], DEFAULT) == (essential or np.isnan(stderr))


class TestTorque:
    def test_with_the_model_it_is_the_true_torque(self):
        (curve,) = residual_torques(base())
        assert curve.body == "casing"
        speed = np.interp(curve.time, TIME, motion(FRICTION)[1])
        fitted = base().estimates
        model = -(fitted["touchpoint.constant.b1"].value + fitted["casing.air.linear.b2"].value * speed)
        true = -(FRICTION[0] + FRICTION[1] * speed + DRAG * speed**2)
        inside = slice(len(speed) // 10, -len(speed) // 10)
        z = ((model + curve.torque - true) / curve.sigma)[inside]
        assert np.sqrt(np.mean(z**2)) < 2.0
        # its largest deviation is a large part of the curve
        assert np.abs(curve.torque[inside]).max() > 5 * np.median(curve.sigma[inside])

    def test_failures_are_where_the_drag_is_largest(self):
        found = answer().failures
        assert found[0].t_start < 0.1
        assert found[0].t_stop < 10.0
        assert found[0].residual_torque_Nm < 0
        assert found[0].size_sigma > DEFAULT.failure_sigma
        stretch = np.interp([found[0].t_stop, found[0].t_start], TIME, motion(FRICTION)[1])
        assert found[0].omega_c == pytest.approx(tuple(stretch), rel=0.02)
        assert found[0].where == "at the start"
        assert [f.size_sigma for f in found] == sorted((f.size_sigma for f in found), reverse=True)
        curves = residual_torques(base())
        assert not find_failures(base(), curves, [], Criteria(failure_sigma=1e6, harmonic_sigma=1e6))
        few = find_failures(base(), curves, [], Criteria(failure_sigma=0.99 * found[0].size_sigma))
        assert few

    def test_an_adequate_fit_has_no_torque(self):
        (curve,) = residual_torques(base(0.0))
        inside = slice(len(curve.time) // 10, -len(curve.time) // 10)
        assert (np.abs(curve.torque) <= 4.5 * curve.sigma)[inside].all()
        assert answer(0.0).failures == ()

    def test_the_named_effect_explains_all_of_it(self):
        full = ranked()[0].fit
        torques = Torques(base(), full, residual=False)
        assert torques.remaining(full) == pytest.approx((0.0, 0.0), abs=1e-12)
        share, rms = torques.remaining(base())
        assert share == 1.0
        speed = motion(FRICTION)[1]
        fitted = base().estimates
        missing = (
            FRICTION[0] - fitted["touchpoint.constant.b1"].value
            + (FRICTION[1] - fitted["casing.air.linear.b2"].value) * speed + DRAG * speed**2
        )  # fmt: skip
        assert rms == pytest.approx(np.sqrt(np.mean(missing**2)), rel=0.05)

    def test_residuals_of_an_adequate_fit_are_white(self):
        (white,) = whiteness(base(0.0))[:1]
        (not_white,) = whiteness(base())[:1]
        assert white.p_value > 0.001 > not_white.p_value


class TestAnswer:
    def test_the_drag_is_the_missing_effect(self):
        found = answer()
        assert (found.verdict, found.form, found.explained, found.remainder) == (
            "missing_effect",
            "exact",
            1.0,
            None,
        )
        assert "Missing: quadratic air drag of the body (air.quadratic), k = " in found.sentence
        assert found.upper_limits == ()
        assert found.form_limit is None or 0.0 < found.form_limit < 1.0

    def test_a_stored_answer_keeps_its_remainder(self):
        left = Remainder(1e-8, 0.03, 1e-9, "Remainder 10 nN m rms.", ("air.cubic",))
        found = replace(answer(), form="approximate", explained=0.97, remainder=left)
        again = restored_diagnosis(stored_diagnosis(found), found.fit)
        assert (again.remainder, again.form, again.explained) == (left, "approximate", 0.97)

    def test_a_fit_of_the_true_model_is_adequate(self):
        found = answer(0.0)
        assert (found.verdict, found.form, found.explained) == ("adequate", None, None)
        assert found.sentence.startswith("The residuals are consistent with noise; the model is adequate.")

    def test_an_upper_limit_is_that_of_the_standard_error(self):
        """Rms over the recording of k omega^2 beyond what constant and linear friction absorb, at 95 %."""
        limit = next(u for u in answer(0.0).upper_limits if u.effect == NAME)
        speed = motion((*FRICTION[:2], 0.0))[1]
        rms = standard_errors()[2] * np.sqrt(np.mean(speed**4))
        assert 1.0 * rms < limit.torque_Nm < 5.0 * rms

    def test_significance_decides(self):
        none = diagnose(base(), candidates=[replace(c, significant=False) for c in ranked()])
        assert none.verdict == "unexplained"

    def test_an_adequate_fit_is_not_contradicted(self):
        assert contradiction(None, base(0.0), DEFAULT) is None
        assert base(0.0).smooth_test.p_value > DEFAULT.doubt_adequate
        assert base().smooth_test.p_value < 1e-6

    def test_one_effect_is_added_and_no_more(self):
        kept = []
        history = improve(base(), first=ranked(), keep=kept.append)
        assert [s.change for s in history] == ["", f"+{NAME}"]
        assert kept == history[1:]
        assert history[-1].fit.verdict == "no_lack_of_fit"
        assert history[-1].fit.bic < base().bic - DEFAULT.evidence
        assert best(history[-1].candidates) is None

    @pytest.mark.parametrize(
        ("sigma", "excess", "needs"), [(4.5, 11.0, True), (3.5, 11.0, False), (4.5, 9.0, False)]
    )
    def test_a_random_torque_that_the_recording_does_not_show_is_a_lack_of_fit(self, sigma, excess, needs):
        found = base(0.0)
        n = found.noise[0]
        noisy = replace(found, noise=(replace(n, level=n.pure + sigma * n.pure_u, excess=excess),))
        assert noisy.needs_random_torque() == needs
        assert noisy.verdict == ("lack_of_fit" if needs else found.verdict)
        assert not noisy.needs_random_torque(Criteria(random_torque_evidence=1e9))
        assert not replace(noisy, noise=noisy.noise * 2).needs_random_torque()  # of a joint fit

    @pytest.mark.parametrize(("describes", "verdict"), [(True, "undecided"), (False, "unexplained")])
    def test_such_a_model_is_not_adequate(self, monkeypatch, describes, verdict):
        found = base(0.0)
        n = found.noise[0]
        noisy = replace(found, noise=(replace(n, level=n.pure + 5 * n.pure_u, excess=20.0),))
        monkeypatch.setattr(globals()["verdict"], "describes", lambda *_: describes)
        answered = diagnose(noisy, candidates=ranked(0.0), brief=True)
        assert answered.verdict == verdict
        assert "random torque" in answered.sentence or "unexplained torque" in answered.sentence
        assert diagnose(found, candidates=ranked(0.0), brief=True).verdict == "adequate"

    def test_excess_noise_compares_the_fit_with_the_recording(self):
        found = base()

        def raised(by):
            return replace(found, noise=tuple(replace(n, level=n.pure + by * n.pure_u) for n in found.noise))

        assert raised(4.5).has_excess_noise()
        assert not raised(0.5).has_excess_noise()
        assert not raised(4.5).has_excess_noise(Criteria(excess_noise=1e9))


@cache
def with_torque_of_the_angle():
    """Return the fit with the drag, and one with a torque of 2 mN m twice a turn beside it."""
    named = fit(Model.of((*BASE, NAME)), base())
    end = fit(Model.of((*BASE, NAME, "casing.asymmetry")), base(), start=named.values)
    theta = end.theta.copy()
    theta[end.problem.layout.index["casing.asymmetry.k"]] = 2e-3
    return named, replace(end, theta=theta)


class TestKindsOfTorque:
    """A drag and a second effect that repeats with the angle and is not determined."""

    def test_angle_dependent_torques_have_a_separate_size(self):
        named, end = with_torque_of_the_angle()
        torques = Torques(base(), end, residual=False)
        assert torques.of_angle(named) == pytest.approx(2e-3 / math.sqrt(2))
        assert torques.of_angle(end) == 0.0
        assert torques.remaining(named)[0] > 0.5
        assert torques.remaining(named, slow=True)[0] < 0.05

    def test_a_drag_is_not_measured_by_angle_dependent_torques(self, monkeypatch):
        named, end = with_torque_of_the_angle()
        first = replace(ranked()[0], fit=named)
        selection = Selection([first], first, named, end)
        monkeypatch.setattr(type(end), "fails", lambda *_: False)
        size = remainder.grade(base(), selection, None, DEFAULT, misfit=False)
        assert size.explained > 0.95
        assert size.form == "approximate"
        assert "second effect asymmetry of the body (asymmetry)" in size.remainder.sentence
        assert "an angle-dependent torque of 1.41 mN m rms" in size.remainder.sentence

    @pytest.mark.parametrize(("alone", "explained"), [(0.02, 0.98), (0.3, 0.7), (0.6, 0.6)])
    def test_the_smaller_estimate_of_what_remains_counts(self, monkeypatch, alone, explained):
        """Beside an undetermined second effect, 0.4 of the torque seems to remain."""
        named, end = with_torque_of_the_angle()

        class Estimated(Torques):
            def remaining(self, fit, *, slow=False):
                assert slow
                return (alone if self._end is named else 0.4), 1e-6

        monkeypatch.setattr(remainder, "Torques", Estimated)
        monkeypatch.setattr(remainder, "better_law", lambda *_: "")
        first = replace(ranked()[0], fit=named)
        size = remainder.grade(base(), Selection([first], first, named, end), None, DEFAULT, misfit=False)
        assert size.explained == pytest.approx(explained)


class TestShape:
    @pytest.mark.parametrize(
        ("name", "shape"),
        [
            (NAME, ("n", 1.0, 3.0, 2.0)),
            ("casing.air.laminar", ("n", 0.5, 2.5, 1.5)),
            ("touchpoint.step", ("w", 1e-3, 1e3, None)),
        ],
    )
    def test_the_constant_of_a_law_is_freed_about_its_value(self, name, shape):
        freed = with_shape_parameter(LIBRARY[name])
        last = freed.parameters[-1]
        assert (last.symbol, last.lower, last.upper) == shape[:3]
        assert shape[3] is None or last.start == shape[3]
        values = {"omega_c": np.array([-3.0, 2.0]), "t": np.array([1.0, 5.0]), "k": 2.0, "n": shape[3]}
        values |= {"t0": 4.0, "w": 1e-3}
        needed = [Tape([e.expression])(values)[0] for e in (LIBRARY[name], freed)]
        np.testing.assert_allclose(needed[0], needed[1], atol=1e-9)
        assert set(symbols(freed.expression)) >= {"k", shape[0]}

    def test_laws_without_a_constant_stay(self):
        for name in ("touchpoint.constant", "casing.unbalance", "bearing.heating", "bearing.power"):
            assert with_shape_parameter(LIBRARY[name]) is None

    @pytest.mark.parametrize("residual", [True, False])
    def test_the_error_of_a_shape_is_that_of_the_best_scaled_law(self, residual):
        """A cubic for the quadratic law, along the motion; also where the base takes the place of a worse fit."""
        torques = Torques(base(), base(), residual=residual)
        numbers = {f"{NAME}.k": 1e-8, f"{NAME}.n": 3.0}
        layout = SimpleNamespace(numbers=lambda theta, case: numbers)
        free = SimpleNamespace(problem=SimpleNamespace(layout=layout), theta=None)
        law = LIBRARY[NAME]
        of_unmodelled, of_law, rms = torques.shape_error(law, with_shape_parameter(law), free)
        w = np.interp(np.linspace(0.0, 30.0, 2000), TIME, motion(FRICTION)[1])
        cubic, square = 1e-8 * w**3, w**2
        rest = cubic - square * (cubic @ square) / (square @ square)
        assert rms == pytest.approx(np.sqrt(np.mean(rest**2)), rel=0.02)
        assert of_law == pytest.approx(np.mean(rest**2) / np.mean(cubic**2), rel=0.02)
        if residual:
            (curve,) = residual_torques(base())
            whole = np.interp(np.linspace(0.0, 30.0, 2000), curve.time, curve.torque, left=0.0, right=0.0)
            assert of_unmodelled == pytest.approx(min(np.mean(rest**2) / np.mean(whole**2), 1.0), rel=0.02)
        else:
            assert of_unmodelled == 0.0


class TestGrade:
    """What is left of a form by an error of inertia, by noise, and by laws outside the library."""

    def graded(self, monkeypatch, size, rival=None, *, noisy=False, misfit=False, doubt=None):
        monkeypatch.setattr(verdict, "grade", lambda *_, **__: size)
        final = SimpleNamespace(has_excess_noise=lambda _: noisy)
        selection = SimpleNamespace(final=final)
        return verdict._graded(None, selection, doubt, rival, DEFAULT, misfit=misfit)

    @pytest.mark.parametrize(
        ("better", "allowed", "misfit", "doubt", "form"),
        [
            (True, True, False, None, "exact"),
            (True, False, False, None, "approximate"),
            (True, True, True, None, "approximate"),
            (True, True, False, "a sinusoid", "approximate"),
            (False, True, False, None, "exact"),
        ],
    )
    def test_an_inertia_within_its_uncertainty_is_not_a_remainder(
        self, monkeypatch, better, allowed, misfit, doubt, form
    ):
        rival = SimpleNamespace(better=better, is_allowed=lambda _: allowed)
        size = Grade(
            "approximate" if better else "exact", 0.97, Remainder(1.0, 0.03, 0.0, "left") if better else None
        )
        found = self.graded(monkeypatch, size, rival, misfit=misfit, doubt=doubt)
        assert found.form == form
        assert (found.remainder is None) is (form == "exact")
        assert found.explained == (1.0 if better and form == "exact" else 0.97)

    @pytest.mark.parametrize(
        ("form", "noisy", "expected"),
        [
            ("exact", True, (None, True)),
            ("exact", False, ("exact", False)),
            ("approximate", True, ("approximate", False)),
        ],
    )
    def test_more_noise_than_the_recording_shows_voids_a_form(self, monkeypatch, form, noisy, expected):
        found = self.graded(monkeypatch, Grade(form, 1.0, None), noisy=noisy)
        assert (found.form, found.noisy) == expected

    @pytest.mark.parametrize(
        ("form", "own", "laws", "expected"),
        [
            ("exact", (), ("a law of time",), (None, ("a law of time",))),
            ("exact", (), (), ("exact", ())),
            (
                "approximate",
                ("casing.air.laminar",),
                ("a law of time",),
                ("approximate", ("casing.air.laminar",)),
            ),
            ("approximate", (), ("a law of time",), ("approximate", ("a law of time",))),
        ],
    )
    def test_laws_outside_the_library_are_rivals(self, monkeypatch, form, own, laws, expected):
        monkeypatch.setattr(verdict, "nonparametric_rivals", lambda *_: laws)
        chosen = ranked()[0]
        selection = Selection([chosen], chosen, base(), base())
        found, size = verdict._with_unknown_laws(
            base(), selection, chosen, Grade(form, 1.0, None, own), DEFAULT
        )
        assert size.form == expected[0]
        assert found.chosen.indistinguishable_from == expected[1]

    @pytest.mark.parametrize(
        ("limit", "strong", "bounds_p", "words"),
        [
            (0.5, True, 1.0, None),
            (0.5, False, 0.5, "only a deviation above 50 % of the torque of the law"),
            (1.5, False, 0.5, "any law of similar size and shape"),
            (np.inf, False, 0.5, "the other parameters absorb every deviation"),
            (0.5, False, 0.001, "the fit prefers x outside its bounds"),
        ],
    )
    def test_why_a_form_is_not_established(self, limit, strong, bounds_p, words):
        test = SimpleNamespace(is_strong=lambda _: strong, limit=limit, bounds=("x",), bounds_p=bounds_p)
        found = verdict._untested(test, DEFAULT)
        assert not found if words is None else words in found[0]

    def test_noise_of_the_fit_that_the_recording_does_not_show_is_stated(self):
        most = (SimpleNamespace(level=5e-6, pure=4e-6), SimpleNamespace(level=3e-6, pure=1e-6))
        model = SimpleNamespace(names=("casing.air.quadratic",))
        selection = SimpleNamespace(
            chosen=ranked()[0],
            named=SimpleNamespace(model=model),
            final=SimpleNamespace(noise=most, torque_unit="N m", name=lambda e: e.name, model=model),
            candidates=ranked(),
        )
        (_, text) = verdict._missing(selection, Grade(None, 1.0, None, noisy=True), DEFAULT)
        assert "a random torque of 3 uN m rms, the recording shows 1 uN m" in text


@pytest.mark.parametrize("named", [True, False])
def test_a_camera_effect_is_stated_where_it_is_significant(named):
    """Its p-value is that of chi-square with two degrees of freedom, times the number of effects."""
    size = math.sqrt(-2.0 * math.log(0.03 / 2.0)) + (0.1 if named else -0.1)
    p_value = math.exp(-0.5 * size**2)
    found = [
        Nuisance("camera.centre", "case", 1e-3, 1e-3 / size, "rad", p_value),
        Nuisance("camera.tilt", "case", 1e-4, 1.0, "rad", 1.0),
    ]
    texts = verdict._nuisance(None, found, DEFAULT)
    assert texts == (["Camera centre offset 1 mrad (nuisance parameter, fitted)."] if named else [])
    periodic = SimpleNamespace(effect=SimpleNamespace(depends_on_angle=True))
    assert verdict._nuisance(periodic, found, DEFAULT) == []


def test_nuisance_parameters_have_the_probability_of_their_size():
    for found in nuisance_parameters(base(0.0)):
        assert 0.0 < found.p_value <= 1.0
        assert found.stderr > 0.0
        # without a correlation of its two components the size decides
        assert found.p_value == pytest.approx(math.exp(-0.5 * (found.value / found.stderr) ** 2), rel=0.9)


@pytest.mark.parametrize(
    ("explained", "remainder", "significant", "completed", "expected"),
    [
        (None, None, False, False, "missing_effect"),
        (0.97, "left", False, False, "unexplained"),
        (0.97, "left", False, True, "missing_effect"),
        (0.97, "left", True, True, "unexplained"),
        (0.04, "left", False, True, "unexplained"),
        (0.06, "left", False, True, "missing_effect"),
    ],
)
def test_a_second_effect_of_the_library_completes_an_answer(
    explained, remainder, significant, completed, expected
):
    chosen = SimpleNamespace(effect=SimpleNamespace(name="a"))
    named = SimpleNamespace(undetermined_at=lambda _: (), model=SimpleNamespace(names=("a",)))
    final = SimpleNamespace(model=SimpleNamespace(names=("a", "b") if completed else ("a",)))
    selection = SimpleNamespace(chosen=chosen, named=named, final=final)
    size = Grade(None, explained, remainder)
    assert verdict._verdict(selection, size, DEFAULT, significant=significant) == expected
    named.undetermined_at = lambda _: ("a.k",)
    assert verdict._verdict(selection, size, DEFAULT, significant=significant) == "unexplained"


@pytest.mark.parametrize(
    ("fitted", "significant", "words"),
    [
        (
            False,
            True,
            "was fitted to it (`gyrotrack improve` begins with quadratic air drag of the body (air.quadratic))",
        ),
        (False, False, "explains it"),
        (True, True, "explains it"),
    ],
)
def test_an_effect_that_was_not_fitted_is_not_said_to_explain_nothing(fitted, significant, words):
    first = next(c for c in ranked() if c.effect.name == NAME)
    candidate = replace(first, significant=significant, fit=first.fit if fitted else None)
    selection = Selection([candidate], None, base(), base())
    said = " ".join(verdict._unexplained(selection, None, Grade(None, None, None, ()), DEFAULT))
    assert f"o effect of the library {words}" in said


class TestUnrecordedDrive:
    """A rise of the speed without a drive in the model ends in "undecided" or "unexplained", never in an answer."""

    def diagnosed(self, monkeypatch, drag, candidates):
        examined = []
        monkeypatch.setattr(verdict, "unrecorded_drive", lambda f: examined.append(f) or "The speed rises.")
        return diagnose(base(drag), candidates=candidates, brief=True), examined

    def test_a_model_consistent_with_noise_is_not_adequate(self, monkeypatch):
        found, examined = self.diagnosed(monkeypatch, 0.0, ranked(0.0))
        assert (found.verdict, found.sentence) == ("undecided", "Nothing is established. The speed rises.")
        assert examined == [base(0.0)]

    def test_no_effect_is_named(self, monkeypatch):
        found, examined = self.diagnosed(monkeypatch, DRAG, ranked())
        assert found.verdict == "undecided"
        assert "The speed rises." in found.sentence
        assert found.form is None
        # the effect may describe the rise, so the fit with it is examined
        assert NAME in examined[0].model.names

    def test_an_unexplained_torque_is_stated_after_it(self, monkeypatch):
        found, examined = self.diagnosed(monkeypatch, DRAG, [])
        assert found.verdict == "unexplained"
        assert found.sentence.startswith("The speed rises. Significant lack of fit")
        assert examined == [base()]
