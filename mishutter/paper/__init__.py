"""The published figures, and what was met of them."""
