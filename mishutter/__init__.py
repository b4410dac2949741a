"""Design of shutters for motion-invariant photography.

Begin with `optimise(example_scene())`; `python -m mishutter` is the command line.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.2.0"
