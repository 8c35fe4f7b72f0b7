import math

import pytest

from fitting._numbers import (
    per_inertia,
    probability,
    scaled,
    short,
    stated_probability,
    typeset,
    unit_text,
    with_uncertainty,
)


@pytest.mark.parametrize(
    ("value", "error", "unit", "text"),
    [
        (7.16e-7, 4e-9, "N m s", "(7.16 ± 0.04) × 10⁻⁷ N m s"),
        (1.26e-8, 3e-10, "N m s^g", "(1.26 ± 0.03) × 10⁻⁸ N m sᵍ"),
        (-2.17, 0.24, "rad", "−2.17 ± 0.24 rad"),
        (899.9998, 0.00011, "rad s-1", "899.99980 ± 0.00011 rad s⁻¹"),
        (1.3195, 0.0003, "1", "1.3195 ± 0.0003"),
    ],
)
def test_value_and_error_are_rounded_together(value, error, unit, text):
    assert with_uncertainty(value, error, unit) == text


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("N m s2", "N m s²"),
        ("rad s-1", "rad s⁻¹"),
        ("N m s1.5", "N m s¹·⁵"),
        ("1", ""),
        ("kg m2", "kg m²"),
        ("N m A-1", "N m A⁻¹"),
        ("rad s-1 V-1", "rad s⁻¹ V⁻¹"),
        ("A2", "A2"),  # may be a name
    ],
)
def test_units_have_raised_exponents(unit, text):
    assert unit_text(unit) == text


def test_sentences_are_typeset_without_names_and_formulas():
    sentence = (
        "loses 2.7e-07 N m with k = (9.996e-11 +- 2e-14) N m s2. Effect casing: -1e-6*omega_c**2 of run s2x"
    )
    assert typeset(sentence) == (
        "loses 2.7 × 10⁻⁷ N m with k = (9.996 × 10⁻¹¹ ± 2 × 10⁻¹⁴) N m s². "
        "Effect casing: -1e-6*omega_c**2 of run s2x"
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.04617, "0.0462"), (659193.14, "6.6 × 10⁵"), (-1550.9, "−1551"), (0.9986, "0.999"), (1.0, "1.00")],
)
def test_short_numbers(value, text):
    assert short(value) == text


def test_large_numbers_keep_all_digits():
    assert short(199.4, 2) == "199"
    assert short(99.9, 2) == "100"
    assert short(-999.7) == "−1000"
    assert short(999.4) == "999"
    assert short(0.9996) == "1.00"
    assert short(2000.0) == "2000"


def test_missing_numbers_are_a_dash():
    assert short(math.nan) == "–"


def test_tiny_probabilities_are_bounded():
    assert probability(1e-186) == "< 10⁻³⁰"
    assert probability(0.0) == "< 10⁻³⁰"
    assert stated_probability(1e-186) == "p < 10⁻³⁰"
    assert stated_probability(0.34) == "p = 0.34"


def test_scale_keeps_the_size_readable():
    for size in (3e-8, 4e-5, 0.02, 1.0, 160.0):
        factor, prefix = scaled(size)
        assert 0.5 <= size * factor <= 500
        assert factor == {"": 1, "m": 1e3, "µ": 1e6, "n": 1e9, "p": 1e12}[prefix]


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("k = (8.60 ± 0.27) × 10⁻¹¹ N m s² in all", ["k", "=", "(8.60 ± 0.27) × 10⁻¹¹ N m s²", "in", "all"]),
        ("loses 1.8 × 10⁻⁷ N m more", ["loses", "1.8 × 10⁻⁷ N m", "more"]),
        ("from 0.1 s to 3.7 s, so", ["from", "0.1 s", "to", "3.7 s,", "so"]),
        (
            "up to 0.079 rad/s, at 22 s; rms 9 times it",
            ["up", "to", "0.079 rad/s,", "at", "22 s;", "rms", "9 times", "it"],
        ),
        ("file 3 sand.mp4", ["file", "3", "sand.mp4"]),
    ],
)
def test_numbers_and_units_are_joined_by_nonbreaking_spaces(text, lines):
    from fitting._numbers import nonbreaking

    assert [w.replace("\u00a0", " ") for w in nonbreaking(text).split(" ")] == lines


@pytest.mark.parametrize(
    ("unit", "divided"),
    [
        ("N m", "rad/s2"),
        ("N m s-1", "rad/s3"),
        ("N m s", "s-1"),
        ("N m s2", "1"),
        ("N m s3", "s"),
        ("N m s^g", "s^(g-2)"),
        ("N m A-1", "rad/s2 A-1"),
        ("N m s V-1", "s-1 V-1"),
        ("N m V-2", "rad/s2 V-2"),
        ("N m K-1", "rad/s2 K-1"),
        ("s", "s"),
    ],
)
def test_units_per_inertia(unit, divided):
    assert per_inertia(unit) == divided
