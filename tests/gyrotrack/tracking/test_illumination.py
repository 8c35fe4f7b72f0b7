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

    off = even_light(light, REACH) / height
    assert np.ptp(off) < 0.02 * off.mean()
    assert np.ptp(even_light(blind, REACH) / height) > 0.1


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


def test_where_a_marker_creeps_about_few_places_its_displacement_is_not_taken_for_light():
    half, creep = REACH + 4.5, np.linspace(-6.0, 6.0, 140)
    place = np.rint(np.arange(140) % 7 * COLUMNS / 7 + creep).astype(int)
    light = AngleMap(1, COLUMNS)
    around = np.arange(-30, 31)
    for middle in place:
        template, seen = (np.clip((half - np.abs(around - shift)) / 6.0, 0.0, 1.0) for shift in (0.0, 1.0))
        expected = np.where(template > 0.4, template, 0.0)
        light.learn(0, (middle + around) % COLUMNS, expected, seen)

    assert light.spacing(REACH) == round(COLUMNS / 7)
    found, fine = even_light(light, REACH), light.heights(REACH, prior=4.0)[0]
    assert abs(found[12] - found[-12]) < 0.3 * abs(fine[12] - fine[-12])
    mean = light.heights(3 * light.spacing(REACH) // 2, prior=4.0)[0]
    np.testing.assert_allclose(found, np.clip(mean, 0.55, 2.0))


def seen_at(distribution):
    """Return the map of a marker with this distribution of angles."""
    light = AngleMap(1, COLUMNS)
    around = np.arange(-REACH, REACH + 1)
    for middle, count in enumerate(distribution):
        expected = np.full(len(around), np.sqrt(count))
        light.learn(0, (middle + around) % COLUMNS, expected, expected)
    return light


ORDER = 2 * np.pi * np.arange(COLUMNS) / COLUMNS


@pytest.mark.parametrize(
    ("waves", "spacing"),
    [
        ({7: 0.11}, round(COLUMNS / 7)),
        ({7: 0.09}, 0),
        ({2: 0.11}, COLUMNS // 2),
        ({1: 0.4}, 0),
        ({9: 0.11}, COLUMNS // 9),
        ({10: 0.4}, 0),  # averaged by a marker of 29 columns: 10 > 0.8 * 360 / 29
        ({7: 0.26, 5: 0.12}, COLUMNS // 5),
        ({7: 0.26, 5: 0.14, 4: 0.1, 3: 0.1}, 0),
        ({7: 0.26, 6: 0.12, 5: 0.07}, round(COLUMNS / 7)),
        ({7: 0.26, 6: 0.14, 5: 0.08}, 0),
        ({7: 0.26, 8: 0.12}, round(COLUMNS / 7)),
        ({7: 0.26, 8: 0.14}, 0),
        ({2: 0.2, 4: 0.2}, COLUMNS // 2),
        ({2: 0.2, 1: 0.11}, 0),
    ],
)
def test_equally_spaced_angles_are_a_harmonic_of_their_distribution(waves, spacing):
    distribution = 1.0 + sum(2.0 * a * np.cos(k * ORDER + 0.4) for k, a in waves.items())
    assert seen_at(distribution).spacing(REACH) == spacing


@pytest.mark.parametrize("share", [0.05, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0])
def test_angles_over_a_part_of_a_turn_are_not_equally_spaced(share):
    distribution = (np.arange(COLUMNS) < share * COLUMNS).astype(float)
    assert seen_at(distribution).spacing(REACH) == 0


def test_a_map_without_passages_or_with_random_ones_has_no_spacing():
    assert AngleMap(1, COLUMNS).spacing(REACH) == 0
    assert seen_at(np.random.default_rng(0).poisson(1.5, COLUMNS)).spacing(REACH) == 0


def test_maps_of_parts_of_a_film_add_up():
    whole, first, second = (AngleMap(1, COLUMNS) for _ in range(3))
    height = 1.0 + 0.3 * np.cos(np.deg2rad(np.arange(COLUMNS)))
    for part in (first, second):
        passages(part, height)
        passages(whole, height)
    first.add(second)
    np.testing.assert_allclose(first.heights(2, prior=1.0), whole.heights(2, prior=1.0), rtol=1e-12)
