"""The classes of the package that are final."""


def final_classes(module, base):
    classes = {v for v in vars(module).values() if isinstance(v, type) and issubclass(v, base)}
    return {c for c in classes if not c.__name__.startswith("Abstract")}
