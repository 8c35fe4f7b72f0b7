"""Errors of the starts of rotor windows and slipped turns, as alternatives to a missing effect."""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import twobody
from cases import data, fitted
from scipy import stats

from fitting import LIBRARY, REDUCED, Candidate, EstimationError, Model, diagnose, fit, make_record
from fitting._criteria import DEFAULT
from fitting.discovery import _measurement, _select
from fitting.discovery._measurement import StartErrors, slip_estimates, starts_are_unknown, with_start_u
from fitting.discovery._score import Level, Score
from fitting.discovery._select import ordered
from fitting.effects._library import START
from fitting.inference._case_data import CaseData
from fitting.inference._record import Samples

UNKNOWN = (np.nan,) * 3
# errors of the starts [s]; a common one would be camera.offset
SHIFTS = (4e-3, -7e-3, 5e-3)


def started_late(record, shifts, start_sigma=UNKNOWN):
    """Return a recording whose windows are stated to start later than they do."""
    windows = tuple(
        Samples(w.time + dt, w.value, w.sigma) for w, dt in zip(record.rotor, shifts, strict=True)
    )
    return replace(record, rotor=windows, start_sigma=start_sigma, digest="")


@cache
def record():
    """Return a recording with few frames: two minutes at 15 per second, and three windows."""
    cameras = twobody.Cameras(span=120.0, windows=(5.0, 58.0, 114.0), casing_rate=15.0, rotor_rate=100.0)
    return make_record(**twobody.film(twobody.simulate(span=120.0), cameras=cameras))


def test_the_fall_is_that_of_two_gaussian_densities():
    """-2 log of N(r; 0, 1 + s^2 C C') against N(r; 0, 1), with the determinant lemma undone."""
    rng = np.random.default_rng(0)
    c, r, s = rng.standard_normal((7, 3)), rng.standard_normal(7), 0.7
    v = np.eye(7) + s**2 * c @ c.T
    white = r @ r
    expected = white - (r @ np.linalg.solve(v, r) + np.linalg.slogdet(v)[1])
    assert _measurement._fall(c.T @ c, c.T @ r, s) == pytest.approx(expected, rel=1e-10)


def test_starts_are_unknown_only_if_nothing_is_stated_about_them():
    for start_sigma, unknown in [(UNKNOWN, True), ((0.0,) * 3, False), ((), False), ((1e-3,) * 3, False)]:
        assert starts_are_unknown([CaseData.of(replace(record(), start_sigma=start_sigma))]) == unknown


@pytest.mark.slow
def test_a_stated_uncertainty_replaces_an_unknown_one_and_keeps_the_noise():
    found = CaseData.of(replace(record(), start_sigma=(np.nan, 2e-3, np.nan)))
    noise = found.process_noise
    stated = found.with_start_u(5e-3)
    assert stated.record.start_sigma == (5e-3, 2e-3, 5e-3)
    assert stated.process_noise is noise
    assert len(stated.start_time_noise.parts) == 3
    assert [i for i, _ in found.start_columns()] == [0, 2]


@pytest.mark.slow
def test_errors_of_starts_are_found_where_nothing_is_stated():
    """The misfit of windows off by 4 to 7 ms: no effect is named, and the errors are those that were made."""
    found = diagnose(fit(fitted().model, [CaseData.of(started_late(data(seed=0, few=True).record, SHIFTS))]))
    first = found.candidates[0]
    assert first.effect is START
    assert found.verdict == "missing_effect"
    assert "--start-u" in found.sentence
    errors = np.array([e.value for e in first.estimates.values()])
    u = np.array([e.stderr for e in first.estimates.values()])
    truth = -np.array(SHIFTS)
    # three errors of which the friction of the bodies absorbs a part, to which the u belongs
    assert (np.abs(errors - truth) < 4 * u).all()
    assert with_start_u(found.fit, 5e-3).verdict == "no_lack_of_fit"


@pytest.mark.parametrize("size", [10.0, 0.01])
def test_the_evidence_for_errors_of_starts_is_that_of_their_refit(size):
    """A base that large errors have bent has too much noise, and the linear fall about it is too small."""
    shifts = tuple(size * s for s in SHIFTS)
    base = fit(Model.of(REDUCED), [CaseData.of(started_late(record(), shifts))])
    starts = StartErrors(base, DEFAULT)
    refitted, about = starts.refit()
    # -2 log of the densities of the rows, whose whitening has the determinant 1 / sqrt(1 + s^2 c'c) for each window
    whitened = [part[2] for part in refitted.problem.data[0].start_time_noise.parts]
    fall = base.deviance - refitted.deviance - sum(np.log1p(x**2) for x in whitened)
    occam = starts.evidence - starts.fall
    assert occam < 0
    assert starts.evidence_of(refitted) == pytest.approx(max(starts.evidence, fall + occam), rel=1e-9)
    truth = -np.array(shifts)
    assert (np.abs(about.errors - truth) < 3 * about.stderrs).all()
    if size == 10.0:
        assert starts.evidence_of(refitted) > 1.2 * starts.evidence
        # the linear estimate about the bent base
        assert (np.abs(starts.errors - truth) > 4 * starts.stderrs).all()
    else:
        assert starts.evidence_of(refitted) < starts.evidence + 3


@pytest.mark.slow
def test_starts_that_are_right_are_not_candidate_of_weight():
    record = replace(data(seed=0).record, start_sigma=UNKNOWN)
    starts = StartErrors(fit(fitted().model, [CaseData.of(record)]), DEFAULT)
    assert starts.p_value > 0.05
    assert starts.evidence < 2


def candidate(effect, delta_bic, **changes):
    none = np.zeros(0)
    screened = Score(effect, -delta_bic, none, ({},), 1, 1, absorbed=False, direction=none, null=none)
    made = Candidate(effect, -delta_bic, delta_bic, 1e-8, np.nan, (), {}, True, screened, object())
    return replace(made, **changes)


WIDTH = DEFAULT.equivalence_width


@pytest.mark.parametrize(
    ("starts", "law", "first"),
    [
        (candidate(START, -30 + 0.9 * WIDTH), -30.0, "camera.start"),
        (candidate(START, -30 + 1.1 * WIDTH), -30.0, "bearing.drift"),
        (candidate(START, -31, significant=False), -30.0, "bearing.drift"),
        (candidate(START, -31, fit=None), -30.0, "bearing.drift"),
    ],
)
def test_unstated_starts_come_first_unless_an_effect_is_better_by_the_width_of_a_class(starts, law, first):
    found = ordered([candidate(LIBRARY["bearing.drift"], law), starts], DEFAULT)
    assert found[0].effect.name == first


@pytest.mark.parametrize(("significant", "refitted"), [(True, True), (False, False)])
def test_measurement_effects_are_refitted_wherever_something_is_significant(significant, refitted):
    """However small their scores: about a base that the fault has bent, a linear score misses it."""
    physical = [e for e in LIBRARY.values() if e.kind == "physical"][: DEFAULT.refit_least + 1]
    laws = [candidate(e, -30.0, p_value=1e-8, significant=significant) for e in physical]
    inertia = candidate(LIBRARY["setup.inertia"], -0.1, p_value=0.9, significant=False)
    assert _select._to_refit([*laws, inertia], DEFAULT)[-1] == refitted


def slipped_case():
    """Return a recording in whose second window a whole turn slipped."""
    record = data(seed=0, few=True).record
    windows = list(record.rotor)
    value = windows[1].value.copy()
    value[700:] += 2 * np.pi
    windows[1] = Samples(windows[1].time, value, windows[1].sigma)
    return replace(record, rotor=tuple(windows), digest="")


@pytest.mark.slow
def test_a_slip_is_named_and_its_fit_is_that_of_the_corrected_angles():
    found = diagnose(fit(fitted().model, [CaseData.of(slipped_case())]))
    assert found.fit.verdict == "no_lack_of_fit"
    assert found.verdict == "missing_effect"
    assert found.candidates[0].effect.name == "camera.slip"
    assert found.sentence.startswith("A whole turn slipped in rotor window 2")
    assert "the model is adequate" not in found.sentence


ENDS = np.array([0, 20, 50])
SIZES = np.geomspace(0.1, 10.0, 21) * DEFAULT.start_u


class Rows:
    """Two cases of 20 and 30 rows with one and two windows; errors of the starts move them by 5 ms each."""

    def __init__(self, deviances=(0.0,), gains=(1.0,), size=5e-3):
        random = np.random.default_rng(3)
        self.own = [random.standard_normal((20, 1)) / 2e-3, random.standard_normal((30, 2)) / 2e-3]
        self.columns = np.zeros((50, 3))
        self.columns[:20, :1], self.columns[20:, 1:] = self.own
        self.rows = self.columns @ (size * np.array([1.0, -1.0, 1.0])) + random.standard_normal(50)
        free = random.standard_normal((50, 2))
        self.levels = [self.level(g, d, free) for g, d in zip(gains, deviances, strict=True)]
        self.ends = ENDS

    def level(self, gain, deviance, free):
        gain = gain * np.ones(50)
        basis = np.linalg.qr(gain[:, None] * free)[0]
        rest = gain * self.rows
        return Level(gain, basis, rest - basis @ (basis.T @ rest), deviance)

    def rotated(self, columns):
        return columns

    def starts(self, monkeypatch, labels=("a", "b")):
        monkeypatch.setattr(_measurement, "ScoreContext", lambda base, draws: self)
        own = self.own if len(labels) > 1 else [self.columns]
        if len(labels) == 1:
            self.ends = np.array([0, 50])
        data = [
            SimpleNamespace(
                start_columns=lambda c=c: list(enumerate(c.T)), record=SimpleNamespace(label=label)
            )
            for c, label in zip(own, labels, strict=True)
        ]
        base = SimpleNamespace(problem=SimpleNamespace(data=data))
        return StartErrors(base, DEFAULT)

    def falls(self):
        """Fall of the deviance at each level and each size, from the density of the rows orthogonal to the base."""
        lowest = min(level.deviance for level in self.levels)
        found = []
        for level in self.levels:
            c = self.projected(level)
            each = []
            for s in SIZES:
                v = np.eye(50) + s**2 * c @ c.T
                r = level.residual
                each.append(r @ r - r @ np.linalg.solve(v, r) - np.linalg.slogdet(v)[1])
            found.append(np.array(each) + lowest - level.deviance)
        return np.array(found)

    def projected(self, level):
        c = level.gain[:, None] * self.columns
        return c - level.basis @ (level.basis.T @ c)


CHOICES = [
    pytest.param({}, id="one level"),
    pytest.param({"deviances": (30.0, 0.0), "gains": (1.0, 0.8)}, id="higher level"),
    pytest.param({"deviances": (0.0, 30.0), "gains": (0.9, 1.0)}, id="lower level"),
    pytest.param({"size": 0.0}, id="without errors"),
]


class TestStartErrors:
    @pytest.mark.parametrize("choice", CHOICES)
    def test_fall_and_evidence_are_those_of_the_densities(self, monkeypatch, choice):
        rows = Rows(**choice)
        found, falls = rows.starts(monkeypatch), rows.falls()
        assert found.fall == pytest.approx(falls.max())
        assert found.evidence == pytest.approx(2 * np.log(np.mean(np.exp(0.5 * falls.max(axis=0)))))
        assert found.u == pytest.approx(SIZES[falls.max(axis=0).argmax()])
        assert found.p_value / (0.5 * stats.chi2.sf(max(falls.max(), 0.0), 1)) == pytest.approx(1.0)
        score = found.score
        assert (score.effect, score.score) == (START, pytest.approx(max(falls.max(), 0.0)))

    @pytest.mark.parametrize("choice", CHOICES)
    def test_the_errors_are_conditional_means(self, monkeypatch, choice):
        rows = Rows(**choice)
        found = rows.starts(monkeypatch)
        level = rows.levels[rows.falls().max(axis=1).argmax()]
        c, s = rows.projected(level), found.u
        v = np.eye(50) + s**2 * c @ c.T
        mean = s**2 * c.T @ np.linalg.solve(v, level.residual)
        covariance = s**2 * np.eye(3) - s**4 * c.T @ np.linalg.solve(v, c)
        assert found.errors == pytest.approx(mean)
        assert found.stderrs == pytest.approx(np.sqrt(np.diag(covariance)))
        along = c @ mean
        assert found.direction == pytest.approx(along / np.linalg.norm(along))

    def test_a_fall_below_zero_is_not_evidence(self, monkeypatch):
        rows = Rows(size=0.0)
        rows.levels = [level._replace(residual=np.zeros(50)) for level in rows.levels]
        found = rows.starts(monkeypatch)
        assert found.fall < 0
        assert (found.p_value, found.score.score) == (0.5, 0.0)

    def test_windows_are_counted_from_one_in_each_recording(self, monkeypatch):
        assert list(Rows().starts(monkeypatch).estimates) == [
            "camera.start.dt@window 1 of a", "camera.start.dt@window 1 of b", "camera.start.dt@window 2 of b",
        ]  # fmt: skip
        assert list(Rows().starts(monkeypatch, ("a",)).estimates) == [
            f"camera.start.dt@window {i}" for i in (1, 2, 3)
        ]

    @pytest.mark.parametrize(("deviance", "gain"), [(60.0, 12.0), (90.0, 0.0)])
    def test_the_evidence_of_a_refit_has_the_same_loss_by_averaging(self, deviance, gain):
        """A fall of 100 - 60, less the increase 5 - 1 of the determinants, against a linear fall of 24."""

        def fit(deviance, *logs):
            data = [SimpleNamespace(start_time_noise=SimpleNamespace(log_determinant=x)) for x in logs]
            return SimpleNamespace(deviance=deviance, problem=SimpleNamespace(data=data))

        starts = StartErrors.__new__(StartErrors)
        starts.base, starts.evidence, starts.fall = fit(100.0, 0.4, 0.6), 20.0, 24.0
        assert starts.evidence_of(fit(deviance, 2.0, 3.0)) == pytest.approx(20.0 + gain)


class TestRefit:
    """The size of the errors about each refit, and the sizes of the fits that it leads to."""

    def refit(self, monkeypatch, first, sizes, fails_at=None):
        asked = []

        def with_start_u(base, u):
            if len(asked) == fails_at:
                raise EstimationError("singular")
            asked.append(u)
            return f"fit {len(asked)}"

        monkeypatch.setattr(_measurement, "with_start_u", with_start_u)
        monkeypatch.setattr(_measurement, "_with_parameters", lambda base, other: (base, other))
        found = iter(sizes)
        monkeypatch.setattr(
            _measurement, "StartErrors", lambda about, criteria: SimpleNamespace(u=next(found), about=about)
        )
        starts = StartErrors.__new__(StartErrors)
        starts.base, starts.criteria, starts.u = "base", DEFAULT, first
        fitted, errors = starts.refit()
        return starts, fitted, errors, asked

    @pytest.mark.parametrize(
        ("sizes", "asked"),
        [
            ([1.9e-3], [1e-3]),
            ([0.51e-3], [1e-3]),
            ([2.1e-3, 2.2e-3], [1e-3, 2.1e-3]),
            ([0.49e-3, 0.5e-3], [1e-3, 0.49e-3]),
            ([3e-3, 9e-3, 27e-3], [1e-3, 3e-3, 9e-3]),
        ],
    )
    def test_it_is_repeated_while_the_size_changes_by_a_factor_of_two(self, monkeypatch, sizes, asked):
        _, fitted, errors, used = self.refit(monkeypatch, 1e-3, sizes)
        assert used == asked
        assert fitted == f"fit {len(asked)}"
        assert errors.about == ("base", fitted)

    def test_without_a_refit_the_errors_are_those_about_the_base(self, monkeypatch):
        starts, fitted, errors, _ = self.refit(monkeypatch, 1e-3, [], fails_at=0)
        assert fitted is None
        assert errors is starts

    def test_a_later_refit_that_fails_leaves_the_one_before(self, monkeypatch):
        _, fitted, errors, _ = self.refit(monkeypatch, 1e-3, [9e-3], fails_at=1)
        assert fitted == "fit 1"
        assert errors.u == 9e-3


def test_a_fit_with_stated_starts_keeps_its_choices(monkeypatch):
    asked = {}
    layout = SimpleNamespace(choices=("share", "per case"), ranges="ranges", ties="ties")
    monkeypatch.setattr(
        _measurement, "ParameterLayout", SimpleNamespace(of=lambda *args: asked.setdefault("layout", args))
    )
    problem = SimpleNamespace(predict=lambda theta: ["prediction"])
    monkeypatch.setattr(_measurement, "Problem", SimpleNamespace(of=lambda layout, data: problem))
    monkeypatch.setattr(_measurement, "recording_noise", lambda data, prediction: (data, prediction))
    monkeypatch.setattr(_measurement, "refine_level", lambda problem, theta, noise: ("refined", theta, noise))
    monkeypatch.setattr(_measurement, "fit", lambda *args, **options: (args, options))
    stated = SimpleNamespace(record="record")
    data = SimpleNamespace(with_start_u=lambda u: stated if u == 5e-3 else None)
    base = SimpleNamespace(
        model="model", theta="theta", values="values", problem=SimpleNamespace(data=[data], layout=layout)
    )
    args, options = with_start_u(base, 5e-3)
    assert args == ("model", [stated])
    assert options == {
        "share": "share", "per_case": "per case", "start": "values",
        "noise": ("refined", "theta", [(stated, "prediction")]),
    }  # fmt: skip
    assert asked["layout"] == ("model", ["record"], "share", "per case", "ranges", "ties")


@pytest.mark.parametrize(
    ("angle", "rotor", "unstated", "unknown"),
    [
        (True, ("window",), True, True),
        (False, ("window",), True, False),
        (True, (), True, False),
        (True, ("window",), False, False),
    ],
)
def test_starts_are_unknown_if_those_of_one_film_of_angles_are(angle, rotor, unstated, unknown):
    known = SimpleNamespace(is_angle=True, record=SimpleNamespace(rotor=("window",), unstated_starts=False))
    one = SimpleNamespace(is_angle=angle, record=SimpleNamespace(rotor=rotor, unstated_starts=unstated))
    assert bool(starts_are_unknown([known, one])) is unknown


def test_slips_are_listed_by_series_and_time():
    slips = [SimpleNamespace(turns=n, where="window 2", time=t) for n, t in ((2, 3.4567), (-1, 8.0))]
    found = slip_estimates(slips)
    assert {k: e.value for k, e in found.items()} == {
        "camera.slip.n@window 2, 3.457 s": 2.0,
        "camera.slip.n@window 2, 8.000 s": -1.0,
    }
    assert not math.isnan(found["camera.slip.n@window 2, 3.457 s"].stderr)
