"""Colours and chart style for all charts, reports, pages and tables.

The palette is that of Okabe and Ito (2008), which people with colour blindness can tell apart, and a grey.
"""

from typing import Any

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C8C8C")
DASHES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)), (0, (3, 1, 1, 1)), (0, (7, 3)))
GREY, PALE = "#6F6F6F", "#E4E4E4"
GOOD, BAD = "#1b7837", "#b2182b"  # colours of the words for solved and not solved, dark enough to read on white
MUTED = "#4a5766"  # colour of text that is less important
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": PALE,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "figure.dpi": 110,
    "savefig.dpi": 160,
    "svg.fonttype": "none",
}
# Style of the figures in reports that reproduce papers, where they are shown beside the papers' own figures.
PRINTED: Any = STYLE | {
    "axes.titlesize": 9,
    "axes.titlelocation": "center",
    "axes.grid": False,
    "savefig.bbox": "tight",
}
