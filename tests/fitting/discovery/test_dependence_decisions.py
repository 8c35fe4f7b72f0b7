"""Tests of a dependence on one or two variables, and the curve, against dense matrices."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.discovery import _dependence as module

RNG = np.random.default_rng(4)
TIME = np.linspace(0.0, 30.0, 40)
MOTION = {
    "t": TIME,
    "omega_r": 900.0 * np.exp(-TIME / 20.0),
    "omega_c": 60.0 * np.sin(TIME / 12.0),
    "delta": 900.0 * np.exp(-TIME / 20.0) - 60.0 * np.sin(TIME / 12.0),
}


class Case:
    """Forty cells; the rows of the casing and of the rotor respond differently, and a further row does not."""

    response = SimpleNamespace(casing=RNG.standard_normal((70, 40)), rotor=RNG.standard_normal((70, 40)))

    def __init__(self, names=("k", "phi")):
        self.laws, self.sizes = [], {}

    @staticmethod
    def along_motion(variable):
        return MOTION[variable]

    @staticmethod
    def padded(columns):
        return np.concatenate([columns, np.zeros((1, columns.shape[1]))])

    def trials(self, law):
        self.laws.append(law)
        n = int(law.name.rpartition(".")[2])
        return [SimpleNamespace(columns=np.full((3, 2), n) * [1.0, 10.0])]


def about(parts=("casing", "rotor"), angle=None):
    data = SimpleNamespace(record=SimpleNamespace(parts=frozenset(parts)), measured_angle=angle)
    return SimpleNamespace(problem=SimpleNamespace(data=[data]))


class TestFunctions:
    def test_each_body_has_its_variables_and_pairs(self):
        tests = list(module._tests(about(), [Case(), Case()]))
        assert [(t.body, t.variables) for t in tests] == [
            ("casing", ("omega_c",)),
            ("casing", ("omega_r",)),
            ("casing", ("t",)),
            ("casing", ("omega_c", "omega_r")),
            ("casing", ("omega_c", "t")),
            ("bearing", ("delta",)),
            ("bearing", ("t",)),
            ("bearing", ("delta", "t")),
            ("bearing", ("delta", "omega_c")),
            ("rotor", ("omega_r",)),
            ("rotor", ("t",)),
        ]
        response = Case.response
        acting = {
            "casing": response.casing,
            "rotor": response.rotor,
            "bearing": response.casing - response.rotor,
        }
        for test in tests:
            w, values = acting[test.body], [MOTION[v] for v in test.variables]
            assert test.columns.shape[0] == 142
            assert not test.columns[[70, 141]].any()
            rows = test.columns[:70]
            assert (test.columns[71:141] == rows).all()
            # the functions add up to 1, and a cubic of each variable is a sum of them
            assert rows.sum(axis=1) == pytest.approx(w.sum(axis=1))
            for f in (*values, *(v**3 for v in values), np.prod(values, axis=0)):
                rest = w @ f - rows @ np.linalg.lstsq(rows, w @ f, rcond=1e-12)[0]
                assert np.linalg.norm(rest) < 1e-6 * np.linalg.norm(w @ f)
            if len(values) == 2:
                assert (len(test.value), test.priors) == (0, ())
                assert test.fine is test.columns
                assert test.basis.shape == (0, rows.shape[1])
            else:
                (v,) = values
                assert test.value == pytest.approx(np.linspace(v.min(), v.max(), 120))
                assert test.basis.shape == (120, test.fine.shape[1])
                assert test.fine.shape[1] > rows.shape[1]
                c = np.linalg.lstsq(test.basis, test.value**2, rcond=None)[0]
                assert test.fine[:70] @ c == pytest.approx(
                    w @ v**2, rel=1e-6, abs=1e-6 * np.abs(w @ v**2).max()
                )
                assert len(test.priors) == 9

    def test_a_body_alone_has_no_rotor(self):
        tests = list(module._tests(about(("casing",)), [Case()]))
        assert [(t.body, t.variables) for t in tests] == [
            ("casing", ("omega_c",)),
            ("casing", ("t",)),
            ("casing", ("omega_c", "t")),
        ]

    def test_the_prior_of_the_coefficients_is_that_of_matern(self):
        priors = module._Axis(np.array([0.0, 8.0]), 12).priors()
        assert len(priors) == 9
        knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 8.0, 10), [8.0] * 3])
        centres = np.array([knots[i + 1 : i + 4].mean() for i in range(12)])
        for length, prior in zip(np.geomspace(0.03, 3.0, 9) * 8.0, priors, strict=True):
            r = np.sqrt(3) * np.abs(centres[:, None] - centres) / length
            assert prior == pytest.approx((1 + r) * np.exp(-r))


class TestAngles:
    def test_the_angle_of_the_casing_has_a_curve_over_a_turn(self):
        cases = [Case(), Case()]
        test = module._angle_test(cases, "casing", "psi_c", (1, 3))
        assert [e.name for e in cases[0].laws] == ["harmonic.1", "harmonic.3"]
        for law, n in zip(cases[0].laws, (1, 3), strict=True):
            assert law.joint == "casing"
            at = {"psi_c": 0.4, "phi": 0.3, "k": 2.0}
            assert module_value(law, at) == pytest.approx(2.0 * np.sin(n * 0.4 - 0.3))
        assert test.columns.tolist() == [[1.0, 10.0, 3.0, 30.0]] * 6
        assert test.fine is test.columns
        psi = np.linspace(0.0, 2 * np.pi, 120)
        assert test.value == pytest.approx(psi)
        expected = [np.sin(psi), np.sin(psi - np.pi / 2), np.sin(3 * psi), np.sin(3 * psi - np.pi / 2)]
        assert test.basis == pytest.approx(np.transpose(expected))
        ((prior),) = test.priors
        assert (prior == np.eye(4)).all()

    def test_each_recording_has_its_own_phase_of_the_rotor(self):
        test = module._angle_test([Case(), Case()], "rotor", "psi_r", (2,))
        rows = [[2.0, 20.0, 0.0, 0.0]] * 3 + [[0.0, 0.0, 2.0, 20.0]] * 3
        assert test.columns.tolist() == rows
        assert (len(test.value), test.priors, test.basis.shape) == (0, (), (0, 4))

    def test_they_are_tested_where_the_angle_is_known(self, monkeypatch):
        monkeypatch.setattr(module, "_orders", lambda found, angle: {"psi_c": (1, 2), "psi_r": ()}[angle])
        tests = list(module._tests(about(), [Case()]))
        angles = [(t.body, t.columns.shape[1]) for t in tests if t.variables == ("psi_c",)]
        assert angles == [("casing", 4)]
        assert not [t for t in tests if t.variables == ("psi_r",)]


def module_value(law, at):
    from fitting.effects._expression import Tape

    return float(Tape([law.expression])(at)[0])


class TestCurve:
    """A torque of five functions of which the base absorbs one direction."""

    ROWS, FINE = 40, 5

    def setting(self, noise, seed=0, weak=0.02):
        rng = np.random.default_rng(seed)
        fine = rng.standard_normal((self.ROWS, self.FINE)) * [30.0, 20.0, 10.0, 1.0, weak]
        gain = rng.uniform(0.5, 2.0, self.ROWS)
        basis = np.linalg.qr(rng.standard_normal((self.ROWS, 2)))[0]
        white = gain[:, None] * (2.0 * fine)
        response = white - basis @ (basis.T @ white)
        residual = response @ [1.0, -2.0, 0.5, 0.3, 0.0] + noise * rng.standard_normal(self.ROWS)
        residual = residual - basis @ (basis.T @ residual)
        value = np.linspace(0.0, 1.0, 7)
        shapes = np.stack([np.ones(7), value, value**2, value**3, value**4], axis=1)
        apart = np.abs(np.arange(5)[:, None] - np.arange(5))
        priors = (np.eye(5), np.exp(-apart / 2.0))
        context = SimpleNamespace(rotated=lambda x: 2.0 * x)
        level = SimpleNamespace(gain=gain, basis=basis, residual=residual)
        test = module._Test("casing", ("t",), fine, fine, value, shapes, priors)
        return context, level, test, response

    def expected(self, level, test, response):
        free = np.linalg.qr(response)[0]
        rest = level.residual - free @ (free.T @ level.residual)
        scatter = max(1.0, rest @ rest / (self.ROWS - 2 - 5))
        best = None
        for prior in test.priors:
            root = np.linalg.cholesky(prior)
            a, r = response @ root / np.sqrt(scatter), level.residual / np.sqrt(scatter)
            u, s, vt = np.linalg.svd(a, full_matrices=False)
            unit = max(1.0, np.sqrt(np.mean((u.T @ r) ** 2))) / s[0]
            for strength in np.geomspace(1e-3, 1e5, 33) * unit:
                c = np.eye(self.ROWS) + strength**2 * a @ a.T
                deviance = np.linalg.slogdet(c)[1] + r @ np.linalg.solve(c, r)
                if best is None or deviance < best[0]:
                    known = strength**2 * s**2 > 1
                    back = test.basis @ root @ (vt[known].T / s[known]) @ u[:, known].T
                    best = deviance, back, back @ r, np.sqrt(scatter), known.sum()
        return best

    @pytest.mark.parametrize(
        ("noise", "weak", "rough"),
        [(1.0, 0.02, False), (0.2, 0.02, False), (6.0, 0.02, True), (1.0, 0.06, False)],
    )
    def test_it_is_the_determined_part_at_the_most_likely_strength(self, noise, weak, rough):
        context, level, test, response = self.setting(noise, weak=weak)
        _, back, torque, scatter, known = self.expected(level, test, response)
        assert known == (5 if weak > 0.02 else 4 if noise <= 1.0 else known)
        assert bool(scatter > 2.0) is rough
        found, sigma, identified = module._curve(context, level, test)
        assert found == pytest.approx(torque, rel=1e-4)
        assert sigma == pytest.approx(np.linalg.norm(back, axis=1), rel=1e-4)
        # the part of another torque that these data would show
        other = np.array([3.0, -1.0, 2.0, 0.7, 1.0])
        shown = back @ (response @ other) / scatter
        assert identified @ (test.basis @ other) == pytest.approx(shown, rel=1e-4)

    def test_pairs_and_harmonics_of_the_rotor_have_none(self):
        context, level, test, _ = self.setting(1.0)
        for changed in (test._replace(value=np.zeros(0)), test._replace(priors=())):
            assert [x.shape for x in module._curve(context, level, changed)] == [(0,), (0,), (0, 0)]


@pytest.mark.parametrize(("rest", "explained"), [(0.5, 1.0 - 2 / 200), (5.0, 198 / (200 + 15 * 25 - 15 - 2))])
def test_the_explained_share_is_that_of_the_excess_of_chi_square(rest, explained):
    """Of 20 rows with three free columns, two functions that fall by 200, and 15 rows of a residual."""
    residual = np.concatenate([np.zeros(3), [10.0, -10.0], np.full(15, rest)])
    level = SimpleNamespace(gain=np.ones(20), basis=np.eye(20)[:, :3], residual=residual, deviance=0.0)
    context = SimpleNamespace(levels=[level], draws=np.zeros((20, 7)), rotated=lambda c: c)
    test = module._Test("casing", ("t", "delta"), np.eye(20)[:, [3, 4]], None, np.zeros(0), None, ())
    found, null = module._tested(context, test)
    assert found.explained == pytest.approx(explained)
    assert (found.score, found.columns, found.variable, found.body) == (
        pytest.approx(200.0),
        2,
        "t*delta",
        "casing",
    )
    assert null.tolist() == [1.0] * 7


def test_functions_that_the_base_contains_are_not_tested():
    basis = np.eye(20)[:, :2]
    level = SimpleNamespace(gain=np.ones(20), basis=basis, residual=np.ones(20), deviance=0.0)
    context = SimpleNamespace(levels=[level], draws=np.ones((20, 7)), rotated=lambda c: c)
    test = module._Test("casing", ("t",), basis @ np.ones((2, 3)), None, np.zeros(0), None, ())
    found, null = module._tested(context, test)
    assert found is None
    assert null.tolist() == [1.0] * 7


def test_a_determined_part_is_that_of_its_projection():
    matrix = RNG.standard_normal((3, 3))
    found = module.Dependence("t", "casing", 0.1, 0.5, 1.0, 2, *[np.zeros(3)] * 3, matrix)
    assert found.comparable(np.array([1.0, 2.0, 3.0])) == pytest.approx(matrix @ [1.0, 2.0, 3.0])
