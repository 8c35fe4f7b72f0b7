"""Formulas behind rivals: information of rows, BIC and jackknife of an oscillation, sets of effects of one kind."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import LIBRARY
from fitting._criteria import DEFAULT
from fitting.discovery import _oscillator as oscillator
from fitting.discovery._information import rivals

RNG = np.random.default_rng(3)


class TestOscillation:
    def test_correlated_residuals_have_less_information(self):
        """Shares (1 - r) / (1 + r) with the correlation r of neighbours, not negative."""
        smooth = np.sin(np.arange(400) / 3.0)
        opposite = np.where(np.arange(400) % 2, 1.0, -1.0)
        rest = np.concatenate([smooth, opposite])
        shares = oscillator._information(SimpleNamespace(rows=[((), None, rest)]))
        r = math.cos(1 / 3.0)
        assert shares == pytest.approx([(1 - r) / (1 + r), 1.0], rel=0.05)

    def test_bic_counts_independent_residuals(self):
        rest = RNG.standard_normal(60)
        fitted = SimpleNamespace(rows=[(("a.k", "b.k"), None, rest)])
        shares = np.array([0.5, 0.25])
        expected = 0.5 * np.sum(rest[:30] ** 2) + 0.25 * np.sum(rest[30:] ** 2) + 2 * math.log(0.75 * 30)
        assert oscillator._bic(fitted, shares) == pytest.approx(expected)

    def test_the_jackknife_gives_the_standard_error_of_least_squares(self):
        """Independent residuals of unit variance: errors of the inverse normal matrix, within the scatter of blocks."""
        count = 2000
        design = RNG.standard_normal((2 * count, 2))
        found = np.mean(
            [
                oscillator._jackknife(design, RNG.standard_normal(2 * count), np.ones(2 * count))
                for _ in range(8)
            ],
            axis=0,
        )
        assert found == pytest.approx(np.sqrt(np.diag(np.linalg.inv(design.T @ design))), rel=0.25)

    @pytest.mark.parametrize(("apart", "both"), [(9.0, True), (11.0, False)])
    def test_springs_within_the_width_of_the_best_bic_are_possible(self, monkeypatch, apart, both):
        bic = {"a": 100.0, "b": 100.0 + apart}

        def averaged(model, data, scales=None):
            return SimpleNamespace(scales=None, phase_error=0.0, name=model)

        monkeypatch.setattr(oscillator, "averaged_fit", averaged)
        monkeypatch.setattr(oscillator, "_information", lambda _: None)
        monkeypatch.setattr(oscillator, "_bic", lambda fitted, _: bic[fitted.name])
        model = SimpleNamespace(with_effect=lambda effect: effect.name)
        effects = [SimpleNamespace(name=n) for n in bic]
        found = oscillator.possible_restoring(model, effects, [None], DEFAULT)
        assert found == ({"a", "b"} if both else {"a"})
        assert oscillator.possible_restoring(model, effects, [None, None], DEFAULT) is None

        def lost(model, data, scales=None):
            error = 2.0 * oscillator.LARGEST_PHASE_ERROR if isinstance(model, str) else 0.0
            return SimpleNamespace(scales=None, phase_error=error, name=model)

        monkeypatch.setattr(oscillator, "averaged_fit", lost)
        assert oscillator.possible_restoring(model, effects, [None], DEFAULT) is None


class TestRivals:
    """Three candidates with one column each, beside one parameter of the model; scores by least squares."""

    ROWS = 400

    def rivals(
        self,
        strengths,
        cosine=0.0,
        threshold=12.0,
        names=("casing.air.quadratic", "touchpoint.step", "bearing.heating"),
    ):
        base, *others = np.linalg.qr(RNG.standard_normal((self.ROWS, 4)))[0].T
        first, second, third = others
        second = cosine * first + math.sqrt(1 - cosine**2) * second
        columns = np.stack([base, first, second, third], axis=1)
        data = columns[:, 1:] @ np.array(strengths) + 5.0 * base
        candidates = [(SimpleNamespace(**self.effect(n)), None) for n in names]
        information = SimpleNamespace(
            added=dict, candidates=candidates, places=lambda i: [i + 1], parameters=1,
            present=columns.T @ columns, right=columns.T @ data,
            fit=SimpleNamespace(problem=SimpleNamespace(rows=self.ROWS)),
        )  # fmt: skip
        return rivals(information, [threshold] * 3, DEFAULT)

    @staticmethod
    def effect(name):
        e = LIBRARY[name]
        return {"name": name, "free": e.parameters[:1], "amplitude": e.amplitude, "kind": e.kind}

    def test_one_clear_effect_has_no_rival(self):
        assert self.rivals((10.0, 0.0, 0.0)) == []

    def test_nearly_equal_responses_are_rivals_by_their_likelihood(self):
        first, second = self.rivals((10.0, 0.0, 0.0), cosine=0.98)
        assert (first.names, second.names) == (("casing.air.quadratic",), ("touchpoint.step",))
        assert first.weight == 1.0
        assert second.weight == pytest.approx(math.exp(-0.5 * 100.0 * (1 - 0.98**2)))
        assert first.strengths == pytest.approx([10.0])
        assert second.strengths == pytest.approx([9.8])
        assert (first.columns, second.columns) == ((1,), (2,))

    @pytest.mark.parametrize(("apart", "kept"), [(9.0, True), (11.0, False)])
    def test_the_width_decides(self, apart, kept):
        found = self.rivals((20.0, 0.0, 0.0), cosine=math.sqrt(1 - apart / 400.0))
        assert bool(found) is kept

    def test_friction_is_not_negative(self):
        found = self.rivals((-10.0, 0.0, 0.0), cosine=0.98)
        assert not any("casing.air.quadratic" in r.names for r in found)

    @pytest.mark.parametrize(("threshold", "found"), [(99.0, True), (101.0, False)])
    def test_the_best_one_is_significant(self, threshold, found):
        assert bool(self.rivals((10.0, 0.0, 0.0), cosine=0.98, threshold=threshold)) is found
