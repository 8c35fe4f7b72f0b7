"""Fits of simulated recordings that several tests use, each computed once for all processes."""

import hashlib
import os
import pickle
from functools import lru_cache, wraps
from inspect import signature
from pathlib import Path
from unittest.mock import patch

import numpy as np
import twobody
from filelock import FileLock
from scipy.integrate import solve_ivp

from fitting import REDUCED, Model, diagnose, fit, make_record
from fitting.discovery import _select
from fitting.discovery._select import applicable_effects as every
from fitting.discovery._select import rank
from fitting.inference._case_data import CaseData

HIDDEN = {
    "nothing": twobody.Hidden(),
    "step": twobody.Hidden(jump=(88.0, -1e-6)),
    "drag": twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -1e-6 * (wc / 100) ** 2),
}


def shared(function):
    """Compute the results of a function of numbers and names once for all processes of pytest-xdist."""

    @lru_cache(maxsize=64)
    def of(settings):
        key = repr((function.__module__, function.__name__, settings))
        path = Path(os.environ["GYROTRACK_TEST_SHARED"], hashlib.sha256(key.encode()).hexdigest())
        with FileLock(f"{path}.lock"):
            if not path.exists():
                path.write_bytes(pickle.dumps(function(**dict(settings))))
        return pickle.loads(path.read_bytes())  # noqa: S301 - the tests' own file

    @wraps(function)
    def result(*args, **settings):
        given = signature(function).bind(*args, **settings)
        given.apply_defaults()
        return of(tuple(given.arguments.items()))

    return result


@shared
def data(seed=0, ou=0.0, ou_time=1.0, hidden="nothing", quantity="angle", few=False):
    """Return a case of the paper's cameras, or (`few`) of angles with the same information in fewer frames."""
    motion = twobody.simulate(seed=seed, ou=ou, ou_time=ou_time, hidden=HIDDEN[hidden])
    sigma = 1e-3 if quantity == "angle" else 0.05
    cameras = twobody.FEWER_FRAMES if few else twobody.Cameras(quantity=quantity, sigma=sigma)
    found = CaseData.of(make_record(**twobody.film(motion, seed=seed, cameras=cameras)))
    found.whitened(found.z)  # the estimates of the noise, which cost more than a fit, are kept in the file
    return found


@shared
def fitted(seed=0, ou=0.0, ou_time=1.0, hidden="nothing", quantity="angle", few=False):
    return fit(Model.of(REDUCED), [data(seed, ou, ou_time, hidden, quantity, few)])


@shared
def wheel(drag=4e-7):
    """Fit friction and viscous drag to a wheel of 2 g m2, 60 rad/s at first, that a quadratic drag slows down too."""
    time, inertia = np.linspace(0.0, 30.0, 1200), 2e-3
    done = solve_ivp(
        lambda _, y: [y[1], -(1e-3 + 2e-5 * y[1] + drag * y[1] ** 2) / inertia], (0, 30), [0.0, 60.0],
        t_eval=time, rtol=1e-11, atol=1e-11, method="DOP853",
    )  # fmt: skip
    angle = done.y[0] + 1e-3 * np.random.default_rng(0).standard_normal(len(time))
    samples = (time, angle, np.full(len(time), 1e-3))
    record = make_record(casing=samples, rotor=[], I_rotor=1.0, I_casing=inertia, single=True)
    return fit(Model.of(["touchpoint.constant", "casing.air.linear"]), [CaseData.of(record)])


@shared
def searched(drag=4e-7):
    """Return the fit of `wheel`, its candidates and its diagnosis."""
    base = wheel(drag)
    # the refits of these two take three quarters of the time
    slow = {"casing.brake.eddy", "casing.seal.cooling"}
    with patch.object(_select, "applicable_effects", lambda *x: [e for e in every(*x) if e.name not in slow]):
        candidates = rank(base)
    return base, candidates, diagnose(base, candidates=candidates)


def pulls(result, true):
    """Return (estimate - truth) / standard error by name."""
    return {k: (e.value - true[k]) / e.stderr for k, e in result.estimates.items() if k in true}


def case(par, seed, label, start=(900.0, 5.0), hidden=None, ou=0.0, cameras=twobody.FEWER_FRAMES):
    """Return a case with the paper's parameters but those of `par`, and what is hidden in it."""
    motion = twobody.simulate({**twobody.PAPER, **par}, start=start, seed=seed, hidden=hidden, ou=ou)
    film = twobody.film(motion, seed=seed, label=label, cameras=cameras)
    return CaseData.of(make_record(**film))
