"""Decisions of a proposed profile: hues that move, groups that turn together, names of bodies and markers."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import Profile, TrackingError
from gyrotrack.tracking import _proposal as module
from gyrotrack.tracking._acquisition import Rings, SampledMarker
from gyrotrack.tracking._orbit import Orbit
from gyrotrack.tracking._polar import Ring
from gyrotrack.tracking._profile import MarkerProfile
from gyrotrack.tracking._proposal import (
    Candidate,
    Circle,
    Group,
    MovingColour,
    ProposedMarker,
    SteadyRotation,
    apart,
    direction_of,
    find_circle,
    find_orbit,
    group_bodies,
    left_out,
    moving_colour,
    name_bodies,
    name_markers,
    resting_casing,
    rotation,
)
from gyrotrack.tracking._scene import Disc, Marker

RED, GREEN, BLUE = 108.0, 228.0, 333.0
GRID = 2.0 * np.pi / 32.0  # divided by the number of frames: the step between trial steps


def _candidate(hue=RED, contrast=50.0, angle=None, clear=None, *, ambiguous=False, **marker):
    angle = np.zeros(20) if angle is None else np.asarray(angle, dtype=float)
    clear = np.ones(len(angle), dtype=bool) if clear is None else np.asarray(clear)
    shade = contrast * np.cos(np.deg2rad(hue)), contrast * np.sin(np.deg2rad(hue))
    own = {"inner": 40.0, "outer": 50.0, "half_width": 0.1, "foot": 0.15, "dwell": 0.1} | marker
    return Candidate(
        hue, SampledMarker(Marker("x", "rotor", "red", contrast=shade, **own), angle, clear), ambiguous
    )


def _group(step, *members, share=1.0):
    return Group(members or (_candidate(),), SteadyRotation(step, share))


def _samples(chroma):
    return SimpleNamespace(
        chroma=chroma, to_luma=lambda x, y: (2.0 * x + 0.5, 2.0 * y + 0.5), frames=[None] * chroma.shape[1]
    )


def test_a_moving_colour_changes_by_more_than_six_grey_levels():
    chroma = np.full((2, 9, 6, 6), 128, dtype=np.uint8)
    for k, (u, v) in enumerate([(6, 0), (7, 0), (0, 6), (0, -7), (6, 1), (30, 40)]):
        chroma[0, k, 0, k] += u
        chroma[1, k, 0, k] = 128 + v
    change = moving_colour(_samples(chroma)).change
    seen = [tuple(change[:, k, 0, k]) for k in range(6)]
    assert seen == [(0, 0), (7, 0), (0, 0), (0, -7), (6, 1), (30, 40)]
    assert np.count_nonzero(np.hypot(*change)) == 4


def test_a_pixel_that_loses_saturation_shows_the_background_of_a_marker():
    chroma = np.full((2, 9, 4, 4), 128, dtype=np.uint8)
    chroma[0, :, 1, 1] = 168  # a marker covers the pixel in most samples
    chroma[0, 3, 1, 1] = 128
    chroma[0, 4, 1, 1] = 100  # bluish beyond grey, but less than the marker
    chroma[0, 5, 1, 1] = 80
    change = moving_colour(_samples(chroma)).change
    np.testing.assert_array_equal(change[0, :, 1, 1], [0, 0, 0, 0, 0, -88, 0, 0, 0])


def test_noise_triples_the_limit_of_a_moving_colour():
    chroma = np.full((2, 9, 4, 10), 128, dtype=np.uint8)
    chroma[0, ::2] = 128 + 4  # the median is 132; four of nine samples differ by 4
    chroma[0, 1, 0, 0], chroma[0, 3, 0, 0] = 132 + 11, 132 + 13
    change = moving_colour(_samples(chroma)).change
    assert sorted(set(change[0].ravel().tolist())) == [0.0, 13.0]


def _hues(*hues_and_sizes):
    pixels = np.array([[s * np.cos(np.deg2rad(h)), s * np.sin(np.deg2rad(h))] for h, s in hues_and_sizes])
    return np.rad2deg(module._peaks(pixels.T.astype(np.float32)[:, :, None, None])) % 360.0


@pytest.mark.parametrize(
    ("hues", "found"),
    [
        ([(61.5, 100.0), (151.5, 200.0)], [151.5, 61.5]),
        ([(61.5, 100.0), (91.5, 90.0)], [61.5, 91.5]),
        ([(61.5, 100.0), (82.5, 90.0)], [61.5]),
        ([(1.5, 100.0), (340.5, 90.0)], [1.5]),
        ([(-1.5, 100.0), (31.5, 90.0)], [358.5, 31.5]),
        ([(61.5, 100.0), (241.5, 0.5)], [61.5, 241.5]),
        ([(61.5, 100.0), (241.5, 0.3)], [61.5]),
    ],
)
def test_hues_are_the_peaks_of_the_histogram_of_the_change(hues, found):
    np.testing.assert_allclose(_hues(*hues), found, atol=0.01)


def test_eight_hues_are_proposed():
    assert len(_hues(*((1.5 + 39.0 * k, 100.0 - k) for k in range(9)))) == 8
    np.testing.assert_allclose(
        _hues(*((1.5 + 39.0 * k, 100.0 - k) for k in range(8))), 1.5 + 39.0 * np.arange(8)
    )


@pytest.mark.parametrize(
    ("pixel", "hues", "scored"),
    [(19.0, (0.0, 40.0), True), (21.0, (0.0, 40.0), False), (44.0, (0.0,), True), (46.0, (0.0,), False)],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pixel_belongs_to_the_nearest_hue_within_its_sector(pixel, hues, scored, sign):
    angle = sign * np.deg2rad(pixel)
    change = np.array([10.0 * np.cos(angle), 10.0 * np.sin(angle)], dtype=np.float32).reshape(2, 1, 1, 1)
    score = MovingColour(change, tuple(sign * np.deg2rad(h) for h in hues)).scores(0.0)
    expected = 10.0 * (np.cos(angle) - abs(np.sin(angle))) if scored else 0.0
    assert score.item() == pytest.approx(expected, rel=1e-5)


def test_hues_have_directions_and_distances_across_the_zero():
    assert direction_of(2.0) == pytest.approx((np.cos(2.0), np.sin(2.0)))
    assert apart(0.1, 6.2) == pytest.approx(0.1 + 2.0 * np.pi - 6.2)
    assert module._hue((0.0, -2.0)) == pytest.approx(270.0)
    assert module._hue((-1.0, 1.0)) == pytest.approx(135.0)


def test_blobs_exceed_a_part_of_the_typical_peak_of_their_colour():
    change = np.zeros((2, 5, 12, 12), dtype=np.float32)
    for k, height in enumerate([100.0, 100.0, 100.0, 41.0, 39.0]):
        change[0, k, 4:7, 4:7] = height
    assert [len(b) for b in module._blobs(MovingColour(change, (0.0,)), 0.0)] == [1, 1, 1, 1, 0]
    faint = np.zeros((2, 2, 12, 12), dtype=np.float32)
    faint[0, 0, 4:7, 4:7], faint[0, 1, 4:7, 4:7] = 3.9, 4.1
    assert [len(b) for b in module._blobs(MovingColour(faint, (0.0,)), 0.0)] == [0, 1]
    assert module._blobs(MovingColour(np.zeros((2, 2, 3, 3), dtype=np.float32), (0.0,)), 0.0) == [[], []]


@pytest.mark.parametrize("hub", [None, (80.5, 60.5)])
def test_the_orbit_of_a_coloured_blob_is_found_with_and_without_a_hub(hub, monkeypatch):
    monkeypatch.setattr(module, "TRIALS", 60)
    change = np.zeros((2, 12, 60, 80), dtype=np.float32)
    for k in range(12):
        x, y = round(40 + 20 * np.cos(k * 0.5)), round(30 - 20 * np.sin(k * 0.5))
        change[0, k, y - 1 : y + 2, x - 1 : x + 2] = 50.0
    orbit = find_orbit(_samples(change), MovingColour(change, (0.0,)), hub)
    np.testing.assert_allclose(orbit.centre, (80.5, 60.5), atol=0.5)
    assert orbit.radii[0] == pytest.approx(40.0, abs=0.6)
    assert find_orbit(_samples(change), MovingColour(0.0 * change, (0.0,)), hub) is None
    # about another hub the blob does not move on a circle
    assert find_orbit(_samples(change), MovingColour(change, (0.0,)), (5.0, 5.0)) is None


ORBIT = Orbit((100.0, 80.0), {0: 60.0, 1: 40.0}, 20, 6.0)


@pytest.mark.parametrize(
    ("distance", "chroma", "found"),
    [(11.0, 30.0, True), (13.0, 30.0, False), (0.0, 13.9, False), (0.0, 14.1, True)],
)
def test_a_disc_is_near_the_centre_of_the_smallest_orbit_and_has_chroma(distance, chroma, found, monkeypatch):
    def find_disc(_, direction, orbit):
        assert orbit is ORBIT
        # the chroma is strongest in the direction of 150 degrees
        strength = max(direction @ np.array([np.cos(2.5), np.sin(2.5)]), 0.0)
        hue = np.arctan2(direction[1], direction[0])
        if strength < 0.9:
            return None
        return Disc((100.0 + distance, 80.0), 5.0, (chroma * np.cos(hue), chroma * np.sin(hue)))

    monkeypatch.setattr(module, "find_disc", lambda s, d, o: find_disc(s, np.array(d), o))
    circle = find_circle(None, ORBIT)
    assert (circle is not None) == found
    if found:
        assert circle.disc.centre == (100.0 + distance, 80.0)
        assert round(circle.hue) in (120, 150)


def test_the_disc_with_most_chroma_is_measured_with_its_own_hue(monkeypatch):
    asked = []

    def find_disc(_, direction, __):
        hue = round(float(np.rad2deg(np.arctan2(direction[1], direction[0])) % 360.0))
        asked.append(hue)
        # 35 degrees with the trial hue 30, 60 degrees (weaker) with others, 36 degrees with its own
        own, size = {30: (35.0, 40.0), 35: (36.0, 41.0)}.get(hue, (60.0, 20.0))
        return Disc((100.0, 80.0), 5.0, (size * np.cos(np.deg2rad(own)), size * np.sin(np.deg2rad(own))))

    monkeypatch.setattr(module, "find_disc", find_disc)
    assert find_circle(None, ORBIT).hue == pytest.approx(36.0)
    assert asked == [*range(0, 360, 30), 35]


@pytest.mark.parametrize(
    ("contrast", "hue", "clear", "alike"),
    [
        (20.0, 108.0, 20, True),
        (17.0, 108.0, 20, False),
        (40.0, 108.0, 10, True),
        (40.0, 108.0, 8, False),
        (50.0, 125.0, 20, True),
        (50.0, 127.0, 20, False),
        (50.0, 89.0, 20, False),
    ],
)
def test_a_second_patch_of_a_hue_is_a_rival(contrast, hue, clear, alike):
    other = _candidate(hue, contrast, clear=np.arange(20) < clear)
    assert module._alike(_candidate(), other) == alike


def test_hues_differ_across_the_zero_by_the_short_way():
    assert module._alike(_candidate(5.0), _candidate(355.0))
    assert not module._alike(_candidate(15.0), _candidate(355.0))


@pytest.mark.parametrize("dwell", [0.29, 0.31])
def test_a_marker_is_replaced_by_the_background(dwell):
    ring = Ring((50.0, 50.0), 20.0, 30.0, 4, 64)
    strips = np.full((2, 5, 4, 64), 100, dtype=np.uint8)
    for k in range(5):
        strips[0, k, :, 10 * k : 10 * k + 3] = 180
        strips[0, k, :, 60] = 90  # at rest: part of the background
    angle = np.array([(10 * k + 1) * ring.step for k in range(5)])
    seen = _candidate(angle=angle, half_width=1.5 * ring.step, dwell=dwell).sampled
    # 1.8 half widths and 0.05 rad are 3.2 columns
    strips[0, 0, 0, 4], strips[0, 0, 0, 5] = 150, 150
    left = module._without(Rings(strips, ring), seen)
    assert left.ring is ring
    assert left.strips.dtype == np.uint8
    assert left.strips[0, 0, 0, 4] == 100
    assert left.strips[0, 0, 0, 5] == 150
    assert set(np.unique(left.strips[0, 1:, :, :60]).tolist()) == {100}
    assert left.strips[0, 2, 0, 60] == 90


def test_the_background_of_a_resting_marker_is_the_median_along_the_row():
    ring = Ring((50.0, 50.0), 20.0, 30.0, 4, 64)
    strips = np.full((2, 5, 4, 64), 100, dtype=np.uint8)
    strips[0, :, :, 20:23] = 180
    for dwell, value in ((0.29, 180), (0.31, 100)):
        seen = _candidate(angle=np.full(5, 21 * ring.step), half_width=1.5 * ring.step, dwell=dwell).sampled
        assert set(module._without(Rings(strips, ring), seen).strips[0, :, :, 20:23].ravel().tolist()) == {
            value
        }


@pytest.mark.parametrize(
    ("step", "spread", "rests"),
    [
        (0.0019, 0.0, True),
        (0.0021, 0.0, False),
        (-0.0021, 0.0, False),
        (0.0, 0.24, True),
        (0.0, 0.26, False),
    ],
)
def test_a_group_at_rest_neither_steps_nor_oscillates(step, spread, rests):
    angle = 3.0 + np.array([0.0, spread, -spread, 0.0, 0.0] * 4)
    one = _candidate(angle=[*angle, 0.0], clear=[True] * 20 + [False])
    assert _group(step, one).is_at_rest == rests


def test_the_weight_of_a_group_is_contrast_times_visibility():
    group = _group(
        0.1, _candidate(contrast=40.0, clear=[True, False]), _candidate(GREEN, 20.0, clear=[True] * 4)
    )
    assert group.weight == pytest.approx(40.0)


@pytest.mark.parametrize(("count", "share"), [(7, 0.0), (8, 1.0)])
def test_eight_observations_show_a_rotation(count, share):
    step = -7 * GRID / 20
    use = np.arange(20) >= 20 - count
    found = rotation(1.0 + step * np.arange(20), use)
    assert found.share == share
    # with few frames the trial steps are those of the last frame
    assert found.step == pytest.approx(step if share else 0.0)


@pytest.mark.parametrize(("off", "share"), [(0.34, 1.0), (0.36, 0.8)])
def test_angles_within_a_third_of_a_radian_are_in_phase(off, share):
    step = 5 * GRID / 20
    angle = 2.0 + step * np.arange(20)
    angle[[3, 16]] += off
    angle[[4, 15]] -= off
    found = rotation(angle, np.ones(20, dtype=bool))
    assert found.step == pytest.approx(step)
    assert found.share == pytest.approx(share)


def test_markers_with_equal_angular_distances_form_groups():
    frame = np.arange(30)
    slow, fast = 0.1 * frame, 0.9 * frame
    red = _candidate(RED, 20.0, slow)
    blue, green = _candidate(BLUE, 60.0, fast), _candidate(GREEN, 50.0, fast + 1.0)
    random = _candidate(171.0, 90.0, np.random.default_rng(0).uniform(0, 6.28, 30))
    groups, uneven = group_bodies([red, green, random, blue], 24)
    assert [[c.hue for c in g.members] for g in groups] == [[BLUE, GREEN], [RED]]
    assert [g.rotation.step for g in groups] == pytest.approx([0.9, 0.1], abs=0.01)
    assert uneven == [random]


def test_the_rotation_is_that_of_the_first_frames():
    frame = np.arange(30)
    angle = np.where(frame < 20, 0.5 * frame, np.random.default_rng(0).uniform(0, 6.28, 30))
    (group,), _ = group_bodies([_candidate(angle=angle)], 20)
    assert group.rotation.share == 1.0


@pytest.mark.parametrize(("off", "uneven"), [(7, False), (9, True)])
def test_a_candidate_in_phase_in_sixty_percent_of_the_frames_turns(off, uneven):
    angle = 5 * GRID / 20 * np.arange(20)
    angle[:off] += np.array([1.0, -1.0, 1.5, -1.5, 2.0, -2.0, 2.5, -2.5, 3.0])[:off]
    assert (len(group_bodies([_candidate(angle=angle)], 20)[1]) == 1) == uneven


CIRCLE = Circle(Disc((0.0, 0.0), 5.0, (10.0, 0.0)), RED)


def test_a_casing_at_rest_has_the_colour_of_the_disc():
    resting, other = _group(0.0), _group(0.0, _candidate(GREEN))
    turning = [_group(0.5, _candidate(BLUE))]
    assert resting_casing([other, resting], turning, CIRCLE) is resting
    assert resting_casing([other], turning, CIRCLE) is None
    assert resting_casing([resting], turning, None) is None
    assert resting_casing([resting], [*turning, _group(0.2, other.members[0])], CIRCLE) is None
    assert resting_casing([resting], [_group(0.5, _candidate(BLUE), _candidate(RED))], CIRCLE) is None


@pytest.mark.parametrize(("steps", "rotor"), [((0.1, -0.13), 1), ((-0.13, 0.1), 0), ((-0.1, 0.5), 1)])
def test_the_faster_body_is_the_rotor(steps, rotor):
    groups = [_group(step) for step in steps]
    bodies, notes = name_bodies(groups, None, CIRCLE)
    assert bodies["rotor"] is groups[rotor]
    assert bodies["casing"] is groups[1 - rotor]
    assert notes == []


def test_of_two_equally_fast_bodies_the_casing_has_fewer_and_clearer_markers():
    one, two = _group(0.1), _group(-0.12, _candidate(), _candidate(GREEN))
    for groups in ([one, two], [two, one]):
        bodies, notes = name_bodies(groups, None, CIRCLE)
        assert (bodies["casing"], bodies["rotor"]) == (one, two)
        assert len(notes) == 1
    hidden = _group(0.1, _candidate(clear=np.arange(20) < 15))
    for groups in ([one, hidden], [hidden, one]):
        bodies, _ = name_bodies(groups, None, CIRCLE)
        assert bodies["casing"] is one
        assert bodies["rotor"] is hidden


def test_a_single_body_is_the_casing_if_its_only_marker_has_the_colour_of_the_disc():
    for group, circle, name in (
        (_group(0.1), CIRCLE, "casing"),
        (_group(0.1), None, "rotor"),
        (_group(0.1, _candidate(GREEN)), CIRCLE, "rotor"),
        (_group(0.1, _candidate(), _candidate(GREEN)), CIRCLE, "rotor"),
    ):
        bodies, notes = name_bodies([group], None, circle)
        assert bodies == {name: group}
        assert len(notes) == 1


def test_a_resting_casing_leaves_the_moving_group_to_the_rotor():
    resting, turning = _group(0.0), _group(0.3)
    bodies, notes = name_bodies([turning], resting, CIRCLE)
    assert (bodies["casing"], bodies["rotor"]) == (resting, turning)
    assert len(notes) == 1


def test_a_third_group_is_omitted():
    groups = [_group(0.3), _group(0.1), _group(0.9, _candidate(GREEN))]
    bodies, notes = name_bodies(groups, None, CIRCLE)
    assert (bodies["casing"], bodies["rotor"]) == (groups[1], groups[0])
    assert len(notes) == 1
    assert "green" in notes[0]


def test_markers_are_named_by_colour_and_then_by_body():
    casing = _group(0.1, _candidate(110.03))
    rotor = _group(
        0.5,
        _candidate(BLUE, angle=np.full(20, 1.0)),
        _candidate(105.0, angle=np.full(20, 2.5), ambiguous=True),
        _candidate(330.0),
    )
    notes = []
    found = name_markers({"casing": casing, "rotor": rotor}, notes)
    assert [(m.profile.name, m.profile.body, m.profile.colour, m.profile.hue) for m in found] == [
        ("red", "casing", "red", 110.0),
        ("blue", "rotor", "blue", BLUE),
        ("red_rotor", "rotor", "red", 105.0),
    ]
    assert [(m.marker.name, m.marker.body, m.marker.colour) for m in found] == [
        ("red", "casing", "red"),
        ("blue", "rotor", "blue"),
        ("red_rotor", "rotor", "red"),
    ]
    assert [m.step for m in found] == [0.1, 0.5, 0.5]
    assert [m.marker.mount for m in found] == pytest.approx([0.0, 0.0, 1.5])
    assert len(notes) == 2  # a second blue patch, and two red markers that may be confused


def test_an_omitted_colour_is_ambiguous_or_uneven():
    assert "two red markers" in left_out(_candidate(ambiguous=True))
    assert "steadily" in left_out(_candidate())


def test_a_proposed_marker_is_seen_in_a_share_of_the_samples():
    one = _candidate(clear=[True, True, False, False, False])
    assert ProposedMarker(None, one.sampled.marker, one.sampled.angle, one.sampled.clear, 0.1).seen == 0.4


@pytest.mark.parametrize(
    ("length", "half_width", "accepted"),
    [
        (4.1, 0.1, True),
        (3.9, 0.1, False),
        (24.9, 0.1, True),
        (25.1, 0.1, False),
        (10.0, 0.041, True),
        (10.0, 0.039, False),
        (10.0, 0.249, True),
        (10.0, 0.251, False),
    ],
)
@pytest.mark.parametrize("faint", [False, True])
def test_a_white_marker_has_the_size_of_the_coloured_ones(length, half_width, accepted, faint, monkeypatch):
    white = Marker("w", "rotor", "white", 80.0, 80.0 + length, half_width, (20.0, 0.0), 0.2, mount=0.7)
    found = {6.0: None if faint else white, 1.8: white}
    monkeypatch.setattr(module, "find_white", lambda *given: found[round(given[-1], 6)])
    monkeypatch.setattr(module, "is_marker_sized", lambda _: True)
    group = _group(0.4, _candidate(angle=np.full(20, 1.0)))
    result = module._white(SimpleNamespace(head=4), None, {"rotor": group})
    if not accepted:
        assert result is None
    elif faint:
        assert result is white
    else:
        assert (result.marker, result.step) == (white, 0.4)
        assert result.angle == pytest.approx(np.full(20, 1.7))
        assert (result.profile.name, result.profile.body) == ("white", "rotor")
    assert module._white(SimpleNamespace(head=4), None, {"casing": group}) is None


@pytest.mark.parametrize(
    ("again", "sound"),
    [
        ((45.0, "x"), True),
        ((51.9, "x"), True),
        ((52.1, "x"), False),
        ((38.1, "x"), True),
        ((45.0, "y"), False),
    ],
)
def test_a_profile_is_sound_if_extract_finds_each_marker_at_its_radius(again, sound, monkeypatch):
    radius, name = again
    marker = Marker(name, "rotor", "red", radius - 5.0, radius + 5.0, 0.1, (9.0, 0.0), 0.2)
    monkeypatch.setattr(module, "take_samples", lambda _: None)
    monkeypatch.setattr(module, "acquire", lambda *_: SimpleNamespace(markers=(marker,)))
    one = _candidate().sampled
    profile = MarkerProfile(name="x", colour="red", body="rotor")
    notes = []
    proposed = [ProposedMarker(profile, one.marker, one.angle, one.clear, 0.1)]
    whole = Profile(marker=(profile,))
    assert module._confirmed("film", whole, proposed, notes) == sound
    assert len(notes) == (0 if sound else 1)


def test_a_profile_that_extract_refuses_is_not_sound(monkeypatch):
    def refuse(*_):
        raise TrackingError("reason")

    monkeypatch.setattr(module, "take_samples", lambda _: None)
    monkeypatch.setattr(module, "acquire", refuse)
    notes = []
    assert not module._confirmed("film", None, [], notes)
    assert len(notes) == 1


@pytest.mark.parametrize(("count", "spread"), [(5, 0), (6, 1), (105, 24)])
def test_samples_are_the_head_and_frames_spread_over_the_film(count, spread, monkeypatch):
    first = SimpleNamespace(head=5, frames=tuple(range(7)))
    monkeypatch.setattr(module, "take_samples", lambda _: first)
    monkeypatch.setattr(module, "read_packets", lambda _: SimpleNamespace(stamps=10 * np.arange(count)))
    asked = set()

    def frames_at(_, stamps, __):
        asked.update(stamps)
        return {stamp: f"frame {stamp}" for stamp in stamps}

    monkeypatch.setattr(module, "frames_at", frames_at)
    found = module._samples("film")
    assert found.head == 5
    assert len(asked) == spread
    if spread:
        assert (min(asked), max(asked)) == (50, 10 * (count - 1))
        assert found.frames == (0, 1, 2, 3, 4, *(f"frame {s}" for s in sorted(asked)))
    else:
        assert found.frames == tuple(range(7))


def test_a_candidate_with_a_rival_is_ambiguous(monkeypatch):
    """`_candidate` finds a patch in the rings, then a second one in the rings without it."""
    first, faint = _candidate(RED), _candidate(RED, 10.0)
    ring = Ring((0.0, 0.0), 10.0, 20.0, 4, 16)
    samples = SimpleNamespace(frames=[1, 2], strips=lambda *_: np.zeros((2, 2, 4, 16), dtype=np.uint8))
    centres = []

    def search_ring(_, centre, __, radius):
        centres.append((centre, radius))
        return ring

    monkeypatch.setattr(module, "search_ring", search_ring)
    monkeypatch.setattr(module, "_without", lambda rings, _: SimpleNamespace(without=True))
    for second, ambiguous in ((first, True), (faint, False), (None, False)):

        def pick(rings, hue, second=second):
            return None if hue > 150 else second if hasattr(rings, "without") else first

        monkeypatch.setattr(module, "_candidate", pick)
        found_ring, found = module.find_candidates(samples, np.deg2rad([RED, GREEN]), ORBIT, None)
        assert found_ring is ring
        assert [c.ambiguous for c in found] == [ambiguous]
    module.find_candidates(samples, [], ORBIT, Disc((90.0, 70.0), 5.0, (9.0, 0.0)))
    assert centres[0] == ((100.0, 80.0), 60.0)
    assert centres[-1] == ((90.0, 70.0), 60.0)


def test_a_candidate_is_a_patch_of_the_size_of_a_marker(monkeypatch):
    """It has the hue of its own contrast."""
    sized, asked = [True], []
    seen = _candidate(BLUE, 30.0).sampled
    found = [seen]
    monkeypatch.setattr(
        module, "find_coloured", lambda rings, wanted: asked.append((rings, wanted)) or found[0]
    )
    monkeypatch.setattr(module, "is_marker_sized", lambda marker: sized[0] and marker is seen.marker)
    one = module._candidate("rings", 325.0)
    assert one.hue == pytest.approx(BLUE)
    assert one.sampled is seen
    ((rings, wanted),) = asked
    assert (rings, wanted.hue, wanted.colour) == ("rings", 325.0, module.nearest_colour(325.0))
    sized[0] = False
    assert module._candidate("rings", 325.0) is None
    found[0] = None
    assert module._candidate("rings", 325.0) is None


class TestPropose:
    """A turning group of red, a resting group, and one patch that does not move steadily."""

    def proposed(
        self, monkeypatch, *, orbit=ORBIT, circle=CIRCLE, turning=True, white=None, hub=None, sound=True
    ):
        told = SimpleNamespace(candidates=[], groups=[], confirmed=[], white=[])
        resting, moving = _group(0.0), _group(0.4, _candidate(RED, angle=np.full(20, 1.0)))
        samples = SimpleNamespace(head=12)

        def find_candidates(given, hues, about, disc):
            told.candidates.append((given, hues, about, disc))
            return "ring", ["candidates"]

        def group(candidates, head):
            told.groups.append((candidates, head))
            return [resting, *([moving] if turning else [])], [_candidate(GREEN)]

        def casing(at_rest, others, disc):
            return resting if (at_rest, others) == ([resting], [moving]) else None

        def confirmed(*given):
            told.confirmed.append(given)
            return sound

        for name, what in (
            ("_samples", lambda video: samples),
            ("moving_colour", lambda given: SimpleNamespace(hues=(1.0, 2.0))),
            ("find_orbit", lambda given, colours, about: orbit if about == hub else None),
            ("find_circle", lambda given, about: circle),
            ("find_candidates", find_candidates),
            ("group_bodies", group),
            ("resting_casing", casing),
            ("_white", lambda *given: told.white.append(given) or white),
            ("_confirmed", confirmed),
        ):  # fmt: skip
            monkeypatch.setattr(module, name, what)
        found = module.propose("folder/film.mp4", capture_fps=240.0, hub=hub)
        return found, told, samples

    def test_the_markers_of_turning_and_resting_groups_are_named(self, monkeypatch):
        found, told, samples = self.proposed(monkeypatch)
        assert [(m.profile.body, m.step) for m in found.markers] == [("casing", 0.0), ("rotor", 0.4)]
        assert told.candidates == [(samples, (1.0, 2.0), ORBIT, CIRCLE.disc)]
        assert told.groups == [(["candidates"], 12)]
        profile = found.profile
        assert (profile.name, profile.centre, profile.capture_fps, profile.hub) == (
            "film",
            "circle",
            240.0,
            None,
        )
        assert (profile.circle_hue, profile.circle_colour) == (
            round(CIRCLE.hue, 1),
            module.nearest_colour(CIRCLE.hue),
        )
        assert profile.marker == tuple(m.profile for m in found.markers)
        assert (found.centre, found.disc, found.sound, found.samples) == (
            CIRCLE.disc.centre,
            CIRCLE.disc,
            True,
            samples,
        )
        assert any("does not move steadily" in note for note in found.notes)
        assert told.confirmed[0][1] is profile

    def test_without_a_disc_the_centre_is_that_of_the_orbits(self, monkeypatch):
        found, told, _ = self.proposed(monkeypatch, circle=None, sound=False)
        assert (found.profile.centre, found.profile.circle_hue, found.profile.circle_colour) == (
            "orbit",
            None,
            "red",
        )
        assert (found.centre, found.disc, found.sound) == (ORBIT.centre, None, False)
        assert told.candidates[0][3] is None

    def test_about_a_given_hub_no_disc_is_searched(self, monkeypatch):
        found, _, _ = self.proposed(monkeypatch, hub=(30.0, 40.0))
        assert (found.profile.hub, found.disc) == ((30.0, 40.0), None)
        with pytest.raises(TrackingError, match=r"about \(30, 40\) px"):
            self.proposed(monkeypatch, hub=(30.0, 40.0), orbit=None)

    def test_without_an_orbit_or_a_turning_group_there_is_no_profile(self, monkeypatch):
        with pytest.raises(TrackingError, match="rotates about a centre"):
            self.proposed(monkeypatch, orbit=None)
        with pytest.raises(TrackingError, match="turns steadily"):
            self.proposed(monkeypatch, turning=False)

    def test_a_white_marker_is_added_or_reported(self, monkeypatch):
        marker = Marker("w", "rotor", "white", 30.0, 50.0, 0.1, (4.2, 0.0), 0.2)
        one = _candidate().sampled
        profile = MarkerProfile(name="white", colour="white", body="rotor")
        clear = ProposedMarker(profile, marker, one.angle, one.clear, 0.4)
        found, _, _ = self.proposed(monkeypatch, white=clear)
        assert found.markers[-1] is clear
        assert found.profile.marker[-1] is profile
        found, told, samples = self.proposed(monkeypatch, white=marker)
        assert len(found.markers) == 2
        assert any("radius of 40 px" in note and "4.2 grey levels" in note for note in found.notes)
        assert told.white[0][:2] == (samples, "ring")
