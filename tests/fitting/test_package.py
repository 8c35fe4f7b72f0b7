"""The package in a notebook: imports, results that are printed, tabulated and saved."""

import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import twobody
from cases import data, fitted

import fitting
from fitting import EffectError, EstimationError, LedgerError, Model, fit, load_fit, make_record
from gyrotrack.apps.cli._app import run

ROOT = Path(__file__).parents[2]
BLOCK = """
import importlib.abc, sys
class Wall(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked!r}:
            raise ImportError(name + " is walled off")
sys.meta_path.insert(0, Wall())
"""


def python(code, *blocked):
    """Run code in a process of its own, without some packages."""
    text = (BLOCK.format(blocked=set(blocked)) if blocked else "") + code
    return subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, cwd=ROOT, check=False)


@pytest.mark.slow
def test_the_package_needs_neither_films_nor_terminals():
    done = python(
        "from fitting import *\nimport fitting\nassert all(hasattr(fitting, n) for n in fitting.__all__)",
        "cv2", "av", "typer", "rich", "gyrotrack", "matplotlib", "pandas",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_importing_the_package_imports_nothing_slow():
    """A notebook waits for NumPy at most, and for that only when something is taken from the package."""
    # what is there already may measure the coverage of the tests
    foreign = (
        "{m.partition('.')[0] for m in sys.modules if m[0] != '_'} - set(sys.stdlib_module_names) - before"
    )
    done = python(
        "import sys\nbefore = {m.partition('.')[0] for m in sys.modules}\n"
        f"import fitting\nassert {foreign} == {{'fitting', 'lazy_loader'}}, {foreign}\n"
        f"from fitting import load, Model, fit\nassert {foreign} == {{'fitting', 'lazy_loader', 'numpy'}}, {foreign}"
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_fit_imports_nothing_slow_that_it_does_not_need(tmp_path):
    """Their import takes longer than the fit."""
    path = tmp_path / "case.h5"
    assert run(["simulate", "-o", str(path), "--duration", "20", "-q"]) == 0
    code = (
        "import sys\nfrom gyrotrack.apps.cli._app import run\n"
        f"assert run(['fit', {str(path)!r}, '--json', '-q']) == 0\n"
        "slow = {'scipy.stats', 'scipy.signal', 'pandas', 'matplotlib', 'rich', 'cv2', 'av'} & set(sys.modules)\n"
        "assert not slow, slow\n"
        "parts = {m.split('.')[1] for m in sys.modules if m.startswith('fitting.')}\n"
        "assert not parts & {'law_search', 'planning', 'comparison', 'paper'}, parts"
    )
    done = python(code)
    assert done.returncode == 0, done.stderr


def test_public_names():
    assert set(fitting.__all__) <= set(dir(fitting))
    with pytest.raises(AttributeError, match="nonsense"):
        _ = fitting.nonsense


def test_models_compose():
    model = Model.of("reduced") + "casing.air.quadratic" + "casing: -q*omega_c**3" - "bearing.power"
    assert "casing.air.quadratic" in model.names
    assert "bearing.power" not in model.names
    assert str(Model.of("linear")).count(" + ") == 3
    with pytest.raises(EffectError, match="no model named"):
        Model.of("quadratic")


def test_a_fit_prints_itself():
    lines = repr(fitted(seed=0)).splitlines()
    assert lines[0] == "fit: no significant lack of fit; `gyrotrack diagnose` tests other effects"
    assert max(map(len, lines)) <= 80
    assert any("bearing.linear.d" in line and "+-" in line and "N m s" in line for line in lines)
    held = fit(Model.of("linear"), data(seed=0), fixed={"b1": 2.88e-6})
    assert "2.88e-06 N m (held)" in repr(held)


def test_data_frame():
    pandas = pytest.importorskip("pandas")
    frame = fitted(seed=0).to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    e = fitted(seed=0).estimates["bearing.power.g"]
    assert frame.loc["bearing.power.g"].tolist() == [e.value, e.stderr, "1", False]
    assert len(frame) == len(fitted(seed=0).estimates)


def test_a_data_frame_without_pandas_is_an_error_with_a_hint(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(EstimationError, match="needs pandas"):
        fitted(seed=0).to_dataframe()


def same(a, b):
    return a == b or (math.isnan(a) and math.isnan(b))


@pytest.mark.slow
def test_a_saved_fit_is_read_back(tmp_path):
    model = Model.of("reduced") + "casing: -q*omega_c**3"
    found = fit(model, data(seed=0), fixed={"g": 1.32})
    path = tmp_path / "fit.json"
    found.save(path)
    again = load_fit(path)
    assert again.model == found.model
    assert again.verdict == found.verdict
    assert list(again.estimates) == list(found.estimates)
    for k, e in found.estimates.items():
        assert again.estimates[k].value == e.value
        assert same(again.estimates[k].stderr, e.stderr)
    np.testing.assert_array_equal(again.covariance, found.covariance)
    assert again.cases == found.cases
    assert (again.bic, again.chi2, again.n_eff, again.rows) == (
        found.bic,
        found.chi2,
        found.n_eff,
        found.rows,
    )
    assert repr(again) == repr(found)
    # once more from the file's own fit, and to a fit of data
    again.save(tmp_path / "twice.json")
    assert (tmp_path / "twice.json").read_text() == path.read_text()
    refit = again.refit([data(seed=0)])
    assert refit.bic == pytest.approx(found.bic, abs=0.01)
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"format": "gyrotrack ledger"}',
        "[" * 100_000,
        '{"format": "gyrotrack fit", "version": 1, "model": ["os.system"]}',
        '{"format": "gyrotrack fit", "version": 9}',
    ],
)
def test_other_files_are_refused_as_saved_fits(tmp_path, text):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(LedgerError):
        load_fit(path)


def test_damaged_fits_are_refused(tmp_path):
    path = tmp_path / "fit.json"
    fitted(seed=0).save(path)
    document = json.loads(path.read_text())
    for key in document:
        for wrong in (None, "x", [1], {"a": 1}, 3):
            if isinstance(wrong, type(document[key])):
                continue
            path.write_text(json.dumps(document | {key: wrong}))
            try:
                load_fit(path)
            except LedgerError:
                continue
            # what carries no structure may hold another word or number; nothing but LedgerError may come out
            assert key not in {"format", "version", "model", "estimates", "covariance", "cases"}, (key, wrong)


def test_saving_into_a_read_only_folder_is_an_error(tmp_path):
    with pytest.raises(LedgerError, match="cannot be written"):
        fitted(seed=0).save(tmp_path / "nowhere" / "fit.json")


def test_energy_is_a_curve_and_a_number():
    """Against the paper's formula with its signs put right, summed here from the data and the parameters."""
    found = fitted(seed=0)
    balance = found.energy("case1")
    values = {k.rpartition(".")[2]: e.value for k, e in found.estimates.items()}
    t, omega_c = found.problem.data[0].speeds["casing"]
    omega_c = np.interp(balance.time, t, omega_c)
    motion = twobody.simulate(seed=0)
    omega_r = motion.at(balance.time, 0)[1]
    diff = omega_r - omega_c
    tau = values["d"] * diff + values["f"] * diff ** values["g"]
    power = tau * diff + values["a2"] * omega_r**3 + (values["b1"] + values["b2"] * omega_c) * omega_c
    lost = np.concatenate([[0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(balance.time))])
    expected = 0.5 * (twobody.I_ROTOR * omega_r**2 + twobody.I_CASING * omega_c**2) + lost
    np.testing.assert_allclose(balance.energy, expected, rtol=1e-6)
    assert balance.drift == found.cases[0].energy_drift
    with pytest.raises(EstimationError, match="no case"):
        found.energy("case7")


def test_figures_of_merit_agree_with_their_definitions():
    """R2, rmse and chi-square summed sample by sample from the film and the model's path, smoothed like the film."""
    from fitting.dynamics._collocation import Sampler
    from fitting.inference._record import speeds

    found = fitted(seed=0)
    (case,) = found.cases
    t, omega = found.problem.data[0].speeds["casing"]
    path = found.predictions[0].path
    measured = found.problem.data[0].record.casing
    angle = Sampler(path.mesh, measured.time).integral(*path.angle("omega_c"))
    times, modelled = speeds(replace(measured, value=angle), "angle")
    assert np.array_equal(times, t)
    error = omega - modelled
    assert case.casing.rmse == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert case.casing.r2 == pytest.approx(
        1 - np.sum(error**2) / np.sum((omega - omega.mean()) ** 2), rel=1e-12
    )
    # angles: a constant start angle is free; once- and twice-a-turn artefacts take six more of 52,000. The level of
    # the noise is that of its slow end, some 900 numbers, known to 2.4 %
    samples = found.problem.data[0].record.casing
    angle = Sampler(path.mesh, samples.time).integral(*path.angle("omega_c"))
    left = samples.value - angle
    scale = found.noise[0].scale * samples.sigma
    chi2 = np.sum(((left - left.mean()) / scale) ** 2) / len(left)
    assert case.casing.reduced_chi2 == pytest.approx(chi2, rel=0.06)


@pytest.mark.slow
def test_one_case_or_a_list():
    record = data(seed=0).record
    assert fit("linear", record).chi2 == fit(Model.of("linear"), [record]).chi2
    raw = twobody.film(twobody.simulate(seed=0), seed=0)
    assert make_record(**raw).digest == record.digest


@pytest.mark.slow
@pytest.mark.release
def test_the_documentation_page_runs(tmp_path, monkeypatch, capsys):
    for name, seed, words in (
        ("case1", "2", []),
        ("case2", "3", ["--omega-rotor", "800", "--set", "touchpoint.constant.b1=5e-6"]),
    ):
        done = run(
            ["simulate", "-o", str(tmp_path / f"{name}.h5"), "--duration", "40", "--seed", seed, *words]
        )
        assert done == 0
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    names = {}
    for block in re.findall(
        r"```python\n(.*?)```", (ROOT / "docs/how-to/python.md").read_text(encoding="utf-8"), re.S
    ):
        exec(compile(block, "python.md", "exec"), names)  # noqa: S102 - our own page
    said = capsys.readouterr().out
    assert "True (8, 8)" in said
    assert "reduced model" in said
    assert names["again"].label == "from arrays"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((42, None), "a case is a NoneType"),
        (("reduced", "case.h5"), "a case is a str, not a Record"),
        ((42, []), "a int is not a model"),
        (("reduced", [], {"start": [1.0]}), "start is a list"),
        (("reduced", [], {"ranges": {"g": 0.7}}), "the range of 'g' is 0.7"),
    ],
)
def test_wrong_arguments_raise_errors_of_the_package_with_a_hint(arguments, message):
    *positional, options = (*arguments, {}) if len(arguments) == 2 else arguments
    with pytest.raises(fitting.FittingError, match=message) as found:
        fitting.fit(*positional, **options)
    assert str(found.value) == f"{found.value.message}\nHint: {found.value.hint}"
