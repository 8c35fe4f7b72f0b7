"""What holds for every test: one thread for linear algebra, set before NumPy is imported."""

import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # matrices are small, and pytest-xdist already uses the cores

# glibc returns freed memory to the system after every fit, and the system has to clear it again: 5 % of the time
for _name in ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"):
    os.environ.setdefault(_name, str(2**28))  # of the processes that are started by this one

# workers and programs under test would otherwise compile every module again, which takes longer than most tests
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# a shell that runs the tests in the background has SIGINT ignored, and programs under test would inherit that
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

import pytest  # noqa: E402
from filelock import FileLock  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402 - it may import NumPy

# how fast examples come tells of the machine that runs the tests, not of the program; and the examples are the same in
# every run, so that a change is judged by itself: `pytest --hypothesis-profile searching` looks for new ones
_CALM = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("any machine", derandomize=True, **_CALM)
settings.register_profile("searching", **_CALM)
settings.load_profile("any machine")

# files whose slow tests take about a minute or more, the longest first
LONG_FILES = (
    "test_laws.py", "test_discovery.py", "test_spindown.py", "test_coverage.py", "test_remainder.py", "test_films.py",
    "test_view.py", "test_plan.py", "test_fit.py", "test_scan.py", "test_integrated_angle.py",
    "test_other_gyroscopes.py",
)  # fmt: skip


def pytest_configure(config):
    """Run each file in one process (pytest-xdist), and give all processes a folder for what several files compute."""
    if getattr(config.option, "dist", "no") == "load":
        config.option.dist = "loadfile"
        # of the other tests, their number tells how long a file takes
        config.option.loadscopereorder = config.option.markexpr != "slow"
    if "PYTEST_XDIST_WORKER" not in os.environ:
        os.environ["GYROTRACK_TEST_SHARED"] = tempfile.mkdtemp(prefix="gyrotrack-tests-")


def pytest_collection_modifyitems(config, items):
    """Begin the slow tests with the files that take longest: a long one that is begun last runs alone."""
    if config.option.markexpr != "slow":
        return
    place = {name: i for i, name in enumerate(LONG_FILES)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect no garbage among the tests that are collected: they stay, and each collection would visit them all."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_unconfigure():
    """Remove the folder of the processes."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        shutil.rmtree(os.environ["GYROTRACK_TEST_SHARED"], ignore_errors=True)


@pytest.fixture(scope="session", autouse=True)
def one_core():
    """One core for each process of pytest-xdist: workers of a command in it would only repeat its imports."""
    with pytest.MonkeyPatch.context() as patch:
        if "PYTEST_XDIST_WORKER" in os.environ:
            patch.setattr("fitting._workers.available_cores", lambda: 1)
        yield


@pytest.fixture(scope="session")
def made_once(tmp_path_factory):
    """Make a folder once for all processes of pytest-xdist: made_once(name, make) calls make(folder) at most once."""
    base = tmp_path_factory.getbasetemp()
    root = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def folder_of(name, make):
        folder, done = root / name, root / f"{name}.done"
        with FileLock(root / f"{name}.lock"):
            if not done.exists():
                folder.mkdir()
                make(folder)
                done.touch()
        return folder

    return folder_of


@pytest.fixture(scope="session")
def demo(made_once):
    """What `gyrotrack demo --json` says, and the folder of its results: made once for all processes."""

    def make(folder):
        clips, output = Path(__file__).parents[1] / "sample_clips", folder / "gyrotrack_demo"
        words = ["demo", "--clips", clips, "-o", output, "--json"]
        done = subprocess.run(
            [sys.executable, "-m", "gyrotrack", *map(str, words)],
            capture_output=True, text=True, check=False, timeout=900, cwd=folder,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        assert done.stderr == ""
        assert [p.name for p in folder.iterdir()] == ["gyrotrack_demo"]
        (folder / "document.json").write_text(done.stdout, encoding="utf-8")

    folder = made_once("demo", make)
    return json.loads((folder / "document.json").read_text(encoding="utf-8")), folder / "gyrotrack_demo"
