"""Sphinx's settings: `make docs` builds the site in build/docs from the Markdown beside this file, which GitHub shows as it is."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "site"))

project = "gainroom"
author = copyright = "the gainroom authors"  # noqa: A001, as Sphinx calls it
html_title = "gainroom"
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "mathml", "docstrings", "offline"]
exclude_patterns = ["site"]

myst_enable_extensions = ["dollarmath", "html_image"]
myst_heading_anchors = 4  # links to headings as GitHub has them

default_role = "literal"  # docstrings put code between single backticks
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "none"  # docstrings say shapes and units
toc_object_entries_show_parents = "hide"
add_module_names = False
python_maximum_signature_line_length = 100
numpydoc_show_class_members = False  # autodoc lists them
numpydoc_class_members_toctree = False

html_theme = "furo"
html_math_renderer = "mathml"
html_static_path = ["site/static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
pygments_style = "friendly"
pygments_dark_style = "monokai"
