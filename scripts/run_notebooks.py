"""Execute the notebooks and keep their outputs small: plots and text stay, 3-D scenes become pictures with a palette.

    python scripts/run_notebooks.py [NAME ...]      execute, strip, write back
    python scripts/run_notebooks.py --strip         only strip what is there

A scene is an HTML page of some 300 kB that code-hosting sites do not show anyway; it comes back when the cell is run. The picture
that is among its outputs is kept.
"""

import argparse
import base64
import io
from pathlib import Path

import nbformat
from make_pictures import palette_of
from PIL import Image  # comes with matplotlib

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
LARGEST_HTML = 20_000  # characters; tables of robots and results are far below, scenes far above
COLOURS = 200


def strip(notebook: nbformat.NotebookNode) -> None:
    """Replace scenes by pictures, drop times and widget state; number the cells from 1."""
    notebook.metadata = {
        key: notebook.metadata[key] for key in ("kernelspec", "language_info") if key in notebook.metadata
    }
    notebook.metadata["language_info"] = {"name": "python"}
    count = 0
    for cell in notebook.cells:
        cell.metadata = {}
        if cell.cell_type != "code":
            continue
        count += 1
        cell.execution_count = count
        cell.outputs = [output for output in map(small, cell.outputs) if output is not None]


def small(output: nbformat.NotebookNode) -> nbformat.NotebookNode | None:
    """Return the output with a picture in place of its scene, or None if nothing is left or it went to stderr."""
    if output.output_type == "stream" and output.name == "stderr":
        return None
    if output.output_type not in ("display_data", "execute_result"):
        return output
    if "execution_count" in output:
        output.execution_count = None
    html = output.data.get("text/html", "")
    if "image/png" in output.data:
        output.data.pop("text/html", None)
        html = ""
    if "application/vnd.jupyter.widget-view+json" in output.data or "<script" in html or len(html) > LARGEST_HTML:
        return None
    output.metadata = {}
    if "image/png" in output.data:
        output.data["image/png"] = with_palette(output.data["image/png"])
    return output


def with_palette(png: str) -> str:
    """Reduce a base64 picture to COLOURS colours: a third of the size for a chart."""
    packed = io.BytesIO()
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    palette = palette_of([picture], COLOURS)
    picture.quantize(palette=palette, dither=Image.Dither.NONE).save(packed, "png", optimize=True)
    return base64.b64encode(packed.getvalue()).decode()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="beginnings of file names; default: all")
    parser.add_argument("--strip", action="store_true", help="do not execute")
    arguments = parser.parse_args()
    for path in sorted(FOLDER.glob("*.ipynb")):
        if arguments.names and not path.name.startswith(tuple(arguments.names)):
            continue
        notebook = nbformat.read(path, as_version=4)
        if not arguments.strip:
            from nbclient import NotebookClient

            NotebookClient(notebook, timeout=180, store_widget_state=False).execute(cwd=str(FOLDER))
        strip(notebook)
        nbformat.write(notebook, path)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
