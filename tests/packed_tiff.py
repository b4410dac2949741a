"""A writer of 16-bit RGB TIFFs under LZW, after section 13 of TIFF 6.0, to test the reader."""

import struct

import numpy as np


def packed(data):
    """Bytes under TIFF's LZW."""
    out, start = [], {bytes([i]): i for i in range(256)}
    table, width, known = dict(start), 9, b""
    out.append(f"{256:09b}")
    free = 258
    for byte in data:
        longer = known + bytes([byte])
        if longer in table:
            known = longer
            continue
        out.append(f"{table[known]:0{width}b}")
        table[longer], free, known = free, free + 1, bytes([byte])
        if free == 4095:
            out.append(f"{256:0{width}b}")
            table, width, free = dict(start), 9, 258
        elif free == 1 << width:
            width += 1
    out.append(f"{table[known]:0{width}b}")
    out.append(f"{257:0{width + (free + 1 == 1 << width)}b}")
    text = "".join(out)
    text += "0" * (-len(text) % 8)
    return int(text, 2).to_bytes(len(text) // 8, "big")


def write_packed_tiff(path, coded, *, differences, rows_per_strip):
    """Write uint16 `(rows, columns, 3)` in strips, big-endian, with or without differences."""
    rows, columns, channels = coded.shape
    stored = coded.astype(">u2")
    if differences:
        stored[:, 1:] = stored[:, 1:] - stored[:, :-1]
    strips = [
        packed(stored[r : r + rows_per_strip].tobytes()) for r in range(0, rows, rows_per_strip)
    ]
    count = len(strips)
    entries = 11
    lists = 8 + 2 + 12 * entries + 4
    first = lists + 6 + 8 * count
    offsets = first + np.cumsum([0, *map(len, strips)])[:-1]
    fields = [
        (256, 4, 1, columns),
        (257, 4, 1, rows),
        (258, 3, 3, lists),
        (259, 4, 1, 5),
        (262, 4, 1, 2),
        (273, 4, count, lists + 6),
        (277, 4, 1, channels),
        (278, 4, 1, rows_per_strip),
        (279, 4, count, lists + 6 + 4 * count),
        (284, 4, 1, 1),
        (317, 4, 1, 2 if differences else 1),
    ]
    body = struct.pack(">2sHIH", b"MM", 42, 8, entries)
    body += b"".join(struct.pack(">HHII", *field) for field in fields) + struct.pack(">I", 0)
    body += struct.pack(">3H", 16, 16, 16)
    body += struct.pack(f">{2 * count}I", *offsets, *map(len, strips))
    path.write_bytes(body + b"".join(strips))
