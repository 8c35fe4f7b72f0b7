import os
import sys
from pathlib import Path

# the matrices of a fit are small: several BLAS threads would spend ten times the work waiting for each other
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# twobody.py and nist.py stand beside the tests that use them
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent / "simulation"))
