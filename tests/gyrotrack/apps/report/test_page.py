import base64
import hashlib
import html
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from fitting.discovery._select import Step
from gyrotrack import BodyTrack, Case, MarkerTrack, OutputError, Recording, Series, write_report
from gyrotrack.io._records import Placement

pytestmark = pytest.mark.slow  # the story of fits behind the page takes seconds

HOSTILE = "<script>alert(1)</script> $\\frac{$ & \"quoted\" 'single' \u202e\U0001f300"
_TAGS = """
html head meta title style body header main footer section nav ul li a h1 h2 h3 p strong span br sub code div
figure figcaption button details summary
table caption thead tbody tr th td dl dt dd svg g path use defs clippath rect pattern
script noscript h4 img wbr
"""


class _Page(HTMLParser):
    """Tags, attributes and text of a page, as a browser would see them."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes, self.texts = [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, k, v or "") for k, v in attrs]

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def text(self):
        return " ".join(self.texts)

    def values(self, name):
        return [v for _, k, v in self.attributes if k == name]


@pytest.fixture(scope="module")
def page(story, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, story.rungs, story.diagnosis, provenance={"command": "gyrotrack report run.h5"})
    return path.read_text("utf-8")


def test_page_is_whole_and_needs_nothing_else(page):
    seen = _Page(page)
    assert len(page) < 3e6
    assert not {"link", "iframe", "object", "embed", "base", "img", "form"} & set(seen.tags)
    assert all(v.startswith("#") for v in [*seen.values("href"), *seen.values("xlink:href")])
    assert not [k for _, k, _ in seen.attributes if k.startswith("on") or k == "src"]
    assert "@import" not in page
    assert all(u.startswith("#") for u in re.findall(r"url\(([^)]*)\)", page))


def _scripts(page):
    return re.findall(r"<script>(.*?)</script>", page, re.DOTALL)


def test_only_the_scripts_of_the_program_may_run(page):
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1])
    assert "default-src 'none'" in policy
    assert "unsafe-inline" not in policy.split("script-src")[1].split(";")[0]
    hashes = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in _scripts(page)]
    assert [f"'sha256-{h}'" in policy for h in hashes] == [True, True, True]
    assert _Page(page).tags.count("script") == 4


def test_boards_carry_every_plot_against_time(page, story):
    data = re.search(r'<script type="application/json" id="dashboards">(.*?)</script>', page, re.DOTALL)[1]
    (board,) = json.loads(data)
    assert [c["name"] for c in board["charts"]] == [
        "speed", "residual-casing", "torque-speed", "torque-casing", "torque-rotor", "rotor", "residual-rotor",
        "normalised", "energy",
    ]  # fmt: skip
    assert all(c["finding"] and c["unit"] for c in board["charts"])
    assert len(board["intervals"]) >= len(story.diagnosis.failures) >= 1
    for chart in board["charts"]:
        # laws of candidates, which go far outside the windows, have no influence on the scale
        assert {t["label"] for t in chart["traces"] if t["scale"] == "none"}.isdisjoint(
            {"base model", "final model"}
        )
    assert [t["scale"] for t in board["charts"][4]["traces"]][:3] == ["normal", "normal", "none"]
    measured = board["charts"][0]["traces"][0]
    assert measured["scale"] == "reference"
    # all measured points, except the ends that the smoothing drops
    assert measured["value"]["count"] == len(story.record.casing) - 100


def test_ids_are_unique_and_references_resolve(page):
    ids = _Page(page).values("id")
    assert len(ids) == len(set(ids))
    wanted = {u[1:] for u in re.findall(r"url\((#[^)]*)\)", page)}
    wanted |= {v[1:] for v in [*_Page(page).values("href"), *_Page(page).values("xlink:href")]}
    assert wanted <= set(ids)


def test_every_drawing_has_a_text_alternative(page):
    seen = _Page(page)
    assert seen.tags.count("svg") == seen.values("role").count("img")
    labels = [v for tag, k, v in seen.attributes if tag == "svg" and k == "aria-label"]
    assert len(labels) == seen.tags.count("svg")
    assert all(labels)
    assert seen.tags.count("figure") == seen.tags.count("figcaption") >= 7


def test_page_tells_the_story(page):
    text = _Page(page).text.replace("\u00a0", " ")
    for words in (
        "Missing: quadratic air drag of the casing",
        "casing.air.quadratic",
        "The final model has no significant lack of fit.",
        "times the noise: misfit of the model",
        "N m s²",
        "Lack of fit of the base model",
        "Upper limits",
        "gyrotrack report run.h5",
    ):
        assert words in text
    # the value found is the true one, 3e-10, rounded with its error
    value, error = re.search(r"with k = \(([\d.]+) ± ([\d.]+)\) × 10⁻¹⁰", text).groups()
    assert abs(float(value) - 3) < 4 * float(error)


def test_page_does_not_change_from_run_to_run(story, page, tmp_path):
    write_report(
        tmp_path / "again.html",
        story.rungs,
        story.diagnosis,
        provenance={"command": "gyrotrack report run.h5"},
    )
    assert (tmp_path / "again.html").read_text("utf-8") == page


def _hostile(story):
    record = replace(story.record, label=HOSTILE, surface=HOSTILE)
    rungs = []
    for rung in story.rungs:
        effects = tuple(
            replace(e, name=HOSTILE, words="", signature=HOSTILE) if e.name == "casing.air.quadratic" else e
            for e in rung.fit.model.effects
        )
        data = tuple(replace(d, record=record) for d in rung.fit.problem.data)
        problem = _shallow(rung.fit.problem, data=data)
        model = replace(rung.fit.model, effects=effects)
        rungs.append(Step(rung.change and f"+{HOSTILE}", replace(rung.fit, model=model, problem=problem), ()))
    candidates = tuple(
        replace(c, effect=replace(c.effect, name=HOSTILE + c.effect.name, words=""))
        for c in story.diagnosis.candidates
    )
    diagnosis = replace(
        story.diagnosis,
        sentence=HOSTILE,
        next_experiment=HOSTILE,
        candidates=candidates,
        failures=tuple(replace(f, label=HOSTILE, body=HOSTILE) for f in story.diagnosis.failures),
        torques=tuple(replace(t, label=HOSTILE) for t in story.diagnosis.torques),
    )
    return rungs, replace(diagnosis, fit=rungs[0].fit)


def _shallow(thing, **changes):
    other = object.__new__(type(thing))
    other.__dict__.update({**thing.__dict__, **changes})
    return other


def _case():
    n = 20
    ones, two = np.ones(n), np.ones((n, 2))
    status = np.array([0] * 17 + [2, 4, 4], dtype=np.int8)
    marker = MarkerTrack(HOSTILE, "rotor", 0.0, np.ones((n, 2, 2)), *[ones] * 8, status, ones, ones)
    body = BodyTrack("rotor", ones, ones, 2e-3 * ones, ones, np.ones(n, dtype=np.int64), ones, ones, 51)
    clip = Recording(
        HOSTILE, "ab" * 32, 640, 480, 1000.0, 25.0, 22, n, 1, "rotor", np.arange(n), ones, ones, two, ones,
        {HOSTILE: marker}, {"rotor": body}, (HOSTILE,),
    )  # fmt: skip
    placement = Placement("r1", 70.0123, 0.0004, 1.0, 0.0, 0.0, True, "matching")
    series = Series(ones, ones, ones, ones, ones, np.ones(n, dtype=np.int64))
    return Case(5e-5, 2e-5, HOSTILE, HOSTILE, series, series, {"r1": clip}, {"r1": placement})


def test_names_from_files_appear_as_text(story, tmp_path):
    rungs, diagnosis = _hostile(story)
    path = write_report(
        tmp_path / "hostile.html", rungs, diagnosis, recordings=[_case()], provenance={HOSTILE: HOSTILE}
    )
    seen = _Page(path.read_text("utf-8"))
    assert seen.tags.count("script") == 4
    assert not any("alert(1)" in s for s in _scripts(path.read_text("utf-8")))
    assert set(seen.tags) <= set(_TAGS.split())
    # title, heading, surface, sentence, next experiment, effect, clip, marker, warning, provenance ...
    assert seen.text.count(HOSTILE) > 10
    assert not [k for _, k, _ in seen.attributes if k.startswith("on")]


def test_names_from_files_do_not_stop_the_pdf(story, tmp_path):
    rungs, diagnosis = _hostile(story)
    where = {HOSTILE: '#panic() #import "x" $ * _ \udcff'}
    path = write_report(tmp_path / "hostile.pdf", rungs, diagnosis, recordings=[_case()], provenance=where)
    assert path.read_bytes().startswith(b"%PDF-")
    assert [p.name for p in tmp_path.iterdir()] == ["hostile.pdf"]


def test_one_fit_alone_makes_a_report(story, tmp_path):
    path = write_report(tmp_path / "one.html", story.rungs[:1], None, recordings=[_case()])
    text = " ".join(_Page(path.read_text("utf-8")).text.split())
    assert "Final model" not in text
    assert "Unexplained torque" in text
    # of a model with a lack of fit there are no limits
    assert "Upper limits" not in text
    # and the tracking behind it
    assert "85 % ok, 5 % occluded, 10 % lost" in text
    assert "rotor: 2.0 mrad" in text
    assert "70.0123 ± 0.0004 s" in text
    assert "yes: the start is not unique" in text
    assert "2 of 22 not decoded" in text


def test_an_existing_file_is_kept_unless_forced(story, tmp_path):
    path = tmp_path / "report.html"
    path.write_text("mine")
    with pytest.raises(OutputError, match="already exists"):
        write_report(path, story.rungs, story.diagnosis)
    assert path.read_text() == "mine"
    write_report(path, story.rungs[:1], None, force=True)
    assert path.read_text("utf-8").startswith("<!DOCTYPE html>")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
