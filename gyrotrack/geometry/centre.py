"""The path of the centre: slow motion and regular fast motion kept, noise removed.

The noise of a compressed film is not independent from frame to frame, so that what predicts the next frame
best is not the true path. The path is therefore taken as a slow curve (local parabolas, their width chosen
by how well they predict points at least `HOLE` frames away) plus whatever stands out as a line in the
spectrum of the rest: a precession or a wobble with the turn of the casing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.local import local_fit

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

HOLE = 8
"""Frames over which the errors of a compressed film hang together."""
_HALVES = (24, 48, 96, 192)
_STANDS_OUT = 7.0
_PIECES = 64
LEAST_SIGMA = 0.05
"""Uncertainty in px that no smoothing beats: encoders hold a disc in place while it creeps."""


@dataclass(frozen=True)
class CentrePath:
    """The centre in each frame (n, 2) [px], its uncertainty per axis (n,) [px], frames of smoothing."""

    centre: Floats
    sigma: Floats
    reach: int


def smooth_path(measured: Floats) -> CentrePath:
    """Smooth a measured path, (n, 2) in px, NaN where there is none."""
    known: npt.NDArray[np.bool_] = np.asarray(np.isfinite(measured).all(axis=1))
    if not known.any():
        return CentrePath(measured, np.full(len(measured), np.nan), 0)
    index = np.arange(len(measured))
    x, y = (np.interp(index, index[known], measured[known, k]) for k in (0, 1))
    z = x + 1j * y
    del index, x, y
    weight: Floats = known.astype(np.float64)
    halves = [half for half in _HALVES if 3 * half <= len(z)]
    if not halves:
        return _steady(z, known)
    half = min(halves, key=lambda h: _prediction_error(z, weight, h))
    slow = _fitted(z, weight, half)
    path = slow + _lines(np.where(known, z - slow, 0.0))
    left = (z - path)[known]
    sigma = _left_error(left, half)
    gap = np.convolve(weight, np.ones(2 * half + 1), mode="same") > 0
    return CentrePath(np.stack([path.real, path.imag], axis=1), np.where(gap, sigma, np.nan), half)


def _steady(z: Complexes, known: npt.NDArray[np.bool_]) -> CentrePath:
    """Take the mean for a clip of a few frames."""
    mean = z[known].mean()
    scatter = float(np.sqrt(np.mean(np.abs(z[known] - mean) ** 2) / 2.0))
    centre = np.tile([mean.real, mean.imag], (len(z), 1))
    return CentrePath(centre, np.full(len(z), max(scatter, LEAST_SIGMA)), len(z))


def _fitted(z: Complexes, weight: Floats, half: int, hole: int = -1) -> Complexes:
    origin = z.mean()
    x, y = (local_fit(part, weight, half, 2, hole)[0] for part in ((z - origin).real, (z - origin).imag))
    fitted = origin + x + 1j * y
    return np.asarray(np.where(np.isfinite(fitted), fitted, z))


def _prediction_error(z: Complexes, weight: Floats, half: int) -> float:
    """Return the trimmed mean squared error of predicting points from others at least `HOLE` frames away."""
    error = np.abs(z - _fitted(z, weight, half, HOLE)) ** 2
    inner = slice(half // 2, len(z) - half // 2)
    core = np.sort(error[inner][weight[inner] > 0])
    return float(core[: max(int(0.95 * len(core)), 1)].mean()) if len(core) else float("inf")


def _lines(rest: Complexes) -> Complexes:
    """Keep what stands out of the spectrum of a series, piece by piece (Hann windows, half overlapping)."""
    n = len(rest)
    if n < 96:
        return np.zeros(n, dtype=np.complex128)
    size = 64 if n < 1024 else 128
    hop = size // 2
    padded = np.pad(rest, (size, size + (-n) % hop))
    window = np.sqrt(np.hanning(size + 1)[:size])
    starts = range(0, len(padded) - size + 1, hop)
    inner = starts[2:-2] if len(starts) > 6 else starts
    total = np.zeros(size)
    for _, spectra in _spectra(padded, window, inner):
        for power in np.abs(spectra) ** 2:
            total += power
    floor = _floor(total / len(inner))
    out = np.zeros(len(padded), dtype=np.complex128)
    for some, spectra in _spectra(padded, window, starts):
        power = np.abs(spectra) ** 2
        kept = spectra * np.where(power > _STANDS_OUT * floor, 1.0 - floor / np.maximum(power, 1e-12), 0.0)
        for start, piece in zip(some, np.fft.ifft(kept, axis=1) * window, strict=True):
            out[start : start + size] += piece
    return out[size : size + n]


def _spectra(series: Complexes, window: Floats, starts: range) -> Iterator[tuple[range, Complexes]]:
    """Yield the spectra of the pieces that begin at `starts`, (m, size), some at a time."""
    for k in range(0, len(starts), _PIECES):
        some = starts[k : k + _PIECES]
        yield some, np.fft.fft(np.stack([series[s : s + len(window)] * window for s in some]), axis=1)


def _floor(power: Floats) -> Floats:
    """Return the level of a spectrum without its lines: a running median, raised to the mean of noise."""
    reach = 8
    wrapped = np.concatenate([power[-reach:], power, power[:reach]])
    around = np.stack([wrapped[k : k + len(power)] for k in range(2 * reach + 1)])
    return np.asarray(np.median(around, axis=0) / np.log(2.0) + 1e-9)


def _left_error(left: Complexes, half: int) -> float:
    """Return what remains of the noise in the smoothed path: its rms, lessened by averaging."""
    rms = float(np.sqrt(np.mean(np.abs(left) ** 2) / 2.0))
    lags = min(48, len(left) // 4)
    base = float(np.mean(np.abs(left) ** 2)) + 1e-12
    chain = [float(np.mean((left[k:] * left[: len(left) - k].conj()).real)) / base for k in range(1, lags)]
    length = 1.0 + 2.0 * sum(c for c in chain if c > 0.1)
    return max(rms * float(np.sqrt(min(length / (1.1 * half), 1.0))), LEAST_SIGMA)
