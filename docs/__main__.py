"""`python -m docs`: the documentation site, in `site/`; `--quick` runs one notebook of all."""

import sys

from docs.builder import build

if __name__ == "__main__":
    build(quick="--quick" in sys.argv[1:])
