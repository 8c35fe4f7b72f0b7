"""Errors that samples share, in rows, estimates, tests, files and replicas."""

import math
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from fitting import Case, ErrorMode, RecordError, diagnose, fit
from fitting.inference import _case_data, _replica
from fitting.inference._case_data import CaseData
from fitting.inference._case_file import read_record
from fitting.inference._error_modes import MOST_AMPLITUDES, mode_columns
from fitting.inference._record import Samples, make_record
from fitting.inference._sampled import FittedMotion

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
        levels = [
            f.problem.data[0].process_noise.level
            for f in (found, fit("support.constant", wheel(0.1 * shape)))
        ]
        assert levels[0] < 0.1 * levels[1]

    @pytest.mark.parametrize("period", [3.0, 0.5, 0.2])
    def test_a_fast_error_is_not_white_noise(self, period):
        """Periods above and below the length of a block, 0.5 s; the amplitude is ten times the noise."""
        shape = np.sin(2 * np.pi * T / period)
        mode = {"sway": {"basis": shape, "covariance": 0.1**2}}
        found = fit("support.constant", wheel(0.1 * shape, modes=mode))
        assert found.problem.data[0].casing.scale == pytest.approx(1.0, abs=0.15)
        without = deceleration(wheel()).stderr
        assert found.params["wheel.support.constant.b1"].stderr == pytest.approx(without, rel=0.3)

    def test_angles_have_modes_beside_the_camera(self):
        """A fast error of the angle of a body that turns: its amplitude is fitted, and so is the centre offset."""
        phase = 60.0 * T - 0.5 * T**2
        shape = np.sin(40.0 * T)
        noise = 1e-4 * np.random.default_rng(2).standard_normal(len(T))
        angle = phase + 2e-3 * shape + 1e-3 * np.cos(phase) + noise
        body = {
            "t": T,
            "angle": angle,
            "u": 1e-4,
            "modes": {"shake": {"basis": shape, "covariance": 2e-3**2}},
        }
        found = fit("support.constant", Case.from_arrays(wheel=body))
        assert found.params["wheel.support.constant.b1"].value == pytest.approx(1.0, abs=1e-4)
        assert np.sqrt(np.mean(found.residual**2)) == pytest.approx(1.0, abs=0.1)

    def test_an_error_beyond_its_covariance_is_not_hidden(self):
        shape = np.sin(2 * np.pi * T / 3.0)
        mode = {"sway": {"basis": shape, "covariance": 1e-4**2}}
        assert deceleration(wheel(0.1 * shape, modes=mode)).stderr > 0.02

    @pytest.mark.parametrize(("s", "verdict"), [(0.0, "missing_effect"), (0.2, "adequate")])
    def test_a_stated_error_does_not_become_a_missing_effect(self, s, verdict):
        """A drift of the scale that resembles drag is named only where no such error is stated."""
        shape = np.exp(-T / 8.0)
        modes = {"warming": {"basis": shape, "covariance": s**2}} if s else None
        answer = diagnose(fit("support.constant", wheel(0.2 * shape, modes=modes)), brief=True)
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


class TestWindows:
    def record(self, windows, modes):
        casing = (T, 5 * T, np.full(len(T), 1e-3))
        rotor = [(t, 100 * t, np.full(len(t), 1e-3)) for t in windows]
        return make_record(casing=casing, rotor=rotor, I_rotor=1e-4, I_casing=1e-4, modes=modes)

    def test_a_window_has_its_own_errors_where_two_overlap(self):
        t = [np.linspace(0.0, 1.0, 60), np.linspace(0.5, 1.5, 60)]
        modes = [ErrorMode(f"start_{i}", w, w, 1.0, "rotor", i) for i, w in enumerate(t)]
        columns = CaseData.of(self.record(t, modes)).mode_columns[1]
        assert [c.any(axis=0).tolist() for c in columns] == [[True, False], [False, True]]

    def test_a_window_that_is_left_out_takes_its_errors_with_it(self):
        t = [np.linspace(0.0, 0.01, 3), np.linspace(2.0, 3.0, 60)]
        modes = [ErrorMode(f"start_{i}", w, w, 1.0, "rotor", i) for i, w in enumerate(t)]
        record = self.record(t, modes)
        assert len(record.rotor) == 1
        assert [(m.name, m.window) for m in record.modes] == [("start_1", 0)]

    def test_windows_of_a_file_need_no_order(self, tmp_path):
        def swap(file):
            file["body/rotor/series/fused/segment"][...] = np.repeat([1, 0], [200, 201])

        path = write(
            tmp_path / "c.h5", quantity="angle", inertia=1e-4, roles=("rotor", "casing"), change=swap
        )
        record = read_record(path)
        assert [len(w) for w in record.rotor] == [201, 200]
        columns = CaseData.of(record).mode_columns[1]
        for window, column in zip(record.rotor, columns, strict=True):
            assert column[:, 0] == pytest.approx(0.02 * window.time)

    @pytest.mark.slow
    def test_negligible_errors_leave_the_noise_of_the_windows_as_it_is(self):
        rng = np.random.default_rng(0)
        casing = (T, 5 * T + 1e-3 * rng.standard_normal(len(T)), np.full(len(T), 1e-3))
        windows = [T[:200], T[200:]]
        slow = [np.cumsum(rng.standard_normal(len(t))) * 2e-4 for t in windows]
        rotor = [
            (t, 100 * t + s + 1e-3 * rng.standard_normal(len(t)), np.full(len(t), 1e-3))
            for t, s in zip(windows, slow, strict=True)
        ]
        found = []
        for count in (0, 20):
            modes = [
                ErrorMode(f"{i}_{k}", t, np.cos(k * np.pi * (t - t[0]) / np.ptp(t)), 1e-18, "rotor", i)
                for i, t in enumerate(windows)
                for k in range(count)
            ]
            record = make_record(casing=casing, rotor=rotor, I_rotor=1e-4, I_casing=1e-4, modes=modes)
            found.append(CaseData.of(record).rotor_angle_noise.sigma)
        assert found[0] > 0
        assert found[1] == pytest.approx(found[0], rel=1e-3)


def test_samples_without_a_value_take_their_row_of_the_basis_with_them():
    omega = 30.0 - 0.7 * T
    omega[7] = np.nan
    modes = {"scale": {"basis": omega, "covariance": 1e-6}}
    case = Case.from_arrays(wheel={"t": T, "omega": omega, "u": U, "modes": modes})
    (mode,) = case.record.modes
    assert len(mode.time) == 400
    assert len(case.record.casing) == 400


def test_speeds_from_angles_err_by_the_derivative():
    mode = ErrorMode("sway", T, np.sin(T), 4.0)
    assert mode.rates().at(T[1:-1])[:, 0] == pytest.approx(np.cos(T[1:-1]), abs=1e-3)
    assert mode.rates().covariance == mode.covariance


class TestReplicas:
    def test_simulated_recordings_have_the_error(self):
        shape = np.sin(T)
        case = wheel(modes={"sway": {"basis": shape, "covariance": 0.5**2}})
        found = fit("support.constant", case)
        motion = FittedMotion(found, 0, found.problem.data[0])
        random = np.random.default_rng(3)
        left = _replica._recording(motion, random).casing.value - motion.values()[0]
        left -= shape * (shape @ left) / (shape @ shape)
        assert np.std(left) == pytest.approx(U, rel=0.15)
        amplitude = [
            (shape @ (_replica._recording(motion, random).casing.value - motion.values()[0]))
            / (shape @ shape)
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
        ({"basis": np.ones((3, 401)), "covariance": np.eye(401)}, "401 amplitudes; at most 400"),
        ({"time": np.array([0.0, 1.0, 1.0])}, "not finite and strictly increasing"),
        ({"time": np.array([0.0, 1.0, np.nan])}, "not finite and strictly increasing"),
        ({"group": None}, "its group is not a string"),
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


@pytest.mark.parametrize(("asymmetry", "refused"), [(0.95e-9, False), (1.05e-9, True)])
def test_an_asymmetry_beyond_rounding_is_refused(asymmetry, refused):
    covariance = np.array([[1.0, 0.5], [0.5 + asymmetry, 1.0]])
    if refused:
        with pytest.raises(RecordError, match="not symmetric"):
            ErrorMode("tilt", GOOD.time, np.ones((3, 2)), covariance)
    else:
        assert ErrorMode("tilt", GOOD.time, np.ones((3, 2)), covariance).basis.shape == (3, 2)


@pytest.mark.parametrize(("size", "kept"), [(0.9, 0), (1.1, 1)])
def test_errors_beyond_the_white_noise_of_a_window_are_free(size, kept):
    """100 samples of sigma 0.1: a constant of 0.01 is one standard deviation of their mean."""
    samples = Samples(np.arange(100.0), np.zeros(100), np.full(100, 0.1))
    found = _case_data._beyond_noise(np.full((100, 1), 0.01 * size), samples)
    assert found.shape == (100, kept)
    assert not kept or np.ptp(found) == pytest.approx(0.0, abs=1e-12)


def test_a_covariance_that_is_barely_singular_is_taken():
    ErrorMode("tilt", GOOD.time, np.ones((3, 2)), np.ones((2, 2)))


@pytest.mark.parametrize(("excess", "refused"), [(0.95e-9, False), (1.05e-9, True)])
def test_a_negative_eigenvalue_beyond_rounding_is_refused(excess, refused):
    """The matrix [[1, 1 + x], [1 + x, 1]] has the eigenvalue -x."""
    covariance = 1e-6 * np.array([[1.0, 1 + excess], [1 + excess, 1.0]])
    if refused:
        with pytest.raises(RecordError, match="negative variance"):
            ErrorMode("tilt", GOOD.time, np.ones((3, 2)), covariance)
    else:
        ErrorMode("tilt", GOOD.time, np.ones((3, 2)), covariance)


@pytest.mark.parametrize(
    ("modes", "words"),
    [
        ("tilt", "not all ErrorMode objects"),
        (
            [ErrorMode("a", T, T, 1.0, group="g"), ErrorMode("b", T, T, 2.0, group="g")],
            "different covariances",
        ),
        (
            [
                ErrorMode(name, T, np.ones((401, n)), np.eye(n))
                for name, n in (("a", MOST_AMPLITUDES), ("b", 1))
            ],
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


def exchange(group, name, shape):
    del group[name]
    group[name] = np.zeros(shape)


class TestFiles:
    def test_a_single_body_may_be_named_rotor(self, tmp_path):
        def rename(file):
            file.move("body/wheel", "body/rotor")
            group = file.create_group("casing")
            for name, old in (("time", "time"), ("omega", "value"), ("omega_sigma", "u")):
                group[name] = file[f"body/rotor/series/fused/{old}"]
            file.attrs.update({"bodies": "one", "I_casing": 1.0, "per_inertia": 1, "quantity": "omega"})

        assert len(read_record(write(tmp_path / "case.h5", change=rename)).modes) == 1

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
            ({"quantity": "pulse_times"}, "of the quantity 'pulse_times', which cannot be fitted"),
            ({"names": ("left", "right")}, "2 series and none is named fused"),
            ({"roles": ("rotor",)}, "roles rotor"),
            ({"roles": ("body", "casing")}, "roles body, casing"),
            ({"roles": ("casing", "rotor"), "quantity": "angle"}, "an inertia is missing"),
            ({"inertia": -1.0}, "not positive"),
            (
                {"change": lambda f: exchange(f["body/wheel/series/fused/error/drift"], "basis", (5, 1))},
                "shape (5, 1)",
            ),
            (
                {
                    "quantity": "angle",
                    "inertia": 1e-4,
                    "roles": ("casing", "rotor"),
                    "change": lambda f: exchange(f["clock/rotor_0"], "covariance", (0, 0)),
                },
                "shape (0, 0), not (2, 2)",
            ),
            (
                {
                    "quantity": "angle",
                    "inertia": 1e-4,
                    "roles": ("casing", "rotor"),
                    "change": lambda f: f["clock/rotor_0/covariance"].__setitem__((0, 0), -1e-9),
                },
                "no covariance of offset and rate",
            ),
            (
                {"change": lambda f: f["body/wheel/series/fused/error/drift"].__delitem__("basis")},
                "drift lacks 'basis'",
            ),
            ({"change": lambda f: f.__delitem__("body")}, "lacks 'casing'"),
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
