"""Films drawn by a renderer that shares no code with the package."""

import contextlib
import dataclasses
import hashlib
import importlib.util
import io
import json
import sys
from pathlib import Path

import pytest


def _load(name):
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def foreign():
    """The module `foreign_film`: `Film` and `render`."""
    return _load("foreign_film")


@pytest.fixture(scope="session")
def bob():
    """The class `Bob` of the module `bob_film`: films of a bob about a pivot."""
    return _load("bob_film").Bob


@pytest.fixture(scope="session")
def draw(foreign, made_once, tmp_path_factory):
    """Draw a film once a session: draw(casing=..., frames=...) -> (path, film); name edited ones by `key`.

    A film with a `key` is drawn once for all processes.
    """
    own = tmp_path_factory.mktemp("films")
    done = {}

    def make(suffix=".mp4", key=None, edit=None, **settings):
        film = dataclasses.replace(foreign.Film(), **settings)
        name = key or hashlib.sha256(repr(sorted(settings.items())).encode()).hexdigest()[:16]
        file = f"{name}{suffix}"
        if key is not None:
            return made_once(
                f"film-{key}", lambda folder: foreign.render(film, folder / file, edit)
            ) / file, film
        if name not in done:
            done[name] = (foreign.render(film, own / file, edit), film)
        return done[name]

    return make


@pytest.fixture(scope="session")
def casing_clip(draw):
    """A short clip of the paper's scene at 260 fps."""
    return draw(
        key="casing",
        width=320,
        height=240,
        radius=105.0,
        frames=100,
        casing=_casing,
        rotor=_rotor,
        exposure=0.8e-3,
    )


@pytest.fixture(scope="session")
def rotor_clip(draw):
    """A short clip at 1000 fps, stored at 25 fps, with the camera's tag."""
    return draw(
        key="rotor",
        width=320,
        height=240,
        radius=105.0,
        frames=100,
        fps=1000.0,
        container_fps=25.0,
        tag=1000.0,
        exposure=0.5e-3,
        casing=_casing_late,
        rotor=_rotor_fast,
        tilt=0.1,
    )


@pytest.fixture(scope="session")
def program():
    """Run a command in this process: program(["fit", path]) returns the exit code."""
    from gyrotrack.apps.cli import _app

    return _app.run


@pytest.fixture(scope="session")
def measured_film(made_once, program):
    """Run `spindown` on a film once for all processes: (code, document, stderr, case) = measured_film(film, *words)."""

    def measured(film, *words):
        def make(folder):
            out, err = io.StringIO(), io.StringIO()
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = program(["spindown", str(film), *words, "-o", str(folder / "film.h5"), "--json"])
            said = {"code": code, "document": json.loads(out.getvalue()), "err": err.getvalue()}
            (folder / "said.json").write_text(json.dumps(said), encoding="utf-8")

        folder = made_once(f"spindown-{film.stem}", make)
        said = json.loads((folder / "said.json").read_text(encoding="utf-8"))
        return said["code"], said["document"], said["err"], folder / "film.h5"

    return measured


def _casing(t):
    return 0.4 + 60.0 * t + 10.0 * t**2


def _rotor(t):
    return 1.0 + 300.0 * t


def _casing_late(t):
    return 2.0 + 90.0 * t


def _rotor_fast(t):
    return 0.5 + 640.0 * t - 20.0 * t**2
