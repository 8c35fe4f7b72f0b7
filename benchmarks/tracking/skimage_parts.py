"""Parts of scikit-image against our own, on what tracking needs: error and time.

    python benchmarks/tracking/skimage_parts.py

Two parts: the polar picture of a ring (`warp_polar` against `Ring.unwrap`); the rotation between two polar pictures
with noise (`phase_cross_correlation`, 100 times upsampled, against `register`). Circles are fitted by
scikit-image (`ransac`).
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from skimage.registration import phase_cross_correlation
from skimage.transform import warp_polar

from gyrotrack.tracking._registration import Ring, learn, register


def timed(call: Callable[[], Any], times: int = 5) -> tuple[Any, float]:
    """Return the result of a call and its shortest time [ms]."""
    best = np.inf
    for _ in range(times):
        start = time.perf_counter()
        found = call()
        best = min(best, 1e3 * (time.perf_counter() - start))
    return found, best


def scene(theta: float, rng: np.random.Generator, texture: Any) -> Any:
    """Return a disc of 100 px radius turned by theta, with noise of 4 grey levels."""
    turn = cv2.getRotationMatrix2D((127.5, 127.5), -np.degrees(theta), 1.0)
    clean = cv2.warpAffine(texture, turn, (256, 256), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.clip(np.rint(clean + rng.normal(0, 4, clean.shape)), 0, 255).astype(np.uint8)


def rotations() -> None:
    """Compare rotations of a textured disc against its first frame, and against the learnt mean."""
    rng = np.random.default_rng(1)
    texture = cv2.GaussianBlur(rng.normal(128, 400, (256, 256)), None, 4).astype(np.float32)
    angles = 0.013 + 0.29 * np.arange(40)
    frames = [scene(a, rng, texture) for a in angles]
    ring = Ring.about((127.5, 127.5), 20.0, 100.0)
    polars, ours = timed(lambda: [ring.unwrap(f) for f in frames], 3)
    size = {"output_shape": (ring.columns, 100), "radius": 100}
    theirs, skimage = timed(lambda: [warp_polar(f, center=(127.5, 127.5), **size) for f in frames], 2)
    print(f"polar     {'warp_polar':26} {'':16} {skimage / len(frames):8.2f} ms")
    print(f"polar     {'Ring.unwrap':26} {'':16} {ours / len(frames):8.2f} ms")
    step = 2 * np.pi / ring.columns

    def phase(k: int) -> float:
        shift = phase_cross_correlation(theirs[0][:, 20:], theirs[k][:, 20:], upsample_factor=100)[0][0]
        return float(-shift * step)

    def error(found: Any) -> float:
        off = np.angle(np.exp(1j * (np.array(found) - (angles - angles[0]))))
        return float(np.std(off))

    found, duration = timed(lambda: [phase(k) for k in range(len(frames))], 1)
    print(
        f"rotation  {'phase_cross_correlation':26} {1e3 * error(found):8.2f} mrad rms {duration / 40:7.2f} ms"
    )
    allowed = np.ones((ring.rows, ring.columns), dtype=bool)
    turned = angles.copy()
    for _ in range(2):
        template = learn(polars, turned, allowed, ring, separate=True)
        turned = np.array([register(p, template, a).angle for p, a in zip(polars, turned, strict=True)])
    poses, duration = timed(
        lambda: [register(p, template, a) for p, a in zip(polars, angles, strict=True)], 1
    )
    found = [p.angle - poses[0].angle for p in poses]
    print(f"rotation  {'register':26} {1e3 * error(found):8.2f} mrad rms {duration / 40:7.2f} ms")


if __name__ == "__main__":
    warnings.simplefilter("ignore", FutureWarning)
    rotations()
