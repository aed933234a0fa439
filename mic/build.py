"""From a scene to its reduced model, or to the warnings of the plausibility check."""

from __future__ import annotations

from pathlib import Path

from mic.plausibility import SceneWarning, find_warnings
from mic.process.feasible_assembly import assemble_feasible
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients
from mic.scene import Scene
from mic.scene.settings import AUTO
from mic.setting_choice import choose
from mic.system.arguments import checked
from mic.system.disk_cache import cache_folder
from mic.system.progress_bar import ProgressBar

__all__ = ["check", "reduce"]


@checked
def reduce(scene: Scene, cache: Path | None = None, progress: bool | None = None) -> ReducedModel:
    """Build the reduced model of a scene: meshes, contact pairs, influence coefficients. Each MPI rank builds its own.

    With ``setting = "auto"``, what the scene leaves open is chosen first (:mod:`mic.setting_choice`).

    Parameters
    ----------
    scene : Scene
    cache : Path, optional
        Folder of generated meshes and influence coefficients; default :func:`mic.cache_folder`.
    progress : bool, optional
        Whether the step that is being computed is shown; default: after a second, in a notebook or interactive session.

    Raises
    ------
    SceneError
        Naming the key and the remedy.
    MissingProvider
        If influence coefficients must be computed and no provider of them is installed.
    """
    cache = cache or cache_folder()
    with ProgressBar(progress) as bar:
        if scene.setting == AUTO:
            scene = choose(scene, cache, bar.report).scene
        bar.report(f"{scene.name}: meshing and pairing")
        assembly = assemble_feasible(scene, cache, bar.report)
        return ReducedModel.build(assembly, coefficients(assembly, cache, bar.report)[0])


@checked
def check(scene: Scene, cache: Path | None = None) -> tuple[SceneWarning, ...]:
    """Mesh and assemble a scene, and warn of values that are valid but unusual in production.

    Parameters
    ----------
    scene : Scene
    cache : Path, optional
        Folder of generated meshes; default :func:`mic.cache_folder`.

    Returns
    -------
    tuple of mic.plausibility.SceneWarning
        In the order of the rules; empty if nothing is unusual.

    Raises
    ------
    SceneError
        If the scene cannot be built, naming the key and the remedy.
    """
    return find_warnings(scene, assemble_feasible(scene, cache or cache_folder()))
