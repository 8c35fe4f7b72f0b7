"""The paper's figures and tables of a study of two cases."""

import json
import re

import pytest

from gyrotrack.apps.cli._app import run
from gyrotrack.apps.report._paper import FORMATS

OPTIONS = "--duration 40 --casing-fps 40 --rotor-fps 200 --window 3 --window 30 --sigma 1e-3 --json -q"
NAMES = {"angular-positions", "rotor-data", "rotor-fits", "casing-fits", "residuals", "energy"}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    cases = []
    for seed, b1 in ((1, "3e-6"), (2, "4e-5")):
        cases.append(str(folder / f"case{seed}.h5"))
        words = f"--seed {seed} --set touchpoint.constant.b1={b1} --label case_{seed} {OPTIONS}"
        assert run(["simulate", "-o", cases[-1], *words.split()]) == 0
    target = folder / "figures"
    formats = [w for f in FORMATS for w in ("--format", f)]
    assert run(["figures", *cases, "-o", str(target), *formats, "--json", "-q"]) in (0, 3)
    return cases, target


@pytest.mark.release
@pytest.mark.slow
def test_every_figure_is_there_in_every_format(study):
    _, target = study
    heads = {"pdf": b"%PDF-", "png": b"\x89PNG", "svg": b"<?xml"}
    for name in NAMES:
        for kind, head in heads.items():
            assert (target / f"{name}.{kind}").read_bytes().startswith(head)
    text = (target / "figures.tex").read_text()
    assert set(re.findall(r"\\includegraphics\[[^]]*\]\{([^}]*)\}", text)) == NAMES
    # a film is needed for the first figure of the paper
    assert not list(target.glob("gyroscope*"))


@pytest.mark.slow
def test_the_papers_eight_tables_are_there(study):
    _, target = study
    whole = (target / "tables.tex").read_text()
    each = sorted(target.glob("table-*.tex"))
    assert len(each) == whole.count(r"\begin{table}") >= 8
    for path in each:
        text = path.read_text()
        assert text.count(r"\begin{table}") == text.count(r"\end{table}") == 1
        assert text[text.index(r"\begin{table}") :].strip() in whole
    names = " ".join(p.name for p in each)
    for part in ("air-case", "bearing-case", "reduced-metrics", "general-metrics"):
        assert part in names


def test_what_is_there_is_kept_and_wrong_formats_are_refused(tmp_path, capsys):
    (tmp_path / "tables.tex").write_text("mine")
    assert run(["figures", "no.h5", "-o", str(tmp_path), "--json"]) == 1
    assert "--force" in json.loads(capsys.readouterr().out)["error"]["hint"]
    assert run(["figures", "no.h5", "--format", "gif", "--json"]) == 2
    assert "gif" in json.loads(capsys.readouterr().out)["error"]["message"]
    assert (tmp_path / "tables.tex").read_text() == "mine"
