"""BIC of averaged equations, and the restoring torques that it leaves possible."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting.discovery import _oscillator as module


def equations(rest, keys=("a.k", "b.k"), design=None, theta=(3.0, 5.0), scales=None):
    rows = ((list(keys), design, np.asarray(rest)),)
    return SimpleNamespace(rows=rows, theta=np.array(theta), scales=(scales,), phase_error=0.1)


@pytest.mark.parametrize(
    ("rest", "shares"),
    [
        # correlations of 1/2 (of products 1 and squares 2), of 0 and of less than 0
        ([1.0, 1.0, 0.0, 1.0, 0.0, 1.0], ((1 - 0.5) / 1.5, 1.0)),
        ([1.0, -1.0, 0.0, 1.0, 1.0, 1.0], (1.0, (1 - 2 / 3) / (1 + 2 / 3))),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], (1.0, 1.0)),
    ],
)
def test_shares_of_independent_residuals_follow_from_their_correlation(rest, shares):
    assert module._information(equations(rest)) == pytest.approx(shares)


def test_a_correlation_has_a_limit():
    r = module._MOST_CORRELATED
    found = module._information(equations(np.ones(4000)))
    assert found == pytest.approx([(1 - r) / (1 + r)] * 2)


def test_bic_counts_independent_residuals():
    rest = [1.0, 2.0, 3.0, 1.0, 1.0, 2.0]
    shares = np.array([0.5, 0.25])
    expected = 0.5 * 14 + 0.25 * 6 + 2 * math.log(0.75 * 3)
    assert module._bic(equations(rest), shares) == pytest.approx(expected)
    # of less than two there is at least the logarithm of two
    assert module._bic(equations(rest), shares / 10) == pytest.approx(0.7 + 0.15 + 2 * math.log(2.0))


class TestPossible:
    def possible(self, monkeypatch, fits, *, general=True, cases=1):
        asked = []

        def averaged(model, data, errors=None):
            if model == "general":
                return SimpleNamespace(scales="scales") if general else None
            asked.append(errors)
            return fits[model]

        monkeypatch.setattr(module, "averaged_fit", averaged)
        monkeypatch.setattr(module, "Model", SimpleNamespace(of=lambda names: "general"))
        monkeypatch.setattr(module, "_information", lambda general: "shares")
        monkeypatch.setattr(module, "_bic", lambda fitted, shares: fitted.bic)
        model = SimpleNamespace(with_effect=lambda e: e.name)
        effects = [SimpleNamespace(name=n) for n in fits]
        criteria = SimpleNamespace(equivalence_width=6.0)
        found = module.possible_restoring(model, effects, [None] * cases, criteria)
        assert set(asked) <= {"scales"}
        return found

    def fitted(self, bic, error=0.1):
        return SimpleNamespace(bic=bic, phase_error=error)

    def test_effects_within_the_width_of_the_best_are_possible(self, monkeypatch):
        fits = {
            "a": self.fitted(10.0),
            "b": self.fitted(15.9),
            "c": self.fitted(16.1),
            "d": self.fitted(5.0, 0.71),
            "e": None,
        }
        assert self.possible(monkeypatch, fits) == {"a", "b"}

    def test_without_an_answer_there_is_none(self, monkeypatch):
        assert self.possible(monkeypatch, {"a": self.fitted(1.0, 0.7)}) is None
        assert self.possible(monkeypatch, {"a": self.fitted(1.0)}, general=False) is None
        assert self.possible(monkeypatch, {"a": self.fitted(1.0)}, cases=2) is None
