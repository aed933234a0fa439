"""Pages can be read by everybody: contrast of texts, alternative texts, keyboard."""

import re
from pathlib import Path

import pytest

MIC = Path(__file__).resolve().parents[1] / "mic"
PAGES = sorted([*(MIC / "report").glob("*.html"), MIC / "explorer" / "page.html"])
STYLES = [MIC / "report" / "style.html", MIC / "report" / "check.html", MIC / "explorer" / "page.css"]
WITHOUT_TEXT = (".bars span", ".tick", ".scale", ".column", "::before")
LEAST = 4.5


def luminance(colour):
    digits = colour.lstrip("#")
    digits = digits if len(digits) == 6 else "".join(2 * digit for digit in digits)
    shares = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    linear = [x / 12.92 if x <= 0.03928 else ((x + 0.055) / 1.055) ** 2.4 for x in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    """Ratio of WCAG 2, 1 to 21."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def text_colours(text):
    """(selector, colour, background) of each rule that states a colour or a background; white and ink by default."""
    text = text.replace("white", "#ffffff")
    names = dict(re.findall(r"(--[\w-]+): (#\w+)", text))
    text = re.sub(r"var\((--[\w-]+)\)", lambda found: names.get(found[1], ""), text)
    rules = re.findall(r"([^{}]+)\{([^{}]*)\}", text.split("</style>")[0])
    for selector, body in rules:
        ink = re.search(r"(?<![\w-])color: (#\w+)", body)
        ground = re.search(r"background: (#\w+)", body)
        if (ink or ground) and not any(part in selector for part in WITHOUT_TEXT):
            yield selector.strip(), ink[1] if ink else "#1b1f24", ground[1] if ground else None


@pytest.mark.parametrize("style", STYLES, ids=lambda path: path.name)
def test_texts_have_contrast(style):
    found = list(text_colours(style.read_text(encoding="utf-8")))
    assert found
    for selector, ink, ground in found:
        for behind in (ground,) if ground else ("#ffffff", "#f5f7f9"):
            assert contrast(ink, behind) >= LEAST, f"{selector}: {ink} on {behind}"


def test_contrast_by_hand():
    assert contrast("#000", "#ffffff") == pytest.approx(21) and contrast("#777", "#fff") == pytest.approx(
        4.48, abs=0.01
    )
    assert contrast("#d98500", "#fff") < LEAST


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_pictures_have_texts_and_everything_has_a_keyboard(page):
    text = page.read_text(encoding="utf-8")
    assert all(re.search(r'\balt="[^"]', one) for one in re.findall(r"<img\b[^>]*>", text))
    assert 'style="color:' not in text, "a mark beside the text shows the colour, whose contrast is unknown"
    for one in re.findall(r"<div\b[^>]*>", text):
        assert ('class="scroll"' not in one and "@click" not in one) or "tabindex" in one, one
    for one in re.findall(r"<(?:input|select|VSlider)\b[^>]*>", text, re.S):
        name = re.search(r"\bid=\"([\w-]+)\"|:id=\"([^\"]+)\"", one)
        labelled = name and (f'for="{name[1]}"' in text if name[1] else f':for="{name[2]}"' in text)
        inside = f"<label>law {one}" in text or f"<label>show {one}" in text
        assert "aria-label" in one or labelled or inside, one
