"""The paper's tables on recordings made without `fitting`: which terms are on, and that each run is the fit."""

import csv
import io
import math
import re

import pytest
import twobody

from fitting import GENERAL, REDUCED, EstimationError, Model, make_record, scan, scan_lines
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.paper._scan import AIR, BEARING, COLUMNS, paper_ranges, shade
from fitting.paper._tables import (
    concise,
    scan_csv,
    scan_document,
    scan_latex,
    scan_records,
    three_digits,
)

pytestmark = pytest.mark.slow

CAMERAS = twobody.Cameras(span=60.0, windows=(2.0, 25.0, 50.0), window_length=2.0)


def case(label, seed, par, start):
    motion = twobody.simulate({**twobody.PAPER, **par}, start=start, span=60.0, seed=seed)
    return CaseData.of(make_record(**twobody.film(motion, seed=seed, cameras=CAMERAS, label=label)))


@pytest.fixture(scope="module")
def data():
    return [case("case_1", 61, {}, (900.0, 5.0)), case("case 2", 62, {"b1": 20e-6}, (850.0, 9.0))]


@pytest.fixture(scope="module")
def found(data):
    return scan(data)


def test_the_runs_are_those_of_the_paper():
    assert [" ".join(r.terms) for r in AIR] == [
        "a1 a2 b1 b2 d",
        "a2 b1 b2 d",
        "a1 b1 b2 d",
        "a1 a2 b2 d",
        "a1 a2 b1 d",
    ]
    choices = [frozenset(r.terms[3:]) for r in BEARING]
    assert len(choices) == len(set(choices)) == 15
    assert all(r.terms[:3] == ("a2", "b1", "b2") for r in BEARING)
    assert [len(c) for c in choices] == [4, 3, 3, 3, 3, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1]


def test_shades_have_the_thresholds_of_the_paper():
    shades = [shade(x) for x in (1.0, 0.99, 0.9899, 0.90, 0.899, 0.0, -1e-9, float("-inf"))]
    assert shades == ["white", "white", *["light gray"] * 2, "gray", "gray", "dark gray", "dark gray"]


@pytest.mark.release
def test_the_scan_has_every_run_for_every_case(found, data):
    assert found.labels == ("case_1", "case 2")
    assert [len(rows) for rows in (*found.air, *found.bearing)] == [5, 5, 15, 15]
    for label, rows in zip(found.labels * 2, (*found.air, *found.bearing), strict=True):
        for row in rows:
            assert row.fit is not None, row.fault
            assert row.fit.cases[0].label == label
            assert set(row.fit.model.names) == set(row.run.effects)


def test_a_row_is_the_fit_of_that_model(found, data):
    for i, run in ((0, 6), (1, 7), (1, 4)):
        row = found.bearing[i][run]
        alone = fit(Model.of(row.run.effects), [data[i]])
        assert row.r2 == pytest.approx(alone.cases[0].casing.r2, abs=1e-6)
        assert row.fit.deviance == pytest.approx(alone.deviance, abs=0.5)
        for key, e in alone.estimates.items():
            mine = row.fit.estimates[key]
            assert abs(mine.value - e.value) <= 0.05 * e.stderr if not e.at_bound else mine.at_bound


def test_the_true_model_is_the_best_run(found):
    for rows in found.bearing:
        best = min(rows, key=lambda row: row.fit.bic)
        assert best.run.terms == ("a2", "b1", "b2", "d", "f")
        # what contains the truth describes as well; no sum of whole powers does
        for row in rows:
            if {"d", "f"} <= set(row.run.terms):
                assert row.fit.verdict == "no_lack_of_fit", row.run
            if "f" not in row.run.terms:
                assert row.fit.verdict == "lack_of_fit", row.run


def test_a_model_is_never_worse_than_one_that_it_contains(found):
    for rows in (*found.air, *found.bearing):
        for outer in rows:
            for inner in rows:
                if set(inner.run.terms) < set(outer.run.terms):
                    assert outer.fit.deviance < inner.fit.deviance + 0.5, (outer.run, inner.run)


def test_a_bearing_of_constant_friction_alone_is_the_worst(found):
    """The paper's last row; b1 runs to 0 there as here."""
    for rows in found.bearing:
        assert rows[-1].run.terms[3:] == ("c",)
        assert rows[-1].r2 == min(row.r2 for row in rows)
        assert rows[-1].shade in {"gray", "dark gray"}
        assert rows[-1].fit.estimates["touchpoint.constant.b1"].value < 1e-6


@pytest.mark.slow
def test_models_separate_and_joint(found, data):
    reduced, general = found.models
    assert reduced.separate[0].model == Model.of(REDUCED)
    assert general.joint.model == Model.of(GENERAL)
    together = fit(Model.of(REDUCED), data)
    for key, e in together.estimates.items():
        assert abs(reduced.joint.estimates[key].value - e.value) < 0.3 * e.stderr
    assert found.converged


def test_the_general_model_keeps_to_the_papers_ranges(found):
    reduced, general = found.models
    for key, width in (("rotor.air.quadratic.a2", 0.2), ("bearing.linear.d", 0.5)):
        mean = sum(f.estimates[key].value for f in reduced.separate) / 2
        for f in (*general.separate, general.joint):
            assert (1 - width) * mean <= f.estimates[key].value <= (1 + width) * mean
    ranges = paper_ranges(reduced.separate, found.labels)
    assert set(ranges) >= {"casing.air.linear.b2", "casing.air.linear.b2@case_1", "bearing.power.g"}


def test_recordings_predicted_from_the_others(found):
    """Nothing but noise is left where both recordings have the same bearing."""
    for model in found.models:
        assert [p.label for p in model.predicted] == list(found.labels)
        for p in model.predicted:
            assert 0.95 < p.casing < 1.1
            assert p.r2 > 0.9999


def test_robustness_distinguishes_surface_and_bearing(found):
    table = {r.symbol: r for r in found.models[0].robustness}
    assert set(table) == {"a2", "b1", "b2", "d", "f", "g"}
    assert table["a2"].verdict == table["b2"].verdict == "robust"
    one, two = (f.estimates["touchpoint.constant.b1"].value for f in found.models[0].separate)
    assert table["b1"].spread == pytest.approx((two - one) / (0.5 * (one + two)))
    assert abs(table["b1"].shift) < 0.1
    assert table["b1"].verdict == "robust"
    assert table["a2"].sigma < 4 < table["b1"].sigma


def test_terminal_tables_fit_80_columns(found):
    lines = scan_lines(found)
    assert max(map(len, lines)) <= 80
    assert all(line.isascii() for line in lines)
    text = "\n".join(lines)
    assert "reduced model" in text
    assert "robustness of the general model" in text


def test_flat_table(found):
    rows = list(csv.DictReader(io.StringIO(scan_csv(found))))
    assert len(rows) == 2 * (5 + 15) + 2 * 4 == len(scan_records(found))
    best = next(r for r in rows if r["table"] == "bearing" and r["terms"] == "a2 b1 b2 d f")
    estimate = found.bearing[0][6].fit.estimates["rotor.air.quadratic.a2"]
    assert float(best["a2 [N m s2]"]) == estimate.value
    assert float(best["a2_stderr [N m s2]"]) == estimate.stderr
    assert best["e [N m s2]"] == best["held_out_recording"] == ""
    joint = [r for r in rows if r["fit"] == "joint"]
    assert {r["case"] for r in joint} == {"case_1", "case 2"}
    assert all(float(r["held_out_recording"]) > 0 for r in joint)


def test_latex_is_well_formed(found):
    text = scan_latex(found)
    assert text.count(r"\begin{table}") == text.count(r"\end{table}") == 2 * 2 + 2 * 3
    assert text.count("{") == text.count("}")
    assert r"case\_1" in text
    assert "case_1" not in re.sub(r"\\label\{.*?\}", "", text).replace(r"case\_1", "")
    for columns, body in re.findall(r"\\begin\{tabular\}\{(\w+)\}(.*?)\\end\{tabular\}", text, re.S):
        rows = [line for line in body.splitlines() if line.endswith(r"\\") and "multicolumn" not in line]
        assert len(rows) > 2
        assert {line.count("&") + 1 for line in rows} == {len(columns)}
    dark = next(line for line in text.splitlines() if r"\cellcolor{gray!" in line)
    assert dark.count(r"\cellcolor") in {6, 9}  # the whole row
    assert text.isascii()
    fit = found.models[0].separate[0]
    estimate = fit.estimates[COLUMNS["b1"].key]
    unit = 10.0 ** COLUMNS["b1"].exponent
    assert f"${concise(estimate.value / unit, estimate.stderr / unit)}$" in text


def test_the_document_contains_plain_numbers(found):
    document = scan_document(found)
    assert [t["table"] for t in document["tables"]] == ["air", "air", "bearing", "bearing"]
    rows = document["tables"][2]["rows"]
    assert min(r["delta_bic"] for r in rows) == 0
    assert rows[6]["fit"]["parameters"]["bearing.linear.d"]["unit"] == COLUMNS["d"].unit


@pytest.mark.slow
@pytest.mark.release
def test_one_case_has_no_joint_fit(data):
    alone = scan(data[:1])
    for model in alone.models:
        assert model.joint is None
        assert model.predicted == ()
        assert {r.verdict for r in model.robustness} <= {"not known", "zero", "not determined"}
    assert max(map(len, scan_lines(alone))) <= 80
    assert r"\midrule" in scan_latex(alone)


def test_labels_must_differ(data):
    with pytest.raises(EstimationError, match="different labels"):
        scan([data[0], data[0]])
    with pytest.raises(EstimationError):
        scan([])


@pytest.mark.parametrize(
    ("x", "text"),
    [
        (0.0, "0"),
        (0.04321, "0.0432"),
        (9.969, "9.97"),
        (11.0, "11.0"),
        (4080.4, "4080"),
        (13000.0, "13000"),
        (0.9996, "1.00"),
        (99.96, "100"),
        (3e-6, "~0"),
        (-2.5, "-2.50"),
        (math.nan, "-"),
        (1.234e7, "1.2e+07"),
    ],
)
def test_three_digits(x, text):
    assert three_digits(x) == text


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (9.97, 0.12, "9.97(12)"),
        (0.1263, 0.0041, "0.126(4)"),
        (4081.0, 120.0, "4080(120)"),
        (2.88, 0.0296, "2.88(3)"),
        (-1.0, 3.4, "-1(3)"),
        (0.999, 0.0999, "1.00(10)"),
        (1.32, math.nan, "1.32"),
        (0.0, 0.0, "0"),
    ],
)
def test_concise(value, error, text):
    assert concise(value, error) == text
