"""Videos of a test pattern, as FFmpeg writes them."""

import subprocess

import pytest

ROWS, COLUMNS = 96, 160


def film(path, *options, num_frames=12):
    """A video, or a picture, of the first frames of the pattern; skips where there is no FFmpeg."""
    exe = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    pattern = ["-f", "lavfi", "-i", f"testsrc2=size={COLUMNS}x{ROWS}:rate=25"]
    command = [exe, "-v", "error", *pattern, "-frames:v", str(num_frames), *options, str(path)]
    subprocess.run(command, check=True)
    return path


def cut(path):
    """The same file without its last two fifths."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])
    return path
