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


def pieces(plane, differences, rows_per_strip, tile):
    """Strips of a plane `(rows, columns, channels)`, or tiles of it, each packed."""
    height, width = tile or (rows_per_strip, plane.shape[1])
    if tile:
        spare = [(0, -size % side) for size, side in zip(plane.shape, tile, strict=False)]
        plane = np.pad(plane, [*spare, (0, 0)])
    for top in range(0, plane.shape[0], height):
        for left in range(0, plane.shape[1], width):
            stored = plane[top : top + height, left : left + width].astype(">u2")
            if differences:
                stored[:, 1:] = stored[:, 1:] - stored[:, :-1]
            yield packed(stored.tobytes())


def write_packed_tiff(path, coded, *, differences, rows_per_strip=16, separate=False, tile=None):
    """Write uint16 `(rows, columns, 3)`, big-endian, with or without differences.

    In strips or in tiles of `(rows, columns)`, the colours together or in planes of their own.
    """
    rows, columns, channels = coded.shape
    planes = np.split(coded, 3, axis=2) if separate else [coded]
    strips = [x for plane in planes for x in pieces(plane, differences, rows_per_strip, tile)]
    count = len(strips)
    entries = 12 if tile else 11
    lists = 8 + 2 + 12 * entries + 4
    first = lists + 6 + 8 * count
    offsets = first + np.cumsum([0, *map(len, strips)])[:-1]
    fields = [
        (256, 4, 1, columns),
        (257, 4, 1, rows),
        (258, 3, 3, lists),
        (259, 4, 1, 5),
        (262, 4, 1, 2),
        (277, 4, 1, channels),
        (284, 4, 1, 2 if separate else 1),
        (317, 4, 1, 2 if differences else 1),
    ]
    places, sizes = (4, count, lists + 6), (4, count, lists + 6 + 4 * count)
    if tile:
        fields += [(322, 4, 1, tile[1]), (323, 4, 1, tile[0]), (324, *places), (325, *sizes)]
    else:
        fields += [(273, *places), (278, 4, 1, rows_per_strip), (279, *sizes)]
    body = struct.pack(">2sHIH", b"MM", 42, 8, entries)
    body += b"".join(struct.pack(">HHII", *field) for field in sorted(fields))
    body += struct.pack(">I", 0)
    body += struct.pack(">3H", 16, 16, 16)
    body += struct.pack(f">{2 * count}I", *offsets, *map(len, strips))
    path.write_bytes(body + b"".join(strips))
