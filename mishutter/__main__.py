"""`python -m mishutter`, and the command `mishutter`."""

import os
import signal
import sys


def main() -> int:
    """Runs the command line; returns the exit code.

    Its import takes a second. An interrupt in that time ends the process at once: there is nothing
    to save, and an error would come out of the middle of a library's import as any other error.
    """
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    from mishutter.cli.app import main as command

    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, before)
    return command()


if __name__ == "__main__":
    sys.exit(main())
