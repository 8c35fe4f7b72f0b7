from ._api import fit as fit, load as load
from ._criteria import Criteria as Criteria
from ._errors import EffectError as EffectError, EstimationError as EstimationError
from ._errors import ExpressionError as ExpressionError, FittingError as FittingError
from ._errors import LedgerError as LedgerError, RecordError as RecordError
from ._errors import SimulationError as SimulationError
from .discovery._certificate import Certificate as Certificate, certify as certify
from .law_search._laws import laws as laws
from .planning._plan import plan as plan
from .discovery._select import Candidate as Candidate, improve as improve
from .discovery._verdict import Diagnosis as Diagnosis, diagnose as diagnose
from .dynamics._inputs import Input as Input
from .dynamics._model import Model as Model
from .effects._effect import Effect as Effect, Parameter as Parameter
from .effects._library import GENERAL as GENERAL, LIBRARY as LIBRARY, LINEAR as LINEAR, REDUCED as REDUCED
from .effects._user import effect as effect, read_effects as read_effects
from .effects._words import EffectName as EffectName, effect_name as effect_name
from .inference._budget import budget as budget
from .inference._case import Case as Case
from .inference._error_modes import ErrorMode as ErrorMode
from .inference._first_order import FirstOrder as FirstOrder, first_order as first_order
from .inference._params import Estimate as Estimate, Params as Params
from .inference._profile import profile_interval as profile_interval
from .inference._record import Record as Record, make_record as make_record
from .inference._result import Fit as Fit
from .inference._simulation import Experiment as Experiment, simulate as simulate
from .comparison._comparison import compare as compare
from .study._history import Ledger as Ledger
from .paper._scan import Scan as Scan, predict_recordings as predict_recordings, scan as scan
from .paper._tables import scan_lines as scan_lines
from .study._serialisation import load_fit as load_fit
