"""The live page: a scene whose design follows the hand."""

from mishutter.explore.server import serve as serve
from mishutter.explore.session import beginning as beginning
