"""A gyroscope of our own: the two equations integrated by SciPy, seen by two imperfect cameras."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from gyrotrack import BodyTrack, Recording
from gyrotrack.synchronisation._matching import Curve

TURN = 2 * np.pi


def integrate(duration=140.0, speed=900.0, b1=4.86e-6, b2=8.35e-7, f=1.76e-7, g=1.06):
    """Return psi_c(t) of a casing that starts at rest; parameters near the paper's case 1."""

    def rates(_, y):
        friction = f * abs(y[0] - y[1]) ** g
        ground = b1 * np.tanh(y[1] / 1e-2) + b2 * y[1]
        return [-(friction + 8.92e-11 * y[0] ** 2) / 5.54e-5, (friction - ground) / 2.06e-5, y[1], y[0]]

    done = solve_ivp(
        rates, (0, duration), [speed, 0, 0, 0], rtol=1e-9, atol=1e-9, max_step=0.5, dense_output=True
    )
    return done.sol


@dataclass(frozen=True)
class Camera:
    """Harmonics of one and two turns of 2 mrad, and white noise of 1 mrad."""

    rng: np.random.Generator
    noise: float = 1e-3
    harmonic: float = 2e-3

    def __post_init__(self):
        object.__setattr__(self, "phases", self.rng.uniform(0, TURN, 2))

    def see(self, angle):
        one, two = self.phases
        seen = self.harmonic * (np.sin(angle - one) + np.sin(2 * angle - two))
        return angle + seen + self.rng.normal(size=angle.size) * self.noise

    def curve(self, time, angle):
        return Curve(time, self.see(angle), np.full(time.size, self.noise))


@dataclass(frozen=True)
class Run:
    """One experiment: the casing's record, and clips of it that start at known times."""

    motion: object
    rng: np.random.Generator
    duration: float = 135.0

    def casing(self):
        time = np.arange(0, self.duration, 1 / 130)
        return Camera(self.rng).curve(time, self.motion(time)[2])

    def clips(self, starts, *, offset=1.0, rate=1 + 2e-5, duration=3.0, offsets=None, camera=None):
        camera = camera or Camera(self.rng)
        offsets = offsets or [offset] * len(starts)
        found = []
        for start, turned in zip(starts, offsets, strict=True):
            time = np.arange(0, duration, 2e-3)
            angle = self.motion(start + rate * time)[2] - turned
            found.append(camera.curve(time, angle - TURN * np.floor(angle[0] / TURN)))
        return found


def body(name, time, angle, sigma=1e-3, omega=None):
    every = np.full(time.size, sigma)
    speed = np.gradient(angle, time) if omega is None else omega
    return BodyTrack(name, time, angle, every, every, np.ones(time.size, dtype=np.int64), speed, every, 51)


def recording(source, fps, bodies):
    time = next(iter(bodies.values())).time
    n = time.size
    return Recording(
        source=source,
        source_sha256=f"{abs(hash(source)):064x}",
        width=640,
        height=480,
        capture_fps=fps,
        container_fps=30.0,
        frames_declared=n,
        frames_decoded=n,
        sense=-1,
        body="both",
        frame_index=np.arange(n),
        time=time,
        pts_time=time,
        centre=np.zeros((n, 2)),
        centre_sigma=np.zeros(n),
        markers={},
        bodies=bodies,
    )


@pytest.fixture(scope="session")
def motion():
    return integrate()


@pytest.fixture(scope="session")
def other_motion():
    """Another surface: the casing is braked more."""
    return integrate(b1=2e-5, b2=8.0e-7)


@pytest.fixture
def make_run():
    return Run


@pytest.fixture
def make_recordings(motion):
    """Recordings of a run: the casing's, and one for each start, with the rotor in it."""

    def make(starts, *, seed=0, rate=1 + 2e-5, shown=motion):
        rng = np.random.default_rng(seed)
        run = Run(shown, rng)
        seen = run.casing()
        found = [recording("casing.mp4", 260.0, {"casing": body("casing", seen.time, seen.angle)})]
        for k, (start, clip) in enumerate(zip(starts, run.clips(starts, rate=rate), strict=True)):
            wheel = run.motion(start + rate * clip.time)
            tracks = {
                "casing": body("casing", clip.time, clip.angle),
                "rotor": body(
                    "rotor", clip.time, wheel[3] % TURN + wheel[3] - wheel[3][0], omega=wheel[0] * rate
                ),
            }
            found.append(recording(f"rotor{k}.mp4", 1000.0, tracks))
        return found

    return make
