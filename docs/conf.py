"""How Sphinx builds the site: python -m sphinx -W --keep-going docs build/site."""

import inspect
import re
import shutil
from importlib import import_module
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.inspect import TypeAliasForwardRef

import octoarm_env

project = "OctoArm"
author = "The OctoArm authors"
copyright = author
release = octoarm_env.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
exclude_patterns = []

html_theme = "furo"
html_title = f"OctoArm {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]

myst_heading_anchors = 4

# Tutorials run where they have changed; what they print and draw is kept in build/notebooks.
nb_execution_mode = "cache"
nb_execution_cache_path = str(Path(__file__).parent.parent / "build" / "notebooks")
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_merge_streams = True

# Every name that is meant as a link must be one, but for those of other packages, aliases of types,
# and what is not for users.
nitpicky = True
OTHERS = "(_core|collections|gymnasium|minari|np|numpy|os|pathlib|sklearn|stable_baselines3)"
ALIASES = ("ArrayLike", "BodyLike", "Env", "Float", "Float32", "Integer", "NDArray")
OTHER_ALIASES = ("Flags", "Frame", "Numbers", "Path", "State")
INTERNAL = (
    r"(.*\.)?(BatchHistory|Cluster|MadeOnce|Past|ReachHistories|Renderer|Request|Spec|StateBasis|T)"
)
nitpick_ignore_regex = [
    ("py:.*", rf"{OTHERS}\..*"),
    ("py:class", "|".join(ALIASES + OTHER_ALIASES)),
    ("py:class", INTERNAL),
]

autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ALIASES}
# Sphinx 9.0 prints the class around such a name where it stands in another type.
TypeAliasForwardRef.__repr__ = lambda self: self.name  # type: ignore[method-assign]
napoleon_attr_annotations = False
napoleon_use_ivar = True
napoleon_use_rtype = False
maximum_signature_line_length = 88
default_role = "code"

MARKDOWN_HEADING = re.compile(r"^## ", re.M)
DOCSTRING = re.compile(r"^<!-- docstring of ([\w.]+) -->$", re.M)


def insert_docstrings(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put a docstring in Markdown, headings and tables and all, where a page asks for it."""

    def markdown(match: re.Match[str]) -> str:
        module, _, attribute = match[1].rpartition(".")
        documented = getattr(import_module(module), attribute)
        app.env.note_dependency(inspect.getfile(documented))
        # :class:`name` of reStructuredText is {class}`name` in MyST.
        return re.sub(r":(class|meth|func|attr):`", r"{\1}`", inspect.getdoc(documented) or "")

    source[0] = DOCSTRING.sub(markdown, source[0])


def shorten_markdown(
    app: Sphinx, what: str, name: str, documented: Any, options: Any, lines: list[str]
) -> None:
    """Of a docstring in Markdown the reference shows the first line: it has a page of its own."""
    if MARKDOWN_HEADING.search("\n".join(lines)):
        page = "reaching" if "Reach" in name else "octoarm"
        lines[:] = [lines[0], "", f"Spaces, reward and arguments: :doc:`/environments/{page}`.", ""]


def keep_colons(
    app: Sphinx, what: str, name: str, documented: Any, options: Any, lines: list[str]
) -> None:
    """Napoleon takes what stands before a colon for a type, in the first line of an attribute."""
    if what in {"attribute", "data", "property"} and lines:
        lines[:0] = ["..", ""]


def shorten_defaults(
    app: Sphinx,
    what: str,
    name: str,
    documented: Any,
    options: Any,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """Write defaults that are no Python, such as <factory>, as three dots."""
    return signature and re.sub(r"<[^<>]*>", "...", signature), returns


def mend_links(app: Sphinx, doctree: nodes.document) -> None:
    """Name pages by their titles, and folders of the repository, which no site has, unlinked."""
    folder = Path(app.env.doc2path(app.env.docname)).parent
    for reference in list(doctree.findall(addnodes.pending_xref)):
        if reference["reftype"] != "myst":
            continue
        if reference["refdomain"] == "doc":  # a page's target has no ending: a folder's name too
            if reference.astext().endswith(".md"):
                reference["refexplicit"] = False
        elif (folder / reference["reftarget"]).is_dir():
            reference.replace_self(reference.children)


def copy_page(app: Sphinx, error: Exception | None) -> None:
    """Put the arm in the browser beside the pages, of which web.md shows it."""
    if error is None and app.builder.format == "html":
        page = Path(__file__).parents[1] / "agents" / "octoarm_agents" / "web" / "page"
        shutil.copytree(page, Path(app.outdir) / "arm", dirs_exist_ok=True)


def setup(app: Sphinx) -> None:
    """Connect what is above."""
    app.connect("source-read", insert_docstrings)
    app.connect("autodoc-process-docstring", shorten_markdown, priority=400)
    app.connect("autodoc-process-docstring", keep_colons, priority=400)
    app.connect("autodoc-process-signature", shorten_defaults)
    app.connect("doctree-read", mend_links)
    app.connect("build-finished", copy_page)
