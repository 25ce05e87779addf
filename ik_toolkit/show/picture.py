"""A still picture of a scene without a browser: triangles are rendered in numpy, lines and text are drawn by Pillow.

A notebook shows it where the scene's script cannot run: before the notebook is opened, in a preview, or if it is not trusted.
"""

import importlib.util
import io
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, MissingExtra
from ..style import GREY, MUTED
from .body import DrawnShape
from .live_page import normals
from .meshcat_server import Cloud, Window
from .plots import charts
from .scene_state import css


class _Layer(NamedTuple):
    """A rendered image: for each pixel the inverse depth (H * W,) [1/m], 0 where nothing is drawn, and the colour (H * W, 3)."""

    near: np.ndarray
    color: np.ndarray


class _Pencil:
    """Draws on an image; sizes of text are in points, all other lengths in its pixels."""

    sharp = 2  # The image is drawn this many times larger than the final picture, which smooths edges.

    def __init__(self, size: tuple[int, int]) -> None:
        """Make an image (W, H). Raises MissingExtra without matplotlib, whose font is used, and with which Pillow comes."""
        found = importlib.util.find_spec("matplotlib")
        if found is None or found.origin is None:
            raise MissingExtra("matplotlib", "plots")
        from PIL import Image, ImageDraw, ImageFont

        self.fonts, self.load = Path(found.origin).parent / "mpl-data" / "fonts" / "ttf", ImageFont.truetype
        self.image = Image.new("RGB", size, (243, 245, 248))
        self.draw = ImageDraw.Draw(self.image)

    def blend(self, color: np.ndarray, cover: np.ndarray) -> None:
        """Draw pixels over the picture: colours (H * W, 3) in 0..1, already multiplied by their opacity `cover` (H * W,)."""
        data = np.array(self.image).reshape(-1, 3)
        at = np.flatnonzero(cover)
        data[at] = np.round(255 * color[at] + (1.0 - cover[at, None]) * data[at])
        self.image.frombytes(data.tobytes())

    def ball(self, x: float, y: float, radius: float, fill: str) -> None:
        """Draw a disc around pixel x, y with a radius [px], in a CSS colour."""
        # half a pixel less, because Pillow adds the pixel in the middle
        radius = min(max(radius - 0.5, 0.5), self.image.width)
        self.draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill)

    def text(
        self, x: float, y: float, text: str, points: float, fill: str = "black", at: str = "lm", bold: bool = False
    ) -> float:
        """Write text at pixel x, y and return its width; at: which point of the text is put there, as Pillow names anchors."""
        font = self.load(str(self.fonts / f"DejaVuSans{'-Bold' if bold else ''}.ttf"), points / 0.72 * self.sharp)
        self.draw.text((x, y), text, fill, font, at)
        return font.getlength(text.replace("\n", " "))


def picture(window: Window, size: tuple[int, int] = (760, 460)) -> bytes:
    """Render a 3-D scene (Window, with its camera set) as the bytes of a PNG of a size [pixels]. Raises MissingExtra."""
    sharp = _Pencil.sharp
    W, H = sharp * size[0], sharp * size[1]
    pencil, curves = _Pencil((W, H)), window.about.get("curves")
    # The scene leaves room for the chart of errors at the right.
    camera = _Camera(window.about["camera"], W * (0.7 if curves else 1.0), H)
    for line in _grid(window.about["camera"]):
        seen = camera.project(line)
        if (seen[:, 2] > 0).all() and (np.abs(seen) < 100 * W).all():
            pencil.draw.line([*seen[:, :2].ravel()], "#b9c2cc", sharp)
    pencil.blend(*_filled(window, camera, W, H))

    def inside(points: np.ndarray) -> Iterator[tuple[int, float, float, float]]:
        seen = camera.project(points)
        for k in np.flatnonzero((seen > 0).all(axis=1) & (seen[:, :2] < (W, H)).all(axis=1)):
            # index, x, y, and how many pixels a metre is at that distance
            yield int(k), *seen[k, :2].tolist(), float(camera.scale * seen[k, 2])

    for path, cloud in window.objects.items():
        if isinstance(cloud, Cloud):
            T, words = window.pose(path), [css(color) for color in cloud.colors]
            for k, x, y, scale in inside(cloud.points @ T[:3, :3].T + T[:3, 3]):
                pencil.ball(x, y, 0.5 * cloud.size * scale, words[k])
    # The ball by which a target is dragged is drawn last, so that the robot does not hide it.
    for grip in window.about.get("drag", []):
        for _, x, y, scale in () if grip["turns"] else inside(window.pose(grip["name"])[None, :3, 3]):
            pencil.ball(x, y, grip["size"] * scale, css(grip["color"]))
    for path, text, down in window.about["names"]:
        for _, x, y, _ in inside(window.pose(path)[None, :3, 3]):
            pencil.text(x + 8 * sharp, y + down * sharp, text, 8, at="la")
    _words(pencil, window.about)
    if curves:
        _chart(pencil, curves)
    from PIL import Image  # Pillow is installed with matplotlib

    whole, packed = pencil.image.reduce(sharp), io.BytesIO()
    whole.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(packed, "png", optimize=True)
    return packed.getvalue()


def shapes_of(window: Window) -> dict[str, DrawnShape]:
    """Return the triangles drawn in a Window, by path, including copies."""
    found = {path: drawn for path, drawn in window.objects.items() if isinstance(drawn, DrawnShape)}
    for path, (source, color, opacity) in window.copies.items():
        if source in found:
            found[path] = replace(found[source], color=color, opacity=opacity)
    return found


class _Camera:
    """The viewer's camera: `turned` is the rotation from world to camera axes, `project` maps points [m] to pixels."""

    def __init__(self, aim: Any, width: float, height: float) -> None:
        """Aim the camera as `Window.about["camera"]` says, for a picture of a size [pixels]."""
        eye, to = np.array(aim[0], dtype=float), np.array(aim[1], dtype=float)
        back = (eye - to) / max(float(np.linalg.norm(eye - to)), 1e-12)
        right = np.cross((0.0, 0.0, 1.0) if abs(back[2]) < 0.9999 else (0.0, 1.0, 0.0), back)
        right /= np.linalg.norm(right)
        self.eye, self.turned = eye, np.array([right, np.cross(back, right), back])
        # The meshcat viewer's camera sees 75 degrees from top to bottom, so half the height is at 37.5 degrees.
        self.scale, self.middle = 0.5 * height / np.tan(np.radians(37.5)), (0.5 * width, 0.5 * height)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return pixels and inverse depth (N, 3) [px, px, 1/m] of world points (N, 3) [m]; inverse depth is 0 behind the camera."""
        x, y, z = self.turned @ (np.asarray(points, dtype=float) - self.eye).T
        near = np.where(-z > 1e-9, 1.0 / np.maximum(-z, 1e-9), 0.0)
        return np.stack([self.middle[0] + self.scale * x * near, self.middle[1] - self.scale * y * near, near], axis=1)


def _filled(window: Window, camera: _Camera, W: int, H: int) -> tuple[np.ndarray, np.ndarray]:
    """Render the triangles of a scene: colours (H * W, 3) times opacity, and opacity (H * W,)."""
    groups: dict[str, list[tuple[DrawnShape, np.ndarray]]] = {"": []}
    for path, shape in shapes_of(window).items():
        group = "" if shape.opacity >= 1.0 else path.partition("/")[0]
        groups.setdefault(group, []).append((shape, window.pose(path)))
    near, color = _layer(groups.pop(""), camera, W, H)
    cover = (near > 0).astype(float)
    for group in groups.values():
        layer = _layer(group, camera, W, H)
        # A translucent surface must be nearer by a little, so that one which coincides with a solid surface is hidden.
        at = np.flatnonzero(layer.near > 1.002 * near)
        share = group[0][0].opacity
        color[at] = share * layer.color[at] + (1.0 - share) * color[at]
        cover[at] = share + (1.0 - share) * cover[at]
    return color, cover


def _layer(shapes: list[tuple[DrawnShape, np.ndarray]], camera: _Camera, W: int, H: int) -> _Layer:
    """Render the triangles of shapes at their poses (4, 4); for each pixel the nearest one is visible."""
    light_from = np.array((-0.35, 0.55, 0.76))  # direction of the light in camera axes: right, up, towards the eye
    near, owner = np.zeros(H * W), np.full(H * W, -1)
    corners, tints = [np.zeros((0, 3, 3))], [np.zeros((0, 3, 3))]
    for shape, T in shapes:
        turn = camera.turned @ T[:3, :3]
        normal = normals(shape) @ turn.T
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        light = 0.52 + 0.48 * np.abs(0.5 + 0.5 * (normal @ light_from)) ** 1.5
        corners.append(camera.project(shape.vertices @ T[:3, :3].T + T[:3, 3])[shape.faces])
        tints.append((light[:, None] * np.array(shape.color))[shape.faces])
    P, tint = np.concatenate(corners), np.concatenate(tints)
    planes = _planes(P)
    keep = (P[:, :, 2] > 0).all(axis=1) & np.isfinite(planes).all(axis=(0, 2))
    P, tint, planes = P[keep], tint[keep], planes[:, keep]
    for faces, x, y in _covered(P, planes[:3], W, H):
        a, b, c = planes[3, faces].T
        pixel, depth = y * W + x, a + b * (x + 0.5) + c * (y + 0.5)
        np.maximum.at(near, pixel, depth)
        first = depth == near[pixel]
        owner[pixel[first]] = faces[first]
    pixel = np.flatnonzero(owner >= 0)
    color, faces, y, x = np.zeros((H * W, 3)), owner[pixel], pixel // W, pixel % W
    for k in range(3):
        a, b, c = planes[k, faces].T
        color[pixel] += (a + b * (x + 0.5) + c * (y + 0.5))[:, None] * tint[faces, k]
    return _Layer(near, np.clip(color, 0.0, 1.0))


def _planes(P: np.ndarray) -> np.ndarray:
    """Return coefficients (4, N, 3) of a + b x + c y [pixels] for triangles P (N, 3, 3): barycentric coordinates, inverse depth."""
    x, y = P[:, :, 0], P[:, :, 1]
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (y[:, 1] - y[:, 0]) * (x[:, 2] - x[:, 0])
    area = np.where(np.abs(area) < 1e-9, np.nan, area)  # a triangle seen from its edge covers no pixel
    shares = []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        a = x[:, i] * y[:, j] - x[:, j] * y[:, i]
        shares.append(np.stack([a, y[:, i] - y[:, j], x[:, j] - x[:, i]], axis=1) / area[:, None])
    return np.array([*shares, sum(P[:, k, 2, None] * shares[k] for k in range(3))])


def _covered(P: np.ndarray, shares: np.ndarray, W: int, H: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the pixels of triangles P (N, 3, 3) as arrays: triangle, x and y.

    In each row of pixels a triangle reaches from where all its barycentric coordinates, `shares` (3, N, 3), have become positive
    to where the first becomes negative.
    """
    low, high = (np.clip(np.floor(end(P[:, :, 1], axis=1) + 0.5), 0, H).astype(int) for end in (np.min, np.max))
    owner, y = _counted(high - low)
    y += low[owner]
    left, right = np.zeros(len(owner)), np.full(len(owner), float(W))
    for a, b, c in np.moveaxis(shares[:, owner], 2, 1):
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = -(a + c * (y + 0.5)) / b  # A side parallel to the row gives NaN, which `fmax` and `fmin` ignore.
        left, right = np.fmax(left, np.where(b > 0, ends, 0.0)), np.fmin(right, np.where(b < 0, ends, W))
    start = np.clip(np.ceil(left - 0.5), 0, W).astype(int)
    count = np.maximum(np.clip(np.ceil(right - 0.5), 0, W).astype(int) - start, 0)
    # Rows of pixels are handled in chunks of some two million pixels, to limit the memory.
    first = np.searchsorted(np.cumsum(count), np.arange(0, count.sum(), 2_000_000))
    for chunk in np.split(np.arange(len(count)), np.unique(first)[1:]):
        row, x = _counted(count[chunk])
        row = chunk[row]
        yield owner[row], x + start[row], y[row]


def _counted(count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each index k count[k] times, and the numbers 0, 1, ... of its repetitions."""
    which = np.repeat(np.arange(len(count)), count)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)


def _grid(aim: Any) -> list[np.ndarray]:
    """Return the lines (2, 3) [m] of the viewer's floor, ten cells to each side."""
    _, _, cell, floor = aim
    cell *= 0.5
    ends = [np.array([(k * cell, -10 * cell, floor), (k * cell, 10 * cell, floor)]) for k in range(-10, 11)]
    return [*ends, *(line[:, [1, 0, 2]] for line in ends)]


def _words(pencil: _Pencil, about: dict[str, Any]) -> None:
    """Write title, lines and legend into the upper left corner, as the page does."""
    sharp = pencil.sharp
    x, y = 16 * sharp, 22 * sharp
    pencil.text(x, y, about["title"], 11, bold=True)
    for line in about["lines"]:
        y += 17 * sharp
        pencil.text(x, y, line if len(line) <= 74 else f"{line[:72]}...", 8.5, MUTED)
    y += 18 * sharp
    for color, text in about["legend"]:
        side = 5 * sharp
        pencil.draw.rectangle((x, y - side, x + 2 * side, y + side), color if color[0] == "#" else GREY)
        x += 34 * sharp + pencil.text(x + 3 * side, y, text, 8)


def _chart(pencil: _Pencil, curves: Any) -> None:
    """Draw the errors of `Window.about["curves"]` on a logarithmic scale into the upper right corner.

    Each curve has a name, a colour, pairs of iteration and error [m], and words, which the page alone shows.
    """
    from PIL import Image

    (W, H), stream = pencil.image.size, io.BytesIO()
    scale = W / 7.6  # pixels per inch of the chart, if the whole picture is 7.6 inches wide
    with charts(1, 1, (0.3 * W / scale, 0.45 * H / scale)) as (figure, axis):
        for name, color, errors, _ in curves:
            steps, left = np.transpose(errors)
            axis.semilogy(steps, np.maximum(left, 1e-9), color=color, label=name)
        axis.set(xlabel="iteration", title="error [m]")
        axis.legend()
        figure.savefig(stream, format="png", dpi=scale)
    pencil.image.paste(Image.open(stream), (round(0.7 * W), 0))


# ------------------------------------------------------------------------------------------------------------------ films
def encoder() -> str:
    """Return the path of the program ffmpeg: that of the package imageio-ffmpeg or one on the PATH. Raises MissingExtra."""
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):  # RuntimeError means that the package is installed but has no program
        found = shutil.which("ffmpeg")
    if found is None:
        raise MissingExtra("imageio-ffmpeg", "mp4")
    return found


def film(ffmpeg: str, frames: Sequence[Any], lasts: np.ndarray) -> bytes:
    """Encode pictures (PIL) as an MP4 film (H.264), return its bytes. lasts (N,) [ms]: how long each is shown.

    All but the last are shown about equally long. Raises InvalidOption if ffmpeg fails, with what it says.
    """
    first, *_ = rgb = [frame.convert("RGB") for frame in frames]
    rate = 1000.0 / float(lasts[:-1].mean()) if len(lasts) > 1 else 1.0
    rgb += rgb[-1:] * max(0, round(float(lasts[-1]) / 1000.0 * rate) - 1)
    # A file is needed, not a pipe, because ffmpeg goes back to write the head of an MP4 file.
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "film.mp4"
        # The pixel format yuv420p needs an even width and height, so a row or column is added if necessary.
        even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"
        read = f"-y -loglevel error -f rawvideo -pix_fmt rgb24 -s {first.width}x{first.height} -r {rate:.6g} -i -"
        write = f"-vf {even} -c:v libx264 -pix_fmt yuv420p -movflags +faststart"
        words = [ffmpeg, *read.split(), *write.split(), str(made)]
        done = subprocess.run(words, input=b"".join(one.tobytes() for one in rgb), capture_output=True, check=False)
        if done.returncode or not made.is_file():
            said = done.stderr.decode(errors="replace").strip().splitlines() or [done.returncode]
            raise InvalidOption(f"ffmpeg could not write the film: {said[-1]}; a .gif needs no ffmpeg")
        return made.read_bytes()
