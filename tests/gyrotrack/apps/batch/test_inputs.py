"""What a manifest or a folder says, and what it says wrong."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrotrack import ConfigurationError, UsageError
from gyrotrack.apps.batch._experiments import (
    Clip,
    Experiment,
    folder_name,
    read_folder,
    read_manifest,
    read_study,
    unique_name,
    with_folders,
    with_inertias,
)
from gyrotrack.apps.batch._steps import Request, plan

TOML = """
[defaults]
casing_fps = 260
inertia_rotor = 5e-5

[[case]]
label = "pvc 1"
casing = "pvc1/casing.mp4"
rotor = ["pvc1/r1.mp4", "/films/r1.mp4"]
rotor_fps = 1000
surface = "PVC"

[[case]]
data = "old/case7.h5"

[[case]]
study = "study.toml"
inertia_rotor = 7e-5

[[clip]]
file = "wheel.mp4"
capture_fps = 300
profile = "wheel.toml"
"""
STUDY = """
label = "noted"
inertia_casing = 2e-6

[[clip]]
file = "r.mp4"
body = "rotor"
[[clip]]
file = "c.mp4"
body = "casing"
capture_fps = 100
"""
CSV = """case;body;file;capture_fps;surface
pvc;rotor;r1.mp4;1000;
pvc;casing;c.mp4;260;PVC
;;wheel.mp4;;
"""


@pytest.fixture
def write(tmp_path):
    def make(name, text):
        path = tmp_path / name
        path.write_text(text)
        return path

    return make


def test_toml(write, tmp_path):
    write("study.toml", STUDY)
    pvc, old, noted, wheel = read_manifest(write("m.toml", TOML))
    assert pvc.clips == (
        Clip(tmp_path / "pvc1/casing.mp4", "casing", 260),
        Clip(tmp_path / "pvc1/r1.mp4", "rotor", 1000),
        Clip(Path("/films/r1.mp4"), "rotor", 1000),
    )
    assert (pvc.label, pvc.folder, pvc.surface, pvc.inertia_rotor) == ("pvc 1", "pvc_1", "PVC", "5e-05")
    assert (old.label, old.data) == ("case7", tmp_path / "old/case7.h5")
    assert (noted.label, noted.inertia_rotor, noted.inertia_casing) == ("noted", "7e-05", "2e-06")
    assert [c.body for c in noted.clips] == ["casing", "rotor"]
    assert wheel.alone
    assert wheel.clips[0] == Clip(tmp_path / "wheel.mp4", "", 300, tmp_path / "wheel.toml")


def test_csv(write, tmp_path):
    wheel, pvc = read_manifest(write("m.csv", CSV))
    assert wheel.alone
    assert [(c.file.name, c.body, c.capture_fps) for c in pvc.clips] == [
        ("c.mp4", "casing", 260),
        ("r1.mp4", "rotor", 1000),
    ]
    assert pvc.surface == "PVC"


def test_folder(tmp_path):
    for name in (
        "one/casing.mp4",
        "one/rotor_1_1000fps.MP4",
        "one/rotor_2.mov",
        "two/a_casing.mp4",
        "two/a_rotor.mp4",
        "two/b-Casing 2.avi",
        "two/b-rotor.mkv",
        "two/casingham.mp4",
        "lonely/rotor_1.mp4",
        "results/case/casing.mp4",
        ".hidden/casing.mp4",
        "one/notes.txt",
    ):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_bytes(b"")
    (tmp_path / "three").mkdir()
    (tmp_path / "three" / "study.toml").write_text(STUDY)
    found = read_folder(tmp_path, casing_fps=260, skip=tmp_path / "results")
    assert {e.label: [c.file.name for c in e.clips] for e in found} == {
        "one": ["casing.mp4", "rotor_1_1000fps.MP4", "rotor_2.mov"],
        "two/a": ["a_casing.mp4", "a_rotor.mp4"],
        "two/b": ["b-Casing 2.avi", "b-rotor.mkv"],
        "two/casingham": ["casingham.mp4"],
        "lonely/rotor_1": ["rotor_1.mp4"],
        "noted": ["c.mp4", "r.mp4"],
    }
    one = next(e for e in found if e.label == "one")
    assert [c.capture_fps for c in one.clips] == [260, 1000, None]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[case]]\ncasing = 'a'\n", "line 1, case[1]: a case needs one film of the casing"),
        (
            "[[case]]\ncasing = 'a'\nrotor = ['b']\ndata = 'c'\n",
            "line 1, case[1]: a case needs exactly one of",
        ),
        ("[[clip]]\nfile = 'a'\ncapture_fps = -1\n", "line 3, clip[1].capture_fps: input should be greater"),
        ("[[clip]]\nflie = 'a'\n", "line 2, clip[1].flie: extra inputs"),
        ("[[clip]]\nfile = 'a'\n[[clip]]\nfile = 'b/a'\n", "two cases have the label 'a'"),
        ("", "contains no film and no case"),
        ("[[case]]\nstudy = 'no.toml'\n", "There is no study"),
    ],
)
def test_faults_of_a_manifest_name_line_and_key(write, text, words):
    with pytest.raises(ConfigurationError) as caught:
        read_manifest(write("m.toml", text))
    assert words in caught.value.message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("case,body,file\nx,wheel,a.mp4\n", "line 2: body: input should be"),
        ("case,file\nx,\n", "line 2: file: field required"),
        ("case,body,file\nx,rotor,a.mp4\n", "0 films of the casing and 1 of the rotor"),
        ("case,body,file,fps\nx,rotor,a.mp4,3\n", "fps: extra inputs"),
        ("file\na.mp4,b.mp4\n", "extra inputs"),
    ],
)
def test_faults_of_a_table_name_the_line(write, text, words):
    with pytest.raises(ConfigurationError) as caught:
        read_manifest(write("m.csv", text))
    assert words in caught.value.message


def test_an_empty_folder(tmp_path):
    with pytest.raises(ConfigurationError, match="contains no film"):
        read_folder(tmp_path)
    with pytest.raises(ConfigurationError, match="There is no folder"):
        read_folder(tmp_path / "no")


@pytest.mark.slow
@given(st.text(max_size=100))
def test_no_label_leads_out_of_the_results(label):
    name = folder_name(label)
    assert os.path.dirname(os.path.normpath(f"/results/{name}")) == "/results"  # noqa: PTH120 - without the disk
    assert not {"/", "\\", "\0", ":", "\x1b"} & set(name)
    assert name.partition(".")[0].casefold() not in {"con", "nul", "prn", "aux", "com1", "lpt9"}


def test_labels_alike_get_folders_of_their_own():
    clip = (Clip(Path("/a.mp4")),)
    found = with_folders(
        [Experiment(label, clip) for label in ("a b", "a_b", "A b", "../a b", "con")], Path("m")
    )
    assert [e.folder for e in found] == ["a_b", "a_b_2", "A_b_3", "a_b_4", "con_"]


def test_the_steps_of_a_case(tmp_path):
    clips = (
        Clip(Path("/f/casing.mp4"), "casing", 260.0),
        Clip(Path("/f/--force.mp4"), "rotor"),
        Clip(Path("/g/--force.mp4"), "rotor"),
    )
    case = with_folders([Experiment("-x", clips, surface="-s", inertia_rotor=1e-5)], tmp_path)
    steps = plan(case, tmp_path, Request(improve=True))
    assert [s.name for s in steps] == [
        "x/extract casing", "x/extract force", "x/extract force_2",
        "x/sync", "x/fit", "x/diagnose", "x/improve", "x/report",
    ]  # fmt: skip
    sync = steps[3]
    assert sync.needs == ("x/extract casing",)
    assert sync.needs_any == ("x/extract force", "x/extract force_2")
    assert {"--label=-x", "--surface=-s"} <= set(sync.words)
    assert all(s.output.is_relative_to(tmp_path / "x") for s in steps)
    assert [s.verb for s in plan(case, tmp_path, Request("sync"))] == ["extract"] * 3 + ["sync"]


def test_paths_of_a_study_are_relative_to_its_folder(write, tmp_path):
    text = STUDY.replace('file = "c.mp4"', 'file = "c.mp4"\nprofile = "profiles/c.toml"')
    text = text.replace('file = "r.mp4"', 'file = "/films/r.mp4"\nprofile = "/films/r.toml"')
    found = read_study(write("study.toml", text.replace("label", 'surface = "PVC"\nlabel')))
    assert found.clips == (
        Clip(tmp_path / "c.mp4", "casing", 100, tmp_path / "profiles/c.toml"),
        Clip(Path("/films/r.mp4"), "rotor", None, Path("/films/r.toml")),
    )
    assert (found.label, found.surface, found.inertia_rotor, found.inertia_casing) == (
        "noted", "PVC", None, "2e-06"
    )  # fmt: skip
    assert [c.profile for c in read_study(write("study.toml", STUDY)).clips] == [None, None]


def test_values_of_a_manifest_replace_those_of_a_study_and_of_the_defaults(write, tmp_path):
    write("study.toml", STUDY)
    text = """
[defaults]
casing_fps = 260
rotor_fps = 900
surface = "glass"
profile = "all.toml"
inertia_rotor = 5e-5

[[case]]
study = "study.toml"
label = "other"
inertia_casing = 3e-6

[[case]]
casing = "c.mp4"
rotor = ["r.mp4"]
casing_fps = 100
profile = "own.toml"

[[case]]
casing = "c.mp4"
rotor = ["r.mp4"]
label = "usual"
surface = "PVC"

[[clip]]
file = "wheel.mp4"
"""
    noted, own, usual, wheel = read_manifest(write("m.toml", text))
    assert (noted.label, noted.surface, noted.inertia_rotor, noted.inertia_casing) == (
        "other", "", "5e-05", "3e-06",
    )  # fmt: skip
    assert (own.label, own.surface) == ("case 2", "glass")
    assert [(c.capture_fps, c.profile.name) for c in own.clips] == [(100, "own.toml"), (900, "own.toml")]
    assert [(c.capture_fps, c.profile) for c in usual.clips] == [
        (260, tmp_path / "all.toml"), (900, tmp_path / "all.toml"),
    ]  # fmt: skip
    assert usual.surface == "PVC"
    assert wheel.clips == (Clip(tmp_path / "wheel.mp4", "", None, tmp_path / "all.toml"),)


def test_folders_of_equal_names_are_numbered():
    taken = set()
    assert [unique_name(x, taken) for x in ("a b", "a_b", "A/B", "con")] == ["a_b", "a_b_2", "A_B_3", "con_"]
    assert taken == {"a_b", "a_b_2", "a_b_3", "con_"}


@pytest.mark.parametrize(
    ("own", "given", "skip", "found"),
    [
        ("2e-5", "3e-5", (), "2e-5"),
        (None, "3e-5", (), "3e-5"),
        (None, None, ("--inertia-rotor",), None),
        (None, None, ("--inertia-casing",), "refused"),
    ],
)
def test_the_inertia_of_a_case_has_priority(own, given, skip, found):
    clips = (Clip(Path("c"), "casing"), Clip(Path("r"), "rotor"))
    case = Experiment("x", clips, inertia_rotor=own, inertia_casing="1e-6")
    options = {"rotor": given, "casing": None}
    if found == "refused":
        with pytest.raises(UsageError, match="of the rotor of the case 'x' is not given"):
            with_inertias([case], options, skip)
    else:
        (made,) = with_inertias([case], options, skip)
        assert (made.inertia_rotor, made.inertia_casing) == (found, "1e-6")


def test_a_film_alone_or_a_case_file_needs_no_inertia():
    alone = Experiment("x", (Clip(Path("c"), ""),))
    stored = Experiment("y", (), data=Path("y.h5"))
    assert with_inertias([alone, stored], {"rotor": "3e-5", "casing": None}) == (alone, stored)
