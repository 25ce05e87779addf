"""Sphinx settings. `sphinx-build -W docs docs/_build/html` builds the site; needs the extra `docs`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import _generate

from ik_toolkit import __version__

project = "ik_toolkit"
copyright = "ik_toolkit contributors, BSD-3-Clause"
release = version = __version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx_copybutton"]
exclude_patterns = ["_build", "data", "generated/extra", "**.ipynb_checkpoints"]

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
smartquotes = False  # "--" is the beginning of an option here
nb_execution_mode = "off"  # the notebooks are executed by their own check and carry their outputs
suppress_warnings = ["mystnb.unknown_mime_type"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 90

html_theme = "furo"
html_title = f"ik_toolkit {version}"
(Path(__file__).parent / "generated" / "extra").mkdir(parents=True, exist_ok=True)  # the scenes go there
html_static_path = ["_static"]
html_extra_path = ["generated/extra"]
html_css_files = ["style.css"]
html_logo = "_static/logo.svg"
copybutton_exclude = ".linenos, .gp, .go"
html_show_sphinx = False
html_copy_source = False


def setup(app):
    """Write the generated pages before reading, and make the plain docstrings safe for reStructuredText."""
    app.connect("builder-inited", lambda app: _generate.write_all(Path(app.srcdir)))
    app.connect("autodoc-process-docstring", _generate.escape_docstring)
    app.connect("autodoc-skip-member", _generate.skip_member)
