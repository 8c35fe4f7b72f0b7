"""The kernels of tracking: a dispatcher to the compiled extension, or to its NumPy reference.

Each kernel has a signature like ``"f8[n,m] f8[k] -> f8[n,5]"``: element type and dimensions of its arrays in order;
a letter denotes the same length wherever it occurs. An array of another type, number of dimensions or length, or in
non-contiguous memory, raises `ValueError` before anything is computed. Arrays after the arrow are written to.

`COMPILED` is true if the extension is in use. The reference of each kernel is the function of the same name with an
underscore; it writes to its last arguments, like the compiled kernel in `kernels.c`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

ABI = 7  # version of the interface; an extension of another version is not used

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

_DISC_BATCH = 64  # windows that are processed together


def _extension() -> Any:
    try:
        found = import_module("gyrotrack._native._compiled")
    except ImportError:
        return None
    return found if getattr(found, "ABI", None) == ABI else None


_compiled = _extension()
# True if the compiled extension is in use, False if the NumPy reference is in use
COMPILED = _compiled is not None

_TERM = re.compile(r"([a-z]\d)\[([^\]]*)\]")


@cache
def _terms(signature: str) -> tuple[tuple[str, tuple[str, ...], bool], ...]:
    """Return element type, dimensions and a flag (output or not) of each array of a signature."""
    inputs, _, outputs = signature.partition("->")
    return tuple(
        (kind, tuple(dimensions.split(",")), written)
        for part, written in ((inputs, False), (outputs, True))
        for kind, dimensions in _TERM.findall(part)
    )


def _check(signature: str, arrays: tuple[Array, ...]) -> dict[str, int]:
    """Check arrays against a signature and return the lengths of its letters."""
    lengths: dict[str, int] = {}
    for number, ((kind, expected, written), array) in enumerate(
        zip(_terms(signature), arrays, strict=True), 1
    ):
        what = f"array {number} of the kernel: expected {kind}[{','.join(expected)}]"
        if array.dtype != np.dtype(kind) or not array.dtype.isnative:
            raise ValueError(f"{what}, got elements of type {array.dtype}")
        if array.ndim != len(expected):
            raise ValueError(f"{what}, got {array.ndim} dimensions")
        for letter, length in zip(expected, array.shape, strict=True):
            known = int(letter) if letter.isdigit() else lengths.setdefault(letter, length)
            if known != length:
                raise ValueError(f"{what}, got shape {array.shape} where {letter} = {known}")
        if not array.flags.c_contiguous or (written and not array.flags.writeable):
            raise ValueError(f"{what}, got an array that is not contiguous or not writeable")
    return lengths


def _require(condition: bool, message: str) -> None:  # noqa: FBT001
    if not condition:
        raise ValueError(message)


def _kernel(name: str) -> Callable[..., None]:
    return getattr(_compiled, name) if COMPILED else globals()[f"_{name}"]  # type: ignore[no-any-return]


def likelihood(squares: Array, excess: Array, shares: Array, clip: float) -> Array:
    r"""Return minus twice the mean log-likelihood of normal residuals, up to a constant, for each share (m,).

    The variance of residual k is :math:`s^2 (1 + q e_k)` with share q and excess e_k of the squared misfit (n,); the
    scale s is profiled. The squared residuals (n,) are clipped at `clip` times their median.
    """
    out = np.empty(len(shares))
    lengths = _check("f8[n] f8[n] f8[m] -> f8[m]", (squares, excess, shares, out))
    _require(
        lengths["n"] > 0 and lengths["m"] > 0, "the likelihood needs at least one residual and one share"
    )
    _kernel("likelihood")(squares, excess, shares, clip, out)
    return out


def match(
    profile: Array, curve: Array, slope: Array, start: Array, seen: Array,
    pad: int, limit: float, stride: float, rounds: int, fineness: float,
) -> Array:  # fmt: skip
    """Fit gain, offset and displacement of a template to each profile (n, m) by Gauss-Newton.

    `curve` and `slope` (m + 2 pad,) are the template and its derivative per sample, extended by `pad` >= `limit` + 2
    samples at both ends. `start` (n,) is the initial displacement, and `seen` (n, m) is a mask of the samples that are
    not occluded. `limit` is the largest displacement, and `stride` is the largest step. The template is evaluated at
    multiples of 1/`fineness` samples. The result is (n, 5): displacement [samples], gain, offset, sum of squared
    residuals, and the last diagonal element of the inverse normal matrix.
    """
    out = np.empty((len(profile), 5))
    profile, seen, start = (
        np.ascontiguousarray(profile),
        np.ascontiguousarray(seen),
        np.ascontiguousarray(start),
    )
    lengths = _check(
        "f8[n,m] f8[k] f8[k] f8[n] b1[n,m] -> f8[n,5]", (profile, curve, slope, start, seen, out)
    )
    fits = lengths["k"] == lengths["m"] + 2 * pad and limit + 2.0 <= pad
    _require(fits, "the template must be extended by at least limit + 2 samples at both ends")
    _kernel("match")(
        profile, curve, slope, start, seen.view(np.uint8), pad, limit, stride, rounds, fineness, out
    )
    return out


def bands(
    windows: Array, which: Array, light: Array, offset: Array, scale: Array, mixing: Array, *, across: bool
) -> Array:
    """Return averages of (light * window - offset) * scale over bands of rows, or columns (`across`), of windows.

    `which` (n,) are the indices of the averaged `windows` (k, rows, columns). `light` (n, columns) is a factor on each
    column, and `offset` (n,) is in units of the window. `mixing` (bands, rows) or (bands, columns) contains the weights
    of each band, with sum 1. The result has the shape (n, bands, columns) or (n, bands, rows).
    """
    count, parts = len(which), len(mixing)
    out = np.empty((count, parts, windows.shape[1] if across else windows.shape[2]))
    last = ("f4[p,c]", "f8[n,p,r]") if across else ("f4[p,r]", "f8[n,p,c]")
    signature = f"f4[k,r,c] i8[n] f8[n,c] f8[n] f8[n] {last[0]} -> {last[1]}"
    _check(signature, (windows, which, light, offset, scale, mixing, out))
    _require(
        not count or (which.min() >= 0 and which.max() < len(windows)), "an index is outside the windows"
    )
    _kernel("bands")(windows, which, light, offset, scale, mixing, across, out)
    return out


def crossings(curves: Array, first: int, step: int, level: float, least: float) -> Array:
    """Return where curves (n, k, m) fall below a level, in samples from `first`; NaN if never or at `first`.

    `step` (1 or -1) is the direction of the search; the crossing is interpolated linearly. `least` is the lower limit
    of the decrease between two samples, which is a divisor.
    """
    out = np.empty(curves.shape[:2])
    curves = np.ascontiguousarray(curves)
    lengths = _check("f8[n,k,m] -> f8[n,k]", (curves, out))
    _require(0 <= first < lengths["m"] and step in (1, -1), "the search begins outside the curves")
    _kernel("crossings")(curves, first, step, level, least, out)
    return out


def local_polynomials(
    value: Array, weight: Array, half: int, degree: int, hole: int, smooth: Array, leverage: Array
) -> None:
    """Fit a polynomial about each point of an evenly sampled series, with weights 1 - (x / (half + 1))^2.

    `value` and `weight` have the shape (n + 2 half,); the weight is 0 where a value is missing. `degree` is 0 to 3.
    Points up to the distance `hole` are excluded; -1 excludes none. The outputs (n,) are the fitted value `smooth`, and
    its derivative `leverage` with respect to the value at the point itself. Both are NaN if the window contains too few
    points.
    """
    lengths = _check("f8[m] f8[m] -> f8[n] f8[n]", (value, weight, smooth, leverage))
    fits = lengths["m"] == lengths["n"] + 2 * half and 1 <= half <= 1 << 20
    _require(
        fits and 0 <= degree <= 3 and -1 <= hole < half, "window, degree or hole do not match the series"
    )
    _kernel("local_polynomials")(value, weight, half, degree, hole, smooth, leverage)


def discs(pixels: Array, weights: tuple[float, float], radius: float) -> Array:
    """Return the centroid (n, 2) of a bright disc in each window [px of the window]; NaN where it is occluded.

    `pixels` (n, 2, side, side) are both chroma planes, with `weights` in the score; `radius` is in px. Foreground and
    background levels are quantiles of each window; a soft mask between 30 % and 70 % of their difference weights each
    pixel at the edge by the fraction of the pixel that the disc covers.
    """
    out = np.empty((len(pixels), 2))
    _check("u1[n,2,s,s] -> f8[n,2]", (pixels, out))
    _kernel("discs")(pixels, weights, radius, out)
    return out


def locate(windows: Array, column: Array, rows: tuple[int, int, int], half: int, reach: int) -> Array:
    """Return displacement [columns] and mean score (n, 2) of a marker about its expected column.

    The score is 0 if its maximum is at the limit of the search.

    `windows` (n, rows, columns) are contiguous in every row. `column` (n,) is the first column of the search. `rows`
    are start, stop and step of the rows to average. `half` is the half width of the marker, and `reach` is the half
    width of the search.
    """
    windows, column = np.ascontiguousarray(windows), np.ascontiguousarray(column)
    out = np.empty((len(windows), 2))
    _check("f4[n,r,c] f8[n] -> f8[n,2]", (windows, column, out))
    begin, end, step = rows
    fits = 0 <= begin < end <= windows.shape[1] and step >= 1
    room = windows.shape[2] - 2 * half - 2 * reach - 2
    _require(
        fits and half >= 0 and reach >= 1 and room >= 0, "rows, marker or search do not match the windows"
    )
    _kernel("locate")(windows, column, rows, half, reach, out)
    return out


def sample(
    planes: tuple[list[Array], ...], weights: tuple[float, float], places: tuple[Array, Array, Array],
    box: Array, ground: Array, first: Array, score: Array, out: Array,
) -> None:  # fmt: skip
    """Sample windows of a polar grid from planes of frames by bilinear interpolation, and subtract a background.

    `planes` are one or two lists with one plane (height, width) for each frame; the rows of a plane may be padded. The
    score is the sum of the planes times `weights`. `places` are three arrays (rows, columns). The first contains the
    pixel above and to the left of each sample as int32 (row in the upper, column in the lower 16 bits). The others
    contain the distances from this pixel to the right and down as float32 [px]. `box` (starts, 4) contains the left,
    right, top and bottom edge of the pixels of a window that begins at each column. `ground` (rows, columns) is the
    background, and `first` (n,) is the first column of the window in each frame. `score` (height, width) is a work
    array; `out` (n, rows, width) is written to.
    """
    at, right, down = places
    signature = "i4[r,c] f4[r,c] f4[r,c] i4[b,4] f4[r,c] i8[n] -> f4[h,w] f4[n,r,o]"
    lengths = _check(signature, (at, right, down, box, ground, first, score, out))
    _require(len(planes) in (1, 2), "one or two lists of planes are expected")
    for plane in (plane for kind in planes for plane in kind):
        if not (plane.dtype == np.uint8 and plane.shape == score.shape and plane.strides[1] == 1):
            what = f"a plane has type {plane.dtype} and shape {plane.shape}, expected uint8 {score.shape}"
            raise ValueError(what)
    _require(all(len(kind) == lengths["n"] for kind in planes), "the number of planes and windows differ")
    inside = first.size == 0 or (
        first.min() >= 0 and first.max() < lengths["b"] and first.max() + lengths["o"] <= lengths["c"]
    )
    _require(bool(inside), "a window is outside the ring")
    _kernel("sample")(planes, weights, at, right, down, box, ground, first, score, out)


def ring(
    planes: list[Array], centre: Array, turn: Array, radius: Array, direction: Array, out: Array
) -> None:
    """Sample rings from one plane (height, width) per frame by bilinear interpolation, rounded to grey levels.

    The sample of row i and column j in frame k is at the radius r_i (`radius` (rows,) [px]) about `centre` (n, 2) (x,
    y) [px] and at the angle a_j + b_k, counter-clockwise: `direction` (2, columns) contains cos and sin of a_j, and
    `turn` (n, 2) contains cos and sin of b_k. For a sample outside the picture, the nearest pixel is used. `out` (n,
    rows, columns) is written to.
    """
    lengths = _check("f8[n,2] f8[n,2] f4[r] f4[2,c] -> u1[n,r,c]", (centre, turn, radius, direction, out))
    _require(len(planes) == lengths["n"], "the number of planes and rings differ")
    shape = planes[0].shape if planes else (2, 2)
    _require(len(shape) == 2 and min(shape) >= 2, "a plane needs two rows and two columns at least")
    for plane in planes:
        if not (plane.dtype == np.uint8 and plane.shape == shape and plane.strides[1] == 1):
            what = f"a plane has type {plane.dtype} and shape {plane.shape}, expected uint8 {shape}"
            raise ValueError(what)
    _kernel("ring")(planes, centre, turn, radius, direction, out)


def turned(strips: Array, which: Array, ahead: Array, light: Array, first: Array) -> Array:
    """Return rings without their margins, turned back by fractions of a column, less static light, (n, rows, columns).

    The result at column j of frame k is the difference of two values. The first is the ring `which[k]` of `strips` (m,
    rows, columns + 2 margin), linearly interpolated at the column j + margin + `ahead[k]`. The second is the column (j
    + `first[k]`) modulo columns of `light` (rows, columns).
    """
    out = np.empty((len(which), *light.shape), dtype=np.float32)
    signature = "u1[m,r,d] i8[n] f8[n] f4[r,c] i8[n] -> f4[n,r,c]"
    lengths = _check(signature, (strips, which, ahead, light, first, out))
    margin = 0.5 * (lengths["d"] - lengths["c"])
    if len(which):
        inside = which.min() >= 0 and which.max() < len(strips)
        inside = inside and first.min() >= 0 and first.max() < lengths["c"]
        _require(
            bool(inside and np.abs(ahead).max() <= margin - 1.0),
            "a ring is turned beyond its margin or missing",
        )
    _kernel("turned")(strips, which, ahead, light, first, out)
    return out


def sample_sums(strips: Array, row: int, picture: Array, weights: Array) -> Array:
    """Return weighted sums over the samples of each picture, (n, 4).

    The samples x of picture k are the (p,) values of `strips` (n, rows, columns) that start at a given row. With d = x
    - `picture` (p,) and `weights` w (4, p), the terms of the four sums are w_0 d, w_1 d, w_2 d and w_3 d^2.
    """
    out = np.empty((len(strips), 4))
    lengths = _check("f4[n,r,c] f4[p] f4[4,p] -> f8[n,4]", (strips, picture, weights, out))
    _require(
        row >= 0 and lengths["p"] <= (lengths["r"] - row) * lengths["c"], "the picture is outside the rows"
    )
    _kernel("sample_sums")(strips, row, picture, weights, out)
    return out


def frame_sums(strips: Array, row: int, picture: Array, weights: Array) -> Array:
    """Return weighted sums over the pictures for each sample, (5, p).

    With d as for `sample_sums` and `weights` w (n, 4), the terms of the five sums are w_0 d, w_0 d^2, w_1 d, w_2 d and
    w_3 d. Pictures with w_0 = 0 are omitted.
    """
    out = np.zeros((5, len(picture)), dtype=np.float32)
    lengths = _check("f4[n,r,c] f4[p] f4[n,4] -> f4[5,p]", (strips, picture, weights, out))
    _require(
        row >= 0 and lengths["p"] <= (lengths["r"] - row) * lengths["c"], "the picture is outside the rows"
    )
    _kernel("frame_sums")(strips, row, picture, weights, out)
    return out


def _likelihood(squares: Floats, excess: Floats, shares: Floats, clip: float, out: Floats) -> None:
    """Compute `likelihood` with NumPy."""
    for k, share in enumerate(shares):
        variance = 1.0 + share * excess
        scaled = squares / variance
        scaled = np.minimum(scaled, clip * np.median(scaled))
        out[k] = np.log(max(scaled.mean(), 1e-30)) + np.log(variance).mean()


def _match(
    profile: Floats, curve: Floats, slope: Floats, start: Floats, seen: Array,
    pad: int, limit: float, stride: float, rounds: int, fineness: float, out: Floats,
) -> None:  # fmt: skip
    """Compute `match` with NumPy."""
    weight = seen.astype(np.float64)
    weighted = weight * profile
    squares = np.einsum("nm,nm->n", weighted, profile)
    at = np.arange(profile.shape[1])
    out[:] = 0.0
    shift = np.clip(start, -limit, limit)
    moving = np.arange(len(start))
    for _ in range(rounds):
        place = np.rint(shift[moving] * fineness) / fineness
        known = np.isfinite(place)
        out[moving[~known]] = np.nan
        moving, place = moving[known], place[known]
        whole = np.floor(-place)
        part = (-place - whole)[:, None]
        index = pad + whole.astype(np.int64)[:, None] + at
        c, s = (line[index] + part * (line[index + 1] - line[index]) for line in (curve, slope))
        rows = np.stack([c, np.ones_like(c), s], axis=1)
        normal = np.einsum("nim,nm,njm->nij", rows, weight[moving], rows)
        normal += 1e-9 * (1.0 + np.trace(normal, axis1=1, axis2=2))[:, None, None] * np.eye(3)
        right = np.einsum("nim,nm->ni", rows, weighted[moving])
        inverse = np.linalg.inv(normal)
        solution = np.einsum("nij,nj->ni", inverse, right)
        gain = solution[:, 0]
        off = -solution[:, 2] / np.where(np.abs(gain) > 1e-3, gain, np.inf)
        shift[moving] = np.clip(place + np.clip(off, -stride, stride), -limit, limit)
        left = squares[moving] - (solution * right).sum(axis=1)
        out[moving] = np.column_stack([shift[moving], gain, solution[:, 1], left, inverse[:, 2, 2]])
        moving = moving[np.rint(shift[moving] * fineness) / fineness != place]
        if not len(moving):
            break


def _bands(
    windows: Array,
    which: Array,
    light: Floats,
    offset: Floats,
    scale: Floats,
    mixing: Array,
    across: int,
    out: Floats,
) -> None:
    """Compute `bands` with NumPy."""
    lit = windows[which] * light[:, None, :].astype(np.float32)
    mixed = np.matmul(lit, mixing.T).transpose(0, 2, 1) if across else np.matmul(mixing, lit)
    out[:] = (mixed - offset[:, None, None]) * scale[:, None, None]


def _crossings(curves: Floats, first: int, step: int, level: float, least: float, out: Floats) -> None:
    """Compute `crossings` with NumPy."""
    values = curves[:, :, first::step]
    below = values < level
    where = np.argmax(below, axis=2)
    valid = below.any(axis=2) & (where > 0)
    index = np.clip(where, 1, values.shape[2] - 1)
    high = np.take_along_axis(values, index[..., None] - 1, axis=2)[..., 0]
    low = np.take_along_axis(values, index[..., None], axis=2)[..., 0]
    part = np.clip((high - level) / np.maximum(high - low, least), 0.0, 1.0)
    out[:] = np.where(valid, index - 1 + part, np.nan)


def _local_polynomials(
    value: Floats, weight: Floats, half: int, degree: int, hole: int, smooth: Floats, leverage: Floats
) -> None:
    """Compute `local_polynomials` with NumPy."""
    n = len(smooth)
    x = np.arange(-half, half + 1, dtype=np.float64) / (half + 1)
    bell = np.where(np.abs(np.arange(-half, half + 1)) <= hole, 0.0, 1.0 - x**2)
    clean = np.where(weight > 0, value, 0.0) * weight

    def moment(series: Floats, power: int) -> Floats:
        return np.convolve(series, (bell * x**power)[::-1], mode="valid")

    s = [moment(weight, k) for k in range(2 * degree + 1)]
    t = np.stack([moment(clean, k) for k in range(degree + 1)], axis=1)
    matrix = np.empty((n, degree + 1, degree + 1))
    for i in range(degree + 1):
        for j in range(degree + 1):
            matrix[:, i, j] = s[i + j]
    held = np.convolve((weight > 0).astype(float), np.ones(2 * half + 1), mode="valid")
    enough = held > degree + 2.5
    matrix[~enough] = np.eye(degree + 1)
    matrix += 1e-9 * np.maximum(s[0], 1e-12)[:, None, None] * np.eye(degree + 1)
    row = np.linalg.solve(matrix, np.broadcast_to(np.eye(degree + 1)[:, :1], (n, degree + 1, 1)))[..., 0]
    smooth[:] = np.where(enough, (row * t).sum(axis=1), np.nan)
    leverage[:] = np.where(enough, row[:, 0] * bell[half], np.nan)


def _discs(pixels: Array, weights: tuple[float, float], radius: float, out: Floats) -> None:
    """Compute `discs` with NumPy."""
    for first in range(0, len(pixels), _DISC_BATCH):
        some = pixels[first : first + _DISC_BATCH].astype(np.float32)
        out[first : first + _DISC_BATCH] = _disc_centroids(
            some[:, 0] * np.float32(weights[0]) + some[:, 1] * np.float32(weights[1]), radius
        )


def _disc_centroids(score: npt.NDArray[np.float32], radius: float) -> Floats:
    count, side, _ = score.shape
    grid = np.arange(side, dtype=np.float64)
    few = score[:, ::3, ::3].reshape(count, -1)
    ranks = [int(part * (few.shape[1] - 1)) for part in (0.97, 0.5)]
    level, ground = np.partition(few, ranks, axis=1)[:, ranks, None, None].transpose(1, 0, 2, 3)
    step = np.maximum(level - ground, np.float32(1e-6))
    soft = np.clip((score - (ground + np.float32(0.3) * step)) / (np.float32(0.4) * step), 0.0, 1.0)
    x, y = np.full((2, count), (side - 1) / 2.0)
    for reach in (2.2 * radius + 3.0, 1.5 * radius + 1.5, 1.35 * radius + 1.0):
        half_chord = np.sqrt(np.maximum(reach**2 - (grid - y[:, None]) ** 2, 0.0))[:, :, None]
        weight = soft * (np.abs(grid - x[:, None])[:, None, :] < half_chord)
        across = weight.sum(axis=1, dtype=np.float64)
        total = np.maximum(across.sum(axis=1), 1e-9)
        x = (across @ grid) / total
        y = (weight.sum(axis=2, dtype=np.float64) @ grid) / total
    expected = np.pi * radius**2
    hidden = (total < 0.6 * expected) | (total > 1.7 * expected) | (step[:, 0, 0] < 0.3)
    return np.where(hidden[:, None], np.nan, np.column_stack([x, y]))


def _locate(
    windows: Array, column: Floats, rows: tuple[int, int, int], half: int, reach: int, out: Floats
) -> None:
    """Compute `locate` with NumPy."""
    profile = windows[:, slice(*rows)].mean(axis=1, dtype=np.float64)
    total = np.pad(np.cumsum(profile, axis=1), ((0, 0), (1, 0)))
    box = (total[:, 2 * half + 1 :] - total[:, : -2 * half - 1]) / (2 * half + 1)
    low = np.clip(np.floor(column).astype(np.int64), 0, box.shape[1] - 2 * reach - 2)
    part = np.clip(column - low, 0.0, 1.0)[:, None]
    frame = np.arange(len(column))
    cut = sliding_window_view(box, 2 * reach + 2, axis=1)[frame, low]
    height = (1.0 - part) * cut[:, :-1] + part * cut[:, 1:]
    top = np.argmax(height, axis=1)
    inner = np.clip(top, 1, 2 * reach - 1)
    left, middle, right = (height[frame, inner + k] for k in (-1, 0, 1))
    bend = np.minimum(left - 2.0 * middle + right, -1e-9)
    off = np.where(inner == top, np.clip(0.5 * (left - right) / bend, -0.5, 0.5), 0.0)
    out[:] = np.column_stack([top - reach + off, np.where(inner == top, middle, 0.0)])


def _sample(
    planes: tuple[list[Array], ...], weights: tuple[float, float], at: Array, right: Array, down: Array,
    box: Array, ground: Array, first: Array, score: Array, out: Array,
) -> None:  # fmt: skip
    """Compute `sample` with NumPy."""
    del score  # work array of the compiled kernel only
    width = out.shape[2]
    a, b = (np.float32(w) for w in weights)
    for k, begin in enumerate(first.tolist()):
        left, end, top, bottom = box[begin].tolist()
        region = (slice(top, bottom), slice(left, end))
        picture = planes[0][k][region].astype(np.float32)
        if len(planes) == 2:
            picture = a * picture + b * planes[1][k][region].astype(np.float32)
        part = (slice(None), slice(begin, begin + width))
        x, y = (at[part] & 0xFFFF) - left, (at[part] >> 16) - top
        below, after = np.minimum(y + 1, len(picture) - 1), np.minimum(x + 1, picture.shape[1] - 1)
        near = picture[y, x] + down[part] * (picture[below, x] - picture[y, x])
        far = picture[y, after] + down[part] * (picture[below, after] - picture[y, after])
        found = near + right[part] * (far - near)
        out[k] = (found * a if len(planes) == 1 else found) - ground[part]


def _ring(
    planes: list[Array], centre: Array, turn: Array, radius: Array, direction: Array, out: Array
) -> None:
    """Compute `ring` with NumPy."""
    c, s = turn.astype(np.float32).T
    for plane, cos, sin, (x0, y0), found in zip(planes, c, s, centre.astype(np.float32), out, strict=True):
        right, up = cos * direction[0] - sin * direction[1], sin * direction[0] + cos * direction[1]
        height, width = plane.shape
        x = np.clip(x0 + radius[:, None] * right, 0, width - 1)
        y = np.clip(y0 - radius[:, None] * up, 0, height - 1)
        column = np.minimum(x.astype(np.int64), width - 2)
        line = np.minimum(y.astype(np.int64), height - 2)
        beside, below = x - column, y - line
        grey = plane.astype(np.float64)
        above = grey[line, column] + beside * (grey[line, column + 1] - grey[line, column])
        under = grey[line + 1, column] + beside * (grey[line + 1, column + 1] - grey[line + 1, column])
        found[:] = np.floor(above + below * (under - above) + 0.5)


def _turned(strips: Array, which: Array, ahead: Array, light: Array, first: Array, out: Array) -> None:
    """Compute `turned` with NumPy."""
    count = out.shape[2]
    twice = np.concatenate([light, light], axis=1)
    for at, columns, k, found in zip(which, ahead, first, out, strict=True):
        shift = 0.5 * (strips.shape[2] - count) + columns
        whole = int(np.floor(shift))
        seen = strips[at].astype(np.float32)
        near, far = seen[:, whole : whole + count], seen[:, whole + 1 : whole + 1 + count]
        found[:] = near + np.float32(shift - whole) * (far - near) - twice[:, k : k + count]


def _sample_sums(strips: Array, row: int, picture: Array, weights: Array, out: Array) -> None:
    """Compute `sample_sums` with NumPy."""
    off = strips.reshape(len(strips), -1)[:, row * strips.shape[2] :][:, : len(picture)] - picture
    out[:, :3], out[:, 3] = off @ weights[:3].T, off**2 @ weights[3]


def _frame_sums(strips: Array, row: int, picture: Array, weights: Array, out: Array) -> None:
    """Compute `frame_sums` with NumPy."""
    off = strips.reshape(len(strips), -1)[:, row * strips.shape[2] :][:, : len(picture)] - picture
    used = np.where(weights[:, :1] != 0.0, weights, np.float32(0.0))
    out[0], out[1], out[2:] = used[:, 0] @ off, used[:, 0] @ off**2, used[:, 1:].T @ off
