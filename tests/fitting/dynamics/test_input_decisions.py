"""Recorded inputs: values, slopes, integrals and changes with known numbers."""

from itertools import pairwise

import numpy as np
import pytest

from fitting import Input, RecordError
from fitting.dynamics._inputs import means_in, values_at

T, V = np.array([1.0, 2.0, 4.0, 5.0]), np.array([0.0, 3.0, -1.0, -1.0])


def made(kind="linear", delay=0.0, **more):
    return Input("u", T, V, "A", interpolation=kind, delay=delay, **more)


@pytest.mark.parametrize("delay", [0.0, 0.5, -0.25])
@pytest.mark.parametrize("late", [0.0, 0.125])
def test_values_and_slopes_follow_the_samples(delay, late):
    t = np.array([0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 4.5, 5.0, 9.0])
    shifted = t + delay + late
    assert made(delay=delay)(shifted, late).tolist() == [0.0, 0.0, 1.5, 3.0, 1.0, -1.0, -1.0, -1.0, -1.0]
    assert made(delay=delay).slope(shifted, late).tolist() == [0.0, 3.0, 3.0, -2.0, -2.0, 0.0, 0.0, 0.0, 0.0]
    held = made("hold", delay)
    assert held(shifted, late).tolist() == [0.0, 0.0, 0.0, 3.0, 3.0, -1.0, -1.0, -1.0, -1.0]
    assert held.slope(shifted, late).tolist() == [0.0] * 9


@pytest.mark.parametrize("kind", ["linear", "hold"])
def test_integrals_and_means_are_those_of_the_curve(kind):
    u = made(kind, 0.5)
    edges = np.array([0.0, 1.75, 2.0, 4.0, 8.0])
    fine = [np.linspace(a, b, 40001)[:-1] + (b - a) / 80000 for a, b in pairwise(edges)]
    means = [u(x).mean() for x in fine]
    assert u.means(edges) == pytest.approx(means, abs=1e-4)
    assert u.integral(edges) == pytest.approx(
        np.concatenate([[0.0], np.cumsum(means * np.diff(edges))]), abs=1e-3
    )
    assert means_in([u], edges)[u.symbol] == pytest.approx(means, abs=1e-4)
    assert values_at([u], edges)[u.symbol].tolist() == u(edges).tolist()


def test_jumps_and_changes_are_at_the_times_they_act():
    times, change = made("hold", 0.5).jumps()
    assert times.tolist() == [2.5, 4.5, 5.5]
    assert change.tolist() == [3.0, -4.0, 0.0]
    assert made("hold", 0.5).changes(0.0, 9.0).tolist() == [2.5, 4.5]
    assert made("hold", 0.5).changes(0.0, 9.0, 1.0).tolist() == [3.5, 5.5]
    assert made("hold").changes(2.0, 4.0).tolist() == []
    assert made("linear").changes(0.0, 9.0).tolist() == [1.0, 2.0, 4.0]
    assert made("linear").changes(1.0, 4.0).tolist() == [2.0]
    assert Input("u", [1.0], [2.0]).changes(0.0, 9.0).tolist() == []
    assert Input("u", [1.0], [2.0]).slope(np.array([0.0, 2.0])).tolist() == [0.0, 0.0]
    assert made().varies
    assert not Input("u", [1.0, 2.0], [2.0, 2.0]).varies


def test_uncertainties_are_interpolated():
    u = made(u=np.array([0.1, 0.3, 0.1, 0.1]))
    assert u.uncertainty(np.array([0.0, 1.5, 3.0])) == pytest.approx([0.1, 0.2, 0.2])
    assert made("hold", u=np.array([0.1, 0.3, 0.1, 0.1])).uncertainty(np.array([2.5])) == pytest.approx([0.3])
    assert made().uncertainty(np.array([0.0, 1.5])).tolist() == [0.0, 0.0]
    for wrong in ([0.1, 0.1, -0.1, 0.1], [0.1, 0.1, 0.1], [0.1, 0.1, 0.1, np.nan]):
        with pytest.raises(RecordError):
            made(u=np.array(wrong))
    assert made(u=np.zeros(4)).u.tolist() == [0.0] * 4


@pytest.mark.parametrize(("most", "same"), [(3, True), (2, False)])
def test_an_input_with_more_changes_is_averaged(most, same):
    u = made(delay=0.5, u=np.array([0.1, 0.3, 0.1, 0.1]))
    found = u.followed(0.0, 6.0, most)
    assert (found is u) is same
    if not same:
        edges = np.array([0.0, 3.0, 6.0])
        assert found.interpolation == "hold"
        assert (found.time + 0.5).tolist() == edges[:-1].tolist()
        assert found.value == pytest.approx(u.means(edges))
        assert found.u == pytest.approx(u.uncertainty(edges[:-1]))
        assert found.integral(edges) == pytest.approx(u.integral(edges))


@pytest.mark.parametrize(
    ("kind", "delay", "first", "last", "covers"),
    [
        ("linear", 0.0, 0.1, 5.9, True),
        ("linear", 0.0, -0.1, 5.0, False),
        ("linear", 0.0, 1.0, 6.1, False),
        ("linear", 0.5, -0.4, 6.4, True),
        ("linear", -0.5, -0.6, 6.4, False),
        ("linear", 0.5, -0.4, 6.6, False),
        ("hold", 0.0, 0.1, 99.0, True),
        ("hold", 0.0, -0.1, 5.0, False),
    ],
)
def test_one_interval_and_the_delay_may_be_missing(kind, delay, first, last, covers):
    """The median interval of the samples is 1 s."""
    u = made(kind, delay)
    if covers:
        u.refuse_uncovered(first, last)
    else:
        with pytest.raises(RecordError, match="is known from"):
            u.refuse_uncovered(first, last)


def test_a_single_sample_covers_any_record():
    Input("u", [3.0], [1.0]).refuse_uncovered(-1e6, 1e6)
