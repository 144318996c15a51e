"""The configuration of Sphinx for the documentation; docs/site/build.py calls it."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import lagrange

project = "lagrange"
author = "The lagrange developers"
version = release = lagrange.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx_copybutton", "mathml", "docstrings"]
html_math_renderer = "mathml"

myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 4
myst_dmath_double_inline = False
nb_execution_mode = "off"  # docs/site/tutorials.py has run them
nb_render_markdown_format = "myst"
suppress_warnings = ["misc.highlighting_failure"]

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_class_signature = "mixed"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 100
add_module_names = False
nitpicky = True

html_theme = "furo"
html_title = "lagrange"
html_static_path = ["static"]
html_extra_path = [str(Path(__file__).resolve().parents[2] / "build" / "site" / "extra")]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_last_updated_fmt = None
templates_path: list[str] = []
pygments_style = "friendly"
pygments_dark_style = "nord-darker"
copybutton_prompt_text = r">>> |\$ "
copybutton_prompt_is_regexp = True
