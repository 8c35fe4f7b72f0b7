"""The record of a search: each fit with its purpose, its model, and its result or the reason of its failure."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import EstimationError, Fit, Model, SimulationError, diagnose, fit, improve, make_record
from fitting import fit as public_fit
from fitting._workers import WorkerPool
from fitting.inference._trace import (
    Refit,
    attempt,
    of_model,
    record_result,
    recorded_map,
    recording,
    with_purpose,
)

DRAG = SimpleNamespace(names=("a", "drag"))
RESULT = SimpleNamespace(deviance=12.5, bic=20.25, converged=True)


def wheel(seed=0):
    """One body that slows down by a constant torque of 0.3 N m and by 0.02 N m s omega; unit inertia, speeds."""
    t = np.linspace(0.0, 20.0, 300)
    speed = (20.0 + 15.0) * np.exp(-0.02 * t) - 15.0
    value = speed + 0.02 * np.random.default_rng(seed).standard_normal(len(t))
    casing = (t, value, np.full(len(t), 0.02))
    return make_record(
        casing=casing, rotor=[], I_rotor=1.0, I_casing=1.0, single=True, quantity="omega", label="wheel"
    )


def failing(model, message="no minimum"):
    with of_model(model):
        raise EstimationError(message)


class TestEntries:
    def test_a_result_with_purpose_and_model(self):
        with recording() as trace, with_purpose("a candidate"), of_model(DRAG):
            record_result(RESULT)
        assert trace.refits == [Refit("a candidate", ("a", "drag"), 12.5, 20.25, converged=True)]

    def test_a_failure_is_recorded_once_with_its_reason(self):
        with recording() as trace:
            with attempt("a law"), attempt("a part of it"):
                failing(DRAG)
            with attempt("a motion", SimulationError):
                raise SimulationError("it diverges")
        assert [(r.purpose, r.effects, r.failure) for r in trace.refits] == [
            ("a part of it", ("a", "drag"), "no minimum"),
            ("a motion", (), "it diverges"),
        ]
        assert math.isnan(trace.refits[0].deviance)

    def test_errors_of_another_kind_are_raised(self):
        with recording(), pytest.raises(EstimationError), attempt("a motion", SimulationError):
            failing(DRAG)

    def test_a_raised_failure_is_recorded_as_well(self):
        with recording() as trace:
            with pytest.raises(EstimationError):
                failing(DRAG)
            with attempt("the next one"):
                failing(DRAG, "another")
        assert [r.failure for r in trace.refits] == ["no minimum", "another"]

    def test_an_outer_search_receives_the_fits_of_an_inner_one(self):
        with recording() as outer:
            with recording() as inner, of_model(DRAG):
                record_result(RESULT)
            with recording(passed_on=False) as separate, of_model(DRAG):
                record_result(RESULT)
        assert len(inner.refits) == len(separate.refits) == len(outer.refits) == 1

    def test_without_a_search_nothing_is_kept(self):
        with attempt("a law"), of_model(DRAG):
            record_result(RESULT)
            raise EstimationError("no minimum")


def _work(common, item):
    with attempt(f"item {item}"):
        failing(SimpleNamespace(names=(common,)), str(item))
    return item**2


def test_fits_of_workers_are_recorded_in_the_order_of_items():
    with WorkerPool(0) as pool, recording() as trace:
        assert recorded_map(pool, _work, "drag", [3, 1, 2], lambda _: ()) == [9, 1, 4]
    assert [r.failure for r in trace.refits] == ["3", "1", "2"]


class TestSentences:
    def test_the_model_is_stated_as_the_difference(self):
        line = Refit("a candidate", ("a", "drag"), 12.54, 20.26, converged=True).sentence(("a", "b"))
        assert line == "a candidate (+drag -b): deviance 12.5, BIC 20.3"

    def test_an_unfinished_search_and_a_failure(self):
        same = Refit("a candidate", ("a",), 1.0, 2.0, converged=False)
        assert same.sentence(("a",)) == "a candidate (same model): deviance 1.0, BIC 2.0, not converged"
        assert Refit("a law", ("a",), failure="it diverges").sentence() == "a law (+a): failed: it diverges"


class TestSearches:
    def test_of_a_fit(self):
        with recording() as trace:
            found = fit(Model.of(["touchpoint.constant"]), [wheel()])
            with attempt("nothing"):
                fit(Model.of(["touchpoint.constant"]), [])
        assert isinstance(found, Fit)
        assert (trace.refits[-2].deviance, trace.refits[-2].bic) == (found.deviance, found.bic)
        assert trace.refits[-1].purpose == "nothing"
        assert trace.refits[-1].failure

    @pytest.mark.slow
    def test_a_diagnosis_lists_the_fit_of_each_candidate(self):
        base = public_fit(Model.of(["touchpoint.constant"]), wheel())
        found = diagnose(base)
        assert found.verdict == "missing_effect"
        tried = {e for r in found.trace for e in r.effects}
        assert {c.effect.name for c in found.candidates if c.fit is not None} <= tried
        best = found.candidates[0]
        assert any(best.effect.name in r.effects and r.deviance == best.fit.deviance for r in found.trace)
        history = improve(base, first=found.candidates, max_steps=1)
        assert any(r.effects == tuple(history[-1].fit.model.names) for r in history.trace)
