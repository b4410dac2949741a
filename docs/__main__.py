"""`python -m docs`: the documentation site, in `site/`.

`--notebooks 1` runs the first notebook alone, and `--scenes 1` shows one scene in the gallery.
"""

import argparse

from docs.builder import build

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m docs", description=__doc__)
    for name in ("notebooks", "scenes"):
        parser.add_argument(f"--{name}", type=int, help=f"{name}, from the first; all by default")
    build(**vars(parser.parse_args()))
