"""Errors of the angles where a body passes the same places in step with the frames.

    python benchmarks/tracking/aliases.py -o benchmarks/tracking/aliases.md

An error that repeats with an angle a, with k periods per turn, is seen as a slow one where k times the speed of a is
near a multiple of 2 pi times the capture rate. a is the angle of the body itself, of the other body, or of one to the
other (the markers of the rotor pass below the bar three times per relative turn). In each film one such product sweeps
through the multiple, by 1 % of it (slow) or by 20 % (fast), in the light of a lamp that flickers by 5 % at 0, 100 or
120 Hz.

An amplitude A_k is fitted to the errors in stretches of 3 s (casing) or 0.5 s (rotor) beside a parabola, which is what
the motion absorbs. Noise of variance s^2 in n frames has a mean A_k^2 of 4 s^2 / n, which is subtracted. The largest of
the 36 rms amplitudes is given, with its angle and order, and the rms of means over 0.1 s beside what the file claims
for slow and for repeating errors. A film whose line is in the output is not drawn again.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import replace
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from clips import CAMERAS, LIGHT, SCENE
from speed import commit

from gyrotrack.synthetic._film import Film, render_clip
from gyrotrack.synthetic._scene import Motion
from gyrotrack.tracking._extract import extract

TURN = 2.0 * np.pi
SPAN = {"casing": 12.0, "rotor": 3.0}
STRETCH = {"casing": 3.0, "rotor": 0.5}
SWEEPS = {"slow": 0.01, "fast": 0.2}
LAMPS = (0.0, 100.0, 120.0)
FLICKER = 0.05
# body of the camera, angle and order of the error, speed of the other body [rad/s], multiple of the capture rate
PASSAGES = (
    ("casing", "relative", 3, 150.0, 1),
    ("casing", "relative", 6, 150.0, 1),
    ("casing", "own", 8, 800.0, 1),
    ("casing", "own", 2, 500.0, 0),
    ("casing", "other", 2, 120.0, 1),
    ("rotor", "own", 7, 100.0, 1),
    ("rotor", "relative", 8, 100.0, 1),
)


def speeds(passage: tuple[str, str, int, float, int], share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the speeds of casing and rotor [rad/s] that pass the multiple by the relative distances `share`.

    A multiple of 0 is a body that starts from rest.
    """
    body, angle, order, fixed, multiple = passage
    passed = TURN * CAMERAS[body].fps * multiple / order * (1.0 + share)
    if multiple == 0:
        passed = 40.0 * (share - share.min()) / np.ptp(share)
    held = np.full_like(share, fixed)
    if angle == "relative":
        return (held, held + passed)
    own = (angle == "own") == (body == "casing")
    return (passed, held) if own else (held, passed)


def amplitudes(error: np.ndarray, angles: dict[str, np.ndarray], size: int) -> tuple[float, str]:
    """Return the largest rms amplitude beyond noise [rad], and the name of its angle and order."""
    best, where = 0.0, "-"
    for name, angle in angles.items():
        for order in range(1, 13):
            excess = []
            for first in range(0, len(error) - size + 1, size):
                part = slice(first, first + size)
                x = np.linspace(-1.0, 1.0, size)
                rows = np.stack(
                    [np.cos(order * angle[part]), np.sin(order * angle[part]), np.ones(size), x, x**2], axis=1
                )
                found, *_ = np.linalg.lstsq(rows, error[part], rcond=None)
                covariance = np.linalg.pinv(rows.T @ rows) * np.var(error[part] - rows @ found)
                if (
                    np.trace(covariance[:2, :2]) < 4.0 * 4.0 * np.var(error[part]) / size
                ):  # not the motion itself
                    excess.append(found[0] ** 2 + found[1] ** 2 - np.trace(covariance[:2, :2]))
            if excess and np.mean(excess) > best**2:
                best, where = float(np.sqrt(np.mean(excess))), f"{name} {order}"
    return best, where


def measured(passage: tuple[str, str, int, float, int], sweep: str, lamp: float, folder: Path) -> str:
    """Render and track one film, and return its line of the table."""
    body = passage[0]
    time = np.linspace(0.0, SPAN[body], int(500 * SPAN[body]) + 1)
    share = np.linspace(SWEEPS[sweep], -SWEEPS[sweep], len(time))
    rates = np.stack(speeds(passage, share))
    path = np.concatenate(
        [np.zeros((2, 1)), np.cumsum(0.5 * (rates[:, 1:] + rates[:, :-1]) * np.diff(time), axis=1)], 1
    )
    camera = replace(CAMERAS[body], start=2.0 / CAMERAS[body].fps)
    light = replace(LIGHT, flicker=FLICKER if lamp else 0.0, flicker_hz=lamp or 100.0)
    frames = int(SPAN[body] * camera.fps) - 4
    motion = Motion.from_angles(time, path[1], path[0])
    file = folder / "film.mp4"
    render_clip(file, SCENE, motion, camera, light, frames=frames, film=Film(), seed=1, force=True)
    track = extract(file, capture_fps=camera.fps, body=None).bodies[body]
    at = camera.times(frames)[np.rint(track.time * camera.fps).astype(int)]
    casing, rotor = (np.interp(at, time, p) for p in path)
    own, other = (casing, rotor) if body == "casing" else (rotor, casing)
    error = track.angle - own
    known = np.isfinite(error)
    error = error[known] - error[known].mean()
    angles = {"own": own[known], "other": other[known], "relative": (rotor - casing)[known]}
    largest, where = amplitudes(error, angles, round(STRETCH[body] * camera.fps))
    m = round(0.1 * camera.fps)
    means = error[: len(error) // m * m].reshape(-1, m).mean(axis=1)
    claims = 1e3 * np.array([track.correlated_sigma, track.periodic_sigma, track.harmonic_sigma])
    z = np.sqrt(np.mean((error / track.sigma[known]) ** 2))
    _, angle, order, _, multiple = passage
    return (
        f"| {body} | {angle} {order}, {multiple} | {sweep} | {lamp:.0f} | {1e3 * error.std():.2f} | {z:.2f} | "
        f"{1e3 * largest:.2f} ({where}) | {1e3 * means.std():.2f} | {claims[0]:.2f}, {claims[1]:.2f}, {claims[2]:.2f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    head = (
        "# Errors in step with the frames\n\n"
        f'Commit {commit()}, `aliases.py`. Errors in mrad. The column "passage" states the angle and the order of an\n'
        "error, and the multiple of the capture rate with which this error is in step; 0 is a casing that starts from\n"
        'rest. The column "claims" contains the stated standard deviations of slow errors, of errors once and twice\n'
        "per turn, and of harmonics from order 3 on.\n\n"
        "| camera | passage | sweep | lamp / Hz | rms | z | largest harmonic | means of 0.1 s | claims |\n"
        "|---|---|---|---|---|---|---|---|---|\n"
    )
    before = args.output.read_text().splitlines() if args.output is not None and args.output.exists() else []
    done = {tuple(line.split("|")[1:5]): line for line in before if line.startswith(("| casing", "| rotor"))}
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for passage in PASSAGES:
            for sweep in SWEEPS if passage[4] else ("slow",):
                for lamp in LAMPS if sweep == "slow" else (0.0,):
                    body, angle, order, _, multiple = passage
                    key = (f" {body} ", f" {angle} {order}, {multiple} ", f" {sweep} ", f" {lamp:.0f} ")
                    lines.append(done.get(key) or measured(passage, sweep, lamp, Path(folder)))
                    print(lines[-1], flush=True)
                    if args.output is not None:
                        args.output.write_text(head + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
