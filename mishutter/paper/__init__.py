"""The published figures, and what was met of them."""

from mishutter.paper.reproduction import reproduce as reproduce
