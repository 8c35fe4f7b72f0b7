"""Dimensions, scales and roles of laws, and how formulas of users are understood."""

import math

import pytest

from fitting import Effect, EffectError, ExpressionError, Parameter, RecordError
from fitting.effects._effect import (
    MOMENTS,
    NONE,
    State,
    bodies_of,
    dimension,
    format_unit,
    input_symbol,
    is_input_symbol,
    parse_unit,
    quotient,
    refuse_input_name,
    slope_symbol,
)
from fitting.effects._expression import parse
from fitting.effects._library import find
from fitting.effects._user import dead_time, drive, drives, edit_distance, formula, resolve
from fitting.effects._words import change_name, effect_name

UNITS = {"x": parse_unit("m"), "v": parse_unit("m s-1"), "t": parse_unit("s"), "one": NONE, "p": NONE}


class TestDimension:
    @pytest.mark.parametrize(
        ("text", "unit"),
        [
            ("v*t", "m"),
            ("x/t", "m s-1"),
            ("x + v*t", "m"),
            ("x - v*t", "m"),
            ("v**3", "m3 s-3"),
            ("sqrt(v)", "m0.5 s-0.5"),
            ("abs(v)", "m s-1"),
            ("sign(v)*x", "m"),
            ("heaviside(t)*x", "m"),
            ("exp(x/(v*t))*t", "s"),
            ("v**p", "m2.5 s-2.5"),
            ("v**(p + 1)", "m3.5 s-3.5"),
            ("v**(2*p)", "m5 s-5"),
            ("tanh(one)", "1"),
        ],
    )
    def test_it_follows_from_the_operations(self, text, unit):
        assert dimension(parse(text), UNITS, {"p": 2.5}) == pytest.approx(parse_unit(unit))

    @pytest.mark.parametrize("text", ["x + t", "x - v", "exp(x)", "sin(v)", "one + x", "v**one", "log(t)"])
    def test_contradictions_are_refused(self, text):
        with pytest.raises(ExpressionError):
            dimension(parse(text), UNITS, {"p": 2.5})

    @pytest.mark.parametrize(
        ("unit", "shown"),
        [
            ("kg m2 s-2", "N m"),
            ("kg m2 s-1", "N m s"),
            ("kg m2", "N m s2"),
            ("kg m s-2", "kg m s-2"),
            ("J K-1", "N m K-1"),
            ("rad s-1", "s-1"),
            ("N m A-1", "N m A-1"),
            ("V", "V"),
            ("m2 s-1", "m2 s-1"),
            ("1", "1"),
            ("kg m2 s-0.5", "N m s1.5"),
        ],
    )
    def test_a_newton_metre_is_factored_out(self, unit, shown):
        assert format_unit(parse_unit(unit)) == shown
        assert parse_unit(shown) == pytest.approx(parse_unit(unit))

    def test_exponents_may_be_parameters(self):
        assert parse_unit("N m s^g", {"g": 1.5}) == pytest.approx(parse_unit("N m s1.5"))
        assert parse_unit("N m s^-g", {"g": 1.5}) == pytest.approx(parse_unit("N m s-1.5"))
        with pytest.raises(ExpressionError):
            parse_unit("N m s^g")
        assert quotient(parse_unit("N m"), parse_unit("m s")) == pytest.approx(parse_unit("N s-1"))


class TestParameter:
    @pytest.mark.parametrize(("scale", "unit"), [("speed", 30.0), ("length", 6.0), ("chirp", 5.0), ("", 1.0)])
    def test_values_are_in_units_of_the_recording(self, scale, unit):
        p = Parameter("w", "s-1", "shape", 0.1, 2.0, 0.5, (0.2, 0.4), scale=scale).at(30.0, 6.0)
        assert (p.lower, p.upper, p.start) == pytest.approx((0.1 * unit, 2.0 * unit, 0.5 * unit))
        assert p.grid == pytest.approx((0.2 * unit, 0.4 * unit))
        assert p.scale == ""

    @pytest.mark.parametrize(
        ("law", "unit"), [("-k*w*omega_c", 5.0), ("-k*w*omega_r", 300.0), ("-k*w*delta", 5.0), ("k*w*t", 5.0)]
    )
    def test_the_speed_is_that_of_the_body_of_the_law(self, law, unit):
        own = (Parameter("k", "N m"), Parameter("w", "s-1", "shape", start=2.0, scale="speed"))
        e = Effect("x", "casing", law, own)
        found = e.parameters_at({"omega_r": 300.0, "omega_c": 5.0}, 9.0)
        assert found[1].start == 2.0 * unit

    def test_the_amplitude_is_the_only_one(self):
        k, q = Parameter("k", "N m"), Parameter("q", "N m")
        w, fixed = Parameter("w", "1", "shape"), Parameter("c", "1", "fixed")
        assert Effect("x", "casing", "k*w*c", (w, k, fixed)).amplitude is k
        assert Effect("x", "casing", "k+q", (k, q)).amplitude is None
        assert Effect("x", "casing", "w", (w,)).amplitude is None
        assert Effect("x", "casing", "k*w*c", (w, k, fixed)).free == (w, k)

    def test_trial_changepoints_cover_the_record(self):
        assert len(MOMENTS) == 47
        assert (MOMENTS[0], MOMENTS[1], MOMENTS[-1]) == (0.04, 0.06, 0.96)


class TestEffect:
    def made(self, law, joint="casing", **more):
        return Effect("x", joint, law, (Parameter("k", "N m"),), **more)

    def test_what_a_law_depends_on(self):
        assert self.made("k*sin(psi_c)").depends_on_angle
        assert self.made("k*sin(psi)", "camera.casing").depends_on_angle
        assert not self.made("k*omega_c").depends_on_angle
        assert self.made("k*sin(psi_c)").periodic
        assert not self.made("k*omega_c").periodic
        phase = Effect("x", "casing", "k*sin(t+phi)", (Parameter("k", "N m"), Parameter("phi", "1", "phase")))
        assert phase.periodic
        assert self.made("-k*deflection").restoring
        assert not self.made("-k*psi_c").restoring
        assert self.made("-k*sin(psi_c)").about_equilibrium.law == "-k*sin(deflection)"
        camera = self.made("k*sin(psi_c)", "camera.casing")
        assert camera.about_equilibrium is camera
        assert (camera.camera, camera.mechanical) == ("casing", False)
        assert (self.made("k").camera, self.made("k").mechanical) == (None, True)

    def test_bodies_are_those_of_place_and_variables(self):
        assert self.made("k*omega_c").bodies == {"casing"}
        assert self.made("k*omega_r").bodies == {"rotor", "casing"}
        assert self.made("k*t", "rotor").bodies == {"rotor"}
        assert self.made("k*t", "bearing").bodies == {"rotor", "casing"}
        assert self.made("k*t", "camera.rotor").bodies == {"rotor"}
        assert self.made("k*t", state=State("lag", "omega_r")).bodies == {"rotor", "casing"}
        assert bodies_of("factor", ()) == {"rotor", "casing"}

    def test_places_of_factors_and_inertias(self):
        assert self.made("1+k*t", "factor").site == "bearing"
        assert self.made("1/(1+k)", "inertia").site == "casing"
        assert self.made("k", "rotor").site == "rotor"
        two = self.made("k*lag", state=State("lag", "omega_c"), second=State("strain", "t"))
        assert [s.symbol for s in two.states] == ["lag", "strain"]
        assert len(two.rates) == 2

    @pytest.mark.parametrize(
        ("joint", "law", "unit", "right"),
        [
            ("casing", "k*omega_c", "N m s", True),
            ("casing", "k*omega_c", "N m", False),
            ("factor", "1 + k*t", "s-1", True),
            ("factor", "1 + k*t", "N m", False),
            ("input", "k", "s", True),
            ("input", "k", "1", False),
            ("camera.casing", "k*omega", "s", True),
            ("camera.casing", "k*omega", "N m s", False),
            ("casing", "k*unknown", "N m", False),
            ("casing", "k*slip", "N m s", False),
            ("contact", "k*slip", "N m s", False),
        ],
    )
    def test_a_law_has_the_unit_of_its_joint(self, joint, law, unit, right):
        e = Effect("x", joint, law, (Parameter("k", unit),))
        if right:
            e.check()
        else:
            with pytest.raises((EffectError, ExpressionError)):
                e.check()
        if joint == "contact":
            Effect("x", joint, law, (Parameter("k", unit), Parameter("n", "1"))).check()

    def test_symbols_of_inputs(self):
        assert is_input_symbol(input_symbol("u"))
        assert not is_input_symbol(slope_symbol(input_symbol("u")))
        assert not is_input_symbol("u")
        for name in ("u", "temperature", "a" * 41, "psi", "x_1"):
            refuse_input_name(name)
        for name in ("", "1u", "a" * 42, "omega_c", "pi", "sin", "t", 3):
            with pytest.raises(RecordError):
                refuse_input_name(name)


class TestFormula:
    @pytest.mark.parametrize(
        ("a", "b", "distance"),
        [
            ("", "abc", 3),
            ("abc", "abc", 0),
            ("kitten", "sitting", 3),
            ("omega", "omgea", 2),
            ("ab", "b", 1),
            ("a", "b", 1),
        ],
    )
    def test_the_distance_of_two_words_counts_edits(self, a, b, distance):
        assert edit_distance(a, b) == edit_distance(b, a) == distance

    @pytest.mark.parametrize(
        ("text", "refused"),
        [
            ("casing: -k*omega_d", True),
            ("casing: -omeg_c*t", True),
            ("casing: -omg_c*t", True),
            ("casing: -om_c*t", False),
            ("casing: -a*b*omega_c", True),
            ("casing: -a*omega_c**b", False),
            ("casing: -a*exp(b)", True),
            ("casing: -a*omega_c*(1 + b*t)", False),
        ],
    )
    def test_misspelt_names_and_products_are_refused(self, text, refused):
        if refused:
            with pytest.raises(EffectError):
                resolve(text)
        else:
            resolve(text)

    def test_declared_parameters_keep_their_numbers(self):
        declared = {"n": {"shape": True, "lower": 0.5, "upper": 3.0, "start": 2.0}, "k": {"lower": 0.0}}
        e = formula("x", "casing", "-k*abs(omega_c)**n*sign(omega_c)", declared)
        k, n = e.parameters
        assert (k.role, k.lower, k.upper, k.start) == ("amplitude", 0.0, math.inf, 0.0)
        assert (n.role, n.lower, n.upper, n.start) == ("shape", 0.5, 3.0, 2.0)
        assert all(0.5 <= v <= 3.0 for v in n.grid)
        assert 2.0 in n.grid
        given = formula(
            "x", "casing", "-k*abs(omega_c)**n*sign(omega_c)", {"n": {"grid": [0.4, 1.0, 9.0], "upper": 3.0}}
        )
        assert given.parameters[1].grid == (0.4, 1.0)
        assert given.parameters[1].start == 1.0
        high = formula("x", "casing", "-k*abs(omega_c)**n*sign(omega_c)", {"n": {"lower": 1.5}})
        assert high.parameters[1].start == 1.5
        low = formula("x", "casing", "-k*abs(omega_c)**n*sign(omega_c)", {"n": {"upper": 0.5}})
        assert low.parameters[1].start == 0.5
        bounded = formula("x", "casing", "-k*omega_c", {"k": {"lower": 0.25}})
        assert bounded.parameters[0].start == 0.25

    @pytest.mark.parametrize(
        "keys",
        [
            {"lower": 2.0, "upper": 2.0},
            {"lower": 3.0, "upper": 2.0},
            {"start": 4.0, "upper": 3.0},
            {"start": 0.1, "lower": 0.2},
            {"start": True},
            {"start": "1"},
            {"lower": math.nan},
            {"grid": [None]},
        ],
    )
    def test_contradictory_numbers_are_refused(self, keys):
        with pytest.raises(EffectError):
            formula("x", "casing", "-k*abs(omega_c)**n*sign(omega_c)", {"n": keys})

    @pytest.mark.parametrize(
        ("law", "role"),
        [
            ("k*sin(psi_c + x)", "phase"),
            ("k*cos(2*psi_c - x)", "phase"),
            ("k*sin(2*x + psi_c)", "shape"),
            ("k*(omega_c + x)**2", "shape"),
            ("k*sin(t + x)", "phase"),
            ("k*exp(x*t)", "shape"),
        ],
    )
    def test_a_phase_is_its_own_negative_second_derivative(self, law, role):
        if role == "shape" and "psi_c" in law:
            with pytest.raises(EffectError, match="shape constant"):
                resolve(f"casing: {law}")
        else:
            found = {p.symbol: p.role for p in resolve(f"casing: {law}").parameters}
            assert found == {"k": "amplitude", "x": role}

    @pytest.mark.parametrize(
        ("law", "count", "jump"),
        [
            ("-k*heaviside(t - t0)*omega_c", 47, "t0"),
            ("-k*heaviside(t - t0)*heaviside(omega_c - w)", 47, "t0"),
            ("-k*exp(-(t - t0)**2)*omega_c", 47, ""),
            ("-k*exp(-(t - t0)**2/w)*omega_c", None, ""),
            ("-k*heaviside(2*t - t0)*omega_c", 0, ""),
        ],
    )
    def test_trial_times_cover_the_record(self, law, count, jump):
        e = resolve(f"casing: {law}")
        t0 = next(p for p in e.parameters if p.symbol == "t0")
        assert e.breakpoint == jump
        assert t0.relative is (count != 0)
        if count:
            assert t0.grid == MOMENTS
        elif count is None:
            assert 3 < len(t0.grid) < 47
            assert set(t0.grid) < set(MOMENTS)

    @pytest.mark.parametrize(
        ("text", "unit"),
        [
            ("casing: -k*omega_c**2", "N m s2"),
            ("casing: k*t**2", "N m s-2"),
            ("casing: -k*abs(omega_c)**p*sign(omega_c)", "N m s^p"),
            ("casing: k*t**p", "N m s^-p"),
            ("casing: -k*omega_c*abs(omega_c)**p", "SI"),
            ("casing: -k*abs(omega_c)**(2*p)", "SI"),
            ("casing: -k*abs(omega_c)**power*sign(omega_c)", "SI"),
            ("casing: k*u", "N m A-1"),
            ("casing: k*u*omega_c", "N m s A-1"),
        ],
    )
    def test_the_unit_of_the_strength_makes_a_torque(self, text, unit):
        e = resolve(text, {"u": "A"})
        assert next(p.unit for p in e.parameters if p.role == "amplitude") == unit
        assert e.inputs == ((("u", "A"),) if "k*u" in text else ())

    def test_recorded_inputs_drive_each_place(self):
        found = drives({"u": "A", "w": "V"})
        assert [e.name for e in found] == [
            *(f"{s}.input.{n}" for n in ("u", "w") for s in ("rotor", "casing", "bearing")),
            "input.u.delay",
            "input.w.delay",
        ]
        k = drive("casing", "u", "A").parameters[0]
        assert (k.unit, k.lower, k.upper) == ("N m A-1", -math.inf, math.inf)
        delay = dead_time("u", "A")
        assert (delay.parameters[0].lower, delay.parameters[0].unit, delay.kind) == (0.0, "s", "measurement")

    def test_a_state_is_available_with_its_rate_only(self):
        declared = {"k": {}, "tau_l": {"shape": True}}
        e = formula("x", "casing", "-k*lag", declared, rate="(omega_c - lag)/tau_l")
        assert e.state == State("lag", "(omega_c - lag)/tau_l")
        with pytest.raises(EffectError):
            formula("x", "casing", "-k*lag", {})
        with pytest.raises(EffectError):
            formula("x", "casing", "-k*temperature*lag", {}, rate="omega_c - lag")
        with pytest.raises(EffectError, match="does not occur"):
            formula("x", "casing", "-k*omega_c", {"q": {}})
        with pytest.raises(EffectError, match="declared as a shape"):
            formula("x", "casing", "-k*omega_c", {"k": {"shape": True}})


class TestWords:
    @pytest.mark.parametrize(
        ("key", "body", "shown", "words"),
        [
            ("casing.air.linear", "casing", "casing.air.linear", "casing"),
            ("casing.air.linear", "wheel", "air.linear", "wheel"),
            ("casing.air.linear.b2@x", "wheel", "air.linear.b2", "wheel"),
            ("initial.omega_c", "wheel", "initial.omega_c", "initial speed of the wheel"),
            ("initial.omega_r", "casing", "initial.omega_r", "initial speed of the rotor"),
        ],
    )
    def test_a_name_has_the_body_in_words(self, key, body, shown, words):
        found = effect_name(key, body)
        assert found.key == shown
        assert words in found.words
        assert ("casing" in found.words) is (body == "casing" and "omega_r" not in key)

    def test_unknown_names_and_laws_are_their_own_words(self):
        assert str(effect_name("what.ever")) == "what.ever"
        assert effect_name("casing: -k*omega_c**3").words == "law -k*omega_c**3 on the casing"
        assert effect_name("casing: -k*omega_c**3", "disc").words == "law -k*omega_c**3 on the disc"
        assert str(effect_name("casing.input.u")).endswith("(casing.input.u)")
        assert effect_name("initial.other").key == ""

    def test_a_change_has_its_signs_in_words(self):
        drag = find("casing.air.linear").words
        assert change_name("+casing.air.linear") == f"+ {drag}"
        assert change_name("-casing.air.linear") == f"− {drag}"
        assert change_name("+casing.air.linear -what.ever") == f"+ {drag} − what.ever"
        assert change_name("+what.ever instead of casing.air.linear") == f"+ what.ever instead of {drag}"
        assert change_name("a text") == "a text"
