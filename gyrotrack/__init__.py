"""From films of rotating bodies to their equations of motion.

The way from film to case::

    import gyrotrack

    casing = gyrotrack.extract("casing.mp4", "casing.h5", capture_fps=260)
    rotor = gyrotrack.extract("rotor_1.mp4", "rotor_1.h5", capture_fps=1000)
    case = gyrotrack.sync(casing, [rotor], "case1.h5", inertia_rotor=5.54e-5, inertia_casing=2.06e-5)
    gyrotrack.read("case1.h5")

The package `fitting` goes on from the case to the model.

Public names are imported on first use; ``import gyrotrack`` alone imports nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gyrotrack._errors import ConfigurationError as ConfigurationError
    from gyrotrack._errors import DatasetError as DatasetError
    from gyrotrack._errors import GyrotrackError as GyrotrackError
    from gyrotrack._errors import OutputError as OutputError
    from gyrotrack._errors import ProfileError as ProfileError
    from gyrotrack._errors import SyncError as SyncError
    from gyrotrack._errors import TrackingError as TrackingError
    from gyrotrack._errors import UsageError as UsageError
    from gyrotrack._errors import VideoError as VideoError
    from gyrotrack.apps._api import extract as extract
    from gyrotrack.apps._api import read as read
    from gyrotrack.apps._api import sync as sync
    from gyrotrack.apps._simulation import SimulatedRun as SimulatedRun
    from gyrotrack.apps._study import FitRequest as FitRequest
    from gyrotrack.apps._study import Study as Study
    from gyrotrack.apps._study import open_study as open_study
    from gyrotrack.apps.report._page import write_report as write_report
    from gyrotrack.io._export import export_file as export_file
    from gyrotrack.io._hdf5 import read_case as read_case
    from gyrotrack.io._hdf5 import read_recording as read_recording
    from gyrotrack.io._hdf5 import write_case as write_case
    from gyrotrack.io._hdf5 import write_recording as write_recording
    from gyrotrack.io._records import BodyTrack as BodyTrack
    from gyrotrack.io._records import Case as Case
    from gyrotrack.io._records import MarkerTrack as MarkerTrack
    from gyrotrack.io._records import Recording as Recording
    from gyrotrack.io._records import Series as Series
    from gyrotrack.io.readers._import_case import import_body as import_body
    from gyrotrack.io.readers._import_case import import_case as import_case
    from gyrotrack.tracking._profile import Profile as Profile
    from gyrotrack.tracking._proposal import Proposal as Proposal
    from gyrotrack.tracking._proposal import propose as propose

from gyrotrack._versions import __version__ as __version__

_PLACES = {
    "BodyTrack": ("gyrotrack.io._records", "BodyTrack"),
    "Case": ("gyrotrack.io._records", "Case"),
    "ConfigurationError": ("gyrotrack._errors", "ConfigurationError"),
    "DatasetError": ("gyrotrack._errors", "DatasetError"),
    "FitRequest": ("gyrotrack.apps._study", "FitRequest"),
    "GyrotrackError": ("gyrotrack._errors", "GyrotrackError"),
    "MarkerTrack": ("gyrotrack.io._records", "MarkerTrack"),
    "OutputError": ("gyrotrack._errors", "OutputError"),
    "Profile": ("gyrotrack.tracking._profile", "Profile"),
    "ProfileError": ("gyrotrack._errors", "ProfileError"),
    "Proposal": ("gyrotrack.tracking._proposal", "Proposal"),
    "Recording": ("gyrotrack.io._records", "Recording"),
    "Series": ("gyrotrack.io._records", "Series"),
    "SimulatedRun": ("gyrotrack.apps._simulation", "SimulatedRun"),
    "Study": ("gyrotrack.apps._study", "Study"),
    "SyncError": ("gyrotrack._errors", "SyncError"),
    "TrackingError": ("gyrotrack._errors", "TrackingError"),
    "UsageError": ("gyrotrack._errors", "UsageError"),
    "VideoError": ("gyrotrack._errors", "VideoError"),
    "export_file": ("gyrotrack.io._export", "export_file"),
    "extract": ("gyrotrack.apps._api", "extract"),
    "import_body": ("gyrotrack.io.readers._import_case", "import_body"),
    "import_case": ("gyrotrack.io.readers._import_case", "import_case"),
    "open_study": ("gyrotrack.apps._study", "open_study"),
    "propose": ("gyrotrack.tracking._proposal", "propose"),
    "read": ("gyrotrack.apps._api", "read"),
    "read_case": ("gyrotrack.io._hdf5", "read_case"),
    "read_recording": ("gyrotrack.io._hdf5", "read_recording"),
    "sync": ("gyrotrack.apps._api", "sync"),
    "write_case": ("gyrotrack.io._hdf5", "write_case"),
    "write_recording": ("gyrotrack.io._hdf5", "write_recording"),
    "write_report": ("gyrotrack.apps.report._page", "write_report"),
}

__all__ = [
    "BodyTrack",
    "Case",
    "ConfigurationError",
    "DatasetError",
    "FitRequest",
    "GyrotrackError",
    "MarkerTrack",
    "OutputError",
    "Profile",
    "ProfileError",
    "Proposal",
    "Recording",
    "Series",
    "SimulatedRun",
    "Study",
    "SyncError",
    "TrackingError",
    "UsageError",
    "VideoError",
    "export_file",
    "extract",
    "import_body",
    "import_case",
    "open_study",
    "propose",
    "read",
    "read_case",
    "read_recording",
    "sync",
    "write_case",
    "write_recording",
    "write_report",
]


def __getattr__(name: str) -> Any:
    """Import a public name where it is first used."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _PLACES[name]
    value = globals()[name] = getattr(import_module(module), attribute)
    return value


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *__all__})
