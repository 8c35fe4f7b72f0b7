"""The error of a fitted ellipse is common to all angles, so that fits include it in the strength of a law."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting import Case, fit
from gyrotrack.apps import _spindown
from gyrotrack.apps._spindown import SpindownOptions, _tilt_mode
from gyrotrack.tracking._registration import Ring
from gyrotrack.tracking._tracked import Tracked

TIME = np.arange(0.0, 8.0, 0.02)


def tracked(angle, stretch):
    ring = Ring.about((80.0, 60.0), 10.0, 50.0, finest=20.0, stretch=stretch)
    return SimpleNamespace(angle=angle, ring=ring)


def swing(amplitude):
    law = {"t_span": (0.0, 8.0), "y0": [amplitude, 0.0], "t_eval": TIME, "rtol": 1e-9, "atol": 1e-9}
    return solve_ivp(lambda t, y: [y[1], -9.81 * np.sin(y[0])], **law).y[0]


def uncertainty(mode):
    return float(np.sqrt(np.einsum("ni,ij,nj->n", mode.basis, mode.covariance, mode.basis)).max())


def test_gravity_includes_the_error_of_the_ellipse():
    """A second harmonic of 5 mrad changes gravity by about 0.1 %; without the mode the uncertainty is much smaller."""
    true = swing(1.58)
    seen = true + 0.005 * np.sin(2.0 * true) + np.random.default_rng(1).normal(0.0, 2e-4, len(TIME))
    (mode,) = _tilt_mode(tracked(seen, (0.004, 0.003)))
    stated = {mode.name: {"basis": mode.basis, "covariance": mode.covariance}}
    case = Case.from_arrays(pendulum={"t": TIME, "angle": seen, "u": 2e-4, "modes": stated})
    found = fit("gravity", case).params["gravity.k"]
    assert abs(found.value - 9.81) < 2.0 * found.stderr < 0.1


@pytest.mark.parametrize(
    ("angle", "stretch", "u"),
    [
        (swing(1.58), (0.006, -0.008), 0.01),
        (swing(1.58), (0.06, 0.08), _spindown._STRETCH_U),
        (1.2 * TIME, (0.006, -0.008), 0.01),
        (swing(1.5), (0.006, -0.008), None),
        (1.7 * TIME, (0.006, -0.008), None),
        (swing(1.58), (0.0, 0.0), None),
    ],
)
def test_a_small_ellipse_is_as_uncertain_as_it_is_large(angle, stretch, u):
    """Less than half a turn and more than two turns have no such error."""
    found = _tilt_mode(tracked(angle, stretch))
    assert len(found) == (u is not None)
    if u is not None:
        assert uncertainty(found[0]) == pytest.approx(u, rel=0.4)
        assert found[0].basis.mean(axis=0) == pytest.approx(0.0, abs=1e-12)


def test_the_case_of_a_textured_body_has_the_error(monkeypatch, tmp_path):
    body = object.__new__(Tracked)
    for name, value in vars(tracked(1.2 * TIME, (0.006, 0.008))).items():
        object.__setattr__(body, name, value)
    series = _spindown.no_series()
    case = SimpleNamespace(casing=series)
    film = tmp_path / "wheel.mp4"
    film.write_bytes(b"film")
    monkeypatch.setattr(_spindown, "_film", lambda *_: (None, ("film", body)))
    monkeypatch.setattr(_spindown, "_recording_case", lambda *_: case)
    seen = []

    def stop(old, **changed):
        seen.append(changed)
        raise StopIteration

    monkeypatch.setattr(_spindown, "replace", lambda old, **c: stop(old, **c) if old is case else c)
    with pytest.raises(StopIteration):
        _spindown.read_source(film, SpindownOptions())
    assert seen[0]["casing"]["modes"][0].name == "tilt"
