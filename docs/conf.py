"""The documentation's site: `python -m sphinx -W --keep-going -b html docs site`.

Neither the build nor the site needs a network: any static host serves the folder, and it opens from a disk too. The
notebooks are run by the build, which takes a minute.
"""

from __future__ import annotations

import hashlib
import re
from importlib.metadata import distribution
from importlib.metadata import version as version_of
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.ext.napoleon.docstring import GoogleDocstring
from sphinx.util.inspect import TypeAliasForwardRef

import bayesid

project = "bayesid"
author = "the authors of bayesid"
version = release = version_of("bayesid")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
nitpicky = True
suppress_warnings = ["ref.python"]  # signatures name types without modules; two classes are called Coefficient
nitpick_ignore_regex = [("py:.*", ".*")]  # types of other libraries: nothing is looked up on the network

# ---------------------------------------------------------------------------------------------------------------
# Pages
# ---------------------------------------------------------------------------------------------------------------
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
smartquotes = False  # a prime is a transpose
numfig = math_numfig = True  # equations are numbered with their page: (2.4)
numfig_secnum_depth = 1
math_eqref_format = "equation {number}"
exclude_patterns = ["paper"]  # for a journal, which typesets it
html_theme = "furo"
html_title = f"bayesid {version}"
html_show_copyright = False
html_copy_source = False
html_show_search_summary = False  # browsers let no page read another from a disk: results are titles
html_css_files = ["pages.css"]

# ---------------------------------------------------------------------------------------------------------------
# Equations: MathJax as one file beside the pages. It draws SVG, which needs no fonts; its menu, which would fetch more,
# is left out
# ---------------------------------------------------------------------------------------------------------------
MATHJAX = Path(str(distribution("sphinx-mathjax-offline").locate_file("sphinx-mathjax-offline/static/mathjax")))
MATHJAX_SHA256 = "a4354ff94fd868aea0cc6eaaa79a57fda0588646fc46ee3700a349ee0a11cbe6"
"""Of `es5/tex-svg-full.js` in MathJax 3.2.2 as its authors publish it."""
mathjax_path = "tex-svg-full.js"
mathjax3_config = {"options": {"enableMenu": False}, "svg": {"fontCache": "global"}}
html_static_path = ["_static", str(MATHJAX / mathjax_path)]
if hashlib.sha256((MATHJAX / mathjax_path).read_bytes()).hexdigest() != MATHJAX_SHA256:
    raise RuntimeError(f"{MATHJAX / mathjax_path} is not MathJax 3.2.2")

# ---------------------------------------------------------------------------------------------------------------
# Notebooks: they stand in the repository without outputs, the build runs them
# ---------------------------------------------------------------------------------------------------------------
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 600  # s, of a cell: ten times what the slowest takes, on a busy machine
nb_merge_streams = True

# ---------------------------------------------------------------------------------------------------------------
# Docstrings
# ---------------------------------------------------------------------------------------------------------------
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_type_aliases = {name: name for name in ("Array", "Integers", "Labels", "Mask")}
TypeAliasForwardRef.__repr__ = lambda self: str(self.name)  # or `Array | None` would be spelled out
default_role = "code"
maximum_signature_line_length = 100
napoleon_use_ivar = True


def whole_text(docstring: GoogleDocstring) -> tuple[str, list[str]]:
    """An attribute's docstring has no type before its first colon."""
    lines = docstring._dedent(docstring._consume_to_end())
    return "", GoogleDocstring(lines, docstring._config).lines()


GoogleDocstring._consume_inline_attribute = whole_text
python_use_unqualified_type_names = True
toc_object_entries_show_parents = "hide"

_EXPORTED = {id(getattr(place, name)) for place in (bayesid, bayesid.types) for name in place.__all__}
_MARKUP = re.compile(r"(?P<markup>`[^`]*`|\*\w[^*]*\w\*)|(?P<sign>[|*])")


def keep_signs(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """A bar in a docstring is that of an absolute value, a lone star a product or a pattern: neither is markup."""
    literal: int | None = None  # indentation of the paragraph whose `::` began a literal block
    example = False
    for i, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        example = bool(line) and (example or line.lstrip().startswith(">>> "))
        if line and literal is not None and indent <= literal:
            literal = None
        if literal is None and not example:
            lines[i] = _MARKUP.sub(lambda found: found["markup"] or "\\" + found["sign"], line)
            literal = indent if line.endswith("::") else None


def head_module(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """A module's docstring stands under its name."""
    if what == "module":
        lines[:0] = [f".. rubric:: {name}", ""]


def skip_exported(app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object) -> bool | None:
    """What `bayesid` exports is documented under that name, not once more in its module."""
    return True if what == "module" and id(obj) in _EXPORTED else None


def setup(app: Sphinx) -> None:
    """Connects all of this."""
    app.connect("autodoc-process-docstring", keep_signs, priority=400)  # before napoleon
    app.connect("autodoc-process-docstring", head_module, priority=600)
    app.connect("autodoc-skip-member", skip_exported)
