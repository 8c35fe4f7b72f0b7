"""Several hubs that explain a film: told with both answers if they differ."""

import numpy as np
import pytest

from gyrotrack.tracking._any_body import rival_hub

ANGLE = np.linspace(0.0, 0.4, 50)


@pytest.mark.parametrize(
    ("hub", "angle", "share", "told"),
    [
        ((130.0, 100.0), 1.3 * ANGLE, 0.90, True),
        ((130.0, 100.0), 1.3 * ANGLE, 0.891, True),  # 0.109 unexplained for 0.100
        ((130.0, 100.0), 1.3 * ANGLE, 0.889, False),
        ((130.0, 100.0), 1.06 * ANGLE, 0.90, True),
        ((130.0, 100.0), 1.04 * ANGLE, 0.90, False),  # the same answer
        ((106.0, 100.0), 1.3 * ANGLE, 0.90, True),
        ((104.0, 100.0), 1.3 * ANGLE, 0.90, False),  # the same hub within 5 % of the radius
    ],
)
def test_another_hub_is_reported_if_it_explains_as_much_and_answers_differently(hub, angle, share, told):
    found = [((100.0, 100.0), 100.0, ANGLE, 0.90), (hub, 100.0, angle, share)]
    text = rival_hub(found, 0)
    assert (text is not None) == told
    if told:
        assert f"{np.ptp(angle):.3g} rad" in text
        assert "0.4 rad" in text
