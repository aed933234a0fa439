"""Read the content of pages, and fill them with hostile texts."""

import base64
import gzip
import json
from html.parser import HTMLParser

import jinja2
from markupsafe import Markup

import mic.report.template

#: Ends of an attribute, an element, a script and a JSON string; syntax of Vue, Jinja and matplotlib; text from right to
#: left, control characters, and a long word.
HOSTILE = (
    "\"'></script></title></style><script>alert(1)</script><img src=x onerror=alert(1)>{{7*7}}{%raw%}${1}$\\frac{$"
    "&lt;b&gt;--><!--]]>\u202e\u0645\x07\x1b[31m`<i>`" + "x" * 300
)


def unpacked(text):
    """The JSON of a packed text."""
    return json.loads(gzip.decompress(base64.b64decode(text)))


class _Elements(HTMLParser):
    """The elements of a page and the names of their attributes, in order."""

    def __init__(self, source):
        super().__init__()
        self.found = []
        self.feed(source)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, [name for name, _ in attrs]))


def elements(path):
    """The elements of a page of the program with the names of their attributes, none of which runs a hostile text."""
    source = path.read_text(encoding="utf-8")
    found = _Elements(source).found
    assert len(found) > 20 and not [name for _, names in found for name in names if name.startswith("on")]
    assert "<script>alert" not in source and "<img src=x" not in source
    return found


def make_texts_hostile(monkeypatch):
    """Put :data:`HOSTILE` before every text that a template of the program shows, also before one that it calls safe;
    a Markup was escaped by what made it."""

    def environment(**settings):
        found = jinja2.Environment(finalize=lambda value: HOSTILE + value if type(value) is str else value, **settings)
        found.filters["safe"] = lambda value: Markup(HOSTILE + str(value))
        return found

    monkeypatch.setattr(mic.report.template, "Environment", environment)
