"""Which number is which: the vector of a fit against the parameters of each case."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics import INERTIA_CASING, INERTIA_ROTOR
from fitting.effects.effect import Parameter
from fitting.errors import EffectError
from fitting.model import Model
from fitting.record import Record

Array = NDArray[np.float64]

START_ROTOR, START_CASING = "initial.omega_r", "initial.omega_c"
# the surface may differ from case to case, and the paper frees the casing's drag with it
PER_CASE = ("touchpoint.", "casing.air.linear.")
_START = Parameter("omega", "rad s-1", "shape", -np.inf, np.inf)


@dataclass(frozen=True)
class Layout:
    """The names of all variables of a fit of some cases.

    Parameters
    ----------
    model : Model
        The model.
    records : tuple of Record
        The cases.
    per_case : tuple of str
        Parameters (keys, effects or prefixes) with a value for each case.
    ranges : mapping
        Bounds, by name, within the declared ones.
    """

    model: Model
    records: tuple[Record, ...]
    per_case: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        model: Model,
        records: Sequence[Record],
        share: Iterable[str] = (),
        per_case: Iterable[str] = (),
        ranges: Mapping[str, tuple[float, float]] | None = None,
    ) -> Layout:
        """Return the layout: the paper's per-case parameters, changed by `share` and `per_case`.

        Raises
        ------
        EffectError
            If a name of `share` or `per_case` is no parameter of the model.
        """
        for name in (*share, *per_case):
            if not any(covers(name, key) for key in model.free):
                raise EffectError(
                    f"{name!r} is no parameter of the model", "it has: " + ", ".join(model.free)
                )
        default = [key for key in model.free if key.startswith(PER_CASE)]
        chosen = [
            key
            for key in model.free
            if (key in default or any(covers(n, key) for n in per_case))
            and not any(covers(n, key) for n in share)
        ]
        return cls(model, tuple(records), tuple(chosen) if len(records) > 1 else (), dict(ranges or {}))

    @cached_property
    def choices(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """What is shared, and what each case has of its own, other than is usual: `of` takes both."""
        if len(self.records) == 1:
            return (), ()
        usual = {key for key in self.model.free if key.startswith(PER_CASE)}
        return (
            tuple(k for k in self.model.free if k in usual and k not in self.per_case),
            tuple(k for k in self.per_case if k not in usual),
        )

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The name of each variable: `key`, `key@label`, and the start speeds of each case."""
        names: list[str] = []
        for key in self.model.free:
            names += [f"{key}@{r.label}" for r in self.records] if key in self.per_case else [key]
        for record in self.records:
            names += [f"{START_ROTOR}@{record.label}", f"{START_CASING}@{record.label}"]
        return tuple(names)

    @cached_property
    def index(self) -> dict[str, int]:
        """The place of each name."""
        return {name: i for i, name in enumerate(self.names)}

    def places(self, case: int, keys: Sequence[str]) -> NDArray[np.intp]:
        """Return where the parameters of one case stand."""
        label = self.records[case].label
        return np.array([self.index.get(f"{k}@{label}", self.index.get(k, -1)) for k in keys], dtype=np.intp)

    def numbers(self, theta: Array, case: int) -> dict[str, float]:
        """Return parameters by key, constants and inertias of one case."""
        record = self.records[case]
        values = dict(zip(self.model.free, theta[self.places(case, self.model.free)].tolist(), strict=True))
        inertias = {INERTIA_ROTOR: record.I_rotor, INERTIA_CASING: record.I_casing}
        return values | self.model.constants | inertias

    def start(self, theta: Array, case: int) -> tuple[float, float]:
        """Return the start speeds of one case [rad/s]."""
        i, j = self.places(case, (START_ROTOR, START_CASING))
        return float(theta[i]), float(theta[j])

    def parameter(self, name: str) -> Parameter:
        """Return the declaration behind a name."""
        return self.model.parameters.get(name.partition("@")[0], _START)

    def bounds(self) -> tuple[Array, Array]:
        """Return lower and upper bounds of all variables."""
        lower, upper = self.declared_bounds()
        for name, (least, most) in self.ranges.items():
            if name in self.index:
                i = self.index[name]
                lower[i], upper[i] = max(lower[i], least), min(upper[i], most)
        return lower, upper

    def declared_bounds(self) -> tuple[Array, Array]:
        """Return the bounds that effects declare, whatever range is asked for."""
        declared = [self.parameter(n) for n in self.names]
        return np.array([p.lower for p in declared]), np.array([p.upper for p in declared])

    def at_bound(self, theta: Array) -> NDArray[np.bool_]:
        """Return which variables lie on a bound."""
        lower, upper = self.bounds()
        near = 1e-9 * np.maximum(np.abs(theta), 1e-30)
        return np.asarray((theta - lower <= near) | (upper - theta <= near))

    def is_physical_bound(self, name: str) -> bool:
        """Return whether nature sets the bounds of a variable (friction takes energy), not habit or a range."""
        return self.parameter(name).role == "amplitude" and name not in self.ranges


def covers(name: str, key: str) -> bool:
    """Return whether a name stands for a parameter: its key, its effect or a part of that, or its symbol alone."""
    return key == name or key.startswith(name.rstrip(".") + ".") or key.rpartition(".")[2] == name
