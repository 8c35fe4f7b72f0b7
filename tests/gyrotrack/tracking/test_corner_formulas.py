"""Corners of a marker with exact edges, and which rows, columns and crossings determine them."""

import math

import numpy as np
import pytest

from gyrotrack.tracking import _corners as module
from gyrotrack.tracking._corners import near_corners, paper_angle
from gyrotrack.tracking._polar import Windows

RADII = np.arange(40.0, 101.0)
ANGLES = np.linspace(-0.6, 0.6, 241)
INNER, OUTER = 60.0, 90.0


def marker(near, left, right, ground=0.0):
    """A window whose score falls linearly through 1/2 at near(phi), left(r) and right(r): the edges are exact."""
    r, phi = RADII[:, None], ANGLES[None, :]
    sides = (
        0.5 + 0.25 * (r - near(phi)),
        0.5 + 0.25 * (OUTER - r),
        0.5 + 20.0 * (right(r) - phi),
        0.5 + 20.0 * (phi - left(r)),
    )
    beyond = np.ones((len(RADII), len(ANGLES)))
    for side in sides:
        beyond = np.minimum(beyond, np.clip(side, 0, 1))
    return ground + (1 - ground) * beyond


class TestCorners:
    @pytest.mark.parametrize("ground", [0.0, 0.3])
    @pytest.mark.parametrize(
        ("half", "lean", "slope", "bend", "shift"),
        [
            (0.2, 0.0, 0.0, 0.0, 0.0),
            (0.2, 1e-3, 0.0, 0.0, 0.05),
            (0.25, -5e-4, 3.0, 0.0, -0.04),
            (0.2, 5e-4, -2.0, 12.0, 0.02),
        ],
    )
    def test_they_are_where_the_edges_meet(self, half, lean, slope, bend, shift, ground):
        """Sides phi = shift -+ (half - lean (r - 60)), near edge r = 60 + slope phi + bend phi^2."""
        near = lambda phi: INNER + slope * phi + bend * phi**2  # noqa: E731
        left = lambda r: shift - half + lean * (r - INNER)  # noqa: E731
        right = lambda r: shift + half - lean * (r - INNER)  # noqa: E731
        window = marker(near, left, right, ground)
        r, phi = near_corners(Windows.plain(np.stack([window] * 2)), RADII, ANGLES, INNER, OUTER)
        for side, edge in enumerate((left, right)):
            at = INNER
            for _ in range(50):
                at = near(edge(at))
            assert r[:, side] == pytest.approx([at, at], abs=0.06)
            assert phi[:, side] == pytest.approx([edge(at)] * 2, abs=1.5e-3)

    @pytest.mark.parametrize(("lean", "within"), [(1e-3, 0.05), (1.667e-3, 0.1)])
    def test_oblique_edges_are_intersected_by_iteration(self, monkeypatch, lean, within):
        """phi = +-0.2 + lean (r - 60) and r = 60 + 60 phi: r - 60 = +-12 / (1 - 60 lean); each step leaves 60 lean."""
        one = np.ones(1)
        monkeypatch.setattr(
            module, "_side_edges", lambda *_: ((-0.2 * one, lean * one), (0.2 * one, lean * one))
        )
        monkeypatch.setattr(module, "_near_edge", lambda *_: (60.0 * one, 60.0 * one, 0.0 * one))
        r, phi = near_corners(None, RADII, ANGLES, INNER, OUTER)
        exact = np.array([-12.0, 12.0]) / (1 - 60.0 * lean)
        assert r[0] == pytest.approx(60.0 + exact, abs=within)
        assert phi[0] == pytest.approx([-0.2, 0.2] + lean * (r[0] - 60.0))

    def test_the_near_edge_is_sought_between_the_sides(self, monkeypatch):
        asked, one = [], np.ones(1)
        monkeypatch.setattr(module, "_side_edges", lambda *_: ((-0.05 * one, 0 * one), (0.25 * one, 0 * one)))
        monkeypatch.setattr(
            module, "_near_edge", lambda window, radii, angles, *place: asked.append(place) or (one,) * 3
        )
        near_corners(None, RADII, ANGLES, INNER, OUTER)
        assert [x.item() for x in asked[0]] == pytest.approx([0.15, 0.1])

    def test_a_marker_without_a_side_has_no_corners(self):
        window = marker(lambda phi: INNER, lambda r: -9.0, lambda r: 0.2)
        r, phi = near_corners(Windows.plain(window[None]), RADII, ANGLES, INNER, OUTER)
        assert np.isnan(r).any()
        assert np.isnan(phi[0, 0])


class TestBands:
    def test_neighbours_are_averaged(self):
        found = module._bands(np.array([2, 3, 4, 6, 7]), 9, 2)
        assert found.tolist() == [[0, 0, 1 / 3, 1 / 3, 1 / 3, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0, 0.5, 0.5, 0]]
        assert module._bands(np.array([2]), 4, 4).tolist() == [[0, 0, 1, 0]]

    @pytest.mark.parametrize(
        ("inner", "outer", "first", "last"),
        [
            (60.0, 90.0, 64.0, 85.0),  # from 0.12 to 0.85 of the length
            (60.0, 61.2, 60.0, 61.0),  # all of a short one
            (61.0, 60.0, 70.0, 70.0),  # none: the middle row of the window
            (60.3, 60.6, 60.0, 60.0),  # between two rows: the nearest one
        ],
    )
    def test_rows_of_the_sides(self, monkeypatch, inner, outer, first, last):
        seen = []
        monkeypatch.setattr(
            module, "_bands", lambda rows, size, most: seen.append((rows, most)) or np.ones((1, size)) / size
        )
        monkeypatch.setattr(module, "_edge", lambda part, angles, middle, step: np.full((1, 1), step * 0.2))
        window = Windows.plain(np.zeros((1, len(RADII), len(ANGLES))))
        left, right = module._side_edges(window, RADII, ANGLES, inner, outer)
        ((rows, most),) = seen
        assert (RADII[rows[0]], RADII[rows[-1]], most) == (first, last, 4)
        assert (left[0].tolist(), right[0].tolist()) == ([-0.2], [0.2])

    @pytest.mark.parametrize(
        ("half", "middle", "columns"),
        [
            (0.2475, 0.0, (-0.195, 0.195)),
            (0.2475, 0.1, (-0.095, 0.295)),
            (0.001, 0.0, (-0.005, 0.005)),
            (0.01, 0.2, (0.195, 0.205)),
            (0.0055, 0.2, (-0.005, 0.005)),
        ],
    )
    def test_columns_of_the_near_edge(self, monkeypatch, half, middle, columns):
        """Within 0.8 of the half width about the middle; three at least."""
        seen = []
        bands = module._bands

        def recorded(chosen, size, most):
            seen.append((chosen, most))
            return bands(chosen, size, most)

        monkeypatch.setattr(module, "_bands", recorded)
        window = Windows.plain(np.repeat(RADII[:, None] / 100.0, len(ANGLES), axis=1)[None])
        module._near_edge(window, RADII, ANGLES, np.array([half]), np.array([middle]))
        ((chosen, most),) = seen
        assert ANGLES[chosen[[0, -1]]] == pytest.approx(columns)
        assert most == 5

    def test_a_marker_at_the_border_has_no_near_edge(self):
        """Its brightest row is the first one."""
        window = Windows.plain(np.repeat(1.0 - RADII[:, None] / 200.0, len(ANGLES), axis=1)[None])
        found = module._near_edge(window, RADII, ANGLES, np.array([0.2]), np.array([0.0]))
        assert np.isnan(found).all()

    @pytest.mark.parametrize(("half", "expected"), [(0.007, (61.0, 0.0, 0.0)), (0.2475, None)])
    def test_a_near_edge_of_few_columns_is_an_arc(self, monkeypatch, half, expected):
        """Three columns have no parabola with redundancy."""

        def edge(across, radii, top, step):
            tops.append((top, across.shape[1]))
            return np.linspace(60.0, 62.0, across.shape[1])[None]

        tops = []
        monkeypatch.setattr(module, "_edge", edge)
        rows = np.exp(-(((RADII - RADII[5]) / 9.0) ** 2))  # brightest in the sixth row of the window
        window = Windows.plain(np.repeat(rows[:, None], len(ANGLES), axis=1)[None])
        found = module._near_edge(window, RADII, ANGLES, np.array([half]), np.array([0.0]))
        assert tops == [(5, 3 if expected else 5)]
        coefficients = [c.item() for c in found]
        if expected:
            assert coefficients == pytest.approx(expected)
        else:
            assert coefficients[1] == pytest.approx(2.0 / (0.8 * 0.395), rel=0.05)

    @pytest.mark.parametrize(("missing", "known"), [(1, True), (2, False)])
    def test_the_near_edge_needs_three_of_five_columns_and_more(self, monkeypatch, missing, known):
        edge = np.array([[60.0, 61.0, 62.0, 61.0, 60.0]])
        edge[0, :missing] = np.nan
        monkeypatch.setattr(module, "_edge", lambda across, radii, top, step: edge.copy())
        window = Windows.plain(np.repeat(RADII[:, None] / 100.0, len(ANGLES), axis=1)[None])
        c0, c1, c2 = module._near_edge(window, RADII, ANGLES, np.array([0.2475]), np.array([0.0]))
        assert np.isfinite(c0[0]) == known
        if known:  # a missing one is replaced by the mean
            chosen = np.flatnonzero(np.abs(ANGLES) < 0.198)
            phi = [ANGLES[part].mean() for part in np.array_split(chosen, 5)]
            expected = np.polyfit(phi, [61.0, 61.0, 62.0, 61.0, 60.0], 2)[::-1]
            assert (c0[0], c1[0], c2[0]) == pytest.approx(tuple(expected))


class TestEdges:
    @pytest.mark.parametrize(
        ("beyond", "level"), [(0.0, 0.5), (0.4, 0.7), (0.9, 0.8), (-0.2, 0.4), (-0.9, 0.35)]
    )
    def test_an_edge_is_half_way_to_the_background(self, beyond, level):
        """The background is taken between -0.3 and 0.6."""
        curve = np.array([1.0, 1.0, 1.0, 0.5 * (1.0 + beyond), beyond, beyond, beyond])
        axis = np.linspace(0.0, 0.6, 7)
        (((place,),),) = module._edge(curve[None, None], axis, 0, 1)[None]
        # linear between 1 at 0.2 and the background at 0.4; a background above the level has no edge
        exact = 0.2 + 0.2 * (1.0 - level) / (1.0 - beyond) if beyond < level else math.nan
        assert place == pytest.approx(exact, nan_ok=True)
        (((mirrored,),),) = module._edge(curve[None, None, ::-1], axis, 6, -1)[None]
        assert mirrored == pytest.approx(0.6 - place, nan_ok=True)

    def test_lines_through_crossings(self):
        r = np.array([0.0, 10.0, 20.0, 30.0, 40.0])
        edge = np.array([0.3 - 2e-3 * r, 0.1 + 0 * r, 0.2 + 1e-3 * r])
        edge[0, 1] = np.nan
        edge[2, :2] = np.nan
        base, lean = module._lines(edge, r)
        assert base[:2] == pytest.approx([0.3, 0.1])
        assert lean[:2] == pytest.approx([-2e-3, 0.0])
        assert np.isnan([base[2], lean[2]]).all()  # three of five rows are not more than 60 %
        one = module._lines(np.array([[0.4]]), np.array([7.0]))
        assert [x.tolist() for x in one] == [[0.4], [0.0]]


class TestPaperAngle:
    def corners(self, *frames):
        """Corners at (radius, angle) each, y downwards, about a centre of (10, 20)."""
        made = [[(10 + r * np.cos(a), 20 - r * np.sin(a)) for r, a in frame] for frame in frames]
        return paper_angle(
            np.array(made), np.tile([10.0, 20.0], (len(frames), 1)), np.ones(len(frames), dtype=bool)
        )

    def test_of_an_ideal_marker(self):
        """Two corners at 5 px, 0.2 rad apart, at 1 rad."""
        found = self.corners([(5.0, 0.9), (5.0, 1.1)])
        assert found.angle == pytest.approx([1.0])
        assert found.rho == pytest.approx([5.0 * np.cos(0.1)])
        assert found.delta == pytest.approx([10.0 * np.sin(0.1)])
        assert found.beta == pytest.approx([np.pi / 2])
        assert found.sigma == pytest.approx([0.0], abs=1e-6)

    def test_of_a_skew_marker(self):
        """Corners z_k, middle M, base b: u_2k is the angle between M -+ i |b| M / (2 |M|) and z_k."""
        found = self.corners([(5.0, 0.9), (5.4, 1.1)])
        z = np.array([5.0 * np.exp(0.9j), 5.4 * np.exp(1.1j)])
        middle, base = z.mean(), z[1] - z[0]
        assert found.beta == pytest.approx([abs(np.angle(base / middle))])
        right = middle + np.array([-0.5, 0.5]) * 1j * abs(base) * middle / abs(middle)
        u_2 = np.sqrt(np.mean(np.angle(right / z) ** 2))
        assert found.u_2 == pytest.approx([u_2])
        assert found.u_1 == pytest.approx([0.0], abs=1e-12)
        assert found.sigma == pytest.approx([150.0 * u_2])
        assert found.angle == pytest.approx([np.angle(np.sum(z / np.abs(z)))])

    def test_of_frames_with_another_size(self):
        """Radii of 4 and 6 px: u_r is a fifth; bases of 0.4 and 0.6: u_1 is that of the mean base of 0.5."""
        found = self.corners([(4.0, 0.95), (4.0, 1.05)], [(6.0, 0.95), (6.0, 1.05)])
        assert found.u_r == pytest.approx([0.2, 0.2])
        mean = 5.0 * np.sin(0.05)
        for i, radius in enumerate((4.0, 6.0)):
            wide = np.arctan2(mean, radius * np.cos(0.05)) - 0.05
            assert found.u_1[i] == pytest.approx(abs(wide))
            assert found.u_2[i] == pytest.approx(abs(wide))
            assert found.sigma[i] == pytest.approx(np.sqrt((30 * 0.2) ** 2 + 2 * (150 * wide) ** 2))

    def test_frames_without_corners(self):
        corner = np.full((2, 2, 2), np.nan)
        corner[1] = [[3.0, 0.0], [3.0, -1.0]]
        found = paper_angle(corner, np.zeros((2, 2)), np.array([True, True]))
        assert np.isnan(found.sigma[0])
        assert found.rho[1] == pytest.approx(np.hypot(3.0, 0.5))
        nothing = paper_angle(corner, np.zeros((2, 2)), np.array([False, False]))
        assert np.isnan(nothing.sigma).all()
        at_centre = paper_angle(
            np.array([[[1.0, 0.0], [-1.0, 0.0]]]), np.zeros((1, 2)), np.ones(1, dtype=bool)
        )
        assert np.isnan(at_centre.angle).all()  # the middle is the centre


def test_without_a_side_there_are_no_corners(monkeypatch):
    """One side of each window is lost; the near edge is then not searched for."""
    lost, seen = np.full(3, np.nan), np.zeros(3)
    for sides in (((lost, lost), (seen, seen)), ((seen, seen), (lost, lost))):
        monkeypatch.setattr(module, "_side_edges", lambda *_, sides=sides: sides)
        found = near_corners(None, None, None, 10.0, 20.0)
        for values in found:
            assert values.shape == (3, 2)
            assert np.isnan(values).all()


def test_corners_are_where_the_sides_meet_the_near_edge(monkeypatch):
    """r = 10 + 0.2 phi - 0.5 phi^2, and phi = -+0.3 + 0.01 (r - 10)."""
    sides = tuple((np.array([base]), np.array([0.01])) for base in (-0.3, 0.3))
    asked = []
    near = (np.array([10.0]), np.array([0.2]), np.array([-0.5]))
    monkeypatch.setattr(module, "_side_edges", lambda *_: sides)
    monkeypatch.setattr(module, "_near_edge", lambda *given: asked.append(given[3:]) or near)
    radius, angle = near_corners(None, None, None, 10.0, 20.0)
    ((half, middle),) = asked
    assert (half.tolist(), middle.tolist()) == ([0.3], [0.0])
    assert radius[0] == pytest.approx(10.0 + 0.2 * angle[0] - 0.5 * angle[0] ** 2, abs=1e-5)
    assert angle[0] == pytest.approx([-0.3, 0.3] + 0.01 * (radius[0] - 10.0))
