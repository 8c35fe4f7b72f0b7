"""Deceleration of repeated coast-downs at equal speeds, without a model: do the runs themselves agree?

    python benchmarks/fitting/repeats.py FIRST.h5 SECOND.h5 [--speeds 30 20 10 5]

A cubic in time through the 121 samples nearest to the time of a speed gives the angular acceleration there; its
standard error is that of the least-squares fit. Cases are made by `gyrotrack import --body`.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import h5py
import numpy as np

_HALF, _SMOOTHING = 60, 9


def decelerations(path: Path, speeds: list[float]) -> list[tuple[float, float]]:
    """Return deceleration and standard error at some speeds [rad/s2]."""
    with h5py.File(path) as file:
        time, angle = file["casing/time"][:], file["casing/angle"][:]
    speed = np.convolve(np.gradient(angle, time), np.ones(_SMOOTHING) / _SMOOTHING, "same")
    found = []
    for wanted in speeds:
        middle = _SMOOTHING + int(np.argmin(np.abs(speed[_SMOOTHING:-_SMOOTHING] - wanted)))
        part = slice(max(middle - _HALF, 0), middle + _HALF + 1)
        moment = np.interp(-wanted, -speed[part], time[part])
        powers, covariance = np.polyfit(time[part] - moment, angle[part], 3, cov=True)
        found.append((-2 * float(powers[1]), 2 * math.sqrt(float(covariance[1, 1]))))
    return found


def main() -> None:
    """Print the decelerations of both runs and their ratio."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs=2, type=Path)
    parser.add_argument("--speeds", nargs="*", type=float, default=[30.0, 25.0, 20.0, 15.0, 10.0, 7.0, 5.0])
    options = parser.parse_args()
    first, second = (decelerations(path, options.speeds) for path in options.runs)
    print("| speed [rad/s] | first [rad/s2] | second [rad/s2] | first / second |")
    print("|---|---|---|---|")
    for speed, (a, ua), (b, ub) in zip(options.speeds, first, second, strict=True):
        u = a / b * math.hypot(ua / a, ub / b)
        print(f"| {speed:g} | {a:.5f}({ua:.5f}) | {b:.5f}({ub:.5f}) | {a / b:.4f}({u:.4f}) |")


if __name__ == "__main__":
    main()
