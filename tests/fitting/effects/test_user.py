"""Effects written by users: valid ones, and a clear error for every invalid one."""

import math

import pytest

from fitting import EffectError, ExpressionError, read_effects
from fitting.effects._effect import parse_unit
from fitting.effects._library import find
from fitting.effects._user import edit_distance, formula, resolve


def parts(effect):
    return {p.symbol: (p.role, p.unit) for p in effect.parameters}


def test_a_name_of_the_library():
    assert resolve(" casing.air.quadratic ") is find("casing.air.quadratic")


@pytest.mark.parametrize(
    ("text", "joint", "expected"),
    [
        ("casing: -k*omega_c**3", "casing", {"k": ("amplitude", "N m s3")}),
        ("rotor:-k*omega_r", "rotor", {"k": ("amplitude", "N m s")}),
        ("bearing: c*sign(delta)", "bearing", {"c": ("amplitude", "N m")}),
        ("casing: -k*t", "casing", {"k": ("amplitude", "N m s-1")}),
        ("casing: -k*abs(omega_c)**1.5*sign(omega_c)", "casing", {"k": ("amplitude", "N m s1.5")}),
        (
            "casing: -k*abs(omega_c)**p*sign(omega_c)",
            "casing",
            {"k": ("amplitude", "N m s^p"), "p": ("shape", "1")},
        ),
        (
            "casing: -k*exp(-abs(omega_c)/w)*sign(omega_c)",
            "casing",
            {"k": ("amplitude", "SI"), "w": ("shape", "1")},
        ),
        ("casing: k*sin(psi_c - phi)", "casing", {"k": ("amplitude", "N m"), "phi": ("phase", "1")}),
        ("casing: k*cos(3*psi_c + a)", "casing", {"k": ("amplitude", "N m"), "a": ("phase", "1")}),
        ("casing: k*sin(pi*t*q/q)", "casing", None),
    ],
)
def test_a_formula_becomes_an_effect(text, joint, expected):
    effect = resolve(text)
    assert effect.name == text
    assert effect.joint == joint
    assert effect.kind == "physical"
    if expected is not None:
        assert parts(effect) == expected
    strength = next(p for p in effect.parameters if p.role == "amplitude")
    assert strength.start == 0.0
    assert math.isinf(strength.lower)
    for p in effect.parameters:
        assert p.role != "shape" or len(p.grid) >= 5


@pytest.mark.parametrize("per_case", [False, True])
def test_an_effect_of_a_file_states_whether_each_case_has_its_own_value(tmp_path, per_case):
    path = tmp_path / "own.toml"
    path.write_text(
        '[[effect]]\nname = "own"\nbody = "casing"\nlaw = "-k*omega_c**3"\nsignature = "a fall"\nsource = "a book"\n'
        f"per_case = {str(per_case).lower()}\n"
    )
    (found,) = read_effects(path)
    assert (found.per_case, found.signature, found.source) == (per_case, "a fall", "a book")


def test_derived_units_make_the_law_a_torque():
    for text in (
        "casing: -k*omega_c**3",
        "casing: -k*abs(omega_c)**p*sign(omega_c)",
        "bearing: k*delta*omega_r**2",
    ):
        resolve(text).check()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gearbox: -k*omega_c", "'gearbox' is an unknown body"),
        (": -k*omega_c", "'' is an unknown body"),
        ("casing: -omega_c**3", "has no parameter"),
        ("casing: -k**2*omega_c", "linear in none of k"),
        ("casing: -exp(k*t)", "linear in none of k"),
        ("casing: -k*omega_c + 1e-6", "is not proportional to"),
        ("casing: -k*omega_c - q*omega_c**2", "is not proportional to"),
        ("casing: -k*temperature", "'temperature' is not available"),
        ("casing: -k*tau", "'tau' is not available"),
        ("casing: -k*psi", "'psi' is not available"),
        ("casing: k*sin(n*psi_c)", "'n' is a shape constant, but a law of an angle"),
        ("casing:", "empty"),
        ("casing: -k*omega_c; x", "not a formula"),
        ("casing: __import__('os')", "not allowed"),
        ("-k*omega_c**3", "does not say on which body"),
        ("k*omega_c", "does not say on which body"),
        ("casing.air.quadratics", "no effect named"),
    ],
)
def test_errors_of_formulas_are_explained(text, message):
    with pytest.raises((EffectError, ExpressionError), match=message):
        resolve(text)


def write(tmp_path, text):
    path = tmp_path / "effects.toml"
    path.write_text(text, encoding="utf-8")
    return path


GOOD = """
[[effect]]
name = "my.drag"
body = "casing"
law = "-k*abs(omega_c)**p*sign(omega_c)"
signature = "in between"
source = "guessed"

[effect.parameters.k]
lower = 0.0
meaning = "strength"

[effect.parameters.p]
unit = "1"
lower = 1.0
upper = 2.0
start = 1.5
grid = [1.2, 1.5, 1.8, 7.0]

[[effect]]
name = "rub"
body = "casing"
law = "-k*exp(-abs(omega_c)/w)*sign(omega_c)"

[effect.parameters.k]
unit = "N m"
[effect.parameters.w]
unit = "rad/s"
start = 5

[[effect]]
name = "swap"
body = "rotor"
law = "-a*b*omega_r"
[effect.parameters.a]
shape = true
"""


def test_a_file_of_effects(tmp_path):
    drag, rub, swap = read_effects(write(tmp_path, GOOD))
    k, p = drag.parameters
    assert (drag.name, drag.joint, drag.signature, drag.source) == (
        "my.drag",
        "casing",
        "in between",
        "guessed",
    )
    assert (k.role, k.lower, k.meaning) == ("amplitude", 0.0, "strength")
    assert (p.role, p.lower, p.upper, p.start, p.grid) == ("shape", 1.0, 2.0, 1.5, (1.2, 1.5, 1.8))
    assert parse_unit(k.unit, {"p": 1.5}) == pytest.approx(parse_unit("N m s1.5"))
    assert parts(rub) == {"k": ("amplitude", "N m"), "w": ("shape", "rad s-1")}
    assert rub.parameters[1].start == 5.0
    assert parts(swap)["b"][0] == "amplitude"
    assert parts(swap)["a"][0] == "shape"


HEAD = '[[effect]]\nname = "a"\nbody = "casing"\nlaw = "-k*omega_c"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("this is [not toml", "not a TOML file"),
        ("", r"no \[\[effect\]\] table"),
        ("effect = 3", r"no \[\[effect\]\] table"),
        ("effect = [3]", "effect 1 is not a table"),
        (HEAD + 'colour = "red"', "unknown key 'colour'"),
        ('[[effect]]\nname = "a"\nbody = "casing"', "missing key 'law'"),
        ('[[effect]]\nname = "a"\nlaw = "-k"', "missing key 'body'"),
        ('[[effect]]\nbody = "casing"\nlaw = "-k"', "missing key 'name'"),
        (HEAD.replace('"a"', "7"), "name must be text"),
        (HEAD.replace('"-k*omega_c"', "7"), "law must be text"),
        (HEAD.replace('"a"', '"9 lives"'), "a name has letters"),
        (HEAD.replace('"a"', '"../../etc"'), "a name has letters"),
        (HEAD.replace('"a"', '"x@case1"'), "a name has letters"),
        (HEAD.replace("casing", "gearbox"), "'gearbox' is an unknown body"),
        (HEAD.replace("-k*", "-k**2*"), "linear in none of k"),
        (HEAD.replace("-k*", "-"), "has no parameter"),
        (HEAD + "parameters = 3", "parameters must be a table"),
        (HEAD + "[effect.parameters]\nk = 3", "parameter k must be a table"),
        (HEAD + "[effect.parameters.k]\nmaximum = 3", "parameter k: unknown key 'maximum'"),
        (HEAD + "[effect.parameters.q]\nstart = 3", "'q' does not occur"),
        (HEAD + '[effect.parameters.k]\nunit = "furlong"', "'furlong'"),
        (HEAD + "[effect.parameters.k]\nunit = 3", "unit must be text"),
        (HEAD + '[effect.parameters.k]\nunit = "N m"', "has the unit"),
        (HEAD + "[effect.parameters.k]\nmeaning = 3", "meaning must be text"),
        (HEAD + "[effect.parameters.k]\ngrid = 3", "grid must be a list"),
        (HEAD + '[effect.parameters.k]\ngrid = ["x"]', "grid must be a number"),
        (HEAD + "[effect.parameters.k]\nshape = 1", "shape must be true or false"),
        (HEAD + "[effect.parameters.k]\nshape = true", "every parameter"),
        (HEAD + '[effect.parameters.k]\nstart = "x"', "start must be a number"),
        (HEAD + "[effect.parameters.k]\nstart = true", "start must be a number"),
        (HEAD + "[effect.parameters.k]\nlower = nan", "lower must be a number"),
        (HEAD + "[effect.parameters.k]\nlower = 2\nupper = 1", "lower 2 must be less than upper 1"),
        (HEAD + "[effect.parameters.k]\nstart = 2\nupper = 1", "start 2 is outside"),
        (
            HEAD.replace("-k*omega_c", "-k*omega_c*(omega_c + t)") + '[effect.parameters.k]\nunit = "N m"',
            "do not agree",
        ),
        (HEAD + HEAD, "another effect named 'a'"),
        (HEAD.replace('"a"', '"casing.windage"'), "another effect named"),
    ],
)
def test_errors_of_effect_files_are_explained(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(EffectError, match=message) as caught:
        read_effects(path)
    assert str(path) in caught.value.message
    assert "Traceback" not in caught.value.message
    assert len(caught.value.message) < 300 + len(str(tmp_path))


def test_bounds_move_the_usual_start(tmp_path):
    (effect,) = read_effects(write(tmp_path, HEAD + "[effect.parameters.k]\nlower = 1e-9"))
    assert effect.parameters[0].start == 1e-9


def test_unreadable_files_are_refused(tmp_path):
    with pytest.raises(EffectError, match="No such file"):
        read_effects(tmp_path / "nothing.toml")
    with pytest.raises(EffectError, match="directory"):
        read_effects(tmp_path)
    path = tmp_path / "bytes.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(EffectError, match="not a TOML file"):
        read_effects(path)


@pytest.mark.parametrize(
    ("law", "jump"),
    [
        ("-k*heaviside(t - t0)", "t0"),
        ("-k*omega_c*heaviside(-a + t)", ""),
        ("-k*heaviside(t0 - t)", ""),
        ("-k*heaviside(t - t0)*heaviside(t0 + 10 - t)", ""),
        ("-k*heaviside(omega_c - w)", ""),
        ("-k*exp(-((t - t0)/w)**2)", ""),
    ],
)
def test_the_changepoint_of_a_jump_is_recognised(law, jump):
    assert resolve(f"casing: {law}").breakpoint == jump


def test_changepoints_are_searched_in_the_whole_record():
    bump = {p.symbol: p for p in resolve("casing: -k*exp(-((t - t0)/w)**2)").parameters}
    assert bump["t0"].relative
    assert max(bump["t0"].grid) < 1
    assert not bump["w"].relative
    drift = resolve("casing: -k*exp(-t/tau0)")
    assert not any(p.relative for p in drift.parameters)


def test_a_declared_changepoint_keeps_its_values(tmp_path):
    file = tmp_path / "own.toml"
    file.write_text(
        '[[effect]]\nname = "own.step"\nbody = "casing"\nlaw = "-k*heaviside(t - t0)"\n'
        "[effect.parameters.t0]\nstart = 61.0\n"
    )
    (step,) = read_effects(file)
    (t0,) = (p for p in step.parameters if p.symbol == "t0")
    assert step.breakpoint == "t0"
    assert (t0.start, t0.relative) == (61.0, False)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("casing: -k*omga_c", "omega_c"),
        ("casing: -k*omegac**2", "omega_c"),
        ("rotor: -k*Omega_r", "omega_r"),
        ("bearing: k*deltta", "delta"),
        ("casing: k*sin(psi_x - phi)", "psi_c"),
        ("casing: -k*speed", "omega_c"),
        ("bearing: k*slip**n", "delta"),
    ],
)
def test_misspelt_variables_are_refused(text, meant):
    with pytest.raises(EffectError, match=f"did you mean {meant}"):
        resolve(text)


@pytest.mark.parametrize(
    "text", ["casing: k", "casing: -k*exp(-t/tau0)", "casing: -k*omega_c*exp(-omega_c/w1)", "bearing: k*t"]
)
def test_parameters_are_not_misspelt_variables(text):
    assert resolve(text).amplitude.symbol == "k"


def test_a_declared_parameter_may_look_like_a_variable():
    law = "-k*omega_c*exp(-omega_c/omega_0)"
    with pytest.raises(EffectError, match="did you mean omega_"):
        formula("x", "casing", law, {})
    keys = {"omega_0": {"unit": "s-1", "start": 50.0}}
    assert [p.symbol for p in formula("x", "casing", law, keys).parameters] == ["k", "omega_0"]


@pytest.mark.parametrize(
    ("keys", "factors"),
    [
        ({}, (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)),
        ({"start": 2.0}, (0.06, 0.2, 0.6, 2.0, 6.0, 20.0, 60.0, 200.0)),
        ({"start": 2.0, "lower": 0.2, "upper": 20.0}, (0.2, 0.6, 2.0, 6.0, 20.0)),
        ({"grid": [5, 7.5, -1], "lower": 0.0}, (5.0, 7.5)),
        ({"lower": 3.0}, (3.0, 9.0, 30.0, 90.0, 300.0)),
        ({"upper": -2.0, "lower": -9.0}, (-2.0, -6.0)),
    ],
)
def test_trial_values_of_a_shape_constant_are_two_per_decade(keys, factors):
    effect = formula("x", "casing", "-k*tanh(omega_c/w)", {"w": {"shape": True, **keys}})
    k, w = effect.parameters
    assert sorted(w.grid) == pytest.approx(sorted(factors))
    assert (k.grid, k.start, k.role, w.role) == ((), 0.0, "amplitude", "shape")


@pytest.mark.parametrize(
    ("a", "b", "distance"),
    [
        ("", "abc", 3),
        ("abc", "", 3),
        ("abc", "ac", 1),
        ("ac", "abc", 1),
        ("abcd", "bcda", 2),
        ("kitten", "sitting", 3),
        ("ab", "ba", 2),
    ],
)
def test_edits_are_insertions_deletions_and_substitutions(a, b, distance):
    assert edit_distance(a, b) == distance
