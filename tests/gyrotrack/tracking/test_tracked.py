"""The white part of a series of angles, evenly and unevenly sampled; doubts about a track; a recording."""

from dataclasses import make_dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import BodyTrack, TrackingError, UsageError, VideoError
from gyrotrack.io._schema import STATUS
from gyrotrack.tracking import _extract as module
from gyrotrack.tracking._extract import track_doubts
from gyrotrack.tracking._tracked import white_noise


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_noise_of_a_smooth_motion_with_missing_frames(share):
    rng = np.random.default_rng(3)
    frame = np.flatnonzero(rng.random(6000) < share)
    angle = 3.0 * np.sin(frame / 40.0) + 0.2 * frame + rng.normal(0, 2e-3, frame.size)
    assert white_noise(angle, frame) == pytest.approx(2e-3, rel=0.1)


def test_missing_frames_are_not_noise():
    frame = np.flatnonzero(np.random.default_rng(4).random(3000) < 0.5)
    angle = 0.3 * frame
    assert white_noise(angle, frame) < 1e-9
    assert white_noise(angle) > 0.01


def track_of(time, angle):
    """A track of one body with the angles of some frames."""
    nothing = np.zeros(len(time))
    return BodyTrack(
        "casing", time, angle, nothing, nothing, np.ones(len(time), np.int64), nothing, nothing, 3
    )


def test_a_track_with_lost_frames_or_a_gap_that_may_hide_a_turn_is_doubted():
    time = np.arange(300) / 60
    angle = 3.0 * time
    assert track_doubts("body", track_of(time, angle), 300, "it") == []
    few = np.flatnonzero((np.arange(300) < 100) | (np.arange(300) > 180))
    (lost,) = track_doubts("body", track_of(time[few], angle[few]), 300, "it")
    assert "219 of 300 frames (73%)" in lost
    # 8 rad/s before and -8 rad/s after a gap of 0.5 s: up to 4 rad in either sense
    late = time > 0.25
    turns = 8.0 * np.where(time < 2.0, time, 4.0 - time)
    seen = late & ((time < 1.75) | (time > 2.25))
    doubts = track_doubts("body", track_of(time[seen], turns[seen]), int(late.sum()), "it")
    assert len(doubts) == 1
    assert "not determined in 1 gap(s), the first of 0.533 s" in doubts[0]


@pytest.mark.parametrize(("share", "hidden"), [(0.9, False), (1.1, True)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_turn_may_be_hidden_where_the_angles_differ_by_half_a_turn(share, hidden, sign):
    """Before and after a gap of 0.5 s the speeds differ by this angle over the gap."""
    before = np.arange(60) / 60
    time = np.concatenate([before, before[-1] + 0.5 + before])
    angle = np.concatenate([8.0 * before, 9.0 + (8.0 - sign * share * np.pi / 0.5) * before])
    assert bool(track_doubts("body", track_of(time, angle), 120, "it")) == hidden


@pytest.mark.parametrize(
    ("first", "later", "frames", "omitted"),
    [
        (("lost", "lost"), 1, 10, True),
        (("lost", "lost"), 5, 10, True),
        (("lost", "lost"), 6, 10, False),
        (("lost", "ok"), 1, 10, False),
        (("lost", "lost"), 1, 9, False),
    ],
)
def test_a_still_picture_before_a_film_is_omitted(first, later, frames, omitted):
    """No marker is at its place in the first frame, and each is in one of the next five."""
    markers = {}
    for name in first:
        status = np.full(frames, STATUS["lost"])
        status[0], status[later] = STATUS[name], STATUS["ok"]
        markers[len(markers)] = SimpleNamespace(status=status)
    assert bool(module._first_frame_warning(markers)) == omitted


@pytest.mark.parametrize(("share", "rests"), [(0.9, True), (1.1, False)])
def test_a_film_without_rotation_is_reported(share, rests):
    turn = share * module.LEAST_TURN
    bodies = {"casing": [1.0, np.nan, 1.0 - turn], "rotor": [0.5, 0.5 + 0.2 * turn, 0.5]}
    joint = SimpleNamespace(bodies={k: SimpleNamespace(angle=np.array(v)) for k, v in bodies.items()})
    found = module._rest_warning(joint, Path("film.mp4"), marked=True)
    assert len(found) == rests
    if rests:
        assert f"the casing by {turn:.2f} rad and the rotor by {0.2 * turn:.2f} rad in total" in found[0]
        (other,) = module._rest_warning(joint, Path("film.mp4"), marked=False)
        assert other == found[0] + " No disc marks the centre of rotation."


def test_the_uncertainty_of_a_moving_camera_is_that_of_its_roll_and_shift():
    """A shift turns a marker by its ratio to the radius: 50 px of the rotor, 80 px of the casing."""
    body = make_dataclass("Body", ["markers", "sigma"])
    angles = make_dataclass("Angles", ["sigma"])
    joint = make_dataclass("Joint", ["centre", "bodies", "warnings"])(
        make_dataclass("Centre", ["centre", "sigma"])(np.zeros(2), np.array([0.4])),
        {n: body({"m": angles(np.array([2e-3]))}, np.array([1e-3])) for n in ("casing", "rotor")},
        ("joint",),
    )
    scene = SimpleNamespace(
        of=lambda n: [SimpleNamespace(radius=r) for r in {"casing": (80,), "rotor": (40, 60)}[n]]
    )
    shake = SimpleNamespace(
        seen=lambda centre: centre + 3.0, shift_sigma=0.3, roll_sigma=4e-3, roll=np.array([2e-3, -2e-3]), rms=1.5,
        features=70,
    )  # fmt: skip
    found = module._as_seen(joint, scene, shake)
    assert found.centre.centre.tolist() == [3.0, 3.0]
    assert found.centre.sigma == pytest.approx([0.5])
    for name, radius in (("casing", 80.0), ("rotor", 50.0)):
        own = np.hypot(4e-3, 0.3 / radius)
        assert found.bodies[name].sigma == pytest.approx([np.hypot(1e-3, own)])
        assert found.bodies[name].markers["m"].sigma == pytest.approx([np.hypot(2e-3, own)])
    text, last = found.warnings
    assert last == "joint"
    assert "moves by 1.5 px rms and rolls by 2 mrad rms; 70 features" in text
    assert f"uncertainty of {1e3 * np.hypot(4e-3, 6e-3):.2g} mrad is included" in text


class TestRecording:
    """A film of one or two bodies: what the recording takes from it, and the order of its warnings."""

    @pytest.fixture(autouse=True)
    def _parts(self, monkeypatch):
        for name in (
            "_rest_warning", "_doubts", "_unseen", "_first_frame_warning", "speed_warnings",
        ):  # fmt: skip
            monkeypatch.setattr(module, name, lambda *_, _name=name, **__: (_name.strip("_"),))
        monkeypatch.setattr(module, "_without_corners", lambda *_: ())
        monkeypatch.setattr(module, "marker_track", lambda *given: given)
        monkeypatch.setattr(module, "body_track", lambda *given: given)
        monkeypatch.setattr(module, "_extra", lambda *_: {"tilt": {}})
        monkeypatch.setattr(module, "Recording", lambda **fields: SimpleNamespace(**fields))

    @staticmethod
    def recording(*bodies, stamped=False):
        marker = {"casing": SimpleNamespace(name="red"), "rotor": SimpleNamespace(name="blue")}
        times = SimpleNamespace(
            place=np.arange(5) if stamped else None,
            seconds=lambda fps: np.arange(5) / fps,
            number=np.arange(5) + 2,
            warnings=("times",),
        )
        seen = SimpleNamespace(
            times=times, warnings=("seen",), size=(320, 240), pts_time=np.arange(5.0),
            bodies={b: SimpleNamespace(markers={marker[b].name: f"{b} seen"}) for b in bodies},
        )  # fmt: skip
        joint = SimpleNamespace(
            bodies=dict.fromkeys(bodies, "angles"), doubts=("joint doubt",), warnings=("joint",), sense=-1,
            centre=SimpleNamespace(centre="centre", sigma="its sigma"),
        )  # fmt: skip
        scene = SimpleNamespace(of=lambda name: [marker[name]], disc=None, warnings=("scene",))
        info = SimpleNamespace(path=Path("film.mp4"), container_fps=30.0, frames_declared=6)
        rate = SimpleNamespace(fps=250.0, warnings=("rate",), source="tag")
        return module._recording(info, "sum", rate, scene, seen, joint)

    @pytest.mark.parametrize("stamped", [False, True])
    def test_the_capture_rate_is_doubted_only_if_it_is_used(self, stamped):
        found = self.recording("casing", stamped=stamped)
        used = () if stamped else ("rate",)
        doubts = ("joint doubt", "doubts")
        others = ("seen", "times", "scene", "unseen", "joint", "first_frame_warning")
        assert found.warnings == ("rest_warning", *used, *others, *doubts)
        assert found.extra == {"tilt": {}, "doubts": list(doubts)}

    def test_speeds_are_compared_and_bodies_named(self):
        both = self.recording("casing", "rotor")
        assert both.warnings[-3:] == ("speed_warnings", "joint doubt", "doubts")
        assert [self.recording(*b).body for b in (("casing",), ("rotor",), ("casing", "rotor"))] == [
            "casing",
            "rotor",
            "both",
        ]
        assert list(both.bodies) == ["casing", "rotor"]
        assert {name: given[1] for name, given in both.markers.items()} == {
            "red": "casing seen",
            "blue": "rotor seen",
        }

    def test_sizes_and_times_are_those_of_the_film(self):
        found = self.recording("casing")
        assert (found.width, found.height) == (320, 240)
        assert (found.frames_declared, found.frames_decoded) == (6, 5)
        assert (found.capture_fps, found.container_fps, found.sense) == (250.0, 30.0, -1)
        assert found.time.tolist() == pytest.approx([0.0, 0.004, 0.008, 0.012, 0.016])
        assert found.frame_index.tolist() == [2, 3, 4, 5, 6]
        assert (found.centre, found.centre_sigma) == ("centre", "its sigma")


class TestExtraction:
    """The order in which the parts of an extraction are called, and with what; nothing is tracked."""

    @staticmethod
    def extract(monkeypatch, frames=8, *, shaken=False, disc=None, fast=False, times=(), **options):
        asked = {}

        def told(name, answer):
            def part(*given, **_):
                asked.setdefault(name, []).append(given)
                return answer(*given) if callable(answer) else answer

            monkeypatch.setattr(module, name, part)

        seen_type = make_dataclass("Seen", ["pts_time", "disc", "still"])
        joint_type = make_dataclass("Joint", ["warnings"])
        seen = seen_type(np.arange(frames), disc, False)
        shake = SimpleNamespace() if shaken else None
        told("probe", "info")
        told("capture_rate", SimpleNamespace(fps=100.0))
        told("_only_casing", SimpleNamespace(name="casing only"))
        told("_observe", ("scene", seen, shake))
        told("_stabilised", lambda seen, _: replace(seen, still=True))
        told("judge_repeats", "repeats")
        told("trusted_times", "times")
        told("without_repeats", ("kept", SimpleNamespace(fps=50.0)))
        told("left_out", lambda seen, when: replace(seen, pts_time=seen.pts_time[1:]))
        told("moves_fast", fast)
        told("join_bodies", joint_type(("joint",)))
        told("_as_seen", lambda joint, *_: replace(joint, warnings=("shaken", *joint.warnings)))
        told("_check_bodies", None)
        told("file_sha256", "sum")
        told("_recording", lambda *given: given)
        profile = SimpleNamespace(capture_fps=None, name="whole")
        return module.extract(Path("film.mp4"), profile, **options), asked

    @pytest.mark.parametrize("shaken", [True, False])
    def test_repeats_times_and_bodies_of_a_shaken_film_are_those_of_a_camera_at_rest(
        self, monkeypatch, shaken
    ):
        (*_, rate, scene, seen, joint), asked = self.extract(monkeypatch, shaken=shaken)
        for name, frames in (("judge_repeats", 8), ("trusted_times", 8), ("join_bodies", 7)):
            ((judged, *_),) = asked[name]
            assert (judged.still, len(judged.pts_time)) == (shaken, frames)
        ((_, when),) = asked["left_out"]
        assert (when, asked["without_repeats"][0][:2]) == ("kept", ("times", "repeats"))
        assert (rate.fps, scene, seen.still, len(seen.pts_time)) == (50.0, "scene", False, 7)
        ((_, *others, fps),) = asked["join_bodies"]
        assert (others[0], others[1].name, fps) == ("scene", "whole", 50.0)
        assert joint.warnings == (("shaken", "joint") if shaken else ("joint",))

    @pytest.mark.parametrize(
        ("shaken", "disc", "fast", "doubted"),
        [
            (False, "disc", True, True),
            (False, "disc", False, False),
            (False, None, True, False),
            (True, "disc", True, False),
        ],
    )
    def test_a_roll_of_a_shaking_camera_without_a_background_is_unknown(
        self, monkeypatch, shaken, disc, fast, doubted
    ):
        (*_, joint), _ = self.extract(monkeypatch, shaken=shaken, disc=disc, fast=fast)
        assert (module._UNKNOWN_ROLL in joint.warnings) == doubted

    @pytest.mark.parametrize("enough", [True, False])
    def test_a_film_needs_as_many_frames_as_its_samples(self, monkeypatch, enough):
        frames = module.FEWEST - (not enough)
        if enough:
            self.extract(monkeypatch, frames)
        else:
            with pytest.raises(VideoError, match=f"Only {frames} frames of film.mp4"):
                self.extract(monkeypatch, frames)

    @pytest.mark.parametrize(
        ("body", "profile"), [("casing", "casing only"), ("both", "whole"), (None, "whole")]
    )
    def test_only_the_casing_is_tracked_if_it_alone_is_wanted(self, monkeypatch, body, profile):
        _, asked = self.extract(monkeypatch, body=body)
        assert asked["_observe"][0][1].name == profile
        assert asked["join_bodies"][0][2].name == profile
        assert asked["_check_bodies"][0][1] == body

    def test_an_unknown_body_is_refused(self, monkeypatch):
        with pytest.raises(UsageError, match="Unknown body 'wheel'"):
            self.extract(monkeypatch, body="wheel")


@pytest.mark.parametrize(
    ("wanted", "seen", "refused"),
    [
        (None, "casing", ""), ("casing", "casing", ""), ("rotor", "casing", "The rotor is not visible"),
        ("both", "casing", "The rotor is not visible"), ("both", "rotor", "The casing is not visible"),
        (None, "", "No body can be tracked"),
    ],
)  # fmt: skip
def test_a_body_that_is_wanted_must_be_tracked(wanted, seen, refused):
    joint = SimpleNamespace(bodies={seen: None} if seen else {})
    if not refused:
        module._check_bodies(joint, wanted, Path("film.mp4"))
        return
    with pytest.raises(TrackingError, match=f"{refused} in film.mp4"):
        module._check_bodies(joint, wanted, Path("film.mp4"))


def test_the_uncertainty_of_the_paper_is_that_of_the_mean_of_its_markers():
    found = module._paper_sigma([np.array([3.0, np.nan, np.nan]), np.array([4.0, 2.0, np.nan])])
    assert found == pytest.approx([2.5, 2.0, np.nan], nan_ok=True)


@pytest.mark.parametrize(("body", "needed"), [("rotor", False), ("casing", True)])
def test_a_body_without_a_marker_in_the_film_is_reported(body, needed):
    other = {"rotor": "casing", "casing": "rotor"}[body]
    scene = SimpleNamespace(
        markers=[SimpleNamespace(body=other)], body_of={"red": other, "blue": body, "green": body}
    )
    (told,) = module._unseen(scene)
    assert told.startswith(f"The {body} is not tracked: no blue and no green marker is found.")
    assert ("Synchronisation needs the casing" in told) == needed


def test_markers_that_are_missing_on_a_tracked_body_are_doubts(monkeypatch):
    monkeypatch.setattr(module, "track_doubts", lambda name, track, count, _: [f"{name} {track} {count}"])
    scene = SimpleNamespace(
        doubts=("first",),
        missing=("red", "blue", "cyan"),
        body_of={"red": "casing", "cyan": "casing", "blue": "rotor"},
    )
    first, of_track, absent = module._doubts(scene, {"casing": "track"}, np.zeros(7))
    assert (first, of_track) == ("first", "casing track 7")
    assert absent.startswith("No red and no cyan marker is found on the casing.")


@pytest.mark.parametrize(("corners", "doubted"), [(4, True), (5, False)])
def test_coloured_patches_without_corners_are_doubted(corners, doubted):
    never = SimpleNamespace(rho=np.full(100, np.nan))
    some = SimpleNamespace(rho=np.where(np.arange(100) < corners, 80.0, np.nan))
    assert bool(module._without_corners({"red": never, "blue": some})) == doubted
    assert module._without_corners({"red": never})
    assert module._without_corners({}) == ()


@pytest.mark.parametrize(
    ("workers", "parts", "told"),
    [
        (2, 2, ""), (3, 2, "2 parts at key frames and tracked by 2 of 3 processes"), (None, 1, ""),
        (4, 1, "one part and tracked by 1 of 4 processes"),
        (None, 5, "5 parts at key frames and tracked by 5 of 6 processes"), (None, 6, ""),
    ],
)  # fmt: skip
def test_a_film_of_fewer_parts_than_processes_is_reported(monkeypatch, workers, parts, told):
    """Of six cores."""
    monkeypatch.setattr(module, "read_packets", lambda _: "packets")
    monkeypatch.setattr(module, "split", lambda _: range(parts))
    monkeypatch.setattr(module, "available_cores", lambda: 6)
    job = module.ExtractionJob(Path("film.mp4"), Path("a.h5"), None, workers=workers)
    found = job._limit_of_processes()
    assert found == (f"The film is divided into {told}." if told else "")


@pytest.mark.parametrize("again", [None, np.array([False, True, True])])
def test_a_recording_states_its_repeated_frames_and_where_its_centre_is_from(again):
    times = SimpleNamespace(place=again, again=again)
    scene = SimpleNamespace(disc=again is not None and "disc", missing=("red",), markers=())
    joint = SimpleNamespace(centre=SimpleNamespace(reach=7), flattening={})
    found = module._extra(scene, joint, "tag", times)
    stated = [found[k] for k in ("times_from", "repeated_frames", "capture_rate_from", "centre_from")]
    assert stated == (["frames", 0, "tag", "orbit"] if again is None else ["stamps", 2, "tag", "disc"])
    assert (found["centre_smoothing_reach"], found["missing_markers"]) == (7, ["red"])
