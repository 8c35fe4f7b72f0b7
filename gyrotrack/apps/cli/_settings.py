"""Options of the commands: settings files (`gyrotrack.toml` and the user's own), and options that commands share.

::

    [extract]
    capture_fps = 260
    profile = "lab.toml"        # relative to the folder of this file

    [sync]
    inertia_rotor = "5.54e-5 +- 0.06e-5"

Each section is a command. Its keys are the options of this command, written with ``_`` for ``-``.

A file given by the user (``--config``, ``$GYROTRACK_CONFIG``) and the settings file of the user may set every option. A
``gyrotrack.toml`` found in the working folder comes with the data and may be hostile: it may set only the options in
`FOUND`, and paths only within its own folder.

A command is imported when it runs, or when its options are needed to check a settings file. Therefore `gyrotrack
--help` imports no numerical library.
"""

from __future__ import annotations

import inspect
import math
import os
import tomllib
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import Enum, StrEnum
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from gyrotrack._errors import ConfigurationError, UsageError
from gyrotrack.apps.batch._workers import Cluster
from gyrotrack.apps.cli._output import Output

if TYPE_CHECKING:
    from pydantic import BaseModel

    from fitting.effects._effect import Effect
    from fitting.effects._mechanism import Mechanism

NAME = "gyrotrack.toml"
VARIABLE = "GYROTRACK_CONFIG"
NONE = "none"  # file name that disables settings

# options that a file found in the working folder may set, because they affect only computation and display
_COMPUTE = (
    "add all appendix beyond_library body body_name bound capture_fps casing casing_fps centre centre_offset "
    "clock_rate colour column cut data drop dry_run duration fitting fix format friction from hide hold_out "
    "hub improve inertia inertia_casing inertia_rotor joint json keep_all label law likelihood links loss "
    "marker model omega_casing omega_rotor per_case point profile pulses_per_turn quiet recordings resume "
    "rotor rotor_fps rotor_start scale seed set share sigma size speed_scale start_u strength surface table "
    "tilt timeout times to torque_noise torque_time tracking until verbose verify window window_length"
)
# options whose values are files to read or to write; a found file may set them to files in its own folder
_PATHS = (
    "clips contact_sheet csv effects film films folder latex ledger output overlay picture prior "
    "prior_rotor report run_times"
)
FOUND = frozenset(f"{_COMPUTE} {_PATHS}".split())
# options that only the user may set: they replace or delete results, have values that contain file names, or set
# addresses, certificates, ports or the number of processes
REFUSED = frozenset(
    "answer browser delete force input name note part port save_law scheduler tls_ca tls_cert tls_key workers".split()  # noqa: SIM905
)


@dataclass(frozen=True)
class Settings:
    """Settings of a file by command and parameter, with their lines."""

    path: Path | None = None
    values: dict[str, dict[str, Any]] = field(default_factory=dict)
    lines: dict[tuple[str, str], int | None] = field(default_factory=dict)


def find(named: Path | None = None) -> tuple[Path | None, bool]:
    """Return the settings file (given, $GYROTRACK_CONFIG, ./gyrotrack.toml or the user's), and whether it is trusted.

    Only ./gyrotrack.toml is not trusted.
    """
    chosen = named or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    if chosen == Path(NONE):
        return None, True
    if chosen is not None:
        if not chosen.is_file():
            what = f"There is no settings file {chosen}."
            raise ConfigurationError(what, "Check --config and $GYROTRACK_CONFIG.")
        return chosen, True
    if Path(NAME).is_file():
        return Path(NAME), False
    own = user_file()
    return (own, True) if own is not None and own.is_file() else (None, True)


def user_file() -> Path | None:
    """Return the path of the user's settings file; None for a user without a home folder."""
    from platformdirs import user_config_path

    try:
        path = user_config_path("gyrotrack", appauthor=False, roaming=True) / NAME
    except (RuntimeError, KeyError):
        return None
    # an unexpanded "~" would be a path relative to the working folder
    return path if path.is_absolute() else None


def read(path: Path | None, entries: tuple[Entry, ...], *, trusted: bool = True) -> Settings:
    """Read a settings file and check it against the options of all commands; an error names every line and key.

    A file that is not `trusted` was found in the working folder and may set fewer options.
    """
    if path is None:
        return Settings()
    from gyrotrack._toml import line_of, read_document, read_text

    document = read_document(path, _model(entries), what="settings file")
    text = read_text(path, what="settings file", error=ConfigurationError)
    stated = tomllib.loads(text)
    folder = path.resolve().parent
    values: dict[str, dict[str, Any]] = {}
    lines: dict[tuple[str, str], int | None] = {}
    faults: list[str] = []
    for entry in entries:
        for name, key in options_of(entry).items() if entry.name in stated else ():
            if key not in stated[entry.name]:
                continue
            value = getattr(getattr(document, entry.name), name)
            lines[entry.name, name] = line = line_of(text, (entry.name, key))
            if not trusted and (fault := _not_permitted(key, value, folder)):
                faults.append(f"line {line}, {entry.name}.{key}: {fault}")
            values.setdefault(entry.name, {})[name] = _plain(value, folder)
    if faults:
        raise ConfigurationError(
            f"{path}: {'; '.join(faults[:8])}.",
            "Give the option on the command line, or check the file and name it with --config.",
        )
    return Settings(path, values, lines)


def _not_permitted(key: str, value: Any, folder: Path) -> str:
    """Return the reason why an untrusted file may not set `key` to `value`; "" if this is permitted."""
    if key not in FOUND:
        return "a settings file found in the working folder may not set this option"
    if key == "model" and value in {"reduced", "general", "linear"}:
        return ""
    for item in value if isinstance(value, list) else [value]:
        named = item if isinstance(item, Path) else Path(str(item)) if key == "model" else None
        if named is not None and not (folder / named).resolve().is_relative_to(folder):
            return "a settings file found in the working folder may name only files within that folder"
    return ""


def as_words(settings: Settings, entry: Entry, given: frozenset[str]) -> tuple[str, ...]:
    """Return the settings of a command as command-line arguments, without the keys in `given`."""
    keys = options_of(entry)
    words: list[str] = []
    for name, value in settings.values.get(entry.name, {}).items():
        option = f"--{keys[name].replace('_', '-')}"
        if keys[name] in given or value is False:
            continue
        items = value if isinstance(value, list) else [value]
        words += [option] if value is True else [f"{option}={item}" for item in items]
    return tuple(words)


def options_of(entry: Entry) -> dict[str, str]:
    """Return the options of a command: the key of each parameter in a settings file."""
    return {name: key for name, (key, _) in _options(entry).items()}


def _options(entry: Entry) -> dict[str, tuple[str, Any]]:
    """Return key and type of each option by name of the parameter."""
    command = function_of(entry)
    hints = typing.get_type_hints(command, include_extras=True)
    found = {}
    for name, hint in hints.items():
        marks = [m for m in getattr(hint, "__metadata__", ()) if isinstance(m, typer.models.OptionInfo)]
        if marks:
            # typer stores the first name of an annotated option as its default
            names = (marks[0].default, *(marks[0].param_decls or ()))
            words = [w for w in names if isinstance(w, str) and w.startswith("--")]
            key = (words[0] if words else f"--{name}").partition("/")[0].lstrip("-").replace("-", "_")
            found[name] = (key, typing.get_args(hint)[0])
    return found


def _model(entries: tuple[Entry, ...]) -> type[BaseModel]:
    from pydantic import ConfigDict, Field, create_model

    strict = ConfigDict(extra="forbid", coerce_numbers_to_str=True)
    sections: dict[str, Any] = {}
    for entry in entries:
        fields: dict[str, Any] = {
            name: (kind | None, Field(default=None, alias=key))
            for name, (key, kind) in _options(entry).items()
        }
        section = create_model(f"section_{entry.name}", __config__=strict, **fields)
        sections[entry.name] = (section | None, None)
    return create_model("settings", __config__=strict, **sections)


def _plain(value: Any, folder: Path) -> Any:
    if isinstance(value, Path):
        return str(folder / value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, list):
        return [_plain(v, folder) for v in value]
    return value


@dataclass(frozen=True)
class Entry:
    """One command: its name, the module with `<name>_command`, and its section and line in the help."""

    name: str
    module: str
    section: str
    help: str


def function_of(entry: Entry) -> Callable[..., Any]:
    """Import the module of a command and return its function `<name>_command`, with the options of its groups."""
    module = import_module(f"gyrotrack.apps.cli.{entry.module}")
    return _with_options_of_groups(getattr(module, f"{entry.name}_command"))


@dataclass(frozen=True)
class Group:
    """Options that several commands have in common.

    They form one argument of a function: a dataclass with a field per option.
    """

    options: Mapping[str, Any]  # annotations by field


def _with_options_of_groups(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function with an argument for each option of the groups in its signature."""
    hints = typing.get_type_hints(function, include_extras=True)
    groups = {
        name: (typing.get_args(hint)[0], mark.options)
        for name, hint in hints.items()
        for mark in getattr(hint, "__metadata__", ())
        if isinstance(mark, Group)
    }
    parameters = []
    for p in inspect.signature(function).parameters.values():
        kind, options = groups.get(p.name, (None, {p.name: hints[p.name]}))
        defaults = {p.name: p.default} if kind is None else {f.name: f.default for f in fields(kind)}
        parameters += [
            p.replace(name=name, default=defaults[name], annotation=annotation)
            for name, annotation in options.items()
        ]

    @wraps(function)
    def command(**given: Any) -> Any:
        for name, (kind, options) in groups.items():
            given[name] = kind(**{option: given.pop(option) for option in options})
        return function(**given)

    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in parameters}
    return command


def load(entry: Entry) -> Any:
    """Build a command from the signature of its function."""
    single = typer.Typer(add_completion=False, rich_markup_mode=None)
    single.command(name=entry.name)(function_of(entry))
    return get_command(single)


def lazy_group(entries: tuple[Entry, ...]) -> type[TyperGroup]:
    """Return a command group of `entries` that imports a command when it runs."""
    table = {entry.name: entry for entry in entries}

    class LazyGroup(TyperGroup):
        """Commands that are imported on use."""

        def list_commands(self, ctx: Any) -> list[str]:
            """Return the names in the order of the table."""
            del ctx
            return list(table)

        def get_command(self, ctx: Any, cmd_name: str) -> Any:
            """Return a placeholder with name and help line."""
            del ctx
            entry = table.get(cmd_name)
            return entry and TyperCommand(name=entry.name, help=entry.help, rich_markup_mode=None)

        def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
            """Import and return the command to run."""
            # all names are needed for the question "did you mean"
            self.commands = {name: self.get_command(ctx, name) for name in table}
            name, _, rest = super().resolve_command(ctx, args)
            return name, load(table[name]) if name in table else None, rest

        def format_commands(self, ctx: Any, formatter: Any) -> None:
            """List the commands section by section."""
            del ctx
            for section in dict.fromkeys(entry.section for entry in entries):
                with formatter.section(section):
                    formatter.write_dl([(e.name, e.help) for e in entries if e.section == section])

    return LazyGroup


def option(words: str, text: str, **settings: Any) -> Any:
    """Return an option, given its names and placeholder, as in ``-o --output FILE``, and its help text."""
    names = [w for w in words.split() if w.startswith("-")]
    return typer.Option(*names, metavar=words.partition(names[-1])[2].strip() or None, help=text, **settings)


Json = Annotated[bool, option("--json", "Print one JSON document on stdout and nothing else.")]
Quiet = Annotated[bool, option("-q --quiet", "Show warnings only, no progress or other messages.")]
Verbose = Annotated[bool, option("-v --verbose", "Verbose output.")]
Out = Annotated[Output, Group({"as_json": Json, "quiet": Quiet})]
VerboseOut = Annotated[Output, Group({"as_json": Json, "quiet": Quiet, "verbose": Verbose})]
Force = Annotated[bool, option("--force", "Replace an existing output.")]

OutputFile = Annotated[Path, option("-o --output FILE", "File to write.")]
OptionalOutputFile = Annotated[Path | None, option("-o --output FILE", "File to write.")]
CaseFiles = Annotated[
    list[Path], typer.Argument(metavar="CASE.h5", help="Case files, made by `sync` or `import`.")
]

Films = Annotated[
    list[Path] | None,
    option("--films DIR", "Folder of the films; by default the folder of the case and the current folder."),
]

InertiaRotor = Annotated[
    str | None,
    option(
        "--inertia-rotor I", "Moment of inertia of the rotor: '5.54e-5 +- 0.06e-5' (kg m2) or '554 g cm2'."
    ),
]
InertiaCasing = Annotated[
    str | None, option("--inertia-casing I", "Moment of inertia of the casing, in the same form.")
]
Label = Annotated[str | None, option("--label L", "Name of the case; by default the name of the file.")]
BodyName = Annotated[
    str, option("--body-name NAME", "Name of the single body, for example wheel, in all sentences and keys.")
]
Surface = Annotated[str, option("--surface S", "Surface on which the casing turns.")]


def film_folders(cases: Sequence[Path], given: Sequence[Path] | None) -> list[Path]:
    """Return the folders that are searched for films; see `Films`."""
    return list(given) if given else list(dict.fromkeys([*(c.parent for c in cases), Path()]))


Hub = Annotated[
    str | None,
    option("--hub X,Y", "Centre of rotation [px], also outside of the image; by default detected."),
]
Point = Annotated[
    str | None,
    option(
        "--point X,Y", "Follow this point of the body, by its position in the first frame of a film [px]."
    ),
]


class Colour(StrEnum):
    """Colour of a point."""

    red = "red"
    orange = "orange"
    yellow = "yellow"
    green = "green"
    cyan = "cyan"
    blue = "blue"
    magenta = "magenta"


PointColour = Annotated[
    Colour | None,
    option("--colour NAME", "Follow a point of this colour; with --point, the point at that position."),
]
PixelScale = Annotated[
    float | None, option("--scale M_PER_PX", "Length of a pixel [m]: `export --table points` is then in m.")
]

PlaneTilt = Annotated[
    str | None,
    option(
        "--tilt ANGLE[,DIRECTION]",
        "Correct a film for the tilt of the axis of rotation relative to the line of sight [degrees]; DIRECTION is "
        "along the short axis of the ellipse, counter-clockwise from the right (90 by default).",
    ),
]


def checked_scale(scale: float | None) -> float | None:
    """Return the length of a pixel [m]; a UsageError unless it is positive."""
    if scale is not None and not 0.0 < scale < math.inf:
        raise UsageError(f"Invalid scale: {scale:g} m per px.", "Give a positive number.")
    return scale


BodyInertia = Annotated[
    str | None,
    option(
        "--inertia I",
        "Moment of inertia of the single body, for example '5.5e-5 +- 0.1e-5' (kg m2); without it torques are per "
        "unit of inertia.",
    ),
]
Columns = Annotated[
    list[str] | None,
    option(
        "--column QUANTITY=COLUMN",
        "Quantity in a column of a table, which is selected by its header or number: t=Zeit, 'angle=phi "
        "[deg]', 't=1 [us]', x=2, revolutions=3. For only one of two bodies: casing.revolutions=5.",
    ),
]
Inputs = Annotated[
    list[str] | None,
    option(
        "--input NAME=COLUMN",
        "Recorded input of the motion, for laws like 'casing: k*current': 'current=3 [A] +- 0.01', with "
        "interpolation and dead time 'pwm=Command, hold, delay=0.02', from a separate table 'torque=2 [N m], "
        "file=torque.csv'.",
    ),
]
PulsesPerTurn = Annotated[
    float | None,
    option(
        "--pulses-per-turn N",
        "The file contains times of pulses [s], intervals, counts or a pulsed signal, with N pulses per turn.",
    ),
]
_MOST_PULSES = 1e6


def check_pulses(number: float | None) -> None:
    """Raise an error if a number of pulses per turn is given and is outside the permitted range."""
    if number is not None and not 1 / _MOST_PULSES <= number <= _MOST_PULSES:
        what = f"--pulses-per-turn {number:g} is not between {1 / _MOST_PULSES:g} and {_MOST_PULSES:g}."
        raise UsageError(what, "Give the number of marks or magnets that pass the sensor in one turn.")


Centre = Annotated[
    str | None, option("--centre C", "Centre of rotation in files of points: a point, X,Y in px, or orbit.")
]
Picture = Annotated[Path | None, option("--picture FILE", "Draw the result: .png, .svg or .pdf.")]
Marker = Annotated[
    str | None,
    option("--marker NAME", "Name of the point to follow, or of the particle, test, signal or table to use."),
]
Likelihood = Annotated[float, option("--likelihood P", "Minimum likelihood of the points that are used.")]
StartTime = Annotated[float | None, option("--from T", "Exclude samples before this time [s].")]
StopTime = Annotated[float | None, option("--to T", "Exclude samples after this time [s].")]
Cuts = Annotated[list[str] | None, option("--cut A:B", "Exclude samples between two times [s]; repeatable.")]
From = Annotated[str | None, option("--from ID", "Fit to start from; by default the latest.")]
PriorStudy = Annotated[
    Path | None,
    option(
        "--prior STUDY",
        "Case or ledger of other recordings; the parameters of its latest fit become a prior.",
    ),
]
PriorRotor = Annotated[
    Path | None,
    option(
        "--prior-rotor STUDY",
        "Prior from a study of the rotor alone; the laws of its body apply to the rotor.",
    ),
]
LedgerFile = Annotated[
    Path | None, option("--ledger FILE", "File of the fits; by default next to the first case.")
]
OfCluster = Annotated[
    Cluster,
    Group({
        "scheduler": Annotated[
            str | None,
            option(
                "--scheduler ADDRESS",
                "Run on the Dask cluster of this scheduler: tls://HOST:PORT or tcp://HOST:PORT.",
                envvar="GYROTRACK_SCHEDULER",
            ),
        ],
        "tls_ca": Annotated[
            Path | None,
            option("--tls-ca FILE", "Certificate authority of the cluster (PEM).", envvar="GYROTRACK_TLS_CA"),
        ],
        "tls_cert": Annotated[
            Path | None, option("--tls-cert FILE", "Certificate of this client (PEM).", envvar="GYROTRACK_TLS_CERT")
        ],
        "tls_key": Annotated[
            Path | None, option("--tls-key FILE", "Private key of this client (PEM).", envvar="GYROTRACK_TLS_KEY")
        ],
    }),
]  # fmt: skip
EffectsFile = Annotated[Path | None, option("--effects FILE", "Your own effects, in TOML.")]
Friction = Annotated[
    bool, option("--friction", "Also consider the friction laws of LuGre, Maxwell slip (GMS) and starvation.")
]
DataKind = Annotated[
    str | None, option("--data D", "Fitted quantity: angle, or velocity (smoothed as in the paper).")
]
RotorKind = Annotated[
    str,
    option(
        "--rotor R", "Rotor data: windows (as measured) or generated (a curve through them, as in the paper)."
    ),
]


def own_effects(
    path: Path | None, mechanism: Mechanism | None = None, *, friction: bool = False
) -> list[Effect]:
    """Read user-defined effects of the bodies of a case (by default a gyroscope), if a file is given.

    With `friction` the laws that a search omits by default are added.
    """
    from fitting.effects._mechanism import GYROSCOPE

    mechanism = mechanism or GYROSCOPE
    if friction:
        from fitting.effects._instances import counterparts
        from fitting.effects._library import FRICTION

        laws = (e for name in FRICTION for e in counterparts(name, mechanism))
        return [*own_effects(path, mechanism), *(e for e in laws if not e.searched)]
    if path is None:
        return []
    from fitting.effects._user import read_effects
    from gyrotrack.io._atomic import refuse_special

    refuse_special(path)
    return read_effects(path, mechanism)


def reading_lines(readings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return two lines for each table: the quantity in each column with the reason, and the unused columns."""
    from gyrotrack.io.readers._reading import reading_of

    return [line for document in readings for line in reading_of(document).lines()]
