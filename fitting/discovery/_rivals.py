"""Rival explanations: sets of effects that the recordings at hand do not separate.

With the information I of the recordings about the strengths of all candidates, the shared parameters projected out, and
the products b of their responses with the residuals, a set H of candidates lowers the deviance by

    b_H' I_HH^-1 b_H

after a linear refit. Effects that the model has beyond the paper's are candidates like all others: what they contribute
to the motion is added to the residuals, so that another effect can take their place.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.discovery._criteria import Criteria
from fitting.discovery._information import Information, schur

Array = NDArray[np.float64]

# determinant of the correlation of two candidates below which no data separates them
_COLLINEAR = 1e-6
# share of the information about a strength that the shared parameters leave, below which they absorb it
_ABSORBED = 1e-12


@dataclass(frozen=True)
class Rival:
    """An explanation: candidate effects with their shape constants and strengths.

    Attributes
    ----------
    names : tuple of str
        The effects.
    columns : tuple of int
        Their places among the columns of `Information`.
    strengths : ndarray
        Strength of each column.
    weight : float
        Its posterior probability among the rivals.
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]
    strengths: Array
    weight: float = 1.0


MOST_RIVALS = 6


def rivals(information: Information, threshold: Sequence[float], criteria: Criteria) -> list[Rival]:
    """Return the explanations that the recordings at hand do not separate, in the linear theory of the score test.

    Every set of at most two effects, among the candidates and the effects that the model has beyond the paper's, is
    scored; those within the equivalence width of the best BIC are rivals, unless a part of them does as well.

    Parameters
    ----------
    information : Information
        Of the recordings at hand.
    threshold : sequence of float
        Score from which each candidate is significant in the whole list.
    criteria : Criteria
        `equivalence_width`, `evidence`.
    """
    added = information.added()
    names = [*added, *(e.name for e, _ in information.candidates)]
    columns = [[place] for place, _ in added.values()]
    columns += [information.places(i) for i in range(len(information.candidates))]
    count = [1 for _ in added] + [len(e.free) for e, _ in information.candidates]
    # friction is not negative
    one_sided = [False for _ in added] + [
        e.amplitude is not None and e.amplitude.lower >= 0 and len(c) == 1
        for (e, _), c in zip(information.candidates, columns[len(added) :], strict=True)
    ]
    physical = [True for _ in added] + [e.kind == "physical" for e, _ in information.candidates]
    places, strengths = [p for p, _ in added.values()], np.array([g for _, g in added.values()])
    base = [k for k in range(information.parameters) if k not in places]
    everything = [k for c in columns for k in c]
    n = len(information.present)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n], augmented[n, :n] = (
        information.present,
        information.right,
        information.right,
    )
    reduced = schur(augmented, [*everything, n], base)
    full, right = reduced[:-1, :-1], reduced[:-1, -1]
    index = {k: i for i, k in enumerate(everything)}
    if places:
        right = right + full[:, [index[p] for p in places]] @ strengths
    size = np.sqrt(np.maximum(np.diag(full), 1e-300))
    per_parameter = math.log(information.fit.problem.rows)
    scored: dict[frozenset[int], tuple[float, Array]] = {frozenset(): (0.0, np.zeros(0))}
    usable = [
        i
        for i, c in enumerate(columns)
        if physical[i] and all(full[index[k], index[k]] > _ABSORBED * information.present[k, k] for k in c)
    ]
    for n in (1, 2):
        for chosen in itertools.combinations(usable, n):
            at = [index[k] for i in chosen for k in columns[i]]
            block = full[np.ix_(at, at)] / np.outer(size[at], size[at])
            if np.linalg.det(block) < _COLLINEAR:
                continue
            g = np.linalg.solve(block, right[at] / size[at])
            gain = float(g @ (right[at] / size[at]))
            signs = [
                v < 0 and one_sided[i]
                for i, v in zip([i for i in chosen for _ in columns[i]], g, strict=True)
            ]
            if any(signs):
                continue
            bic = -gain + per_parameter * sum(count[i] for i in chosen)
            scored[frozenset(chosen)] = bic, g / size[at]
    best = min(bic for bic, _ in scored.values())
    most = max(scored, key=lambda s: -scored[s][0])
    if not added:
        score = -best + per_parameter * sum(count[i] for i in most)
        if not most or score < min(threshold) or best > -criteria.evidence:
            return []
    kept = []
    for members, (bic, g) in sorted(scored.items(), key=lambda item: item[1][0]):
        inner = any(scored[part][0] <= bic for part in scored if part < members)
        if members and not inner and bic < best + criteria.equivalence_width:
            order = [i for i in usable if i in members]
            where = tuple(k for i in order for k in columns[i])
            kept.append(Rival(tuple(names[i] for i in order), where, g, math.exp(-0.5 * (bic - best))))
    kept = kept[:MOST_RIVALS]
    return kept if len(kept) > 1 else []
