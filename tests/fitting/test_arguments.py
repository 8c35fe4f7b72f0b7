"""Wrong arguments of public functions and the repr of public results: one sentence, one screen."""

from types import SimpleNamespace

import numpy as np
import pytest
from cases import fitted, searched

import fitting
from fitting import Case, Criteria, Experiment, FittingError, Input, Ledger, Model, effect
from fitting._arguments import PUBLIC

T = np.linspace(0.0, 10.0, 100)
RUN = (T, 20.0 - T, np.full(100, 0.1))
WRONG = [
    None,
    3,
    -1.5,
    float("nan"),
    "x",
    "",
    b"x",
    [],
    {},
    object(),
    np.zeros(3),
    True,
    ["x"],
    {"x": 1},
    {1: 2},
]


def refused(function, wrong, *args, **kwargs):
    """Call with a wrong argument: only errors of the package may come out, in one sentence."""
    messages = [""]
    try:
        function(*args, **kwargs)
    except FittingError as fault:
        messages.append(fault.message)
    assert "\n" not in messages[-1], wrong
    assert len(messages[-1]) < 300, wrong


@pytest.mark.parametrize("name", ["budget", "certify", "diagnose", "first_order", "improve", "laws", "plan"])
@pytest.mark.parametrize("wrong", WRONG, ids=range(len(WRONG)))
def test_functions_of_a_fit_refuse_anything_else(name, wrong):
    with pytest.raises(FittingError) as fault:
        getattr(fitting, name)(wrong)
    assert "\n" not in fault.value.message


@pytest.mark.parametrize("argument", ["extra", "criteria"])
@pytest.mark.parametrize("wrong", [3, "x", ["x"], {"x": 1}, True], ids=range(5))
@pytest.mark.parametrize("name", ["diagnose", "improve", "laws", "plan"])
def test_options_of_a_diagnosis_are_checked_before_it_begins(name, argument, wrong):
    with pytest.raises(FittingError, match=f"{argument} is"):
        getattr(fitting, name)(fitted(seed=0), **{argument: wrong})


MODEL = Model.of("linear")
NUMBERS = dict.fromkeys(MODEL.free, 1e-07)
SMALL = Experiment(duration=4.0, casing_fps=30.0, rotor_fps=50.0, windows=(1.0,), window_length=1.0)
CALLS = {
    "make_record": {
        "casing": RUN, "rotor": [RUN], "I_rotor": 1.0, "I_casing": 1.0, "label": "x", "surface": "",
        "quantity": "omega", "source": "", "tracked": False, "single": False, "start_sigma": (),
        "I_rotor_u": 0.1, "I_casing_u": 0.1,
        "per_inertia": False, "correlated": (), "inputs": (), "name": "",
    },
    "simulate": {
        "model": MODEL, "numbers": NUMBERS, "experiment": SMALL, "inertia_rotor": 5e-5, "inertia_casing": 2e-5,
        "seed": 0, "label": "x", "inputs": (),
    },
    "load": {"path": "none.h5", "data": None, "rotor": "windows"},
    "load_fit": {"path": "none.json"},
    "read_effects": {"path": "none.toml"},
    "effect": {"text": "casing: -k*omega_c", "inputs": None},
    "scan": {"cases": None},
    "scan_lines": {"scan": None},
    "compare": {"fits": None},
    "profile_interval": {"fit": None, "name": "x", "level": 0.9},
}  # fmt: skip


@pytest.mark.parametrize(("name", "argument"), [(n, a) for n, kwargs in CALLS.items() for a in kwargs])
def test_a_wrong_argument_is_one_sentence(name, argument):
    for wrong in WRONG:
        refused(getattr(fitting, name), wrong, **(CALLS[name] | {argument: wrong}))


@pytest.mark.parametrize(
    ("build", "arguments"),
    [
        (Input, {"name": "current", "time": T, "value": T, "unit": "A", "u": None}),
        (lambda **k: Input("current", T, T, **k), {"interpolation": "hold", "delay": 0.0}),
        (Case, {"record": None}),
        (Case.from_arrays, {"wheel": {"t": T, "omega": T}, "label": "x", "surface": "", "inputs": ()}),
        (Case.load, {"path": "none.h5"}),
        (Model, {"effects": ()}),
        (Model.of, {"names": "linear"}),
        (MODEL.with_effect, {"effect": effect("casing.air.quadratic")}),
        (MODEL.without, {"name": "bearing.linear"}),
        (MODEL.with_fixed, {"values": {"d": 1.0}}),
        (Ledger, {"path": "none.json"}),
        (Experiment, {"duration": 4.0, "casing_fps": 30.0, "windows": (1.0,), "sigma": 1e-3, "omega_rotor": 900.0}),
    ],
    ids=range(12),
)  # fmt: skip
def test_a_wrong_argument_of_a_class_is_one_sentence(build, arguments):
    for argument in arguments:
        for wrong in WRONG:
            refused(build, wrong, **(arguments | {argument: wrong}))


@pytest.mark.parametrize("wrong", WRONG, ids=range(len(WRONG)))
def test_methods_of_a_fit_refuse_wrong_arguments(wrong, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = fitted(seed=0)
    # intervals take a few fits each
    monkeypatch.setattr("fitting.inference._profile.profile", lambda *_: None)
    for method, arguments in (
        (found.eval, {"time": [1.0], "body": "rotor", "case": 0, "quantity": "omega"}),
        (found.conf_interval, {"level": 0.9}),
        (found.energy, {"label": "case1"}),
        (found.fit_report, {"least_correlation": 0.1}),
        (found.save, {"path": "x.json"}),
        (found.measured_speeds, {"case": 0, "body": 1}),
        (found.modelled_speed, {"case": 0, "body": 1, "time": T}),
        (found.speed_residuals, {"case": 0}),
        (found.params.set, {"name": "d", "value": 1.0, "vary": True, "min": 0.0, "max": 1.0, "expr": None}),
        (found.params.__getitem__, {"name": "d"}),
    ):
        for argument in arguments:
            # `__getitem__` has no keywords
            if method == found.params.__getitem__:
                refused(method, wrong, wrong)
            else:
                refused(method, wrong, **(arguments | {argument: wrong}))


def test_a_message_names_the_argument_the_value_and_what_it_must_be():
    with pytest.raises(FittingError) as fault:
        fitting.simulate(MODEL, NUMBERS, SMALL, inertia_rotor="heavy", inertia_casing=2e-5)
    assert fault.value.message == "inertia_rotor is 'heavy', not a positive number"
    with pytest.raises(FittingError, match="fit is a list, not a Fit"):
        fitting.diagnose([3.0] * 40)
    # zero is no inertia, and the smallest one is
    with pytest.raises(FittingError, match="not a positive number"):
        fitting.simulate(MODEL, NUMBERS, SMALL, inertia_rotor=0, inertia_casing=2e-5)


def test_every_public_function_is_checked():
    functions = {
        n
        for n in fitting.__all__
        if callable(getattr(fitting, n)) and not isinstance(getattr(fitting, n), type)
    }
    assert functions - set(PUBLIC) == {"fit", "load", "effect"}  # which check their arguments themselves
    with pytest.raises(TypeError, match="unexpected keyword argument 'fitt'"):
        fitting.first_order(fitt=fitted(seed=0))


def results():
    """Yield public results that cost nothing but a fit."""
    found = fitted(seed=0)
    record = found.problem.data[0].record
    yield from (
        record,
        Case(record),
        found,
        found.params,
        found.params["d"],
        found.model,
        found.cases,
        record.casing,
    )
    yield from (
        fitting.budget(found),
        fitting.compare({"a": found, "b": found}),
        found.energy(),
        found.lack_of_fit,
    )
    yield from (
        found.speed_residuals(0),
        effect("casing.air.quadratic"),
        effect("casing: -k*omega_c**3"),
        SMALL,
    )
    yield from (Input("current", T, T, "A"), fitting.LIBRARY["bearing.power"].parameters, Criteria())


def test_a_result_prints_within_a_screen():
    for result in results():
        text = repr(result)
        assert text.count("\n") < 20, type(result)
        assert len(text) < 2000, type(result)


@pytest.mark.slow
@pytest.mark.release
def test_results_of_a_diagnosis_print_within_a_screen():
    found, _, diagnosis = searched()
    for result in (
        diagnosis, diagnosis.torques, diagnosis.failures[:5], diagnosis.ripples, diagnosis.candidates[0],
        fitting.improve(found, max_steps=1), fitting.laws(found, diagnosis=diagnosis),
    ):  # fmt: skip
        text = repr(result)
        assert text.count("\n") < 20, type(result)
        assert len(text) < 2600, type(result)


def test_a_plan_and_a_scan_print_within_a_screen():
    from fitting import Scan
    from fitting.paper._scan import ModelFits
    from fitting.planning._plan import Plan

    found = fitted(seed=0)
    scan = Scan(("case1",), ((),), ((),), (ModelFits("reduced", (found,) * 30, found, (), ()),))
    assert repr(scan).count("\n") == 19
    text = repr(Plan(found, False, 1e-7, (), (), None, "Only one recording."))
    assert text.splitlines() == ["plan: 0 effects, for an rms torque of 1e-07 N m", "Only one recording."]


@pytest.mark.parametrize(
    ("separate", "joint", "converged"),
    [
        ("adequate", "missing_effect", True),
        ("adequate", "not_converged", False),
        ("not_converged", "adequate", False),
        ("adequate", None, True),
        ("not_converged", None, False),
    ],
)
def test_a_scan_converged_if_all_its_separate_and_joint_fits_did(separate, joint, converged):
    from fitting import Scan
    from fitting.paper._scan import ModelFits

    good, last = SimpleNamespace(verdict="adequate"), SimpleNamespace(verdict=separate)
    both = SimpleNamespace(verdict=joint) if joint else None
    models = (ModelFits("reduced", (good,), good, (), ()), ModelFits("general", (good, last), both, (), ()))
    assert Scan(("case1",), ((),), ((),), models).converged == converged
