"""`certify` as a user runs it: rates, continuation, the report, a cluster."""

import json
import re

import numpy as np
import pytest

from gyrotrack.apps.cli._certify import _item, _Keeper
from gyrotrack.apps.workbench._server import Laboratory


@pytest.fixture(scope="module")
def wheel(tmp_path_factory, program):
    """A table of the speeds 80 exp(-t/60) - 4 t/60 rad/s with white noise: dry friction and viscous drag."""

    folder = tmp_path_factory.mktemp("wheel")
    t = np.arange(0, 30, 0.1)
    speed = 90 * np.exp(-t / 60) - 10 + np.random.default_rng(0).normal(0, 0.05, len(t))
    rows = "".join(f"{a:.4f},{b:.6f},0.05\n" for a, b in zip(t, speed, strict=True))
    (folder / "wheel.csv").write_text("t,omega,sigma\n" + rows, encoding="utf-8")
    case = folder / "wheel.h5"
    assert (
        program(["import", "--body", str(folder / "wheel.csv"), "--inertia", "2e-3", "-o", str(case), "-q"])
        == 0
    )
    assert program(["diagnose", str(case), "-q"]) == 0
    return case


@pytest.mark.slow
def test_rates_are_printed_stored_and_shown_in_the_report(gyrotrack, wheel, tmp_path):
    found = gyrotrack("certify", wheel, "-n", "2", "--workers", "1", "--json").json
    assert found["n"] == found["null"]["n"] == 2
    assert found["null"]["rate"] == found["null"]["alarms"] / 2
    assert 0 < found["p_empirical"] <= 1
    assert found["null"]["interval"][0] <= found["null"]["rate"] <= found["null"]["interval"][1]
    stored = json.loads(wheel.with_suffix(".fits.json").read_text())["fits"][0]["certificate"]
    assert len(stored["outcomes"]) == 2
    said = gyrotrack("certify", wheel, "-n", "2", "--workers", "1")
    assert said.code == 0
    assert "Of 2 simulated recordings" in said.out
    assert "  none, 2 recordings\n" in said.out
    # the workbench shows it when it opens the case
    laboratory = Laboratory.open(wheel, [])
    try:
        shown = laboratory.outcome("certificate")
        assert shown["state"] == "none"
        assert shown["document"]["sentence"] == found["sentence"]
    finally:
        laboratory.close()
    report = tmp_path / "report.html"
    assert gyrotrack("report", wheel, "-o", report, "-q").code == 0
    page = report.read_text(encoding="utf-8")
    assert "Tested on simulated recordings" in page
    assert "Of 2 simulated recordings" in page.replace("\u00a0", " ")


@pytest.mark.slow
def test_a_run_continues_where_it_was_interrupted(gyrotrack, wheel, monkeypatch):
    gyrotrack("certify", wheel, "-n", "2", "--workers", "1", "-q")
    from fitting.discovery import _certificate

    simulated = []
    original = _certificate._outcome

    def counted(work, item):
        simulated.append(item)
        return original(work, item)

    monkeypatch.setattr(_certificate, "_outcome", counted)
    assert gyrotrack("certify", wheel, "-n", "4", "--workers", "1", "-q").code == 0
    assert len(simulated) < 4
    assert gyrotrack("certify", wheel, "-n", "1", "--seed", "9", "--workers", "1", "-q").code == 0
    assert simulated[-1] == ("null", "", 0)


@pytest.mark.slow
def test_a_shorter_test_leaves_the_outcomes_of_a_longer_one(gyrotrack, wheel):
    long = gyrotrack("certify", wheel, "-n", "3", "--seed", "2", "--workers", "1", "--json").json
    short = gyrotrack("certify", wheel, "-n", "1", "--seed", "2", "--workers", "1", "--json").json
    assert (long["null"]["n"], short["null"]["n"]) == (3, 1)
    stored = json.loads(wheel.with_suffix(".fits.json").read_text())["fits"][0]["certificate"]
    assert (stored["n"], len(stored["outcomes"])) == (3, 3)
    assert [o["number"] for o in stored["outcomes"]] == [0, 1, 2]


@pytest.mark.slow
def test_diagnose_says_what_the_test_takes(gyrotrack, wheel):
    assert re.search(
        r"`gyrotrack certify \S+wheel.h5` tests this answer .*\(about .* (s|min|h)\)",
        (said := gyrotrack("diagnose", wheel).err),
    )
    assert "a candidate" not in said  # without -v


@pytest.mark.parametrize(
    ("words", "code"),
    [(["-n", "0"], 2), (["--workers", "0"], 2), (["--seed", "-1"], 2), (["--part", "null"], 2)],
)
def test_wrong_usage(gyrotrack, wheel, words, code):
    assert gyrotrack("certify", wheel, *words).code == code


def test_a_missing_case_is_one_sentence(gyrotrack, tmp_path):
    said = gyrotrack("certify", tmp_path / "no.h5", "--json")
    assert said.code == 1
    assert "does not exist" in said.error["message"]


def test_a_part_names_a_recording_of_a_world():
    assert _item("truth:casing: -k*omega_c**3:17") == ("truth", "casing: -k*omega_c**3", 17)
    assert _item("null::0") == ("null", "", 0)


class Kept:
    """A ledger that counts what it stores."""

    def __init__(self):
        self.stored = []

    def keep_certificate(self, fit_id, done):
        self.stored.append((fit_id, len(done.outcomes)))


class Notes:
    """Output that keeps its messages."""

    def __init__(self):
        self.said = []

    def note(self, text):
        self.said.append(text)


def test_duration_is_reported_once_and_outcomes_are_stored_from_time_to_time(monkeypatch):
    from fitting import Certificate
    from fitting.discovery._certificate import Outcome
    from gyrotrack.apps.cli import _certify

    clock = iter([0.0, 10.0, 21.0, 25.0, 45.0])
    monkeypatch.setattr(_certify, "monotonic", lambda: next(clock))
    ledger, notes = Kept(), Notes()
    keep = _Keeper(notes, lambda *_: None, ledger, "f1", Certificate(20, "adequate", (), 0.0, ()), ())
    outcomes = [Outcome("null", "", k, "adequate", (), 0.0, {}) for k in range(4)]
    for k in range(1, 5):
        keep(outcomes[:k], 20)
    assert notes.said == ["20 recordings are simulated and analysed; about 3 min left."]
    assert ledger.stored == [("f1", 2), ("f1", 4)]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the cluster's own libraries
@pytest.mark.release
def test_a_cluster_gives_the_same_outcomes(gyrotrack, wheel, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    here = gyrotrack("certify", wheel, "-n", "5", "--seed", "3", "--workers", "1", "--json").json
    gyrotrack("certify", wheel, "-n", "1", "--seed", "4", "--workers", "1", "-q")  # forgets the outcomes
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        words = ["-n", "5", "--seed", "3", "--scheduler", cluster.scheduler_address, "--json"]
        there = gyrotrack("certify", wheel, *words)
    assert there.code == 0
    assert there.json == here


def test_a_case_without_films_is_refused_before_anything_is_rendered(gyrotrack, wheel):
    said = gyrotrack("certify", wheel, "--film", "--json")
    assert said.code == 1
    assert "was not made from films" in said.error["message"]
    assert "--film" in said.error["hint"]


@pytest.mark.slow
def test_diagnose_lists_the_fits_of_its_search_with_v(gyrotrack, wheel):
    said = gyrotrack("diagnose", wheel, "-v")
    lines = [line for line in said.err.splitlines() if re.match(r"a candidate .*\(\+\S+", line)]
    assert len(lines) >= 4
    assert all("BIC" in line or "failed: " in line for line in lines)
