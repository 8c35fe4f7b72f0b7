"""Versions of the libraries in use."""

from __future__ import annotations

import platform
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

__version__ = "0.2.0"

LIBRARIES = (
    "numpy",
    "scipy",
    "h5py",
    "av",
    "opencv-contrib-python-headless",
    "matplotlib",
    "pydantic",
    "typer",
    "xarray",
    "pandas",
    "pyarrow",
    "distributed",
)


def versions() -> dict[str, str]:
    """Return the versions of the program, of Python with its platform, and of the installed libraries."""
    found = {
        "gyrotrack": __version__,
        "python": platform.python_version(),
        "platform": f"{sys.platform} {platform.machine()}",
        "kernels": "compiled" if find_spec("gyrotrack._native._compiled") else "not compiled (NumPy, slower)",
    }
    return found | _libraries()


@cache
def _libraries() -> dict[str, str]:
    # cached: importlib.metadata reads a file for each library, and the versions are written into every table
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
