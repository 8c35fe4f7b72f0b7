"""Two recordings with a sinusoidal torque, of the same phase or of another phase in each."""

import math

import numpy as np
import twobody

from fitting import make_record

STRENGTH, RATE = 4e-6, 530.0
APART, ALIKE = (0.7, 3.3), (0.7, 0.7)
STARTS = ((900.0, 5.0), (740.0, 12.0))


def records(law, phases):
    """Return two recordings in which `law` (omega_c's angle, phase of the precession, phi) swings on the casing."""
    found = []
    for i, (phi, start) in enumerate(zip(phases, STARTS, strict=True)):
        plain = twobody.simulate(start=start, span=120.0, ou=5e-8, seed=i, step=0.01)
        turned = np.concatenate([[0.0], np.cumsum(0.01 * RATE / plain.speed[:-1, 0])])

        def casing(t, wr, wc, pr, pc, phi=phi, turned=turned):
            k = min(int(t / 0.01), len(turned) - 2)
            return STRENGTH * law(pc, turned[k] + (turned[k + 1] - turned[k]) * (t / 0.01 - k), phi)

        motion = twobody.simulate(
            start=start, span=120.0, hidden=twobody.Hidden(casing=casing), ou=5e-8, seed=i, step=0.01
        )
        cameras = twobody.Cameras(span=120.0, windows=(4.0, 50.0, 100.0))
        found.append(make_record(**twobody.film(motion, i, cameras, label=f"case{i + 1}")))
    return found


def unbalance(angle, turned, phi):
    return math.sin(angle - phi)


def precession(angle, turned, phi):
    return math.cos(turned + phi)
