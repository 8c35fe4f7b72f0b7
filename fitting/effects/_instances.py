"""The laws of the library for the bodies and joints of a mechanism.

The library contains each law once: a law between a body and the ground is written for the casing, a law of a joint is
written for the bearing. This module rewrites these laws for every body and joint of a case and names them accordingly,
for example ``wheel.air.quadratic``, ``motor.support.constant``, ``belt.linear``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType

from fitting.effects._effect import Effect, State
from fitting.effects._library import LIBRARY, find, unknown
from fitting.effects._mechanism import GYROSCOPE, Coupling, Mechanism, angle_of, renamed, speed_of

# prefixes of names in the library, and the text that replaces them after the name of a body
PLACES = (("touchpoint.", "support."), ("external.", "external."), ("casing.", ""))


@lru_cache(maxsize=64)
def laws_of(mechanism: Mechanism) -> Mapping[str, Effect]:
    """Return the laws of the library by name, written for the bodies and joints of a mechanism."""
    if mechanism == GYROSCOPE:
        return LIBRARY
    found = [e for body in mechanism.bodies for e in _of_body(mechanism, body)]
    found += [e for joint in mechanism.couplings for e in _of_joint(mechanism, joint)]
    names = {(e.pattern, e.site): e.name for e in found}

    def related(patterns: tuple[str, ...], site: str) -> tuple[str, ...]:
        return tuple(names[p, site] for p in patterns if (p, site) in names)

    return MappingProxyType({
        e.name: replace(
            e, equivalent=related(e.equivalent, e.site), confused_with=related(e.confused_with, e.site)
        )
        for e in found
    })  # fmt: skip


def find_law(name: str, mechanism: Mechanism) -> Effect:
    """Return the law of this name for the bodies of a mechanism; raise an EffectError with the closest names."""
    if mechanism == GYROSCOPE:
        return find(name)
    laws = laws_of(mechanism)
    if name not in laws:
        sites = ", ".join((*mechanism.bodies, *mechanism.joints))
        raise unknown(name, laws, f"names begin with a body or a joint: {sites}")
    return laws[name]


def law_of_main(pattern: str, mechanism: Mechanism) -> Effect:
    """Return a law that the library writes for the casing, rewritten for the main body of a mechanism."""
    inner, outer = next(pair for pair in PLACES if pattern.startswith(pair[0]))
    name = pattern if mechanism == GYROSCOPE else f"{mechanism.main}.{outer}{pattern.removeprefix(inner)}"
    return laws_of(mechanism)[name]


def counterparts(name: str, mechanism: Mechanism) -> tuple[Effect, ...]:
    """Return the laws of a mechanism that correspond to one law of the library, which is written for a gyroscope.

    The main body corresponds to the casing, every other body to the rotor, and every joint to the bearing.
    """
    if mechanism == GYROSCOPE:
        return (find(name),)
    role, _, law = name.partition(".")
    others = tuple(b for b in mechanism.bodies if b != mechanism.main)
    sites = {"rotor": others, "bearing": tuple(mechanism.joints)}.get(role, (mechanism.main,))
    pattern = f"casing.{law}" if role == "rotor" else name
    known = {(e.pattern, e.site): e for e in laws_of(mechanism).values()}
    return tuple(known[pattern, site] for site in sites if (pattern, site) in known)


def _of_body(mechanism: Mechanism, body: str) -> Iterator[Effect]:
    """Yield the laws between a body and the ground; laws of an angle only for the main body, whose angle is measured.

    Springs are left out, because only a single body may oscillate.
    """
    for law in LIBRARY.values():
        ground = law.joint == "casing" and law.bodies == {"casing"}
        if not ground or law.restoring or (law.depends_on_angle and body != mechanism.main):
            continue
        inner, outer = next(pair for pair in PLACES if law.name.startswith(pair[0]))
        names = {"omega_c": speed_of(body), "psi_c": angle_of(body)}
        yield _written(law, mechanism, f"{body}.{outer}{law.name.removeprefix(inner)}", body, names)


def _of_joint(mechanism: Mechanism, joint: Coupling) -> Iterator[Effect]:
    """Yield the laws of a joint; in load-dependent laws, the first body replaces the rotor."""
    names = {"delta": joint.delta, "tau": joint.tau, "omega_r": speed_of(joint.first)}
    for law in LIBRARY.values():
        if law.joint == "bearing" or (law.joint == "factor" and law.kind == "physical"):
            own = law.name.removeprefix("bearing.")
            yield _written(law, mechanism, f"{joint.name}.{own}", joint.name, names)


def _written(law: Effect, mechanism: Mechanism, name: str, place: str, names: Mapping[str, str]) -> Effect:
    """Return a law with other symbols.

    The names of its states contain the place, so that copies of a law can be combined.
    """
    names = {**names, **{s.symbol: f"{s.symbol}_{place}" for s in law.states}}

    def state(old: State | None) -> State | None:
        return old and State(names[old.symbol], renamed(old.rate, names), old.start)

    return replace(
        law, name=name, law=renamed(law.law, names), state=state(law.state), second=state(law.second),
        mechanism=mechanism, place=place, pattern=law.name, words=in_words(law.words, place),
        parameters=tuple(replace(p, meaning=in_words(p.meaning, place)) for p in law.parameters),
    )  # fmt: skip


def in_words(text: str, place: str) -> str:
    """Return a text with the casing or the bearing replaced by the name of a body or joint."""
    text = text.replace("at the touch point", f"of the {place}'s support")
    return re.sub(r"\b(casing|bearing)\b", place, text.replace("touch point", "support"))
