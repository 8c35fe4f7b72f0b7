"""Tables of parameters in words, and speeds in rpm."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import LIBRARY, Case, fit
from gyrotrack.apps.cli._output import diagnosis_tables, fit_tables, ladder_tables
from gyrotrack.apps.cli._parameters import key_beneath


@pytest.fixture(scope="module")
def found():
    t = np.linspace(0.0, 20.0, 201)
    speed = 40.0 * np.exp(-0.1 * t) + np.random.default_rng(1).normal(0.0, 0.02, len(t))
    case = Case.from_arrays(wheel={"t": t, "omega": speed, "u": 0.02, "inertia": 2e-3})
    return fit("air.linear", case)


def test_a_fit_names_effects_in_words_with_symbol_and_key(found):
    (text,) = fit_tables(found, "f1")
    lines = text.splitlines()
    at = lines.index("  linear air drag of the wheel")
    assert lines[at + 1].startswith("    b2 = (2.00")
    assert lines[at + 1].endswith("  air.linear.b2")
    assert all(len(line) < 80 for line in lines)
    assert any(line.startswith("wheel ") for line in lines)  # figures of merit of the body, by its name


def test_fit_and_history_show_the_same_misfit(found):
    (text,) = fit_tables(found, "f1")
    value = f"{found.misfit:.3g}"
    rows = sum(c.rows for c in found.cases)
    chi2 = sum(c.rows * c.chi2_per_row for c in found.cases)
    assert found.misfit == pytest.approx(math.sqrt(chi2 / rows))
    assert f"misfit {value} times the noise" in text
    (table,) = ladder_tables([_step("f1", found.bic, misfit=found.misfit)], found.problem.data[0].record)
    head, _, first, *_ = table.splitlines()
    assert first.split()[head.split().index("misfit")] == value


@pytest.mark.parametrize(
    ("verdict", "head", "mark"),
    [
        ("undecided", "largest unmodelled torques:", "^  largest"),
        ("unexplained", "significant lack of fit:", "^  lack of fit"),
    ],
)
def test_torques_of_an_undecided_answer_are_not_called_a_lack_of_fit(found, verdict, head, mark):
    failure = SimpleNamespace(
        label="wheel", called="wheel", body="casing", times=("1.0", "2.0"), t_start=1.0, t_stop=2.0,
        residual_torque_Nm=2e-6, residual_rad_s=0.1, size_sigma=5.0,
    )  # fmt: skip
    curve = SimpleNamespace(
        label="wheel", body="casing", time=np.linspace(0.0, 20.0, 50), torque=np.linspace(0.0, 2e-6, 50)
    )
    answer = SimpleNamespace(
        fit=found, verdict=verdict, sentence="A sentence.", failures=[failure], torques=[curve],
        candidates=[], differs=None, next_experiment="",
    )  # fmt: skip
    (text,) = diagnosis_tables(answer, "f1")
    lines = text.splitlines()
    assert head in lines
    assert any(line.endswith(mark) for line in lines)
    assert ("lack of fit" in text) == (verdict == "unexplained")


@pytest.mark.parametrize(
    ("verdict", "head"),
    [("adequate", "tested, not established:"), ("missing_effect", "candidate effects:")],
)
def test_a_significant_candidate_without_enough_evidence_is_not_called_insignificant(found, verdict, head):
    candidate = SimpleNamespace(
        effect=LIBRARY["casing.unbalance"], score=26.8, delta_bic=-7.0, p_value=0.007, physical=True, fit=None,
        significant=True, screened=SimpleNamespace(absorbed=False), indistinguishable_from=(),
    )  # fmt: skip
    answer = SimpleNamespace(
        fit=found, verdict=verdict, sentence="A sentence.", failures=[], torques=[],
        candidates=[candidate], differs=None, next_experiment="",
    )  # fmt: skip
    (text,) = diagnosis_tables(answer, "f1")
    assert head in text.splitlines()
    assert "not significant" not in text
    assert "0.007" in text


def _step(fit_id, bic, *, misfit=1.0, bic_noise=500.0):
    merits = {"rmse_casing": 0.1, "rmse_noise": 0.1, "held_out": 1.0, "misfit": misfit}
    return {
        "fit_id": fit_id, "added": "", "bic": bic, "bic_noise": bic_noise, "delta_bic": 0.0,
        "samples": 100, "n_eff": 90.0, **merits,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("second", "noise"), [(90.0, "802.0"), (110.0, "801.0"), (math.nan, "801.0"), (None, "801.0")]
)
def test_the_noise_of_a_history_is_that_of_the_fit_with_the_lowest_bic(found, second, noise):
    steps = [_step("f1", 100.0, bic_noise=801.0), _step("f2", second, bic_noise=802.0)]
    (table,) = ladder_tables(steps, found.problem.data[0].record)
    (row,) = (line for line in table.splitlines() if line.startswith("noise"))
    assert row.split()[4] == noise


def test_a_history_of_a_fit_that_was_stored_without_a_misfit_shows_a_dash(found):
    (table,) = ladder_tables([_step("f1", 100.0, misfit=math.nan)], found.problem.data[0].record)
    head, _, first, *_ = table.splitlines()
    assert first.split()[head.split().index("misfit")] == "-"


def test_speeds_are_printed_in_rpm_and_torques_as_before(found):
    from fitting._numbers import rounded, speed, speed_unit, speeds_in

    (plain,) = fit_tables(found, "f1")
    with speeds_in("rpm"):
        assert speed_unit() == "rpm"
        assert speed(math.pi / 30) == pytest.approx(1.0)
        assert rounded(10.0, 0.1, "rad/s") == "95.5 +- 1.0 rpm"
        assert rounded(10.0, 0.1, "rad s-1") == "95.5 +- 1.0 rpm"
        assert rounded(10.0, 0.1, "rad/s2") == "10.00 +- 0.10 rad/s2"
        (turning,) = fit_tables(found, "f1")
    assert speed_unit() == "rad/s"
    assert rounded(10.0, 0.1, "rad/s") == "10.00 +- 0.10 rad/s"
    assert "rmse [rad/s]" in plain
    assert "rmse [rpm]" in turning
    assert "rad" not in turning
    (drag,) = (line for line in plain.splitlines() if "air.linear.b2" in line)
    assert drag in turning


def test_rpm_may_be_given_before_and_after_the_command_and_documents_stay_in_si(gyrotrack, tmp_path):
    rows = "".join(f"{k / 10},{20 - k / 10}\n" for k in range(100))
    table = tmp_path / "wheel.csv"
    table.write_text("t [s],omega [rad/s]\n" + rows, encoding="utf-8")
    words = ("import", "--body", table, "--dry-run")
    assert "10.1 to 20.0" in gyrotrack(*words).out
    for said in (gyrotrack("--rpm", *words), gyrotrack(*words, "--rpm")):
        assert "speed [rpm]" in said.out
        assert "96.4 to 191.0" in said.out
    documents = [json.loads(gyrotrack(*words, "--json", *more).out) for more in ((), ("--rpm",))]
    assert documents[0] == documents[1]


def test_the_key_is_beneath_the_words_unless_it_is_the_same():
    assert key_beneath("law -k*t on the casing", "") == ["law -k*t on the casing"]
    assert key_beneath("a", "a") == ["a"]
    assert key_beneath("linear air drag", "air.linear") == ["linear air drag", "  (air.linear)"]


def test_the_name_of_a_body_is_stored_in_the_case_and_used_in_every_sentence(gyrotrack, tmp_path):
    rng = np.random.default_rng(2)
    rows = "".join(f"{k / 10},{20 * math.exp(-k / 100) + rng.normal(0, 0.01):.4f},0.01\n" for k in range(200))
    table, case = tmp_path / "run.csv", tmp_path / "run.h5"
    table.write_text("t,omega,sigma\n" + rows, encoding="utf-8")
    words = ("import", "--body", table, "--inertia", "2e-3", "-o", case)
    refused = gyrotrack(*words, "--body-name", "rotor")
    assert refused.code == 2
    assert "cannot be the name of a body" in refused.err
    assert "\nflywheel " in "\n" + gyrotrack(*words, "--body-name", "flywheel").out
    assert "\nflywheel " in gyrotrack("info", case).out
    said = gyrotrack("fit", case).out
    assert "air drag of the flywheel" in said
    assert "casing" not in said
    assert gyrotrack("import", "--casing", table, "--rotor", table, "--body-name", "x", "--dry-run").code == 2
