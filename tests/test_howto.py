"""The how-to pages on a finished run do what they say: their commands, one after the other, on one results folder."""

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mic import examples
from mic.options import app
from mic.report.picture_registry import draw
from mic.results.schema import (
    CONTRIBUTORS,
    DESIGN_POINTS,
    FRICTION_EFFECTS,
    LINEARITY,
    ORDERS,
    RARE,
    REMEDIES,
    REMEDY_EFFECTS,
    SENSITIVITIES,
    SPREADS,
)
from mic.runs import run
from verification.scenes import FEW

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "howto.md").read_text(encoding="utf-8")
SECTIONS = {
    "Find the main contributors": (CONTRIBUTORS, LINEARITY),
    "Find the sensitivity to each input": (SENSITIVITIES, SPREADS),
    "Measure the effect of friction": (FRICTION_EFFECTS,),
    "Estimate small failure probabilities": (RARE, DESIGN_POINTS),
    "Find a remedy": (REMEDIES, REMEDY_EFFECTS),
}

#: Files that the commands of a section write, beside those of the results folder.
ASSEMBLIES = {
    "Compare before and after": (
        "results/lap-joint_lap-joint-weaker/comparison.html",
        "results/lap-joint_lap-joint/comparison.html",
    ),
    "Find the causes of one measured assembly": ("results/lap-joint_measured/explanation.html",),
    "Predict individual assemblies": ("predictions.csv",),
}
#: Samples of a command, fewer than those that the page or the command chooses.
SAMPLES = {"contributors": 16, "sensitivity": 4, "friction": 10, "rare": 100, "order": 4}


def commands(section):
    """The commands that a section of the page shows."""
    text = PAGE.split(f"## {section}\n")[1].split("\n## ")[0]
    blocks = re.findall(r"```sh\n(.*?)```", text, re.S)
    return text, [shlex.split(line, comments=True) for block in blocks for line in block.strip().splitlines()]


def execute(program, command, *arguments):
    """Output of a command with few samples; fails if it fails."""
    few = ["--samples", str(SAMPLES[command])] if command in SAMPLES else []
    done = CliRunner().invoke(app, [command, *arguments, *few], env={"COLUMNS": "160"})
    assert program == "mic" and done.exit_code == 0, f"{command} {arguments}: {done.output}{done.exception}"
    return done.output


def prepare_assemblies(scene, cache):
    """Write the inputs of the sections on single assemblies: another run, two scenes, measured values."""
    text, _ = commands("Find the causes of one measured assembly")
    Path("measured.csv").write_text(re.findall(r"```\n(measurement,.*?)```", text, re.S)[0])
    Path("measured_parts.csv").write_text("F1,F2\n-5,2\n-4,\n")
    weaker = [zone.model_copy(update={"friction": 0.1}) for zone in scene.zones]
    run(scene.model_copy(update={"zones": weaker}), Path("results") / "lap-joint-weaker", cache)
    for name, friction in (("my_joint", "0.27"), ("my_joint_weaker", "0.1")):
        path = examples.copy("lap_joint", Path(name)) / "scene.toml"
        own = f"friction = {friction}\npairs = {FEW['lap']}"
        path.write_text(path.read_text().replace("friction = 0.27", own))


@pytest.mark.slow
def test_commands_of_the_page_write_their_tables_and_the_report_shows_them(
    lap_scene, cache, tmp_path, monkeypatch, no_pictures
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MIC_CACHE", str(cache))
    scene = lap_scene.model_copy(
        update={
            "monte_carlo": lap_scene.monte_carlo.model_copy(update={"samples": 10}),
            "report": lap_scene.report.model_copy(update={"laws": ["coulomb"]}),
        }
    )
    folder = Path("results") / "lap-joint"
    run(scene, folder, cache)
    for section, tables in SECTIONS.items():
        text, asked = commands(section)
        assert asked
        for words in asked:
            execute(*words)
        for code in re.findall(r"```python\n(.*?)```", text, re.S):
            exec(code, {})
        for table in tables:
            frame = table.read(folder, "")
            assert len(frame) and (frame["law"] == "coulomb").all() and table.place in text
    prepare_assemblies(scene, cache)
    for section, files in ASSEMBLIES.items():
        _, asked = commands(section)
        for words in asked:
            if "--watch" not in words:  # until Ctrl-C
                execute(*words)
        for file in files:
            assert Path(file).is_file(), sorted(Path("results").iterdir())
    assert ORDERS.place in execute("mic", "order", str(folder)).replace("\n", "") and len(ORDERS.read(folder, ""))
    one_picture = lambda outcome, context, *_: {"contributors": draw("contributors", outcome, context)}
    monkeypatch.setattr("mic.report.page.draw_all", one_picture)
    assert "Main contributors of " in execute("mic", "report", str(folder))
    page = (folder / "report.html").read_text(encoding="utf-8")
    for anchor in ("verdict-table", "budget-table", "contributors-table", "friction-table", "contributors"):
        assert f'id="{anchor}"' in page
    assert "Friction has little effect" in page and "nearly linear" in page
    assert page.index('id="verdict"') < page.index('id="validity"')
    opening = page[page.index('<section id="verdict">') : page.index("</section>")]
    assert "Main contributors of " in opening and "not computed" not in opening
    for source in ("samples", "path", "contact residuals", "meshes", "contact pairs", "order of the process"):
        assert f"<b>{source}</b>" in opening
