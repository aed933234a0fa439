"""Stages that follow another path."""

from dataclasses import replace

MOVES = ("clamp", "weld", "release")  #: kinds of stages that may follow a path


def with_stages(model, stages):
    """The model of the same scene with other stages."""
    return replace(model, scene=model.scene.model_copy(update={"stages": stages}))


def stages_on_the_way(scene, way):
    """The stages of a scene with the named path, or a number of increments in each step."""
    keys = {"path": way} if isinstance(way, str) else {"path": "increments", "increments": way}
    return [stage.model_copy(update=keys) if stage.kind in MOVES else stage for stage in scene.stages]


def on_the_way(model, way):
    """The model with the named path in every stage, or a number of increments in each step."""
    return with_stages(model, stages_on_the_way(model.scene, way))
