"""Errors that samples share, in rows, estimates, tests, files and replicas."""

import math
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from fitting import Case, ErrorMode, RecordError, diagnose, fit
from fitting.inference._case_data import CaseData
from fitting.inference._case_file import read_record
from fitting.inference._error_modes import MOST_AMPLITUDES, mode_columns
from fitting.inference._record import make_record
from fitting.inference._replica import _Motion, _recording

T = np.linspace(0.0, 20.0, 401)
U = 0.01


def wheel(error=0.0, *, modes=None, seed=0):
    """A wheel slowed by a constant torque; its speeds have an error besides their noise."""
    omega = 30.0 - 0.7 * T + U * np.random.default_rng(seed).standard_normal(len(T)) + error
    return Case.from_arrays(wheel={"t": T, "omega": omega, "u": U} | ({"modes": modes} if modes else {}))


def deceleration(case):
    return fit("support.constant", case).params["wheel.support.constant.b1"]


class TestEstimates:
    @pytest.mark.parametrize("s", [0.02, 0.001])
    def test_an_error_along_the_motion_adds_its_variance(self, s):
        """Speeds that err by a t change the deceleration by a."""
        without, found = (
            deceleration(wheel()),
            deceleration(wheel(modes={"drift": {"basis": T, "covariance": s**2}})),
        )
        assert found.value == pytest.approx(without.value, abs=1e-6)
        assert found.stderr == pytest.approx(math.hypot(without.stderr, s), rel=0.02)

    def test_an_error_across_the_motion_is_estimated(self):
        """Speeds that err by a sinusoid: with the mode the residuals are noise, without it they are not."""
        shape = np.sin(2 * np.pi * T / 3.0)
        mode = {"sway": {"basis": shape, "covariance": 0.1**2}}
        found = fit("support.constant", wheel(0.1 * shape, modes=mode))
        assert np.sqrt(np.mean(found.residual**2)) == pytest.approx(1.0, abs=0.1)
        assert found.params["wheel.support.constant.b1"].stderr < 2e-4
        # it would be a random torque
        assert deceleration(wheel(0.1 * shape)).stderr > 0.02

    def test_an_error_beyond_its_covariance_is_not_hidden(self):
        shape = np.sin(2 * np.pi * T / 3.0)
        mode = {"sway": {"basis": shape, "covariance": 1e-4**2}}
        assert deceleration(wheel(0.1 * shape, modes=mode)).stderr > 0.02

    @pytest.mark.parametrize(("s", "verdict"), [(0.0, "missing_effect"), (0.2, "adequate")])
    def test_a_stated_error_does_not_become_a_missing_effect(self, s, verdict):
        """A drift of the scale that resembles drag is named only where no such error is stated."""
        shape = np.exp(-T / 8.0)
        modes = {"warming": {"basis": shape, "covariance": s**2}} if s else None
        answer = diagnose(fit("support.constant", wheel(0.2 * shape, modes=modes)))
        assert answer.verdict == verdict


class TestColumns:
    def test_amplitudes_have_the_stated_covariance(self):
        covariance = np.array([[4.0, 1.0], [1.0, 9.0]])
        basis = np.stack([np.ones(5), np.arange(5.0)], axis=1)
        mode = ErrorMode("tilt", np.arange(5.0), basis, covariance)
        columns, windows = mode_columns([mode], np.arange(5.0), [np.array([0.5])])
        assert columns @ columns.T == pytest.approx(basis @ covariance @ basis.T)
        assert not windows[0].any()
        assert mode.standard_uncertainty() == pytest.approx(np.sqrt(np.diag(columns @ columns.T)))

    def test_a_group_is_one_parameter_of_all_its_series(self):
        t = np.arange(4.0)
        shared = [
            ErrorMode("tilt", t, np.ones(4), [[4.0]], body, group="tilt") for body in ("casing", "rotor")
        ]
        casing, (rotor,) = mode_columns(shared, t, [t])
        assert casing @ rotor.T == pytest.approx(np.full((4, 4), 4.0))
        alone = [ErrorMode("tilt", t, np.ones(4), [[4.0]], body) for body in ("casing", "rotor")]
        casing, (rotor,) = mode_columns(alone, t, [t])
        assert casing @ rotor.T == pytest.approx(np.zeros((4, 4)))

    def test_between_samples_it_is_linear_and_beyond_them_there_is_none(self):
        mode = ErrorMode("tilt", np.array([0.0, 2.0]), np.array([1.0, 3.0]), 1.0)
        assert mode.at(np.array([-0.1, 0.0, 1.0, 2.0, 2.1]))[:, 0] == pytest.approx([0.0, 1.0, 2.0, 3.0, 0.0])

    def test_windows_without_a_group_have_their_own_amplitudes(self):
        window = {
            "angle": 100 * T[:30],
            "u": 1e-3,
            "inertia": 1e-4,
            "modes": {"start": {"basis": T[:30], "covariance": 1}},
        }
        case = Case.from_arrays(
            casing={"t": T, "angle": 5 * T, "u": 1e-3, "inertia": 1e-4},
            rotor=[window | {"t": T[:30]}, window | {"t": T[100:130]}],
        )
        assert [m.key for m in case.record.modes] == ["rotor/start/0", "rotor/start/1"]
        columns = CaseData.of(case.record).mode_columns
        assert columns[0].shape == (401, 2)
        assert not columns[0].any()
        assert [w.any(axis=0).tolist() for w in columns[1]] == [[True, False], [False, True]]


class TestReplicas:
    def test_simulated_recordings_have_the_error(self):
        shape = np.sin(T)
        case = wheel(modes={"sway": {"basis": shape, "covariance": 0.5**2}})
        found = fit("support.constant", case)
        motion = _Motion(found, 0, found.problem.data[0])
        random = np.random.default_rng(3)
        amplitude = [
            (shape @ (_recording(motion, random).casing.value - motion.values()[0])) / (shape @ shape)
            for _ in range(60)
        ]
        assert np.std(amplitude) == pytest.approx(0.5, rel=0.35)


GOOD = SimpleNamespace(time=np.arange(3.0), basis=np.ones((3, 1)), covariance=np.eye(1))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"basis": np.ones((4, 1))}, "shape (4, 1) for 3 samples"),
        ({"basis": np.zeros((3, 0))}, "shape (3, 0)"),
        ({"basis": [["a"], ["b"], ["c"]]}, "holds no numbers"),
        ({"basis": np.full((3, 1), np.nan)}, "not finite"),
        ({"covariance": np.eye(2)}, "covariance has the shape (2, 2) for 1 amplitudes"),
        ({"covariance": [[-1.0]]}, "negative variance"),
        ({"basis": np.ones((3, 2)), "covariance": [[1.0, 2.0], [2.0, 1.0]]}, "negative variance"),
        ({"basis": np.ones((3, 2)), "covariance": [[1.0, 0.5], [0.2, 1.0]]}, "not symmetric"),
        ({"body": "wheel"}, "no body is named 'wheel'"),
    ],
)
def test_wrong_modes_are_refused(change, words):
    with pytest.raises(RecordError) as caught:
        ErrorMode("tilt", **(vars(GOOD) | change))
    assert words in caught.value.message


def test_a_covariance_that_is_barely_singular_is_taken():
    ErrorMode("tilt", GOOD.time, np.ones((3, 2)), np.ones((2, 2)))


@pytest.mark.parametrize(
    ("modes", "words"),
    [
        ("tilt", "not an ErrorMode"),
        (
            [ErrorMode("a", T, T, 1.0, group="g"), ErrorMode("b", T, T, 2.0, group="g")],
            "different covariances",
        ),
        (
            [ErrorMode("a", T, np.ones((401, MOST_AMPLITUDES + 1)), np.eye(MOST_AMPLITUDES + 1))],
            "at most 400",
        ),
    ],
)
def test_contradictions_are_refused(modes, words):
    run = (T, 30 - T, np.full(401, U))
    with pytest.raises(RecordError) as caught:
        make_record(
            casing=run, rotor=[], I_rotor=1.0, I_casing=1.0, single=True, quantity="omega", modes=modes
        )
    assert words in caught.value.message


@pytest.mark.parametrize(
    "modes", [3, {"tilt": {"basis": T}}, {"tilt": {"basis": T, "covariance": 1.0, "colour": 2}}]
)
def test_wrong_entries_of_a_case_are_refused(modes):
    with pytest.raises(RecordError, match=r"modes|basis"):
        wheel(modes=modes)


# ------------------------------------------------------------------------------------------------- files of layout 2


def write(path, *, quantity="speed", inertia=None, roles=("body",), names=("fused",), change=None):
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "gyrotrack", "format_version": "2.0", "kind": "case", "label": "run"})
        for role in roles:
            body = file.create_group(f"body/{'wheel' if role == 'body' else role}")
            body.attrs["role"] = role
            if inertia is not None:
                body.attrs["inertia"], body.attrs["inertia_u"] = inertia, 0.1 * inertia
            for name in names:
                group = body.create_group(f"series/{name}")
                group.attrs["quantity"] = quantity
                group["time"], group["value"], group["u"] = T, 30 - 0.7 * T, np.full(401, U)
                if role == "rotor":
                    group["segment"] = np.repeat([0, 1], [200, 201])
                mode = group.create_group("error/drift")
                mode["basis"], mode["covariance"] = T[:, None], np.array([[0.02**2]])
                mode.attrs["group"], mode.attrs["origin"] = "drift", "rate"
        if "rotor" in roles:
            for window, s in enumerate((1e-3, 2e-3)):
                clock = file.create_group(f"clock/rotor_{window}")
                clock["covariance"] = np.diag([s**2, 1e-12])
        if change:
            change(file)
    return path


class TestFiles:
    def test_a_wheel_is_read_with_its_modes(self, tmp_path):
        record = read_record(write(tmp_path / "case.h5"))
        assert (record.name, record.single, record.quantity, record.per_inertia) == (
            "wheel",
            True,
            "omega",
            True,
        )
        (mode,) = record.modes
        assert (mode.name, mode.group, mode.origin, mode.body) == ("drift", "drift", "rate", "casing")
        assert mode.standard_uncertainty() == pytest.approx(0.02 * T)
        assert record.casing.value == pytest.approx(30 - 0.7 * T)

    def test_a_gyroscope_is_read_with_windows_and_starts(self, tmp_path):
        record = read_record(
            write(tmp_path / "case.h5", quantity="angle", inertia=1e-4, roles=("rotor", "casing"))
        )
        assert [len(w) for w in record.rotor] == [200, 201]
        assert record.start_sigma == pytest.approx((1e-3, 2e-3))
        assert (record.I_casing, record.I_rotor_u, record.per_inertia) == pytest.approx((1e-4, 1e-5, False))
        assert {m.body for m in record.modes} == {"casing", "rotor"}

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            ({"quantity": "pulse_times"}, "holds pulse_times, which cannot be fitted"),
            ({"names": ("left", "right")}, "2 series and none is named fused"),
            ({"roles": ("rotor",)}, "roles rotor"),
            ({"roles": ("body", "casing")}, "roles body, casing"),
            ({"roles": ("casing", "rotor"), "quantity": "angle"}, "needs the inertia of both"),
            ({"inertia": -1.0}, "not positive"),
            (
                {"change": lambda f: f["body/wheel/series/fused/error/drift"].__delitem__("basis")},
                "has no body/wheel",
            ),
            ({"change": lambda f: f.__delitem__("body")}, "incomplete"),
        ],
    )
    def test_files_that_do_not_fit_are_refused(self, tmp_path, arguments, words):
        with pytest.raises(RecordError) as caught:
            read_record(write(tmp_path / "case.h5", **arguments))
        assert words in caught.value.message

    def test_of_several_series_the_fused_one_is_read(self, tmp_path):
        assert len(read_record(write(tmp_path / "case.h5", names=("fused", "left"))).modes) == 1
        assert read_record(write(tmp_path / "other.h5", names=("left",))).casing.value[0] == pytest.approx(
            30.0
        )

    def test_a_link_to_another_file_is_refused(self, tmp_path):
        def link(file):
            del file["body/wheel/series/fused/error/drift/basis"]
            file["body/wheel/series/fused/error/drift/basis"] = h5py.ExternalLink("other.h5", "/x")

        with pytest.raises(RecordError):
            read_record(write(tmp_path / "case.h5", change=link))
