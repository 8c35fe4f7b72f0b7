"""`gyrotrack extract` as a user runs it."""

import json

import h5py
import numpy as np
import pytest

from gyrotrack.apps.cli._app import run


@pytest.fixture
def film(casing_clip):
    return casing_clip[0]


def _json(capsys):
    captured = capsys.readouterr()
    return json.loads(captured.out), captured.err


@pytest.mark.slow
def test_a_film_becomes_a_recording(film, tmp_path, capsys):
    target = tmp_path / "out.h5"
    assert run(["extract", str(film), "-o", str(target), "--json"]) == 0
    document, _ = _json(capsys)
    assert document["output"] == str(target)
    assert document["frames"] == 100
    assert document["markers"]["red"]["ok"] > 88
    assert set(document["markers"]["red"]) == {"ok", "blurred", "occluded", "out_of_frame", "lost"}
    assert document["body"]["casing"]["samples"] > 92
    assert 1e-4 < document["body"]["casing"]["median_sigma"] < 1e-2
    assert document["fps"] > 0
    assert document["warnings"] == []
    with h5py.File(target) as file:
        assert file.attrs["kind"] == "recording"
        assert np.all(np.diff(file["body/casing/angle"][:]) > 0)


def test_the_output_stands_beside_the_film_if_not_said_otherwise(film, tmp_path, capsys):
    copy = tmp_path / "spin.mp4"
    copy.write_bytes(film.read_bytes())
    assert run(["extract", str(copy), "--body", "casing", "--workers", "5"]) == 0
    assert (tmp_path / "spin.h5").exists()
    captured = capsys.readouterr()
    assert "casing" in captured.out
    assert "tracked by 1 of 5 processes" in captured.err  # 170 frames are one part


def test_an_existing_output_is_kept_without_force(film, tmp_path, capsys):
    target = tmp_path / "out.h5"
    target.write_bytes(b"mine")
    assert run(["extract", str(film), "-o", str(target)]) == 1
    assert target.read_bytes() == b"mine"
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "code"),
    [(b"", "video"), (b"no film at all", "video"), (None, "video")],
    ids=["empty", "text", "missing"],
)
def test_a_wrong_file_is_one_sentence_and_nothing_is_written(tmp_path, capsys, content, code):
    film = tmp_path / "wrong.mp4"
    if content is not None:
        film.write_bytes(content)
    before = sorted(tmp_path.iterdir())
    assert run(["extract", str(film), "--json"]) == 1
    document, _ = _json(capsys)
    assert document["error"]["code"] == code
    assert "wrong.mp4" in document["error"]["message"]
    assert document["error"]["hint"]
    assert sorted(tmp_path.iterdir()) == before


def test_a_clip_without_markers_is_one_sentence(draw, tmp_path, capsys):
    film, _ = draw(
        width=320, height=240, radius=105.0, frames=30, disc=None, rotor_papers=False, casing_paper=False
    )
    target = tmp_path / "out.h5"
    assert run(["extract", str(film), "-o", str(target)]) == 1
    message = capsys.readouterr().err
    assert "No markers found" in message
    assert "Traceback" not in message
    assert not target.exists()


def test_a_faulty_profile_names_its_key(film, tmp_path, capsys):
    profile = tmp_path / "p.toml"
    profile.write_text('[[marker]]\nname = "a"\ncolour = "pink"\nbody = "rotor"\n')
    assert run(["extract", str(film), "--profile", str(profile), "-o", str(tmp_path / "x.h5")]) == 1
    assert "marker[1].colour" in capsys.readouterr().err


def test_a_wrong_body_is_wrong_usage(film, tmp_path, capsys):
    assert run(["extract", str(film), "--body", "wheel"]) == 2
    capsys.readouterr()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["look.png", "look.mp4"])
def test_an_overlay_shows_what_was_found(film, tmp_path, capsys, name):
    import av

    picture = tmp_path / name
    assert run(["extract", str(film), "-o", str(tmp_path / "o.h5"), "--overlay", str(picture), "--json"]) == 0
    document, _ = _json(capsys)
    assert document["overlay"] == str(picture)
    with av.open(str(picture)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == (1 if name.endswith("png") else 100)
    assert (frames[0].reshape(-1, 3).max(axis=0) == 255).any() or frames[0].max() > 240
