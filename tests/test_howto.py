"""The how-to pages on a finished run do what they say: their commands, one after the other, on one results folder."""

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mic.options import app
from mic.report.page import write_report
from mic.results.schema import (
    CONTRIBUTORS,
    DESIGN_POINTS,
    FRICTION_EFFECTS,
    LINEARITY,
    RARE,
    REMEDIES,
    REMEDY_EFFECTS,
    SENSITIVITIES,
    SPREADS,
)
from mic.runs import run

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "howto.md").read_text(encoding="utf-8")
SECTIONS = {
    "Find out what drives a characteristic": (CONTRIBUTORS, LINEARITY),
    "Find out what a step of each input changes": (SENSITIVITIES, SPREADS),
    "Find out whether friction matters": (FRICTION_EFFECTS,),
    "Find out how often a limit is missed where that is rare": (RARE, DESIGN_POINTS),
    "Find out what would mend it": (REMEDIES, REMEDY_EFFECTS),
}


def commands(section):
    """The commands that a section of the page shows."""
    text = PAGE.split(f"## {section}\n")[1].split("\n## ")[0]
    blocks = re.findall(r"```sh\n(.*?)```", text, re.S)
    return text, [shlex.split(line) for block in blocks for line in block.strip().splitlines()]


@pytest.mark.slow
def test_what_the_page_asks_of_a_finished_run_stands_in_its_folder_and_report(lap_scene, cache, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MIC_CACHE", str(cache))
    scene = lap_scene.model_copy(
        update={
            "monte_carlo": lap_scene.monte_carlo.model_copy(update={"samples": 20}),
            "report": lap_scene.report.model_copy(update={"laws": ["coulomb"]}),
        }
    )
    folder = Path("results") / "lap-joint"
    run(scene, folder, cache)
    for section, tables in SECTIONS.items():
        text, asked = commands(section)
        assert asked
        for program, *arguments in asked:
            assert program == "mic"
            done = CliRunner().invoke(app, arguments, env={"COLUMNS": "160"})
            assert done.exit_code == 0, f"{arguments}: {done.output}{done.exception}"
        for code in re.findall(r"```python\n(.*?)```", text, re.S):
            exec(code, {})
        for table in tables:
            assert (folder / table.place).is_file() and table.place in text
    page = write_report(folder).read_text(encoding="utf-8")
    opening = page[page.index('<section id="answer">') : page.index("</section>")]
    assert "driven by" in opening and "is not measured" not in opening
    for source in ("samples", "path", "contact residuals", "meshes", "contact pairs", "order of the process"):
        assert f"<b>{source}</b>" in opening
