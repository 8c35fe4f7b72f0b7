"""The compiled loops do what their twins in Python do, and what is true; they are built here from their source."""

import importlib
import importlib.util
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gyrotrack._native._kernels as kernels
from gyrotrack import _smoothing as local
from gyrotrack.tracking import _corners as corners
from gyrotrack.tracking import _hub as disc
from gyrotrack.tracking import _marker_window as strip_module
from gyrotrack.tracking import _matching as matching
from gyrotrack.tracking import _observations as oddity
from gyrotrack.tracking import _polar as bands
from gyrotrack.tracking import _polar as grid
from gyrotrack.tracking._hub import DiscWindow
from gyrotrack.tracking._marker_window import MarkerStrip
from gyrotrack.tracking._polar import CHROMA_SHIFT, Grid, Ring, Score
from gyrotrack.tracking._scene import Disc
from gyrotrack.video._container import Frame

SOURCES = sorted(Path(kernels.__file__).parent.glob("*.c"))
WIDTH, HEIGHT = 96, 72


@pytest.fixture(scope="module")
def loops(tmp_path_factory):
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or sys.platform == "win32" or not SOURCES:
        pytest.skip("no C compiler here, or no source")
    target = tmp_path_factory.mktemp("built") / f"_compiled{sysconfig.get_config_var('EXT_SUFFIX')}"
    missing = ["-undefined", "dynamic_lookup"] if sys.platform == "darwin" else []
    include = f"-I{sysconfig.get_paths()['include']}"
    words = [
        compiler,
        "-O2",
        "-Wall",
        "-Werror",
        "-shared",
        "-fPIC",
        include,
        *missing,
        *map(str, SOURCES),
        "-o",
        str(target),
    ]
    subprocess.run([*words, "-lm"], check=True)
    spec = importlib.util.spec_from_file_location("gyrotrack._native._compiled", target)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _frame(make):
    """A frame whose planes are cut out of padded rows, as a decoder gives them."""
    y, u, v = (make(HEIGHT, WIDTH + 32), *(make(HEIGHT // 2, WIDTH // 2 + 16) for _ in range(2)))
    return Frame(0, 0, y[:, :WIDTH], u[:, : WIDTH // 2], v[:, : WIDTH // 2])


def _noise(seed=0):
    rng = np.random.default_rng(seed)
    return lambda rows, columns: rng.integers(0, 256, (rows, columns), dtype=np.uint8)


def _cut(monkeypatch, loops, frames, first, *, white, centre=(47.0, 35.0), columns=160):
    """Windows from all these frames, without a background."""
    monkeypatch.setattr(grid, "loops", loops)
    shape = frames[0].y.shape if white else frames[0].u.shape
    score = Score(white, (0.02, 0.0) if white else (0.3, -0.7), shape)
    here = Grid(Ring(centre, 12.0, 30.0, 9, columns), 41, score)
    ground = np.zeros((9, columns + 41), dtype=np.float32)
    ground[:] = np.linspace(0, 1, columns + 41)
    windows = np.zeros((len(frames), 9, 41), dtype=np.float32)
    here.cut(frames, np.asarray(first, dtype=np.int64), ground, windows)
    return windows


@pytest.mark.parametrize("white", [True, False])
@pytest.mark.parametrize(
    "centre", [(47.0, 35.0), (47.3, 34.6), (3.0, 68.0)]
)  # the last one: beyond the picture
def test_windows_are_those_of_opencv(monkeypatch, loops, white, centre):
    frames = [_frame(_noise(seed)) for seed in range(40)]
    first = np.arange(40) * 4 % 160
    ours = _cut(monkeypatch, loops, frames, first, white=white, centre=centre)
    theirs = _cut(monkeypatch, None, frames, first, white=white, centre=centre)
    assert np.ptp(theirs) > 1.0
    np.testing.assert_allclose(ours, theirs, atol=2e-4)


def test_a_slope_is_sampled_exactly(monkeypatch, loops):
    ramp = np.add.outer(2 * np.arange(HEIGHT // 2), np.arange(WIDTH // 2)).astype(np.uint8)
    frame = Frame(0, 0, np.zeros((HEIGHT, WIDTH), np.uint8), ramp, np.zeros_like(ramp))
    windows = _cut(monkeypatch, loops, [frame], [30], white=False)
    ring = Ring((47.0, 35.0), 12.0, 30.0, 9, 160)
    angle = (30 + np.arange(41)) * ring.step
    x = (47.0 + ring.radii[:, None] * np.cos(angle)) / 2
    y = (35.0 - ring.radii[:, None] * np.sin(angle) - 0.5) / 2
    np.testing.assert_allclose(windows[0], 0.3 * (x + 2 * y) - np.linspace(0, 1, 201)[30:71], atol=1e-4)


def test_planes_are_let_go(monkeypatch, loops):
    memory = bytearray(HEIGHT * WIDTH)
    y = np.frombuffer(memory, np.uint8).reshape(HEIGHT, WIDTH)
    _cut(monkeypatch, loops, [Frame(0, 0, y, y, y)], [0], white=True)
    small = Frame(0, 0, y[:-1], y, y)
    with pytest.raises(ValueError, match="do not fit"):
        _cut(monkeypatch, loops, [Frame(0, 0, y, y, y), small], [0, 1], white=True)
    del y, small
    memory.append(0)  # refused while anything looks into it


@pytest.mark.parametrize("first", [-1, 161, 10**9])
def test_a_window_outside_the_ring_is_refused(monkeypatch, loops, first):
    with pytest.raises(ValueError, match="do not fit"):
        _cut(monkeypatch, loops, [_frame(_noise())], [first], white=False)


def test_arrays_of_another_type_are_refused(loops):
    with pytest.raises(ValueError, match="shape or type"):
        loops.fit(
            np.zeros((2, 5), np.float32),
            *[np.zeros(5)] * 2,
            np.zeros(2),
            np.ones((2, 5), bool),
            np.zeros((2, 5)),
            0,
            1,
            1,
            1,
            8,
        )


@pytest.mark.parametrize("hidden", [False, True])
def test_fits_are_those_of_numpy(monkeypatch, loops, hidden):
    rng = np.random.default_rng(5)
    count, m = 400, 57
    template = matching.flat_top(9, m)
    shift, gain = rng.uniform(-9, 9, count), rng.uniform(0.3, 1.5, count)
    profile = gain[:, None] * matching.displaced(template, shift) + rng.normal(0, 0.03, (count, m)) + 0.2
    profile[:20] = rng.normal(0, 1, (20, m))  # no marker at all
    seen = np.ones((count, m), dtype=bool)
    if hidden:
        seen[100:300, :25] = False
        seen[10] = False
    start = shift + rng.uniform(-2, 2, count)
    found = {}
    for name, here in (("compiled", loops), ("numpy", None)):
        monkeypatch.setattr(matching, "loops", here)
        found[name] = matching.match(profile, template, start, seen)
    usual = slice(20, None)
    for name in ("shift", "gain", "offset", "misfit", "weakness"):
        ours, theirs = (getattr(found[which], name) for which in ("compiled", "numpy"))
        assert np.isfinite(ours[usual]).all()
        np.testing.assert_allclose(ours[usual], theirs[usual], rtol=1e-6, atol=1e-6)
    if not hidden:
        assert np.abs(found["compiled"].shift - shift)[usual].max() < 1.0


def test_what_is_no_number_does_no_harm(loops, monkeypatch):
    monkeypatch.setattr(matching, "loops", loops)
    profile = np.full((2, 31), np.nan)
    found = matching.match(
        profile, matching.flat_top(6, 31), np.array([0.0, np.nan]), np.ones((2, 31), dtype=bool)
    )
    assert found.shift.shape == (2,)


def _both(monkeypatch, loops, module, work):
    found = []
    for here in (loops, None):
        monkeypatch.setattr(module, "loops", here)
        found.append(work())
    return found


def test_papers_are_found_where_opencv_and_numpy_find_them(monkeypatch, loops):
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
    ours, theirs = _both(monkeypatch, loops, strip_module, lambda: strip.beside(angle, place))
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, other, atol=2e-5)
    assert (ours[1][:5] < 0.3).all()
    assert np.abs(ours[0] - (middle[place] - 0.3))[5:].max() < 1.2


def test_discs_are_those_of_numpy_and_where_they_are(monkeypatch, loops):
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
    ours, theirs = _both(monkeypatch, loops, disc, lambda: window.centres(200))
    np.testing.assert_allclose(ours, theirs, atol=1e-4)
    assert np.isnan(ours[:5]).all()
    assert np.abs(ours[5:] - (2.0 * true[5:] + CHROMA_SHIFT)).max() < 0.4


@pytest.mark.parametrize("count", [1, 2, 30, 4001])
def test_likelihoods_are_those_of_numpy(monkeypatch, loops, count):
    rng = np.random.default_rng(count)
    squares, misfit_excess = rng.standard_t(3, count) ** 2, np.clip(rng.normal(0, 6, count), 0, 24)
    squares[::7] = 0.0
    ours, theirs = _both(monkeypatch, loops, oddity, lambda: oddity._unlikely(squares, misfit_excess))
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("across", [False, True])
def test_bands_are_those_of_numpy(monkeypatch, loops, across):
    rng = np.random.default_rng(6)
    scores = rng.normal(0, 1, (40, 12, 31)).astype(np.float32)
    which = np.flatnonzero(rng.random(40) < 0.6)
    count, size = len(which), 31 if across else 12
    mixing = np.zeros((3, size))
    mixing[0, 2:5], mixing[1, 5:9], mixing[2, size - 1] = 1 / 3, 1 / 4, 1.0
    light = rng.uniform(0.5, 2, (count, 31))
    light[:, 6] = 0.0
    windows = bands.Windows(scores, which, light, rng.normal(0, 1, count), rng.uniform(0.5, 2, count))
    work = windows.columns if across else windows.rows
    ours, theirs = _both(monkeypatch, loops, bands, lambda: work(mixing))
    assert ours.shape == (count, 3, 12 if across else 31)
    np.testing.assert_allclose(ours, theirs, atol=1e-5)
    beyond = bands.Windows(scores, which + 40, light, windows.offset, windows.scale)
    monkeypatch.setattr(bands, "loops", loops)
    with pytest.raises(ValueError, match="do not fit"):
        beyond.rows(mixing[:, :12])


@pytest.mark.parametrize("step", [1, -1])
def test_edges_are_those_of_numpy_and_where_they_are(monkeypatch, loops, step):
    rng = np.random.default_rng(7)
    place = rng.uniform(3, 16, (50, 4))
    away = step * (np.arange(41) - 20) - place[..., None]
    curves = np.clip(0.5 - away / 3.0, 0.0, 1.0)
    curves[0], curves[1], curves[2] = 1.0, 0.0, np.nan  # no edge, no marker, no number
    axis = np.linspace(100.0, 180.0, 41)
    ours, theirs = _both(monkeypatch, loops, corners, lambda: corners._edge(curves, axis, 20, step))
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    assert np.isnan(ours[:3]).all()
    np.testing.assert_allclose(ours[3:], 140.0 + 2.0 * step * place[3:], atol=1e-9)


@pytest.mark.parametrize(
    ("half", "degree", "hole"), [(20, 2, -1), (60, 3, -1), (24, 2, 8), (4, 0, -1), (7, 1, 2)]
)
@pytest.mark.parametrize("count", [3, 200, 5000])
def test_local_polynomials_are_those_of_numpy(monkeypatch, loops, count, half, degree, hole):
    rng = np.random.default_rng(count)
    value = np.cumsum(rng.normal(0, 0.1, count)) + 1e-3 * np.arange(count) ** 1.5
    weight = np.where(rng.random(count) < 0.3, 0.0, rng.uniform(0.2, 3.0, count))
    weight[count // 2 : count // 2 + 3 * half] = 0.0
    value[(weight == 0) & (rng.random(count) < 0.5)] = np.nan
    ours, theirs = _both(
        monkeypatch, loops, local, lambda: local.local_fit(value, weight, half, degree, hole)
    )
    for mine, other in zip(ours, theirs, strict=True):
        assert (np.isnan(mine) == np.isnan(other)).all()
        seen = (weight > 0) & np.isfinite(
            other
        )  # where nothing is seen, some points far off may say nearly nothing
        np.testing.assert_allclose(mine[seen], other[seen], rtol=1e-8, atol=1e-8)


def test_a_build_of_an_older_source_is_not_used(monkeypatch):
    old = SimpleNamespace(EDITION=kernels.EDITION - 1)
    monkeypatch.setitem(sys.modules, "gyrotrack._native._compiled", old)
    try:
        assert importlib.reload(kernels).loops is None
    finally:
        monkeypatch.undo()
        importlib.reload(kernels)


def test_source_and_package_are_of_one_edition(loops):
    assert loops.EDITION == kernels.EDITION
