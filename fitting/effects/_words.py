"""Effects in words: the name, the symbol and the key of any effect or parameter.

The library names each law once, for the casing: "quadratic air drag of the casing". A single recorded body has the role
of the casing. The name of this body replaces "casing", and "support" replaces "touch point".
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from fitting._numbers import SI, Units, symbol_text, unit_text
from fitting.effects._effect import Effect
from fitting.effects._expression import symbols
from fitting.effects._library import LIBRARY, SLIP, START, shortened
from fitting.effects._user import _OF_INPUT, dead_time, drive

CASING = "casing"
# words for the body or joint on which a law of the user acts
_OWN = {"rotor": "on the rotor", CASING: "on the casing", "bearing": "between the bodies"}
# separates the parts of a change of the model, "+casing.air.quadratic -casing.air.linear"; laws may contain spaces
_PART = re.compile(r"(?:^|(?<!:) )(?=[+-][A-Za-z])")
# separates the laws that an exchange adds from the law that it removes
INSTEAD = " instead of "
_INITIAL = {"omega_r": "rotor", "omega_c": CASING}


@dataclass(frozen=True)
class EffectName:
    """The name of an effect, or of a parameter, for a reader.

    Attributes
    ----------
    key : str
        The key that commands accept. Keys of a single body have no role: ``air.quadratic``, ``support.constant``.
    words : str
        The name in words, for example "quadratic air drag of the casing".
    symbol : str
        The symbol of the strength in the formula, for example b₂; empty if there is no strength.
    """

    key: str
    words: str
    symbol: str

    def __str__(self) -> str:
        return self.words if self.key in {"", self.words} else f"{self.words} ({self.key})"


def effect_name(key: str, body: str = CASING, effects: Iterable[Effect] = ()) -> EffectName:
    """Return the name of an effect or of a parameter.

    Parameters
    ----------
    key : str
        The key of an effect (``casing.air.quadratic``, ``camera.start``), of a parameter
        (``casing.air.quadratic.k``, ``initial.omega_c``; the case after ``@`` is ignored), or a law of the user
        (``casing: -k*omega_c**3``).
    body : str
        The name of the recorded body: "casing", or the name of a single body ("body", "wheel").
    effects : iterable of Effect
        Effects that are not in the library.

    Returns
    -------
    EffectName
        The words of an unknown key are the key itself, so that texts that are not keys remain unchanged.

    Examples
    --------
    >>> str(effect_name("touchpoint.constant", "wheel"))
    "dry friction of the wheel's support (support.constant)"
    """
    key, known = key.partition("@")[0], tuple(effects)
    if (effect := _known(key, known)) is not None:
        strength = effect.amplitude or next(iter(effect.free), None)
        words, symbol = _words(effect), symbol_text(strength.symbol) if strength else ""
    else:
        prefix, _, own = key.rpartition(".")
        symbol = symbol_text(own)
        if prefix == "initial" and own in _INITIAL:
            words, symbol = f"initial speed of the {_INITIAL[own]}", symbol_text(f"{own}0")
        elif (effect := _known(prefix, known)) is not None:
            words = f"{symbol} of the {_words(effect)}"
        else:
            return EffectName("", of_body(_law(key), body), "")
    shown = key if body == CASING or effect is None or effect.name not in LIBRARY else shortened(key)
    # the words of a formula already contain the formula
    return EffectName("" if words == _law(key) != key else shown, of_body(words, body), symbol)


def change_name(change: str, body: str = CASING, effects: Iterable[Effect] = ()) -> str:
    """Return a change of the model in words: ``+casing.air.quadratic`` is "+ quadratic air drag of the casing"."""
    new, instead, old = change.partition(INSTEAD)
    parts = [p.strip() for p in _PART.split(new) if p.strip()]
    known = tuple(effects)
    words = " ".join(
        f"{'−' if p[0] == '-' else '+'} {effect_name(p[1:], body, known).words}" if p[0] in "+-" else p
        for p in parts
    )
    return words + instead + effect_name(old, body, known).words if instead else words


def of_body(text: str, body: str) -> str:
    """Return a text about the casing as a text about a single body with the name `body` and its support."""
    if body == CASING:
        return text
    text = text.replace("at the touch point", f"of the {body}'s support").replace("touch point", "support")
    return re.sub(r"\bcasing\b(?![.:])", body, text)


def _words(effect: Effect) -> str:
    return effect.words or _law(effect.name)


def _law(name: str) -> str:
    """Return the words for an effect that a user wrote as ``body: law``; other names are returned unchanged."""
    joint, colon, law = name.partition(":")
    return f"law {law.strip()} {_OWN[joint]}" if colon and joint in _OWN else name


def _known(key: str, effects: Iterable[Effect]) -> Effect | None:
    """Return the effect of a key; None if there is none."""
    found = next((e for e in effects if e.name == key), None) or LIBRARY.get(key)
    if found is None:
        found = {e.name: e for e in (START, SLIP)}.get(key)
    recorded = _OF_INPUT.fullmatch(key)
    if found is not None or recorded is None or recorded["joint"] not in (*_OWN, None):
        return found
    # the unit of the input is not part of the name
    return (
        drive(recorded["joint"], recorded["driven"], "1")
        if recorded["joint"]
        else dead_time(recorded["delayed"], "1")
    )


# the variables of the laws; `symbol_meanings` adds the equations of state variables
_VARIABLES = {
    "t": "time from the start of the recording",
    "omega_r": "angular velocity of the rotor",
    "omega_c": "angular velocity of the casing",
    "delta": "ω_r − ω_c",
    "psi_r": "angle of the rotor",
    "psi_c": "angle of the casing",
    "psi": "angle of the filmed body",
    "omega": "angular velocity of the filmed body",
    "deflection": "angle of the casing from its equilibrium",
    "temperature": "temperature rise of the bearing",
    "chirp": "phase of the precession",
    "strain": "elastic deflection of the contact, relative to its largest value",
    "lag": "state variable of the law, zero at the start",
    "tau": "torque of the bearing",
    "slip": "ω_r − n ω_c",
    "inertia_slip": "effective inertia of the slip",
    "torque_held": "torque at which the slip is constant",
}
_SIGNS = {"deflection": "deflection", "temperature": "T", "chirp": "χ", "tau": "τ_cr", "tau_T": "τ_T"}


def symbol_meanings(
    effects: Iterable[Effect], body: str = CASING, units: Units = SI
) -> tuple[tuple[str, str], ...]:
    """Return the symbols of the formulas of effects with their meanings, for the definitions beneath a formula.

    Parameters
    ----------
    effects : iterable of Effect
        The effects, in the order of their formulas.
    body : str
        The name of the recorded body: "casing", or the name of a single body.
    units : Units
        Units of the torques of the case.

    Returns
    -------
    tuple of (str, str)
        Symbol and meaning: variables first, then the parameters of each effect with their units.
    """
    known = tuple(effects)
    used = {
        s for e in known for s in symbols(e.expression) | (symbols(e.rate) if e.rate is not None else set())
    }
    found = []
    for name, meaning in _VARIABLES.items():
        if name not in used:
            continue
        rate = next((e.state.rate for e in known if e.state is not None and e.state.symbol == name), "")
        text = f"{meaning}, d{_sign(name)}/dt = {_in_signs(rate)}" if rate else meaning
        found.append((_sign(name), of_body(text, body)))
    for e in known:
        for p in e.parameters:
            unit = units.of(p.unit)
            unit = "" if unit == "1" else f" [{unit_text(unit)}]"
            found.append(
                (_sign(p.symbol), of_body(p.meaning or f"parameter of the {_words(e)}", body) + unit)
            )
    return tuple(dict.fromkeys(found))


def _sign(name: str) -> str:
    return _SIGNS.get(name) or symbol_text(name)


def _in_signs(law: str) -> str:
    return re.sub(r"[A-Za-z]\w*", lambda m: _sign(m[0]), law).replace("*", " ")
