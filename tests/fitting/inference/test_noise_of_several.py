"""Process noise of several recordings, one of them with a noisy camera."""

from types import SimpleNamespace

import numpy as np
import pytest
import twobody

from fitting import REDUCED, Model, fit, make_record
from fitting.inference import _problem
from fitting.inference._case_data import CaseData

LEVEL = 1e-8


def recorded(label, seed, level, sigma, start):
    motion = twobody.simulate(start=start, ou=level, ou_time=0.4, seed=seed, span=100.0)
    cameras = twobody.Cameras(100.0, windows=(5.0, 40.0, 80.0), sigma=sigma)
    return CaseData.of(make_record(**{**twobody.film(motion, seed, cameras), "label": label}))


@pytest.fixture(scope="module")
def quiet_camera():
    return recorded("quiet", 1, LEVEL, 2e-4, (900.0, 5.0))


@pytest.mark.slow
def test_process_noise_is_estimated_with_a_noisy_camera(quiet_camera):
    found = fit(Model.of(REDUCED), [quiet_camera, recorded("loud", 3, LEVEL, 1e-2, (700.0, 12.0))])
    assert found.verdict == "no_lack_of_fit"
    assert [n.pure for n in found.noise] == pytest.approx([LEVEL] * 2, rel=0.5)


@pytest.mark.slow
def test_a_recording_that_excludes_process_noise_has_a_low_level(quiet_camera):
    found = fit(Model.of(REDUCED), [quiet_camera, recorded("still", 3, 0.0, 1e-3, (700.0, 12.0))])
    assert found.verdict == "no_lack_of_fit"
    assert found.noise[0].pure == pytest.approx(LEVEL, rel=0.5)
    assert found.noise[1].pure < 0.3 * LEVEL


@pytest.mark.parametrize(("common", "driven"), [(True, False), (False, False), (False, True)])
def test_recordings_with_a_common_level_keep_it(monkeypatch, common, driven):
    """Of a driven body the level is at most the lowest one that the recording allows, which limits it."""

    class Level(SimpleNamespace):
        def at(self, level):
            return Level(**(vars(self) | {"level": level}))

    noise = [
        Level(pure=1e-9, level=0.0, least=2e-8, whitener=None, excess=0.0, common=common) for _ in range(2)
    ]
    levels = iter([(3e-8, 5.0), (1e-8, 6.0)])
    monkeypatch.setattr(_problem, "remaining_level", lambda *_: next(levels))
    monkeypatch.setattr(_problem, "_rows_at_rest", lambda *_: np.zeros((3, 0)))
    monkeypatch.setattr(_problem, "replace", lambda n, **changed: Level(**(vars(n) | changed)))
    none = np.zeros((3, 0))
    data = SimpleNamespace(
        nuisance=none, harmonic_responses=none, z=np.zeros(3), largest_torque=1.0, driven=driven
    )
    prediction = SimpleNamespace(columns=none, places=np.zeros(0, dtype=int), rows=np.zeros(3))
    layout = SimpleNamespace(
        at_bound=lambda _: np.zeros(0, dtype=bool), model=SimpleNamespace(restoring=False)
    )
    problem = SimpleNamespace(data=[data] * 2, layout=layout, predict=lambda _: [prediction] * 2)
    found = _problem.refine_level(problem, np.zeros(0), noise)
    assert [n.level for n in found] == [2e-8 if driven else 3e-8, 3e-8 if common else 1e-8]
    assert [n.limited for n in found] == [driven] * 2
    assert [n.excess for n in found] == [5.0, 6.0]
    assert [n.common for n in found] == [common] * 2


@pytest.mark.parametrize(
    ("alone", "joint", "common"),
    [
        ((29, 1), (31, 1), True),
        ((31, 1), (31, 1), False),
        ((29, 1), (29, 1), False),
        ((1, 31), (31, 1), False),
    ],
)
def test_a_recording_is_given_up_only_if_the_model_does_not_describe_it_alone(
    monkeypatch, alone, joint, common
):
    """Ratios of the random torque to that of the recording: of each fit alone, and in the joint fit."""
    from fitting.inference import _fit

    class Level(SimpleNamespace):
        def at(self, level):
            return Level(**(vars(self) | {"level": level}))

    def of(ratio):
        return Level(pure=1.0, level=float(ratio), common=False)

    fits = iter([SimpleNamespace(noise=[of(r)], labels=("a",), estimates={}) for r in alone])
    solution = SimpleNamespace(theta=np.zeros(1))
    noise = tuple(of(r) for r in joint)
    monkeypatch.setattr(_fit, "fit", lambda *_, **__: next(fits))
    monkeypatch.setattr(_fit, "search_with_noise", lambda *_, **__: (solution, noise))
    monkeypatch.setattr(_fit, "initial_values", lambda *_: np.zeros(1))
    monkeypatch.setattr(_fit, "_deviance", lambda *_: 0.0)
    monkeypatch.setattr(_problem, "replace", lambda n, **changed: Level(**(vars(n) | changed)))
    problem = SimpleNamespace(data=[None, None], layout=SimpleNamespace(model=None, names=()))
    _, found = _fit._from_separate_fits(problem, solution, noise, quick=False)
    assert [n.common for n in found] == [common] * 2
    assert [n.level for n in found] == ([31.0, 31.0] if common else [float(r) for r in joint])


@pytest.mark.parametrize(
    ("restoring", "gross", "driven", "largest", "level"),
    [
        (False, True, False, 1.0, 3e-8),
        (True, False, False, 1.0, 3e-8),
        (True, True, False, 1.0, 7e-9),
        (True, True, True, 1.0, 7e-9),
        (False, False, True, 1.0, 2e-8),
        (False, False, False, 1e-8, 1e-8),
        (False, False, False, 0.0, 3e-8),
        (False, False, True, 1e-8, 1e-8),
    ],
)
def test_the_level_of_the_residuals_has_its_limits(monkeypatch, restoring, gross, driven, largest, level):
    """Of 3e-8 N m; that of the recording is 7e-9, its least plausible one 2e-8."""

    class Level(SimpleNamespace):
        def at(self, level):
            return Level(**(vars(self) | {"level": level}))

    monkeypatch.setattr(_problem, "remaining_level", lambda whitener, residual, columns: (3e-8, 4.0))
    monkeypatch.setattr(_problem, "fails_grossly", lambda *_: gross)
    monkeypatch.setattr(_problem, "free_columns", lambda data, p, moving: None)
    monkeypatch.setattr(_problem, "replace", lambda n, **changed: Level(**(vars(n) | changed)))
    data = SimpleNamespace(z=np.zeros(3), largest_torque=largest, driven=driven)
    prediction = SimpleNamespace(rows=np.zeros(3))
    layout = SimpleNamespace(
        at_bound=lambda _: np.zeros(0, dtype=bool), model=SimpleNamespace(restoring=restoring)
    )
    problem = SimpleNamespace(data=[data], layout=layout, predict=lambda _: [prediction])
    noise = [Level(level=1.0, pure=7e-9, least=2e-8, whitener=None, common=False)]
    (found,) = _problem.refine_level(problem, np.zeros(0), noise)
    assert (found.level, found.excess, found.limited) == (level, 4.0, driven)


@pytest.mark.parametrize(("share", "gross"), [(0.98, False), (1.02, True)])
@pytest.mark.parametrize("time", [0.3, 2.0])
def test_a_torque_that_makes_the_phase_random_is_a_gross_misfit(monkeypatch, share, gross, time):
    """An oscillation of 1.5 s and 0.2 rad over 40 periods, with an inertia of 3e-4 kg m2."""
    w = 2 * np.pi / 1.5
    criteria = SimpleNamespace(gross_misfit=0.7)
    density = lambda s: 2 * (s / 3e-4) ** 2 * time / (1 + (w * time) ** 2)  # noqa: E731
    unit = np.sqrt(density(1.0) * 60.0 / 2) / (0.2 * w)
    level = share * 0.7 / unit
    monkeypatch.setattr(_problem, "remaining_level", lambda whitener, residual, columns: (level, 0.0))
    motion = SimpleNamespace(
        period=1.5, periods=40, slow_motion=SimpleNamespace(amplitude=np.array([0.2, -0.2]))
    )
    none = np.zeros((2, 0))
    data = SimpleNamespace(
        motion=motion, nuisance=none, z=np.zeros(2), criteria=criteria, record=SimpleNamespace(I_casing=3e-4)
    )
    prediction = SimpleNamespace(columns=none, rows=np.zeros(2))
    noise = SimpleNamespace(whitener=None, time=time)
    assert _problem.fails_grossly(data, prediction, noise) is gross
    motion.slow_motion = None
    assert not _problem.fails_grossly(data, prediction, noise)
