"""Sphinx: the pages of this folder, and an API reference made from the docstrings (see `api.rst`)."""

from importlib.metadata import version as _version

project = "gyrotrack"
author = "The gyrotrack developers"
version = release = _version("gyrotrack")
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["_build", "make_*.py"]
html_theme = "furo"
html_title = "gyrotrack"
html_show_copyright = False
# what a page links to outside this folder is read on the project's site, not in the built pages; fields of several
# classes have the same name
suppress_warnings = ["myst.xref_missing", "myst.header", "ref.python"]
myst_enable_extensions = ["colon_fence", "dollarmath", "amsmath"]
myst_heading_anchors = 3
autodoc_typehints = "none"
autodoc_class_signature = "separated"  # the docstrings name types and shapes
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": False}
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
