"""Pictures of tracking: clocks of clips, selected frames, and sentences with known sizes."""

import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack.plotting import _tracking as module
from gyrotrack.plotting._tracking import (
    Centre,
    Sigma,
    Span,
    centre_finding,
    contact_sheets,
    jpeg,
    on_clock,
    sigma_finding,
    sync_finding,
    sync_picture,
    tracks_of,
)

PLACED = SimpleNamespace(
    clock_offset=10.0, clock_rate=1.001, clock_offset_sigma=2e-3, ambiguous=False, method="casing"
)


def recording(source="a", count=100, rate=10.0, bodies=("casing",), markers=()):
    time = np.arange(count) / rate
    place = np.column_stack([np.full(count, 320.0), np.full(count, 240.0)])
    if count:
        place[0] = np.nan
        place[1:3] += [[3.0, 4.0], [-3.0, -4.0]]
    return SimpleNamespace(
        source=source, time=time, centre=place, markers={m.name: m for m in markers},
        bodies={
            b: SimpleNamespace(time=time[::2], sigma=np.full(len(time[::2]), 1e-3 * (i + 1)))
            for i, b in enumerate(bodies)
        },
    )  # fmt: skip


def span(clip="a", start=0.0, stop=10.0, sigma=1e-3, *, ambiguous=False, method="casing"):
    return Span(clip, start, stop, sigma, ambiguous, method)


class TestTracks:
    def case(self, *recordings, placed=None):
        keys = [f"k{i}" for i in range(len(recordings))]
        placements = dict.fromkeys(keys, PLACED) if placed is None else placed
        return SimpleNamespace(recordings=dict(zip(keys, recordings, strict=True)), placements=placements)

    def test_times_of_clips_are_on_the_clock_of_the_case(self):
        assert on_clock(PLACED, np.array([0.0, 100.0])) == pytest.approx([10.0, 110.1])
        found = tracks_of(self.case(recording(bodies=("casing", "rotor"))))
        assert [(s.clip, s.body, s.median) for s in found.sigmas] == [
            ("a", "casing", 1e-3),
            ("a", "rotor", 2e-3),
        ]
        assert found.sigmas[0].time[1] == pytest.approx(10.0 + 0.2 * 1.001)
        (centre,) = found.centres
        assert centre.time[-1] == pytest.approx(10.0 + 9.9 * 1.001)
        assert centre.rms == pytest.approx(math.sqrt(2 * 25.0 / 99))
        (placed,) = found.spans
        assert (placed.start, placed.stop) == pytest.approx((10.0, 10.0 + 9.9 * 1.001))
        assert (placed.sigma, placed.ambiguous, placed.method) == (2e-3, False, "casing")

    def test_clips_without_a_place_or_frames_are_omitted(self):
        assert tracks_of(self.case(recording(), placed={})) is None
        assert tracks_of(self.case(recording(count=0))) is None
        assert [s.clip for s in tracks_of(self.case(recording(count=0), recording("b"))).spans] == ["b"]

    def test_unknown_values_have_no_median(self):
        assert math.isnan(Sigma("a", "casing", np.zeros(2), np.full(2, np.nan)).median)
        assert Sigma("a", "casing", np.zeros(3), np.array([np.nan, 1.0, 3.0])).median == 2.0
        assert math.isnan(Centre("a", np.zeros(2), np.full((2, 2), np.nan)).rms)
        assert Centre("a", np.zeros(2), np.array([[3.0, 4.0], [np.nan, 9.0]])).rms == 5.0

    def test_a_clip_without_a_known_centre_is_at_zero(self):
        clip = recording()
        clip.centre[:] = np.nan
        assert np.isnan(tracks_of(self.case(clip)).centres[0].place).all()


class TestFindings:
    def sigma(self, body, value):
        return Sigma("a", body, np.zeros(2), np.full(2, value))

    @pytest.mark.parametrize(
        ("given", "words"),
        [
            ([("rotor", 2e-3), ("casing", 1e-3)], "casing 1.0 mrad, rotor 2.0 mrad."),
            ([("rotor", 2e-3), ("rotor", 5e-3), ("rotor", 3e-3)], "rotor 2.0 to 5.0 mrad."),
            ([("rotor", 2.001e-3), ("rotor", 2.002e-3)], "rotor 2.0 mrad."),
            ([("rotor", math.nan), ("casing", 1e-3)], "casing 1.0 mrad."),
            ([("rotor", math.nan)], "The standard uncertainty of the angles is unknown."),
            ([], "The standard uncertainty of the angles is unknown."),
        ],
    )
    def test_uncertainties_of_each_body(self, given, words):
        assert sigma_finding(tuple(self.sigma(*g) for g in given)).endswith(words)

    def test_the_clip_whose_centre_moves_most(self):
        centres = [
            Centre(n, np.zeros(1), np.array([[x, 0.0]])) for n, x in (("a", 1.0), ("b", -3.0), ("c", np.nan))
        ]
        assert centre_finding(tuple(centres)) == "Motion of the centre: 3.0 px rms at most (b)."

    @pytest.mark.parametrize(
        ("spans", "words"),
        [
            ([span(sigma=0.0)], "1 clips on one clock; no start is ambiguous."),
            (
                [span(sigma=0.0), span(sigma=1e-3), span(sigma=5e-3)],
                "3 clips on one clock, standard uncertainty of a start at most 5.0 ms; no start is ambiguous.",
            ),
            (
                [span(), span("b", ambiguous=True), span("c", ambiguous=True)],
                "3 clips on one clock, standard uncertainty of a start at most 1.0 ms; ambiguous: b, c.",
            ),
        ],
    )
    def test_uncertainties_of_the_starts(self, spans, words):
        assert sync_finding(tuple(spans)) == words

    def test_intervals_are_drawn_with_their_uncertainties(self, monkeypatch):
        drawn, noted = [], []
        monkeypatch.setattr(module, "markup", lambda figure, *_: drawn.append(figure.axes[0]) or "")
        monkeypatch.setattr(module, "beside", lambda ax, text, place, *_, **__: noted.append((text, place)))
        spans = (span(sigma=0.0), span("b", 2.0, 4.0, ambiguous=True, method="marks"))
        picture = sync_picture(SimpleNamespace(spans=spans), "sync")
        (ax,) = drawn
        assert [(p.get_x(), p.get_width()) for p in ax.patches] == [(0.0, 10.0), (2.0, 2.0)]
        assert [p.get_hatch() for p in ax.patches] == ["", "////"]
        assert ax.get_xlim() == pytest.approx((-0.2, 13.4))
        assert noted == [("reference clock", (10.0, 0)), ("start ± 1.0 ms  AMBIGUOUS", (4.0, 1))]
        assert picture.caption.endswith("hatched: ambiguous start. Method: marks.")
        assert picture.finding == sync_finding(spans)

    def test_at_most_twelve_clips_are_drawn(self, monkeypatch):
        drawn = []
        monkeypatch.setattr(module, "markup", lambda figure, *_: drawn.append(figure.axes[0]) or "")
        sync_picture(SimpleNamespace(spans=tuple(span(str(i)) for i in range(13))), "sync")
        assert len(drawn[0].patches) == 12


class TestFrames:
    @pytest.mark.parametrize(
        ("count", "intervals", "frames"),
        [
            (101, [], [0, 20, 40, 60, 80, 100]),
            (3, [], [0, 1, 2]),
            (0, [], []),
            # at 10 frames per second, begun at 10 s on a clock that is fast by a thousandth
            (101, [(13.1, 13.3)], [0, 20, 32, 60, 80, 100]),
            (101, [(10.0, 10.0)], [0, 40, 60, 80, 100]),  # in place of frame 20
            (101, [(9.0, 9.9), (20.02, 30.0)], [0, 20, 40, 60, 80, 100]),  # outside of the clip
            (101, [(x, x) for x in (12.1, 14.1, 16.1, 18.1)], [0, 21, 41, 61, 80, 100]),  # three of four
        ],
    )
    def test_frames_are_spread_and_moved_to_intervals(self, count, intervals, frames):
        assert module._selected_frames(recording(count=count), PLACED, intervals) == frames

    def test_without_a_clock_intervals_are_unknown(self):
        assert module._selected_frames(recording(count=101), None, [(3.1, 3.3)]) == [0, 20, 40, 60, 80, 100]

    def test_a_frame_has_its_time_and_the_state_of_its_markers(self):
        from gyrotrack.io._schema import STATUS

        (word, code), (other, second) = list(STATUS.items())[:2]
        markers = [
            SimpleNamespace(name="M1", status=np.full(100, code)),
            SimpleNamespace(name="M2", status=np.r_[np.full(7, second), np.full(93, 250)]),
        ]
        r = recording(markers=markers)
        assert module._description(r, None, 5) == (
            f"frame 5, 0.500 s: M1 {word.replace('_', ' ')}, M2 {other.replace('_', ' ')}"
        )
        assert (
            module._description(r, PLACED, 20)
            == f"frame 20, 12.002 s: M1 {word.replace('_', ' ')}, M2 unknown"
        )

    @pytest.mark.parametrize(
        ("width", "shape"), [(320, (50, 100)), (100, (50, 100)), (40, (20, 40)), (1, (1, 1))]
    )
    def test_wide_pictures_are_reduced(self, width, shape):
        content = jpeg(np.full((50, 100, 3), (20, 120, 220), np.uint8), width)
        back = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        assert back.shape[:2] == shape
        assert np.abs(back.astype(int) - (20, 120, 220)).max() < 6

    def test_clips_whose_films_are_found_have_sheets(self, monkeypatch):
        asked = []

        def tiles(r, placement, folders, intervals):
            asked.append((r.source, placement, folders, intervals))
            return ["tile"] if r.source != "lost" else []

        monkeypatch.setattr(module, "_tiles", tiles)
        recordings = {str(i): recording("lost" if i == 1 else f"c{i}") for i in range(13)}
        case = SimpleNamespace(recordings=recordings, placements={"0": PLACED})
        found = contact_sheets(case, ["folder"], iter([(1.0, 2.0)]))
        assert [s.clip for s in found] == [f"c{i}" for i in range(12) if i != 1]
        assert asked[0] == ("c0", PLACED, ["folder"], [(1.0, 2.0)])
        assert asked[2][1:] == (None, ["folder"], [(1.0, 2.0)])
        assert module.Tile(b"abc", "").url == "data:image/jpeg;base64,YWJj"
