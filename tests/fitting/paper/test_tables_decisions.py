"""Cells, marks, blocks and records of the tables of a scan, from fits of known values."""

import csv
import io
import math
from types import SimpleNamespace

import pytest

from fitting import Estimate
from fitting.paper import _tables as module
from fitting.paper._scan import AIR, BEARING, COLUMNS, ModelFits, Robustness, Row, Run, Scan
from fitting.paper._tables import scan_csv, scan_document, scan_latex, scan_lines, scan_records

A2, B1, D, G = (COLUMNS[s].key for s in ("a2", "b1", "d", "g"))
UNIT = {s: 10.0**c.exponent for s, c in COLUMNS.items()}


def metrics(label, r2=0.995, rotor=0.9999, energy=0.012):
    body = SimpleNamespace(r2=r2, rmse=0.125, reduced_chi2=1.5, held_out=1.25)
    other = SimpleNamespace(r2=rotor, rmse=0.5, reduced_chi2=2.5, held_out=2.25)
    return SimpleNamespace(label=label, casing=body, rotor=other, misfit=1.75, energy_drift=energy)


def fit(values=(), *, bic=0.0, labels=("a",), r2=0.995, verdict="adequate", keys=None):
    """A fit of (value, standard error, at bound) by the name of the parameter, in units of the table's header."""
    made = {}
    for name, (value, error, *bound) in dict(values).items():
        symbol = next(s for s, c in COLUMNS.items() if c.key == name.partition("@")[0])
        made[name] = Estimate(value * UNIT[symbol], error * UNIT[symbol], "1", at_bound=bool(bound))
    parameters = keys if keys is not None else dict.fromkeys(n.partition("@")[0] for n in made)
    return SimpleNamespace(
        estimates=made, bic=bic, verdict=verdict, labels=labels, cases=[metrics(x, r2) for x in labels],
        model=SimpleNamespace(parameters=parameters),
    )  # fmt: skip


BASE = {A2: (3.5, 0.5), B1: (0.0432, 0.001), D: (2.5, 3.5)}


class TestRuns:
    """Rows of one table; the second one has the smallest BIC."""

    ROWS = (
        Row(AIR[0], fit(BASE, bic=-3.5, r2=0.95)),
        Row(AIR[1], fit({A2: (3.5, 0.5, True)}, bic=-5.0)),
        Row(AIR[2], fit(BASE, bic=1995.0, r2=0.5, verdict="not_converged")),
        Row(AIR[3], fit(BASE, bic=-5.0 + 2e6, r2=-123.4)),
        Row(AIR[4], None, "no bounded solution " * 9),
    )

    def test_values_are_in_units_of_the_header_with_marks(self):
        head, scales, *rows = module._runs(self.ROWS, ("a1", "a2", "b1", "d"))
        assert head.split() == ["a1", "a2", "b1", "d", "R2", "dBIC"]
        assert scales.split() == ["1e-11", "1e-11", "1e-6", "1e-7"]
        assert rows[0] == "      -    3.50  0.0432    2.50? 0.95000.   1.5"
        assert rows[1] == "      -    3.50*      -       -  0.99500    0.0"
        assert rows[2].endswith(" 0.50000:  2000!")
        assert rows[3].endswith("-1.2e+02# 2e+06")
        assert rows[4] == f"  {' '.join(AIR[4].terms)}: no fit, {'no bounded solution ' * 9}"[:80]

    def test_without_a_fit_no_row_is_the_best(self):
        assert len(module._runs([Row(AIR[0], None, "x")], ("a1",))) == 3

    @pytest.mark.parametrize(
        ("bound", "value", "error", "mark"),
        [(True, 1.0, 2.0, "*"), (False, -1.0, 1.1, "?"), (False, -1.0, 0.9, " "), (False, 1.0, 1.0, " ")],
    )
    def test_marks(self, bound, value, error, mark):
        assert module._mark(Estimate(value, error, "1", at_bound=bound)) == mark

    @pytest.mark.parametrize(
        ("x", "text"),
        [(-12.34, "-12.3"), (999.0, "999.0"), (-1001.0, "-1001"), (999e3, "999000"), (-2e6, "-2e+06")],
    )
    def test_differences_of_bic_are_short(self, x, text):
        assert module._short(x) == text

    def test_in_latex_a_row_without_a_fit_spans_all_columns(self):
        head, rule, *rows = module._latex_runs(self.ROWS, ("a1", "a2", "b1", "d", "g"))
        assert head.count("&") == 5
        assert head.startswith(r"$a_1\,(10^{-11})$ & $a_2\,(10^{-11})$ & $b_1\,(10^{-6})$")
        assert head.endswith(r"$g$ & $R^2$ \\")
        assert rule == r"\midrule"
        assert rows[0].count(r"\cellcolor{gray!25}") == 6
        assert rows[1] == r"$0$ & $3.50$ & $0$ & $0$ & $0$ & $0.995$ \\"
        assert rows[2].count(r"\cellcolor{gray!50}") == 6
        assert rows[3].count(r"\cellcolor{gray!75}") == 6
        assert rows[4] == rf"\multicolumn{{6}}{{l}}{{{' '.join(AIR[4].terms)}: no fit}} \\"

    @pytest.mark.parametrize(
        ("value", "text"),
        [(0.0, "$0$"), (0.9e-4, r"$\approx 0$"), (-0.9e-4, r"$\approx 0$"), (1.1e-4, "$0.000110$")],
    )
    def test_in_latex_small_values_are_nearly_zero(self, value, text):
        assert module._value(Estimate(value * UNIT["a2"], 0.0, "1", at_bound=False), "a2") == text

    def test_in_latex_values_have_errors_in_the_last_digit(self):
        e = Estimate(3.5 * UNIT["a2"], 0.12 * UNIT["a2"], "1", at_bound=False)
        assert module._with_error(e, "a2") == "$3.50(12)$"
        assert module._with_error(None, "a2") == "$0$"
        assert (
            module._with_error(Estimate(1e-5 * UNIT["a2"], 0.0, "1", at_bound=False), "a2") == r"$\approx 0$"
        )


def model(joint=True, labels=("a", "b")):
    separate = tuple(fit({A2: (1.0 + i, 0.1), B1: (5.0, 0.2)}, labels=(x,)) for i, x in enumerate(labels))
    both = fit({A2: (1.5, 0.1), **{f"{B1}@{x}": (7.0 + i, 0.3) for i, x in enumerate(labels)}}, labels=labels)
    predicted = tuple(SimpleNamespace(label=x, casing=1.5 + i) for i, x in enumerate(labels))
    return ModelFits(
        "reduced", separate, both if joint else None, predicted if joint else (),
        (Robustness("a2", A2, "N m s2", 1.5e-11, 2 / 3, -0.25, 12.34, "unstable"),),
    )  # fmt: skip


class TestModels:
    def test_separate_fits_are_above_the_joint_fit(self):
        lines = module._model(model(), ("a", "b"))
        assert lines[:3] == [
            "reduced model: separate fits, then the joint fit",
            "case     a2      b1",
            "      1e-11    1e-6",
        ]
        assert [x.split() for x in lines[3:5]] == [["a", "1.00", "5.00"], ["b", "2.00", "5.00"]]
        assert lines[5] == "-" * (4 + 8 * 2)
        assert [x.split() for x in lines[6:8]] == [["a", "1.50", "7.00"], ["b", "1.50", "8.00"]]
        assert [x.split()[-2] for x in lines[10:12]] == [
            "1.25",
            "1.25",
        ]  # not predicted from other recordings
        assert set(lines[12]) == {"-"}
        assert [x.split() for x in lines[13:15]] == [
            ["a", "0.999900", "0.995000", "0.125", "1.75", "1.25", "1.5", "1.2e-02"],
            ["b", "0.999900", "0.995000", "0.125", "1.75", "1.25", "2.5", "1.2e-02"],
        ]
        assert lines[16] == "robustness of the reduced model's parameters across the cases"
        assert lines[18].split() == [
            "a2",
            "1.500e-11",
            "N",
            "m",
            "s2",
            "67",
            "%",
            "-25",
            "%",
            "12.3",
            "unstable",
        ]

    def test_a_single_case_has_no_joint_fit(self):
        lines = module._model(model(joint=False, labels=("a",)), ("a",))
        assert lines[0] == "reduced model"
        assert not any(set(x) == {"-"} for x in lines)
        assert not any("robustness" in x for x in lines)

    @pytest.mark.parametrize(
        ("share", "text"),
        [
            (0.9e-4, "< 0.01 %"),
            (1.1e-4, "0.011 %"),
            (-0.9e-4, "< 0.01 %"),
            (0.999, "1e+02 %"),
            (-0.123, "-12 %"),
            (1.234, "123 %"),
            (math.inf, ""),
            (math.nan, ""),
        ],
    )
    def test_shares_are_in_percent(self, share, text):
        assert module._percent(share) == text

    @pytest.mark.parametrize(("sigma", "text"), [(math.nan, None), (99999.0, "99999.0"), (100001.0, "1e+05")])
    def test_differences_in_standard_errors(self, sigma, text):
        row = Robustness("g", G, "1", 1.0, math.nan, math.nan, sigma, "not known")
        words = module.robustness_lines([row])[1].split()
        assert words == ["g", "1.000e+00", "1", *([text] if text else []), "not", "known"]

    def test_in_latex_shared_values_span_the_cases(self):
        head, _rule, *rows = module._parameters(model(), ("a", "b"), ["a2", "b1"])
        assert head == r" & $a_2\,(10^{-11})$ & $b_1\,(10^{-6})$ \\"
        assert rows == [
            r"a & $1.00(10)$ & $5.00(20)$ \\",
            r"b & $2.00(10)$ & $5.00(20)$ \\",
            r"\midrule",
            r"a & \multirow{2}{*}{$1.50(10)$} & $7.0(3)$ \\",
            r"b &  & $8.0(3)$ \\",
        ]

    def test_in_latex_figures_of_merit_of_each_fit(self):
        _head, _rule, *rows = module._latex_metrics(model(), ("a", "b"))
        merits = r"$0.9999$ & $0.9950$ & $1.5$ & $1.25$ & $1.2\,\%$ \\"
        assert rows == [
            rf"Fit 1 & a & {merits}",
            rf"Fit 2 & b & {merits}",
            r"\midrule",
            rf"\multirow{{2}}{{*}}{{Fit 3}} & a & {merits}",
            rf" & b & {merits}",
        ]
        assert module._merits(metrics("x_1", r2=0.5))[:3] == [
            r"x\_1", "$0.9999$", r"\cellcolor{gray!50}$0.5000$"
        ]  # fmt: skip

    def test_in_latex_robustness(self):
        (row,) = module._robustness(model().robustness)[2:]
        assert row == r"$a_2\,(10^{-11})$ & $1.50$ & $66.7\,\%$ & $-25.0\,\%$ & $12.3$ & unstable \\"
        unknown = Robustness("g", G, "1", 0.0, math.nan, math.inf, math.inf, "zero")
        assert module._robustness([unknown])[2] == r"$g$ & $0$ &  &  &  & zero \\"

    @pytest.mark.parametrize(
        ("x", "text"),
        [
            (99999.0, "1e+05"),
            (1234.56, "1235"),
            (123456.0, r"1.23\times 10^{5}"),
            (-2e6, r"-2.00\times 10^{6}"),
        ],
    )
    def test_in_latex_large_numbers_have_powers_of_ten(self, x, text):
        assert module._four(x) == text


def made(joint=True):
    labels = ("a", "b") if joint else ("a",)
    air = tuple(tuple(Row(r, fit(BASE, bic=7.0 + i, labels=(x,))) for i, r in enumerate(AIR)) for x in labels)
    bearing = tuple(tuple(Row(r, None, "no solution") for r in BEARING) for _ in labels)
    return Scan(labels, air, bearing, (model(joint, labels),))


class TestWhole:
    def test_latex_has_two_tables_a_case_and_three_a_model(self):
        text = scan_latex(made())
        assert text.count(r"\begin{table}") == 4 + 3
        assert [k in text for k in ("scan-air-b", "scan-bearing-a", "{tab:reduced-robustness}")] == [True] * 3
        assert scan_latex(made(joint=False)).count(r"\begin{table}") == 2 + 2
        assert "Fit metrics of the reduced model: separate fits, then the joint fit." in text
        assert "Fit metrics of the reduced model." in scan_latex(made(joint=False))

    def test_lines_begin_with_the_tables_of_each_case(self):
        lines = scan_lines(made())
        assert [x for x in lines if ": which" in x] == [
            "a: which drags are needed (bearing: d alone)",
            "a: which laws of the bearing are needed (no a1)",
            "b: which drags are needed (bearing: d alone)",
            "b: which laws of the bearing are needed (no a1)",
        ]

    def test_records_are_one_per_fit(self):
        found = scan_records(made())
        assert [(r["table"], r["fit"], r["case"]) for r in found] == [
            *(("air", "separate", x) for x in "ab" for _ in AIR),
            *(("bearing", "separate", x) for x in "ab" for _ in BEARING),
            *(("reduced", kind, x) for kind in ("separate", "joint") for x in "ab"),
        ]
        first, failed, joint = found[0], found[10], found[-1]
        assert (first["terms"], first["verdict"], first["fault"]) == ("a1 a2 b1 b2 d", "adequate", "")
        assert (first["a2"], first["a2_stderr"]) == (3.5 * UNIT["a2"], 0.5 * UNIT["a2"])
        assert (first["a1"], first["a1_stderr"]) == (None, None)
        assert (first["r2_casing"], first["r2_rotor"], first["rmse_rotor"]) == (0.995, 0.9999, 0.5)
        assert (first["reduced_chi2_casing"], first["held_out_rotor"]) == (1.5, 2.25)
        assert (first["held_out_recording"], first["energy_drift"], first["bic"]) == (None, 0.012, 7.0)
        assert first["shade"] == "white"
        assert (failed["verdict"], failed["fault"], failed["a2"], failed["bic"]) == (
            "no fit", "no solution", None, None
        )  # fmt: skip
        assert set(failed) == set(first)
        assert (joint["terms"], joint["held_out_recording"], joint["b1"]) == ("a2 b1", 2.5, 8.0 * UNIT["b1"])
        assert found[-3]["held_out_recording"] is None

    def test_an_unknown_error_is_missing(self):
        f = fit({A2: (3.5, math.nan)})
        assert module._numbers(f, "a", math.nan)["a2_stderr"] is None

    def test_the_exponent_is_not_a_term(self):
        f = fit({G: (1.2, 0.1), COLUMNS["f"].key: (1.0, 0.1)})
        (found,) = module._fits(ModelFits("general", (f,), None, (), ()), ("a",))
        assert found["terms"] == "f"

    def test_the_header_of_csv_has_units(self):
        head, *rows = csv.reader(io.StringIO(scan_csv(made())))
        assert head[4:8] == ["a1 [N m s]", "a1_stderr [N m s]", "a2 [N m s2]", "a2_stderr [N m s2]"]
        assert {"g", "rmse_casing [rad s-1]", "r2_casing", "bic"} <= set(head)
        assert len(rows) == 2 * 20 + 4

    @pytest.mark.parametrize("joint", [True, False])
    def test_the_document_has_differences_to_the_best_row(self, monkeypatch, joint):
        monkeypatch.setattr(module, "fit_document", lambda f, name: None)
        monkeypatch.setattr(module, "as_document", lambda kind, thing, **more: more)
        monkeypatch.setattr(
            module, "PredictedDocument",
            SimpleNamespace(model_validate=lambda p: SimpleNamespace(model_dump=lambda: p.casing)),
        )  # fmt: skip
        found = scan_document(made(joint))
        count = 2 if joint else 1
        assert found["cases"] == ["a", "b"][:count]
        assert [(t["table"], t["case"]) for t in found["tables"]] == [
            (name, x) for name in ("air", "bearing") for x in "ab"[:count]
        ]
        assert [r["delta_bic"] for r in found["tables"][0]["rows"]] == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert {(r["delta_bic"], r["r2"]) for r in found["tables"][-1]["rows"]} == {(None, None)}
        assert found["tables"][0]["rows"][0]["model"] == list(AIR[0].effects)
        assert found["models"][0]["predicted"] == ([1.5, 2.5] if joint else [])
        assert found["models"][0]["robustness"][0]["shift"] == -0.25


def test_effects_of_a_run_are_those_of_its_terms():
    assert Run(("a2", "f")).effects == ("rotor.air.quadratic", "bearing.power")
    assert len(BEARING) == 15
    assert len(set(BEARING)) == 15
