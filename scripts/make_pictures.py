"""Make the pictures of the README and the gallery: scenes drawn by `ik.view`, captured in headless Chromium.

Run: python scripts/make_pictures.py [NAME ...]   (needs the extras view, robots and paths, and chromium; `panel` and `drag`
also playwright, `panel` the extra panel)
"""

import argparse
import contextlib
import io
import math
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image  # comes with matplotlib

import ik_toolkit as ik

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "_static"
SIZE = (1000, 600)
COLUMNS, SMALL = 4, (300, 220)  # columns of a sheet of solutions, and pixels of each
# WebGL without a card
GRAPHICS = "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"
MOVING = (900, 600)  # pixels of the animation
FRAMES, PAUSE, COLOURS = 34, 70, 128  # frames one way, [ms] per frame, and colours: under a megabyte in all
POINTER = """() => { const svg = document.createElement("div");
  const arrow = '<path d="M1 1v20l5-4 4 9 4-2-4-8h7z" fill="#fff" stroke="#222" stroke-width="1.4"/>';
  svg.innerHTML = `<svg width="20" height="28">${arrow}</svg>`;
  svg.style.cssText = "position:fixed;pointer-events:none;left:0;top:0;width:20px";
  document.body.append(svg);
  addEventListener("pointermove", (e) => { svg.style.left = e.clientX + "px"; svg.style.top = e.clientY + "px"; }, true);
}"""  # a visible pointer: screenshots do not show the real one
FLAGS = (
    "--headless --no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --hide-scrollbars --virtual-time-budget=15000"
).split()


def aim(scene: Any, at: tuple[float, float, float], eye: tuple[float, float, float]) -> Any:
    """Look at a point [m] from closer than the default, which leaves room for rotating the scene."""
    scene.look(eye=eye, target=at)
    return scene


def solve() -> Any:
    """A pose of the HydroLek, with the iterations from home."""
    robot = ik.Robot.load("hydrolek_7w")
    target = robot.fk([0.4, 0.9, -0.4, 1.0, -1.0, 0.8])
    scene = ik.view(robot, ik.solve(robot, target, history=True), target=target)
    return aim(scene, (0.38, 0.08, 0.17), (0.95, -0.62, 0.5))


def two_arms() -> Any:
    """Both arms of the Brokk machine, solved together."""
    robot = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    targets = {"left_tip": ik.pose(xyz=(1.35, 0.35, 0.75)), "right_tip": ik.pose(xyz=(1.25, -0.3, 0.95))}
    return aim(ik.view(robot, ik.solve(robot, targets), target=targets), (0.4, 0.0, 0.62), (2.15, -1.25, 1.3))


def branches(picture: Path) -> None:
    """All solutions for one pose of the UR5, joints within half a turn, side by side."""
    robot = ik.Robot.load("ur5_limited")
    target = robot.fk([0.4, -1.1, 1.3, -0.6, 1.2, 0.3])
    found = ik.solve_all(robot, target)
    rows = -(-len(found) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * SMALL[0], rows * SMALL[1]), "white")
    for k, q in enumerate(found):
        scene = ik.view(robot, q, target=target, title=f"solution {k + 1}")
        aim(scene, (0.15, 0.05, 0.3), (1.05, -0.85, 0.85))
        with tempfile.TemporaryDirectory() as folder:
            single = Path(folder) / "one.png"
            photograph(scene.save(Path(folder) / "one.html"), single)
            with Image.open(single) as one:
                tile = one.crop((420, 210, 420 + SMALL[0], 210 + SMALL[1]))
        sheet.paste(tile, (k % COLUMNS * SMALL[0], k // COLUMNS * SMALL[1]))
    sheet.save(picture, optimize=True)


def tracking() -> Any:
    """A figure of eight followed by the Panda."""
    robot = ik.Robot.load("panda")
    start = robot.fk(robot.home)
    path = ik.lissajous(start, amplitudes=(0.12, 0.2, 0.0), duration=8.0)
    return aim(ik.view(robot, ik.track(robot, path, "cv", dt=0.02)), (0.27, 0.0, 0.38), (0.95, -0.55, 0.72))


def path() -> Any:
    """A saw blade on the HydroLek moves round a pipe; its path is coloured by speed."""
    robot = ik.Robot.load("hydrolek_7w")
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    poses = np.tile(ik.pose(xyz=(1.01, -0.13, 0.10), direction=(1, 0, 0)).T_base_tip, (121, 1, 1))
    poses[:, 1, 3] += 0.12 * np.cos(angle)
    poses[:, 2, 3] += 0.12 * np.sin(angle)
    along_x = ik.pose(xyz=(1.26, -0.13, 0.10), rpy=(0, np.pi / 2, 0))
    pipe = ik.CollisionModel(robot).add_cylinder(0.05, 0.6, along_x, name="pipe")
    result = ik.solve_path(robot, poses, free_turn=(0, 0, 1), avoid_collisions=pipe)
    return aim(ik.view(robot, result.retime(acceleration=1.0)), (0.75, -0.1, 0.1), (0.95, -1.0, 0.5))


def stretched() -> Any:
    """The HydroLek's tip follows a line that leaves its reach and returns, as closely as possible."""
    robot = ik.Robot.load("hydrolek_7w")
    T = robot.fk(robot.home).homogeneous
    end = T.copy()
    end[:3, 3] += (0.35, 0.15, 0.1)
    run = ik.track(robot, ik.line(T, end, duration=8.0, rounds=1), "cv", dt=0.01, q0=robot.home, on_limit="leave")
    return aim(ik.view(robot, run), (0.55, 0.12, 0.15), (1.15, -0.85, 0.6))


def limits() -> Any:
    """Points of the plane y = 0 that the HydroLek's tip reaches inside its joint limits."""
    robot = ik.Robot.load("hydrolek_7w")
    x, z = np.meshgrid(np.arange(0.15, 1.35, 0.04), np.arange(-0.9, 1.06, 0.04))
    points = np.column_stack([x.ravel(), np.zeros(x.size), z.ravel()])
    many = ik.solve_batch(robot, points, restarts=20)
    return aim(ik.view(robot, cloud=(points, many.success)), (0.55, 0.0, 0.1), (0.72, -1.55, 0.3))


def reach() -> Any:
    """The cells that the HydroLek reaches with any orientation, cut open."""
    robot = ik.Robot.load("hydrolek_7w")
    return aim(
        ik.view(robot, ik.reachability(robot, resolution=0.06, audit=500)), (0.55, 0.05, 0.1), (1.2, -1.75, 0.75)
    )


def reach_maps(picture: Path) -> None:
    """Maps of the planar arms and of the HydroLek: planes of cells, coloured by manipulability."""
    flat = ((-2.1, -2.1, 0), (2.1, 2.1, 0))
    asked = {
        "planar_2r": (flat, 0.03),
        "planar_3r": (3.0 * np.array(flat), 0.1),
        "hydrolek_7w": (((0.0, 0.05, -1.0), (1.35, 0.05, 1.0)), 0.02),
    }
    drawn = []
    for name, (region, resolution) in asked.items():
        found = ik.reachability(ik.Robot.load(name), region, resolution=resolution)
        with tempfile.TemporaryDirectory() as folder:
            ik.plot(found, file=Path(folder) / "map.png")
            drawn.append(Image.open(Path(folder) / "map.png").convert("RGB"))
    tall = max(one.height for one in drawn)
    sheet = Image.new("RGB", (sum(one.width for one in drawn), tall), "white")
    for k, one in enumerate(drawn):
        sheet.paste(one, (sum(other.width for other in drawn[:k]), 0))
    sheet.quantize(128).save(picture, optimize=True)


def reach_floor(picture: Path) -> None:
    """The floor around a sheet that the HydroLek cuts along three edges, and the best places to stand."""
    robot = ik.Robot.load("hydrolek_7w")
    T = robot.fk(0.5 * (robot.lower + robot.upper)).homogeneous
    s = np.linspace(-0.5, 0.5, 60)
    edges = np.tile(T, (180, 1, 1))
    edges[:, :3, 3] += (2.0, 1.0, 0.0)
    sides = ((0 * s - 0.4, s), (0.8 * s, 0 * s + 0.5), (0 * s + 0.4, -s))
    edges[:, 1:3, 3] += np.concatenate([np.column_stack(side) for side in sides])
    ik.plot(ik.place(robot, edges), file=picture)


SCENES = {
    "reach": reach,
    "solve": solve,
    "two_arms": two_arms,
    "tracking": tracking,
    "path": path,
    "limits": limits,
    "stretched": stretched,
}
SHIPPED = ("solve", "two_arms", "path", "limits", "stretched", "reach")  # robots that need no extra


def find_chromium() -> str:
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        raise SystemExit("chromium is not installed")
    return chromium


def panel(picture: Path) -> None:
    """Write the picture of the panel after a solve, operated as a user would."""
    from playwright.sync_api import sync_playwright

    from ik_toolkit.show.panel.panel import Panel

    with contextlib.closing(Panel("hydrolek_7w")) as served, sync_playwright() as play:
        page = play.chromium.launch(executable_path=find_chromium(), args=[*GRAPHICS]).new_page(
            viewport={"width": 1280, "height": 960}
        )
        page.goto(served.url)
        page.locator(".mantine-Notification-closeButton").click()  # notice about the software renderer
        page.get_by_role("tab", name="Solve").click()
        for label, text in (("x y z [m]", "0.829 0.608 0.401"), ("r p y [deg]", "-69 -18 -26")):
            page.locator(f"xpath=//label[.='{label}']/ancestor::div[.//input][1]//input").fill(text)
        page.wait_for_timeout(500)
        page.get_by_role("button", name="Solve", exact=True).click()
        page.locator("[role=status]", has_text="Converged").wait_for()
        page.wait_for_timeout(2000)
        page.screenshot(path=picture)
    Image.open(picture).convert("RGB").quantize(256).save(picture, optimize=True)


def drag(picture: Path) -> None:
    """Write the animation: the target of the Panda's live page is dragged there and back, once past the edge of reach.

    The return shows the same frames in reverse, so that the animation loops without a jump.
    """
    from playwright.sync_api import sync_playwright

    frames = []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        page = play.chromium.launch(executable_path=find_chromium(), args=[*GRAPHICS]).new_page(
            viewport={"width": MOVING[0], "height": MOVING[1]}
        )
        page.goto(ik.view(ik.Robot.load("panda")).page(Path(folder) / "panda.html").as_uri())
        page.wait_for_selector("body[data-still='1']")
        page.evaluate(POINTER)
        page.mouse.move(280, 330)
        page.mouse.wheel(0, -150)  # nearer
        x, y = page.evaluate("arm.state().at[0]")
        page.mouse.move(x, y)
        page.mouse.down()
        for k in range(FRAMES):
            s = 0.5 - 0.5 * math.cos(math.pi * k / (FRAMES - 1))  # starts and ends slowly
            page.mouse.move(
                x + 60 * (math.cos(2.2 * math.pi * s) - 1) + 125 * s, y + 85 * math.sin(1.9 * math.pi * s) - 30 * s
            )
            page.wait_for_timeout(60)
            page.wait_for_selector("body[data-still='1']")
            frames.append(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
    palette = palette_of(frames[:: FRAMES // 4], COLOURS)  # one for all frames: static parts do not flicker
    first, *others = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in [*frames, *frames[-2:0:-1]]]
    first.save(picture, save_all=True, append_images=others, duration=PAUSE, loop=0, optimize=True, disposal=1)


def palette_of(pictures: list[Any], count: int) -> Any:
    """Common palette of some pictures. Vivid parts are small but catch the eye, so they count for a sixth of the pixels."""
    pixels = np.concatenate([np.asarray(picture).reshape(-1, 3) for picture in pictures])
    vivid = pixels[np.ptp(pixels.astype(int), axis=1) > 90]
    if len(vivid):
        pixels = np.concatenate([pixels, np.resize(vivid, (len(pixels) // 5, 3))])
    return Image.fromarray(pixels[None]).quantize(count, method=Image.Quantize.MEDIANCUT)


def photograph(page: Path, picture: Path) -> None:
    """Write a screenshot of a page."""
    with tempfile.TemporaryDirectory() as profile:
        size = f"--window-size={SIZE[0]},{SIZE[1]}"
        command = [
            find_chromium(),
            *FLAGS,
            f"--user-data-dir={profile}",
            size,
            f"--screenshot={picture}",
            page.as_uri(),
        ]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
    Image.open(picture).convert("RGB").save(picture, optimize=True)


MADE = {  # pictures that are not a single scene
    "branches.png": branches,
    "panel.png": panel,
    "drag.gif": drag,
    "reach_maps.png": reach_maps,
    "reach_floor.png": reach_floor,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    makers = {Path(file).stem: (FOLDER / file, make) for file, make in MADE.items()}
    parser.add_argument("names", nargs="*", help=f"default: all of {', '.join([*SCENES, *makers])}")
    for name in parser.parse_args().names or [*SCENES, *makers]:
        picture, make = makers.get(name, (FOLDER / f"{name}.png", None))
        if make:
            make(picture)
        else:
            with tempfile.TemporaryDirectory() as folder:
                photograph(SCENES[name]().save(Path(folder) / f"{name}.html"), picture)
        print(f"{picture.name}: {picture.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
