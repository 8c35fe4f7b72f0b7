"""A case from tables is the motion that was written into them."""

import numpy as np
import pytest

from gyrotrack import DatasetError, UsageError, import_case
from gyrotrack.io.readers._import_case import summary


def motion(body, time):
    """Angle and speed of a casing that speeds up and a rotor that slows down, known in closed form."""
    if body == "casing":
        return 60 * (time + 5 * np.exp(-time / 5)), 60 * (1 - np.exp(-time / 5))
    return 900 * 30 * (1 - np.exp(-time / 30)), 900 * np.exp(-time / 30)


def write(path, body, times, *, noise=1e-3, sigma=True, quantity="angle", sign=1, wrap=False, seed=0):
    rng = np.random.default_rng(seed)
    values = sign * motion(body, times)[0 if quantity == "angle" else 1] + rng.normal(size=times.size) * noise
    if wrap:
        values = np.mod(values, 2 * np.pi)
    header = f"t,{quantity}" + (",sigma" if sigma else "")
    tail = f",{noise}" if sigma else ""
    path.write_text(
        "\n".join([header, *(f"{t:.7f},{v:.9f}{tail}" for t, v in zip(times, values, strict=True))])
    )
    return path


@pytest.fixture
def tables(tmp_path):
    def make(**options):
        casing = write(tmp_path / "casing.csv", "casing", np.arange(0, 20, 1 / 260), **options)
        rotors = [
            write(
                tmp_path / f"r{k}.csv",
                "rotor",
                np.arange(start, start + 1.5, 1 / 1000),
                seed=k + 1,
                **options,
            )
            for k, start in enumerate((12.0, 2.0))
        ]
        return casing, rotors

    return make


def test_angles_become_the_motion(tables):
    case = import_case(*tables(wrap=True), label="L", surface="S", I_rotor=5.54e-5, I_casing=2.06e-5)
    assert (case.label, case.surface, case.quantity) == ("L", "S", "angle")
    assert (case.I_rotor, case.I_casing) == (5.54e-5, 2.06e-5)
    truth = motion("casing", case.casing.time)
    turned = case.casing.angle - truth[0]
    assert np.std(turned) < 1.1e-3
    inside = np.isfinite(case.casing.omega)
    assert inside.sum() == len(inside) - 100
    z = ((case.casing.omega - truth[1]) / case.casing.omega_sigma)[inside]
    assert 0.8 < np.std(z) < 1.25
    assert list(np.unique(case.rotor.window)) == [0, 1]
    assert case.rotor.time[case.rotor.window == 0][0] == 2.0
    np.testing.assert_array_equal(case.rotor.turn, np.floor(case.rotor.angle / (2 * np.pi)))


def test_sigma_that_is_not_given_is_estimated_from_the_scatter(tables):
    case = import_case(*tables(sigma=False, noise=2e-3), I_rotor=5.54e-5, I_casing=2.06e-5)
    assert case.casing.sigma_source == case.rotor.sigma_source == "estimated"
    assert np.median(case.casing.sigma) == pytest.approx(2e-3, rel=0.05)
    assert np.median(case.rotor.sigma) == pytest.approx(2e-3, rel=0.05)
    assert any("estimated from the scatter" in warning for warning in case.warnings)


def test_scatter_follows_a_slow_change_of_the_noise(tmp_path):
    rng = np.random.default_rng(4)
    time = np.arange(0, 40, 1 / 260)
    noise = np.linspace(1e-3, 4e-3, time.size)
    lines = [
        f"{t:.7f},{v:.9f}" for t, v in zip(time, 30 * time + rng.normal(size=time.size) * noise, strict=True)
    ]
    (tmp_path / "c.csv").write_text("\n".join(["t,angle", *lines]))
    rotor = write(tmp_path / "r.csv", "rotor", np.arange(2, 3, 1e-3))
    case = import_case(tmp_path / "c.csv", [rotor], I_rotor=5.54e-5, I_casing=2.06e-5)
    ratio = case.casing.sigma / noise
    assert np.median(ratio) == pytest.approx(1, rel=0.05)
    assert 0.7 < ratio.min() <= ratio.max() < 1.4
    assert case.rotor.sigma_source == "given"


def test_speeds_are_kept_and_integrated(tables):
    case = import_case(*tables(quantity="omega", noise=0.05), I_rotor=5.54e-5, I_casing=2.06e-5)
    assert case.quantity == "omega"
    truth = motion("casing", case.casing.time)
    assert np.std(case.casing.omega - truth[1]) == pytest.approx(0.05, rel=0.05)
    np.testing.assert_array_equal(case.casing.omega_sigma, 0.05)
    error = case.casing.angle - (truth[0] - truth[0][0])
    assert abs(error[-1]) < 5 * case.casing.sigma[-1] < 0.1
    assert (np.diff(case.casing.sigma) > 0).all()


def test_one_rotor_table_with_gaps_becomes_windows(tmp_path, tables):
    casing, _ = tables()
    times = np.concatenate([s + np.arange(0, 1, 1e-3) for s in (1.0, 6.0, 11.0)])
    case = import_case(
        casing, [write(tmp_path / "all.csv", "rotor", times, wrap=True)], I_rotor=5.54e-5, I_casing=2.06e-5
    )
    assert [int((case.rotor.window == k).sum()) for k in range(3)] == [1000, 1000, 1000]
    assert np.isnan(case.rotor.omega[1000:1050]).all()


def test_both_bodies_negative_are_turned_round(tables):
    case = import_case(*tables(sign=-1), I_rotor=5.54e-5, I_casing=2.06e-5)
    assert case.extra["sense"] == -1
    assert np.nanmedian(case.casing.omega) > 0
    assert np.nanmedian(case.rotor.omega) > 0
    assert any("sense -1" in warning for warning in case.warnings)


def test_opposite_senses_are_reported_not_corrected(tmp_path, tables):
    _, rotors = tables()
    casing = write(tmp_path / "c.csv", "casing", np.arange(0, 20, 1 / 260), sign=-1)
    case = import_case(casing, rotors, I_rotor=5.54e-5, I_casing=2.06e-5)
    assert np.nanmedian(case.casing.omega) < 0 < np.nanmedian(case.rotor.omega)
    assert any("opposite senses of rotation" in warning for warning in case.warnings)


def test_exchanged_bodies_and_one_body_measured_twice_are_reported(tmp_path, tables):
    times = [np.arange(0, 20, 1 / 260), np.arange(8.0, 9.5, 1e-3)]
    as_casing, twice = (
        write(tmp_path / f"{k}.csv", body, t)
        for k, (body, t) in enumerate(zip(("rotor", "casing"), times, strict=True))
    )
    casing, rotors = tables()
    for files, words in (
        ((casing, rotors), ""),
        ((as_casing, [twice]), "the casing is faster than the rotor"),
        ((casing, [twice]), "casing and rotor have the same motion"),
        # one window in which both turn together is the end of a run
        ((casing, [twice, *rotors]), ""),
    ):
        told = [w for w in import_case(*files, I_rotor=5.54e-5, I_casing=2.06e-5).warnings if "rad/s" in w]
        assert len(told) == bool(words)
        assert all(w.startswith(words) and "gyrotrack import --casing" in w for w in told)


def test_windows_outside_and_overlapping_are_reported(tmp_path, tables):
    casing, rotors = tables()
    late = write(tmp_path / "late.csv", "rotor", np.arange(19.5, 20.5, 1e-3))
    again = write(tmp_path / "again.csv", "rotor", np.arange(2.5, 3.0, 1e-3))
    warnings = " ".join(
        import_case(casing, [*rotors, late, again], I_rotor=5.54e-5, I_casing=2.06e-5).warnings
    )
    assert "not within the record of the casing" in warnings
    assert "overlap in time" in warnings


def test_a_short_piece_is_reported(tmp_path, tables):
    casing, _ = tables()
    short = write(tmp_path / "short.csv", "rotor", np.arange(2, 2.05, 1e-3))
    assert any(
        "too short" in warning
        for warning in import_case(casing, [short], I_rotor=5.54e-5, I_casing=2.06e-5).warnings
    )


def test_mixed_quantities_and_bad_inertia_are_refused(tmp_path, tables):
    casing, rotors = tables()
    speed = write(tmp_path / "w.csv", "rotor", np.arange(2, 3, 1e-3), quantity="omega")
    with pytest.raises(DatasetError, match="contains omega"):
        import_case(casing, [speed], I_rotor=5.54e-5, I_casing=2.06e-5)
    with pytest.raises(UsageError, match="inertia"):
        import_case(casing, rotors, I_rotor=0.0, I_casing=2.06e-5)
    with pytest.raises(UsageError, match="no table of the rotor"):
        import_case(casing, [], I_rotor=5.54e-5, I_casing=2.06e-5)


def test_summary_names_what_was_taken(tables):
    said = summary(import_case(*tables(sigma=False), I_rotor=5.54e-5, I_casing=2.06e-5))
    assert said["casing"]["samples"] == 5200
    assert said["casing"]["sigma_source"] == "estimated"
    assert [w["samples"] for w in said["rotor"]["windows"]] == [1500, 1500]
