"""Sphinx configuration: written pages, pages generated from the code, and a gallery that is run (script/docs)."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from docutils import nodes
from jinja2.sandbox import SandboxedEnvironment
from latex2mathml.converter import convert
from numpydoc import docscrape_sphinx

import mic

sys.path.insert(0, str(Path(__file__).parent))  # pages.py, which writes the generated pages
import pages

project = "mic-contact"
author = "The authors of mic-contact"
copyright = "The authors of mic-contact"
version = release = mic.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["gallery/*", "images/*.py"]
suppress_warnings = ["config.cache"]  # the gallery's order is a function, which cannot be pickled

default_role = "literal"  # single backquotes name an argument or attribute
autodoc_default_options = {"exclude-members": "model_config"}  # pydantic's settings
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the numpydoc sections have shapes, units and signs
numpydoc_show_class_members = False

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "_generated/gallery",
    "filename_pattern": r"\.py$",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "write_computation_times": False,
    "remove_config_comments": True,
}

html_theme = "pydata_sphinx_theme"
html_title = "mic-contact"
html_show_sourcelink = False
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"  # typeset by browsers, without scripts or downloads
html_theme_options = {
    "collapse_navigation": True,  # the whole tree of the API on each page takes most of the time to write it
    "header_links_before_dropdown": 6,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
}


templates = SandboxedEnvironment()


def one_environment(loader):
    """The Jinja environment of all docstrings; numpydoc makes one for each, and compiles its template again."""
    templates.loader = templates.loader or loader
    return templates


docscrape_sphinx.SandboxedEnvironment = one_environment


def own_document(app, doctree):
    """Make a page the document of all its nodes.

    Those of an ``eval-rst`` block name a document of their own, which holds Sphinx's environment: each page would be
    stored with the tables of contents of all pages before it.
    """
    for node in doctree.findall():
        node.document = doctree


def mathml(display):
    """A renderer of equations as MathML."""

    def visit(self, node):
        text = convert(node.astext(), display=display)
        self.body.append(text.replace("<mo>&#x0005E;", '<mo stretchy="false">&#x0005E;'))  # a hat, not a wide accent
        raise nodes.SkipNode

    return visit, None


def equations(app, what, name, obj, options, lines):
    """Make indented paragraphs of a docstring, which are equations, literal blocks.

    The numpydoc sections, from the first underlined heading on, are unchanged.
    """
    end = next((i - 1 for i, line in enumerate(lines) if i and re.fullmatch(r"\s*-{3,}", line)), len(lines))
    done, base, literal = [], 0, False
    for i, line in enumerate(lines[:end]):
        indent = len(line) - len(line.lstrip())
        if line.strip():
            if i and not lines[i - 1].strip() and indent >= base + 4 and not literal and not _marked(done):
                done += [" " * base + "::", ""]
                literal = True
            elif indent < base + 4:
                item = re.match(r"\s*([-*]|\d+\.) +", line)
                base, literal = len(item[0]) if item else indent, False
        # the number of an equation closer to it
        done.append(re.sub(r" {6,}(\(\d+\))$", r"      \1", line) if literal else line)
    lines[:] = done + lines[end:]


def _marked(done):
    """Whether the last line introduces a literal block or is a directive."""
    last = next((line.strip() for line in reversed(done) if line.strip()), "")
    return last.endswith("::") or last.startswith("..")


def references(app, what, name, obj, options, lines):
    """References are numbered once per module; numpydoc expects them in each docstring."""
    text = "\n".join(lines)
    if what == "module":
        text = re.sub(r"^(\w[^\n]*)\n-{3,}$", r".. rubric:: \1\n", text, flags=re.MULTILINE)
        text = re.sub(r"^\.\. \[(\d+)\] ", r"- [\1] ", text, flags=re.MULTILINE)
        text = re.sub(r"^   (?=\S)", "  ", text, flags=re.MULTILINE) if "- [1] " in text else text
    lines[:] = re.sub(r"\[(\d+)\]_", r"[\1]", text).split("\n") if what == "module" or ".. [" not in text else lines[:]


def setup(app):
    """Write the generated pages before Sphinx looks for sources."""
    pages.write(Path(__file__).parent / "_generated")
    app.connect("doctree-read", own_document)
    app.connect("autodoc-process-docstring", references, priority=100)  # before numpydoc
    app.connect("autodoc-process-docstring", equations, priority=110)
    app.add_html_math_renderer("mathml", inline_renderers=mathml("inline"), block_renderers=mathml("block"))
