"""Information of runs against least squares, planned recordings against equations of motion, sets of rivals."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from linearised import BEGIN, covariance, gyroscope

from fitting import LIBRARY
from fitting._criteria import DEFAULT
from fitting.discovery import _information as module
from fitting.discovery._information import MOST_RIVALS, Information, Run, rivals, schur, simulated
from fitting.discovery._score import CaseColumns

DRAG, PERIODIC = LIBRARY["casing.air.quadratic"], LIBRARY["casing.precession"]
BEARING = "bearing.linear.d"


def test_the_schur_complement_is_the_inverse_of_a_part_of_the_covariance():
    columns = np.random.default_rng(1).standard_normal((30, 5)) * [1.0, 1e4, 1e-6, 3.0, 1e2]
    information = columns.T @ columns
    size = np.sqrt(np.diag(information))
    whole = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    for kept, free in (((0, 3), (1, 2, 4)), ((2,), (0, 1, 3, 4))):
        expected = np.linalg.inv(whole[np.ix_(kept, kept)])
        assert schur(information, kept, free) == pytest.approx(expected, rel=1e-8)


class TestInformation:
    def fit(self, values=None, *, names=(), residual=None):
        model = ("rotor.air.quadratic", "touchpoint.constant", "casing.air.linear", "bearing.linear", *names)
        base = gyroscope(model, values, level=3e-7, residual=residual)
        base.noise[0].pure = 1e-7
        base.estimates = {
            n: SimpleNamespace(value=x) for n, x in zip(base.problem.layout.names, base.theta, strict=True)
        }
        return base

    @pytest.mark.parametrize("held", [False, True])
    def test_it_is_that_of_least_squares_with_the_run_s_own_parameters_free(self, held):
        """At the noise of the recording without a model; a parameter at its bound has none."""
        size = len(gyroscope().predictions[0].rows)
        rows = np.random.default_rng(2).standard_normal(size)
        base = self.fit({BEARING: 0.0} if held else None, residual=[rows])
        found = Information(base, [(DRAG, {}), (LIBRARY["casing.unbalance"], {})])
        assert (found.parameters, [e.name for e, _ in found.candidates]) == (2, [DRAG.name])
        names, jacobian = base.problem.layout.names, base.predictions[0].jacobian
        keys = found._shared
        shared = jacobian[:, [names.index(k) for k in keys]].copy()
        if held:
            shared[:, keys.index(BEARING)] = 0.0
        (trial,) = CaseColumns(base, 0).trials(DRAG)
        own = [i for i, n in enumerate(names) if n not in keys]
        free = np.concatenate([jacobian[:, own], base.problem.data[0].nuisance], axis=1)
        root = np.linalg.cholesky(covariance(base, 1e-7))
        tested = np.linalg.solve(root, np.column_stack([shared, trial.columns]))
        free = np.linalg.solve(root, free / np.maximum(np.linalg.norm(free, axis=0), 1e-300))
        basis, values, _ = np.linalg.svd(free, full_matrices=False)
        basis = basis[:, values > 1e-8 * values[0]]
        tested = tested - basis @ (basis.T @ tested)
        size = np.linalg.norm(tested, axis=0)
        size[size == 0] = 1.0
        scaled = found.present / np.outer(size, size)
        assert scaled == pytest.approx(tested.T @ tested / np.outer(size, size), abs=1e-3)
        right = tested.T @ np.linalg.solve(root, rows)
        assert found.right / size == pytest.approx(right / size, abs=1e-2)

    def test_columns_of_candidates_follow_the_shared_parameters(self):
        found = Information.__new__(Information)
        found._shared = ["a", "b", "c"]
        found.candidates = [(DRAG, {}), (PERIODIC, {}), (DRAG, {})]
        assert [found.places(i) for i in range(3)] == [[3], [4, 5], [6]]

    def test_physics_that_no_model_of_the_paper_has_is_added(self):
        strengths = {f"{DRAG.name}.k": 4e-8, "casing.windage.k": 1e-12}
        base = self.fit(strengths, names=(DRAG.name, "casing.windage", "setup.inertia"))
        found = Information(base, [])
        place = found._shared.index(f"{DRAG.name}.k")
        found._held = {"casing.windage.k"}
        assert found.added() == {DRAG.name: (place, 4e-8)}


class TestPlanned:
    """A planned run of a gyroscope whose parameters are known."""

    RUN = Run(200.0, 10.0, 8.0, (1.0, 5.0), 0.5)

    def planned(self, monkeypatch, run=RUN, values=None):
        def replaced(thing, **changes):
            if isinstance(thing, SimpleNamespace):
                return SimpleNamespace(**(vars(thing) | changes))
            return dataclasses.replace(thing, **changes)

        monkeypatch.setattr(module, "replace", replaced)
        monkeypatch.setattr(module, "Noise", lambda *args: args)
        base = gyroscope(values=values, level=3e-7)
        noise = base.noise[0]
        noise.pure, noise.pure_u, noise.time, noise.process = 1e-7, 2e-8, 0.7, "process"
        base.criteria = DEFAULT
        return base, simulated(base, run)

    def acceleration(self, found):
        """Return the initial angular acceleration of the casing [rad/s2]."""
        casing = found.problem.data[0].record.casing
        early = casing.time < 1.0
        return 2 * np.polyfit(casing.time[early], casing.value[early], 6)[-3]

    @pytest.mark.parametrize(("ring", "surface"), [(1.0, 1.0), (2.0, 1.0), (1.0, 3.0)])
    def test_its_motion_begins_by_the_torques_at_its_start(self, monkeypatch, ring, surface):
        run = dataclasses.replace(self.RUN, ring=ring, surface=surface)
        base, found = self.planned(monkeypatch, run)
        (data,) = found.problem.data
        inertia = base.problem.data[0].record.I_casing
        torque = 2e-7 * (200.0 - 10.0) - surface * 1e-5 - 1e-6 * 10.0
        assert self.acceleration(found) == pytest.approx(torque / (ring * inertia), rel=1e-3)
        assert data.record.I_casing == pytest.approx(ring * inertia)
        casing, rotor = data.record.casing, data.record.rotor
        assert (casing.time[0], casing.time[-1], len(casing.time)) == (0.0, 8.0, 24 * 64)
        assert [(w.time[0], w.time[-1]) for w in rotor] == [(1.0, 1.5), (5.0, 5.5)]
        names = [n.partition("@")[0] for n in found.problem.layout.names]
        theta = dict(zip(names, found.theta, strict=True))
        assert (theta["initial.omega_r"], theta["initial.omega_c"]) == (200.0, 10.0)
        # the parameters of the fit reproduce it
        rest = found.problem.data[0].z - found.predictions[0].rows
        assert np.abs(rest).max() < 1e-3 * np.abs(found.problem.data[0].z).max()

    def test_a_second_of_it_has_the_information_of_a_second_of_the_recording(self, monkeypatch):
        base, found = self.planned(monkeypatch)
        before, after = base.problem.data[0], found.problem.data[0]
        pairs = [(before.casing, before.record.casing, after.record.casing)]
        pairs += [(before.rotor[0], before.record.rotor[0], w) for w in after.record.rotor]
        for run, old, new in pairs:
            length = old.time[-1] - old.time[0]
            independent = run.n_effective / run.scale**2
            per_second = independent / np.median(old.sigma) ** 2 / length
            assert np.ptp(new.sigma) == 0.0
            seconds = new.time[-1] - new.time[0]
            assert len(new.time) / new.sigma[0] ** 2 / seconds == pytest.approx(per_second)

    def test_its_noise_is_that_of_the_recording_without_a_model(self, monkeypatch):
        asked = []
        own = module.TorqueNoise
        monkeypatch.setattr(module, "TorqueNoise", lambda *args: asked.append(args) or own(*args))
        _, found = self.planned(monkeypatch)
        assert asked == [(1e-7, 0.7)]
        ((scale, level, uncertainty, pure, time, _, process),) = found.noise
        assert (scale, level, uncertainty, pure, time, process) == (1.0, 1e-7, 2e-8, 1e-7, 0.7, "process")

    def test_inputs_begin_with_it(self, monkeypatch):
        base = gyroscope(level=3e-7)
        given = []

        class StoppedError(Exception):
            pass

        def path(model, numbers, experiment, inputs):
            given.extend(inputs)
            raise StoppedError

        @dataclasses.dataclass(frozen=True)
        class Recorded:
            time: np.ndarray

        template = base.problem.data[0].record
        record = SimpleNamespace(
            span=template.span, I_casing=template.I_casing, inputs=(Recorded(np.array([BEGIN, BEGIN + 2.0])),)
        )
        base.problem = SimpleNamespace(data=[SimpleNamespace(record=record)], layout=base.problem.layout)
        monkeypatch.setattr(module, "simulate_path", path)
        with pytest.raises(StoppedError):
            simulated(base, self.RUN)
        assert given[0].time.tolist() == [0.0, 2.0]


class TestSets:
    """Sets of at most two candidates; each has a response of unit length, and 400 rows cost 6.0 per parameter."""

    ROWS = 400

    def found(self, columns, residual, kinds=None, *, added=None, thresholds=None):
        """`columns` (rows, columns) belong to one base parameter, the added effects and the candidates in turn."""
        added = added or {}
        kinds = kinds or [{}] * (columns.shape[1] - 1 - len(added))
        widths = [k.get("width", 1) for k in kinds]
        first = 1 + len(added)
        starts = np.cumsum([first, *widths])
        candidates = [
            (
                SimpleNamespace(
                    name=f"e{i}",
                    kind=k.get("kind", "physical"),
                    free=[None] * k.get("free", 1),
                    amplitude=SimpleNamespace(lower=k.get("lower", 0.0)),
                ),
                None,
            )
            for i, k in enumerate(kinds)
        ]
        information = SimpleNamespace(
            added=lambda: added, candidates=candidates, parameters=first,
            places=lambda i: list(range(starts[i], starts[i] + widths[i])),
            present=columns.T @ columns, right=columns.T @ residual,
            fit=SimpleNamespace(problem=SimpleNamespace(rows=self.ROWS)),
        )  # fmt: skip
        return rivals(information, thresholds or [12.0] * len(kinds), DEFAULT)

    @property
    def axes(self):
        return np.linalg.qr(np.random.default_rng(7).standard_normal((self.ROWS, 12)))[0]

    def near(self, one, other, cosine=0.98):
        return cosine * one + math.sqrt(1 - cosine**2) * other

    def test_a_law_with_a_phase_has_strengths_of_any_sign(self):
        base, a, b, c, *_ = self.axes.T
        columns = np.column_stack([base, a, b, self.near(a, c)])
        found = self.found(columns, -10.0 * a + 5.0 * b, [{"width": 2, "free": 1}, {"lower": -np.inf}])
        assert found == []
        found = self.found(columns, -10.0 * a + 1.0 * b, [{"width": 2, "free": 1}, {"lower": -np.inf}])
        assert [r.names for r in found] == [("e0",), ("e1",)]
        assert found[0].strengths == pytest.approx([-10.0, 1.0])
        assert (found[0].columns, found[1].columns) == ((1, 2), (3,))

    def test_strengths_are_those_of_columns_of_any_length(self):
        base, a, b, *_ = self.axes.T
        columns = np.column_stack([base, 1e-3 * a, 1e4 * self.near(a, b)]) + base[:, None] * [0.0, 2.0, 3.0]
        first, second = self.found(columns, 10.0 * a + 4.0 * base)
        assert first.strengths == pytest.approx([1e4])
        assert second.strengths == pytest.approx([9.8e-4])
        assert second.weight == pytest.approx(math.exp(-0.5 * 100 * (1 - 0.98**2)))

    def test_an_effect_of_the_model_can_be_replaced(self):
        """Its strength is 10, so nothing remains in the residuals; a candidate explains the same motion."""
        base, a, b, *_ = self.axes.T
        columns = np.column_stack([base, a, self.near(a, b)])
        found = self.found(columns, np.zeros(self.ROWS), added={"added": (1, 10.0)}, thresholds=[1e9])
        assert [r.names for r in found] == [("added",), ("e0",)]
        assert [r.strengths[0] for r in found] == pytest.approx([10.0, 9.8])
        assert found[0].columns == (1,)

    @pytest.mark.parametrize(("kind", "count"), [("physical", 2), ("measurement", 0)])
    def test_a_fault_of_the_measurement_is_not_a_rival(self, kind, count):
        base, a, b, *_ = self.axes.T
        columns = np.column_stack([base, a, self.near(a, b)])
        assert len(self.found(columns, 10.0 * a, [{}, {"kind": kind}])) == count

    @pytest.mark.parametrize(("own", "count"), [(1e-5, 2), (1e-7, 0)])
    def test_an_effect_that_the_model_absorbs_is_not_a_rival(self, own, count):
        base, a, *_ = self.axes.T
        columns = np.column_stack([base, a, base + own * a])
        assert len(self.found(columns, 10.0 * a + 5.0 * base)) == count

    def test_two_effects_together_have_rivals_as_one_has(self):
        base, a, b, c, *_ = self.axes.T
        columns = np.column_stack([base, a, b, self.near(a, c)])
        found = self.found(columns, 10.0 * a + 9.0 * b)
        assert [r.names for r in found] == [("e0", "e1"), ("e1", "e2")]
        assert found[0].strengths == pytest.approx([10.0, 9.0])
        assert found[0].columns == (1, 2)
        # a friction of negative strength is none
        assert not any("e1" in r.names for r in self.found(columns, 10.0 * a - 9.0 * b))

    def test_equal_responses_are_separate_and_not_a_set(self):
        base, a, *_ = self.axes.T
        found = self.found(np.column_stack([base, a, a]), 10.0 * a)
        assert [r.names for r in found] == [("e0",), ("e1",)]
        assert [r.weight for r in found] == pytest.approx([1.0, 1.0])

    @pytest.mark.parametrize(("determinant", "count"), [(2e-6, 2), (5e-7, 0)])
    def test_two_nearly_equal_responses_are_not_a_set(self, determinant, count):
        """Their difference would describe what a third effect describes."""
        base, a, b, c, *_ = self.axes.T
        second = self.near(a, b, math.sqrt(1 - determinant))
        columns = np.column_stack([base, a, second, self.near(b, c)])
        found = self.found(columns, 10.0 * b, [{"lower": -np.inf}] * 2 + [{}])
        assert [r.names for r in found] == [("e2",), ("e0", "e1")][:count]

    def test_each_free_parameter_costs_the_logarithm_of_the_rows(self):
        base, a, *_ = self.axes.T
        found = self.found(np.column_stack([base, a, a]), 10.0 * a, [{"free": 2}, {"free": 1}])
        assert [r.names for r in found] == [("e1",), ("e0",)]
        assert found[1].weight == pytest.approx(1 / math.sqrt(self.ROWS))

    @pytest.mark.parametrize(("gain", "count"), [(8.1, 2), (7.9, 0)])
    def test_the_best_one_needs_evidence(self, gain, count):
        base, a, *_ = self.axes.T
        columns = np.column_stack([base, a, a])
        assert len(self.found(columns, math.sqrt(gain) * a, thresholds=[1.0, 1.0])) == count

    @pytest.mark.parametrize(
        ("thresholds", "free", "count"),
        [([99.0, 500.0], 1, 2), ([500.0, 99.0], 1, 2), ([101.0, 101.0], 1, 0), ([99.0, 99.0], 3, 2)],
    )
    def test_its_score_exceeds_the_threshold_of_one_candidate(self, thresholds, free, count):
        base, a, *_ = self.axes.T
        columns = np.column_stack([base, a, a])
        kinds = [{"free": free}] * 2
        assert len(self.found(columns, 10.0 * a, kinds, thresholds=thresholds)) == count

    def test_the_most_likely_six_are_kept(self):
        base, a, *others = self.axes.T
        columns = np.column_stack(
            [base, a, *(self.near(a, x, 0.99 - 0.001 * i) for i, x in enumerate(others[:8]))]
        )
        found = self.found(columns, 10.0 * a)
        assert [r.names for r in found] == [(f"e{i}",) for i in range(MOST_RIVALS)]

    def test_a_larger_set_is_not_a_rival_of_its_part(self):
        base, a, b, c, *_ = self.axes.T
        columns = np.column_stack([base, a, self.near(a, b), c])
        found = self.found(columns, 10.0 * a + 0.5 * c)
        assert [r.names for r in found] == [("e0",), ("e1",)]


def test_added_effects_are_physical_ones_with_one_free_strength(monkeypatch):
    monkeypatch.setattr(module, "GENERAL", {"usual"})

    def effect(name, kind="physical", symbol="k"):
        return SimpleNamespace(name=name, kind=kind, amplitude=symbol and SimpleNamespace(symbol=symbol))

    effects = [
        effect("usual"), effect("drag"), effect("camera", "measurement"), effect("own", symbol="c"), effect("held"),
        effect("per case"), effect("shape", symbol=None),
    ]  # fmt: skip
    known = object.__new__(Information)
    estimates = {"drag.k": SimpleNamespace(value=3.0), "own.c": SimpleNamespace(value=-2.0)}
    fit = SimpleNamespace(
        model=SimpleNamespace(smooth=SimpleNamespace(effects=effects)),
        estimates=estimates | {n: SimpleNamespace(value=9.0) for n in ("usual.k", "camera.k", "held.k", "")},
    )
    for name, value in {
        "fit": fit,
        "_shared": ["usual.k", "own.c", "camera.k", "held.k", "drag.k"],
        "_held": {"held.k"},
    }.items():
        object.__setattr__(known, name, value)
    assert known.added() == {"drag": (4, 3.0), "own": (1, -2.0)}
