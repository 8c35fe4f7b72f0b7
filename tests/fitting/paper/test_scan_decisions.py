"""Runs, ranges, robustness, predictions and repeated fits of a scan, with fits of known values."""

import math
from types import SimpleNamespace

import pytest

from fitting import Estimate, EstimationError, Model
from fitting.paper import _scan as module
from fitting.paper._scan import (
    AIR,
    BEARING,
    COLUMNS,
    ModelFits,
    Row,
    Run,
    Scan,
    paper_ranges,
    predict_recordings,
    robustness,
    scan,
    shade,
)

A2, B1, B2, F, G = (COLUMNS[s].key for s in ("a2", "b1", "b2", "f", "g"))


def estimate(value, stderr=0.1, *, at_bound=False):
    return Estimate(value, stderr, "1", at_bound=at_bound)


def fit(values=(), *, deviance=0.0, bic=0.0, verdict="adequate", labels=("a",), r2=0.95, model=None):
    """A fit of these values (value, or value and standard error) by name."""
    made = {k: estimate(*(v if isinstance(v, tuple) else (v,))) for k, v in dict(values).items()}
    return SimpleNamespace(
        estimates=made, values={k: e.value for k, e in made.items()}, deviance=deviance, bic=bic,
        verdict=verdict, labels=labels, model=model or Model.of(["touchpoint.constant"]),
        cases=[SimpleNamespace(casing=SimpleNamespace(r2=r2))],
        problem=SimpleNamespace(layout=SimpleNamespace(records=())),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("r2", "name"),
    [
        (0.99, "white"),
        (0.9899, "light gray"),
        (0.90, "light gray"),
        (0.8999, "gray"),
        (0.0, "gray"),
        (-1e-9, "dark gray"),
        (math.nan, "dark gray"),
    ],
)
def test_shades_begin_at_their_limits(r2, name):
    assert shade(r2) == name


def test_a_row_without_a_fit_has_no_shade():
    assert math.isnan(Row(AIR[0], None).r2)
    assert Row(AIR[0], None).shade == ""
    assert (Row(AIR[0], fit(r2=0.5)).r2, Row(AIR[0], fit(r2=0.5)).shade) == (0.5, "gray")


class TestRanges:
    def test_they_are_shares_of_the_mean_of_separate_fits(self):
        fits = [fit({A2: 2.0, F: 1.0, G: 1.0, B1: 7.0}), fit({A2: 4.0, F: 2.0, G: 1.4})]
        found = paper_ranges(fits, ["x"])
        assert set(found) == {A2, F, G, f"{A2}@x", f"{F}@x", f"{G}@x"}
        assert found[A2] == found[f"{A2}@x"] == pytest.approx((0.8 * 3.0, 1.2 * 3.0))
        assert found[F] == pytest.approx((0.5 * 1.5, 1.5 * 1.5))
        assert found[G] == pytest.approx((0.8 * 1.2, 1.2 * 1.2))

    @pytest.mark.parametrize("value", [0.0, -1.0])
    def test_a_parameter_that_is_not_positive_keeps_its_bounds(self, value):
        assert paper_ranges([fit({A2: value})]) == {}

    def test_values_of_cases_count_as_values_of_the_parameter(self):
        found = paper_ranges([fit({f"{B2}@a": 1.0, f"{B2}@b": 3.0})])
        assert found == {B2: pytest.approx((1.6, 2.4))}


class TestRobustness:
    def one(self, key, own, together=None):
        """`own` are the separate values, `together` the values of the joint fit."""
        joint = None
        if together is not None:
            names = [key] if len(together) == 1 else [f"{key}@{i}" for i in range(len(together))]
            joint = fit(dict(zip(names, together, strict=True)))
        (found,) = robustness([fit({key: v}) for v in own], joint)
        return found

    def test_spread_and_shift_are_shares_of_the_mean(self):
        found = self.one(A2, [(3.0, 0.3), (5.0, 0.4)], [4.4])
        assert (found.symbol, found.key, found.unit) == ("a2", A2, "N m s2")
        assert (found.mean, found.spread) == (4.0, pytest.approx(0.5))
        assert found.shift == pytest.approx(0.1)
        assert found.sigma == pytest.approx(2.0 / 0.5)

    def test_of_a_negative_mean_the_shares_keep_their_sign(self):
        found = self.one(A2, [-3.0, -5.0], [-5.0])
        assert (found.spread, found.shift) == (pytest.approx(0.5), pytest.approx(-0.25))

    def test_values_of_cases_have_the_largest_of_their_own_shifts(self):
        found = self.one(A2, [4.0, 5.0], [3.0, 6.0])
        assert found.shift == pytest.approx(-0.25)
        assert self.one(A2, [4.0, 5.0], [5.0, 4.0]).shift == pytest.approx(0.25)

    def test_values_without_error_have_no_difference_in_standard_errors(self):
        assert math.isnan(self.one(A2, [(3.0, 0.0), (5.0, 0.4)]).sigma)
        assert self.one(A2, [(3.0, 0.3), (5.0, 0.4), (9.0, 0.0), (3.0, 0.4)]).sigma == pytest.approx(4.0)

    def test_a_single_case_is_not_known(self):
        found = self.one(A2, [3.0])
        assert math.isnan(found.spread)
        assert math.isnan(found.shift)
        assert found.verdict == "not known"

    @pytest.mark.parametrize(
        ("own", "together", "verdict"),
        [
            ([4.0, 4.0], [4.39], "robust"),
            ([4.0, 4.0], [4.41], "varies"),
            ([4.0, 4.0], [3.59], "varies"),
            ([3.81, 4.19], [4.0], "robust"),
            ([3.79, 4.21], [4.0], "varies"),
            ([4.0, 4.0], [5.99], "varies"),
            ([4.0, 4.0], [6.01], "unstable"),
            ([0.0, 0.0], [4.0], "zero"),
            ([0.0, 4.0], [2.0], "unstable"),
            ([(1.0, 1.1), (1.0, 2.0)], [1.0], "not determined"),
            ([(1.0, 0.9), (1.0, 2.0)], [1.0], "robust"),
            ([(-1.0, 0.9), (-1.0, 2.0)], [-1.0], "robust"),
        ],
    )
    def test_the_larger_of_spread_and_shift_decides(self, own, together, verdict):
        assert self.one(A2, own, together).verdict == verdict

    def test_an_active_bound_is_not_determined(self):
        both = [fit({A2: 1.0}), fit({A2: 1.0})]
        for f in both:
            f.estimates[A2] = estimate(1.0, at_bound=True)
        assert robustness(both, None)[0].verdict == "not determined"
        both[0].estimates[A2] = estimate(1.0)
        assert robustness(both, None)[0].verdict == "robust"

    def test_surfaces_may_differ(self):
        assert self.one(B1, [2.0, 6.0], [4.0]).verdict == "robust"
        assert self.one(A2, [2.0, 6.0], [4.0]).verdict == "unstable"

    def test_a_parameter_of_some_cases_only_has_none(self):
        assert robustness([fit({A2: 1.0}), fit({B1: 1.0})], None) == ()
        assert robustness([], None) == ()

    def test_a_change_from_zero_is_infinite(self):
        assert self.one(A2, [-1.0, 1.0], [0.0]).spread == math.inf
        assert self.one(A2, [-1.0, 1.0], [0.0]).shift == 0.0


class TestPrediction:
    """Fits are replaced by stubs that state from which recordings they are."""

    def predicted(self, monkeypatch, labels, **options):
        calls = []

        def fitted(model, data, *, noise, share=None):
            calls.append((model, [d.record.label for d in data], list(noise), share))
            case = SimpleNamespace(
                casing=SimpleNamespace(reduced_chi2=4.0, r2=0.9, rmse=0.2),
                rotor=SimpleNamespace(reduced_chi2=9.0),
            )
            return SimpleNamespace(
                cases=[case],
                estimates={k: estimate(2.5) for k in (A2, B1)},
                names=[d.record.label for d in data],
            )

        monkeypatch.setattr(module, "fit", fitted)
        data = [SimpleNamespace(record=SimpleNamespace(label=x)) for x in labels]
        model = Model.of(["rotor.air.quadratic", "touchpoint.constant"])
        return predict_recordings(model, data, [f"noise {x}" for x in labels], **options), calls

    def test_each_is_predicted_from_all_others(self, monkeypatch):
        found, calls = self.predicted(monkeypatch, "abc")
        assert [(p.label, p.casing, p.rotor, p.r2, p.rmse) for p in found] == [
            (x, 2.0, 3.0, 0.9, 0.2) for x in "abc"
        ]
        assert [p.others.names for p in found] == [["b", "c"], ["a", "c"], ["a", "b"]]
        assert [(names, noise) for _, names, noise, _ in calls[:2]] == [
            (["b", "c"], ["noise b", "noise c"]),
            (["a"], ["noise a"]),
        ]
        # friction of another surface is not shared, and is free in the prediction
        assert [share for *_, share in calls[:2]] == [[A2], None]
        assert list(calls[1][0].free) == [B1]
        assert calls[1][0].constants[A2] == 2.5

    def test_of_two_the_fit_of_the_other_one_is_used(self, monkeypatch):
        alone = [SimpleNamespace(estimates={A2: estimate(v)}, names=[v]) for v in (1.0, 2.0)]
        found, calls = self.predicted(monkeypatch, "ab", alone=alone)
        assert [p.others.names for p in found] == [[2.0], [1.0]]
        assert [c[0].constants[A2] for c in calls] == [2.0, 1.0]

    def test_of_three_a_fit_alone_is_not_used(self, monkeypatch):
        _, calls = self.predicted(monkeypatch, "abc", alone=[None] * 3)
        assert len(calls) == 6

    def test_one_cannot_be_predicted(self, monkeypatch):
        with pytest.raises(EstimationError, match="one recording"):
            self.predicted(monkeypatch, "a")


class TestRows:
    """The deviance of each run is given by its terms; a fit with initial values may have another one."""

    def rows(self, monkeypatch, runs, deviances, again=None):
        again, calls, counted = again or {}, [], []

        def fitted(model, data, *, noise, start=None):
            terms = tuple(sorted(s for s, e in module.EFFECT_OF.items() if e in model.names))
            calls.append((terms, start is not None))
            found = deviances.get(terms) if start is None else again.get(terms, deviances.get(terms))
            if found is None:
                raise EstimationError("no bounded solution", "")
            return fit({A2: 1.0}, deviance=found, model=model)

        monkeypatch.setattr(module, "fit", fitted)
        monkeypatch.setattr(module, "parameters_at", lambda effects, records: {})
        count = module._Count(lambda done, total: counted.append((done, total)), 9)
        made = [Run(tuple(r)) for r in runs]
        found = module._rows(made, None, None, count)
        assert [r.run for r in found] == made
        assert counted == [(i, 9) for i in range(len(runs) + 1)]
        return found, calls

    def test_small_models_are_first_and_the_order_of_the_table_remains(self, monkeypatch):
        found, calls = self.rows(monkeypatch, ["cd", "c", "d"], {("c", "d"): 1.0, ("c",): 2.0, ("d",): 3.0})
        assert calls == [(("c",), False), (("d",), False), (("c", "d"), False)]
        assert [r.fit.deviance for r in found] == [1.0, 2.0, 3.0]

    @pytest.mark.parametrize(("larger", "repeated"), [(2.09, False), (2.11, True)])
    def test_a_larger_model_with_a_larger_deviance_is_repeated(self, monkeypatch, larger, repeated):
        found, calls = self.rows(
            monkeypatch, ["cd", "c"], {("c", "d"): larger, ("c",): 2.0}, {("c", "d"): 1.5}
        )
        assert ((("c", "d"), True) in calls) is repeated
        assert found[0].fit.deviance == (1.5 if repeated else larger)

    def test_a_repeated_fit_that_is_worse_is_not_taken(self, monkeypatch):
        found, _ = self.rows(monkeypatch, ["cd", "c"], {("c", "d"): 5.0, ("c",): 2.0}, {("c", "d"): 6.0})
        assert found[0].fit.deviance == 5.0

    def test_it_starts_at_the_best_nested_model(self, monkeypatch):
        starts = []
        monkeypatch.setattr(module, "_better", lambda row, best, *_: starts.append(best.deviance) or row)
        self.rows(
            monkeypatch, ["cd", "c", "d", "e"], {("c", "d"): 9.0, ("c",): 3.0, ("d",): 2.0, ("e",): 1.0}
        )
        assert starts == [2.0]

    def test_a_model_with_a_power_law_starts_at_the_smaller_one(self, monkeypatch):
        found, calls = self.rows(monkeypatch, ["cf", "f"], {("f",): 2.0}, {("c", "f"): 1.0})
        assert calls == [(("f",), False), (("c", "f"), True)]
        assert found[0].fit.deviance == 1.0

    def test_without_a_fit_the_row_has_the_reason(self, monkeypatch):
        found, _calls = self.rows(monkeypatch, ["c", "d"], {("d",): 1.0})
        assert (found[0].fit, found[0].fault) == (None, "no bounded solution")
        found, _ = self.rows(monkeypatch, ["cf", "f"], {("f",): 2.0}, {("c", "f"): None})
        assert (found[0].fit, found[0].fault) == (None, "no bounded solution")

    def test_without_the_touch_point_a_fit_finds_its_start(self, monkeypatch):
        calls = []

        def fitted(model, data, *, noise, start=None):
            calls.append((model.names, start))
            if start is None and "touchpoint.constant" in model.names:
                raise EstimationError("the casing stops", "")
            return fit({A2: 3.0}, model=model)

        monkeypatch.setattr(module, "fit", fitted)
        both = Model.of(["rotor.air.quadratic", "touchpoint.constant"])
        module._fit(both, None, None)
        assert calls[1:] == [(("rotor.air.quadratic",), None), (both.names, {A2: 3.0, B1: 0.0})]

    def test_a_failed_fit_without_a_touch_point_is_not_repeated(self, monkeypatch):
        calls = []

        def failing(*args, **more):
            calls.append(more)
            raise EstimationError("the casing stops", "")

        monkeypatch.setattr(module, "fit", failing)
        with pytest.raises(EstimationError, match="stops"):
            module._fit(Model.of(["rotor.air.quadratic"]), None, None)
        assert len(calls) == 1

    def test_initial_values_of_a_nested_model_replace_those_declared(self, monkeypatch):
        monkeypatch.setattr(
            module, "parameters_at",
            lambda effects, records: {A2: SimpleNamespace(start=9.0), B2: SimpleNamespace(start=8.0)},
        )  # fmt: skip
        assert module._extended(Model.of([]), fit({A2: 1.0, "initial": 2.0})) == {
            A2: 1.0, B2: 8.0, "initial": 2.0,
        }  # fmt: skip


class TestModels:
    def made(self, monkeypatch, count):
        calls = []
        monkeypatch.setattr(module, "fit", lambda *args, **more: calls.append((args, more)) or fit({A2: 2.0}))
        monkeypatch.setattr(module, "predict_recordings", lambda *args, alone: (args, alone))
        separate = [fit({A2: 1.0 + i}) for i in range(count)]
        found = module._model("general", separate, list("ab")[:count], ["n"] * count, {A2: (0, 1)}, {A2: 1.0})
        return separate, found, calls

    def test_one_case_has_no_joint_fit(self, monkeypatch):
        _, found, calls = self.made(monkeypatch, 1)
        assert (found.joint, found.predicted, calls) == (None, (), [])
        assert [r.verdict for r in found.robustness] == ["not known"]

    def test_several_cases_are_fitted_jointly_and_predicted(self, monkeypatch):
        separate, found, calls = self.made(monkeypatch, 2)
        model = separate[0].model
        assert calls == [
            ((model, ["a", "b"]), {"noise": ["n", "n"], "ranges": {A2: (0, 1)}, "start": {A2: 1.0}})
        ]
        assert found.predicted == ((model, ["a", "b"], ["n", "n"]), separate)
        assert (found.robustness[0].mean, found.robustness[0].shift) == (1.5, pytest.approx(1 / 3))


def test_the_text_of_a_scan_counts_the_runs_of_all_tables():
    rows = tuple(Row(r, None) for r in AIR), tuple(Row(r, None) for r in BEARING)
    fits = ModelFits("reduced", (fit(labels=("a",), bic=1.26),), fit(labels=("a", "b"), bic=-3.0), (), ())
    found = Scan(("a", "b"), (rows[0],) * 2, (rows[1],) * 2, (fits,))
    assert repr(found).splitlines() == [
        "scan of a, b: 40 combinations of terms; see scan_lines()",
        "  reduced, a: BIC 1.3, adequate",
        "  reduced, joint: BIC -3.0, adequate",
    ]


@pytest.mark.parametrize(
    ("separate", "joint", "converged"),
    [
        ("adequate", "adequate", True),
        ("not_converged", "adequate", False),
        ("adequate", "not_converged", False),
        ("adequate", None, True),
    ],
)
def test_a_scan_converged_if_all_models_did(separate, joint, converged):
    together = None if joint is None else fit(verdict=joint)
    fits = ModelFits("reduced", (fit(), fit(verdict=separate)), together, (), ())
    assert Scan((), (), (), (fits,)).converged is converged


class TestScan:
    def scanned(self, monkeypatch, count):
        """Scan stubs; returns the scan, the calls of fits, and the progress."""
        monkeypatch.setattr(module, "CaseData", SimpleNamespace)
        calls, counted = [], []

        def fitted(model, data, *, noise=(), ranges=None, start=None):
            calls.append((len(model.effects), [d.record.label for d in data], list(noise), ranges, start))
            found = fit({A2: 2.0}, model=model)
            found.noise = [f"noise {data[0].record.label}"]
            return found

        def table(runs, data, noise, count):
            count.add(len(runs))
            return (len(runs), data.record.label, noise)

        monkeypatch.setattr(module, "fit", fitted)
        monkeypatch.setattr(module, "_rows", table)
        monkeypatch.setattr(
            module, "_model",
            lambda name, separate, data, noise, ranges, start: SimpleNamespace(
                name=name, joint=separate[0] if len(data) > 1 else None, of=(noise, ranges, start)
            ),
        )  # fmt: skip
        monkeypatch.setattr(module, "_extended", lambda model, inner: ("from", inner.model.names))
        data = [SimpleNamespace(record=SimpleNamespace(label=x, is_chain=False)) for x in "ab"[:count]]
        return (
            scan(data, progress=lambda done, total: counted.append((done, total))),
            calls,
            counted,
        )

    @pytest.mark.parametrize("count", [1, 2])
    def test_tables_and_models_have_the_noise_of_the_reduced_fit(self, monkeypatch, count):
        found, calls, counted = self.scanned(monkeypatch, count)
        labels = "ab"[:count]
        noise = [f"noise {x}" for x in labels]
        assert found.labels == tuple(labels)
        assert found.air == tuple((5, x, f"noise {x}") for x in labels)
        assert found.bearing == tuple((15, x, f"noise {x}") for x in labels)
        reduced = len(Model.of(module.REDUCED).effects)
        general = len(Model.of(module.GENERAL).effects)
        assert [c[:3] for c in calls[:count]] == [(reduced, [x], []) for x in labels]
        ranges = {k: pytest.approx((1.6, 2.4)) for k in (A2, *(f"{A2}@{x}" for x in labels))}
        start = ("from", Model.of(module.REDUCED).names)
        assert calls[count:] == [(general, [x], [f"noise {x}"], ranges, start) for x in labels]
        small, large = found.models
        assert (small.name, small.of) == ("reduced", (noise, {}, {}))
        assert (large.name, large.of) == ("general", (noise, ranges, start if count > 1 else {}))
        assert counted[0] == (0, 20 * count + 6)
        assert counted[-1] == (20 * count + 6, 20 * count + 6)

    @pytest.mark.parametrize(("labels", "chain"), [("", False), ("aa", False), ("ab", True)])
    def test_cases_that_cannot_be_scanned(self, monkeypatch, labels, chain):
        monkeypatch.setattr(module, "CaseData", SimpleNamespace)
        data = [SimpleNamespace(record=SimpleNamespace(label=x, is_chain=chain)) for x in labels]
        with pytest.raises(EstimationError, match="joints" if chain else "different labels"):
            scan(data)
