"""Constants that the modules of the follower share."""

__all__ = ["FACTORISATIONS", "FAILED", "LONGEST", "NEAR", "ROUNDING", "STEPS"]

#: The longest step of the whole path, because the estimate of its error sees two directions of a slider and not what it
#: does in between, unless all of its motion is less than may be in error.
LONGEST = 0.5
#: A contact this near its cone (relative) at the start of a step may slide.
NEAR = 1e-7
#: Relative to the largest force: tangential forces below this count as zero; so do normal forces at the start of an
#: increment.
ROUNDING = 1e-12

STEPS, FACTORISATIONS, FAILED = range(3)  #: columns of the counts
