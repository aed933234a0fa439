"""Constants that the modules of the follower share."""

__all__ = ["CUT", "FACTORISATIONS", "FAILED", "LONGEST", "NEAR", "RESCUES", "ROUNDING", "STEPS"]

#: The longest step of the whole path, because the estimate of its error sees two directions of a slider and not what it
#: does in between, unless all of its motion is less than may be in error.
LONGEST = 0.5
#: A contact this near its cone (relative) at the start of a step may slide.
NEAR = 1e-7
#: Of the largest force: a tangential force that is less is none, nor, at the start of an increment, a normal one.
ROUNDING = 1e-12

STEPS, FACTORISATIONS, RESCUES, FAILED, CUT = range(5)  #: columns of the counts
