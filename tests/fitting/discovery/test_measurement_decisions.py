"""Errors of the starts of rotor windows against normal densities of the rows; what is kept when they are fitted."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from fitting import EstimationError
from fitting._criteria import DEFAULT
from fitting.discovery import _measurement as module
from fitting.discovery._measurement import StartErrors, slip_estimates, starts_are_unknown, with_start_u
from fitting.discovery._score import Level
from fitting.effects._library import START

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
        monkeypatch.setattr(module, "ScoreContext", lambda base, draws: self)
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

        monkeypatch.setattr(module, "with_start_u", with_start_u)
        monkeypatch.setattr(module, "_with_parameters", lambda base, other: (base, other))
        found = iter(sizes)
        monkeypatch.setattr(
            module, "StartErrors", lambda about, criteria: SimpleNamespace(u=next(found), about=about)
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
        module, "ParameterLayout", SimpleNamespace(of=lambda *args: asked.setdefault("layout", args))
    )
    problem = SimpleNamespace(predict=lambda theta: ["prediction"])
    monkeypatch.setattr(module, "Problem", SimpleNamespace(of=lambda layout, data: problem))
    monkeypatch.setattr(module, "recording_noise", lambda data, prediction: (data, prediction))
    monkeypatch.setattr(module, "refine_level", lambda problem, theta, noise: ("refined", theta, noise))
    monkeypatch.setattr(module, "fit", lambda *args, **options: (args, options))
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
