"""The command line: arguments in, public functions called, text and files out."""

from mishutter.cli.app import main as main
