import numpy as np
import pytest

from gyrotrack.tracking._marker_window import AngleMap, even_light, open_columns

COLUMNS, REACH = 360, 14


def passages(cover: AngleMap, height: np.ndarray) -> None:
    """Let a paper pass every angle: in each window its profile, times what is seen of it there."""
    expected = np.clip((REACH + 4.5 - np.abs(np.arange(-20, 21))) / 6.0, 0.0, 1.0)
    for middle in range(0, COLUMNS, 3):
        column = (middle + np.arange(-20, 21)) % COLUMNS
        shown = np.where(expected > 0.4, expected, 0.0)
        cover.learn(0, column, shown, expected * height[column])


def test_a_white_paper_does_not_show_the_lamps_that_mirror_beneath_it():
    angle = np.arange(COLUMNS)
    ground = 1.2 + 0.15 * np.exp(-0.5 * ((angle - 130) / 4.0) ** 2)  # a streak narrower than the paper
    paper = 2.2 * (1.0 + 0.05 * np.cos(np.deg2rad(angle)))  # in slowly changing light
    height = paper - ground

    light = AngleMap(1, COLUMNS, ground)
    passages(light, height)
    blind = AngleMap(1, COLUMNS)
    passages(blind, height)

    off = light.heights(REACH, prior=4.0)[0] / height
    assert np.ptp(off) < 0.02 * off.mean()
    assert np.ptp(blind.heights(REACH, prior=4.0)[0] / height) > 0.1


@pytest.mark.parametrize("edge", [1.0, 5.0])
def test_what_hides_a_marker_reaches_as_far_as_its_edge_is_blurred(edge):
    beside = np.abs(np.arange(COLUMNS) - 90.0) - 10.0  # from the edge of a bar, outwards
    height = np.clip(0.5 + beside / (2.0 * edge), 0.0, 1.0)
    cover = AngleMap(1, COLUMNS)
    passages(cover, height)

    open_ = open_columns(cover, shadows=True)

    assert not open_[height < 0.95].any()
    assert open_columns(cover, shadows=False)[beside > 3.0].all()
    assert open_[beside > edge + 3.0].all()


def test_a_soft_shadow_far_from_the_bar_hides_nothing():
    height = 1.0 - 0.2 * np.exp(-0.5 * ((np.arange(COLUMNS) - 200.0) / 10.0) ** 2)
    cover = AngleMap(1, COLUMNS)
    passages(cover, height)

    assert open_columns(cover, shadows=True).all()


def seen_nearly_in_step(order):
    """Return the map of a marker that is displaced by a column, with nearly `order` frames per turn."""
    half, creep = REACH + 4.5, np.linspace(-6.0, 6.0, 20 * order)
    place = np.rint(np.arange(20 * order) % order * COLUMNS / order + creep).astype(int)
    light = AngleMap(1, COLUMNS)
    around = np.arange(-30, 31)
    for middle in place:
        template, seen = (np.clip((half - np.abs(around - shift)) / 6.0, 0.0, 1.0) for shift in (0.0, 1.0))
        expected = np.where(template > 0.4, template, 0.0)
        light.learn(0, (middle + around) % COLUMNS, expected, seen)
    return light


@pytest.mark.parametrize("order", [5, 7, 10])
def test_where_a_marker_moves_slowly_about_few_angles_its_displacement_is_not_illumination(order):
    light = seen_nearly_in_step(order)
    found, fine = even_light(light, REACH), light.heights(REACH, prior=4.0)[0]
    assert abs(found[12] - found[-12]) < 0.3 * abs(fine[12] - fine[-12])


@pytest.mark.parametrize(("reach", "width"), [(REACH, 145), (80, 161)])
def test_the_illumination_is_a_mean_over_two_fifths_of_a_turn_or_a_wider_marker(reach, width):
    """A dark column of n passages in a turn of equal ones: (n h + 4) / (n + 4), with h = 1 - 0.9 / width."""
    light = AngleMap(1, COLUMNS)
    heights = np.ones(COLUMNS)
    heights[100] = 0.1
    for _ in range(50):
        light.learn(0, np.arange(COLUMNS), np.ones(COLUMNS), heights)
    found = even_light(light, reach)
    n = 50 * width
    assert found[100] == pytest.approx((n * (1 - 0.9 / width) + 4) / (n + 4), rel=1e-9)
    assert np.flatnonzero(found < 0.999).tolist() == list(range(100 - width // 2, 101 + width // 2))


def test_maps_of_parts_of_a_film_add_up():
    whole, first, second = (AngleMap(1, COLUMNS) for _ in range(3))
    height = 1.0 + 0.3 * np.cos(np.deg2rad(np.arange(COLUMNS)))
    for part in (first, second):
        passages(part, height)
        passages(whole, height)
    first.add(second)
    np.testing.assert_allclose(first.heights(2, prior=1.0), whole.heights(2, prior=1.0), rtol=1e-12)
