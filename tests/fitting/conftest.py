import sys
from pathlib import Path

# twobody.py, cases.py, nist.py and dynamics/reference.py stand beside the tests that use them
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent / "dynamics"))
