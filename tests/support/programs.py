"""The programs that JAX compiles."""

from contextlib import contextmanager

import jax


@contextmanager
def compiled_programs(caplog):
    """A list that holds, in the end, the name of each program that was compiled meanwhile."""
    names, before = [], len(caplog.records)
    with jax.log_compiles():
        yield names
    messages = [record.message for record in caplog.records[before:]]
    names += [message.split()[1] for message in messages if message.startswith("Compiling")]
