"""Command certify: an answer tested on simulated recordings."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from fitting._workers import WorkerPool
from gyrotrack._errors import GyrotrackError, UsageError
from gyrotrack.apps._filming import Filming
from gyrotrack.apps._study import open_study
from gyrotrack.apps.batch._workers import Child, Workers
from gyrotrack.apps.cli import _settings as shared
from gyrotrack.apps.cli._output import DONE, Output, duration
from gyrotrack.apps.cli._settings import option
from gyrotrack.io._hdf5 import read_case
from gyrotrack.io._scratch import scratch_folder
from gyrotrack.synthetic._scene import Motion

if TYPE_CHECKING:
    from fitting.discovery._certificate import Certificate, Item, Outcome
    from fitting.discovery._verdict import Diagnosis
    from fitting.effects._effect import Effect

_WIDTH = 79
# time between two writes of the ledger [s]; number of recordings that a cluster worker simulates in one command
_KEPT, _PART = 20.0, 4
_RECORDINGS, _FILMS = 200, 20
_POINTS_PER_SECOND = 500
Keep = Callable[["Sequence[Outcome]", int], None]


def certify_command(
    cases: shared.CaseFiles,
    *,
    n: Annotated[
        int | None,
        option(
            "-n --recordings N",
            "Number of simulated recordings without the named effect; the same number is simulated with this "
            "effect, and a quarter with each rival effect. By default 200, or 20 with --film.",
            min=1,
        ),
    ] = None,
    film: Annotated[
        bool,
        option("--film", "Render films of this scene, and track and synchronise them; this takes hours."),
    ] = False,
    seed: Annotated[int, option("--seed N", "Random seed of all simulated errors.", min=0)] = 0,
    workers: Annotated[
        int | None, option("--workers N", "Processes; by default one per core, at most 5.", min=1)
    ] = None,
    cluster: shared.OfCluster,
    effects: shared.EffectsFile = None,
    start: shared.From = None,
    ledger: shared.LedgerFile = None,
    part: Annotated[
        list[str] | None, typer.Option("--part", hidden=True, help="Simulate some recordings only.")
    ] = None,
    out: shared.Out,
) -> int:
    """Test an answer on recordings that are simulated from its fit.

    The same bodies, samples and windows are simulated with new random errors, and analysed in the same way: without the
    named effect (how often is there a false alarm?), with this effect (how often is it found, and do the intervals
    contain the true values?), and with each effect that could be mistaken for the named effect. The result is stored
    with the fit; a run that was interrupted continues.

    Example: gyrotrack certify case1.h5 -n 200
    """
    from fitting.discovery._certificate import Certificate, certify, outcomes_of, planned
    from fitting.study._serialisation import certificate_document

    study = open_study(cases, ledger)
    own, n = shared.own_effects(effects, study.mechanism), n or (_FILMS if film else _RECORDINGS)
    if part:
        found, _ = study.answered(start, own)
        items = [_item(p) for p in part]
        outcomes = (
            [_from_film(found, item, cases, seed, own) for item in items]
            if film
            else outcomes_of(found, items, seed=seed, extra=own)
        )
        out.result({"outcomes": [vars(o) for o in outcomes]})
        return DONE
    for case in cases if film else ():
        # called now, so that a case without films raises an error before hours of computation
        Filming.of(read_case(case))
    pool = WorkerPool() if workers is None else WorkerPool(workers - 1)
    with pool:
        with out.progress("analysing the recording") as progress:
            progress(0, None)
            found, fit_id = study.answered(start, own, workers=pool)
        with out.progress("simulating recordings") as progress:
            earlier = study.ledger.find(fit_id).certificate(found, seed, film=film)
            known = earlier.outcomes if earlier is not None else ()
            empty = Certificate.of_answer(found, (), n, seed, film=film)
            keep = _Keeper(out, progress, study.ledger, fit_id, empty, known)
            # progress is shown at once, because the first recording takes long
            progress(0, len(planned(found, n)))
            if cluster.scheduler is None and not film:
                done = certify(found, n, seed=seed, extra=own, known=known, workers=pool, keep=keep)
            else:
                words = [*(str(c.resolve()) for c in cases), "--seed", str(seed), "--from", fit_id]
                words += ["--ledger", str(study.ledger.path.resolve())]
                words += ["--effects", str(effects.resolve())] if effects is not None else []
                words += ["--film"] if film else []
                with closing(cluster.workers(study.ledger.path.resolve().parent, workers)) as place:
                    done = _by_commands(found, empty, known, place, words, keep)
            keep.store(done)
    out.result(certificate_document(done, fit_id))
    out.show(_table(done, fit_id))
    return DONE


def _from_film(
    found: Diagnosis, item: Item, cases: Sequence[Path], seed: int, own: Sequence[Effect]
) -> Outcome:
    """Render the films of one simulated experiment, analyse them from tracking to fit, and return the answer."""
    from fitting.discovery._certificate import hypotheses, outcome_of_records
    from fitting.inference._case_file import read_record
    from fitting.inference._replica import motion_of

    kind, effect, number = item
    (hypothesis,) = (w for w in hypotheses(found) if (w.kind, w.effect) == (kind, effect))
    # image noise is independent of the random errors of the motion, and of other recordings
    picture = int(np.random.SeedSequence((seed, *f"{kind}:{effect}".encode(), number)).generate_state(1)[0])
    child, records = Child(), []
    with scratch_folder() as folder, closing(child):
        for i, path in enumerate(cases):
            place = folder / str(i)
            place.mkdir()
            case, data = read_case(path), found.fit.problem.data[i]
            first, last = data.record.casing.time[[0, -1]].tolist()
            times = np.linspace(first, last, int((last - first) * _POINTS_PER_SECOND) + 1)
            casing, rotor = motion_of(hypothesis.fit, i, times, (seed, *effect.encode(), number))
            motion = Motion.from_angles(times, rotor, casing)
            trial = Motion.from_angles(times, *motion_of(found.fit, i, times, seed)[::-1])
            filming = Filming.of(case).with_measured_noise(trial, place, child.run, seed)
            inertias = ["--label", data.record.label]
            for name in ("rotor", "casing"):
                value, u = getattr(case, f"I_{name}"), getattr(case, f"I_{name}_u")
                stated = f"{value!r} +- {u!r}" if math.isfinite(u) else repr(value)
                inertias += [f"--inertia-{name}", stated]
            made = filming.recorded(motion, place, child.run, inertias, picture)
            if made is None:
                return outcome_of_records(found, item, (), extra=own)
            records.append(read_record(made))
    return outcome_of_records(found, item, records, extra=own)


class _Keeper:
    """Shows progress and expected duration of a test, and stores its outcomes regularly."""

    def __init__(
        self,
        out: Output,
        progress: Callable[[int, int | None], None],
        ledger: Any,
        fit_id: str,
        empty: Certificate,
        known: Sequence[Outcome],
    ) -> None:
        self._out, self._progress, self._ledger, self._fit_id = out, progress, ledger, fit_id
        self._empty, self._known, self._told = empty, known, False
        self._begun = self._stored = monotonic()

    def __call__(self, outcomes: Sequence[Outcome], total: int) -> None:
        """Show the outcomes so far, out of `total`, and store them if the last write was long ago."""
        self._progress(len(outcomes), total)
        now = monotonic()
        new = len(outcomes) - len(self._known)
        if not self._told and new > 0 and len(outcomes) < total:
            left = (total - len(outcomes)) * (now - self._begun) / new
            self._out.note(f"{total} recordings are simulated and analysed; about {duration(left)} left.")
            self._told = True
        if now - self._stored > _KEPT:
            self.store(replace(self._empty, outcomes=tuple(outcomes)))
            self._stored = now

    def store(self, done: Certificate) -> None:
        """Store a complete or partial test with its fit.

        If an earlier test was longer, its further outcomes are kept.
        """
        made = {(o.kind, o.effect, o.number) for o in done.outcomes}
        longer = [o for o in self._known if (o.kind, o.effect, o.number) not in made]
        n = max([done.n, *(o.number + 1 for o in longer if o.kind == "null")])
        self._ledger.keep_certificate(self._fit_id, replace(done, n=n, outcomes=(*done.outcomes, *longer)))


def _item(text: str) -> Item:
    """Parse the name of a simulated recording like ``truth:casing.windage:17``."""
    kind, _, rest = text.partition(":")
    effect, _, number = rest.rpartition(":")
    if not number.isdecimal():
        raise UsageError(f"{text[:60]!r} does not name a simulated recording.", "Write kind:effect:number.")
    return kind, effect, int(number)


def _by_commands(
    found: Diagnosis,
    empty: Certificate,
    known: Sequence[Outcome],
    place: Workers,
    words: Sequence[str],
    keep: Keep,
) -> Certificate:
    """Return the certificate; commands simulate the recordings, in processes or on a cluster."""
    from fitting.discovery._certificate import Outcome, planned

    wanted = planned(found, empty.n)
    done: dict[Item, Outcome] = {(o.kind, o.effect, o.number): o for o in known}
    missing = [item for item in wanted if item not in done]
    waiting, size = set(), 1 if empty.film else _PART
    for first in range(0, len(missing), size):
        parts = [f"--part={kind}:{effect}:{k}" for kind, effect, k in missing[first : first + size]]
        waiting.add(place.submit(["certify", *words, *parts], None))
    while waiting:
        ended, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        for future in ended:
            document = future.result()["document"]
            if "error" in document:
                raise GyrotrackError(str(document["error"]["message"]), str(document["error"]["hint"]))
            for o in document["outcomes"]:
                score = math.nan if o["score"] is None else o["score"]
                done[o["kind"], o["effect"], o["number"]] = Outcome(
                    **(o | {"named": tuple(o["named"]), "score": score})
                )
        keep([done[item] for item in wanted if item in done], len(wanted))
    return replace(empty, outcomes=tuple(done[item] for item in wanted))


def _table(found: Certificate, fit_id: str) -> str:
    lines = [
        *textwrap.wrap(found.sentence, _WIDTH),
        "",
        f"fit {fit_id}, verdict: {found.verdict.replace('_', ' ')}",
    ]
    lines += ["", "simulated recordings, by the simulated effect, with their answers:"]
    for effect, count, answers in found.rows:
        lines += [f"  {effect}, {count} recordings"]
        lines += textwrap.wrap(answers, _WIDTH, initial_indent="    ", subsequent_indent="    ")
    covered = found.coverage("truth" if found.right_first is not None else "null")
    if covered:
        lines += ["", "share of 95 % intervals that contain the simulated value:"]
        lines += [f"  {found.in_words(name):<60}{100 * share:>5.0f} %" for name, share in covered.items()]
    return "\n".join(lines)
