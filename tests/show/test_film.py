"""Films of animations: what ffmpeg is given, what is said without it, and a real file where it is installed."""

import json
import subprocess
import sys

import numpy as np
import pytest
from robots import load

from ik_toolkit.errors import InvalidOption, MissingExtra
from ik_toolkit.show.picture import encoder
from ik_toolkit.show.scene import view

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")
pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")

SIZE = (61, 40)
# Stands for ffmpeg: notes what it was given instead of encoding it.
STAND_IN = """#!{python}
import json, sys
data = sys.stdin.buffer.read()
if {fails}:
    sys.exit("Unknown encoder 'libx264'")
open(sys.argv[-1], "w").write(json.dumps([sys.argv[1:], len(data), sum(data[:{picture}]), sum(data[-{picture}:])]))
"""


@pytest.fixture
def scene():
    made = view(load("planar_2r"))
    made.animate(np.linspace([0.0, 0.0], [1.0, 0.5], 31), fps=10.0)
    return made


@pytest.fixture
def only(tmp_path, monkeypatch):
    """Let the PATH be one folder, with a program called ffmpeg or without, and imageio-ffmpeg not be installed."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)

    def put(fails):
        program = folder / "ffmpeg"
        program.write_text(STAND_IN.format(python=sys.executable, fails=fails, picture=3 * SIZE[0] * SIZE[1]))
        program.chmod(0o755)

    return put


def test_a_film_has_every_picture_in_its_own_time(scene, only, tmp_path):
    only(fails=False)
    words, count, first, last = json.loads(scene.record(tmp_path / "a.mp4", SIZE, pictures=4).read_text())
    given = dict(zip(words[1:-1:2], words[2::2], strict=False))
    assert given["-s"] == "61x40" and float(given["-r"]) == 1.0 and given["-c:v"] == "libx264"  # 3 s in 3 steps
    # The last picture stays for 1.5 s, rounded to whole pictures.
    assert count == 3 * SIZE[0] * SIZE[1] * (4 + 1) and first != last


def test_without_ffmpeg_it_is_said_what_to_install_and_nothing_is_written(scene, only, tmp_path):
    with pytest.raises(MissingExtra, match="imageio-ffmpeg is not installed; run: pip install imageio-ffmpeg"):
        scene.record(tmp_path / "a.mp4", SIZE, pictures=4)
    only(fails=True)
    with pytest.raises(InvalidOption, match=r"could not write the film: Unknown encoder .libx264.; a \.gif needs"):
        scene.record(tmp_path / "a.mp4", SIZE, pictures=4)
    with pytest.raises(InvalidOption, match="there is no folder"):
        scene.record(tmp_path / "no" / "a.mp4", SIZE, pictures=4)
    assert not (tmp_path / "a.mp4").exists()


def test_a_real_film_can_be_read(scene, tmp_path):
    try:
        ffmpeg = encoder()
    except MissingExtra:
        pytest.skip("ffmpeg is not installed")
    film = scene.record(tmp_path / "a.mp4", SIZE, pictures=4)
    read = [ffmpeg, "-i", str(film), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(read, capture_output=True, check=True)
    assert b"h264" in done.stderr and len(done.stdout) == 3 * 62 * 40 * 5
