"""`python -m mishutter`."""

import sys

from mishutter.cli import main

if __name__ == "__main__":
    sys.exit(main())
