"""Process noise of several recordings, one of them with a noisy camera."""

from types import SimpleNamespace

import numpy as np
import pytest
import twobody

from fitting.dynamics._model import Model
from fitting.effects._library import REDUCED
from fitting.inference import _problem
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._record import make_record

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


@pytest.mark.parametrize(
    ("ratios", "common"), [((31.0, 2.0), True), ((29.0, 2.0), False), ((40.0, 35.0), True), ((31.0,), False)]
)
def test_no_case_is_given_up_for_the_others(monkeypatch, ratios, common):
    """A level of 31 times the process noise of one recording is that of all recordings of a joint fit."""

    class Level(SimpleNamespace):
        def at(self, level):
            return Level(**(vars(self) | {"level": level}))

    noise = [Level(pure=1e-9, level=0.0, whitener=None, excess=0.0) for _ in ratios]
    levels = iter([(r * 1e-9, 5.0) for r in ratios])
    monkeypatch.setattr(_problem, "remaining_level", lambda *_: next(levels))
    monkeypatch.setattr(_problem, "_rows_at_rest", lambda *_: np.zeros((3, 0)))
    monkeypatch.setattr(_problem, "replace", lambda n, **changed: Level(**(vars(n) | changed)))
    none = np.zeros((3, 0))
    data = SimpleNamespace(nuisance=none, harmonic_responses=none, z=np.zeros(3), largest_torque=1.0)
    prediction = SimpleNamespace(columns=none, places=np.zeros(0, dtype=int), rows=np.zeros(3))
    layout = SimpleNamespace(
        at_bound=lambda _: np.zeros(0, dtype=bool), model=SimpleNamespace(restoring=False)
    )
    problem = SimpleNamespace(
        data=[data] * len(ratios), layout=layout, predict=lambda _: [prediction] * len(ratios)
    )
    found = _problem.refine_level(problem, np.zeros(0), noise)
    expected = [max(ratios)] * len(ratios) if common else list(ratios)
    assert [n.level for n in found] == pytest.approx([1e-9 * r for r in expected])
    assert [n.excess for n in found] == [5.0] * len(ratios)
