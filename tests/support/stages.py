"""Models whose stages follow another path."""

from dataclasses import replace


def with_stages(model, stages):
    """The model of the same scene with other stages."""
    return replace(model, scene=model.scene.model_copy(update={"stages": stages}))


def on_the_way(model, way):
    """The model with the named path in every stage, or a number of increments in each step."""
    keys = {"path": way} if isinstance(way, str) else {"path": "increments", "increments": way}
    moves = ("clamp", "weld", "release")
    stages = [stage.model_copy(update=keys) if stage.kind in moves else stage for stage in model.scene.stages]
    return with_stages(model, stages)
