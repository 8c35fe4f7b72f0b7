"""Several hubs that explain a film: told with both answers if they differ."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _any_body as module
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


def trial(hub, score):
    return SimpleNamespace(ring=SimpleNamespace(hub=hub, outer=100.0), score=score)


@pytest.mark.parametrize(
    ("score", "proposed", "told"),
    [
        (0.79, (40.0, 0.0), True),
        (0.81, (40.0, 0.0), False),  # near enough for a local search, which stays at the given hub
        (0.79, (51.0, 0.0), False),  # farther than half of the radius
    ],
)
def test_another_hub_is_proposed_where_a_given_one_explains_little(monkeypatch, score, proposed, told):
    given, better = trial((0.0, 0.0), score), trial(proposed, 0.95)
    monkeypatch.setattr(module, "propose_hubs", lambda *_: [SimpleNamespace(hub=proposed)])
    monkeypatch.setattr(module, "_trials", lambda *_: [better])
    monkeypatch.setattr(module, "_refined_trial", lambda t, *_, keep: t)
    text = module._doubt_of_hub(given, given, None, SimpleNamespace(area=None))
    assert (text is not None) == told


@pytest.mark.parametrize(
    ("away", "score", "told"),
    [(9.0, 0.96, True), (9.0, 0.94, False), (0.9 * 100 * module._DISPLACED, 0.96, False)],
)
def test_a_given_hub_is_doubted_if_another_one_halves_what_it_leaves(monkeypatch, away, score, told):
    monkeypatch.setattr(module, "_refined_trial", lambda *_, keep: trial((away, 0.0), score))
    given = trial((0.0, 0.0), 0.9)
    text = module._doubt_of_hub(given, given, None, SimpleNamespace(area=None))
    assert (text is not None) == told
