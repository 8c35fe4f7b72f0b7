"""Sealed challenges: a simulated run with a hidden effect.

The answer is committed to by SHA-256 of a random salt and the answer's text; the commitment stands in the case
file and in the seal, so that neither can be changed afterwards. The seal holds the answer scrambled with a
stream made from the salt: it keeps honest eyes off, it is no safe against somebody who means to open it.
"""

from __future__ import annotations

import base64
import hashlib
import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.effects._library import LIBRARY
from fitting.effects._user import resolve
from fitting.study._history import Entry
from gyrotrack._errors import DatasetError
from gyrotrack.io._atomic import new_file

FORMAT = "gyrotrack seal"
# laws that no library effect equals: the right answer to them is "unexplained", or a law of one's own
OUTSIDE = (
    "casing: -k*omega_c**3",
    "casing: -k*exp(-((omega_c - 110)/12)**2)",
    "bearing: k*log(abs(delta)/100)",
    "rotor: -k*omega_r**3",
)
_FROM_OUTSIDE = 0.2


@dataclass(frozen=True)
class Hidden:
    """A model with an effect that was drawn by lot, its strength, and the seed of all chance behind it."""

    model: Model
    effect: Effect
    strength: float
    seed: int

    def seal(self, path: Path, numbers: Mapping[str, float], *, force: bool = False) -> str:
        """Seal the effect with its values among the `numbers` of the model; return the commitment."""
        own = {k: v for k, v in numbers.items() if k.startswith(f"{self.effect.name}.")}
        return seal(path, self.effect.name, own, force=force)


@dataclass(frozen=True)
class Seal:
    """What a seal holds when it is open: the hidden effect's name or law, and its parameters."""

    effect: str
    parameters: dict[str, float]
    commitment: str


@dataclass(frozen=True)
class Score:
    """How good an answer is: "right", "right class" or "wrong", and the sigma of its strength."""

    grade: str
    sentence: str
    pulls: dict[str, float]


def draw_effect(present: Sequence[str], random: Any) -> Effect:
    """Draw an effect from the library (without those present) or, one time in five, from outside."""
    if random.random() < _FROM_OUTSIDE:
        return resolve(OUTSIDE[int(random.integers(len(OUTSIDE)))])
    names = [
        n
        for n, e in LIBRARY.items()
        if e.kind == "physical" and n not in present and n not in {"external.constant", "bearing.power"}
    ]
    return LIBRARY[names[int(random.integers(len(names)))]]


def hide_effect(model: Model, strength: float) -> Hidden:
    """Add an effect that nobody chose to a model, with up to twice or half the strength asked for."""
    seed = secrets.randbits(48)
    random = np.random.default_rng(seed)
    effect = draw_effect(model.names, random)
    return Hidden(model.with_effect(effect), effect, float(strength * 2 ** random.uniform(-1, 1)), seed)


def seal(path: Path, effect: str, parameters: Mapping[str, float], *, force: bool = False) -> str:
    """Write a sealed answer and return its commitment.

    Parameters
    ----------
    path : Path
        The JSON file to write.
    effect, parameters
        The hidden effect.
    """
    salt = secrets.token_hex(16)
    answer = json.dumps({"effect": effect, "parameters": dict(parameters)}, sort_keys=True)
    commitment = hashlib.sha256(f"{salt}{answer}".encode()).hexdigest()
    document = {
        "format": FORMAT,
        "commitment": commitment,
        "salt": salt,
        "sealed": base64.b64encode(_scramble(answer.encode(), salt)).decode(),
    }
    with new_file(path, force=force) as stream:
        stream.write(json.dumps(document, indent=1).encode())
    return commitment


def unseal(path: Path) -> Seal:
    """Open a seal.

    Raises
    ------
    DatasetError
        If the file is no seal, or the answer in it is not the one that was committed to.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        sealed = base64.b64decode(document["sealed"], validate=True)
        salt, commitment = str(document["salt"]), str(document["commitment"])
        answer = _scramble(sealed, salt).decode()
        content = json.loads(answer)
        effect, parameters = (
            str(content["effect"]),
            {str(k): float(v) for k, v in content["parameters"].items()},
        )
    except FileNotFoundError:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise DatasetError(
            f"{path} is not a seal of gyrotrack.", "Seals are made by `gyrotrack simulate --hide`."
        ) from None
    if hashlib.sha256(f"{salt}{answer}".encode()).hexdigest() != commitment:
        raise DatasetError(
            f"{path} has been tampered with: the answer is not the one committed to.", "Ask for the original."
        )
    return Seal(effect, parameters, commitment)


def answer_of(entries: Sequence[Entry]) -> tuple[list[str], dict[str, tuple[float, float]]]:
    """Return what a ladder of fits says: the effects that it added, and their parameters with errors.

    A ladder that ends unexplained names nothing: what it added on the way are hypotheses.
    """
    first, last = entries[0].document, entries[-1].document
    named = [n for n in last["model"] if n not in first["model"]] if last["verdict"] == "adequate" else []
    return named, {k: (v["value"], v["stderr"]) for k, v in last["parameters"].items() if v["stderr"]}


def grade(truth: Seal, named: Sequence[str], found: Mapping[str, tuple[float, float]]) -> Score:
    """Grade an answer.

    Parameters
    ----------
    truth : Seal
        The open seal.
    named : sequence of str
        The effect answered first, then those that the answer could not tell from it; empty for "none".
    found : mapping of str to (value, error)
        Parameters of the answer by key.
    """
    outside = truth.effect not in LIBRARY
    twins = {truth.effect} if outside else {truth.effect, *LIBRARY[truth.effect].equivalent}
    if named and named[0] in twins:
        word = "right"
    elif set(named) & twins or (outside and not named):
        word = "right class"
    else:
        word = "wrong"
    pulls = {
        k: (value - truth.parameters[k]) / error
        for k, (value, error) in found.items()
        if k in truth.parameters and error > 0
    }
    said = ", ".join(named) if named else "nothing that has a name"
    return Score(word, f"Hidden was {truth.effect}; the answer was {said}: {word}.", pulls)


def _scramble(data: bytes, salt: str) -> bytes:
    stream = b"".join(hashlib.sha256(f"{salt}{i}".encode()).digest() for i in range(len(data) // 32 + 1))
    return bytes(a ^ b for a, b in zip(data, stream, strict=False))
