"""The plain way: Radau, finite differences, SciPy's least squares or lmfit, every sample a residual.

Same data, same noise (white), same free phases and camera artefacts, same well-scaled variables as the program's:
torque T1 and curvature K at 400 rad/s in place of d and f.

The angles reach 2e4 rad and are known to 1e-3. At rtol 1e-8 the error of the integration is a fair share of that, and
its least squares end 1.8 above the true minimum of chi2; at 1e-10 they end within 0.001 of it.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from fitting.inference._case_data import camera_columns

REFERENCE = 400.0
# a2, b1, b2, T1, K, g, omega_r, omega_c
SCALE = np.array([1e-10, 3e-6, 8e-7, 1e-4, 1e-5, 1.0, 900.0, 5.0])


class Baseline:
    """Residuals of the reduced model on one record."""

    def __init__(self, record, rtol=1e-10, method="Radau") -> None:
        self.record, self.rtol, self.method = record, rtol, method
        self.calls = 0
        times = [record.casing.time, *(w.time for w in record.rotor)]
        self.every, self.where = np.unique(np.concatenate(times), return_inverse=True)
        self.ends = np.cumsum([len(t) for t in times])[:-1]
        ones = np.ones((len(record.casing), 1))
        self.free = np.linalg.qr(np.concatenate([ones, camera_columns(record.casing)], axis=1))[0]

    def integrate(self, x):
        a2, b1, b2, t1, curvature, g, wr, wc = x * SCALE
        g = g if abs(g - 1) > 3e-3 else 1 + 3e-3
        i_r, i_c = self.record.I_rotor, self.record.I_casing

        def rates(t, y):
            d = (y[0] - y[1]) / REFERENCE
            tau = t1 * d + curvature * (np.sign(d) * abs(d) ** g - d) / (g - 1)
            return [
                (-tau - a2 * y[0] * abs(y[0])) / i_r,
                (tau - b1 * np.sign(y[1]) - b2 * y[1]) / i_c,
                y[0],
                y[1],
            ]

        span = self.every[0], self.every[-1]
        solved = solve_ivp(
            rates, span, [wr, wc, 0, 0], method=self.method, rtol=self.rtol, atol=1e-8, t_eval=self.every
        )
        if not solved.success:
            return None
        return solved.y

    def residuals(self, x):
        self.calls += 1
        y = self.integrate(np.asarray(x))
        parts = []
        for k, where in enumerate(np.split(self.where, self.ends)):
            samples = self.record.casing if k == 0 else self.record.rotor[k - 1]
            model = np.full(len(where), 1e6) if y is None else y[3 if k == 0 else 2][where]
            r = (model - samples.value) / samples.sigma
            # the phase of each run is free, and so are the casing's camera artefacts
            parts.append(r - (self.free @ (self.free.T @ r) if k == 0 else r.mean()))
        return np.concatenate(parts)

    def scipy(self, start):
        """Return variables and chi2 by SciPy's trust-region least squares."""
        found = least_squares(self.residuals, start, method="trf", diff_step=1e-6, ftol=1e-10, xtol=1e-10)
        return found.x * SCALE, 2 * found.cost

    def paper(self, start, most=60):
        """Return variables, chi2 and how it ended, in the paper's own a2, b1, b2, d, f, g and start speeds.

        The valley of (d, f, g) is curved: from a start a factor of two off the search creeps along it, or sticks at
        a bound.
        """
        size = np.abs(start)

        def residuals(x):
            a2, b1, b2, d, f, g, wr, wc = x * size
            return self.residuals(np.array([a2, b1, b2, *straight(d, f, g), g, wr, wc]) / SCALE)

        least = np.array([0, 0, 0, 0, 0, 0.3, -np.inf, -np.inf]) / size
        most_of_g = np.array([*[np.inf] * 5, 1.4, np.inf, np.inf]) / size
        found = least_squares(
            residuals,
            np.ones(8),
            bounds=(least, most_of_g),
            diff_step=1e-6,
            ftol=1e-10,
            xtol=1e-10,
            max_nfev=most,
        )
        return found.x * size, 2 * found.cost, found.message

    def lmfit(self, start):
        """Return variables and chi2 by lmfit's Levenberg-Marquardt, finite differences too."""
        import lmfit

        names = ["a2", "b1", "b2", "T1", "K", "g", "wr", "wc"]
        par = lmfit.Parameters()
        for name, value in zip(names, start, strict=True):
            par.add(name, value=float(value))
        found = lmfit.minimize(
            lambda p: self.residuals([p[n].value for n in names]),
            par,
            method="leastsq",
            ftol=1e-10,
            xtol=1e-10,
            epsfcn=1e-12,
        )
        return np.array([found.params[n].value for n in names]) * SCALE, float(found.chisqr)


def straight(d: float, f: float, g: float) -> tuple[float, float]:
    """Return T1 and K."""
    return d * REFERENCE + f * REFERENCE**g, (g - 1) * f * REFERENCE**g
