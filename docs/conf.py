"""Settings of the documentation: Sphinx, Markdown by MyST, docstrings by autodoc. Nothing is fetched at build or on reading.

python -m sphinx -W --keep-going -n docs docs/_build
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import diffeed

project = "diffeed"
author = "diffeed"
version = release = diffeed.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "extension"]
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = f"diffeed {version}"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_math_renderer = "mathml"  # of extension.py
html_show_copyright = False
html_copy_source = False
html_theme_options = {"top_of_page_buttons": []}
pygments_style = "tango"
pygments_dark_style = "monokai"

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3

default_role = "code"  # docstrings mark code with single backticks
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80

nitpick_ignore_regex = [
    # Of other projects: their pages cannot be asked without a network.
    ("py:.*", r"((jax|numpy|matplotlib|pydantic|pathlib|os|collections|typing)\..*|Axes)"),
    ("py:.*", r"diffeed\.input\.paths\.T"),  # a type variable: the same type comes back
    ("py:.*", r"optimize\.descent\.(Progress|Line)"),  # of a search on its way: for those who read its source
    ("py:.*", r"optimize\.(asked\.Asked|tolerance\.(contributions\.Slopes|statistics\.Indices))"),  # likewise
]
smartquotes = False  # "--out" must stay what can be copied
