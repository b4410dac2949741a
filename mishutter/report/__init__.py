"""Verdicts, pictures and documents of designs, comparisons and sweeps.

Pictures are imported from here. Only a function that draws imports matplotlib.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
