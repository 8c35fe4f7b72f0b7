"""Why a film is refused: each kind is named with its evidence, on either side of its limit."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack.apps._refusal import pictured_refusal
from gyrotrack.tracking._diagnosis import (
    FOLLOW_LINKS,
    Pair,
    RefusedFilmError,
    camera_motion,
    cut_at,
    detail,
    pair_of,
    refuse_blurred,
    refuse_cut,
    refuse_two_motions,
    two_motions,
)
from gyrotrack.tracking._registration import Ring

SHAPE = (240, 320)


def _places(count, seed=0, box=(0.0, 0.0, 320.0, 240.0)):
    rng = np.random.default_rng(seed)
    x0, y0, x1, y1 = box
    return rng.uniform(x0, x1, count) + 1j * rng.uniform(y0, y1, count)


def _moved(place, turn=0.0, hub=0j, shift=0j, seed=1):
    noise = np.random.default_rng(seed).normal(0, 0.05, (2, len(place)))
    return (place - hub) * (np.exp(1j * turn) - 1.0) + shift + noise[0] + 1j * noise[1]


def _pairs(make, count=8):
    return [Pair(1, *make(k)) for k in range(count)]


def test_a_pan_is_a_moving_camera():
    def pan(k):
        z = _places(200, k)
        return z, _moved(z, shift=3.0 + 0.5j)

    step, share, off = camera_motion(_pairs(pan), SHAPE)
    assert step == pytest.approx(abs(3.0 + 0.5j), rel=0.02)
    assert share > 0.98
    assert off > 0.8


@pytest.mark.parametrize("hub", [160 + 120j, 90 + 60j, -200 + 120j])
def test_a_body_that_fills_the_picture_turns_about_a_hub(hub):
    def turning(k):
        z = _places(200, k)
        return z, _moved(z, 0.03 * (1 + 0.1 * k), hub)

    assert camera_motion(_pairs(turning), SHAPE) is None


@pytest.mark.parametrize(("moving", "seen"), [(0.8, True), (0.6, False)])
def test_the_camera_moves_most_features(moving, seen):
    """70 % of the features must move together: fewer may be a large body before a background at rest."""

    def some(k):
        z = _places(300, k)
        d = _moved(z, shift=3.0)
        d[int(moving * 300) :] = 0.0
        return z, d

    assert (camera_motion(_pairs(some), SHAPE) is not None) == seen


@pytest.mark.parametrize(("still", "seen"), [(2, True), (4, False)])
def test_pairs_with_a_background_at_rest_speak_against_a_moving_camera(still, seen):
    """Three quarters of the pairs that show motion or rest must show motion; parallax shows neither."""

    def some(k):
        z = _places(200, k)
        if k < still:
            return z, _moved(z)
        if k < still + 2:  # several depths move differently
            return z, _moved(z, shift=3.0) * (0.5 + np.arange(200) / 100)
        return z, _moved(z, shift=2.0)

    assert (camera_motion(_pairs(some, 12), SHAPE) is not None) == seen


@pytest.mark.parametrize(("speed", "lag"), [(0.02, 1), (0.3, 4), (1.5, 1)])
def test_a_slow_camera_is_measured_over_several_frames(speed, lag):
    """Some features move from frame to frame; most of the picture must move by a pixel, if it moves at all."""
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (140, 180)).astype(np.float32), (0, 0), 2.0)
    picture = cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX)

    def frame(k):
        move = np.array([[1.0, 0.0, -5.0 - speed * k], [0.0, 1.0, -5.0]])
        seen = cv2.warpAffine(picture, move, (160, 120))
        body = np.array([[1.0, 0.0, 1.5 * k], [0.0, 1.0, 0.0]])
        seen[70:, :60] = cv2.warpAffine(picture, body, (160, 120))[70:, :60]
        return seen.astype(np.uint8)

    assert pair_of(frame(0), *(frame(n) for n in (1, 2, 4, 8))).lag == lag


def test_a_large_ball_before_a_blank_wall_is_not_the_background():
    def ball(k):
        z = _places(200, k, (100.0, 60.0, 220.0, 180.0))  # 19 % of the picture
        return z, _moved(z, shift=3.0)

    assert camera_motion(_pairs(ball), SHAPE) is None


def _two(hub, other, turn, second, joint=None):
    """Two bodies about two hubs; with a `joint`, the second hub is on the first body and turns with it to places."""

    def pair(k):
        a, b = _places(80, k, (40.0, 60.0, 140.0, 180.0)), _places(60, k + 50, (180.0, 60.0, 280.0, 180.0))
        place, shift = other, 0.0
        if joint is not None:
            place = joint(k)
            shift = (place - hub) * (np.exp(1j * turn) - 1.0)
        moved = _moved(b, second, place) + shift
        return np.concatenate([a, b]), np.concatenate([_moved(a, turn, hub), moved])

    return _pairs(pair)


def _on_body(k):
    return 90 + 120j + 60.0 * np.exp(0.5j * k)


def _anywhere(k):
    return 90 + 120j + (20.0 + 12.0 * k) * np.exp(0.5j * k)


def test_two_bodies_that_turn_differently_are_reported_with_both_hubs():
    two = two_motions(_two(90 + 120j, 230 + 120j, 0.06, -0.1))
    assert two.hubs[0] == pytest.approx(90 + 120j, abs=1.0)
    assert two.hubs[1] == pytest.approx(230 + 120j, abs=1.0)
    assert two.ratio == pytest.approx(-0.1 / 0.06, rel=0.03)
    assert two.shares == pytest.approx((80 / 140, 60 / 140), abs=0.03)
    assert not two.linked
    assert not two.coaxial


@pytest.mark.parametrize(("joint", "linked"), [(_on_body, True), (_anywhere, False)])
def test_a_second_body_about_a_joint_on_the_first_one_is_a_link(joint, linked):
    """The joint keeps its distance from the hub; a point that moves otherwise is no evidence of a link."""
    pairs = _two(90 + 120j, 0j, 0.06, -0.1, joint)
    two = two_motions(pairs)
    assert two.moving == 1
    assert two.linked == linked
    if not linked:
        refuse_two_motions("film.mp4", pairs, ())


def test_rotor_and_casing_of_a_gyroscope_are_coaxial():
    two = two_motions(_two(160 + 120j, 162 + 120j, 0.03, 0.09))
    assert two.coaxial


@pytest.mark.parametrize(("second", "told"), [(0.1 * 0.75, False), (0.1 * 0.6, True)])
def test_two_bodies_turn_by_different_angles(second, told):
    """Rotations that differ by less than 30 % are those of one body."""
    found = two_motions(_two(90 + 120j, 400 + 120j, 0.1, second))
    assert (found is not None) == told


def _film(frames, changes):
    class Few:
        path = SimpleNamespace(name="film.mp4")
        stamps = np.arange(len(frames)) / 10
        selected = np.ones(len(frames), dtype=bool)

        def __len__(self):
            return len(frames)

        def some(self, index):
            return [frames[int(i)] for i in index]

    film = Few()
    film.changes = np.array(changes)
    return film


@pytest.mark.parametrize(("other", "cut"), [(3.0, True), (5.0, False)])
def test_a_cut_changes_the_picture_more_than_any_motion_near_it(other, cut):
    """The change is 10 grey levels: 2.5 times the largest other one within 12 frames, at least."""
    frames = [np.full((8, 8), 50 if k < 30 else 60, np.uint8) for k in range(60)]
    changes = [255.0, *np.full(59, 1.0)]
    changes[30], changes[25] = 10.0, other
    film = _film(frames, changes)
    found = cut_at(film, np.arange(60))
    assert (found is not None) == cut
    if cut:
        assert found == (30, 10.0, other)
        with pytest.raises(RefusedFilmError, match=r"cut at frame 30 \(3 s\)") as error:
            refuse_cut(film, np.arange(60))
        assert error.value.kind == "cut"
        assert error.value.hint.endswith("--from 3.000.")


def test_a_flash_and_a_still_at_the_beginning_are_not_cuts():
    frames = [np.full((8, 8), 90 if k == 30 else 50, np.uint8) for k in range(60)]
    changes = [255.0, *np.full(59, 1.0)]
    changes[30] = changes[31] = 40.0
    assert cut_at(_film(frames, changes), np.arange(60)) is None
    still = [np.full((8, 8), 90 if k < 1 else 50, np.uint8) for k in range(60)]
    changes = [255.0, 40.0, *np.full(58, 1.0)]
    assert cut_at(_film(still, changes), np.arange(60)) is None


def _turned(count, along, noise=1.0):
    """A ring of spokes; `along` is the contrast that the exposure leaves."""
    y, x = np.mgrid[0:200, 0:200].astype(float)
    radius, angle = np.hypot(x - 100, y - 100), np.arctan2(y - 100, x - 100)
    rng = np.random.default_rng(2)
    for k in range(count):
        picture = 120 + 30 * np.sin(0.4 * radius) + along * np.sin(8 * (angle + 0.05 * k))
        yield np.clip(picture + rng.normal(0, noise, picture.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("along", "blurred"), [(20.0, False), (2.0, True)])
def test_a_body_that_is_smeared_along_its_circles_is_blurred(along, blurred):
    ring = Ring.about((100.0, 100.0), 20.0, 90.0)
    frames = list(_turned(8, along))
    film = SimpleNamespace(path=SimpleNamespace(name="fan.mp4"))
    change, share = detail(ring, frames, 1.0)
    # gradients 8 a / r along, 0.4 * 30 across, rms over the ring
    mean_inverse = np.mean(1 / np.linspace(20, 90, 70) ** 2)
    assert share == pytest.approx(8 * along * np.sqrt(mean_inverse) / 12.0, abs=0.035)
    if not blurred:
        refuse_blurred(film, frames, ring, 1.0)
        return
    with pytest.raises(RefusedFilmError, match="too blurred to be tracked") as error:
        refuse_blurred(film, frames, ring, 1.0)
    assert error.value.evidence["detail"] == pytest.approx(share)
    assert error.value.evidence["change_sigma"] == pytest.approx(change)


def test_a_refusal_writes_a_picture_and_names_it(tmp_path):
    frames = [np.full((60, 80), 90, np.uint8)] * 2
    path = tmp_path / "film.refused.png"
    for _ in range(2):  # an earlier picture is replaced
        error = RefusedFilmError(
            "It moves.", "Stop.", kind="two bodies", evidence={}, frames=frames, hub=(40.0, 30.0)
        )
        with pytest.raises(RefusedFilmError), pictured_refusal(tmp_path / "film.h5"):
            raise error
        assert path.exists()
        assert error.hint == f"Stop. The picture is {path}."
        assert str(error) == f"It moves. Stop. The picture is {path}."
    plain = RefusedFilmError("It moves.", "Stop.", kind="two bodies", evidence={})
    with pytest.raises(RefusedFilmError), pictured_refusal(tmp_path / "other.h5"):
        raise plain
    assert plain.hint == "Stop."
    assert not (tmp_path / "other.refused.png").exists()


def test_the_hint_names_the_command():
    frames = [np.zeros((8, 8), np.uint8)] * 4
    pairs = _two(90 + 120j, 230 + 120j, 0.06, -0.1)
    with pytest.raises(RefusedFilmError, match="--hub 90,120 or --hub 230,120") as error:
        refuse_two_motions("film.mp4", pairs, frames)
    assert error.value.kind == "two bodies"
    linked = _two(90 + 120j, 0j, 0.06, -0.1, _on_body)
    with pytest.raises(RefusedFilmError, match="--links") as error:
        refuse_two_motions("film.mp4", linked, frames)
    assert error.value.kind == "two links"
    refuse_two_motions("film.mp4", _two(160 + 120j, 162 + 120j, 0.03, 0.09), frames)
    assert FOLLOW_LINKS in error.value.hint
