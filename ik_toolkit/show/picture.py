"""A still picture of a scene without a browser: triangles are rendered in numpy, text and charts are drawn by matplotlib.

A notebook shows it where the scene's script cannot run: before the notebook is opened, in a preview, or if it is not trusted.
"""

import io
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, MissingExtra
from ..style import GREY, MUTED
from .body import DrawnShape
from .feed import ROOT
from .live_page import normals
from .meshcat_server import SHADE, Window
from .plots import drawing, literal_text


class _Layer(NamedTuple):
    """A rendered image: for each pixel the inverse depth (H, W) [1/m], 0 where nothing is drawn, and the colour (H, W, 3)."""

    near: np.ndarray
    color: np.ndarray


def picture(window: Window, size: tuple[int, int] = (760, 460)) -> bytes:
    """Draw a Window (whose camera is set) as a PNG of a size [pixels]. Raises MissingExtra without matplotlib."""
    import PIL.Image  # comes with matplotlib

    with drawing() as plt:
        width, height = size
        sky = (0.953, 0.961, 0.973)
        figure = plt.figure(figsize=(width / 100, height / 100), dpi=100, facecolor=sky)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, width), ylim=(height, 0))
        axes.axis("off")
        beside = 0.3 * width if window.about.get("curves") else 0.0  # taken by the chart
        camera = _Camera(window.about["camera"], width - beside, height)
        for line in _grid(window.about["camera"]):
            seen = camera.project(line)
            if (seen[:, 2] > 0).all():
                axes.plot(seen[:, 0], seen[:, 1], color="#b9c2cc", lw=0.6, zorder=0, clip_on=True)
        axes.imshow(_filled(window, camera, width, height), extent=(0, width, height, 0), interpolation="antialiased")
        for path, (points, colors, big) in clouds_of(window).items():
            T = window.pose(path)
            seen = camera.project(points @ T[:3, :3].T + T[:3, 3])
            at = (seen[:, 2] > 0) & (seen[:, :2] > 0).all(axis=1) & (seen[:, :2] < size).all(axis=1)
            axes.scatter(seen[at, 0], seen[at, 1], c=colors[at], s=(0.7 * big * camera.scale * seen[at, 2]) ** 2, lw=0)
        for grip in window.about.get("drag", []):  # As in the page, the robot does not hide a ball to drag.
            x, y, near = camera.project(window.pose(grip["name"])[None, :3, 3])[0]
            if near > 0 and not grip["turns"]:
                axes.plot(x, y, "o", color=grip["color"], ms=1.44 * grip["size"] * camera.scale * near)
        for path, text, down in window.about["names"]:
            x, y, near = camera.project(window.pose(path)[None, :3, 3])[0]
            if near > 0:
                axes.text(x + 8, y + down, text, fontsize=8, va="top", parse_math=False)
        _words(figure, axes, window.about, height)
        _chart(figure, window.about.get("curves"))
        packed = io.BytesIO()
        figure.savefig(packed, format="png", dpi=100, facecolor=sky)
    whole = PIL.Image.open(packed).convert("RGB")
    small = io.BytesIO()
    whole.quantize(256, PIL.Image.Quantize.FASTOCTREE, dither=PIL.Image.Dither.NONE).save(small, "png", optimize=True)
    return small.getvalue()


def shapes_of(window: Window) -> dict[str, DrawnShape]:
    """Return the triangles drawn in a Window, by path, including copies, with their original colours."""
    import umsgpack  # comes with meshcat

    found = {}
    for path, (data, material, _) in _read(window.objects):
        if "index" in data:
            vertices, faces = _array(data["attributes"]["position"], "<f4"), _array(data["index"], "<u4")
            found[path] = DrawnShape(vertices, faces, _color(material["color"], SHADE), material["opacity"])
    for path, packed in window.copies.items():
        told = umsgpack.unpackb(packed)
        source = found.get(told["source"].removeprefix(ROOT))
        if source is not None:
            found[path] = DrawnShape(source.vertices, source.faces, _color(told["color"]), told["opacity"])
    return found


def clouds_of(window: Window) -> dict[str, tuple[np.ndarray, np.ndarray, float]]:
    """Return the clouds of a Window by path: points (N, 3) [m], colours (N, 3) and size [m]."""
    found = {}
    for path, (data, material, kind) in _read(window.objects):
        if kind == "Points":
            points, colors = (_array(data["attributes"][key], "<f4") for key in ("position", "color"))
            found[path] = points, colors, material["size"]
    return found


def _read(objects: dict[str, bytes]) -> Iterator[tuple[str, tuple[Any, Any, str]]]:
    import umsgpack

    for path, packed in objects.items():
        told = umsgpack.unpackb(packed)["object"]
        yield path, (told["geometries"][0]["data"], told["materials"][0], told["object"]["type"])


def _array(told: Any, kind: str) -> np.ndarray:
    return np.frombuffer(told["array"].data, dtype=kind).reshape(-1, 3)


def _color(number: int, shade: float = 1.0) -> tuple[float, float, float]:
    r, g, b = (min(1.0, (number >> shift & 255) / 255 / shade) for shift in (16, 8, 0))
    return r, g, b


class _Camera:
    """The viewer's camera: `turned` is the rotation from world to camera axes, `project` maps points [m] to pixels."""

    def __init__(self, aim: Any, width: float, height: float) -> None:
        """Aim the camera as `Window.about["camera"]` says."""
        eye, to = np.array(aim[0], dtype=float), np.array(aim[1], dtype=float)
        back = (eye - to) / max(float(np.linalg.norm(eye - to)), 1e-12)
        right = np.cross((0.0, 0.0, 1.0) if abs(back[2]) < 0.9999 else (0.0, 1.0, 0.0), back)
        right /= np.linalg.norm(right)
        self.eye, self.turned = eye, np.array([right, np.cross(back, right), back])
        # The viewer's picture is 75 degrees high.
        self.scale, self.middle = 0.5 * height / np.tan(np.radians(37.5)), (0.5 * width, 0.5 * height)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return pixels and inverse depth (N, 3) [px, px, 1/m] of world points (N, 3) [m]; inverse depth is 0 behind the camera."""
        x, y, z = self.turned @ (np.asarray(points, dtype=float) - self.eye).T
        near = np.where(-z > 1e-9, 1.0 / np.maximum(-z, 1e-9), 0.0)
        return np.stack([self.middle[0] + self.scale * x * near, self.middle[1] - self.scale * y * near, near], axis=1)


def _filled(window: Window, camera: _Camera, width: int, height: int) -> np.ndarray:
    """Render the triangles of a scene to pixels (H, W, 4); copies and other translucent objects are blended over the rest."""
    groups: dict[str, list[tuple[DrawnShape, np.ndarray]]] = {"": []}
    for path, shape in shapes_of(window).items():
        group = "" if shape.opacity >= 1.0 else path.partition("/")[0]
        groups.setdefault(group, []).append((shape, window.pose(path)))
    near, color = _layer(groups.pop(""), camera, width, height)
    cover = (near > 0)[..., None].astype(float)
    for group in groups.values():
        layer = _layer(group, camera, width, height)
        before = layer.near > 1.002 * near  # a tolerance, so that surfaces that coincide with a solid one are hidden
        share = np.where(before, group[0][0].opacity, 0.0)[..., None]
        color, cover = share * layer.color + (1.0 - share) * color, share + (1.0 - share) * cover
    return np.dstack([color / np.maximum(cover, 1e-9), cover])


def _layer(shapes: list[tuple[DrawnShape, np.ndarray]], camera: _Camera, width: int, height: int) -> _Layer:
    """Render the triangles of shapes at their poses (4, 4); for each pixel the nearest one is visible."""
    sharp = 2  # supersampling in each direction, for smooth edges
    light_from = np.array((-0.35, 0.55, 0.76))  # in camera axes: right, up, towards the eye
    W, H = sharp * width, sharp * height
    near, owner = np.zeros(H * W), np.full(H * W, -1)
    corners, tints = [np.zeros((0, 3, 3))], [np.zeros((0, 3, 3))]
    for shape, T in shapes:
        seen = camera.project(shape.vertices @ T[:3, :3].T + T[:3, 3]) * (sharp, sharp, 1.0)
        turn = camera.turned @ T[:3, :3]
        normal = normals(shape) @ turn.T
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        light = 0.52 + 0.48 * np.abs(0.5 + 0.5 * (normal @ light_from)) ** 1.5
        corners.append(seen[shape.faces])
        tints.append((light[:, None] * np.array(shape.color))[shape.faces])
    P, tint = np.concatenate(corners), np.concatenate(tints)
    keep = (P[:, :, 2] > 0).all(axis=1)
    P, tint = P[keep], tint[keep]
    planes = _planes(P)
    for faces, pixel in _candidates(P, W, H):
        for k in range(3):  # all three barycentric coordinates must be positive; excluded pixels are not tested again
            at = _plane(planes[k], faces, pixel, W) >= 0.0
            faces, pixel = faces[at], pixel[at]
        depth = _plane(planes[3], faces, pixel, W)
        at = depth > near[pixel]
        faces, pixel, depth = faces[at], pixel[at], depth[at]
        order = np.argsort(depth, kind="stable")  # The nearest candidate of a pixel is written last.
        near[pixel[order]], owner[pixel[order]] = depth[order], faces[order]
    pixel = np.flatnonzero(owner >= 0)
    color, faces = np.zeros((H * W, 3), dtype=np.float32), owner[pixel]
    for k in range(3):
        color[pixel] += _plane(planes[k], faces, pixel, W)[:, None] * tint[faces, k]
    return _Layer(near.reshape(H, W), np.clip(color, 0.0, 1.0).reshape(H, W, 3))


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


def _plane(plane: np.ndarray, faces: np.ndarray, pixel: np.ndarray, W: int) -> np.ndarray:
    """Return a + b x + c y at the middle of a pixel, for pairs of triangles (`faces`) and pixels; plane (N, 3): a, b, c."""
    a, b, c = plane[faces].T
    return a + b * (pixel % W + 0.5) + c * (pixel // W + 0.5)


def _candidates(P: np.ndarray, W: int, H: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield pairs of triangle and pixel indices, for all pixels in the bounding boxes of triangles P (N, 3, 3) [pixels]."""
    low = np.clip(np.ceil(P[:, :, :2].min(axis=1) - 0.5), 0, (W, H)).astype(int)
    high = np.clip(np.floor(P[:, :, :2].max(axis=1) - 0.5) + 1, 0, (W, H)).astype(int)
    wide, tall = np.maximum(high - low, 0).T
    count = wide * tall
    some = np.flatnonzero(count)
    # The triangles are divided into chunks, which bounds the memory.
    first = np.searchsorted(np.cumsum(count[some]), np.arange(0, count.sum(), 2_000_000))
    for chunk in np.split(some, np.unique(first)[1:]) if len(some) else ():
        faces = np.repeat(chunk, count[chunk])
        k = np.arange(len(faces)) - np.repeat(np.cumsum(count[chunk]) - count[chunk], count[chunk])
        yield faces, (low[faces, 1] + k // wide[faces]) * W + low[faces, 0] + k % wide[faces]


def _grid(aim: Any) -> list[np.ndarray]:
    """Return the lines (2, 3) [m] of the viewer's floor, ten cells to each side."""
    _, _, cell, floor = aim
    cell *= 0.5
    ends = [np.array([(k * cell, -10 * cell, floor), (k * cell, 10 * cell, floor)]) for k in range(-10, 11)]
    return [*ends, *(line[:, [1, 0, 2]] for line in ends)]


def _words(figure: Any, axes: Any, about: dict[str, Any], height: int) -> None:
    """Write title, lines and legend into the upper left corner, as the page does."""
    from matplotlib.patches import Rectangle

    y = 22
    axes.text(16, y, about["title"], fontsize=11, fontweight="bold", va="center", parse_math=False)
    for line in about["lines"]:
        y += 17
        text = line if len(line) <= 74 else f"{line[:72]}..."
        axes.text(16, y, text, fontsize=8.5, color=MUTED, va="center", parse_math=False)
    x, y = 16, y + 18
    for color, text in about["legend"]:
        axes.add_patch(Rectangle((x, y - 5), 10, 10, color=color if color[0] == "#" else GREY, lw=0))
        axes.text(x + 15, y, text, fontsize=8, va="center", parse_math=False)
        x += 34 + int(5.6 * len(text))


def _chart(figure: Any, curves: Any) -> None:
    """Draw the errors of `Window.about["curves"]` into the lower right corner.

    Each curve has a name, a colour, pairs of iteration and error [m], and words, which the page alone shows.
    """
    if not curves:
        return
    axes = figure.add_axes((0.7, 0.55, 0.28, 0.36))
    for name, color, errors, _ in curves:
        k, error = np.array(errors).T
        axes.semilogy(k, np.maximum(error, 1e-9), color=color, lw=1.4, label=literal_text(name))
    axes.set_xlabel("iteration", fontsize=7)
    axes.set_title("error [m]", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.legend(fontsize=7, loc="upper right")


# ------------------------------------------------------------------------------------------------------------------ films
def encoder() -> str:
    """Return the path of ffmpeg, that of the package imageio-ffmpeg or one on the PATH. Raises MissingExtra."""
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):  # RuntimeError: the package is there without its program
        found = shutil.which("ffmpeg")
    if found is None:
        raise MissingExtra("imageio-ffmpeg", "mp4")
    return found


def film(ffmpeg: str, frames: Sequence[Any], lasts: np.ndarray) -> bytes:
    """Encode pictures (PIL) as an MP4 file in H.264; lasts (N,) [ms]: times for which they are shown, similar except for the last.

    Raises InvalidOption if ffmpeg fails, with what it says.
    """
    first, *_ = rgb = [frame.convert("RGB") for frame in frames]
    rate = 1000.0 / float(lasts[:-1].mean()) if len(lasts) > 1 else 1.0
    rgb += rgb[-1:] * max(0, round(float(lasts[-1]) / 1000.0 * rate) - 1)
    with tempfile.TemporaryDirectory() as folder:  # an MP4 file is not written from front to back
        made = Path(folder) / "film.mp4"
        even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"  # The pixel format needs even width and height.
        read = f"-y -loglevel error -f rawvideo -pix_fmt rgb24 -s {first.width}x{first.height} -r {rate:.6g} -i -"
        write = f"-vf {even} -c:v libx264 -pix_fmt yuv420p -movflags +faststart"
        words = [ffmpeg, *read.split(), *write.split(), str(made)]
        done = subprocess.run(words, input=b"".join(one.tobytes() for one in rgb), capture_output=True, check=False)
        if done.returncode or not made.is_file():
            said = done.stderr.decode(errors="replace").strip().splitlines() or [done.returncode]
            raise InvalidOption(f"ffmpeg could not write the film: {said[-1]}; a .gif needs no ffmpeg")
        return made.read_bytes()
