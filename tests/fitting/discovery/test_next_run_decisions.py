"""Which explanations a run is planned for, and with what strengths."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import SimulationError
from fitting.discovery import _next_run as module


def parameter(symbol, role, start=0.5):
    return SimpleNamespace(symbol=symbol, role=role, start=start)


def effect(name, *, phase=False, shape=False, angle=False, restoring=False):
    parameters = [parameter("k", "amplitude")]
    parameters += [parameter("phi", "phase")] * phase + [parameter("g", "shape", 1.25)] * shape
    return SimpleNamespace(name=name, parameters=parameters, depends_on_angle=angle, restoring=restoring)


def estimates(**values):
    return {key.replace("__", "."): SimpleNamespace(value=v) for key, v in values.items()}


class TestExplanations:
    @pytest.fixture
    def planned(self, monkeypatch):
        """Return the sentence for some explanations, and what the search for a run was given."""
        calls = []

        class Information:
            def __init__(self, fit, candidates):
                self.candidates = candidates
                sizes = [2 if any(p.role == "phase" for p in e.parameters) else 1 for e, _ in candidates]
                self.first = np.cumsum([10, *sizes])

            def places(self, i):
                return list(range(self.first[i], self.first[i + 1]))

        def next_run(information, rivals, criteria, bounds, *, evaluations):
            calls.append((information, rivals, criteria, bounds, evaluations))
            return SimpleNamespace(sentence="spin it") if criteria else None

        monkeypatch.setattr(module, "Information", Information)
        monkeypatch.setattr(module, "next_run", next_run)
        monkeypatch.setattr(module.Bounds, "of", lambda fit: "bounds")
        monkeypatch.setattr(
            module, "parameters_at",
            lambda effects, records: {f"{e.name}.{p.symbol}": p for e in effects for p in e.parameters},
        )  # fmt: skip

        def of(*explanations, criteria="criteria", reversals=(), contact=None, chain=False):
            record = SimpleNamespace(is_chain=chain)
            data = SimpleNamespace(motion=SimpleNamespace(reversals=reversals), record=record)
            fit = SimpleNamespace(
                problem=SimpleNamespace(data=[data], layout=SimpleNamespace(records=(record,))),
                model=SimpleNamespace(rigid_contact=contact),
            )
            return module.separating_run(fit, explanations, criteria), calls

        return of

    A = ("A", [effect("a")], estimates(a__k=3.0))
    B = ("B", [effect("b", shape=True)], estimates(b__k=2.0, b__g=1.5))
    C = ("C", [effect("c"), effect("d", phase=True)], estimates(c__k=4.0, d__k=2.0, d__phi=math.pi / 6))
    ANGLE = ("angle", [effect("x", angle=True)], estimates(x__k=1.0))

    def test_each_explanation_has_the_columns_and_strengths_of_its_effects(self, planned):
        sentence, calls = planned(self.A, self.C, self.B)
        assert sentence == "spin it"
        ((information, rivals, criteria, bounds, evaluations),) = calls
        assert (criteria, bounds, evaluations) == ("criteria", "bounds", 24)
        assert [(e.name, shapes) for e, shapes in information.candidates] == [
            ("a", {}), ("c", {}), ("d", {}), ("b", {"g": 1.5}),
        ]  # fmt: skip
        assert [r.names for r in rivals] == [("A",), ("C",), ("B",)]
        assert [r.columns for r in rivals] == [(10,), (11, 12, 13), (14,)]
        assert rivals[0].strengths.tolist() == [3.0]
        assert rivals[1].strengths == pytest.approx([4.0, math.sqrt(3), 1.0])
        assert rivals[2].strengths.tolist() == [2.0]

    def test_laws_of_an_angle_and_a_single_explanation_need_no_run(self, planned):
        assert planned(self.A)[0] == ""
        assert planned(self.A, self.ANGLE)[0] == ""
        sentence, calls = planned(self.ANGLE, self.A, self.B)
        assert sentence == "spin it"
        assert [r.names for r in calls[0][1]] == [("A",), ("B",)]

    def test_no_more_rivals_are_planned_for_than_a_search_can_separate(self, planned):
        _, calls = planned(*[(str(i), [effect(f"e{i}")], {}) for i in range(9)])
        assert len(calls[0][1]) == module.MOST_RIVALS < 9

    def test_a_run_that_cannot_be_simulated_has_no_sentence(self, planned):
        sentence, calls = planned(self.A, self.B, criteria=None)
        assert (sentence, len(calls)) == ("", 1)

    def test_bodies_in_contact_and_chains_are_not_planned(self, planned):
        assert planned(self.A, self.B, contact=object()) == ("", [])
        assert planned(self.A, self.B, chain=True) == ("", [])

    @pytest.mark.parametrize(
        ("laws", "told"), [((1, 1), True), ((1, 0), False), ((0, 0), False), ((1, 0, 1), True)]
    )
    def test_of_an_oscillation_two_restoring_laws_need_a_larger_angle(self, planned, laws, told):
        rivals = [(str(i), [effect("z"), effect("y", restoring=bool(r))], {}) for i, r in enumerate(laws)]
        sentence, calls = planned(*rivals, reversals=(1.0,))
        assert (sentence == module._LARGER_AMPLITUDE, bool(sentence), calls) == (told, told, [])


def test_a_value_of_each_recording_counts_by_its_mean(monkeypatch):
    law = effect("a.b", shape=True)
    monkeypatch.setattr(
        module,
        "parameters_at",
        lambda effects, records: {f"a.b.{p.symbol}": p for p in effects[0].parameters},
    )
    known = {"a.b.k@one": 2.0, "a.b.k@two": 5.0, "a.b.kk": 100.0}
    found = module._mean_values(law, {k: SimpleNamespace(value=v) for k, v in known.items()}, ())
    assert found == {"k": 3.5, "g": 1.25}


class TestTrial:
    def search(self, added, *, evaluations=3):
        seen = []

        def of_run(run):
            if isinstance(added, Exception):
                raise added
            return added, "planned"

        search = object.__new__(module._RunSearch)
        search._information = SimpleNamespace(of_run=of_run, present=np.ones((2, 2)))
        search._criterion = lambda total: float(total.sum())
        search._progress = lambda done, total: seen.append((done, total))
        search._count, search._evaluations, search.tried = 1, evaluations, []
        return search, seen

    def test_its_value_is_that_of_the_information_with_it(self):
        search, seen = self.search(np.full((2, 2), 3.0))
        found = search._try("x", -1.0, "run")
        assert (found.value, found.x, found.sense, found.run, found.planned) == (
            16.0,
            "x",
            -1.0,
            "run",
            "planned",
        )
        assert (found.added == 3.0).all()
        search._try("x", -1.0, "run")
        search._try("x", -1.0, "run")
        assert seen == [(2, 3), (3, 3), (3, 3)]
        search._progress = None
        assert search._try("x", 1.0, "run").value == 16.0
        assert search._count == 5

    @pytest.mark.parametrize(
        "added",
        [
            SimulationError("no motion"),
            np.linalg.LinAlgError(),
            np.array([[1.0, np.nan], [0.0, 1.0]]),
            np.full((2, 2), np.inf),
        ],
    )
    def test_a_run_without_a_motion_is_left_out(self, added):
        search, seen = self.search(added)
        assert search._try("x", 1.0, "run") is None
        search._run = lambda x, sense: "run"
        search._keep("x", 1.0)
        assert (search.tried, seen) == ([], [(2, 3), (3, 3)])


def test_without_any_run_there_is_no_proposal(monkeypatch):
    order = []

    class Search:
        def __init__(self, *args):
            self.tried, self.args = args[3], args

        def __getattr__(self, name):
            return lambda: order.append(name) or "result"

    monkeypatch.setattr(module, "_RunSearch", Search)
    assert module.next_run("information", "rivals", "criteria", []) is None
    assert order == ["explore"]
    assert module.next_run("information", "rivals", "criteria", ["a run"]) == "result"
    assert order == ["explore", "explore", "refine", "vary_apparatus", "result"]


class TestSearch:
    """Two recordings; the windows of the first last 2, 3 and 9 s, and its casing begins at 7 rad/s."""

    def search(self, windows=(2.0, 3.0, 9.0)):
        runs = [SimpleNamespace(time=np.array([20.0, 20.0 + w])) for w in windows]
        speeds = (None, np.array([[900.0, 7.0], [800.0, 60.0]]))
        data = [SimpleNamespace(record=SimpleNamespace(rotor=runs), initial_speeds=speeds), SimpleNamespace()]
        fit = SimpleNamespace(problem=SimpleNamespace(data=data))
        information = SimpleNamespace(
            fit=fit, parameters=2, candidates=[("e", {})], present=np.eye(3), places=lambda i: [2]
        )
        bounds = module.Bounds((300.0, 900.0), (-50.0, 150.0), (100.0, 300.0))
        return module._RunSearch(information, [], SimpleNamespace(experiment_sigma=3.0), bounds, 60, None)

    def test_a_run_is_a_point_between_the_bounds(self):
        search = self.search()
        run = search._run(np.array([0.5, 0.25, 1.0, 0.9, 0.1, 0.5]), -1.0)
        assert (run.omega_rotor, run.omega_casing, run.duration) == (-600.0, 0.0, 300.0)
        # three windows of the median length, in 291 s that are left
        assert run.window_length == 3.0
        assert run.windows == pytest.approx((29.1, 148.5, 267.9))
        assert search._start == 7.0

    def test_windows_fit_into_a_short_run(self):
        run = self.search((90.0, 80.0, 70.0))._run(np.array([0.0, 0.0, 0.0, 0.2, 0.4, 0.6]), 1.0)
        assert run.window_length == pytest.approx(100 / 3)
        assert run.windows == pytest.approx((0.0, 100 / 3, 200 / 3))
        alone = self.search(())._run(np.array([0.0, 1.0, 0.5]), 1.0)
        assert (alone.windows, alone.window_length) == ((), 0.0)
        assert (alone.omega_rotor, alone.omega_casing, alone.duration) == (300.0, 150.0, 200.0)

    def test_the_search_is_given_what_is_asked(self, monkeypatch):
        made = []

        class Search:
            tried = ()

            def __init__(self, *args):
                made.append(args)

            def explore(self):
                pass

        monkeypatch.setattr(module, "_RunSearch", Search)
        module.next_run("information", "rivals", "criteria", "bounds", evaluations=7, progress="progress")
        assert made == [("information", "rivals", "criteria", "bounds", 7, "progress")]
