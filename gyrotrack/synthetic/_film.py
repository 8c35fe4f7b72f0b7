"""Render and encode a film, and compute its exact angles, corners and visibilities.

A chroma sample (i, j) is centred at the luma position x = 2 i, y = 2 j + 1/2, the default of H.264. The conversion is
implemented here because the results of common scalers differ by half a luma pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrotrack.io._atomic import new_path
from gyrotrack.synthetic._render import Renderer
from gyrotrack.synthetic._scene import Camera, Light, Marker, Motion, Scene

Frame = NDArray[np.uint8]

KR, KB = 0.2126, 0.0722
_Y = np.array([KR, 1.0 - KR - KB, KB])
_CB = (np.array([0.0, 0.0, 1.0]) - _Y) / (2.0 * (1.0 - KB))
_CR = (np.array([1.0, 0.0, 0.0]) - _Y) / (2.0 * (1.0 - KR))
TO_LUMA = np.append(_Y * 219.0 / 255.0, 16.0)[None]
TO_CHROMA = np.stack([np.append(_CB * 224.0 / 255.0, 128.0), np.append(_CR * 224.0 / 255.0, 128.0)])


def to_planes(picture: Frame) -> tuple[Frame, Frame, Frame]:
    """Convert (height, width, 3) red, green, blue to Y (height, width), and Cb and Cr of half the size."""
    height, width = picture.shape[:2]
    luma = cv2.transform(picture, TO_LUMA)
    half = (width // 2, height // 2)
    right = cv2.resize(picture, half, interpolation=cv2.INTER_AREA)  # columns 2 i and 2 i + 1
    shifted = np.empty_like(picture)
    shifted[:, 1:], shifted[:, 0] = picture[:, :-1], picture[:, 0]
    left = cv2.resize(shifted, half, interpolation=cv2.INTER_AREA)  # columns 2 i - 1 and 2 i
    chroma = cv2.transform(cv2.addWeighted(left, 0.5, right, 0.5, 0.0), TO_CHROMA)
    blue, red = cv2.split(chroma)
    return luma, blue, red  # type: ignore[return-value]


BT709, LIMITED = 1, 1  # codes in H.264: matrix, primaries and transfer function; range


@dataclass(frozen=True)
class Film:
    """Options of the encoder."""

    crf: int = 20  # constant rate factor of x264: 0 lossless, 18 very good, 23 default, 28 poor
    preset: str = "veryfast"  # preset of x264, "ultrafast" to "veryslow"
    keyframe: int = 250  # largest number of frames between key frames
    bframes: int = 0  # largest number of consecutive B-frames; most cameras write none
    # write the capture rate to the metadata, as some phones do (``com.android.capture.fps``)
    tag_capture_fps: bool = False
    threads: int = 1  # threads of the encoder


def write_film(
    path: Path,
    frames: Iterable[Frame],
    *,
    width: int,
    height: int,
    fps: float,
    container_fps: float | None = None,
    film: Film | None = None,
    force: bool = False,
) -> int:
    """Encode RGB frames (height, width, 3) atomically as mp4 with the rate `container_fps`; return their number."""
    film = film or Film()
    path = Path(path)
    with new_path(path, force=force) as part:
        return _encode(part, frames, (width, height), fps, Fraction(container_fps or fps), film)


def _encode(
    part: Path, frames: Iterable[Frame], size: tuple[int, int], fps: float, stored: Fraction, film: Film
) -> int:
    import av

    rate = stored.limit_denominator(1001)
    options = {"movflags": "use_metadata_tags"} if film.tag_capture_fps else {}
    count = 0
    with av.open(str(part), "w", format="mp4", options=options) as container:
        if film.tag_capture_fps:
            container.metadata["com.android.capture.fps"] = f"{fps:f}"
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.options = {
            "crf": str(film.crf),
            "preset": film.preset,
            "g": str(film.keyframe),
            "bf": str(film.bframes),
            "x264-params": "mbtree=0",  # with mbtree, equal pictures are encoded differently in each run
        }
        context = stream.codec_context
        context.thread_count, context.time_base = film.threads, 1 / rate
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = LIMITED
        for picture in frames:
            frame = av.VideoFrame(*size, "yuv420p")
            for plane, values in zip(frame.planes, to_planes(picture), strict=True):
                rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
                rows[: values.shape[0], : values.shape[1]] = values
            frame.pts = count
            container.mux(stream.encode(frame))
            count += 1
        container.mux(stream.encode(None))
    return count


Array = NDArray[np.float64]

COVER_STEPS = (
    4096  # number of relative angles of rotor and casing at which the occlusion of a marker is computed
)
COVER_RADII = 96


@dataclass(frozen=True)
class Truth:
    """The exact quantities in a film of n frames."""

    time: Array  # shape (n,); true time of the middle of each exposure in s
    # shape (n,); time on the clock of the camera, ``k / fps``; ``time = clock_offset + clock_rate * clip_time``
    clip_time: Array
    # true time of frame 0 in s, and true seconds per second of the camera
    clock_offset: float
    clock_rate: float
    # shape (n,); for "rotor" and "casing": unwrapped angle in rad, increasing in the sense of rotation, and speed
    # in rad/s
    angle: Mapping[str, Array]
    omega: Mapping[str, Array]
    centre: Array  # shape (n, 2); position of the axis in the image in px
    # shape (n, 4, 2); for each marker the corners in px at the middle of the exposure, in cyclic order: inner, inner,
    # outer, outer; of the inner corners, the first has the smaller angle in the sense of rotation
    corners: Mapping[str, Array]
    # shape (n,); for each marker, the fraction of its area, 0 to 1, that the casing does not occlude (mean over the
    # exposure) and that is inside the image
    visible: Mapping[str, Array]
    sense: int  # +1 if the bodies turn counter-clockwise in the image, -1 if clockwise


def find_truth(scene: Scene, motion: Motion, camera: Camera, frames: int) -> Truth:
    """Compute the truth of a film, without rendering it."""
    time = camera.times(frames)
    shift = scene.wobble.shift(time)
    angle = {"rotor": motion.psi_rotor(time), "casing": motion.psi_casing(time)}
    corners, visible = {}, {}
    for marker in scene.markers:
        turned = camera.turn(marker.corners(), angle[marker.body]) + shift[:, None]
        corners[marker.name] = camera.project(turned)
        share = _inside_picture(corners[marker.name], camera)
        visible[marker.name] = share * _uncovered(scene, marker, motion, camera, time)
    return Truth(
        time=time,
        clip_time=np.arange(frames) / camera.fps,
        clock_offset=camera.start,
        clock_rate=camera.rate,
        angle=angle,
        omega={"rotor": motion.omega_rotor(time), "casing": motion.omega_casing(time)},
        centre=camera.project(shift),
        corners=corners,
        visible=visible,
        sense=camera.sense,
    )


def _uncovered(scene: Scene, marker: Marker, motion: Motion, camera: Camera, time: Array) -> Array:
    """Return the fraction of a marker that the casing does not occlude, averaged over the exposure, (n,)."""
    if marker.body == "casing":
        return np.ones(time.shape)
    share = _visible_fraction(scene, marker)
    step = 2.0 * np.pi / COVER_STEPS
    running = np.concatenate([[0.0], np.cumsum(share)]) * step
    turn = running[-1]

    def integral(relative: Array) -> Array:
        whole, rest = np.divmod(relative + 0.5 * step, 2.0 * np.pi)  # steps are centred
        return np.asarray(whole * turn + np.interp(rest, np.arange(COVER_STEPS + 1) * step, running))

    half = 0.5 * camera.exposure
    ends = [motion.psi_rotor(time + late) - motion.psi_casing(time + late) for late in (-half, half)]
    swept = ends[1] - ends[0]
    still = np.abs(swept) < step
    middle = 0.5 * (ends[0] + ends[1])
    narrow = (integral(middle + 0.5 * step) - integral(middle - 0.5 * step)) / step
    wide = (integral(ends[1]) - integral(ends[0])) / np.where(still, 1.0, swept)
    return np.where(still, narrow, wide)


def _visible_fraction(scene: Scene, marker: Marker) -> Array:
    """Return the fraction of a marker of the rotor that is not occluded at psi_r - psi_c = 2 pi k / COVER_STEPS."""
    reach = np.hypot(*marker.corners().T)
    low = marker.near * np.cos(marker.skew) - 0.5 * marker.base * abs(np.sin(marker.skew))
    edges = np.linspace(low, reach.max(), COVER_RADII + 1)
    r = 0.5 * (edges[1:] + edges[:-1])[:, None]
    theta = np.arange(COVER_STEPS) * (2.0 * np.pi / COVER_STEPS)
    x, y = r * np.cos(theta), r * np.sin(theta)
    along, across = marker.local(x, y)
    paper = (along >= 0.0) & (along <= marker.length) & (np.abs(across) <= 0.5 * marker.base)
    weight = np.fft.rfft(paper * r, axis=1)
    cover = np.fft.rfft(scene.casing_covers(x, y).astype(np.float64), axis=1)
    hidden = np.fft.irfft(np.conj(weight) * cover, COVER_STEPS, axis=1).sum(axis=0)
    return np.asarray(np.clip(1.0 - hidden / (paper * r).sum(), 0.0, 1.0))


def _inside_picture(corners: Array, camera: Camera) -> Array:
    """Return the fraction of a marker that is inside the picture in each frame, (n,)."""
    low, high = np.array([-0.5, -0.5]), np.array([camera.width - 0.5, camera.height - 0.5])
    share = np.ones(len(corners))
    frame = np.array([low, [high[0], low[1]], high, [low[0], high[1]]], dtype=np.float32)
    for k in np.flatnonzero(np.any((corners < low) | (corners > high), axis=(1, 2))):
        paper = corners[k].astype(np.float32)
        common, _ = cv2.intersectConvexConvex(paper, frame)
        share[k] = common / cv2.contourArea(paper)
    return share


Progress = Callable[[int, int | None], None]


def render_clip(
    path: Path,
    scene: Scene,
    motion: Motion,
    camera: Camera,
    light: Light | None = None,
    *,
    frames: int,
    film: Film | None = None,
    seed: int = 0,
    force: bool = False,
    progress: Progress | None = None,
) -> Truth:
    """Render a film of a scene with a known motion, and return its exact angles and corners.

    ``camera.start`` is the true time of the first of the frames; `progress` is called with (frames rendered, frames in
    total). A ValueError is raised if the motion is not known for the whole film.

    Examples
    --------
    >>> from pathlib import Path
    >>> from gyrotrack.synthetic._scene import Camera, Scene
    >>> motion = Motion.constant(omega_rotor=400.0, omega_casing=60.0)
    >>> truth = render_clip(Path("casing.mp4"), Scene(), motion, Camera(), frames=260)  # doctest: +SKIP
    """
    renderer = Renderer(scene, motion, camera, light, seed=seed)
    write_film(
        path,
        _counted(renderer.frames(frames), frames, progress),
        width=camera.width,
        height=camera.height,
        fps=camera.fps,
        container_fps=camera.container_fps,
        film=film,
        force=force,
    )
    return find_truth(scene, motion, camera, frames)


def _counted(
    pictures: Iterator[NDArray[np.uint8]], total: int, progress: Progress | None
) -> Iterator[NDArray[np.uint8]]:
    """Yield pictures and report their number."""
    for done, picture in enumerate(pictures, start=1):
        yield picture
        if progress is not None:
            progress(done, total)
