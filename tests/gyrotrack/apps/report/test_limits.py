"""The table of upper limits: torque and strength with their units, the joint of the effect, no row without a limit."""

from types import SimpleNamespace

from fitting import effect_name
from fitting.discovery._power import UpperLimit
from fitting.effects._mechanism import GYROSCOPE
from gyrotrack.apps.report._tables import limit_rows


def view(limits, *, unit="N m", body="casing"):
    return SimpleNamespace(
        body=body,
        upper_limits=limits,
        final=SimpleNamespace(torque_unit=unit, model=SimpleNamespace(mechanism=GYROSCOPE)),
        name=lambda key: effect_name(key, body),
    )


def test_a_limit_has_its_torque_with_a_prefix_and_its_strength_in_si():
    limits = (
        UpperLimit("bearing.drift", "k", 4.2e-5, "s-1", 7.5e-7),
        UpperLimit("casing.air.quadratic", "k", 3e-11, "N m s2", 1.4e-8),
        UpperLimit("lab.own", "k", 2.0, "1", 9e-9),
    )
    rows = limit_rows(view(limits))
    assert [r["effect"] for r in rows] == [
        "drift of the bearing friction",
        "quadratic air drag of the casing",
        "lab.own",
    ]
    assert [r["key"] for r in rows] == ["bearing.drift", "casing.air.quadratic", ""]
    assert [r["torque"] for r in rows] == ["< 0.75 µN m", "< 14 nN m", "< 9.0 nN m"]
    assert rows[1]["joint"] == "casing"
    assert rows[1]["strength"] == "k < 3.0 × 10⁻¹¹ N m s²"
    assert rows[2]["joint"] == "–"
    assert rows[2]["strength"] == "k < 2.00"


def test_a_single_body_is_named_as_the_page_names_it():
    limits = (UpperLimit("casing.air.quadratic", "k", 3e-11, "N m s2", 1.4e-8),)
    (row,) = limit_rows(view(limits, unit="rad/s2", body="body"))
    assert row["joint"] == "body"
    assert (row["effect"], row["key"]) == ("quadratic air drag of the body", "air.quadratic")
    assert row["torque"] == "< 1.4 × 10⁻⁸ rad/s²"
