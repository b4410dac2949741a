"""`python -m docs`: the documentation site, in `site/`."""

from docs.builder import build

if __name__ == "__main__":
    build()
