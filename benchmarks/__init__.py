"""Run time against error: each script answers one question, runs alone and stores every sample."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))
"""The references that errors are measured against are those of the tests."""
