"""How much of a torque an effect explains, against integrals of known laws; and what grade follows from it."""

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from linearised import covariance, gyroscope
from scipy.stats import chi2

from fitting import LIBRARY, LINEAR, Candidate, Estimate, EstimationError, effect_name
from fitting import Model as Laws
from fitting._criteria import DEFAULT
from fitting.discovery import _remainder as module
from fitting.discovery._lack_of_fit import HarmonicTest
from fitting.discovery._named_effect import FormTest
from fitting.discovery._refine import with_shape_parameter
from fitting.discovery._remainder import (
    Torques,
    better_law,
    grade,
    nuisance_parameters,
    ranges_of,
    smooth_law,
)
from fitting.discovery._residuals import ResidualTorque
from fitting.discovery._select import Selection
from fitting.dynamics._collocation import Sampler
from fitting.effects._expression import Tape
from fitting.inference._periodogram import PeriodogramPeak
from fitting.inference._smooth_test import SmoothTest

DRAG, BEARING = "casing.air.quadratic", "bearing.quadratic"
UNBALANCE = "casing.unbalance"
K = 4e-8


def lawful(*names, cases=("case",), **strengths):
    """Return the gyroscope with more laws: drag, bearing and unbalance of some strengths, and a phase."""
    keys = {
        "drag": f"{DRAG}.k",
        "bearing": f"{BEARING}.e",
        "unbalance": f"{UNBALANCE}.k",
        "phi": f"{UNBALANCE}.phi",
    }
    return gyroscope((*LINEAR, *names), {keys[n]: x for n, x in strengths.items()}, cases=cases)


def speeds(fit, case=0):
    """Return the speeds of both bodies at the times of the comparison."""
    t = np.linspace(*fit.problem.data[case].record.span, 2000)
    path = fit.predictions[case].path
    return Sampler(path.mesh, t).value(path.y)[:, :2].T


class TestTorques:
    def test_the_net_torque_of_a_law_is_the_difference_of_two_fits(self):
        end = lawful(DRAG, drag=K)
        (((rotor, casing), harmonics),) = Torques(lawful(), end, residual=False).unmodelled
        speed = speeds(end)[1]
        assert rotor == pytest.approx(np.zeros(2000), abs=1e-14)
        assert casing == pytest.approx(-K * speed * np.abs(speed), abs=1e-14)
        assert harmonics == {}

    def test_a_law_of_the_bearing_acts_on_both_bodies(self):
        end = lawful(BEARING, bearing=1e-11)
        (((rotor, casing), _),) = Torques(lawful(), end, residual=False).unmodelled
        delta = np.subtract(*speeds(end))
        assert casing == pytest.approx(1e-11 * delta**2, abs=1e-14)
        assert rotor == pytest.approx(-casing, abs=1e-14)

    @pytest.mark.parametrize(
        ("share", "left"), [(1.0, 0.0), (0.5, 0.25), (1.5, 0.25), (0.0, 1.0), (2.5, 1.0), (-1.0, 1.0)]
    )
    def test_the_unexplained_share_is_that_of_the_mean_square(self, share, left):
        """A fit with a part of the drag; one that makes it worse leaves all of it."""
        end = lawful(DRAG, drag=K)
        torques = Torques(lawful(), end, residual=False)
        found, rms = torques.remaining(lawful(DRAG, drag=share * K))
        assert found == pytest.approx(left, abs=1e-9)
        whole = K * math.sqrt(np.mean(speeds(end)[1] ** 4))
        assert rms == pytest.approx(math.sqrt(left) * whole, rel=1e-6, abs=1e-15)

    def test_the_rms_is_that_of_the_body_with_more_of_it(self):
        end = gyroscope((*LINEAR, DRAG, BEARING), {f"{DRAG}.k": K, f"{BEARING}.e": 2e-11})
        omega_r, omega_c = speeds(end)
        rotor = 2e-11 * (omega_r - omega_c) ** 2
        casing = rotor - K * omega_c**2
        share, rms = Torques(lawful(), end, residual=False).remaining(lawful())
        assert share == 1.0
        assert rms == pytest.approx(math.sqrt(max(np.mean(rotor**2), np.mean(casing**2))), rel=1e-6)
        of_drag = gyroscope((*LINEAR, DRAG), {f"{DRAG}.k": K})
        share, rms = Torques(lawful(), end, residual=False).remaining(of_drag)
        assert share == pytest.approx(
            min(2 * np.mean(rotor**2) / (np.mean(rotor**2) + np.mean(casing**2)), 1.0), rel=1e-6
        )

    def test_angle_dependent_torques_count_by_their_amplitudes(self):
        """<(k sin)^2> = k^2 / 2; a fit with another phase leaves |k e^(i a) - k' e^(i b)|^2 / 2."""
        end = lawful(DRAG, UNBALANCE, drag=K, unbalance=3e-5, phi=0.4)
        torques = Torques(lawful(), end, residual=False)
        named = lawful(DRAG, UNBALANCE, drag=K, unbalance=2e-5, phi=1.0)
        apart = abs(3e-5 * np.exp(0.4j) - 2e-5 * np.exp(1.0j)) ** 2 / 2
        drag = K**2 * np.mean(speeds(end)[1] ** 4)
        share, rms = torques.remaining(named)
        assert share == pytest.approx(apart / (drag + 4.5e-10), rel=1e-4)
        assert rms == pytest.approx(math.sqrt(apart), rel=1e-4)
        assert torques.of_angle(named) == pytest.approx(math.sqrt(apart))
        assert torques.of_angle(lawful(DRAG, drag=K)) == pytest.approx(3e-5 / math.sqrt(2))
        assert torques.remaining(named, slow=True)[0] == pytest.approx(0.0, abs=1e-4)
        assert torques.remaining(lawful(UNBALANCE, unbalance=3e-5, phi=0.4), slow=True)[0] == pytest.approx(
            1.0, abs=1e-4
        )

    def test_an_angle_dependent_torque_in_the_base_is_subtracted(self):
        base = lawful(UNBALANCE, unbalance=1e-5, phi=0.2)
        end = lawful(DRAG, UNBALANCE, drag=K, unbalance=3e-5, phi=0.4)
        ((_, harmonics),) = Torques(base, end, residual=False).unmodelled
        assert harmonics == {(1, UNBALANCE): pytest.approx(3e-5 * np.exp(0.4j) - 1e-5 * np.exp(0.2j))}
        ((_, removed),) = Torques(base, lawful(DRAG, drag=K), residual=False).unmodelled
        assert removed == {(1, UNBALANCE): pytest.approx(-1e-5 * np.exp(0.2j))}

    def test_cases_count_by_their_mean(self):
        cases = ("a", "b")
        names = (*LINEAR, DRAG)

        def of(a, b):
            return gyroscope(names, {f"{DRAG}.k@a": a, f"{DRAG}.k@b": b}, cases=cases, per_case=[DRAG])

        base, end = gyroscope(cases=cases), of(K, 2 * K)
        torques = Torques(base, end, residual=False)
        share, rms = torques.remaining(of(K, K))
        squares = [np.mean(speeds(end, i)[1] ** 4) for i in (0, 1)]
        assert share == pytest.approx(squares[1] / (squares[0] + 4 * squares[1]), rel=1e-6)
        assert rms == pytest.approx(K * math.sqrt(squares[1] / 2), rel=1e-6)

    @pytest.mark.parametrize(("of_end", "of_base", "from_base"), [(1.0, 2.0, False), (2.0, 1.0, True)])
    def test_the_unmodelled_torque_of_the_better_fit_is_added(self, monkeypatch, of_end, of_base, from_base):
        base, end = lawful(), lawful(DRAG, drag=K)
        time = np.array([2.0, 8.0])

        def curves(fit):
            size = of_base if fit is base else of_end
            return [
                ResidualTorque("case", body, time, x * size * np.ones(2), time, time, time)
                for body, x in (("casing", 1e-6), ("rotor", -3e-6))
            ]

        monkeypatch.setattr(module, "residual_torques", curves)
        (((rotor, casing), _),) = Torques(base, end, residual=True).unmodelled
        t = np.linspace(*end.problem.data[0].record.span, 2000)
        within = (t > 2.0) & (t < 8.0)
        drag = 0.0 if from_base else -K * speeds(end)[1] ** 2
        size = of_base if from_base else of_end
        assert casing == pytest.approx(drag + 1e-6 * size * within, abs=1e-12)
        assert rotor == pytest.approx(-3e-6 * size * within, abs=1e-12)

    @pytest.mark.parametrize(("name", "key", "bodies"), [(DRAG, "k", 1), (BEARING, "e", 2)])
    def test_the_error_of_a_shape_is_what_the_best_scaled_law_leaves(self, name, key, bodies):
        """A power 1.7 of the speed beside the square; a law of the bearing acts on both bodies."""
        law, strength = LIBRARY[name], {DRAG: K, BEARING: 1e-11}[name]
        freed = with_shape_parameter(law)
        end = gyroscope((*LINEAR, name), {f"{name}.{key}": 2 * strength})
        own = {f"{name}.{key}": 3 * strength, f"{name}.n": 1.7}
        fit = gyroscope(Laws.of(LINEAR).with_effect(freed), own)
        omega_r, omega_c = speeds(end)
        speed = omega_c if name == DRAG else omega_r - omega_c
        power, square = np.abs(speed) ** 1.7, speed**2
        rest = power - square * (power @ square) / (square @ square)
        left = (3 * strength) ** 2 * np.mean(rest**2)
        torques = Torques(lawful(), end, residual=False)
        of_unmodelled, of_law, rms = torques.shape_error(law, freed, fit)
        assert of_unmodelled == pytest.approx(left / np.mean((2 * strength * square) ** 2), rel=1e-4)
        assert of_law == pytest.approx(np.mean(rest**2) / np.mean(power**2), rel=1e-4)
        assert rms == pytest.approx(math.sqrt(left), rel=1e-4)
        # no more than all of it
        tiny = gyroscope((*LINEAR, name), {f"{name}.{key}": 1e-3 * strength})
        assert Torques(lawful(), tiny, residual=False).shape_error(law, freed, fit)[0] == 1.0

    def test_the_rms_of_an_error_of_a_shape_is_the_mean_of_the_cases(self):
        law = LIBRARY[DRAG]
        freed = with_shape_parameter(law)
        values = {f"{DRAG}.k": K, f"{DRAG}.n": 1.7}

        def found(cases):
            end = lawful(DRAG, drag=K, cases=cases)
            fit = gyroscope(Laws.of(LINEAR).with_effect(freed), values, cases=cases)
            return Torques(lawful(cases=cases), end, residual=False).shape_error(law, freed, fit)

        assert found(("a", "b")) == pytest.approx(found(("a",)), rel=1e-6)

    def test_a_slow_residual_takes_the_place_of_the_curves_of_its_case(self, monkeypatch):
        base, end = lawful(), lawful(DRAG, drag=K)
        time = np.array([2.0, 20.0])
        curves = [ResidualTorque("case", "casing", time, 1e-6 * np.ones(2), time, time, time)]
        monkeypatch.setattr(module, "residual_torques", lambda fit: curves)
        monkeypatch.setattr(module, "_slow_residual", lambda fit, case: (time, 5e-6 * np.ones(2)))
        (((rotor, casing), _),) = Torques(base, end, residual=True).unmodelled
        assert casing == pytest.approx(5e-6 - K * speeds(end)[1] ** 2, abs=1e-12)
        assert rotor == pytest.approx(np.zeros(2000), abs=1e-14)

    def test_of_the_base_alone_its_own_curves_are_all(self, monkeypatch):
        base = lawful()
        time = np.array([2.0, 20.0])
        asked = []

        def curves(fit):
            asked.append(fit)
            return [ResidualTorque("case", "casing", time, 1e-6 * np.ones(2), time, time, time)]

        monkeypatch.setattr(module, "residual_torques", curves)
        (((_, casing), _),) = Torques(base, base, residual=True).unmodelled
        assert casing == pytest.approx(1e-6 * np.ones(2000))
        assert asked == [base]

    @pytest.mark.parametrize(("of_end", "of_fit"), [(True, True), (True, False), (False, False)])
    def test_net_torques_are_those_along_the_motion_of_the_last_fit(self, monkeypatch, of_end, of_fit):
        """A temperature is that of the fit, and a deflection that of the motion about the equilibrium of the fit."""
        monkeypatch.setattr(module, "Sampler", lambda mesh, t: SimpleNamespace(value=np.copy))
        states = {"omega_r": [1.0, 2.0], "omega_c": [3.0, 4.0], "deflection": [0.1, 0.3]}
        own = {"omega_r": [9.0, 9.0], "omega_c": [8.0, 8.0], "T": [5.0, 6.0], "deflection": [1.5, 2.5]}
        asked = []

        def rates(t, y, numbers):
            asked.append((t, y.T.tolist(), numbers))
            return np.array([[1.0, 10.0], [2.0, 20.0]])

        def fit(columns, restoring, numbers):
            path = SimpleNamespace(mesh=None, y=np.array(list(columns.values())).T, states=tuple(columns))
            return SimpleNamespace(
                predictions=[SimpleNamespace(path=path)], model=SimpleNamespace(restoring=restoring), theta=None,
                problem=SimpleNamespace(
                    cases=[SimpleNamespace(dynamics=SimpleNamespace(rates=rates))],
                    layout=SimpleNamespace(numbers=lambda theta, case: numbers),
                ),
            )  # fmt: skip

        inertia = {module.INERTIA_ROTOR: 3.0, module.INERTIA_CASING: 0.5}
        torques = Torques.__new__(Torques)
        torques._time = ["times"]
        torques._end = fit(states, of_end, {"a.k": 7.0, "b.k": 8.0} | inertia)
        rotor, casing = torques._smooth(fit(own, of_fit, {"a.k": 1.0} | inertia), 0)
        assert (rotor.tolist(), casing.tolist()) == ([3.0, 6.0], [5.0, 10.0])
        ((t, y, numbers),) = asked
        assert t == "times"
        assert y[:3] == [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
        assert y[3] == pytest.approx([1.9, 2.1])
        # without a restoring torque its other parameters have no meaning beside an oscillation
        assert numbers == {"a.k": 7.0 if of_end and not of_fit else 1.0} | inertia

    def test_amplitudes_of_laws_of_an_angle(self):
        found = module._amplitudes(lawful(UNBALANCE, unbalance=2.0, phi=0.5), 0)
        assert found == {(1, UNBALANCE): pytest.approx(2.0 * np.exp(0.5j))}

    def test_ranges_of_the_speeds(self):
        fit = lawful()
        found = ranges_of(fit)
        omega_r, omega_c = speeds(fit)
        for name, x in (("omega_r", omega_r), ("omega_c", omega_c), ("delta", omega_r - omega_c)):
            assert found[name] == pytest.approx((x.min(), x.max()), rel=1e-3)

    def test_the_slow_torque_of_an_oscillation_is_in_quadrature_and_in_phase(self, monkeypatch):
        """Residuals a = 1e-3 t of the amplitude and p = 2e-3 t of the phase, w = 3 rad/s, A = 0.5: 2 w a', 2 w A p'."""
        time = np.linspace(0.0, 10.0, 50)
        motion = SimpleNamespace(time=time, amplitude=np.full(50, 0.5), phase=3.0 * time)
        fine = np.linspace(0.0, 10.0, 400)
        oscillation = SimpleNamespace(slow_motion=motion, time=fine, phase=lambda t: 3.0 * t)
        data = SimpleNamespace(motion=oscillation, record=SimpleNamespace(I_casing=2.0))
        end = SimpleNamespace(
            problem=SimpleNamespace(data=[data]), model=SimpleNamespace(restoring=True), predictions=[None],
            noise=[None],
        )  # fmt: skip
        rows = np.concatenate([1e-3 * time, 2e-3 * time])
        fitted = SimpleNamespace(phase_error=0.0, rows=[(None, None, rows / 7.0)], scales=[7.0])
        monkeypatch.setattr(module, "averaged_fit", lambda model, data: fitted)
        monkeypatch.setattr(module, "fails_grossly", lambda *_: True)
        t, torque = module._slow_residual(end, 0)
        assert torque == pytest.approx(2.0 * (6.0 * 0.5 * 2e-3 * np.cos(3 * t) - 6.0 * 1e-3 * np.sin(3 * t)))
        fitted.phase_error = 1e9
        assert module._slow_residual(end, 0) is None
        fitted.phase_error = 0.0
        monkeypatch.setattr(module, "fails_grossly", lambda *_: False)
        assert module._slow_residual(end, 0) is None
        monkeypatch.setattr(module, "fails_grossly", lambda *_: True)
        end.model.restoring = False
        assert module._slow_residual(end, 0) is None


class Model(SimpleNamespace):
    @property
    def names(self):
        return tuple(e.name for e in self.effects)


def estimate(value=1.0, stderr=0.1, unit="1"):
    return Estimate(value, stderr, unit, at_bound=False)


@dataclass(frozen=True, eq=False)
class Found:
    """A fit, as far as a grade depends on it."""

    @staticmethod
    def name(effect):
        return effect_name(getattr(effect, "name", effect))

    model: object
    bic: float = 100.0
    deviance: float = 100.0
    theta: object = ()
    converged: bool = True
    noise: tuple = ()
    torque_unit: str = "N m"
    estimates: object = field(default_factory=dict)
    p_value: float = 1.0
    chi2: float = 10.0

    @property
    def lack_of_fit(self):
        return SimpleNamespace(p_value=self.p_value, chi2=self.chi2, dof=10)


def found(*effects, **options):
    return Found(Model(effects=tuple(LIBRARY.get(e, e) for e in effects)), **options)


def candidate(name=DRAG, *, value=50.0, fit=None, significant=True):
    effect = LIBRARY[name]
    screened = SimpleNamespace()
    return Candidate(effect, value, -40.0, 1e-6, 0.0, (), {}, significant, screened, fit or found(name))


STRONG = FormTest(0.1, "omega_c", (), 1.0, any_in_time=False)


class TestBetterLaw:
    @pytest.mark.parametrize(
        ("bic", "named", "end", "better"),
        [
            (97.9, 100.0, 90.0, True),
            (98.1, 100.0, 90.0, False),  # no evidence over the named effect
            (97.9, 100.0, 87.0, False),  # worse than the most complete fit by more than the width
        ],
    )
    def test_a_law_of_another_speed_needs_evidence(self, monkeypatch, bic, named, end, better):
        laws = [(found(bic=bic + 5.0), "delta"), (found(bic=bic), "omega_r")]
        monkeypatch.setattr(module, "_with_smooth_laws", lambda *_: iter(laws))
        base = SimpleNamespace(noise=())
        speed = better_law(base, found(bic=named), found(bic=end), LIBRARY[DRAG], DEFAULT)
        assert speed == ("omega_r" if better else "")
        monkeypatch.setattr(module, "_with_smooth_laws", lambda *_: iter(()))
        assert better_law(base, found(bic=named), found(bic=end), LIBRARY[DRAG], DEFAULT) == ""

    def laws(self, monkeypatch, effect, *, parts=("casing", "rotor"), restoring=False, failing=()):
        asked = []

        def fit(model, base, *, start, noise, quick):
            asked.append(start)
            if model.name.rpartition(" ")[2] in failing:
                raise EstimationError("it diverges", "")
            return model

        monkeypatch.setattr(module, "fit", fit)
        monkeypatch.setattr(
            module, "ranges_of", lambda _: dict.fromkeys(("omega_r", "omega_c", "delta"), (1.0, 3.0))
        )
        record = SimpleNamespace(parts=frozenset(parts))
        base = SimpleNamespace(
            model=SimpleNamespace(restoring=restoring, with_effect=lambda law: law),
            problem=SimpleNamespace(data=[SimpleNamespace(record=record)]), values={"a.k": 2.0},
        )  # fmt: skip
        speeds = [speed for _, speed in module._with_smooth_laws(base, LIBRARY[effect], ())]
        assert all(s["a.k"] == 2.0 and set(s.values()) == {0.0, 2.0} for s in asked)
        return speeds

    @pytest.mark.parametrize(
        ("effect", "speeds"),
        [
            (DRAG, ["omega_r", "delta"]),
            ("rotor.air.linear", ["omega_c", "delta"]),
            ("casing.windage", ["omega_c", "omega_r", "delta"]),  # on the casing, but of the rotor's speed
            ("touchpoint.drift", ["omega_c", "omega_r", "delta"]),
            (BEARING, ["omega_c", "omega_r"]),
            ("casing.gravity", []),
        ],
    )
    def test_a_smooth_law_of_each_other_speed_is_tried(self, monkeypatch, effect, speeds):
        assert self.laws(monkeypatch, effect) == speeds

    def test_of_a_body_alone_the_casing_is_tried(self, monkeypatch):
        assert self.laws(monkeypatch, "touchpoint.drift", parts=["casing"]) == ["omega_c"]
        assert self.laws(monkeypatch, DRAG, parts=["casing"]) == []

    def test_a_law_whose_fit_fails_is_left_out(self, monkeypatch):
        assert self.laws(monkeypatch, DRAG, failing=("omega_r",)) == ["delta"]


def test_a_smooth_law_is_a_cubic_spline_with_four_inner_knots():
    law = smooth_law("bearing", "delta", (0, 2, 3), 10.0, 30.0)
    x = np.linspace(0.0, 1.0, 7)
    terms = [x**0, x**2, x**3, *(np.abs(x - k) ** 3 for k in (0.2, 0.4, 0.6, 0.8))]
    names = [p.symbol for p in law.parameters]
    assert len(names) == len(terms)
    assert all(p.lower == -np.inf for p in law.parameters)
    for name, term in zip(names, terms, strict=True):
        known = {"delta": 10.0 + 20.0 * x} | {n: float(n == name) for n in names}
        assert np.asarray(Tape([law.expression])(known)[0]) * np.ones(7) == pytest.approx(term)


class TestComplete:
    """The grade of an effect with which the residuals are consistent with noise."""

    def graded(self, monkeypatch, laws, tested=STRONG):
        monkeypatch.setattr(module, "_with_smooth_laws", lambda *_: iter(laws))

        class Shares:
            def __init__(self, base, end, *, residual):
                assert not residual

            def remaining(self, fit):
                return 0.3, 1e-6

        monkeypatch.setattr(module, "Torques", Shares)
        named = found(DRAG)
        selection = Selection([], None, named, named)
        return module._complete(found(), selection, candidate(), tested, DEFAULT)

    def test_without_a_test_of_the_form_it_is_exact(self, monkeypatch):
        size = self.graded(monkeypatch, [], None)
        assert (size.form, size.explained, size.remainder) == ("exact", 1.0, None)

    @pytest.mark.parametrize(
        ("tested", "form"),
        [
            (STRONG, "exact"),
            (replace(STRONG, limit=0.3), None),
            (replace(STRONG, any_in_time=True), None),
            (replace(STRONG, bounds_p=1e-3), None),
        ],
    )
    def test_a_form_needs_a_strong_test(self, monkeypatch, tested, form):
        size = self.graded(monkeypatch, [], tested)
        assert (size.form, size.explained, size.remainder, size.rivals) == (form, 1.0, None, ())

    @pytest.mark.parametrize(
        ("bic", "deviance", "form", "rivals"),
        [
            (109.0, 109.0, None, 1),  # within the width
            (111.0, 109.0, None, 0),  # its parameters describe the data as well
            (111.0, 111.0, "exact", 0),
            (90.1, 109.0, None, 1),
        ],
    )
    def test_laws_of_other_speeds_are_rivals(self, monkeypatch, bic, deviance, form, rivals):
        size = self.graded(monkeypatch, [(found(bic=bic, deviance=deviance), "delta")])
        assert (size.form, len(size.rivals), size.unknown) == (form, rivals, "")
        assert not rivals or "delta" in size.rivals[0]

    def test_a_much_better_law_is_named_as_unknown(self, monkeypatch):
        better = found(bic=100.0 - DEFAULT.shape_evidence - 0.1, deviance=70.0, theta=(0,) * 4)
        size = self.graded(monkeypatch, [(better, "delta"), (found(bic=95.0), "omega_r")])
        assert (size.form, size.explained, size.unknown) == (None, 0.7, "delta")
        assert (size.remainder.share, size.remainder.torque_rms_Nm) == (0.3, 1e-6)
        assert size.remainder.p_value == pytest.approx(chi2(4).sf(30.0))


class TestGrade:
    """Of a drag, with what `Torques` leaves of it and what a form test says given."""

    def graded(
        self, monkeypatch, *, share=0.02, misfit=False, doubt=None, effect=DRAG, end=None, alone=0.5,
        of_angle=0.0, shape=(0.0, 0.0, 0.0), better="", harmonic_p=1.0, smooth_p=1.0, rivals=(), converged=True,
        p_value=1.0,
    ):  # fmt: skip
        asked = self.asked = []

        class Shares:
            def __init__(self, base, end, *, residual):
                self.end = end
                asked.append((end, residual))

            def remaining(self, fit, *, slow=False):
                asked.append(slow)
                if fit in self.rival_shares:
                    return self.rival_shares[fit], 1e-6
                return (alone if self.end is named and final is not named else share), 1e-6

            def of_angle(self, fit):
                return of_angle

            def shape_error(self, law, freed, fit):
                return shape

        monkeypatch.setattr(module, "Torques", Shares)
        monkeypatch.setattr(module, "form_test", lambda *_: STRONG)
        monkeypatch.setattr(module, "better_law", lambda *_: better)
        monkeypatch.setattr(module, "harmonic_test", lambda fit, criteria: HarmonicTest(3, harmonic_p))
        monkeypatch.setattr(module, "_with_smooth_laws", lambda *_: iter(()))
        named = found(effect, deviance=80.0, converged=converged, theta=(0,) * 2, chi2=14.0)
        final = end = named if end is None else end
        object.__setattr__(end, "p_value", p_value)
        object.__setattr__(end, "smooth_test", SmoothTest("casing", smooth_p))
        chosen = candidate(effect, fit=named)
        others = [candidate(n, value=v, fit=found(n)) for n, v, _ in rivals]
        Shares.rival_shares = {c.fit: s for c, (_, _, s) in zip(others, rivals, strict=True)}
        selection = Selection([chosen, *others], chosen, named, end)
        return grade(found(), selection, doubt, DEFAULT, misfit=misfit)

    def test_without_an_effect_there_is_no_grade(self):
        selection = Selection([], None, found(), found())
        assert grade(found(), selection, None, DEFAULT, misfit=False) == module.Grade(None, None, None)

    def test_nothing_significant_is_complete(self, monkeypatch):
        size = self.graded(monkeypatch)
        assert (size.form, size.explained, size.remainder) == ("exact", 1.0, None)

    @pytest.mark.parametrize(("share", "form"), [(0.049, "approximate"), (0.051, None)])
    def test_an_approximate_answer_explains_95_percent(self, monkeypatch, share, form):
        size = self.graded(monkeypatch, share=share, misfit=True)
        assert (size.form, size.explained) == (form, pytest.approx(1 - share))
        assert size.remainder.share == share
        assert "a lack of fit of unknown form" in size.remainder.sentence
        assert self.asked[0] == (self.asked[0][0], True)

    @pytest.mark.parametrize(
        ("p", "words"),
        [
            (0.0009, "depends on the speed of the casing."),
            (0.0011, "depends on the speed of the casing (p = 0.001)."),
            (0.009, "depends on the speed of the casing (p = 0.009)."),
            (0.011, "unknown form"),
        ],
    )
    def test_the_smooth_test_says_what_a_misfit_depends_on(self, monkeypatch, p, words):
        size = self.graded(monkeypatch, misfit=True, smooth_p=p, p_value=1e-7)
        assert words in size.remainder.sentence
        assert size.remainder.p_value == 1e-7  # the smaller one

    def test_a_contradicting_test_is_significant_too(self, monkeypatch):
        size = self.graded(monkeypatch, doubt=SmoothTest("rotor", 1e-4))
        assert size.remainder.p_value == 1e-4
        assert "depends on the speed of the rotor" in size.remainder.sentence

    def test_a_second_effect_is_a_remainder(self, monkeypatch):
        end = found(DRAG, "touchpoint.step", deviance=60.0, theta=(0,) * 4)
        size = self.graded(monkeypatch, share=0.02, end=end)
        assert (
            "second effect step of the friction at the touch point (touchpoint.step)"
            in size.remainder.sentence
        )
        assert size.remainder.effects == ("touchpoint.step",)
        assert size.remainder.p_value == pytest.approx(chi2(2).sf(20.0))
        assert size.form == "approximate"
        assert self.asked[0] == (end, False)

    @pytest.mark.parametrize(
        ("share", "alone", "converged", "strength", "explained"),
        [
            (0.4, 0.3, True, 2.9, 0.7),
            (0.4, 0.6, True, 2.9, 0.6),
            (0.4, 0.3, False, 2.9, 0.6),
            (0.02, 0.01, True, 2.9, 0.98),
            (0.4, 0.3, True, 3.1, 0.6),  # the second effect is determined
        ],
    )
    def test_beside_an_undetermined_second_effect_the_smaller_remainder_counts(
        self, monkeypatch, share, alone, converged, strength, explained
    ):
        estimates = {"touchpoint.step.k": Estimate(strength, 1.0, "N m", at_bound=False)}
        end = found(DRAG, "touchpoint.step", deviance=60.0, theta=(0,) * 4, estimates=estimates)
        size = self.graded(monkeypatch, share=share, alone=alone, end=end, converged=converged)
        assert size.explained == pytest.approx(explained)

    def test_angle_dependent_torques_are_stated_beside_the_share(self, monkeypatch):
        end = found(DRAG, UNBALANCE, deviance=60.0, theta=(0,) * 4)
        size = self.graded(monkeypatch, end=end, of_angle=2e-3)
        assert "of the mean square slow unmodelled torque" in size.remainder.sentence
        assert "an angle-dependent torque of 2 mN m rms" in size.remainder.sentence
        size = self.graded(monkeypatch, end=end)
        assert "slow" not in size.remainder.sentence
        assert "angle-dependent torque" not in size.remainder.sentence

    @pytest.mark.parametrize(
        ("share", "shape", "explained", "whole"),
        [
            (0.30, (0.25, 0.01, 3e-6), 0.99, "torque of the quadratic air drag of the casing"),
            (0.30, (0.25, 0.06, 3e-6), 0.75, "unmodelled torque"),
            (0.30, (0.35, 0.06, 3e-6), 0.70, "unmodelled torque"),
            (0.03, (0.04, 0.01, 3e-6), 0.97, "unmodelled torque"),
        ],
    )
    def test_of_a_free_shape_the_torque_of_the_law_counts(self, monkeypatch, share, shape, explained, whole):
        law = with_shape_parameter(LIBRARY[DRAG])
        estimates = {f"{DRAG}.n": estimate(1.9, 0.01)}
        end = found(law, deviance=60.0, theta=(0,) * 3, estimates=estimates)
        size = self.graded(monkeypatch, share=share, shape=shape, end=end)
        assert size.explained == pytest.approx(explained)
        assert f"of the mean square {whole}" in size.remainder.sentence
        assert (
            "shape of the quadratic air drag of the casing: exponent 1.900 +- 0.010"
            in size.remainder.sentence
        )
        # of a significant lack of fit only the unmodelled torque counts
        if whole.startswith("torque of"):
            size = self.graded(monkeypatch, share=share, shape=shape, end=end, misfit=True)
            assert size.explained == pytest.approx(0.75)

    def test_a_better_law_of_another_speed_is_not_an_approximate_answer(self, monkeypatch):
        size = self.graded(monkeypatch, misfit=True, better="omega_r")
        assert (size.form, size.unknown) == (None, "omega_r")
        size = self.graded(monkeypatch, misfit=True, better="omega_r", effect=UNBALANCE)
        assert (size.form, size.unknown) == ("approximate", "")

    @pytest.mark.parametrize(("p", "taken"), [(0.0009, True), (0.0011, False)])
    def test_a_harmonic_beside_a_law_of_the_angle_is_its_remainder(self, monkeypatch, p, taken):
        end = found(UNBALANCE, "touchpoint.step", deviance=60.0, theta=(0,) * 4)
        size = self.graded(monkeypatch, effect=UNBALANCE, misfit=True, end=end, harmonic_p=p)
        assert ("contains harmonic 3" in size.remainder.sentence) is taken
        assert ("second effect" in size.remainder.sentence) is not taken

    def test_a_sinusoid_states_its_own_size(self, monkeypatch):
        none = HarmonicTest(3, 1e-5)  # of undetermined amplitude
        assert "of the mean square" not in self.graded(monkeypatch, doubt=none).remainder.sentence
        peak = PeriodogramPeak(2.0, 1e-6, 1e-4, "case", "casing", 1e-5, "k*sin(2*t)")
        assert "of the mean square" in self.graded(monkeypatch, doubt=peak).remainder.sentence

    @pytest.mark.parametrize(
        ("value", "share", "rival"),
        [
            (50.0 - 3.9, 0.039, True),
            (50.0 - 4.1, 0.039, False),  # worse by more than the lack of fit of the named effect, 14 - 10
            (50.0 - 3.9, 0.041, False),  # leaves more than twice as much
        ],
    )
    def test_rivals_explain_as_much(self, monkeypatch, value, share, rival):
        size = self.graded(
            monkeypatch, share=0.02, misfit=True, rivals=[("casing.air.laminar", value, share)]
        )
        assert size.rivals == (("casing.air.laminar",) if rival else ())
        # an artefact is no rival of physics
        size = self.graded(monkeypatch, share=0.02, misfit=True, rivals=[("setup.inertia", value, share)])
        assert size.rivals == ()

    def test_the_margin_of_rivals_is_at_least_the_gain_of_the_final_fit(self, monkeypatch):
        end = found(DRAG, "touchpoint.step", deviance=60.0, theta=(0,) * 4)
        for value, rival in ((50.0 - 19.0, True), (50.0 - 21.0, False)):
            size = self.graded(monkeypatch, end=end, rivals=[("casing.air.laminar", value, 0.02)])
            assert bool(size.rivals) is rival


@pytest.mark.parametrize(
    ("smaller", "larger", "fall", "p"),
    [
        (3, 5, 9.0, chi2(2).sf(9.0)),
        (3, 4, 9.0, chi2(1).sf(9.0)),
        (3, 3, 9.0, 1.0),
        (4, 3, 9.0, 1.0),
        (3, 4, -2.0, 1.0),
    ],
)
def test_the_likelihood_ratio_of_nested_fits(smaller, larger, fall, p):
    one, other = (found(theta=(0,) * n, deviance=x) for n, x in ((smaller, 50.0), (larger, 50.0 - fall)))
    assert module._likelihood_ratio(one, other) == pytest.approx(p)


@pytest.mark.parametrize("held", ["", "touchpoint.constant.b1"])
def test_amplitudes_of_the_camera_are_those_of_least_squares(held):
    """All free columns together at the pure noise, without that of a bound; the shutter is divided by the speed.

    Blur has no columns: the samples are not those of a film.
    """
    rows = 3.0 * np.random.default_rng(2).standard_normal(len(gyroscope().predictions[0].rows))
    base = gyroscope(values={held: 0.0}, level=1e-7, residual=[rows])
    base.noise[0].tested = 3e-8
    (data,) = base.problem.data
    assert data.has_camera_prior
    moving = [i for i, n in enumerate(base.problem.layout.names) if n.partition("@")[0] != held]
    columns = np.concatenate([base.predictions[0].jacobian[:, moving], data.nuisance], axis=1)
    root = np.linalg.cholesky(covariance(base, 3e-8))
    white, size = np.linalg.solve(root, columns), np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    inverse = np.linalg.pinv(white / size, rcond=1e-6)
    values = inverse @ np.linalg.solve(root, rows) / size
    inner = inverse @ inverse.T / np.outer(size, size)
    samples = data.casing.samples
    speed = np.abs(np.gradient(samples.value[::25], samples.time[::25])).max()
    seen = {n.effect: n for n in nuisance_parameters(base)}
    units = {"camera.centre": "rad", "camera.tilt": "rad", "camera.shutter": "s"}
    assert list(seen) == list(units)
    for i, (name, one) in enumerate(seen.items()):
        pair = values[-8 + 2 * i :][:2]
        own = inner[-8 + 2 * i :, -8 + 2 * i :][:2, :2]
        scale = speed if units[name] == "s" else 1.0
        amplitude = np.hypot(*pair)
        assert one.value * scale == pytest.approx(amplitude, rel=1e-3)
        along = pair / amplitude
        assert one.stderr * scale == pytest.approx(math.sqrt(along @ own @ along), rel=1e-3)
        assert one.p_value == pytest.approx(math.exp(-0.5 * pair @ np.linalg.solve(own, pair)), rel=1e-2)
        assert (one.unit, one.label) == (units[name], "case")


class TestSlowResidual:
    """An oscillation of 3 rad/s whose amplitude and phase differ from the model by 0.01 t and 0.02 t."""

    def residual(self, monkeypatch, *, gross=True, restoring=True, error=0.69, fits=True):
        time = np.linspace(0.0, 20.0, 81)
        motion = SimpleNamespace(time=time, amplitude=np.full(81, 0.5), phase=3.0 * time)
        rest = np.concatenate([0.01 * time, 0.02 * time]) / 0.1
        fitted = SimpleNamespace(phase_error=error, rows=[(None, None, rest)], scales=[np.full(162, 0.1)])
        asked = []
        monkeypatch.setattr(module, "fails_grossly", lambda d, p, n: asked.append((p, n)) or gross)
        monkeypatch.setattr(module, "averaged_fit", lambda model, data: fitted if fits else None)
        at = np.linspace(1.0, 19.0, 50)
        data = SimpleNamespace(
            motion=SimpleNamespace(slow_motion=motion, time=at, phase=lambda t: 3.0 * t),
            record=SimpleNamespace(I_casing=2e-3),
        )
        end = SimpleNamespace(
            problem=SimpleNamespace(data=["other", data]), model=SimpleNamespace(restoring=restoring),
            predictions=["p0", "p1"], noise=["n0", "n1"],
        )  # fmt: skip
        found = module._slow_residual(end, 1)
        assert asked in ([("p1", "n1")], [])
        return at, found

    def test_it_is_the_torque_that_changes_amplitude_and_phase(self, monkeypatch):
        t, (time, torque) = self.residual(monkeypatch)
        assert time is t
        expected = 2e-3 * (2 * 3.0 * 0.5 * 0.02 * np.cos(3 * t) - 2 * 3.0 * 0.01 * np.sin(3 * t))
        assert torque == pytest.approx(expected)

    def test_it_needs_a_gross_misfit_whose_phase_is_described(self, monkeypatch):
        for changed in ({"gross": False}, {"restoring": False}, {"error": 0.7}, {"fits": False}):
            assert self.residual(monkeypatch, **changed)[1] is None


def test_ranges_are_those_of_all_recordings():
    paths = [
        np.array([[[900.0, 5.0, 9.0], [700.0, 8.0, 9.0]]]),
        np.array([[[600.0, -2.0, 9.0], [650.0, 3.0, 9.0]]]),
    ]
    fit = SimpleNamespace(
        model=SimpleNamespace(mechanism=Laws.of(LINEAR).mechanism),
        predictions=[SimpleNamespace(path=SimpleNamespace(y=y)) for y in paths],
    )
    found = module.ranges_of(fit)
    assert found == {"omega_r": (600.0, 900.0), "omega_c": (-2.0, 8.0), "delta": (602.0, 895.0)}
