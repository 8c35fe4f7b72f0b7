"""What holds for every test: one thread for linear algebra, set before NumPy is imported."""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # matrices are small, and pytest-xdist already uses the cores
