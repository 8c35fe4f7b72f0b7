import numpy as np
import pytest

from gyrotrack.tracking._profile import chroma_direction, hue_score

SHADES = {
    "red": [(200, 30, 30), (110, 15, 20), (230, 80, 30)],
    "blue": [(30, 60, 180), (25, 130, 200), (20, 20, 110)],
    "green": [(20, 140, 60), (150, 200, 50), (0, 150, 100)],
}


def _chroma(rgb):
    """BT.601, as the standard prints it."""
    r, g, b = (v / 255 for v in rgb)
    return 224 * (-0.168736 * r - 0.331264 * g + 0.5 * b), 224 * (0.5 * r - 0.418688 * g - 0.081312 * b)


@pytest.mark.parametrize(("name", "rgb"), [(n, s) for n, shades in SHADES.items() for s in shades])
def test_a_shade_scores_highest_under_its_own_name(name, rgb):
    u, v = _chroma(rgb)
    scores = {other: float(hue_score(u, v, chroma_direction(other))) for other in SHADES}
    assert scores[name] > 0
    assert scores[name] == max(scores.values())


def test_grey_scores_nothing_and_what_is_opposite_neither():
    for name in SHADES:
        u, v = chroma_direction(name)
        assert hue_score(0.0, 0.0, (u, v)) == 0
        assert hue_score(-u, -v, (u, v)) == 0


def test_brightness_scales_the_score():
    du, dv = np.array([10.0, 20.0]), np.array([40.0, 80.0])
    low, high = hue_score(du, dv, chroma_direction("red"))
    assert high == pytest.approx(2 * low, rel=1e-6)
