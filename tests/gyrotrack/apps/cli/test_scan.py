"""`gyrotrack scan` as a user runs it."""

import csv
import shutil

import pytest

from gyrotrack.apps.cli._app import run


@pytest.fixture(scope="module")
def scanned(simulated, tmp_path_factory, request):
    """One run on one case, with all outputs."""
    folder = tmp_path_factory.mktemp("scan")
    outputs = ["--csv", str(folder / "s.csv"), "--latex", str(folder / "s.tex")]
    with pytest.MonkeyPatch.context() as patch:
        said = []
        patch.setattr("gyrotrack.apps.cli._output._json", lambda document: said.append(document) or "")
        # a copy: other tests write a ledger beside the shared case
        source = shutil.copy(simulated / "plain.h5", folder)
        code = run(["scan", str(source), *outputs, "--json", "-q"])
    (document,) = said
    return code, document, folder


@pytest.mark.slow
def test_tables_files_and_document(scanned):
    code, document, folder = scanned
    assert code == 0
    assert [len(t["rows"]) for t in document["tables"]] == [5, 15]
    assert [m["name"] for m in document["models"]] == ["reduced", "general"]
    assert len(list(csv.reader((folder / "s.csv").read_text().splitlines()))) == 1 + 20 + 2
    assert (folder / "s.tex").read_text().startswith("% made by gyrotrack scan")


@pytest.mark.slow
def test_nothing_is_kept_and_nothing_replaced(scanned, simulated, gyrotrack):
    folder = scanned[2]
    assert not list(folder.glob("*.fits.json"))
    said = gyrotrack("scan", simulated / "plain.h5", "--csv", folder / "s.csv", "--json")
    assert said.code == 1
    assert "exists" in said.error["message"]


def test_two_names_for_one_case_are_refused(simulated, gyrotrack):
    said = gyrotrack("scan", simulated / "plain.h5", simulated / "plain.h5")
    assert said.code == 1
    assert "different labels" in said.err
