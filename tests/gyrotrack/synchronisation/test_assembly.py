"""The case that `sync` makes, and the command that makes it."""

import dataclasses
import json

import numpy as np
import pytest

from fitting.inference._case_file import read_record
from gyrotrack import SyncError, UsageError, read_case, write_recording
from gyrotrack.apps.cli._app import run
from gyrotrack.synchronisation._decision import synchronise

NAMES = ["casing.h5", "a.h5", "b.h5", "c.h5"]

INERTIAS = ["--inertia-rotor", "5.54e-5", "--inertia-casing", "2.06e-5"]


@pytest.fixture
def recordings(make_recordings):
    return make_recordings([44.1, 3.2])


def test_the_case_is_on_the_casing_camera_s_clock(motion, recordings):
    done = synchronise(
        recordings[0], recordings[1:], NAMES[:3], label="L", surface="S", I_rotor=6e-5, I_casing=2.06e-5
    )
    case = done.case
    assert (case.label, case.surface, case.I_rotor, case.I_casing) == ("L", "S", 6e-5, 2.06e-5)
    assert [m.name for m in done.matches] == ["a.h5", "b.h5"]
    assert list(np.unique(case.rotor.window)) == [0, 1]
    assert (np.diff(case.rotor.time) > 0).all()
    assert case.rotor.time[0] == pytest.approx(3.2, abs=1e-3)
    np.testing.assert_allclose(case.rotor.omega, motion(case.rotor.time)[0], rtol=1e-5)
    np.testing.assert_array_equal(case.casing.time, recordings[0].bodies["casing"].time)
    assert case.casing.window is None
    assert case.recordings["rotor_0"].source == "rotor1.mp4"
    placed = case.placements["rotor_0"]
    assert placed.clock_offset == pytest.approx(3.2, abs=5 * placed.clock_offset_sigma)
    assert placed.clock_rate == pytest.approx(1 + 2e-5, abs=5 * placed.clock_rate_sigma)
    assert placed.angle_offset == pytest.approx(1.0, abs=0.05)
    assert case.placements["casing"].clock_rate == 1.0


def test_the_same_film_twice_is_refused(recordings):
    with pytest.raises(SyncError, match="come from the same film"):
        synchronise(recordings[0], [recordings[1]] * 2, NAMES[:3], I_rotor=5.54e-5, I_casing=2.06e-5)


def test_a_rotor_without_a_sample_is_refused(recordings):
    rotor = recordings[1].bodies["rotor"]
    none = {
        f.name: getattr(rotor, f.name)[:0]
        for f in dataclasses.fields(rotor)
        if isinstance(getattr(rotor, f.name), np.ndarray)
    }
    empty = recordings[1].bodies | {"rotor": dataclasses.replace(rotor, **none)}
    with pytest.raises(SyncError, match=r"a\.h5 does not show the rotor"):
        synchronise(
            recordings[0],
            [dataclasses.replace(recordings[1], bodies=empty)],
            NAMES[:2],
            I_rotor=5.54e-5,
            I_casing=2.06e-5,
        )


@pytest.mark.parametrize("missing", ["casing", "rotor"])
def test_a_clip_without_a_body_is_refused(recordings, missing):
    bodies = {name: body for name, body in recordings[1].bodies.items() if name != missing}
    with pytest.raises(SyncError, match=f"a.h5 does not show the {missing}"):
        synchronise(
            recordings[0],
            [dataclasses.replace(recordings[1], bodies=bodies)],
            NAMES[:2],
            I_rotor=5.54e-5,
            I_casing=2.06e-5,
        )


def test_too_few_frames_are_refused(recordings):
    body = recordings[1].bodies["casing"]
    few = {
        f.name: getattr(body, f.name)[:30]
        for f in dataclasses.fields(body)
        if isinstance(getattr(body, f.name), np.ndarray)
    }
    bodies = {**recordings[1].bodies, "casing": dataclasses.replace(body, **few)}
    with pytest.raises(SyncError, match="in only 30 frames"):
        synchronise(
            recordings[0],
            [dataclasses.replace(recordings[1], bodies=bodies)],
            NAMES[:2],
            I_rotor=5.54e-5,
            I_casing=2.06e-5,
        )


def test_bad_arguments(recordings):
    with pytest.raises(UsageError, match="inertia"):
        synchronise(recordings[0], recordings[1:], NAMES[:3], I_rotor=-1.0, I_casing=2.06e-5)
    with pytest.raises(UsageError, match="no rotor clip"):
        synchronise(recordings[0], [], NAMES[:1], I_rotor=5.54e-5, I_casing=2.06e-5)


def test_a_rotor_that_speeds_up_between_clips_is_reported(recordings):
    late, early = recordings[1:]
    faster = dataclasses.replace(late.bodies["rotor"], omega=2 * late.bodies["rotor"].omega)
    late = dataclasses.replace(late, bodies={**late.bodies, "rotor": faster})
    done = synchronise(recordings[0], [late, early], NAMES[:3], I_rotor=5.54e-5, I_casing=2.06e-5)
    assert any("faster in the later clip" in warning for warning in done.case.warnings)


@pytest.mark.slow
def test_outliers_and_gaps_do_not_matter(recordings):
    rng = np.random.default_rng(3)
    clip = recordings[2]
    body = clip.bodies["casing"]
    angle = body.angle + np.where(rng.random(body.angle.size) < 0.02, rng.normal(size=body.angle.size), 0)
    keep = rng.random(body.angle.size) > 0.1
    keep[1000:1100] = False
    columns = {
        f.name: getattr(body, f.name)[keep]
        for f in dataclasses.fields(body)
        if isinstance(getattr(body, f.name), np.ndarray) and f.name != "angle"
    }
    damaged = dataclasses.replace(body, **columns, angle=angle[keep])
    done = synchronise(
        recordings[0],
        [dataclasses.replace(clip, bodies={**clip.bodies, "casing": damaged})],
        NAMES[:2],
        I_rotor=5.54e-5,
        I_casing=2.06e-5,
    )
    (found,) = done.matches
    assert abs(found.start.offset - 3.2) < 5 * found.offset_sigma < 1e-3


class TestCommand:
    @pytest.fixture
    def files(self, tmp_path, monkeypatch, recordings):
        monkeypatch.chdir(tmp_path)
        for name, recording in zip(NAMES, recordings, strict=False):
            write_recording(tmp_path / name, recording, command="", settings={})
        return tmp_path

    @pytest.mark.slow
    def test_json(self, files, capsys):
        assert run(["sync", "casing.h5", "a.h5", "b.h5", "-o", "case.h5", "--json", *INERTIAS]) == 0
        said = json.loads(capsys.readouterr().out)
        assert said["output"] == "case.h5"
        assert [clip["source"] for clip in said["clips"]] == ["a.h5", "b.h5"]
        for clip, start in zip(said["clips"], (44.1, 3.2), strict=True):
            assert abs(clip["offset_s"] - start) < 5 * clip["offset_sigma_s"]
            assert clip["ambiguous"] in {True, False}
            assert abs(clip["rate"] - 1 - 2e-5) < 5 * clip["rate_sigma"]
            assert 0 <= clip["angle_offset"] < 2 * np.pi
            assert clip["covariance"][0][0] == pytest.approx(clip["offset_sigma_s"] ** 2)
        kept = read_case(files / "case.h5").extra["sync_covariance"]
        assert sorted(kept) == ["rotor_0", "rotor_1"]
        assert read_case(files / "case.h5").label == "case"
        # what a fit makes of it
        told = {c["source"]: c["offset_sigma_s"] for c in said["clips"]}
        assert read_record(files / "case.h5").start_sigma == (told["b.h5"], told["a.h5"])

    @pytest.mark.slow
    def test_table(self, files, capsys):
        assert run(["sync", "casing.h5", "b.h5", "-o", "case.h5", *INERTIAS]) == 0
        said = capsys.readouterr()
        assert "b.h5" in said.out
        assert max(map(len, said.out.splitlines())) <= 80

    @pytest.mark.slow
    def test_a_case_is_not_a_recording(self, files, capsys):
        run(["sync", "casing.h5", "b.h5", "-o", "case.h5", *INERTIAS])
        assert run(["sync", "case.h5", "b.h5", "-o", "again.h5", *INERTIAS]) == 1
        assert "is a case, not a recording" in capsys.readouterr().err
        assert not (files / "again.h5").exists()
