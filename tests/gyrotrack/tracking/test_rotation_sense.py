import numpy as np
import pytest

from gyrotrack.tracking._association import find_rotation_sense, net_turn, unfold


def test_the_casing_decides():
    assert find_rotation_sense({"casing": -40.0, "rotor": 300.0}, None) == -1
    assert find_rotation_sense({"casing": 0.1, "rotor": 300.0}, None) == 1
    assert find_rotation_sense({"casing": 0.0}, None) == -1
    assert find_rotation_sense({"casing": -40.0}, 1) == 1


def test_net_turn_passes_over_gaps():
    assert net_turn(np.array([np.nan, 1.0, 2.0, np.nan, 5.0, np.nan])) == 4.0
    assert net_turn(np.full(3, np.nan)) == 0.0


def test_spokes_that_seem_to_turn_back_are_unfolded():
    k = np.arange(50)
    true = 3.6 * k  # more than half a turn a frame
    seen = np.unwrap(np.angle(np.exp(1j * true)))
    assert seen[-1] < 0
    angle, changed = unfold(seen, 1)
    assert changed
    np.testing.assert_allclose(angle, true, atol=1e-9)


@pytest.mark.parametrize("step", [0.5, 1e-3, -1e-3])
def test_what_turns_rightly_or_hardly_stays(step):
    angle = step * np.arange(50)
    same, changed = unfold(angle, 1)
    assert not changed
    np.testing.assert_array_equal(same, angle)
