from ._errors import ConfigurationError as ConfigurationError, DatasetError as DatasetError
from ._errors import GyrotrackError as GyrotrackError, OutputError as OutputError
from ._errors import ProfileError as ProfileError, SyncError as SyncError, TrackingError as TrackingError
from ._errors import UsageError as UsageError, VideoError as VideoError
from .apps._api import extract as extract, read as read, sync as sync
from .apps._simulation import SimulatedRun as SimulatedRun
from .apps._study import FitRequest as FitRequest, Study as Study, open_study as open_study
from .apps.report._page import write_report as write_report
from .io._contents import export_file as export_file
from .io._hdf5 import read_case as read_case, read_recording as read_recording, write_case as write_case
from .io._hdf5 import write_recording as write_recording
from .io._records import BodyTrack as BodyTrack, Case as Case, ErrorMode as ErrorMode
from .io._records import (
    ChainBody as ChainBody,
    MarkerTrack as MarkerTrack,
    Recording as Recording,
    Series as Series,
)
from .io.readers._import_case import import_body as import_body, import_case as import_case
from .io.readers._import_chain import import_chain as import_chain
from .plotting._ghost import Ghost as Ghost, ghosts as ghosts
from .tracking._profile import Profile as Profile
from .tracking._proposal import Proposal as Proposal, propose as propose

__version__: str
