"""Write the paper reports to docs/papers/ with small pictures: the output of `ik reproduce` for each.

python scripts/make_reports.py [PAPER ...]
"""

import argparse
import importlib
from pathlib import Path

from PIL import Image  # comes with matplotlib

from ik_toolkit.papers import PAPERS

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "papers"
WIDTH = 1300  # pixels; enough for a page on a high-density screen
COLOURS = 255


def shrink(file: Path) -> None:
    """Reduce a picture to at most WIDTH pixels wide, with a palette."""
    picture = Image.open(file).convert("RGB")
    if picture.width > WIDTH:
        picture = picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)
    # this method keeps the rarest colours, such as a line that only the legend shows
    picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(file, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("papers", nargs="*", choices=[*PAPERS, []], help="default: all")
    for name in parser.parse_args().papers or PAPERS:
        module, function = PAPERS[name].target.split(":")
        files = getattr(importlib.import_module(module), function)().write(FOLDER / name, pictures=True)
        for file in files:
            if file.suffix == ".png":
                shrink(file)
            if file.suffix == ".json":
                file.unlink()  # the same numbers, for machines
        print(name, sum(file.stat().st_size for file in files if file.exists()) // 1000, "kB")


if __name__ == "__main__":
    main()
