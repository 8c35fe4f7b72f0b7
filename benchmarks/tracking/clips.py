"""The films that are timed: the two cameras of the paper, drawn with their answers and kept in a folder."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np

from gyrotrack.synthetic._film import Truth, find_truth, render_clip
from gyrotrack.synthetic._scene import Camera, Light, Motion, Scene, Wobble

LIGHT = Light(gradient=(0.18, -0.10), vignette=0.12, flicker=0.03, glint=0.08, shadow=0.3)
SCENE = Scene(wobble=Wobble(0.07, 3.7, phase=1.0))
CAMERAS = {
    "casing": Camera(
        640, 360, 260.0, exposure=1.0e-3, scale=4.4, tilt=0.10, tilt_azimuth=0.4, noise=3.0
    ),  # what lies on the casing is 92 px from the centre
    "rotor": Camera(
        1280, 720, 1000.0, 25.0, exposure=0.7e-3, scale=8.8, tilt=0.10, tilt_azimuth=2.6, noise=3.0
    ),  # 150 px, smeared by 33 px
    "small rotor": Camera(
        640, 360, 1000.0, 25.0, exposure=0.7e-3, scale=4.4, tilt=0.10, tilt_azimuth=2.6, noise=3.0
    ),  # 75 px
}
SPEEDS = {"casing": (420.0, 62.0), "rotor": (315.0, 58.0), "small rotor": (315.0, 58.0)}


def motion_of(name: str) -> Motion:
    """How both bodies turn in a film."""
    time = np.linspace(-0.1, 60.0, 600)
    rotor, casing = SPEEDS[name]
    return Motion.from_speeds(time, rotor - 6 * time, casing + 8 * np.sin(0.2 * time), 0.3, 0.9)


def film(name: str, frames: int, folder: Path) -> tuple[Path, Truth]:
    """Draw a film, or take the one that was drawn before."""
    stem = f"{name.replace(' ', '_')}_{frames}"
    path = folder / f"{stem}.mp4"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        render_clip(
            path,
            SCENE,
            motion_of(name),
            CAMERAS[name],
            LIGHT,
            frames=frames,
            seed=1,
        )
    return path, find_truth(SCENE, motion_of(name), CAMERAS[name], frames)


def repeated(source: Path, target: Path, times: int) -> Path:
    """Write the packets of a film over and over: as many frames as wanted, drawn once."""
    with av.open(str(source)) as film, av.open(str(target), "w") as longer:
        stream = film.streams.video[0]
        out = longer.add_stream_from_template(stream)
        packets = [(bytes(p), p.pts, p.dts, p.is_keyframe, p.duration) for p in film.demux(stream) if p.size]
        length = sum(p[4] for p in packets)
        for k in range(times):
            for data, pts, dts, key, duration in packets:
                packet = av.Packet(data)
                packet.pts, packet.dts, packet.duration = pts + k * length, dts + k * length, duration
                packet.time_base, packet.stream, packet.is_keyframe = stream.time_base, out, key
                longer.mux(packet)
    return target
