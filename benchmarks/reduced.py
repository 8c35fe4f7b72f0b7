"""The numbers of the simulated recordings of these benchmarks; importing this limits linear algebra to one thread."""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # before NumPy is imported

REDUCED = {
    "rotor.air.quadratic.a2": 1.0e-10,
    "touchpoint.constant.b1": 2.9e-6,
    "casing.air.linear.b2": 8.3e-7,
    "bearing.linear.d": 1.6e-7,
    "bearing.power.f": 1.26e-8,
    "bearing.power.g": 1.32,
}
"""Parameters of the reduced model, SI units."""
INERTIA = {"inertia_rotor": 5.54e-5, "inertia_casing": 2.06e-5}
"""Moments of inertia [kg m2]."""
