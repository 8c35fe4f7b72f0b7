"""Process noise of several recordings, one of them with a noisy camera."""

import pytest
import twobody

from fitting.dynamics._model import Model
from fitting.effects._library import REDUCED
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
