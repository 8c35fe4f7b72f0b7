"""Bounds of a next run by the bodies of a case, and trial frequencies by the length of a record."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting import make_record
from fitting.discovery import _grammar
from fitting.discovery._next_run import Bounds

TIME = np.linspace(0.0, 20.0, 50)
RUN = (TIME, 20.0 - TIME, np.full(50, 0.1))


def fit_of(rotor):
    record = make_record(casing=RUN, rotor=rotor, I_rotor=5e-5, I_casing=2e-5, quantity="omega")
    speeds = np.stack([np.linspace(900.0, 600.0, 50), np.linspace(5.0, 40.0, 50)], axis=1)
    data = SimpleNamespace(initial_speeds=(TIME, speeds), record=record)
    return SimpleNamespace(problem=SimpleNamespace(data=[data]))


def test_the_rotor_is_spun_up_and_the_casing_turns_in_either_sense():
    found = Bounds.of(fit_of([RUN]))
    assert found.omega_rotor == (300.0, 900.0)
    assert found.omega_casing == (-40.0, 40.0)
    assert found.duration == (10.0, 40.0)
    assert found.reversible


def test_a_body_alone_is_spun_up_itself():
    found = Bounds.of(fit_of([]))
    assert found.omega_rotor == (0.0, 0.0)
    assert found.omega_casing == (pytest.approx(40.0 / 3.0), 40.0)
    assert not found.reversible


@pytest.mark.parametrize("span", [0.2, 200.0])
def test_trial_frequencies_end_at_a_phase_of_a_thousand_radians(span):
    """Five radians per second in the 200 s of the paper."""
    assert _grammar._HIGHEST == 200.0 * 5.0
    shape = _grammar._shape("w", "frequency", 100.0, span)
    assert max(shape.grid) == pytest.approx(1000.0 / span, rel=1e-3)
    assert shape.upper == pytest.approx(2000.0 / span)
