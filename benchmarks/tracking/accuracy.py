"""How near are the angles to the best that the decoded frames allow?

    python benchmarks/tracking/accuracy.py -o benchmarks/tracking/accuracy.md

The best is an oracle: a matched filter on the same decoded frames that knows the scene, the light, the smear, the
centre and all angles but one. With D the decoded frame, S the same frame drawn without noise and compression, and S'
its derivative by the body's angle, its error is sum(S' (D - S)) / sum(S' S'') over the marker's neighbourhood, in the
score in which the marker stands out: both chroma planes weighted by its contrast, or luma for a white one. S'' is the
derivative once more, over another step: drawn frames are rounded, and the square of a rounded slope is too large.
Only views that nothing hides enter, the same frames for both. A constant and what repeats with the place in the
picture (eight harmonics of the marker's angle) are taken out of both errors, with the truth.

No tracker knows the centre. What the one that was found puts into each angle is given beside.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass, replace
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import cv2
import numpy as np
from clips import CAMERAS, LIGHT, SCENE, film, motion_of
from speed import commit

from gyrotrack.io._records import Recording
from gyrotrack.synthetic._film import Truth, to_planes
from gyrotrack.synthetic._render import Renderer
from gyrotrack.synthetic._scene import Motion
from gyrotrack.tracking._extract import extract
from gyrotrack.tracking._polar import CHROMA_SHIFT
from gyrotrack.video._decoder import Reader

FRAMES = {"casing": 3000, "rotor": 2000, "small rotor": 2000}
STEPS = (1e-2, 4e-3)
"""Turns in rad over which the derivative is taken: for the filter, and for what it answers to a turn."""
HARMONICS = 8
ROOM = 8.0
BODY = {"red": "casing", "blue": "rotor", "white": "rotor", "green": "rotor"}


@dataclass(frozen=True)
class Errors:
    """Errors of one marker, or of a body, in the frames that count [rad]; how many views were kept of how many.

    `centre` is the part of them that comes from the centre.
    """

    ours: np.ndarray
    oracle: np.ndarray | None
    centre: np.ndarray | None
    kept: int
    views: int


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--every", type=int, default=5, help="the oracle looks at every so many frames")
    parser.add_argument("--films", type=Path, default=Path("~/.cache/gyrotrack-benchmarks").expanduser())
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    said = (
        f"Commit {commit()}; the oracle in every {args.every}th frame. rms errors in mrad, without a constant"
    )
    lines = [
        "# Angles beside the best that the decoded frames allow",
        "",
        f"{said} and {HARMONICS} harmonics of the place.",
        "",
        "| film | angle of | frames | gyrotrack | oracle | ratio | from the centre | unhidden views kept |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, camera in CAMERAS.items():
        path, truth = film(name, FRAMES[name], args.films)
        recording = extract(path, capture_fps=camera.fps, threads=1)
        contrast = {m: p["contrast"] for m, p in recording.extra["papers"].items()}
        known = oracle(name, path, truth, np.arange(0, FRAMES[name], args.every), contrast)
        found = {marker: of_marker(recording, truth, marker, known[marker]) for marker in recording.markers}
        found |= {body: of_body(recording, truth, body) for body in recording.bodies}
        label = f"{name}, {camera.width} x {camera.height}"
        for what, errors in found.items():
            lines.append(row(label, what, errors))
            print(lines[-1], flush=True)
    if args.output:
        args.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


def oracle(
    name: str, path: Path, truth: Truth, chosen: np.ndarray, contrast: dict[str, list[float]]
) -> dict[str, np.ndarray]:
    """Return the oracle's errors in the chosen frames, NaN elsewhere and where a marker is not all visible."""
    camera, motion = replace(CAMERAS[name], noise=0.0), motion_of(name)
    at_rest = Renderer(SCENE, motion, camera, LIGHT, seed=1)
    turned = {
        body: [
            [Renderer(SCENE, ahead(motion, body, by), camera, LIGHT, seed=1) for by in (-step, step)]
            for step in STEPS
        ]
        for body in ("casing", "rotor")
    }
    found = {marker: np.full(len(truth.time), np.nan) for marker in BODY}
    wanted = set(chosen.tolist())
    with Reader(path) as reader:
        for k, frame in enumerate(reader):
            seen = [m for m in BODY if truth.visible[m][k] > 0.999]
            if k not in wanted or not seen:
                continue
            time = float(truth.time[k])
            decoded = [np.asarray(plane, dtype=float) for plane in (frame.y, frame.u, frame.v)]
            clean = drawn(at_rest, time)
            left = [d - c for d, c in zip(decoded, clean, strict=True)]
            for body in {BODY[m] for m in seen}:
                slopes = [slope(pair, step, time) for pair, step in zip(turned[body], STEPS, strict=True)]
                for marker in (m for m in seen if BODY[m] == body):
                    found[marker][k] = matched(contrast[marker], truth.corners[marker][k], left, *slopes)
    return found


def ahead(motion: Motion, body: str, by: float) -> Motion:
    """The same motion with one body further by an angle."""
    curve = getattr(motion, f"psi_{body}")
    return replace(motion, **{f"psi_{body}": lambda t: curve(t) + by})


def drawn(renderer: Renderer, time: float) -> list[np.ndarray]:
    return [np.asarray(plane, dtype=float) for plane in to_planes(renderer.frame(time))]


def slope(pair: list[Renderer], step: float, time: float) -> list[np.ndarray]:
    """Derivative of a frame by the angle, from one drawn a step behind and one drawn a step ahead."""
    low, high = (drawn(renderer, time) for renderer in pair)
    return [(h - w) / (2 * step) for h, w in zip(high, low, strict=True)]


def matched(contrast: list[float], corners: np.ndarray, left: list, slope: list, again: list) -> float:
    """Return the angle by which one marker seems to be ahead, from what is left over near it."""
    white = contrast[1] == 0.0
    outline = corners if white else (corners - np.array(CHROMA_SHIFT)) / 2
    over, steep, once_more = (
        p[0] if white else contrast[0] * p[1] + contrast[1] * p[2] for p in (left, slope, again)
    )
    area = np.zeros(steep.shape, dtype=np.uint8)
    cv2.fillConvexPoly(area, cv2.convexHull(np.rint(outline).astype(np.int32)), 1)
    size = 2 * int(np.ceil((ROOM if white else ROOM / 2) + 0.35 * float(np.ptp(outline, axis=0).max()))) + 1
    near = cv2.dilate(area, np.ones((size, size), np.uint8)) > 0
    return float((steep[near] * over[near]).sum() / (steep[near] * once_more[near]).sum())


def of_marker(recording: Recording, truth: Truth, marker: str, known: np.ndarray) -> Errors:
    track = recording.markers[marker]
    index = recording.frame_index
    whole = truth.visible[marker][index] > 0.999
    kept = whole & np.isfinite(track.angle_fine)
    true = truth.angle[track.body][index]
    off = np.angle(np.exp(1j * (track.angle_fine - true)))
    off = np.angle(np.exp(1j * (off - np.angle(np.nanmean(np.exp(1j * off[kept]))))))
    both = kept & np.isfinite(known[index])
    middle = truth.corners[marker][index].mean(axis=1)
    centre = direction(middle - recording.centre) - direction(middle - truth.centre[index])
    parts = (off, known[index], np.angle(np.exp(1j * centre)))
    return Errors(*(even(part[both], true[both]) for part in parts), int(kept.sum()), int(whole.sum()))


def direction(place: np.ndarray) -> np.ndarray:
    """Angle of places (n, 2) in px, y downwards."""
    return np.arctan2(-place[:, 1], place[:, 0])


def of_body(recording: Recording, truth: Truth, body: str) -> Errors:
    track = recording.bodies[body]
    index = np.rint(track.time * recording.capture_fps).astype(int)
    true = truth.angle[body][index]
    return Errors(even(track.angle - true, true), None, None, len(index), len(truth.time))


def even(off: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Errors without their mean and what repeats with the angle."""
    turns = np.outer(angle, np.arange(1, HARMONICS + 1))
    rows = np.column_stack([np.ones(len(off)), np.cos(turns), np.sin(turns)])
    return off - rows @ np.linalg.lstsq(rows, off, rcond=None)[0]


def row(label: str, what: str, errors: Errors) -> str:
    ours = 1e3 * errors.ours.std()
    kept = f"{errors.kept} of {errors.views}"
    if errors.oracle is None or errors.centre is None:
        return f"| {label} | {what} | {len(errors.ours)} | {ours:.2f} | | | | {kept} |"
    best, centre = (1e3 * part.std() for part in (errors.oracle, errors.centre))
    ratio = f"{ours / best:.2f} | {centre:.2f}"
    return f"| {label} | {what} | {len(errors.ours)} | {ours:.2f} | {best:.2f} | {ratio} | {kept} |"


if __name__ == "__main__":
    main()
