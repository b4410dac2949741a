"""The classes of the package that are final."""


def final_classes_in(package, base):
    """Classes that the modules of a package define, once those are imported, without interfaces."""
    found, left = set(), [base]
    while left:
        subclasses = left.pop().__subclasses__()
        left += subclasses
        found |= {c for c in subclasses if c.__module__.startswith(f"{package.__name__}.")}
    return {c for c in found if not c.__name__.startswith(("Abstract", "_"))}


def final_classes(module, base):
    classes = {v for v in vars(module).values() if isinstance(v, type) and issubclass(v, base)}
    return {c for c in classes if not c.__name__.startswith("Abstract")}
