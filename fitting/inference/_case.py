"""A case as Python users write it, with the arrays of each body by its name, and the names of its parameters.

The library contains laws of a casing and its touch point. A single body has its own name, for example wheel. Its laws
are then called ``wheel.air.quadratic``, which is ``casing.air.quadratic`` of the library, and
``wheel.support.constant``, which is ``touchpoint.constant``. In a case of one body, ``air.quadratic`` and
``support.constant`` suffice. In formulas its speed is ``omega`` and its angle ``psi``.

Several bodies that are connected by joints are a chain. Each body and joint of a chain has its own copy of the laws of
the library (see `fitting.effects._instances`), for example ``wheel.air.quadratic`` and ``belt.linear``. In formulas the
speeds are ``omega_wheel`` and ``delta_belt``, and in a law of the wheel or of the belt ``omega`` and ``delta`` suffice.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting._arguments import PATH, require
from fitting._case_checks import defect_of_joints, is_body_name
from fitting._errors import EffectError, RecordError
from fitting.dynamics._inputs import Input
from fitting.dynamics._model import NAMED, Model
from fitting.effects._instances import PLACES
from fitting.effects._library import LIBRARY
from fitting.effects._mechanism import GYROSCOPE, Mechanism
from fitting.effects._user import resolve
from fitting.inference._error_modes import ErrorMode
from fitting.inference._record import Record, make_record

Array = NDArray[np.float64]

_GYROSCOPE = ("casing", "rotor")
_KEYS = ("t", "omega", "angle", "u", "inertia", "inertia_u", "modes")
_VARIABLES = {"omega": "omega_c", "psi": "psi_c"}


def outward(name: str, body: str) -> str:
    """Return a name of the library as it is shown for a single body; for a gyroscope, the name is not changed."""
    if not body:
        return name
    joint, colon, law = name.partition(":")
    if colon and joint == "casing":
        for own, variable in _VARIABLES.items():
            law = re.sub(rf"\b{variable}\b", own, law)
        return f"{body}:{law}"
    if name.startswith("initial.omega_c"):
        return name.replace("omega_c", "omega", 1)
    for inner, outer in PLACES:
        if name.startswith(inner):
            return f"{body}.{outer}{name.removeprefix(inner)}"
    return name


def inward(name: str, body: str) -> str:
    """Return the library's name of an effect, a parameter or a formula of a single body; the inverse of `outward`."""
    if not body:
        return name
    joint, colon, law = name.partition(":")
    if colon:
        if joint.strip() not in {body, "casing"}:
            return name
        for own, variable in _VARIABLES.items():
            law = re.sub(rf"\b{own}\b", variable, law)
        return f"casing:{law}"
    if re.match(r"initial\.omega(@|$)", name):
        return name.replace("omega", "omega_c", 1)
    named = name.startswith(f"{body}.")
    rest = name.removeprefix(f"{body}.")
    for inner, outer in PLACES[:-1]:
        if rest.startswith(outer):
            return inner + rest.removeprefix(outer)
    of_casing = f"casing.{rest}"
    known = any(of_casing == e or of_casing.startswith(f"{e}.") for e in LIBRARY)
    drives = re.fullmatch(r"input\.\w+(\.k)?", rest) is not None
    return of_casing if named or known or drives else name


@dataclass(frozen=True, repr=False)
class Case:
    """A measured motion: bodies with their series, and recorded inputs.

    Parameters
    ----------
    record : Record
        The arrays; `Case.from_arrays` and `Case.load` make it.

    Examples
    --------
    >>> import numpy as np
    >>> from fitting import Case, fit
    >>> t = np.linspace(0.0, 10.0, 201)
    >>> case = Case.from_arrays(wheel={"t": t, "omega": 20.0 * np.exp(-0.1 * t), "u": 0.01})
    >>> round(fit("air.linear", case).params["b2"].value, 6)
    0.1
    """

    record: Record

    def __post_init__(self) -> None:
        if not isinstance(self.record, Record):
            raise RecordError(
                f"a case is made of a Record, not of a {type(self.record).__name__}",
                "use Case.from_arrays(wheel=dict(t=..., omega=...)) or Case.load(path)",
            )

    @classmethod
    def from_arrays(
        cls,
        *,
        label: str = "case",
        surface: str = "",
        inputs: Mapping[str, Mapping[str, Any]] | Sequence[Input] = (),
        joints: Mapping[str, tuple[str, str]] | None = None,
        **bodies: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    ) -> Case:
        """Make a case from arrays.

        Parameters
        ----------
        label, surface : str
            Name of the recording, and the surface on which the body turned.
        inputs : mapping of str to mapping, or sequence of Input
            Recorded inputs on which torques may depend: ``{"current": {"t": t, "value": i, "unit": "A"}}``.
        joints : mapping of str to (str, str), optional
            The joints of several bodies: ``{"belt": ("motor", "drum")}``. The speed of a joint is the speed of its
            first body minus the speed of its second body; its torque drives the second body and brakes the first body.
        **bodies : mapping of arrays
            One body by its name, ``casing`` and ``rotor`` of a gyroscope, or several bodies with `joints`. Of several
            bodies, only the first may come to rest and reverse; the others turn in one sense. Each body has times ``t``
            [s] and values ``omega`` [rad/s] or ``angle`` [rad]. ``u`` is the standard uncertainty of the values (array
            or number; estimated if absent). ``inertia`` [kg m2] has the uncertainty ``inertia_u``. Without an inertia,
            torques on a single body are per unit of inertia [rad/s2]; several bodies need all inertias. The rotor, and
            each body of a chain but the first, may have several such mappings, one for each window in which it was
            measured. ``modes`` are errors that samples share, by name: ``{"tilt": {"basis": b, "covariance": c}}`` with
            a row of `b` for each sample (see `fitting.ErrorMode`). Optional entries are the name of a ``group`` of
            modes with the same amplitudes, and an ``origin``.

        Returns
        -------
        Case

        Raises
        ------
        RecordError
            If a body has no arrays, wrong arrays, or too few samples.
        """
        names = list(bodies)
        if not names:
            raise RecordError(
                "a case needs a body",
                "write, for example, Case.from_arrays(wheel=dict(t=t, omega=omega, u=0.01))",
            )
        gyroscope = set(names) == set(_GYROSCOPE) and joints is None
        if len(names) > 1 and not gyroscope and not joints:
            raise RecordError(
                f"bodies {', '.join(sorted(names))}: a case has one body, or the casing and the rotor of a gyroscope, "
                "or bodies with joints",
                'give one body, casing=dict(...) and rotor=dict(...), or joints={"belt": ("motor", "drum")}',
            )
        mechanism = _mechanism(names, joints) if joints else GYROSCOPE
        if len(names) == 1 and not is_body_name(names[0]):
            raise RecordError(
                f"{names[0][:40]!r} cannot be the name of a single body: it has another meaning in laws",
                "choose another name, for example wheel or disc",
            )
        main = "casing" if gyroscope else names[0]
        others = [name for name in mechanism.bodies if name in bodies and name != main]
        series = {name: _series(name, bodies[name], several=name in others) for name in names}
        quantities = {s.quantity for several in series.values() for s in several}
        if len(quantities) > 1:
            raise RecordError(
                "one body has speeds and the other angles", "give omega for both, or angle for both"
            )
        inertias = {name: several[0].inertia for name, several in series.items()}
        without = [name for name, (value, _) in inertias.items() if value is None]
        if without and others:
            raise RecordError(
                "a gyroscope needs the inertia of both bodies: torques between them follow from their ratio"
                if gyroscope
                else f"{without[0]} has no inertia: torques between bodies follow from the ratios of their inertias",
                f"add inertia=... [kg m2] to {' and to '.join(sorted(names))}",
            )
        inertia, inertia_u = inertias[main]
        values = [(float(value or 1.0), u) for value, u in (inertias[n] for n in others)]
        rotor, rotor_u = values[0] if others else (1.0, math.nan)
        windows = [(name, s) for name in others for s in series[name]]
        record = make_record(
            casing=series[main][0].arrays,
            rotor=[s.arrays for _, s in windows],
            I_casing=1.0 if inertia is None else inertia,
            I_rotor=rotor,
            I_casing_u=inertia_u,
            I_rotor_u=rotor_u,
            label=_text("label", label),
            surface=_text("surface", surface),
            quantity="angle" if quantities == {"angle"} else "omega",
            per_inertia=inertia is None,
            inputs=_inputs(inputs),
            name="" if others or main == "casing" else main,
            modes=[
                *_modes(main, "casing", 0, series[main][0]),
                *(m for i, (name, s) in enumerate(windows) for m in _modes(name, "rotor", i, s)),
            ],
            mechanism=mechanism,
            states=[mechanism.bodies.index(name) for name, _ in windows],
            further=values[1:],
        )
        return cls(record)

    @classmethod
    def load(cls, path: str | Path) -> Case:
        """Read a case from a file of `gyrotrack import` or `gyrotrack sync` (see `fitting.load`)."""
        from fitting.inference._case_file import read_record

        require("path", path, PATH)

        return cls(read_record(path))

    @property
    def label(self) -> str:
        """Name of the recording."""
        return self.record.label

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies."""
        return tuple(b.name for b in self.record.bodies)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Recorded inputs."""
        return self.record.inputs

    @property
    def torque_unit(self) -> str:
        """Unit of torques: "N m", or "rad/s2" per unit of inertia."""
        return self.record.torque_unit

    def model(self, *effects: str) -> Model:
        """Return a model of this case.

        Parameters
        ----------
        *effects : str
            Names of laws (``"support.constant"``, ``"wheel.air.quadratic"``) or formulas (``"wheel: -k*omega**3"``); a
            string may contain several, joined by " + ". The name of one of the paper's models is also accepted.

        Raises
        ------
        EffectError
            If a name is unknown.
        """
        return model_of(effects, self.record)

    def __repr__(self) -> str:
        return repr(self.record).replace("Record", "Case", 1)


def model_of(effects: str | Sequence[str], record: Record) -> Model:
    """Return the model with these laws, which are named after the body of the record."""
    names = [effects] if isinstance(effects, str) else list(effects)
    wrong = next((type(e).__name__ for e in names if not isinstance(e, str)), "")
    if wrong or not names:
        raise EffectError(
            f"a {wrong} is not a law" if wrong else "a model needs a law",
            'write, for example, "air.linear" or "casing: -k*omega_c**3"',
        )
    if len(names) == 1 and names[0] in NAMED:
        return Model.of(names[0], record.mechanism).of_bodies(record.parts)
    # a plus sign within a formula is a part of the formula
    names = [n for e in names for n in ([e] if ":" in e else e.split("+"))]
    known = (inward(n.strip(), record.name) for n in names)
    return Model(tuple(resolve(n, record.inputs, record.mechanism) for n in known))


def _mechanism(names: Sequence[str], joints: object) -> Mechanism:
    """Return the mechanism of bodies, the main one first, and joints; a RecordError if they are not a chain."""
    if not isinstance(joints, Mapping) or not all(
        isinstance(pair, Sequence) and not isinstance(pair, str) and len(pair) == 2
        for pair in joints.values()
    ):
        raise RecordError(
            "joints is not a mapping of names to two bodies", 'write joints={"belt": ("motor", "drum")}'
        )
    if defect := defect_of_joints(names, joints):
        raise RecordError(*defect)
    return Mechanism.of(names, joints)


@dataclass(frozen=True)
class _Series:
    arrays: tuple[Array, Array, Array]
    quantity: str
    inertia: tuple[float | None, float]
    modes: Mapping[str, Any]


def _modes(name: str, body: str, window: int, series: _Series) -> Iterator[ErrorMode]:
    """Yield the error modes of a series; without a group, each window has its own amplitudes."""
    for mode, entries in series.modes.items():
        known = {"basis", "covariance", "group", "origin"}
        if not isinstance(entries, Mapping) or not {"basis", "covariance"} <= set(entries) <= known:
            raise RecordError(
                f"the error mode {str(mode)[:40]} of {name} needs a basis and a covariance",
                f'write modes={{"{str(mode)[:40]}": dict(basis=b, covariance=c)}}; also group and origin',
            )
        given = dict(entries)
        given["group"] = f"{name}/{mode}/{window}" if given.get("group") is None else given["group"]
        basis = _array(name, f"basis of {str(mode)[:40]}", given.pop("basis"))
        measured = np.isfinite(series.arrays[0]) & np.isfinite(series.arrays[1])
        if len(basis.shape) and len(basis) == len(measured):
            basis = basis[measured]
        number = window if body == "rotor" else None
        yield ErrorMode(
            name=str(mode), time=series.arrays[0][measured], basis=basis, body=body, window=number, **given
        )


def _series(name: str, given: Any, *, several: bool) -> list[_Series]:
    windows = (
        list(given) if several and isinstance(given, Sequence) and not isinstance(given, str) else [given]
    )
    if not windows:
        raise RecordError(f"{name} has no window", "give at least one dict(t=..., omega=...)")
    return [_one_series(name, w) for w in windows]


def _one_series(name: str, given: Any) -> _Series:
    if not isinstance(given, Mapping):
        raise RecordError(
            f"{name} is a {type(given).__name__}, not a mapping of arrays",
            f"write {name}=dict(t=t, omega=omega, u=u)",
        )
    unknown = sorted(str(k) for k in given if k not in _KEYS)
    if unknown:
        raise RecordError(f"{name} has an unknown entry {unknown[0][:30]!r}", f"entries: {', '.join(_KEYS)}")
    measured = [k for k in ("omega", "angle") if given.get(k) is not None]
    if given.get("t") is None or len(measured) != 1:
        raise RecordError(
            f"{name} needs its times t and one of omega and angle",
            f"write {name}=dict(t=t, omega=omega, u=u)",
        )
    t, value = (_array(name, k, given[k]) for k in ("t", measured[0]))
    u = given.get("u")
    sigma = np.full(t.shape, np.nan) if u is None else _array(name, "u", u)
    if sigma.ndim == 0:
        sigma = np.full(t.shape, float(sigma))
    if t.ndim != 1 or t.shape != value.shape or sigma.shape != t.shape:
        raise RecordError(
            f"the arrays of {name} have the shapes {t.shape}, {value.shape} and {sigma.shape}",
            "t, the measured values and u have one value for each sample (u may be one number)",
        )
    if u is not None and not (sigma > 0).all():
        raise RecordError(f"an uncertainty of {name} is not positive", "give u > 0, or leave it out")
    modes = given.get("modes") or {}
    if not isinstance(modes, Mapping):
        raise RecordError(
            f"modes of {name} is a {type(modes).__name__}, not a mapping",
            'write modes={"tilt": dict(basis=b, covariance=c)}',
        )
    return _Series((t, value, sigma), measured[0], _inertia(name, given), modes)


def _array(name: str, key: str, values: Any) -> Array:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise RecordError(f"{key} of {name} holds no numbers", "use a NumPy array") from None


def _inertia(name: str, given: Mapping[str, Any]) -> tuple[float | None, float]:
    value, u = given.get("inertia"), given.get("inertia_u", math.nan)
    for key, number in (("inertia", value), ("inertia_u", u)):
        if isinstance(number, bool) or not isinstance(number, int | float | np.number | None):
            raise RecordError(
                f"{key} of {name} is a {type(number).__name__}, not a number", "give it in kg m2"
            )
    if value is None:
        return None, math.nan
    if not 0 < float(value) < math.inf or (u is not None and float(u) < 0):
        raise RecordError(f"the inertia of {name} is {value} +- {u} kg m2", "give positive numbers")
    return float(value), math.nan if u is None else float(u)


def _inputs(given: Any) -> list[Input]:
    if not isinstance(given, Mapping):
        # make_record checks that each is an Input
        return given if isinstance(given, list) else list(given) if isinstance(given, tuple) else [given]
    found = []
    for name, entries in given.items():
        if not isinstance(entries, Mapping) or not {"t", "value"} <= set(entries):
            raise RecordError(
                f"the input {str(name)[:40]} needs its times t and its values",
                f'write inputs={{"{str(name)[:40]}": dict(t=t, value=value, unit="A")}}',
            )
        keys = {"t": "time"} | {k: k for k in ("value", "unit", "u", "interpolation", "delay")}
        unknown = sorted(str(k) for k in entries if k not in keys)
        if unknown:
            raise RecordError(
                f"the input {name} has an unknown entry {unknown[0][:30]!r}", f"entries: {', '.join(keys)}"
            )
        found.append(Input(name, **{keys[k]: v for k, v in entries.items()}))
    return found


def _text(what: str, value: object) -> str:
    if not isinstance(value, str):
        raise RecordError(f"the {what} is a {type(value).__name__}, not a string", f'write {what}="..."')
    return value
