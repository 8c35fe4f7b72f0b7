"""From films of rotating bodies to their equations of motion.

Make a case from films::

    import gyrotrack

    casing = gyrotrack.extract("casing.mp4", "casing.h5", capture_fps=260)
    rotor = gyrotrack.extract("rotor_1.mp4", "rotor_1.h5", capture_fps=1000)
    case = gyrotrack.sync(casing, [rotor], "case1.h5", inertia_rotor=5.54e-5, inertia_casing=2.06e-5)
    gyrotrack.read("case1.h5")

The package `fitting` fits models to the case.

Public names are imported on first use, so that ``import gyrotrack`` is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gyrotrack.apps._api import extract, read, sync
    from gyrotrack.apps._simulation import SimulatedRun
    from gyrotrack.apps._study import FitRequest, Study, open_study
    from gyrotrack.apps.report._page import write_report
    from gyrotrack.io._contents import export_file
    from gyrotrack.io._hdf5 import read_case, read_recording, write_case, write_recording
    from gyrotrack.io._records import BodyTrack, Case, ChainBody, ErrorMode, MarkerTrack, Recording, Series
    from gyrotrack.io.readers._import_case import import_body, import_case
    from gyrotrack.io.readers._import_chain import import_chain
    from gyrotrack.plotting._ghost import Ghost, ghosts
    from gyrotrack.tracking._profile import Profile
    from gyrotrack.tracking._proposal import Proposal, propose

from gyrotrack._errors import (
    ConfigurationError,
    DatasetError,
    GyrotrackError,
    OutputError,
    ProfileError,
    SyncError,
    TrackingError,
    UsageError,
    VideoError,
)
from gyrotrack._versions import __version__ as __version__

_MODULES = {
    "gyrotrack.apps._api": ("extract", "read", "sync"),
    "gyrotrack.apps._simulation": ("SimulatedRun",),
    "gyrotrack.apps._study": ("FitRequest", "Study", "open_study"),
    "gyrotrack.apps.report._page": ("write_report",),
    "gyrotrack.io._contents": ("export_file",),
    "gyrotrack.plotting._ghost": ("Ghost", "ghosts"),
    "gyrotrack.io._hdf5": ("read_case", "read_recording", "write_case", "write_recording"),
    "gyrotrack.io._records": (
        "BodyTrack",
        "Case",
        "ChainBody",
        "ErrorMode",
        "MarkerTrack",
        "Recording",
        "Series",
    ),
    "gyrotrack.io.readers._import_case": ("import_body", "import_case"),
    "gyrotrack.io.readers._import_chain": ("import_chain",),
    "gyrotrack.tracking._profile": ("Profile",),
    "gyrotrack.tracking._proposal": ("Proposal", "propose"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "BodyTrack", "Case", "ChainBody", "ConfigurationError", "DatasetError", "ErrorMode", "FitRequest", "Ghost",
    "GyrotrackError", "MarkerTrack", "OutputError", "Profile", "ProfileError", "Proposal", "Recording", "Series",
    "SimulatedRun", "Study", "SyncError", "TrackingError", "UsageError", "VideoError", "export_file", "extract",
    "ghosts", "import_body", "import_case", "import_chain", "open_study", "propose", "read", "read_case",
    "read_recording", "sync", "write_case", "write_recording", "write_report",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_MODULE_OF[name]), name)
    return value


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *__all__})
