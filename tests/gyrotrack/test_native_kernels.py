"""The compiled kernels against their NumPy reference, against OpenCV, and against known answers."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from gyrotrack._native import _kernels as kernels
from gyrotrack._smoothing import local_fit
from gyrotrack.tracking import _corners as corners
from gyrotrack.tracking._hub import DiscWindow
from gyrotrack.tracking._marker_tracker import displaced, flat_top, match
from gyrotrack.tracking._marker_window import MarkerStrip
from gyrotrack.tracking._polar import CHROMA_SHIFT, Grid, Ring, Score, Windows
from gyrotrack.tracking._scene import Disc
from gyrotrack.video._container import Frame

WIDTH, HEIGHT = 96, 72

compiled = pytest.mark.skipif(not kernels.COMPILED, reason="the kernels were not compiled")
ways = pytest.mark.parametrize("way", [pytest.param("compiled", marks=compiled), "reference"])


@pytest.fixture
def use(monkeypatch):
    """Choose between the compiled extension and the reference."""
    return lambda way: monkeypatch.setattr(kernels, "COMPILED", way == "compiled")


@pytest.fixture
def both(use):
    """The results of the compiled extension and of the reference."""
    if not kernels.COMPILED:
        pytest.skip("the kernels were not compiled")

    def run(work):
        results = []
        for way in ("compiled", "reference"):
            use(way)
            results.append(work())
        return results

    return run


def _frame(make):
    """A frame whose planes are cut out of padded rows, as a decoder gives them."""
    y, u, v = (make(HEIGHT, WIDTH + 32), *(make(HEIGHT // 2, WIDTH // 2 + 16) for _ in range(2)))
    return Frame(0, 0, y[:, :WIDTH], u[:, : WIDTH // 2], v[:, : WIDTH // 2])


def _noise(seed=0):
    rng = np.random.default_rng(seed)
    return lambda rows, columns: rng.integers(0, 256, (rows, columns), dtype=np.uint8)


def _cut(frames, first, *, white, centre=(47.0, 35.0), columns=160):
    """Windows from all these frames, without a background."""
    shape = frames[0].y.shape if white else frames[0].u.shape
    score = Score(white, (0.02, 0.0) if white else (0.3, -0.7), shape)
    here = Grid(Ring(centre, 12.0, 30.0, 9, columns), 41, score)
    ground = np.zeros((9, columns + 41), dtype=np.float32)
    ground[:] = np.linspace(0, 1, columns + 41)
    windows = np.zeros((len(frames), 9, 41), dtype=np.float32)
    here.cut(frames, np.asarray(first, dtype=np.int64), ground, windows)
    return windows


@ways
@pytest.mark.parametrize("white", [True, False])
@pytest.mark.parametrize(
    "centre", [(47.0, 35.0), (47.3, 34.6), (3.0, 68.0)]
)  # the last one: beyond the picture
def test_windows_are_those_of_bilinear_interpolation(use, way, white, centre):
    use(way)
    frames = [_frame(_noise(seed)) for seed in range(40)]
    first = np.arange(40) * 4 % 160
    ours = _cut(frames, first, white=white, centre=centre)
    shape = frames[0].y.shape if white else frames[0].u.shape
    grid = Grid(Ring(centre, 12.0, 30.0, 9, 160), 41, Score(white, (1.0, 0.0), shape))
    for frame, k, window in zip(frames, first, ours, strict=True):
        picture = (
            0.02 * frame.y.astype(np.float32) if white else 0.3 * frame.u.astype(np.float32) - 0.7 * frame.v
        )
        x, y = (np.ascontiguousarray(place[:, k : k + 41]) for place in (grid.x, grid.y))
        theirs = map_coordinates(picture.astype(np.float64), (y, x), order=1, mode="nearest")
        np.testing.assert_allclose(window + np.linspace(0, 1, 201)[k : k + 41], theirs, atol=2e-4)


@ways
def test_a_slope_is_sampled_exactly(use, way):
    use(way)
    ramp = np.add.outer(2 * np.arange(HEIGHT // 2), np.arange(WIDTH // 2)).astype(np.uint8)
    frame = Frame(0, 0, np.zeros((HEIGHT, WIDTH), np.uint8), ramp, np.zeros_like(ramp))
    windows = _cut([frame], [30], white=False)
    ring = Ring((47.0, 35.0), 12.0, 30.0, 9, 160)
    angle = (30 + np.arange(41)) * ring.step
    x = (47.0 + ring.radii[:, None] * np.cos(angle)) / 2
    y = (35.0 - ring.radii[:, None] * np.sin(angle) - 0.5) / 2
    np.testing.assert_allclose(windows[0], 0.3 * (x + 2 * y) - np.linspace(0, 1, 201)[30:71], atol=1e-4)


@ways
def test_buffers_are_released_and_wrong_planes_refused(use, way):
    use(way)
    memory = bytearray(HEIGHT * WIDTH)
    y = np.frombuffer(memory, np.uint8).reshape(HEIGHT, WIDTH)
    _cut([Frame(0, 0, y, y, y)], [0], white=True)
    small = Frame(0, 0, y[:-1], y, y)
    with pytest.raises(ValueError, match="expected uint8"):
        _cut([Frame(0, 0, y, y, y), small], [0, 1], white=True)
    del y, small
    memory.append(0)  # refused while a view of it exists


@ways
@pytest.mark.parametrize("first", [-1, 161, 10**9])
def test_a_window_outside_the_ring_is_refused(use, way, first):
    use(way)
    with pytest.raises(ValueError, match="outside the ring"):
        _cut([_frame(_noise())], [first], white=False)


GOOD = {
    "likelihood": (np.ones(4), np.zeros(4), np.linspace(0, 1, 3), 10.0),
    "match": (np.zeros((2, 5)), *[np.zeros(13)] * 2, np.zeros(2), np.ones((2, 5), bool), 4, 1.0, 1.0, 1, 8.0),
    "crossings": (np.zeros((2, 3, 9)), 4, 1, 0.5, 0.1),
    "discs": (np.zeros((2, 2, 9, 9), np.uint8), (1.0, 0.0), 2.0),
    "locate": (np.zeros((2, 4, 21), np.float32), np.zeros(2), (0, 4, 2), 2, 3),
    "local_polynomials": (np.zeros(30), np.ones(30), 5, 2, -1, np.empty(20), np.empty(20)),
}


@ways
@pytest.mark.parametrize("name", GOOD)
def test_arrays_of_another_type_or_shape_are_refused(use, way, name):
    use(way)
    kernel, arguments = getattr(kernels, name), GOOD[name]
    kernel(*arguments)
    for k, argument in enumerate(arguments):
        if not isinstance(argument, np.ndarray):
            continue
        for wrong in (argument.astype(np.int64), argument.astype(">f4"), argument[None]):
            with pytest.raises(ValueError, match="array"):
                kernel(*arguments[:k], wrong, *arguments[k + 1 :])


@pytest.mark.parametrize("hidden", [False, True])
def test_matches_are_those_of_the_reference(both, hidden):
    rng = np.random.default_rng(5)
    count, m = 400, 57
    template = flat_top(9, m)
    shift, gain = rng.uniform(-9, 9, count), rng.uniform(0.3, 1.5, count)
    profile = gain[:, None] * displaced(template, shift) + rng.normal(0, 0.03, (count, m)) + 0.2
    profile[:20] = rng.normal(0, 1, (20, m))  # no marker at all
    seen = np.ones((count, m), dtype=bool)
    if hidden:
        seen[100:300, :25] = False
        seen[10] = False
    start = shift + rng.uniform(-2, 2, count)
    ours_, theirs_ = both(lambda: match(profile, template, start, seen))
    usual = slice(20, None)
    for name in ("shift", "gain", "offset", "misfit", "weakness"):
        ours, theirs = getattr(ours_, name), getattr(theirs_, name)
        assert np.isfinite(ours[usual]).all()
        np.testing.assert_allclose(ours[usual], theirs[usual], rtol=1e-6, atol=1e-6)
    if not hidden:
        assert np.abs(ours_.shift - shift)[usual].max() < 1.0


@ways
def test_nan_does_no_harm(use, way):
    use(way)
    profile = np.full((2, 31), np.nan)
    found = match(profile, flat_top(6, 31), np.array([0.0, np.nan]), np.ones((2, 31), dtype=bool))
    assert found.shift.shape == (2,)


def test_markers_are_located_as_by_the_reference(both):
    rng = np.random.default_rng(3)
    strip = MarkerStrip.__new__(MarkerStrip)
    strip.marker, strip.ring = SimpleNamespace(half_width=0.2), Ring((40.0, 30.0), 10.0, 20.0, 12, 200)
    strip.half, strip.width, strip.slack, strip._rows = 25, 51, 6, (2, 9)
    strip._mixing = np.zeros(12, np.float32)
    strip._mixing[2:9:2] = 0.25
    middle = rng.uniform(-5, 5, 300)
    middle[:10] = 20.0  # beyond reach
    paper = np.abs(np.arange(51) - 25 - middle[:, None]) <= 0.2 / strip.ring.step
    strip.windows = (paper[:, None, :] + rng.normal(0, 0.1, (300, 12, 51))).astype(np.float32)
    strip.starts = rng.integers(-400, 400, 300)
    place = slice(1, 300, 2)
    angle = (strip.starts[place] + 0.3) * strip.ring.step
    ours, theirs = both(lambda: strip.locate(angle, place))
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, other, atol=2e-5)
    assert (ours[1][:5] < 0.3).all()
    assert np.abs(ours[0] - (middle[place] - 0.3))[5:].max() < 1.2


def test_discs_are_those_of_numpy_and_where_they_are(both):
    rng = np.random.default_rng(4)
    window = DiscWindow(Disc((60.0, 60.0), 14.0, (-20.0, 70.0)), 200)
    side = 2 * window.half + 1
    true = window.half + rng.uniform(-3, 3, (200, 2))
    y, x = np.mgrid[:side, :side]
    away = np.hypot(x - true[:, 0, None, None], y - true[:, 1, None, None])
    cover = np.clip(7.5 - away, 0.0, 1.0)
    cover[:5] = 0.0  # hidden
    seen = (
        120 + cover[:, None] * np.array([-20.0, 70.0])[:, None, None] + rng.normal(0, 2, (200, 2, side, side))
    )
    window._pixels[:] = np.rint(seen)
    ours, theirs = both(lambda: window.centres(200))
    np.testing.assert_allclose(ours, theirs, atol=1e-4)
    assert np.isnan(ours[:5]).all()
    assert np.abs(ours[5:] - (2.0 * true[5:] + CHROMA_SHIFT)).max() < 0.4


@pytest.mark.parametrize("count", [1, 2, 30, 4001])
def test_likelihoods_are_those_of_numpy(both, count):
    rng = np.random.default_rng(count)
    squares, misfit_excess = rng.standard_t(3, count) ** 2, np.clip(rng.normal(0, 6, count), 0, 24)
    squares[::7] = 0.0
    ours, theirs = both(
        lambda: kernels.likelihood(squares, misfit_excess, np.linspace(0, 1, 22), 25 / 0.4549)
    )
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("across", [False, True])
def test_bands_are_those_of_numpy(both, across):
    rng = np.random.default_rng(6)
    scores = rng.normal(0, 1, (40, 12, 31)).astype(np.float32)
    which = np.flatnonzero(rng.random(40) < 0.6)
    count, size = len(which), 31 if across else 12
    mixing = np.zeros((3, size))
    mixing[0, 2:5], mixing[1, 5:9], mixing[2, size - 1] = 1 / 3, 1 / 4, 1.0
    light = rng.uniform(0.5, 2, (count, 31))
    light[:, 6] = 0.0
    windows = Windows(scores, which, light, rng.normal(0, 1, count), rng.uniform(0.5, 2, count))
    ours, theirs = both(lambda: windows.bands(mixing, across=across))
    assert ours.shape == (count, 3, 12 if across else 31)
    np.testing.assert_allclose(ours, theirs, atol=1e-5)
    beyond = Windows(scores, which + 40, light, windows.offset, windows.scale)
    with pytest.raises(ValueError, match="outside the windows"):
        beyond.bands(mixing[:, :12])


@ways
@pytest.mark.parametrize(("which", "inside"), [((0, 3), True), ((-1, 3), False), ((0, 4), False), ((), True)])
def test_bands_are_those_of_four_windows(use, way, which, inside):
    use(way)
    windows = np.arange(24, dtype=np.float32).reshape(4, 2, 3)
    chosen, ones = np.array(which, dtype=np.int64), np.ones(len(which))
    light = np.ones((len(which), 3))

    def made(across):
        mixing = np.full((1, 3 if across else 2), 1 / 3 if across else 0.5, dtype=np.float32)
        return kernels.bands(windows, chosen, light, 2.0 * ones, 10.0 * ones, mixing, across=across)

    if not inside:
        with pytest.raises(ValueError, match="outside the windows"):
            made(across=False)
        return
    for across in (False, True):
        expected = [10.0 * (windows[k].mean(axis=int(across)) - 2.0) for k in which]
        assert made(across) == pytest.approx(np.reshape(expected, (len(which), 1, 2 if across else 3)))


@ways
@pytest.mark.parametrize(
    ("pad", "limit", "length", "fits"), [(4, 2.0, 18, True), (4, 2.01, 18, False), (4, 2.0, 19, False)]
)
def test_a_template_is_extended_by_its_limit_and_two_samples(use, way, pad, limit, length, fits):
    use(way)
    curve = np.exp(-0.5 * ((np.arange(length) - 8.5) / 2.0) ** 2)
    profile = curve[None, 4:14].copy()

    def run():
        return kernels.match(
            profile, curve, np.gradient(curve), np.zeros(1), np.ones((1, 10), bool), pad, limit, 0.5, 5, 16.0
        )

    if fits:
        assert run()[0, :3] == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)
    else:
        with pytest.raises(ValueError, match="extended by at least limit"):
            run()


@ways
@pytest.mark.parametrize(
    ("first", "step", "refused"),
    [(0, 1, False), (4, -1, False), (-1, 1, True), (5, -1, True), (2, 0, True), (2, 2, True)],
)
def test_a_search_of_a_crossing_begins_within_the_curve(use, way, first, step, refused):
    use(way)
    curves = np.array([[[1.0, 0.9, 0.7, 0.2, 0.0]]])[..., :: step if step in (1, -1) else 1]
    if refused:
        with pytest.raises(ValueError, match="begins outside"):
            kernels.crossings(curves, first, step, 0.45, 1e-3)
    else:
        assert kernels.crossings(curves, first, step, 0.45, 1e-3) == pytest.approx(2.5)


@ways
@pytest.mark.parametrize(
    ("half", "degree", "hole", "length", "fits"),
    [
        (2, 1, -1, 14, True),
        (2, 1, 1, 14, True),
        (2, 1, 2, 14, False),
        (2, 1, -2, 14, False),
        (2, 4, -1, 14, False),
        (2, -1, -1, 14, False),
        (0, 1, -1, 10, False),
        (2, 1, -1, 13, False),
    ],
)
def test_windows_of_a_polynomial_match_the_series(use, way, half, degree, hole, length, fits):
    use(way)
    value, smooth, leverage = 0.5 * np.arange(float(length)), np.zeros(10), np.zeros(10)
    if not fits:
        with pytest.raises(ValueError, match="window, degree or hole"):
            kernels.local_polynomials(value, np.ones(length), half, degree, hole, smooth, leverage)
        return
    kernels.local_polynomials(value, np.ones(length), half, degree, hole, smooth, leverage)
    assert smooth == pytest.approx(value[2:-2])


@ways
@pytest.mark.parametrize(("squares", "shares"), [(1, 1), (0, 1), (1, 0)])
def test_a_likelihood_needs_a_residual_and_a_share(use, way, squares, shares):
    use(way)
    given = np.ones(squares), np.ones(squares), np.zeros(shares)
    if squares and shares:
        assert kernels.likelihood(*given, 9.0).shape == (1,)
    else:
        with pytest.raises(ValueError, match="at least one residual"):
            kernels.likelihood(*given, 9.0)


@ways
@pytest.mark.parametrize(
    ("rows", "half", "reach", "columns", "fits"),
    [
        ((0, 4, 1), 3, 2, 12, True),
        ((0, 4, 1), 3, 2, 11, False),
        ((0, 5, 1), 3, 2, 12, False),
        ((-1, 4, 1), 3, 2, 12, False),
        ((2, 2, 1), 3, 2, 12, False),
        ((0, 4, 0), 3, 2, 12, False),
        ((0, 4, 1), -1, 2, 12, False),
        ((0, 4, 1), 3, 0, 12, False),
    ],
)
def test_rows_marker_and_search_match_the_windows(use, way, rows, half, reach, columns, fits):
    use(way)
    windows = np.zeros((1, 4, columns), dtype=np.float32)
    if fits:
        assert kernels.locate(windows, np.zeros(1), rows, half, reach).shape == (1, 2)
    else:
        with pytest.raises(ValueError, match="do not match the windows"):
            kernels.locate(windows, np.zeros(1), rows, half, reach)


@pytest.mark.parametrize("step", [1, -1])
def test_edges_are_those_of_numpy_and_where_they_are(both, step):
    rng = np.random.default_rng(7)
    place = rng.uniform(3, 16, (50, 4))
    away = step * (np.arange(41) - 20) - place[..., None]
    curves = np.clip(0.5 - away / 3.0, 0.0, 1.0)
    curves[0], curves[1], curves[2] = 1.0, 0.0, np.nan  # no edge, no marker, no number
    axis = np.linspace(100.0, 180.0, 41)
    ours, theirs = both(lambda: corners._edge(curves, axis, 20, step))
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    assert np.isnan(ours[:3]).all()
    np.testing.assert_allclose(ours[3:], 140.0 + 2.0 * step * place[3:], atol=1e-9)


@pytest.mark.parametrize(
    ("half", "degree", "hole"), [(20, 2, -1), (60, 3, -1), (24, 2, 8), (4, 0, -1), (7, 1, 2)]
)
@pytest.mark.parametrize("count", [3, 200, 5000])
def test_local_polynomials_are_those_of_numpy(both, count, half, degree, hole):
    rng = np.random.default_rng(count)
    value = np.cumsum(rng.normal(0, 0.1, count)) + 1e-3 * np.arange(count) ** 1.5
    weight = np.where(rng.random(count) < 0.3, 0.0, rng.uniform(0.2, 3.0, count))
    weight[count // 2 : count // 2 + 3 * half] = 0.0
    value[(weight == 0) & (rng.random(count) < 0.5)] = np.nan
    ours, theirs = both(lambda: local_fit(value, weight, half, degree, hole))
    for mine, other in zip(ours, theirs, strict=True):
        assert (np.isnan(mine) == np.isnan(other)).all()
        seen = (weight > 0) & np.isfinite(
            other
        )  # where nothing is seen, some points far off may say nearly nothing
        np.testing.assert_allclose(mine[seen], other[seen], rtol=1e-8, atol=1e-8)


def _rings(frames, centre, turn, radius, columns=90, margin=6):
    """Rings from the luma of frames, about centres (n, 2) at angles (n,) [rad]."""
    theta = (np.arange(columns + 2 * margin) - margin) * 2.0 * np.pi / columns
    direction = np.stack([np.cos(theta), np.sin(theta)]).astype(np.float32)
    turns = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    out = np.zeros((len(frames), len(radius), len(theta)), dtype=np.uint8)
    kernels.ring([f.y for f in frames], centre, turns, radius.astype(np.float32), direction, out)
    return out, theta


class TestRing:
    RADIUS = np.linspace(4.0, 30.0, 7)

    @ways
    @pytest.mark.parametrize(
        "middle", [(47.3, 35.6), (6.0, 66.0)]
    )  # the second one reaches beyond the picture
    def test_its_samples_are_those_of_bilinear_interpolation(self, use, way, middle):
        use(way)
        frames = [_frame(_noise(seed)) for seed in range(5)]
        centre = np.array(middle) + np.arange(10.0).reshape(5, 2) / 7.0
        turn = np.linspace(-2.0, 9.0, 5)
        rings, theta = _rings(frames, centre, turn, self.RADIUS)
        for frame, (x0, y0), psi, ring in zip(frames, centre, turn, rings, strict=True):
            x = x0 + self.RADIUS[:, None] * np.cos(theta + psi)
            y = y0 - self.RADIUS[:, None] * np.sin(theta + psi)
            theirs = map_coordinates(frame.y.astype(np.float64), (y, x), order=1, mode="nearest")
            # rounded to grey levels; positions are of single precision
            np.testing.assert_allclose(ring, theirs, atol=0.51)

    def test_the_compiled_kernel_gives_the_result_of_numpy(self, both):
        frames = [_frame(_noise(seed)) for seed in range(5)]
        centre, turn = np.tile([[46.0, 36.0]], (5, 1)), np.arange(5.0)
        ours, theirs = both(lambda: _rings(frames, centre, turn, self.RADIUS)[0])
        assert np.abs(ours.astype(int) - theirs).max() <= 1

    @ways
    def test_other_planes_are_refused(self, use, way):
        use(way)
        frame = _frame(_noise())
        with pytest.raises(ValueError, match="number of planes"):
            kernels.ring([frame.y], np.zeros((2, 2)), np.zeros((2, 2)), *_ring_arrays(2))
        for wrong in (frame.y.astype(np.int16), frame.y[:, ::2], frame.y[:-1]):
            with pytest.raises(ValueError, match="a plane has type"):
                kernels.ring([frame.y, wrong], np.zeros((2, 2)), np.zeros((2, 2)), *_ring_arrays(2))
        with pytest.raises(ValueError, match="two rows"):
            kernels.ring([frame.y[:1]], np.zeros((1, 2)), np.zeros((1, 2)), *_ring_arrays(1))


def _ring_arrays(count):
    return np.ones(3, np.float32), np.ones((2, 8), np.float32), np.zeros((count, 3, 8), np.uint8)


class TestTurnedRing:
    @ways
    def test_a_ramp_is_turned_by_fractions_of_a_column_and_loses_the_light(self, use, way):
        use(way)
        strips = np.tile(10 * np.arange(20, dtype=np.uint8), (2, 3, 1))  # 12 columns, margin 4
        strips[1] += 5
        light = (np.arange(36.0).reshape(3, 12) / 4.0).astype(np.float32)
        ahead, first = np.array([0.0, 1.25, -3.0]), np.array([0, 5, 11])
        found = kernels.turned(strips, np.array([0, 1, 0]), ahead, light, first)
        for k, (offset, columns, begin) in enumerate(zip([0.0, 5.0, 0.0], ahead, first, strict=True)):
            seen = 10.0 * (np.arange(12) + 4.0 + columns) + offset
            np.testing.assert_allclose(found[k], seen - np.roll(light, -begin, axis=1), atol=1e-4)

    def test_the_compiled_kernel_gives_the_result_of_numpy(self, both):
        rng = np.random.default_rng(3)
        strips = rng.integers(0, 256, (4, 5, 103), dtype=np.uint8)
        light = rng.normal(0.0, 9.0, (5, 91)).astype(np.float32)
        which, ahead = rng.integers(0, 4, 30), rng.uniform(-5.0, 5.0, 30)
        first = np.arange(30)
        ours, theirs = both(lambda: kernels.turned(strips, which, ahead, light, first))
        np.testing.assert_allclose(ours, theirs, atol=1e-4)

    @ways
    @pytest.mark.parametrize(
        ("which", "ahead", "first"), [(2, 0.0, 0), (0, 3.1, 0), (0, -3.1, 0), (0, 0.0, 12)]
    )
    def test_a_ring_is_not_turned_beyond_its_margin(self, use, way, which, ahead, first):
        use(way)
        strips, light = np.zeros((2, 3, 20), np.uint8), np.zeros((3, 12), np.float32)
        inside = kernels.turned(strips, np.array([1, 1]), np.array([3.0, -3.0]), light, np.array([11, 0]))
        assert inside.shape == (2, 3, 12)
        with pytest.raises(ValueError, match="beyond its margin"):
            kernels.turned(strips, np.array([which]), np.array([ahead]), light, np.array([first]))


class TestSumsOfRings:
    """13 samples, which are not a multiple of what a processor computes at once, from the second row on."""

    RNG = np.random.default_rng(5)
    STRIPS = RNG.normal(0.0, 3.0, (40, 4, 9)).astype(np.float32)
    PICTURE = RNG.normal(0.0, 1.0, 13).astype(np.float32)
    OFF = STRIPS.astype(np.float64).reshape(40, 36)[:, 9:22] - PICTURE

    @ways
    def test_sums_over_samples(self, use, way):
        use(way)
        w = self.RNG.normal(0.0, 1.0, (4, 13)).astype(np.float32)
        found = kernels.sample_sums(self.STRIPS, 1, self.PICTURE, w)
        np.testing.assert_allclose(found[:, :3], self.OFF @ w[:3].T, atol=1e-4)
        np.testing.assert_allclose(found[:, 3], self.OFF**2 @ w[3], atol=1e-3)

    @ways
    def test_sums_over_frames_without_those_of_no_weight(self, use, way):
        use(way)
        w = self.RNG.normal(0.0, 1.0, (40, 4)).astype(np.float32)
        w[7, 0] = 0.0
        found = kernels.frame_sums(self.STRIPS, 1, self.PICTURE, w)
        w[7] = 0.0
        np.testing.assert_allclose(found[[0, 2, 3, 4]], w.T @ self.OFF, atol=1e-3)
        np.testing.assert_allclose(found[1], w[:, 0] @ self.OFF**2, atol=1e-2)

    @ways
    @pytest.mark.parametrize(("row", "fits"), [(0, True), (2, True), (3, False), (-1, False)])
    def test_rows_beyond_the_strip_are_refused(self, use, way, row, fits):
        use(way)
        for work, weights in ((kernels.sample_sums, (4, 13)), (kernels.frame_sums, (40, 4))):
            arrays = self.STRIPS, row, self.PICTURE, np.ones(weights, np.float32)
            if fits:
                work(*arrays)
            else:
                with pytest.raises(ValueError, match="outside the rows"):
                    work(*arrays)


def test_an_extension_of_another_interface_is_not_used(monkeypatch):
    monkeypatch.setattr(kernels, "import_module", lambda name: SimpleNamespace(ABI=kernels.ABI - 1))
    assert kernels._extension() is None


@compiled
def test_source_and_extension_have_one_interface():
    assert kernels._compiled.ABI == kernels.ABI
