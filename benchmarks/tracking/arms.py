"""What is timed: ways from a film to angles. Each takes a film and a number of frames, and gives angles or None."""

from __future__ import annotations

from pathlib import Path

import av
import cv2
import numpy as np

from gyrotrack.tracking._extract import extract

HUES = {"red": (170, 8), "green": (50, 85), "blue": (100, 130)}  # OpenCV's, 0 to 180; red goes round
FEWEST_PX = 30


def decode(path: Path, frames: int) -> None:
    """PyAV, one thread, views of the planes: nothing can be faster than this."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.codec_context.thread_type = "NONE"
        for k, frame in enumerate(container.decode(stream)):
            _ = [np.frombuffer(plane, dtype=np.uint8) for plane in frame.planes]
            if k + 1 == frames:
                return


def gyrotrack(
    path: Path, fps: float, body: str | None = None, threads: int = 1, workers: int = 1
) -> np.ndarray:
    """The whole of `extract`, start-up included: casing angles."""
    recording = extract(path, capture_fps=fps, body=body, threads=threads, workers=workers)
    return recording.bodies["casing"].angle * recording.sense


def opencv(path: Path, frames: int) -> np.ndarray:
    """cv2.VideoCapture, HSV of the whole frame, inRange, morphology, contours, minAreaRect: the red paper's angle."""
    capture = cv2.VideoCapture(str(path))
    kernel = np.ones((3, 3), np.uint8)
    angles = []
    for _ in range(frames):
        ok, picture = capture.read()
        if not ok:
            break
        hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
        rectangles = {}
        for colour, (low, high) in HUES.items():
            mask = _in_range(hsv, low, high)
            mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel)
            contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            contours = [c for c in contours if cv2.contourArea(c) > FEWEST_PX]
            rectangles[colour] = [
                cv2.minAreaRect(c) for c in sorted(contours, key=cv2.contourArea, reverse=True)[:2]
            ]
        angles.append(_red_angle(rectangles["red"], picture.shape))
    capture.release()
    return np.array(angles)


def _in_range(hsv: np.ndarray, low: int, high: int) -> np.ndarray:
    if low < high:
        return cv2.inRange(hsv, (low, 90, 40), (high, 255, 255))
    return cv2.inRange(hsv, (0, 90, 40), (high, 255, 255)) | cv2.inRange(hsv, (low, 90, 40), (180, 255, 255))


def _red_angle(found: list[tuple], shape: tuple[int, ...]) -> float:
    """Return the angle of the paper about the disc: the one farther from, and the one nearer to, the middle."""
    if len(found) < 2:
        return float("nan")
    middle = np.array([shape[1] / 2, shape[0] / 2])
    disc, paper = sorted((np.array(f[0]) for f in found), key=lambda p: np.hypot(*(p - middle)))
    return float(np.arctan2(-(paper[1] - disc[1]), paper[0] - disc[0]))


def regionprops(path: Path, frames: int) -> None:
    """scikit-image: HSV, threshold, label, regionprops of the red papers."""
    from skimage.color import rgb2hsv
    from skimage.measure import label
    from skimage.measure import regionprops as properties

    for picture in _pictures(path, frames):
        hsv = rgb2hsv(picture)
        red = ((hsv[..., 0] < 0.05) | (hsv[..., 0] > 0.95)) & (hsv[..., 1] > 0.35) & (hsv[..., 2] > 0.15)
        _ = [(r.centroid, r.orientation) for r in properties(label(red)) if r.area > FEWEST_PX]


def trackpy(path: Path, frames: int) -> None:
    """trackpy.locate on the difference of two colours."""
    import trackpy as tp

    tp.quiet()
    for picture in _pictures(path, frames):
        difference = np.clip(picture[..., 0].astype(float) - picture[..., 1], 0, None)
        tp.locate(difference, diameter=31 if picture.shape[1] < 1000 else 61, topn=2)


def _pictures(path: Path, frames: int):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.codec_context.thread_type = "NONE"
        for k, frame in enumerate(container.decode(stream)):
            yield frame.to_ndarray(format="rgb24")
            if k + 1 == frames:
                return
