"""The flags by which XLA compiles in the least time, of those that the installed XLA knows.

XLA ends a process without a word where a flag is unknown, and its flags change from version to
version. So a process of its own, this file, asks for them one by one and prints those to set.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from mishutter._core.compiling import known_options  # of this checkout

# One thread each, because there is a process a core.
QUICKEST = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_multi_thread_eigen": False,
    "xla_cpu_parallel_codegen_split_count": 1,
    "xla_cpu_use_fusion_emitters": False,
}

if __name__ == "__main__":
    known = known_options(QUICKEST)
    sys.stdout.write(" ".join(f"--{name}={str(value).lower()}" for name, value in known.items()))
