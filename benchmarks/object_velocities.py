"""Are the errors that are stated of found velocities honest, however long frames are?

Two ellipses of photographs move along the rows before a third photograph, as in
`benchmarks/strips.py`; four stills of long, unlike and short exposures are taken of each, and
things are found blindly. What `results/object_velocities.json` holds already is not done again.
"""

import json
import sys

import jax
import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.strips import FASTEST, layered, stills
from mishutter.decoding.objects.finding import found_in
from mishutter.decoding.objects.readout import Readout
from mishutter.decoding.objects.restored import knowledge_of, stills_of
from mishutter.decoding.rolling import GLOBAL

ORDERS = ((20, 20, 20, 20), (20, 20, 20, 6), (20, 3, 20, 3), (4, 4, 4, 4))
"""Exposures of stills, ms."""
NUM_SCENES = 5
MATCHED = 60.0
"""Difference of a velocity that is found from that of a thing up to which it is of it; px/s."""
TEXT = """## Stated errors of found velocities

Four stills at 50/s, 1e5 e-/s and 8 e-, of {count} scenes of two ellipses of photographs at 315 to
855 px/s before another photograph, found blindly: the error of their velocities, px/s, the error
that is stated, in the median of both, and the former over the latter.

{table}"""


def measured(seed: int, order: tuple[int, ...]) -> dict:
    """Errors of the velocities found in one scene, and those that are stated; px/s."""
    each, frames = layered(seed), stills(order)
    scene = each.wide(FASTEST)
    key = jax.random.key(seed)
    taken = np.asarray(ms.simulate_frames(each.layers, scene, frames, key=key))[..., 0]
    grey, _ = stills_of(taken[None], scene, frames, Readout.of(GLOBAL, "rows"))
    found = found_in(grey, known=knowledge_of(scene, grey, in_plane=False)).things
    off, stated = [], []
    for speed in each.speeds:
        near = min(found, key=lambda one: abs(one.velocity[1] + speed), default=None)
        if near is not None and abs(near.velocity[1] + speed) < MATCHED:
            off.append(float(near.velocity[1] + speed))
            stated.append(float(np.sqrt(near.covariance[1, 1])))
    missed = len(each.speeds) - len(off)
    return {"seed": seed, "order": list(order), "off": off, "stated": stated, "missed": missed}


def table_of(rows: list[dict]) -> list[dict]:
    """A row for each burst, and one for all."""
    table = []
    groups = {f"{', '.join(map(str, order))} ms": [list(order)] for order in ORDERS}
    for name, orders in (groups | {"all": [list(order) for order in ORDERS]}).items():
        mine = [row for row in rows if row["order"] in orders]
        off, stated = (np.concatenate([row[key] for row in mine]) for key in ("off", "stated"))
        scores = off / stated
        table.append(
            {
                "four stills": name,
                "found": f"{off.size} of {off.size + sum(row['missed'] for row in mine)}",
                "off": f"{np.median(np.abs(off)):.2f}",
                "stated": f"{np.median(stated):.2f}",
                "root mean square": f"{np.sqrt(np.mean(scores**2)):.2f}",
                "greatest": f"{np.max(np.abs(scores)):.1f}",
            }
        )
    return table


def main(count: int = NUM_SCENES) -> None:
    """Measure scene by scene, store each, and print."""
    jax.config.update("jax_enable_x64", True)
    path = harness.RESULTS / "object_velocities.json"
    rows = json.loads(path.read_text("utf-8"))["rows"] if path.exists() else []
    for seed in range(count):
        for order in ORDERS:
            if all((row["seed"], row["order"]) != (seed, list(order)) for row in rows):
                rows.append(measured(seed, order))
                harness.write("object_velocities", rows)
                print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    table = table_of(rows)
    text = TEXT.format(count=count, table=harness.table(table, list(table[0])))
    harness.section("object_velocities", text)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
