"""NumPy reference of the kernels in `kernels.c`, used where they are not compiled.

Every function writes to its last arguments, as the compiled kernel of the same name does. `gyrotrack._native._kernels`
checks types and shapes and documents the kernels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

Floats = npt.NDArray[np.float64]
Array = npt.NDArray[Any]

_DISC_BATCH = 64  # windows that are processed together


def likelihood(squares: Floats, excess: Floats, shares: Floats, clip: float, out: Floats) -> None:
    """See `gyrotrack._native._kernels.likelihood`."""
    for k, share in enumerate(shares):
        variance = 1.0 + share * excess
        scaled = squares / variance
        scaled = np.minimum(scaled, clip * np.median(scaled))
        out[k] = np.log(max(scaled.mean(), 1e-30)) + np.log(variance).mean()


def match(
    profile: Floats, curve: Floats, slope: Floats, start: Floats, seen: Array,
    pad: int, limit: float, stride: float, rounds: int, fineness: float, out: Floats,
) -> None:  # fmt: skip
    """See `gyrotrack._native._kernels.match`."""
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


def bands(
    windows: Array,
    which: Array,
    light: Floats,
    offset: Floats,
    scale: Floats,
    mixing: Array,
    across: int,
    out: Floats,
) -> None:
    """See `gyrotrack._native._kernels.bands`."""
    lit = windows[which] * light[:, None, :].astype(np.float32)
    mixed = np.matmul(lit, mixing.T).transpose(0, 2, 1) if across else np.matmul(mixing, lit)
    out[:] = (mixed - offset[:, None, None]) * scale[:, None, None]


def crossings(curves: Floats, first: int, step: int, level: float, least: float, out: Floats) -> None:
    """See `gyrotrack._native._kernels.crossings`."""
    values = curves[:, :, first::step]
    below = values < level
    where = np.argmax(below, axis=2)
    valid = below.any(axis=2) & (where > 0)
    index = np.clip(where, 1, values.shape[2] - 1)
    high = np.take_along_axis(values, index[..., None] - 1, axis=2)[..., 0]
    low = np.take_along_axis(values, index[..., None], axis=2)[..., 0]
    part = np.clip((high - level) / np.maximum(high - low, least), 0.0, 1.0)
    out[:] = np.where(valid, index - 1 + part, np.nan)


def local_polynomials(
    value: Floats, weight: Floats, half: int, degree: int, hole: int, smooth: Floats, leverage: Floats
) -> None:
    """See `gyrotrack._native._kernels.local_polynomials`."""
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


def discs(pixels: Array, weights: tuple[float, float], radius: float, out: Floats) -> None:
    """See `gyrotrack._native._kernels.discs`."""
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


def locate(
    windows: Array, column: Floats, rows: tuple[int, int, int], half: int, reach: int, out: Floats
) -> None:
    """See `gyrotrack._native._kernels.locate`."""
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


def sample(
    planes: tuple[list[Array], ...], weights: tuple[float, float], at: Array, right: Array, down: Array,
    box: Array, ground: Array, first: Array, score: Array, out: Array,
) -> None:  # fmt: skip
    """See `gyrotrack._native._kernels.sample`."""
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
