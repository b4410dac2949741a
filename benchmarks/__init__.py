"""Run time against error: each script answers one question, runs alone and stores every sample."""

import sys
from pathlib import Path

# The references that errors are measured against are those of the tests.
sys.path.append(str(Path(__file__).parents[1] / "tests"))
