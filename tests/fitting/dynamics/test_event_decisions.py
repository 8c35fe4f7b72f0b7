"""Sense of motion, jumps of the derivatives and times of events, against the formulas of dry friction.

With unit inertia, stiffness k and dry friction b, a body released at x0 > b / k reverses every half period
pi / sqrt(k), its turning points fall by 2 b / k each, and it stays where the spring no longer exceeds friction.
"""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Model, SimulationError
from fitting.dynamics import _events as module
from fitting.dynamics._collocation import NODES, Mesh, Path, Sampler
from fitting.dynamics._events import Segments, halved, solve
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.dynamics._sensitivities import sensitivities

DRY, PUSH, SPRING = "touchpoint.constant", "external.constant", "casing.spring.linear"
UNIT = {INERTIA_ROTOR: 1.0, INERTIA_CASING: 2.0}


def pushed(push, friction=1.0, *names, **more):
    """Dry friction and a constant torque on a casing of inertia 2."""
    dynamics = Dynamics(Model.of((DRY, PUSH, *names)))
    return Segments(dynamics, {f"{DRY}.b1": friction, f"{PUSH}.k": push, **UNIT, **more}, ())


class TestSense:
    @pytest.mark.parametrize(
        ("push", "speed", "sense", "after"),
        [
            (0.0, 3.0, 1.0, 1.0),  # it moves
            (9.0, -3.0, -1.0, -1.0),
            (0.0, 0.0, 1.0, 0.0),  # it stops, and friction holds it
            (0.9, 0.0, 1.0, 0.0),
            (-0.9, 0.0, 1.0, 0.0),
            (-1.1, 0.0, 1.0, -1.0),  # it stops and reverses
            (1.1, 0.0, -1.0, 1.0),
            (0.9, 0.0, -1.0, 0.0),
            (1.1, 0.0, 0.0, 1.0),  # from rest
            (-1.1, 0.0, 0.0, -1.0),
            (0.9, 0.0, 0.0, 0.0),
            (-0.9, 0.0, 0.0, 0.0),
        ],
    )
    def test_a_casing_at_rest_moves_if_the_push_exceeds_friction(self, push, speed, sense, after):
        assert pushed(push).sense_after(0.0, np.array([5.0, speed]), sense) == after

    def test_without_dry_friction_nothing_is_held(self):
        run = Segments(Dynamics(Model.of([PUSH])), {f"{PUSH}.k": -1.0, **UNIT}, ())
        assert run.sense_after(0.0, np.zeros(2), 0.0) == 1.0

    @pytest.mark.parametrize(("push", "sense"), [(1.5, 1.0), (-1.5, -1.0)])
    def test_a_casing_is_released_in_the_sense_of_the_push(self, push, sense):
        assert pushed(push).released(0.0, np.zeros(2)) == sense
        assert pushed(push).acceleration(0.0, np.zeros(2), sense) == pytest.approx(sense * 0.25)

    def test_friction_opposes_the_motion(self):
        run = pushed(3.0)
        assert run.acceleration(0.0, np.zeros(2), 1.0) == pytest.approx(1.0)
        assert run.acceleration(0.0, np.zeros(2), -1.0) == pytest.approx(2.0)


class TestJumps:
    """f- = (p - b s) / I before, f+ after; the bearing adds a torque that acts on both bodies."""

    @pytest.mark.parametrize(
        ("push", "before", "after", "factor"),
        [
            (-3.0, 1.0, -1.0, (-3.0 + 1.0) / (-3.0 - 1.0)),
            (3.0, -1.0, 1.0, (3.0 - 1.0) / (3.0 + 1.0)),
            (-0.5, 1.0, 0.0, 0.0),  # held: the deviation of the speed vanishes
            (0.3, -1.0, 0.0, 0.0),
            (3.0, 0.0, 1.0, 1.0),  # from rest
        ],
    )
    def test_of_the_speed_of_the_casing(self, push, before, after, factor):
        found = pushed(push).saltation(0.0, np.array([5.0, 0.0]), before, after)
        assert found == pytest.approx(np.diag([1.0, factor]))

    def test_of_the_other_body(self):
        """A bearing whose dry friction changes its sense: the rotor's rate does not jump, the casing's does."""
        run = pushed(-3.0, 1.0, "bearing.linear", **{"bearing.linear.d": 0.1})
        found = run.saltation(0.0, np.array([5.0, 0.0]), 1.0, -1.0)
        drive = 0.1 * 5.0
        assert found == pytest.approx(np.diag([1.0, (drive - 3.0 + 1.0) / (drive - 3.0 - 1.0)]))

    def test_without_acceleration_there_is_no_jump(self):
        assert pushed(1.0).saltation(0.0, np.zeros(2), 1.0, -1.0) == pytest.approx(np.eye(2))

    def test_rates_that_are_not_finite_are_an_error(self):
        with pytest.raises(SimulationError):
            pushed(math.nan).saltation(0.0, np.zeros(2), 1.0, -1.0)

    def pieces(self, *senses):
        """Stretches of one interval each that end at rest."""
        return [
            Path(
                Mesh(np.array([i, i + 1.0])),
                np.zeros((1, NODES, 2)),
                np.zeros((2, 2)),
                ("omega_r", "omega_c"),
                np.array([s]),
            )
            for i, s in enumerate(senses)
        ]

    @pytest.mark.parametrize(
        ("push", "senses", "count"),
        [
            (3.0, (-1.0,), 1),
            (3.0, (1.0,), 0),  # the push would not reverse it
            (0.5, (-1.0,), 0),  # friction holds it
            (3.0, (-1.0, 1.0), 1),
            (3.0, (-1.0, -1.0), 0),  # the next stretch has another sense
            (3.0, (0.0, 1.0), 0),
            (3.0, (), 0),
        ],
    )
    def test_reversals_until_the_first_rest(self, push, senses, count):
        run = pushed(push)
        found = run.reversals(self.pieces(*senses))
        assert len(found) == count
        for matrix in found:
            assert matrix == pytest.approx(run.saltation(0.0, np.zeros(2), -1.0, 1.0))


def released(x0, stiffness, friction, span=9.0, guess=None, **options):
    dynamics = Dynamics(Model.of([SPRING, DRY]))
    numbers = {f"{SPRING}.k": stiffness, f"{DRY}.b1": friction, INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
    path = solve(dynamics, numbers, np.array([0.0, 0.0, x0]), Mesh.uniform(0.0, span, 36), guess, **options)
    return dynamics, numbers, path


class TestOscillation:
    """k = 10, b = 0.3: the turning points are 1, -0.94, 0.88 ... at multiples of pi / sqrt(10)."""

    @pytest.mark.parametrize("x0", [1.0, -1.0])
    @pytest.mark.parametrize("from_another", [False, True])
    def test_reversals_are_at_half_periods_with_linearly_falling_amplitudes(self, x0, from_another):
        guess = released(x0, 10.1, 0.28)[2] if from_another else None
        dynamics, numbers, path = released(x0, 10.0, 0.3, guess=guess)
        half = math.pi / math.sqrt(10.0)
        count = int(9.0 / half)
        assert path.kinks == pytest.approx(half * np.arange(1, count + 1), abs=1e-8)
        turning = x0 * (-1.0) ** np.arange(1, count + 1) * (1 - 0.06 * np.arange(1, count + 1))
        places = sorted(path.jumps)
        assert path.edges[places, 2] == pytest.approx(turning, abs=1e-8)
        assert path.sense[[p - 1 for p in places]].tolist() == [
            -np.sign(x0) * (-1.0) ** i for i in range(count)
        ]
        # the derivatives of the last turning point: -2 n by b / k, n (2 b / k) / k by k, and (-1)^n by the start
        end = released(x0, 10.0, 0.3, span=(count + 0.5) * half)[2]
        slope = sensitivities(dynamics, numbers, end).edges
        at, sign = sorted(end.jumps)[-1], np.sign(x0) * (-1.0) ** count
        keys = list(dynamics.parameters)
        assert slope[at, 2, keys.index(f"{DRY}.b1")] == pytest.approx(-2 * count * sign / 10.0, abs=1e-6)
        assert slope[at, 2, keys.index(f"{SPRING}.k")] == pytest.approx(
            2 * count * sign * 0.3 / 100.0, abs=1e-6
        )

    @pytest.mark.parametrize("from_another", [False, True])
    def test_it_rests_where_friction_exceeds_the_spring(self, from_another):
        """b / k = 0.12: 1, -0.76, 0.52, -0.28, 0.04, where it stays."""
        guess = released(1.0, 10.1, 1.19)[2] if from_another else None
        _, _, path = released(1.0, 10.0, 1.2, guess=guess)
        half = math.pi / math.sqrt(10.0)
        assert path.kinks == pytest.approx(half * np.arange(1, 5), abs=1e-8)
        assert path.edges[-1] == pytest.approx([0.0, 0.0, 0.04], abs=1e-8)
        assert path.sense[-1] == 0.0

    def test_a_body_that_friction_holds_at_once(self):
        _, _, path = released(0.1, 10.0, 1.2)
        assert (path.y[..., 2] == 0.1).all()
        assert path.kinks == ()

    def test_too_many_events_are_refused(self):
        with pytest.raises(SimulationError, match="too often"):
            released(1.0, 10.0, 0.3, most=4)
        assert released(1.0, 10.0, 0.3, most=10)[2].kinks


class TestRelease:
    """Friction 2 - 0.4 t holds a push of 1 until t = 2.5 s."""

    NAMES = (DRY, PUSH, "touchpoint.drift")

    def run(self, push, drift=-0.4, step=None):
        names = self.NAMES if step is None else (*self.NAMES, "touchpoint.step")
        numbers = {f"{DRY}.b1": 2.0, f"{PUSH}.k": push, "touchpoint.drift.k": drift, **UNIT}
        if step is not None:
            numbers |= {"touchpoint.step.k": -1.5, "touchpoint.step.t0": step}
        dynamics = Dynamics(Model.of(names))
        return solve(dynamics, numbers, np.zeros(2), Mesh.uniform(0.0, 4.0, 5))

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_casing_is_released_when_friction_has_fallen_below_the_push(self, sign):
        path = self.run(sign)
        assert path.kinks == pytest.approx((2.5,), abs=1e-9)
        assert path.sense.tolist()[-1] == sign
        # I w' = p - (2 - 0.4 t): w = 0.2 (t - 2.5)^2 / 2
        assert path.edges[-1, 1] == pytest.approx(sign * 0.4 * 1.5**2 / 2 / 2.0)

    def test_friction_that_never_falls_below_holds_it(self):
        path = self.run(0.3)
        assert path.kinks == ()
        assert (path.edges[:, 1] == 0.0).all()

    def test_a_step_of_friction_releases_it_at_its_time(self):
        path = self.run(1.0, drift=0.0, step=1.3)
        assert path.kinks == (1.3,)
        assert path.edges[-1, 1] == pytest.approx((1.0 - 0.5) * 2.7 / 2.0)


class TestPaths:
    def straight(self, *speeds, sense=1.0, edges=None):
        """A path whose speed is linear between these values at the edges; the angle of the rotor counts intervals."""
        at = np.arange(len(speeds), dtype=float) if edges is None else np.array(edges)
        mesh = Mesh(at)
        y = np.stack([np.zeros_like(mesh.times), np.interp(mesh.times, at, speeds)], axis=-1)
        states = np.column_stack([np.zeros(len(at)), speeds])
        return Path(mesh, y, states, ("omega_r", "omega_c"), np.full(len(at) - 1, sense))

    @pytest.mark.parametrize(
        ("speeds", "sense", "expected"),
        [
            ((3.0, 1.0, 0.5), 1.0, None),
            ((3.0, 1.0, -1.0), 1.0, 1.5),
            ((-3.0, -1.0, 1.0), -1.0, 1.5),
            ((3.0, 1.0, -1.0), -1.0, 0.0),
            ((3.0, 1.0, -1e-11), 1.0, None),  # rounding
        ],
    )
    def test_the_first_crossing_of_the_speed(self, speeds, sense, expected):
        found = module._first_crossing(self.straight(*speeds, sense=sense))
        assert found == expected if expected is None else found == pytest.approx(expected, abs=0.02)

    def test_intervals_are_halved_with_their_senses_and_jumps(self):
        path = replace(
            self.straight(0.0, 2.0, 1.0, 5.0),
            sense=np.array([1.0, -1.0, 0.0]),
            jumps={1: "first", 2: "second"},
        )
        found = halved(path, np.array([True, False, True]), 6)
        assert found.mesh.edges.tolist() == [0.0, 0.5, 1.0, 2.0, 2.5, 3.0]
        assert found.edges[:, 1] == pytest.approx([0.0, 1.0, 2.0, 1.0, 3.0, 5.0])
        assert found.sense.tolist() == [1.0, 1.0, -1.0, 0.0, 0.0]
        assert found.jumps == {2: "first", 3: "second"}
        assert found.y[..., 1] == pytest.approx(np.interp(found.mesh.times, [0, 1, 2, 3], [0, 2, 1, 5]))
        with pytest.raises(SimulationError):
            halved(path, np.array([True, False, True]), 5)

    def test_a_path_up_to_an_edge(self):
        path = replace(self.straight(0.0, 2.0, 1.0, 5.0), jumps={1: "first", 2: "second"})
        found = module._until(path, 2)
        assert found.mesh.edges.tolist() == [0.0, 1.0, 2.0]
        assert (len(found.y), len(found.edges), len(found.sense)) == (2, 3, 2)
        assert found.jumps == {1: "first"}

    def test_a_path_at_rest_has_no_speed(self):
        path = self.straight(1.0, 2.0)
        found = module._at_rest(path)
        assert not found.y[..., 1].any()
        assert not found.edges[:, 1].any()
        assert path.edges[1, 1] == 2.0

    def test_stretches_are_joined_with_their_events(self):
        pieces = [self.straight(1.0, 0.0), self.straight(0.0, -1.0, -2.0, sense=-1.0, edges=(1.0, 2.0, 4.0))]
        found = module._joined(pieces, ["jump"], (3.0,))
        assert found.mesh.edges.tolist() == [0.0, 1.0, 2.0, 4.0]
        assert found.edges[:, 1].tolist() == [1.0, 0.0, -1.0, -2.0]
        assert found.sense.tolist() == [1.0, -1.0, -1.0]
        assert (found.kinks, found.jumps) == ((1.0, 3.0), {1: "jump"})
        assert module._joined(pieces[:1], [], (0.5,)).kinks == (0.5,)

    @pytest.mark.parametrize(
        ("pieces", "count"),
        [
            ([(1.0, (2.0, 0.0)), (-1.0, (0.0, -2.0))], 2),
            ([(1.0, (2.0, 0.0)), (-1.0, (0.0, 2.0))], 1),  # the second one moves against its sense
            ([(1.0, (-2.0, 0.0))], 0),
            ([(1.0, (2.0, -1e-11))], 1),  # rounding
        ],
    )
    def test_stretches_are_valid_until_one_moves_against_its_sense(self, pieces, count):
        paths = [self.straight(*speeds, sense=sense) for sense, speeds in pieces]
        assert len(pushed(0.0)._valid(paths)) == count

    @pytest.mark.parametrize(("push", "count"), [(0.5, 2), (1.5, 1)])
    def test_rest_is_valid_while_friction_holds(self, push, count):
        paths = [self.straight(2.0, 0.0), self.straight(0.0, 0.0, sense=0.0)]
        assert len(pushed(push)._valid(paths)) == count

    @pytest.mark.parametrize(
        ("speed", "end", "braked", "rests"),
        [(0.0, 2.0, True, True), (1e-8, 2.0, True, False), (0.0, 1.0, True, False), (0.0, 2.0, False, False)],
    )
    def test_when_a_stretch_ends_at_rest(self, speed, end, braked, rests):
        """Before the end of the record, with no speed left, decelerated by friction."""
        run = pushed(0.0 if braked else 3.0)
        assert run._rests(self.straight(3.0, speed), end) is rests

    def test_a_law_that_sets_in_before_the_stop_must_be_an_edge(self):
        run = replace(pushed(0.0), breaks=(0.5,))
        assert not run._rests(self.straight(3.0, 0.0), 2.0)
        assert run._rests(self.straight(3.0, 1.5, 0.0, edges=(0.0, 0.5, 1.0)), 2.0)
        assert replace(run, breaks=(1.5,))._rests(self.straight(3.0, 0.0), 2.0)


class TestBeginning:
    """A known motion with reversals at 1 s and 2 s, that begins in the positive sense."""

    def known(self, first=1.0):
        edges = np.array([0.0, first, first + 1.0, first + 2.0])
        speeds = np.array([0.1, 0.0, 0.0, 1.0])
        y = np.zeros((3, NODES, 2))
        states = np.column_stack([np.zeros(4), speeds])
        return Path(
            Mesh(edges), y, states, ("omega_r", "omega_c"), np.array([1.0, -1.0, 1.0]), (first, first + 1.0),
            {1: np.eye(2), 2: np.eye(2)},
        )  # fmt: skip

    def test_the_same_sense_keeps_it(self):
        found = pushed(-3.0)._with_beginning(np.array([0.0, 0.1]), 1.0, self.known())
        assert found.mesh.edges.tolist() == [0.0, 1.0, 2.0, 3.0]
        assert sorted(found.jumps) == [1, 2]

    @pytest.mark.parametrize(("first", "count"), [(0.09, 1), (0.11, 2)])
    def test_a_first_stretch_shorter_than_a_tenth_is_determined_again(self, first, count):
        sense = -1.0 if count == 1 else 1.0
        found = pushed(3.0)._with_beginning(np.array([0.0, 0.01 * sense]), sense, self.known(first))
        reversals = [first, first + 1.0][-count:]
        assert found.mesh.edges[sorted(found.jumps)] == pytest.approx(reversals)
        assert found.mesh.edges[0] == 0.0
        assert found.mesh.edges[-1] == pytest.approx(first + 2.0)
        assert found.sense[0] == sense

    @pytest.mark.parametrize(("speed", "found"), [(-0.1, True), (-0.59, True), (-0.61, False), (0.1, False)])
    def test_a_stretch_in_the_other_sense_is_added(self, speed, found):
        """With a push of 3 and friction of 1 on an inertia of 2, a speed of -0.2 is gone after 0.1 s; up to 0.3 s."""
        start = np.array([0.0, speed])
        path = pushed(3.0)._with_beginning(start, -1.0, self.known())
        assert (path is not None) is found
        if found:
            delay = -speed / 2.0
            assert path.mesh.edges[:3] == pytest.approx([0.0, delay, 1.0])
            assert path.sense.tolist() == [-1.0, 1.0, -1.0, 1.0]
            assert sorted(path.jumps) == [1, 2, 3]
            assert path.edges[0] == pytest.approx(start)
            assert path.edges[1, 1] == 0.0
            share = (path.mesh.times[0]) / delay
            assert path.y[0, :, 1] == pytest.approx(speed * (1 - share))


def test_a_stop_at_the_end_of_the_record_is_not_an_event():
    """w = 5 - t / 2: at rest after 10 s."""
    run = pushed(0.0)
    for span, stops in ((9.9, ()), (10.1, (10.0,))):
        path = solve(run.dynamics, run.numbers, np.array([0.0, 5.0]), Mesh.uniform(0.0, span, 4))
        assert path.kinks == pytest.approx(stops)
        t = np.linspace(0.0, span, 50)
        exact = np.maximum(5.0 - 0.5 * t, 0.0)
        assert Sampler(path.mesh, t).value(path.y)[:, 1] == pytest.approx(exact, abs=1e-9)


class TestUntilRest:
    """Where the stop is no unknown of the equations, it is found by Newton steps on the speed at the end."""

    def stopped(self, monkeypatch, run, start, span, sense, guess):
        monkeypatch.setattr(Segments, "_rests", lambda *_: False)
        mesh = Mesh.uniform(0.0, span, 6)
        path = run._rough(start, mesh, sense, None)
        return run._until_rest(path, mesh, guess)

    @pytest.mark.parametrize("guess", [9.2, 10.4])
    @pytest.mark.parametrize("sense", [1.0, -1.0])
    def test_a_constant_deceleration(self, monkeypatch, sense, guess):
        """w = 5 - t / 2."""
        found = self.stopped(monkeypatch, pushed(0.0), np.array([0.0, 5.0 * sense]), 14.0, sense, guess)
        assert found.mesh.edges[-1] == pytest.approx(10.0, abs=1e-9)
        assert found.edges[-1, 1] == pytest.approx(0.0, abs=1e-9)

    def test_a_deceleration_that_grows(self, monkeypatch):
        """I w' = -1 - 0.2 t: w = 5 - t / 2 - t^2 / 20 vanishes at sqrt(125) - 5."""
        run = pushed(0.0, 1.0, "touchpoint.drift", **{"touchpoint.drift.k": 0.2})
        found = self.stopped(monkeypatch, run, np.array([0.0, 5.0]), 9.0, 1.0, 7.0)
        assert found.mesh.edges[-1] == pytest.approx(math.sqrt(125.0) - 5.0, abs=1e-8)

    def test_the_first_of_several_crossings(self, monkeypatch):
        """w = cos t, and a guess at its second zero."""
        dynamics = Dynamics(Model.of([SPRING, DRY]))
        numbers = {f"{SPRING}.k": 1.0, f"{DRY}.b1": 0.0, INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
        run = Segments(dynamics, numbers, ())
        found = self.stopped(monkeypatch, run, np.array([0.0, 1.0, 0.0]), 6.0, 1.0, 4.7)
        assert found.mesh.edges[-1] == pytest.approx(math.pi / 2, abs=1e-8)

    def test_a_casing_that_does_not_stop_within_the_record(self, monkeypatch):
        found = self.stopped(monkeypatch, pushed(0.0), np.array([0.0, 5.0]), 9.0, 1.0, 8.0)
        assert found.mesh.edges[-1] == 9.0
        assert found.edges[-1, 1] == pytest.approx(0.5)


class TestKnownOscillation:
    """Three reversals: stretches start from the guess, with errors relative to a thousandth of its largest speed."""

    @pytest.mark.parametrize(("reversals", "scale", "horizon"), [(3, 5e-3, 6.0), (2, None, math.inf)])
    def test_scale_and_horizon(self, monkeypatch, reversals, scale, horizon):
        """Its speed is -5 to 2 rad/s; it reverses at 1 s, 2 s and 5 s."""
        dynamics = Dynamics(Model.of((SPRING, DRY)))
        numbers = {f"{SPRING}.k": 1.0, f"{DRY}.b1": 0.01, INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
        mesh, asked = Mesh(np.array([0.0, 1.0, 2.0, 5.0, 9.0])), []
        y = np.zeros((4, NODES, 3))
        y[..., 1] = np.array([-5.0, 2.0, -1.0, 0.5])[:, None]
        jumps = dict.fromkeys(range(1, 1 + reversals), np.eye(3))
        guess = SimpleNamespace(y=y, mesh=mesh, jumps=jumps, exact=False)

        def oscillating(self, start, sense, guess):
            asked.append(self.least_scale)
            return []

        def moving(self, start, mesh, span, sense, guess, horizon):
            asked.append(horizon)
            raise SimulationError("no stretch")

        monkeypatch.setattr(Segments, "oscillating", oscillating)
        monkeypatch.setattr(Segments, "moving", moving)
        with pytest.raises(SimulationError, match="no stretch"):
            solve(
                dynamics, numbers, np.array([0.0, -3.0, 1.0]), Mesh.uniform(0.0, 9.0, 9), guess=guess, most=9
            )
        assert asked == ([horizon] if scale is None else [pytest.approx(scale), horizon])


class TestContinued:
    """A known stretch from 0 to 2 s, and a motion that begins at 0.5 s in a record of 4 s."""

    class Given(Segments):
        """What is solved is the initial solution; rest and release are given."""

        def _solved(self, first, pivot=None):
            if self.numbers["fails"]:
                raise SimulationError("no motion")
            self.numbers["solved"].append(pivot)
            return first

        def _rests(self, path, end):
            return self.numbers["rests"]

        def _release(self, path):
            return self.numbers["release"]

    def found(
        self, monkeypatch, *, sense=1.0, known_sense=1.0, stops=True, breaks=(), kinks=(), time=0.5, rests=True,
        release=None, speeds=(3.0, 0.0), fails=False, dry=True,
    ):  # fmt: skip
        monkeypatch.setattr(module, "coarsened", lambda path: path)
        numbers = {"rests": rests, "release": release, "fails": fails, "solved": []}
        run = self.Given(SimpleNamespace(dry=dry), numbers, breaks)
        edges = [0.0, *kinks, 2.0]
        values = np.interp(edges, [0.0, 2.0], speeds)
        known = replace(TestPaths().straight(*values, sense=known_sense, edges=edges), kinks=kinks)
        start = np.array([7.0, 5.0])
        path = run.continued(start, time, 4.0, sense, known, stops=stops)
        return path, numbers["solved"]

    @pytest.mark.parametrize(
        ("given", "edges", "pivot"),
        [
            ({}, [0.5, 2.0], 0.5),  # until the stop of the known motion
            ({"stops": False}, [0.5, 4.0], None),  # until the end of the record
            ({"breaks": (1.5,), "kinks": (1.2,)}, [0.5, 1.5, 2.0], 1.5),  # a law sets in later than in the known motion
            ({"breaks": (3.0,)}, [0.5, 2.0], 0.5),  # after the stop
            ({"breaks": (0.3,)}, [0.5, 2.0], 0.5),  # before the beginning
            ({"breaks": (3.0,), "kinks": (1.2,), "stops": False}, [0.5, 3.0, 4.0], None),
            ({"sense": 0.0, "known_sense": 0.0, "stops": False, "speeds": (0.0, 0.0)}, [0.5, 4.0], None),
            ({"speeds": (3.0, -1.0), "dry": False}, [0.5, 2.0], 0.5),  # without dry friction a reversal is no event
        ],
    )  # fmt: skip
    def test_the_same_events_are_at_other_times(self, monkeypatch, given, edges, pivot):
        path, solved = self.found(monkeypatch, **given)
        assert path.mesh.edges == pytest.approx(edges)
        assert path.edges[0].tolist() == [7.0, 5.0]
        assert solved == [pivot]

    @pytest.mark.parametrize(
        "given",
        [
            {"sense": -1.0},
            {"known_sense": 0.0},
            {"sense": 0.0, "known_sense": 0.0, "stops": True, "speeds": (0.0, 0.0)},  # it starts again
            {"sense": 0.0, "known_sense": 0.0, "stops": False, "speeds": (0.0, 0.0), "release": 3.0},
            {"breaks": (1.0,)},  # a law sets in that did not
            {"kinks": (1.2,)},  # one no longer sets in
            {"time": 2.0},
            {"rests": False},
            {"speeds": (3.0, -1.0)},
            {"fails": True},
        ],
    )
    def test_another_sequence_of_events_is_not_continued(self, monkeypatch, given):
        assert self.found(monkeypatch, **given)[0] is None


class TestManyReversals:
    """A known motion of 5 s that reverses each second."""

    def found(self, monkeypatch, *, until=9.0, exact=True, kinks=(), breaks=(), known=True):
        """Solve all stretches at once, which succeeds for a motion up to some time."""
        solved = []

        def resolved(self, path):
            solved.append(path)
            if path.mesh.edges[-1] > until:
                raise SimulationError("no motion")
            return path

        edges = np.array(sorted({*range(6), *kinks}), dtype=float)
        at = np.flatnonzero(np.isin(edges, range(1, 5)))
        motion = replace(
            TestPaths().straight(*np.ones(len(edges)), edges=edges),
            kinks=(1.0, 2.0, 3.0, 4.0, *kinks), jumps={int(i): np.eye(2) for i in at}, exact=exact,
        )  # fmt: skip
        monkeypatch.setattr(Segments, "_resolved", resolved)
        monkeypatch.setattr(Segments, "_valid", lambda self, pieces: pieces)
        adapted = replace(motion, kinks=motion.breaks) if known else None
        monkeypatch.setattr(Segments, "_with_beginning", lambda *_: adapted)
        run = Segments(SimpleNamespace(dry=True), {}, breaks)
        return run.oscillating(np.array([7.0, 0.2]), 1.0, motion), solved

    @pytest.mark.parametrize(
        ("until", "exact", "stretches", "tried"),
        [
            (5.0, True, 5, [5.0]),
            (4.9, True, 0, [5.0, 5.0]),  # near a known solution 100 and 97 % of the reversals are tried
            (4.9, False, 3, [5.0, 5.0, 5.0, 4.0]),  # near the measured motion 90, 70 and 40 % as well
            (3.9, False, 2, [5.0, 5.0, 5.0, 4.0, 3.0]),
            (2.9, False, 0, [5.0, 5.0, 5.0, 4.0, 3.0]),
        ],
    )
    def test_as_many_stretches_as_can_be_solved(self, monkeypatch, until, exact, stretches, tried):
        """The last one of an incomplete motion does not end with an event, and is left out."""
        pieces, solved = self.found(monkeypatch, until=until, exact=exact)
        assert [p.mesh.edges.tolist() for p in pieces] == [[i, i + 1.0] for i in range(stretches)]
        assert [p.mesh.edges[-1] for p in solved] == tried
        assert all(p.edges[0].tolist() == [7.0, 0.2] for p in solved)

    @pytest.mark.parametrize(
        ("kinks", "breaks", "edges"),
        [
            ((1.5,), (1.8,), [0.0, 1.0, 1.8, 2.0, 3.0, 4.0, 5.0]),
            ((1.5,), (2.5,), None),  # after another reversal
            ((1.5,), (), None),
            ((), (1.5,), None),
        ],
    )
    def test_laws_set_in_between_the_same_reversals(self, monkeypatch, kinks, breaks, edges):
        pieces, solved = self.found(monkeypatch, kinks=kinks, breaks=breaks)
        assert (len(pieces), len(solved)) == ((5, 1) if edges else (0, 0))
        assert not edges or solved[0].mesh.edges == pytest.approx(edges)

    def test_newton_steps_move_all_reversals_to_their_times(self, monkeypatch):
        """From an oscillation that is 0.5 % faster: the error of a step is the square of the one before."""
        guess = released(1.0, 10.1, 0.28)[2]
        dynamics, numbers, _ = released(1.0, 10.0, 0.3)
        steps, tangent = [], Dynamics.tangent
        monkeypatch.setattr(Dynamics, "tangent", lambda self, *rest: steps.append(1) or tangent(self, *rest))
        found = Segments(dynamics, numbers, ()).oscillating(np.array([0.0, 0.0, 1.0]), -1.0, guess)
        times = math.pi / math.sqrt(10.0) * np.arange(1, 10)
        assert [p.mesh.edges[-1] for p in found] == pytest.approx([*times, 9.0], abs=1e-9)
        assert len(steps) <= 4

    def test_another_beginning_is_not_known(self, monkeypatch):
        assert self.found(monkeypatch, known=False) == ([], [])


class TestHorizon:
    """A stop is sought within one second of a record of 8 s, then within four times as long."""

    def tried(self, monkeypatch, stops, *, rest=None, dry=True):
        """Return the ends of the stretches that were solved, and that of the path; `stops` are where it reverses."""
        tried = []

        def rough(self, start, mesh, sense, guess):
            tried.append(mesh.edges[-1])
            return SimpleNamespace(mesh=mesh, refined=False)

        monkeypatch.setattr(Segments, "_rough", rough)
        monkeypatch.setattr(
            module, "refine", lambda dynamics, numbers, path, **_: replace_path(path, refined=True)
        )
        monkeypatch.setattr(
            Segments,
            "_until_rest",
            lambda self, path, part, stop: replace_path(path, mesh=Mesh.uniform(0.0, rest or stop, 4)),
        )

        def known(path):
            shown = [s for s, when in stops if s < path.mesh.edges[-1] and path.refined >= when]
            return shown[0] if shown else None

        monkeypatch.setattr(module, "_first_crossing", known)
        run = Segments(SimpleNamespace(dry=dry), {}, ())
        path = run.moving(np.zeros(2), Mesh.uniform(0.0, 8.0, 16), (0.0, 8.0), 1.0, None, 1.0)
        return tried, path.mesh.edges[-1], path.refined

    @pytest.mark.parametrize(
        ("stops", "tried", "end", "refined"),
        [
            ((), [1.0, 4.0, 8.0], 8.0, True),
            (((0.5, False),), [1.0], 0.5, False),
            (((3.2, False),), [1.0, 4.0], 3.2, False),
            (((3.2, True),), [1.0, 4.0], 3.2, True),  # a stop that only the refined solution shows
        ],
    )
    def test_the_first_stop_ends_the_search(self, monkeypatch, stops, tried, end, refined):
        assert self.tried(monkeypatch, stops) == (tried, end, refined)

    def test_a_stop_that_is_none_continues_the_search(self, monkeypatch):
        """What looked like a reversal before 1 s is none up to there."""
        assert self.tried(monkeypatch, ((0.9, False),), rest=1.0)[0] == [1.0, 4.0]

    def test_a_reversal_without_dry_friction_does_not_end_the_search(self, monkeypatch):
        assert self.tried(monkeypatch, ((0.5, False),), dry=False) == ([1.0, 4.0, 8.0], 8.0, True)


def replace_path(path, **changes):
    return SimpleNamespace(**{**vars(path), **changes})


@cache
def known_swings():
    dynamics = Dynamics(Model.of((DRY, SPRING)))
    numbers = {f"{SPRING}.k": 8.0, f"{DRY}.b1": 0.2, **UNIT}
    return dynamics, solve(dynamics, numbers, np.array([5.0, 2.0, 0.0]), Mesh.uniform(0.0, 9.0, 40))


class TestSimultaneousReversals:
    """A spring with dry friction: from a solution for other numbers, all reversals are found at once."""

    FIRST = np.array([5.0, 2.0, 0.0])

    def numbers(self, k, b):
        return {f"{SPRING}.k": k, f"{DRY}.b1": b, **UNIT}

    def exact(self, k, b, count):
        """Return times and deflections of the turning points of a body of inertia 2 that begins at 2 rad/s."""
        w, rest = math.sqrt(k / 2.0), b / k
        times, places = [math.atan2(2.0 / w, rest) / w], [math.hypot(rest, 2.0 / w) - rest]
        for _ in range(count - 1):
            sense = -math.copysign(1.0, places[-1])
            times.append(times[-1] + math.pi / w)
            # about the equilibrium -sense rest
            places.append(-2 * sense * rest - places[-1])
        return np.array(times), np.array(places)

    @pytest.mark.parametrize(("k", "b"), [(8.0, 0.2), (8.3, 0.2), (7.8, 0.26), (8.2, 0.24)])
    def test_they_are_those_of_the_exact_motion(self, k, b):
        dynamics, known = known_swings()
        turns = sorted(known.jumps)
        assert len(turns) == 6
        times, places = self.exact(8.0, 0.2, 6)
        assert known.mesh.edges[turns] == pytest.approx(times, abs=1e-6)
        assert known.edges[turns, 2] == pytest.approx(places, abs=1e-6)
        pieces = Segments(dynamics, self.numbers(k, b), ()).oscillating(self.FIRST, 1.0, known)
        assert len(pieces) == 7
        times, places = self.exact(k, b, 6)
        w, last = math.sqrt(k / 2.0), (0.0, None)
        for i, piece in enumerate(pieces):
            sense = 1.0 - 2.0 * (i % 2)
            assert (piece.sense == sense).all()
            end = times[i] if i < 6 else 9.0
            assert (piece.mesh.edges[0], piece.mesh.edges[-1]) == (
                pytest.approx(last[0], abs=1e-6), pytest.approx(end, abs=1e-6),
            )  # fmt: skip
            centre, turn = -sense * b / k, (times[i], places[i]) if i < 6 else last
            at = piece.mesh.times
            x = centre + (turn[1] - centre) * np.cos(w * (at - turn[0]))
            v = -(turn[1] - centre) * w * np.sin(w * (at - turn[0]))
            assert piece.y[..., 2] == pytest.approx(x, abs=2e-6)
            assert piece.y[..., 1] == pytest.approx(v, abs=5e-6)
            assert (piece.y[..., 0] == 5.0).all()
            if i < 6:
                assert piece.edges[-1, 1] == pytest.approx(0.0, abs=1e-9)
                assert piece.edges[-1, 2] == pytest.approx(places[i], abs=2e-6)
                last = turn

    def test_a_motion_without_the_known_reversals_is_not_found(self):
        """With a fifth of the stiffness they are a factor of 2.2 later."""
        dynamics, known = known_swings()
        assert Segments(dynamics, self.numbers(1.6, 0.2), ()).oscillating(self.FIRST, 1.0, known) == []
