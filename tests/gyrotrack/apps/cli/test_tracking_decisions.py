"""Lines, documents and exit codes of the commands that track films, from results of known values."""

import math
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Estimate
from gyrotrack import UsageError
from gyrotrack.apps.cli import _tracking as module
from gyrotrack.apps.cli._output import DONE, NOT_TRUSTED
from gyrotrack.io._schema import STATUS


def estimate(value, stderr=0.1, unit="s", *, approximate=False):
    e = Estimate(value, stderr, unit, at_bound=False)
    return SimpleNamespace(value=e.value, stderr=e.stderr, unit=e.unit, approximate=approximate)


class Out:
    def __init__(self):
        self.results, self.shown, self.warned, self.noted = [], [], [], []

    @contextmanager
    def progress(self, *_):
        yield lambda *_: None

    def result(self, document):
        self.results.append(document)

    def show(self, *lines):
        self.shown += lines

    def warn(self, text):
        self.warned.append(text)

    def note(self, text):
        self.noted.append(text)

    detail = note


@pytest.mark.parametrize(
    ("text", "place"), [(None, None), ("1,2", (1.0, 2.0)), (" -1.5 , 2e2", (-1.5, 200.0))]
)
def test_a_hub_is_a_pair_of_numbers(text, place):
    assert module._position(text) == place


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "a,b", "nan,2", "1,inf"])
def test_a_hub_without_two_finite_numbers_is_refused(text):
    with pytest.raises(UsageError, match="is not a position"):
        module._position(text)


class TestProfile:
    def proposal(self, *, sound=True, notes=(), disc=True, bodies=("casing", "rotor"), hub=None):
        markers = [
            SimpleNamespace(
                profile=SimpleNamespace(name=f"M{i}", colour="red", hue=12.0, body=b),
                marker=SimpleNamespace(inner=40.0, outer=60.4, half_width=0.2, contrast=(30.0, 40.0)),
                seen=0.95, step=0.02,
            )
            for i, b in enumerate(bodies)
        ]  # fmt: skip
        profile = SimpleNamespace(centre="disc", circle_colour="white", hub=hub)
        return SimpleNamespace(
            markers=markers, centre=(320.25, 240.5), disc="disc" if disc else None, profile=profile, notes=notes,
            sound=sound,
        )  # fmt: skip

    @pytest.mark.parametrize(
        ("sound", "notes", "verdict"),
        [
            (True, (), "clear"),
            (True, ("x",), "in_doubt"),
            (False, ("x",), "not_confirmed"),
            (False, (), "not_confirmed"),
        ],
    )
    def test_doubts_are_the_verdict(self, sound, notes, verdict):
        document = module._profile_document(Path("a.toml"), None, self.proposal(sound=sound, notes=notes))
        assert document["verdict"] == verdict
        assert "picture" not in document
        assert document["circle_colour"] == "white"
        assert (
            module._profile_document(Path("a"), Path("b"), self.proposal(disc=False))["circle_colour"] is None
        )

    def test_a_marker_has_its_size_and_contrast(self):
        m = module._marker(self.proposal().markers[0])
        assert (m["inner_px"], m["outer_px"], m["half_width_rad"], m["contrast"]) == (40.0, 60.4, 0.2, 50.0)
        assert (m["seen"], m["step_rad"], m["hue_deg"], m["body"]) == (0.95, 0.02, 12.0, "casing")

    @pytest.mark.parametrize(
        ("disc", "hub", "words"),
        [(True, None, "a white disc"), (False, None, "the markers' orbit"), (True, (1, 2), "--hub")],
    )
    def test_the_origin_of_the_centre_is_stated(self, disc, hub, words):
        lines = module._profile_lines(Path("a.toml"), self.proposal(disc=disc, hub=hub)).splitlines()
        assert lines[0] == f"centre (320.2, 240.5) px from {words}"
        assert lines[2].split() == ["M0", "red", "casing", "40", "-", "60", "50", "95%"]
        assert lines[-1] == "written: a.toml"

    @pytest.mark.parametrize(
        ("way", "words"),
        [("outline", "A body turns while it moves across the picture, near (320, 240) px"),
         ("corners", "One body turns about (320.2, 240.4) px")],
    )  # fmt: skip
    def test_a_body_without_markers_is_described(self, way, words):
        ring = SimpleNamespace(hub=(320.24, 240.36), inner=10.0, outer=90.0)
        reading = module._body_reading(SimpleNamespace(ring=ring, way=way, explained=0.876))
        assert (reading["hub_px"], reading["ring_px"]) == ([320.24, 240.36], [10.0, 90.0])
        text = module._body_sentence(reading, Path("/x/a.mp4"))
        assert text.startswith(f"{words}; tracking quality 88 %.")
        assert "`gyrotrack spindown a.mp4`" in text

    @pytest.mark.parametrize(
        ("bodies", "sound", "searched", "code"),
        [
            (("casing", "rotor"), True, 0, None),
            (("casing", "rotor"), False, 0, NOT_TRUSTED),
            (("rotor",), True, 1, None),
        ],
    )
    def test_markers_of_one_body_have_an_alternative(
        self, monkeypatch, tmp_path, bodies, sound, searched, code
    ):
        calls = []
        ring = SimpleNamespace(hub=(1.0, 2.0), inner=1.0, outer=2.0)
        body = ("film", SimpleNamespace(ring=ring, way="corners", explained=0.5))
        monkeypatch.setattr(
            "gyrotrack.tracking._proposal.propose",
            lambda *_, **__: self.proposal(bodies=bodies, sound=sound, notes=["x"]),
        )
        monkeypatch.setattr(
            "gyrotrack.tracking._any_body.read_excerpt", lambda *args: calls.append(args[:2]) or body
        )
        monkeypatch.setattr("gyrotrack.tracking._profile.to_toml", lambda profile: "text µ")
        out = Out()
        target = tmp_path / "a.toml"
        found = module.profile_command(tmp_path / "a.mp4", output=target, hub="3,4", out=out)
        assert found == code
        assert calls == [(tmp_path / "a.mp4", (3.0, 4.0))] * searched
        assert target.read_text(encoding="utf-8") == "# found in a.mp4 by gyrotrack profile\n# x\ntext µ"
        assert ("readings" in out.results[0]) is bool(searched)
        assert out.warned == ["x"]

    @pytest.mark.parametrize("fps", [0.0, -1.0, 1e7, math.nan])
    def test_capture_rates_are_positive(self, fps):
        with pytest.raises(UsageError, match="capture rate"):
            module.profile_command(Path("a.mp4"), capture_fps=fps, out=Out())
        with pytest.raises(UsageError, match="picture format"):
            module.profile_command(Path("a.mp4"), picture=Path("a.jpg"), out=Out())


def recording(*, doubts=(), warnings=("w",)):
    status = np.array([STATUS["ok"], STATUS["ok"], STATUS["lost"]])
    return SimpleNamespace(
        frames_decoded=3, frames_declared=4, sense=-1, capture_fps=260.0, warnings=warnings,
        markers={"M1": SimpleNamespace(status=status)},
        bodies={"casing": SimpleNamespace(time=np.arange(3.0), sigma=np.array([1e-3, 2e-3, 9e-3]))},
        extra={"capture_rate_from": "asked for", "times_from": "stamps"}, doubts=doubts,
    )  # fmt: skip


class TestExtract:
    def test_a_document_has_medians_and_counts(self):
        document = module._extraction_document(Path("a.h5"), recording(), 99.4)
        assert (document["frames"], document["frames_declared"], document["sense"]) == (3, 4, -1)
        assert document["body"] == {"casing": {"samples": 3, "median_sigma": 2e-3}}
        assert (document["markers"]["M1"]["ok"], document["markers"]["M1"]["lost"]) == (2, 1)
        lines = module._extraction_lines(document).splitlines()
        assert lines[1].split() == ["M1", "2", "0", "0", "0", "1"]
        assert lines[2] == "casing: 3 angles, median uncertainty 2 mrad"
        assert lines[3] == "capture rate 260 fps (from --capture-fps); times from the timestamps"
        assert lines[4] == "3 frames at 99 frames/s; written: a.h5"
        document = module._extraction_document(Path("a.h5"), recording(), math.nan)
        assert module._extraction_lines(document | {"times_from": "frames"}).splitlines()[3:] == [
            "capture rate 260 fps (from --capture-fps)", "3 frames; written: a.h5",
        ]  # fmt: skip

    def run(self, monkeypatch, tmp_path, *, doubts=(), complete=False, left=False, **options):
        calls = {}

        class Job:
            def __init__(self, *args):
                calls["job"] = args

            def earlier(self):
                calls["earlier"] = True
                return recording() if complete else None

            def run(self, **more):
                calls["run"] = more
                return recording(doubts=doubts), 50.0

        monkeypatch.setattr("gyrotrack.tracking._extract.ExtractionJob", Job)
        monkeypatch.setattr("gyrotrack.io._records.doubts_of", lambda r: r.doubts)
        monkeypatch.setattr("gyrotrack.io._atomic.is_left", lambda path: left)
        monkeypatch.setattr("gyrotrack.io._atomic.mark_new", lambda *args: calls.update(marked=args))
        monkeypatch.setattr(
            "gyrotrack.io._atomic.refuse_existing",
            lambda path, *, force, reads: calls.setdefault("refused", []).append((path.name, force)),
        )
        monkeypatch.setattr(
            "gyrotrack.plotting._frames.write_contact_sheet",
            lambda *args, **more: calls.update(sheet=(args, more)),
        )
        monkeypatch.setattr(
            "gyrotrack.plotting._frames.write_overlay", lambda *args, **more: calls.update(overlay=args)
        )
        out = Out()
        code = module.extract_command(tmp_path / "a.mp4", out=out, **options)
        return code, out, calls

    @pytest.mark.parametrize(("doubts", "code"), [((), DONE), (("x",), NOT_TRUSTED)])
    def test_doubts_set_the_exit_code(self, monkeypatch, tmp_path, doubts, code):
        found, out, calls = self.run(monkeypatch, tmp_path, doubts=doubts, body=module.Body.rotor, workers=3)
        assert found == code
        assert out.warned == ["w"]
        video, target, _, fps, body, times, workers = calls["job"]
        assert (video.name, target.name, fps, body, times, workers) == (
            "a.mp4",
            "a.h5",
            None,
            "rotor",
            "auto",
            3,
        )
        assert (calls["run"]["resume"], calls["run"]["force"]) == (True, False)
        assert "earlier" not in calls

    def test_force_ignores_a_complete_output_but_resume_uses_the_checkpoint(self, monkeypatch, tmp_path):
        _, _, calls = self.run(monkeypatch, tmp_path, force=True)
        assert (calls["run"]["resume"], calls["run"]["force"]) == (False, True)
        _, _, calls = self.run(monkeypatch, tmp_path, force=True, resume=True)
        assert calls["run"]["resume"]
        assert "earlier" not in calls

    @pytest.mark.parametrize(("resume", "left"), [(True, False), (False, True)])
    def test_a_complete_output_is_used(self, monkeypatch, tmp_path, resume, left):
        _code, out, calls = self.run(monkeypatch, tmp_path, complete=True, resume=resume, left=left)
        assert "run" not in calls
        assert ("marked" in calls) is left
        assert out.noted[0].endswith("is already complete.")
        assert calls["refused"] == [("a.h5", True)]
        _, _, calls = self.run(monkeypatch, tmp_path, resume=resume, left=left)
        assert "run" in calls
        assert calls["refused"] == [("a.h5", False)]

    def test_pictures_are_drawn_on_request(self, monkeypatch, tmp_path):
        _, out, calls = self.run(
            monkeypatch, tmp_path, overlay=tmp_path / "o.mp4", contact_sheet=tmp_path / "s.png", force=True
        )
        assert (out.results[0]["overlay"].name, out.results[0]["contact_sheet"].name) == ("o.mp4", "s.png")
        assert calls["sheet"][1] == {"force": True}
        assert calls["refused"] == [("a.h5", True), ("o.mp4", True), ("s.png", True)]

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"links": True}, "--links applies to points"), ({"hub": "1,2"}, "--hub and --scale"),
            ({"scale": "1"}, "--hub and --scale"), ({"points": ["1,2"], "profile": Path("p")}, "apply to markers"),
            ({"points": ["1,2"], "body": module.Body.rotor}, "apply to markers"),
            ({"points": ["1,2"], "overlay": Path("o.mp4")}, "apply to markers"),
            ({"points": ["1,2"], "contact_sheet": Path("o.png")}, "apply to markers"),
        ],
    )  # fmt: skip
    def test_options_of_points_and_markers_exclude_each_other(self, monkeypatch, tmp_path, options, words):
        with pytest.raises(UsageError, match=words):
            self.run(monkeypatch, tmp_path, **options)


class TestSync:
    def match(self, **more):
        parts = {
            "start": SimpleNamespace(offset=12.5, eps=2e-5, angle=-0.5), "offset_sigma": 2e-4, "rate_sigma": 1e-6,
            "angle_sigma": 0.01, "covariance": np.eye(3), "ambiguous": False, "rivals": (), "misfit": 1e-3,
            "rejected": 2, "common_rate": True, "common_direction": False, "name": "r", "method": "casing",
        }  # fmt: skip
        return SimpleNamespace(**(parts | more))

    def test_a_clip_has_its_clock_and_its_angle(self):
        clip = module._clip(Path("/x/r1.h5"), self.match())
        assert (clip["offset_s"], clip["rate"], clip["outliers"]) == (12.5, 1.00002, 2)
        assert clip["angle_offset"] == pytest.approx(2 * math.pi - 0.5)
        assert (clip["common_rate"], clip["common_direction"]) == (True, False)
        assert module._line(clip).split() == ["r1.h5", "12.50000", "0.200", "20.0", "1.0"]
        clip = module._clip(Path("a" * 25 + ".h5"), self.match(ambiguous=True))
        assert module._line(clip).split()[0] == "..." + "a" * 17 + ".h5"
        assert module._line(clip).endswith("  ambiguous")
        assert module._line(module._clip(Path("b" * 20 + ".h5"), self.match())).startswith("b" * 20 + ".h5")

    def test_a_case_is_written_with_its_inertias(self, monkeypatch, tmp_path):
        calls = {}
        done = SimpleNamespace(
            case=SimpleNamespace(warnings=("w",)), matches=[self.match(), self.match(name="s")]
        )
        monkeypatch.setattr("gyrotrack.apps._api.synchronised", lambda *args: calls.update(args=args) or done)
        monkeypatch.setattr(
            "gyrotrack.io._hdf5.write_case", lambda path, case, **more: calls.update(path=path, **more)
        )
        out = Out()
        module.sync_command(
            tmp_path / "c.h5", [tmp_path / "r1.h5", tmp_path / "r2.h5"], output=tmp_path / "case.h5",
            inertia_rotor="5e-5", inertia_casing="2e-5", surface="PVC", out=out,
        )  # fmt: skip
        assert calls["args"][2:4] == ("case", "PVC")
        assert calls["settings"]["I_rotor"] == 5e-5
        assert calls["settings"]["I_casing"] == 2e-5
        assert [i.value for i in calls["args"][4]] == [5e-5, 2e-5]
        assert [c["source"].name for c in out.results[0]["clips"]] == ["r1.h5", "r2.h5"]
        assert out.noted == [f"{n}: casing; rms difference of the cameras 1.00 mrad" for n in "rs"]
        assert out.warned == ["w"]


def motion(**more):
    parts = {
        "kind": "steady", "turns": 12.3456, "omega": {"first": 30.0, "last": 20.0},
        "omega_u": {"first": 0.1, "last": 0.0}, "omega_mean": estimate(25.0), "alpha": estimate(-1.0), "period": None,
        "amplitude": None, "decay": None, "quality_factor": None,
    }  # fmt: skip
    return SimpleNamespace(**(parts | more))


def document(**more):
    parts = {
        "motion": motion(), "reading": [], "diagnosis": None, "response": None, "first_order": [], "oscillator": None,
        "laws": [], "case": None, "report": None, "picture": None, "ambiguous": False, "warnings": [], "ladder": [],
    }  # fmt: skip
    return parts | more


class TestSpindown:
    def lines(self, **more):
        (text,) = module._lines(document(**more))
        return text.splitlines()

    def test_a_rotation_has_its_speeds(self):
        assert self.lines() == [
            "steady, 12.346 turns", "omega      30.00 +- 0.10 to 20 rad/s", "mean       25.00 +- 0.10 rad/s",
            "alpha      -1.00 +- 0.10 rad/s2",
        ]  # fmt: skip
        assert self.lines(motion=motion(turns=math.nan))[0] == "steady"
        assert [x.split()[0] for x in self.lines(motion=motion(kind="fluctuating"))] == [
            "fluctuating,",
            "omega",
            "mean",
        ]
        lines = self.lines(motion=motion(kind="driven"))
        assert lines[2:] == ["response   not of first order"]
        assert self.lines(case=Path("a.h5"), picture=Path("c.png"))[-1] == "written: a.h5, c.png"

    def test_an_oscillation_has_its_period(self):
        m = motion(
            kind="oscillation",
            period=estimate(2.0, 0.01),
            amplitude=estimate(0.3, 0.01),
            quality_factor=estimate(50.0, 1.0),
        )
        assert self.lines(motion=m)[1:] == [
            "period     2.000 +- 0.010 s", "amplitude  0.300 +- 0.010 rad, at the middle of the record",
            "Q          50.0 +- 1.0",
        ]  # fmt: skip

    def test_a_response_has_its_constants(self):
        response = SimpleNamespace(
            input="voltage", unit="V", explained=0.987, time_constant=estimate(0.5), delay=None, gain=estimate(9.0),
            final=None,
        )  # fmt: skip
        lines = module._response_lines(response)
        assert lines[0] == "response   of first order to the input 'voltage'; it explains 98.7 %"
        assert lines[1:] == ["tau        0.50 +- 0.10 s", "gain       9.00 +- 0.10 rad/s per V"]
        response.input, response.unit = "", ""
        assert module._response_lines(response)[0].startswith(
            "response   of first order to the constant drive;"
        )
        assert module._response_lines(response)[-1].endswith("per unit")

    @pytest.mark.parametrize(
        ("verdict", "complete"), [("adequate", True), ("unexplained", False), (None, False)]
    )
    def test_a_fit_of_first_order_may_be_incomplete(self, verdict, complete):
        found = [
            {
                "time_constant": estimate(0.5),
                "gains": {"u": estimate(9.0, unit="1/s")},
                "delays": {"u": estimate(0.3)},
            }
        ]
        diagnosis = None if verdict is None else {"verdict": verdict}
        lines = module._first_order_lines({"first_order": found, "diagnosis": diagnosis})
        assert lines[0].endswith(", which is not complete") is not complete
        assert [x.split("  ")[0] for x in lines[1:]] == ["tau", "gain of u", "dead time of u"]
        assert module._first_order_lines({"first_order": [], "diagnosis": None}) == []

    def test_laws_of_an_oscillator_have_their_rivals(self):
        laws = SimpleNamespace(
            parameters={"spring.k": estimate(2.0), "drag.b": estimate(3.0, approximate=True)},
            restoring=("spring",), restoring_classes=(("spring",),),
            damping=("drag",), damping_classes=(("drag",), (), ("a", "b"), ("c",), ("d",), ("e",)),
        )  # fmt: skip
        assert module._oscillator_lines(laws) == [
            "restoring  spring.k = 2.00 +- 0.10 s",
            "damping    drag.b about 3.00 +- 0.10 s (or none or a + b or c or 2 more)",
        ]
        laws.damping, laws.damping_classes = (), ((),)
        assert module._oscillator_lines(laws)[1] == "damping    none"

    def test_values_of_an_oscillator_are_not_repeated(self):
        law = SimpleNamespace(
            words="drag", parameter="drag.b", value=2.0, stderr=0.1, unit="s", meaning="it slows"
        )
        assert module._law_lines(document(laws=[law])) == ["law        drag = 2.00 +- 0.10 s: it slows"]
        oscillator = SimpleNamespace(parameters={"drag.b": 1})
        assert module._law_lines(document(laws=[law], oscillator=oscillator)) == ["law        drag: it slows"]

    @pytest.mark.parametrize(
        ("value", "u", "text"),
        [(12.3456789, 0.0, "12.3457"), (12.3, math.nan, "12.3"), (12.3, 0.1, "12.30 +- 0.10")],
    )
    def test_an_unknown_uncertainty_is_not_stated(self, value, u, text):
        assert module._with_u(value, u) == text

    def run(self, monkeypatch, tmp_path, source="a.mp4", *, found=None, **options):
        calls = []
        made = document(case=Path("a.h5")) if found is None else found
        monkeypatch.setattr(
            "gyrotrack.apps._spindown.spindown",
            lambda source, target, page, options, **more: (
                calls.append((source, target, page, options)) or made
            ),
        )
        monkeypatch.setattr("gyrotrack.apps._refusal.pictured_refusal", lambda target: nullcontext())
        monkeypatch.chdir(tmp_path)
        out = Out()
        return module.spindown_command(tmp_path / source, out=out, **options), calls[0], out

    @pytest.mark.parametrize(
        ("source", "target"), [("a.mp4", "a.h5"), ("b.csv", "b.h5"), ("c.h5", "c_case.h5")]
    )
    def test_the_case_has_the_name_of_the_source(self, monkeypatch, tmp_path, source, target):
        _, (_, case, page, _), _ = self.run(monkeypatch, tmp_path, source)
        assert (case.name, page.name) == (target, Path(target).with_suffix(".html").name)

    @pytest.mark.parametrize(
        ("more", "code"),
        [
            ({"motion": motion(kind="steady")}, DONE),
            ({"motion": motion(kind="fluctuating")}, DONE),
            ({"motion": motion(kind="driven")}, NOT_TRUSTED),
            ({"motion": motion(kind="driven", period=estimate(2.0))}, DONE),
            ({"ambiguous": True}, NOT_TRUSTED),
            ({"diagnosis": {"verdict": "adequate", "sentence": "So."}}, DONE),
            ({"diagnosis": {"verdict": "unexplained", "sentence": "So."}}, NOT_TRUSTED),
            ({"diagnosis": {"verdict": "adequate", "sentence": "So."}, "ambiguous": True}, NOT_TRUSTED),
        ],
    )
    def test_doubts_set_the_exit_code(self, monkeypatch, tmp_path, more, code):
        assert self.run(monkeypatch, tmp_path, found=document(case=Path("a.h5"), **more))[0] == code

    def test_a_report_has_its_own_name(self, monkeypatch, tmp_path):
        for options in ({"report": tmp_path / "a.mp4"}, {"output": Path("x.h5"), "report": Path("x.h5")}):
            with pytest.raises(UsageError, match="both the case and the report"):
                self.run(monkeypatch, tmp_path, **options)
        with pytest.raises(UsageError, match="no angle to write"):
            self.run(monkeypatch, tmp_path, found=document(), output=Path("x.h5"))
        self.run(monkeypatch, tmp_path, found=document())
