"""Write an FMI 3.0 unit of a reduced model, with the library PythonFMU3.

The unit contains the model and :mod:`mic.deployment.fmi_instance`; where it is imported, Python needs this program.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from mic.errors import ArgumentError, MissingLibrary
from mic.process.model import ReducedModel
from mic.studies.adjustment import FACTOR, SHIM, Adjustment, adjustments
from mic.system.arguments import checked
from mic.system.files import replacing

__all__ = ["check_unit", "unit_adjustments", "write_unit"]


def unit_adjustments(model: ReducedModel, shim: float, factor: float) -> list[Adjustment]:
    """The adjustments that are inputs of a unit: none for a scene without locators and clamps."""
    fixture = model.scene.locators or model.scene.clamps
    return adjustments(model, shim, factor) if fixture else []


def check_unit(path: Path) -> None:
    """Raise an error unless a unit can be written to a file.

    Raises
    ------
    MissingLibrary
        If PythonFMU3 is not installed.
    ArgumentError
        If the file's name does not end with ``.fmu``.
    """
    try:
        import pythonfmu3  # noqa: F401
    except ModuleNotFoundError:
        needs = "mic export --fmu needs the library pythonfmu3; install it: pip install 'mic-contact[fmu]'"
        raise MissingLibrary(needs) from None
    if path.suffix != ".fmu":
        raise ArgumentError(f"--fmu {path}: the name of a unit ends with .fmu; correct it")


@checked
def write_unit(
    model: ReducedModel, path: Path, law: str | None = None, shim: float = SHIM, factor: float = FACTOR
) -> int:
    """Write the FMI 3.0 unit of a model; returns the number of its inputs.

    Parameters
    ----------
    model : ReducedModel
    path : Path
        File of the unit, ``NAME.fmu``.
    law : str, optional
        Contact law; default: the first of the scene's report.
    shim, factor : float
        Bounds of the adjustments, as :func:`mic.studies.adjustment.adjustments` takes them.

    Raises
    ------
    MissingLibrary
        As :func:`check_unit`.
    ArgumentError
        As there, and if the bounds allow no change, or nothing is measured.
    StorageError
        If the file cannot be written.
    """
    path = Path(path)
    check_unit(path)
    from pythonfmu3 import FmuBuilder  # an optional dependency

    if not model.scene.measurements:
        raise ArgumentError(f"scene {model.scene.name!r} has no measurements: a unit would have no outputs; add some")
    available = unit_adjustments(model, shim, factor)
    identifier = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    identifier = identifier if identifier[:1].isalpha() else f"unit_{identifier}"
    settings = {"law": law or model.scene.report.laws[0], "shim": shim, "factor": factor, "identifier": identifier}
    with replacing(path) as temporary, TemporaryDirectory(prefix="mic-") as name:
        folder = Path(name)
        model.save(folder / "model.npz")
        (folder / "unit.json").write_text(json.dumps(settings), encoding="utf-8")
        script = Path(__file__).with_name("fmi_instance.py")
        files = [folder / "model.npz", folder / "unit.json"]
        options = {"canHandleVariableCommunicationStepSize": True}
        shutil.move(FmuBuilder.build_FMU(script, folder / "unit", files, **options), temporary)
    return len(model.scene.deviations) + len(available)
