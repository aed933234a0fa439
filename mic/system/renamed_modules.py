"""Former module names of the package, importable for one release with a deprecation warning."""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import sys
import warnings
from collections.abc import Sequence
from types import ModuleType

__all__ = ["install"]

#: New module by former name.
RENAMED = {
    "mic.blas": "mic.system.blas",
    "mic.cache": "mic.system.disk_cache",
    "mic.commands.call": "mic.commands.invocation",
    "mic.compiling": "mic.system.compilation",
    "mic.console": "mic.system.console",
    "mic.contact.columns": "mic.contact.compliance_columns",
    "mic.contact.comparison": "mic.contact.law_comparison",
    "mic.contact.memory": "mic.contact.lazy_memory",
    "mic.contact.problems": "mic.contact.benchmark_problems",
    "mic.contact.programme": "mic.contact.cone_programme",
    "mic.contact.trail": "mic.contact.path_record",
    "mic.contact.watched": "mic.contact.working_set",
    "mic.geometry.cloud": "mic.geometry.measured_points",
    "mic.geometry.opened": "mic.geometry.script_dependencies",
    "mic.geometry.readers.program": "mic.geometry.readers.gmsh_program",
    "mic.geometry.readers.raw": "mic.geometry.readers.raw_mesh",
    "mic.geometry.sides": "mic.geometry.coincident_sheets",
    "mic.geometry.told": "mic.geometry.mesh_summary",
    "mic.judgement": "mic.plausibility",
    "mic.judgement.file": "mic.plausibility.scene_file",
    "mic.judgement.meshes": "mic.plausibility.meshes",
    "mic.judgement.rule": "mic.plausibility.rule",
    "mic.judgement.table": "mic.plausibility.rules",
    "mic.kept": "mic.system.memoise",
    "mic.model.accuracy": "mic.model.mesh_accuracy",
    "mic.model.apart": "mic.model.coincident_sheets",
    "mic.model.deviated": "mic.model.deviated_geometry",
    "mic.model.meshing": "mic.model.element_sizes",
    "mic.model.modes": "mic.model.shape_modes",
    "mic.model.placing": "mic.model.placement",
    "mic.model.positions": "mic.model.position_rows",
    "mic.model.resting": "mic.model.rest_rows",
    "mic.model.slopes": "mic.model.shape_derivatives",
    "mic.model.solved_mesh": "mic.model.refined_mesh",
    "mic.process.freedom": "mic.process.free_motions",
    "mic.process.handover": "mic.process.ramp_columns",
    "mic.process.linear": "mic.process.linear_maps",
    "mic.process.path": "mic.process.ramp",
    "mic.process.rest": "mic.process.resting_parts",
    "mic.process.shift": "mic.process.moving_rows",
    "mic.process.stops": "mic.process.force_limits",
    "mic.process.values": "mic.process.row_values",
    "mic.process.words": "mic.process.description",
    "mic.product": "mic.system.matrix_product",
    "mic.proposal": "mic.wizard",
    "mic.proposal.bodies": "mic.wizard.bodies",
    "mic.proposal.faying": "mic.wizard.faying",
    "mic.proposal.fixture": "mic.wizard.fixture",
    "mic.proposal.joints": "mic.wizard.joints",
    "mic.proposal.proposal": "mic.wizard.proposal",
    "mic.proposal.writing": "mic.wizard.scene_text",
    "mic.report.ahead": "mic.report.background_pictures",
    "mic.report.answer": "mic.report.verdict",
    "mic.report.drivers": "mic.report.driver_sentences",
    "mic.report.gallery": "mic.report.picture_registry",
    "mic.report.shown": "mic.report.study_pictures",
    "mic.report.single": "mic.report.assembly_pictures",
    "mic.report.thinning": "mic.report.mesh_decimation",
    "mic.report.viewer": "mic.report.viewer_data",
    "mic.results.accuracy": "mic.results.mesh_error",
    "mic.results.budget": "mic.results.error_sources",
    "mic.results.capability": "mic.statistics.capability",
    "mic.results.condensed": "mic.results.low_rank_forces",
    "mic.results.digest": "mic.results.block_statistics",
    "mic.results.folder": "mic.results.run_folder",
    "mic.results.forecast": "mic.results.cost_estimate",
    "mic.results.identity": "mic.results.run_identity",
    "mic.results.law_comparison": "mic.results.friction_sweep",
    "mic.results.lock": "mic.system.lock",
    "mic.results.paired": "mic.statistics.paired_differences",
    "mic.results.path_study": "mic.results.path_error",
    "mic.results.regression": "mic.statistics.regression",
    "mic.results.slope_regression": "mic.statistics.derivative_regression",
    "mic.results.sobol": "mic.statistics.sobol_indices",
    "mic.results.statistics": "mic.statistics.estimates",
    "mic.results.sums": "mic.results.contact_sums",
    "mic.results.tables": "mic.results.sample_tables",
    "mic.sampling": "mic.statistics",
    "mic.sampling.draw": "mic.statistics.draw",
    "mic.sampling.montecarlo": "mic.execution.monte_carlo",
    "mic.sampling.normal": "mic.statistics.normal_space",
    "mic.sampling.ranks": "mic.execution.ranks",
    "mic.sampling.sharing": "mic.execution.worker_process",
    "mic.store": "mic.system.files",
    "mic.studies.advice": "mic.studies.smallest_adjustment",
    "mic.studies.density": "mic.studies.pair_convergence",
    "mic.studies.emulator": "mic.statistics.emulator",
    "mic.studies.form": "mic.studies.first_order_reliability",
    "mic.studies.learning": "mic.studies.emulator_training",
    "mic.studies.optimisation.descent": "mic.studies.optimisation.gradient_search",
    "mic.studies.optimisation.sites": "mic.studies.optimisation.moved_items",
    "mic.studies.optimisation.trials": "mic.studies.optimisation.evaluations",
    "mic.studies.optimisation.words": "mic.studies.optimisation.description",
    "mic.studies.optimisation.writing": "mic.studies.optimisation.scene_changes",
    "mic.studies.screening": "mic.studies.input_screening",
}


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Load the module under its new name wherever the former one is imported."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        return importlib.machinery.ModuleSpec(fullname, self) if fullname in RENAMED else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        new = RENAMED[spec.name]
        warnings.warn(f"the module {spec.name} is now {new}", DeprecationWarning, stacklevel=2)
        module = importlib.import_module(new)
        spec.loader_state = module.__spec__  # the import system replaces it
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing to execute: the module has been imported under its new name."""
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state


def install() -> None:
    """Make the former names importable: first in line, or submodules of a renamed package would be loaded twice."""
    sys.meta_path.insert(0, _Finder())
