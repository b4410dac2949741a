"""Footage from files: every frame shows for as long as its file says, or a line says why not."""

import re

import numpy as np
import pytest
from support.videos import COLUMNS, ROWS, cut, film

import mishutter as ms
from mishutter.pictures.images import PictureWarning

HALF = 0.011
MOVING = ms.ParabolicMotion(acceleration=9.0 / HALF**2, half_exposure=HALF)
SCENE = ms.Scene([0.0], photon_rate=4e5, read_noise=6.0)
SHUTTER = ms.TukeyShutter(0.6)
FRAMES = np.random.default_rng(5).integers(10, 250, (4, 6, 40, 3)).astype(np.uint8)


def as_light(coded):
    return (coded.astype(np.float32) / 255) ** np.float32(2.2)


def exposed(frames):
    return ms.simulate_capture(frames, SCENE, MOVING, SHUTTER)


def gif(path, durations):
    """An animation in few colours, so that its palette holds them."""
    from PIL import Image

    pages = [Image.fromarray(frame // 64 * 64) for frame in FRAMES[: len(durations)]]
    pages = [page.quantize(64) for page in pages]
    first, *others = pages
    first.save(path, save_all=True, append_images=others, duration=durations)
    return [np.asarray(page.convert("RGB")) for page in pages]


@pytest.mark.parametrize("durations", [(100, 700, 100, 100), (30, 20, 50)])
def test_frames_of_an_animation_show_for_as_long_as_it_says(tmp_path, durations):
    """A GIF is exposed as equal frames are, each of them repeated for its time."""
    pages = gif(tmp_path / "a.gif", list(durations))
    read = ms.read_frames(tmp_path / "a.gif")
    assert (read.num_frames, read.durations) == (len(durations), durations)
    repeated = [
        as_light(page)
        for page, time in zip(pages, durations, strict=True)
        for _ in range(time // 10)
    ]
    wanted = exposed(ms.Footage.of(repeated))
    np.testing.assert_allclose(exposed(read), wanted, atol=1e-6)


def test_an_animation_without_times_is_even(tmp_path):
    """Its frames show equally long."""
    pages = gif(tmp_path / "a.gif", [0, 0, 0])
    read = ms.read_frames(tmp_path / "a.gif")
    assert len({*read.durations}) == 1
    wanted = exposed(ms.Footage.of([as_light(page) for page in pages]))
    np.testing.assert_allclose(exposed(read), wanted, atol=1e-6)


def test_an_animation_with_a_frame_that_never_shows_is_refused(tmp_path):
    """A time of 0 among others is none, and programs that show it do not agree on another."""
    gif(tmp_path / "a.gif", [40, 0, 70])
    with pytest.raises(ValueError, match=r"whole video; got .*a\.gif': frame 1 shows for no time"):
        ms.read_frames(tmp_path / "a.gif")


@pytest.mark.parametrize(
    ("durations", "line"),
    [
        ((1.0, 2.0), "`Footage(durations=...)` must be 3, one a frame; got shape (2,)"),
        ((1.0, -2.0, 3.0), "`Footage(durations=...)` must be above 0; got -2.0"),
        ((1.0, np.nan, 3.0), "`Footage(durations=...)` must be finite; got"),
    ],
)
def test_durations_that_are_none(durations, line):
    """There is one for each frame, above 0."""
    with pytest.raises(ValueError, match=re.escape(line)):
        ms.Footage(list(as_light(FRAMES[:3])), 3, durations=durations)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("suffix", [".m4v", ".mpg", ".ts", ".wmv", ".mp4", ".avi", ".mkv"])
def test_every_kind_of_video_is_read(tmp_path, suffix):
    """All go to FFmpeg, which knows them by their contents; the frames are those of the video."""
    read = ms.read_frames(film(tmp_path / f"a{suffix}", "-pix_fmt", "yuv420p"))
    frames = list(read.frames)
    assert (read.num_frames, len(frames)) == (12, 12)
    assert {frame.shape for frame in frames} == {(ROWS, COLUMNS, 3)}
    wanted = ms.read_picture(film(tmp_path / "a.png", num_frames=1)).light
    assert np.abs(frames[0] - wanted).mean() < 0.05 < np.ptp(wanted, axis=(0, 1)).min()


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize(("suffix", "more"), [(".mkv", 6), (".mp4", 3)])
def test_a_video_of_uneven_frames_is_shown_in_its_times(tmp_path, suffix, more):
    """Frames that last a twenty-fifth of a second, but for one that lasts longer, show so."""
    late = rf"setpts=if(gt(N\,2)\,N+{more}\,N)/25/TB"
    options = ("-vf", late, "-fps_mode", "vfr", "-pix_fmt", "yuv420p")
    read = ms.read_frames(film(tmp_path / f"a{suffix}", *options, num_frames=6))
    assert read.durations == (1, 1, 1 + more, 1, 1, 1)
    assert len(list(read.frames)) == 6


@pytest.mark.parametrize(
    ("suffix", "reason"),
    [(".mp4", "moov atom not found"), (".avi", "corrupt input packet"), (".mpg", "damaged at")],
)
def test_a_video_that_was_cut_is_refused_with_the_reason(tmp_path, suffix, reason):
    """The line says what is wrong, without what FFmpeg says of itself."""
    path = cut(film(tmp_path / f"a{suffix}", "-pix_fmt", "yuv420p"))
    with pytest.raises(ValueError, match="must name a whole video; got") as caught:
        ms.read_frames(path)
    said = str(caught.value).partition("': ")[2]
    assert reason in said
    assert len(said) < 60


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_video_of_which_a_part_is_read_says_so(tmp_path):
    """Where FFmpeg ends early and finds nothing wrong, a warning says how many frames there are."""
    path = cut(film(tmp_path / "a.mkv", "-pix_fmt", "yuv420p"))
    with pytest.warns(PictureWarning, match=r"\d+ frames are read, and FFmpeg says: File ended"):
        read = ms.read_frames(path)
    assert 0 < read.num_frames < 12


def test_a_file_that_is_no_video_is_not_given_to_ffmpeg(tmp_path):
    """It reads single pictures too, and some of them wrongly."""
    (tmp_path / "a.fits").write_bytes(b"SIMPLE  =")
    with pytest.raises(ValueError, match=r"a folder of pictures or a video \(3gp, .*got '/"):
        ms.read_frames(tmp_path / "a.fits")


def test_pictures_of_a_folder_have_one_white(tmp_path):
    """It is told of all, in the order of their numbers; untold, one warning stands for all."""
    import tifffile

    deep = FRAMES.astype(np.uint16) * 16 + 3
    for number, frame in enumerate(deep):
        tifffile.imwrite(tmp_path / f"{number + 8}.tif", frame, photometric="rgb")  # 8, 9, 10
    read = ms.read_frames(tmp_path, white=4095, linear=True)
    np.testing.assert_allclose(list(read.frames), deep / 4095, atol=1e-6)
    with pytest.warns(PictureWarning, match="12 bits in 16") as warned:
        list(ms.read_frames(tmp_path).frames)
    assert len(warned) == 1
