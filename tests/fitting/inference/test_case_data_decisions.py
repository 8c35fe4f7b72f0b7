"""What becomes of the samples of a case: blocks, starts, nuisance functions and priors, with truths in closed form."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from linearised import data as gyroscope_data
from scipy.integrate import quad

from fitting import Input, make_record
from fitting._criteria import DEFAULT
from fitting.inference import _case_data as module
from fitting.inference._angle_noise import AngleNoise
from fitting.inference._case_data import (
    INERTIA_RATIO,
    CaseData,
    StartTimeNoise,
    blocks_of_window,
    camera_columns,
    largest_speed,
    start_response,
)
from fitting.inference._compression import compress
from fitting.inference._prior import Prior
from fitting.inference._process_noise import mean_acceleration
from fitting.inference._record import Samples


def samples(t, value, sigma=1e-3):
    return Samples(t, value, np.full(len(t), sigma))


def wheel(value=lambda t: 20.0 * t - t**2, *, span=8.0, count=800, sigma=1e-3, seed=0, **more):
    """One body alone, with white noise, whose correlation is not estimated."""
    t = np.linspace(0.0, span, count)
    noisy = value(t) + sigma * np.random.default_rng(seed).standard_normal(count)
    given = {"I_rotor": 1.0, "I_casing": 0.5, **more}
    data = CaseData.of(make_record(casing=(t, noisy, np.full(count, sigma)), rotor=[], **given))
    vars(data)["_correlated_noise"] = AngleNoise()
    return data


class TestStarts:
    """A window that slows down, whose start is uncertain by a millisecond."""

    def window(self, angle):
        t = np.linspace(2.0, 3.0, 200)
        return compress(samples(t, 300.0 * t - 4.0 * t**2 if angle else 300.0 - 8.0 * t), degree=5, blocks=1)

    def test_an_angle_moves_by_the_change_of_the_speed(self):
        """Its mean over the nodes is in the phase of the window."""
        window = self.window(True)
        speed = 300.0 - 8.0 * window.node_times
        assert start_response(window, angle=True) == pytest.approx(
            window.at_nodes(speed - speed.mean()), rel=1e-6, abs=1e-3
        )

    def test_a_speed_moves_by_the_acceleration(self):
        window = self.window(False)
        expected = window.at_nodes(np.full(len(window.node_times), -8.0))
        assert start_response(window, angle=False) == pytest.approx(expected, rel=1e-6, abs=1e-3)

    @pytest.mark.parametrize("angle", [True, False])
    def test_rows_are_whitened_by_their_covariance(self, angle):
        window = self.window(angle)
        c = start_response(window, angle=angle)
        found = StartTimeNoise.of([window, window], (0.0, 2e-3), 3, angle=angle)
        ((rows, *_),) = found.parts
        k = len(c)
        assert rows == slice(3 + k, 3 + 2 * k)
        covariance = np.eye(3 + 2 * k)
        covariance[rows, rows] += 4e-6 * np.outer(c, c)
        white = found.whitened(np.eye(3 + 2 * k))
        assert white @ covariance @ white.T == pytest.approx(np.eye(3 + 2 * k), abs=1e-9)
        assert found.unwhitened(white) == pytest.approx(np.eye(3 + 2 * k), abs=1e-9)
        assert found.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1])

    def test_only_unstated_starts_take_the_given_uncertainty(self):
        data = replace_record(gyroscope_data(), start_sigma=(math.nan, 2e-3))
        assert data.with_start_u(5e-3).record.start_sigma == (5e-3, 2e-3)

    def test_columns_of_unstated_starts(self):
        data = replace_record(gyroscope_data(), start_sigma=(1e-3, math.nan))
        ((index, column),) = data.start_columns()
        first = len(data.casing.z) + len(data.rotor[0].z)
        assert index == 1
        assert np.flatnonzero(column).min() >= first
        part = start_response(data.rotor[1], angle=True)
        assert data.unwhitened(column)[first : first + len(part)] == pytest.approx(part, rel=1e-9, abs=1e-12)


def replace_record(data, **changes):
    return replace(data, record=replace(data.record, **changes))


class TestBlocks:
    @pytest.mark.parametrize(
        ("share", "blocks"), [(0.1, 1), (0.24, 1), (0.26, 5), (0.5, 10), (1.0, 20), (2.0, 40), (9.0, 60)]
    )
    def test_of_a_window(self, share, blocks):
        """Twenty for the length of the record of the casing, one below a quarter of it, sixty at most."""
        casing = samples(np.linspace(3.0, 13.0, 50), np.zeros(50))
        window = samples(np.linspace(4.0, 4.0 + 10.0 * share, 50), np.zeros(50))
        assert blocks_of_window(window, casing) == blocks

    @pytest.mark.parametrize(("count", "rows"), [(8, 4), (9, 5), (14, 7), (15, 8), (60, 8)])
    def test_the_degree_of_a_short_window(self, count, rows):
        t, w = np.linspace(0.0, 12.0, 300), np.linspace(4.0, 5.0, count)
        noise = np.random.default_rng(0).standard_normal
        data = CaseData.of(
            make_record(
                casing=(t, 20.0 * t + 1e-3 * noise(300), np.full(300, 1e-3)),
                rotor=[(w, 300.0 * w + 1e-3 * noise(count), np.full(count, 1e-3))],
                I_rotor=1.0,
                I_casing=1.0,
            )
        )
        assert data.rotor[0].lift.shape == (1, rows, rows)

    @pytest.mark.parametrize(
        ("periods", "per_period", "blocks", "degree"),
        [
            (6, 60, 6, 15),
            (47, 60, 47, 15),
            (50, 60, 12, 24),
            (193, 60, 48, 24),
            (230, 60, 19, 50),
            (6, 10, 2, 5),
        ],
    )
    def test_of_an_oscillation(self, periods, per_period, blocks, degree):
        """One, four or twelve periods long; of ten samples each determines five coefficients."""
        t = np.arange(periods * per_period) / per_period
        value = 0.5 * np.cos(2 * np.pi * t)
        data = wheel(lambda _: value, span=t[-1], count=len(t), sigma=1e-4)
        assert data.oscillation is not None
        assert data.casing.lift.shape[:2] == (blocks, degree + 1)


@pytest.mark.parametrize(("back", "reverses"), [(0.04, False), (0.06, True)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("quantity", ["angle", "omega"])
def test_a_body_that_turns_back_has_no_steady_turns(back, reverses, sign, quantity):
    """The way back is a share of the path; the net rotation is nine tenths of it at a share of 0.05."""
    t = np.linspace(0.0, 1.0, 2001)
    speed = sign * np.where(t < 1 - back, 1.0, -1.0)
    angle = np.append(0.0, np.cumsum(speed[1:] * np.diff(t)))
    record = SimpleNamespace(quantity=quantity, casing=samples(t, angle if quantity == "angle" else speed))
    assert module._reverses(record) is reverses


@pytest.mark.parametrize(
    ("step", "gradients", "known"), [(0.9, False, True), (1.1, False, False), (0.9, True, False)]
)
def test_the_integral_of_slowly_sampled_speeds_is_not_an_angle(step, gradients, known):
    t = np.arange(100) / 10
    record = SimpleNamespace(
        quantity="omega", casing=samples(t, np.full(100, 10.0 * step)), gradients=gradients
    )
    found = module._turning_angle(record)
    assert (found is not None) is known
    assert not known or np.diff(found) == pytest.approx(step)


class TestInertia:
    def test_noise_that_depends_on_the_ratio_is_estimated_anew(self):
        data = CaseData.of(gyroscope_data().record)
        data.rotor_angle_noise  # noqa: B018 - estimated here
        rotor, casing = data.record.I_rotor, data.record.I_casing
        scaled = data.with_inertia(2 * rotor, 2 * casing)
        assert (scaled.record.I_rotor, scaled.record.I_casing) == (2 * rotor, 2 * casing)
        assert "rotor_angle_noise" in vars(scaled)
        for other in (data.with_inertia(2 * rotor, casing), data.with_inertia(rotor, 2 * casing)):
            assert "rotor_angle_noise" not in vars(other)
            assert "process_noise" in vars(other)

    def test_a_free_ratio_has_the_prior_of_both_stated_uncertainties(self):
        data = gyroscope_data()
        record = replace(
            data.record, I_rotor_u=0.03 * data.record.I_rotor, I_casing_u=0.04 * data.record.I_casing
        )
        fixed = replace(data, record=record)
        free = fixed.with_free_inertia(free=True)
        assert fixed.prior is None
        assert free.prior.names == (INERTIA_RATIO,)
        assert free.prior.mean == (0.0,)
        assert free.prior.covariance[0][0] == pytest.approx(0.05**2)
        assert data.with_free_inertia(free=True).prior is None
        assert free.prior_rows == 1
        assert len(free.z) == len(fixed.z) + 1

    def test_a_prior_of_another_study_is_kept(self):
        data = gyroscope_data()
        record = replace(
            data.record, I_rotor_u=0.03 * data.record.I_rotor, I_casing_u=0.04 * data.record.I_casing
        )
        friction = Prior(("touchpoint.constant.b1",), (1e-5,), ((1e-14,),), "a")
        both = replace(data, record=replace(record, prior=friction), free_inertia=True).prior
        assert both.names == ("touchpoint.constant.b1", INERTIA_RATIO)
        ratio = Prior((INERTIA_RATIO,), (0.1,), ((1e-4,),), "b")
        assert replace(data, record=replace(record, prior=ratio), free_inertia=True).prior is ratio


class TestLargestTorque:
    """Inertia times the largest acceleration of either body."""

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_of_a_body_alone(self, sign):
        data = wheel(lambda t: 20.0 * t + sign * t**2, sigma=1e-9)
        assert data.largest_torque == pytest.approx(0.5 * 2.0, rel=1e-3)

    @pytest.mark.parametrize(("rotor", "casing"), [(3.0, 1.0), (1.0, 3.0)])
    def test_of_two_bodies(self, rotor, casing):
        t, w = np.linspace(0.0, 12.0, 600), np.linspace(4.0, 6.0, 300)
        record = make_record(
            casing=(t, 20.0 * t - 0.5 * casing * t**2, np.full(600, 1e-9)),
            rotor=[(w, 300.0 * w - 0.5 * rotor * w**2, np.full(300, 1e-9))],
            I_rotor=1.0,
            I_casing=1.0,
        )
        data = SimpleNamespace(
            record=record,
            motion=SimpleNamespace(period=math.inf),
            casing=SimpleNamespace(samples=record.casing),
            rotor=[SimpleNamespace(samples=w) for w in record.rotor],
            is_angle=True,
        )
        assert CaseData.largest_torque.func(data) == pytest.approx(3.0, rel=1e-3)

    def test_of_an_oscillation_it_is_that_within_a_period(self):
        """Averages over a sixteenth of a period keep nearly all of a cos."""
        t = np.arange(1800) / 60
        data = wheel(lambda _: 0.5 * np.cos(2 * np.pi * t), span=t[-1], count=1800, sigma=1e-6)
        assert data.largest_torque == pytest.approx(0.5 * 0.5 * (2 * np.pi) ** 2, rel=0.1)


class TestHarmonicRows:
    @pytest.mark.parametrize("quantity", ["angle", "omega"])
    def test_the_response_to_a_white_acceleration(self, quantity):
        """The sum of the squared responses to an impulse in each step of a block, and the frequency of the row."""
        angle = quantity == "angle"
        data = wheel(lambda t: 30.0 * t if angle else np.full(len(t), 30.0), quantity=quantity)
        square, frequency = data.harmonic_row_responses
        assert frequency == pytest.approx(
            np.tile([30.0, 30.0, 60.0, 60.0], len(data.casing.operators)), rel=1e-3
        )
        k = data.casing.lift.shape[1]
        where, operator = data.casing.operators[5]
        t = data.casing.samples.time[where]
        since = t[:, None] - t
        response = np.maximum(since, 0.0) if angle else (since >= 0).astype(float)
        expected = np.sum((operator[k:] @ response) ** 2, axis=1) * (t[1] - t[0])
        assert square[20:24] == pytest.approx(expected, rel=1e-6, abs=1e-9 * expected.max())

    def test_a_stated_error_of_harmonics_lowers_the_response(self):
        plain, stated = (wheel(lambda t: 60.0 * t, correlated=(0.0, 0.0, 0.0, h)) for h in (0.0, 1e-3))
        scale = stated._harmonic_scale
        assert scale.max() > 2.0
        assert stated.harmonic_row_responses[0] * scale**2 == pytest.approx(plain.harmonic_row_responses[0])

    def test_rows_that_polynomials_represent_do_not_count(self):
        data = wheel(lambda t: 30.0 * t)
        exists = np.ones(len(data.casing.harmonic), dtype=bool)
        exists[:3] = False
        vars(data.casing)["harmonic_exists"] = exists
        assert data.row_count == len(data.z) - 3

    @pytest.mark.parametrize(("p_value", "free"), [(0.5, False), (2.0, True)])
    def test_a_response_to_the_angle_is_free_where_it_is_improbable(self, monkeypatch, p_value, free):
        monkeypatch.setattr(module, "p_value_of_response", lambda *_: DEFAULT.periodic_torque / p_value)
        data = wheel(lambda t: 30.0 * t)
        assert data.harmonic_responses.shape[1] == (4 if free else 0)


class TestCamera:
    def test_columns_are_harmonics_of_the_angle(self):
        t = np.linspace(0.0, 10.0, 2000)
        psi = -20.0 * t + 0.9 * t**2
        found = camera_columns(samples(t, psi), blurred=True)
        once = np.stack([np.cos(psi), np.sin(psi)], axis=1)
        omega = ((-20.0 + 1.8 * t) / 20.0)[:, None]
        assert found[:, :2] == pytest.approx(once)
        assert found[:, 2:4] == pytest.approx(np.stack([np.cos(2 * psi), np.sin(2 * psi)], axis=1))
        assert found[:, 4:6] == pytest.approx(omega * once, abs=0.02)
        assert found[:, 6:] == pytest.approx(omega**2 * once, abs=0.04)
        assert not camera_columns(samples(t, psi))[:, 6:].any()
        assert largest_speed(samples(t, psi)) == pytest.approx(20.0, rel=0.01)

    def test_pulses_once_per_turn_show_no_harmonics(self):
        psi = 2 * np.pi * np.arange(400.0)
        assert not camera_columns(samples(np.arange(400) / 10, psi))[:, :4].any()

    def test_few_samples_have_four_rough_speeds(self):
        knots, speed = module._rough_speeds(samples(np.arange(20.0), np.arange(20.0) ** 2))
        assert knots.tolist() == [0, 5, 10, 15]
        assert speed == pytest.approx([5.0, 10.0, 20.0, 25.0])
        knots, _ = module._rough_speeds(samples(np.arange(400.0), np.arange(400.0)))
        assert np.diff(knots).tolist() == [25] * 15

    def test_the_prior_of_its_amplitudes(self):
        """0.15 for the centre, 0.05 for the tilt, half a frame at the largest speed, 5 mrad of blur."""
        data = wheel(lambda t: 30.0 * t, span=8.0, count=801, tracked=True)
        sizes = np.repeat([0.15, 0.05, 0.5 * 0.01 * 30.0, 5e-3], 2)
        rows = data.nuisance[data.slices["nuisance_prior"]]
        found = 1 / rows[rows != 0]
        assert found == pytest.approx(sizes, rel=1e-3)
        assert data._camera_rows == pytest.approx(
            data.casing.at_samples(camera_columns(data.casing.samples, blurred=True))[0] * sizes, rel=2e-3
        )


class TestAngleNoise:
    @pytest.mark.parametrize(
        ("noise", "excess"),
        [
            ({"sigma": 0.9}, False),
            ({"sigma": 1.1}, True),
            ({"turn_sigma": 1.1}, True),
            ({"sigma": 0.1, "turn_sigma": 0.9}, False),
        ],
    )
    def test_a_noise_far_above_the_white_one_is_a_fault_of_the_measurement(self, noise, excess):
        data = CaseData.of(wheel().record)
        limit = DEFAULT.angle_noise_ratio * data.casing.scale * 1e-3
        known = AngleNoise(**{k: v * limit for k, v in noise.items()}, gain=99.0)
        vars(data)["_correlated_noise"] = known
        assert (data._excess_angle_noise(known, (data.casing,)) > 0) is excess
        assert data.angle_noise.is_white is excess
        assert len(data.findings) == excess
        assert all(f"by {1e3 * 1.1 * limit:.2g} mrad" in words for words in data.findings)

    @pytest.mark.parametrize(("body", "white"), [("casing", 2e-3), ("rotor", 4e-3)])
    def test_the_body_with_an_excessive_noise_is_named(self, body, white):
        """Beside the white noise of the casing, or the smallest one of the windows."""
        data = CaseData.of(gyroscope_data().record)
        rotor = tuple(replace(w, scale=s) for w, s in zip(data.rotor, (8.0, 4.0), strict=True))
        data = replace(data, casing=replace(data.casing, scale=2.0), rotor=rotor)
        size = 1.5 * DEFAULT.angle_noise_ratio * white
        for name, key in (("casing", "_correlated_noise"), ("rotor", "_correlated_rotor_noise")):
            vars(data)[key] = AngleNoise(sigma=size if name == body else 0.0, gain=99.0)
        (found,) = data.findings
        assert f"The angles of the {body} deviate" in found
        ratio = 1.5 * DEFAULT.angle_noise_ratio
        assert f"by {1e3 * size:.2g} mrad, {ratio:.0f} times their white noise" in found

    @pytest.mark.parametrize(("rows", "estimated"), [((7, 20), False), ((8, 20), True)])
    def test_windows_are_estimated_with_the_share_of_the_torque_on_the_rotor(
        self, monkeypatch, rows, estimated
    ):
        seen = []
        found = AngleNoise(sigma=1e-9)
        monkeypatch.setattr(
            module, "estimate_window_noise", lambda w, n, level, time: seen.append((level, time)) or found
        )
        data = CaseData.of(gyroscope_data().record)
        vars(data)["process_noise"] = SimpleNamespace(level=3.0, time=0.7)
        windows = tuple(replace(w, z=np.zeros(n)) for w, n in zip(data.rotor, rows, strict=True))
        data = replace(data, rotor=windows)
        vars(data)["process_noise"] = SimpleNamespace(level=3.0, time=0.7)
        assert (data._correlated_rotor_noise is found) is estimated
        if estimated:
            share = data.record.I_casing / data.record.I_rotor
            assert seen == [(pytest.approx(3.0 * share / math.sqrt(2)), 0.7)]

    def test_bodies_of_a_chain_are_estimated_with_the_torques_of_their_joints(self, monkeypatch):
        """Independent torques of one rms act in each joint, and on the main body from the ground as well."""
        monkeypatch.setattr(module, "camera_columns", lambda samples: np.zeros((4, 1)))
        monkeypatch.setattr(module, "_beyond_noise", lambda modes, samples: np.zeros((4, 1)))
        monkeypatch.setattr(module, "estimate_window_noise", lambda w, n, level, time: (level, time))
        joints = {"a": 2, "b": 3, "c": 1}
        bodies = [
            SimpleNamespace(state=s, part=p, inertia=i)
            for s, p, i in ((1, "a", 2.0), (0, "b", 4.0), (2, "c", 0.5))
        ]
        record = SimpleNamespace(
            generated=False, mechanism=SimpleNamespace(main="a", joints_of=joints.get), I_casing=2.0, bodies=bodies,
            rotor=[SimpleNamespace(state=2), SimpleNamespace(state=0)], is_chain=True,
        )  # fmt: skip
        window = SimpleNamespace(z=np.zeros(20), samples=None)
        data = SimpleNamespace(
            record=record, is_angle=True, rotor=(window, window), noiseless=False, mode_columns=(None, [None, None]),
            process_noise=SimpleNamespace(level=3.0, time=0.7),
        )  # fmt: skip
        level, time = CaseData._correlated_rotor_noise.func(data)
        torque = 2.0 * 3.0 / math.sqrt(3.0)
        assert level == pytest.approx([torque / 0.5, torque * math.sqrt(3.0) / 4.0])
        assert time == 0.7

    def test_a_correlated_error_lowers_the_number_of_independent_samples(self):
        """The spectral density at low frequencies over that of the white noise, by integration of both kernels."""
        t = np.linspace(0.0, 10.0, 1001)
        run = SimpleNamespace(samples=samples(t, 7.0 * t, 2e-3), scale=1.5)
        noise = AngleNoise(sigma=1e-3, time=0.3, turn_sigma=2e-3, turn_time=0.4)
        slow = 2 * quad(lambda x: 1e-6 * math.exp(-x / 0.3), 0, 9)[0]
        turning = 2 * quad(lambda x: 4e-6 * math.exp(-x / 0.4) * math.cos(7.0 * x), 0, 12, limit=200)[0]
        white = (1.5 * 2e-3) ** 2 * 0.01
        assert module._correlation(run, noise) == pytest.approx(1 + (slow + turning) / white, rel=1e-4)
        assert module._correlation(run, AngleNoise()) == 1.0


class TestProcessNoise:
    @pytest.mark.parametrize("quantity", ["angle", "omega"])
    def test_its_scale_is_at_most_the_mean_acceleration_of_angles(self, monkeypatch, quantity):
        seen = []
        monkeypatch.setattr(
            module, "estimate_process_noise", lambda run, free, root, **more: seen.append((free, more))
        )
        data = wheel(
            (lambda t: 30.0 * t - t**2) if quantity == "angle" else (lambda t: 30.0 - 2 * t),
            quantity=quantity,
        )
        data.process_noise  # noqa: B018 - estimated here
        ((free, more),) = seen
        angle = quantity == "angle"
        assert more == {"angle": angle, "typical": mean_acceleration(data.casing) if angle else math.inf}
        assert len(free) == len(data.casing.z)

    @pytest.mark.parametrize(("tracked", "kept"), [(True, 1), (False, 2)])
    def test_lines_below_the_noise_of_a_frame_are_noise(self, monkeypatch, tracked, kept):
        lines = [SimpleNamespace(amplitude=a, rate=5.0) for a in (0.5e-3, 2e-3)]
        monkeypatch.setattr(module, "spectral_lines", lambda *_: lines)
        data = wheel(lambda t: 30.0 * t, tracked=tracked)
        assert list(data.spectral_lines) == lines[2 - kept :]
        # their amplitudes are free, far beyond any angle
        assert np.linalg.norm(data._nuisance_rows, axis=0).max() > 1e5


@pytest.mark.parametrize(
    ("samples_per_period", "width"), [(10, 1), (64, 5), (320, 21), (5000, 51), (math.inf, 51)]
)
def test_speeds_are_smoothed_over_a_sixteenth_of_a_period_at_most(samples_per_period, width):
    found = replace(gyroscope_data(), motion=SimpleNamespace(samples_per_period=lambda n: samples_per_period))
    assert found.smoothing_width == width


@pytest.mark.parametrize("kept", [0.5, 2.0])
def test_error_modes_of_a_window_are_in_units_of_its_samples(kept):
    """Of uneven uncertainties: the directions, divided by these, are orthonormal and span the modes."""
    sigma = np.linspace(0.1, 0.4, 60)
    window = Samples(np.arange(60.0), np.zeros(60), sigma)
    modes = np.stack([np.ones(60), np.linspace(-1.0, 1.0, 60)], axis=1) * np.array([5.0, 1e-3])
    found = module._beyond_noise(modes, window)
    white = modes[:, 0] / sigma
    assert found.shape == (60, 1)
    assert np.abs(found[:, 0] / sigma) == pytest.approx(white / np.linalg.norm(white), rel=1e-3)


@pytest.mark.parametrize(
    ("drive", "turns_back", "steady"),
    [(False, False, True), (False, True, True), (True, False, True), (True, True, False)],
)
def test_only_a_driven_body_that_reverses_has_no_harmonics(drive, turns_back, steady):
    inputs = (Input("drive", [0.0, 4.0], [1.0, 2.0], "V", interpolation="hold"),) if drive else ()
    data = wheel(lambda t: 30.0 * np.minimum(t, 8.0 - t if turns_back else t), inputs=inputs)
    assert bool(len(data.casing.harmonic)) is steady


@pytest.mark.parametrize("is_angle", [True, False])
def test_responses_to_a_drive_are_those_of_the_measured_quantity(is_angle):
    """The speed 1 - exp(-t/tau) after a step, for a time constant of the length of the run, or its integral."""
    t = np.linspace(0.0, 8.0, 801)
    drive = Input("drive", [0.0, 4.0], [1.0, 2.0], "V", interpolation="hold")
    casing = SimpleNamespace(samples=SimpleNamespace(time=t), z=t, at_samples=lambda columns: (columns,))
    record = SimpleNamespace(driving=(drive,))
    rows = CaseData._driven_rows.func(SimpleNamespace(record=record, casing=casing, is_angle=is_angle))
    since = np.maximum(t - 4.0, 0.0)
    speed = 1.0 - np.exp(-since / 8.0)
    response = since - 8.0 * speed if is_angle else speed
    left = response - rows @ (rows.T @ response)
    assert np.abs(left).max() < 2e-3 * response.max()


@pytest.mark.parametrize(("rise", "driven"), [(0.9, False), (1.1, True)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_body_is_driven_that_becomes_a_tenth_faster(rise, driven, sign):
    speed = sign * np.array([10.0, 6.0, 4.0, 4.0 + rise, 2.0])
    record = SimpleNamespace(driving=True, spun=SimpleNamespace(state=1))
    speeds = np.stack([9.0 * np.arange(5.0), speed], axis=1)
    data = SimpleNamespace(record=record, initial_speeds=(np.arange(5.0), speeds))
    assert CaseData.driven.func(data) is driven
    assert CaseData.driven.func(SimpleNamespace(record=SimpleNamespace(driving=()))) is False


class TestKinks:
    """A casing in four blocks of 2 s and a window in one, whose speed jumps."""

    def rows(self, monkeypatch, kinks, *, smooth=True):
        t, w = np.linspace(0.0, 8.0, 800), np.linspace(3.0, 4.0, 100)
        casing = compress(samples(t, 30.0 * t), degree=5, angle=30.0 * t, blocks=4)
        window = compress(samples(w, 300.0 * w), degree=3, blocks=1)
        first = len(casing.z)
        count = first + len(window.z) + len(casing.harmonic)
        motion = {
            1: lambda time: np.cos(30.0 * time) + np.abs(time - 3.3),
            0: lambda time: np.abs(time - 3.3),
        }
        monkeypatch.setattr(module, "Sampler", lambda mesh, times: times)
        data = SimpleNamespace(
            motion=SimpleNamespace(is_smooth=smooth),
            record=SimpleNamespace(driving=()),
            casing=casing,
            rotor=(window,),
            slices={"harmonic": slice(first + len(window.z), count)},
            _observed=lambda times, path, state, nodes: motion[state](times),
        )
        path = SimpleNamespace(kinks=kinks, mesh=None)
        found = CaseData._projected_by_samples(data, path, None, np.full(count, 7.0))
        polynomial, harmonic = casing.at_samples(motion[1](t)[:, None])
        exact = [polynomial[:, 0], window.at_samples(motion[0](w)[:, None])[0][:, 0], harmonic[:, 0]]
        parts = np.split(found, [first, first + len(window.z)])
        return [(p.reshape(n, -1), e.reshape(n, -1)) for p, e, n in zip(parts, exact, (4, 1, 4), strict=True)]

    @pytest.mark.parametrize(
        ("kinks", "smooth", "blocks", "window"),
        [
            ((), True, (), False),
            ((3.3,), True, (1,), True),
            ((5.0, 7.9), True, (2, 3), False),
            ((), False, range(4), True),
        ],
    )
    def test_blocks_with_a_kink_are_projected_by_their_samples(
        self, monkeypatch, kinks, smooth, blocks, window
    ):
        (polynomial, exact), (of_window, exact_of_window), (harmonic, exact_harmonic) = self.rows(
            monkeypatch, kinks, smooth=smooth
        )
        for block in range(4):
            for found, known in ((polynomial, exact), (harmonic, exact_harmonic)):
                expected = known[block] if block in blocks else np.full(len(known[block]), 7.0)
                assert found[block] == pytest.approx(expected)
        assert np.abs(exact_harmonic).max() > 1.0
        assert of_window == pytest.approx(exact_of_window if window else np.full(of_window.shape, 7.0))


@pytest.mark.parametrize("stated", [(math.nan, math.nan, math.nan), (1e-3, math.nan, 0.0), (math.nan,), ()])
def test_columns_of_starts_are_in_the_rows_of_their_windows(monkeypatch, stated):
    """Of windows of 2, 3 and 1 rows after four rows of the casing; rows are whitened twice as large."""
    monkeypatch.setattr(
        module, "start_response", lambda window, *, angle: np.full(window.rows, window.rows + 10.0 * angle)
    )
    windows = [SimpleNamespace(rows=n) for n in (2, 3, 1)]
    data = SimpleNamespace(
        slices={"rotor": slice(4, 10)}, rotor=windows, z=np.zeros(12), is_angle=True,
        record=SimpleNamespace(start_sigma=stated), with_white_angles=lambda rows: 2 * rows,
    )  # fmt: skip
    found = dict(CaseData.start_columns(data))
    assert list(found) == [i for i, s in enumerate(stated) if math.isnan(s)]
    for i, column in found.items():
        first = 4 + (0, 2, 5)[i]
        expected = np.zeros(12)
        expected[first : first + windows[i].rows] = 2 * (10.0 + windows[i].rows)
        assert column.tolist() == expected.tolist()
